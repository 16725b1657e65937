"""Check configurations: pairs as arrays, verdicts and distances.

`checked_pairs` collects the rules for pairs, `problem` prepares the pairs for the kernels, `verdicts`, `distances` and
`edges` compute answers, `self_filter` removes the robot from a camera's points, `cells` saves a robot with its scene
for C, and `pair_cache` keeps proven pairs on disk.
"""
