"""Questions about bodies at poses.

`pairs` classifies, collides and measures pairs. `crowds` finds the pairs that meet among many bodies, `first_contacts`
finds when two moving bodies first touch, and `pose_paths` describes such motions. Below them, `_measure` and `_settle`
work through lists of pairs, and `_exact` decides surfaces in integers.
"""
