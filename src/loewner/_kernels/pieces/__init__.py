"""Convex pieces as kernels see them: packed arrays, shapes, poses."""
