"""Queries about bodies at poses.

`pairs` classifies pairs, decides whether they collide and measures their distances. `crowds` finds the pairs that meet
among many bodies, `first_contacts` finds when two moving bodies first touch, and `pose_paths` describes motions in
time. Below them, `_measure` and `_settle` work through lists of pairs, and `_exact` decides pairs of surfaces in
integers.
"""
