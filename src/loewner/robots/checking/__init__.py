"""Checks of configurations: pairs as arrays, verdicts and distances.

`checked_pairs` chooses the pairs, `problem` and `motion_tables` prepare them for the kernels, `verdicts`, `distances`
and `edges` answer, `self_filter` removes the robot from a camera's points, `cells` saves a robot with its scene for C,
and `pair_cache` keeps proven pairs on disk.
"""
