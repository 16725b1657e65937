"""Bounding-box trees over bodies and over the pieces of a body."""
