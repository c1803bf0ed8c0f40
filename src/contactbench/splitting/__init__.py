"""Exact subflows, compositions of them as data, and the loop that runs every composition."""
