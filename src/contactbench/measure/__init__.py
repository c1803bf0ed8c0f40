"""Measurements: laws along a trajectory, orders of convergence, linear stability."""
