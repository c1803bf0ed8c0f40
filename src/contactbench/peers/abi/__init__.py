"""What is not public in the libraries of the peers: symbols of CVODE, the C interface of CyRK."""
