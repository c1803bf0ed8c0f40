"""The integrators inside other libraries' solvers: `cb.scipy`, `cb.diffrax`, imported when first asked for."""
