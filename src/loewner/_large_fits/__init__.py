"""Fit ellipsoids in high dimension, or to very many points or half-spaces, in NumPy."""
