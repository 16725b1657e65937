"""Fit ellipsoids in high dimension, or to very many points or half-spaces, in NumPy.

`outer` fits ellipsoids around points and `inner` fits them inside half-spaces; `dense` contains their triangular
matrices and step lengths.
"""
