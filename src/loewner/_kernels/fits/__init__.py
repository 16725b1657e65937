"""Hulls and the ellipsoids of pieces."""
