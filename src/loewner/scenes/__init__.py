"""Named bodies with poses and margins, and the files that define them.

`scene` defines `Scene`; `files` reads and writes scenes, `maps` reads occupancy grids, and `mjcf_models` and
`mjcf_limits` read MuJoCo models.
"""
