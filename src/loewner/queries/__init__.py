"""Queries about bodies at poses.

`pairs` classifies pairs, decides whether pairs collide, and measures their distances. `crowds` finds the colliding
pairs among many bodies, `first_contacts` computes when two moving bodies first touch, and `pose_paths` describes
motions in time. These four modules use `_measure` and `_settle`, which process lists of pairs; `_exact` decides pairs
of surfaces in integers.
"""
