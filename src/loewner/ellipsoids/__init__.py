"""Ellipsoids, and the convex sets to which they are fitted.

`ellipsoids` defines `Ellipsoids`, one or a batch; `ellipsoid_pairs` answers whether two overlap. `fits` finds the
largest ellipsoid inside and the smallest around (`mvie`, `mvce`), with `large_fits` in high dimension. `polytopes`
turns vertices into half-spaces and back.
"""
