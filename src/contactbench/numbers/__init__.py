"""Number types that scenes and flows run on beside floats, arrays, JAX tracers and mpmath numbers."""
