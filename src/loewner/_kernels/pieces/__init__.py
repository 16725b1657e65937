"""Convex pieces in the form that kernels use: packed arrays, shapes, poses."""
