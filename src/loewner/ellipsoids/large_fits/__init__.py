"""Fit ellipsoids in high dimension, or to very many points or half-spaces, in NumPy.

`outer` fits ellipsoids around points, and `inner` fits ellipsoids inside half-spaces; both use the triangular matrices
and step lengths in `dense`.
"""
