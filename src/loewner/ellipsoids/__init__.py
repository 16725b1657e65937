"""Ellipsoids, and the convex sets to which they are fitted.

`ellipsoids` defines `Ellipsoids`, one or a batch; `ellipsoid_pairs` decides whether two of them overlap. `fits` finds
the largest ellipsoid inside a set and the smallest one around it (`mvie`, `mvce`), with `large_fits` in high dimension.
`polytopes` turns vertices into half-spaces and back.
"""
