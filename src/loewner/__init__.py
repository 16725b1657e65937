"""Certified collision detection between convex pieces."""
