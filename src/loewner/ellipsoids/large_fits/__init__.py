"""Fit ellipsoids in high dimension, or to very many points or half-spaces, in NumPy.

`outer` fits around points and `inner` inside half-spaces; `dense` has their triangular matrices and step lengths.
"""
