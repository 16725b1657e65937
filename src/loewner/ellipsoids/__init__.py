"""Ellipsoids, and the convex sets to which they are fitted.

`ellipsoids` defines `Ellipsoids`, which holds one ellipsoid or a batch; `ellipsoid_pairs` decides whether two
ellipsoids overlap. `fits` finds the largest ellipsoid inside a set (`mvie`) and the smallest ellipsoid around it
(`mvce`), and uses `large_fits` in high dimension. `polytopes` converts vertices to half-spaces and back.
"""
