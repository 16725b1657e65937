"""Ellipsoids in high dimension, or of very many points or half-spaces, in NumPy."""
