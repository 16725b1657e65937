"""Named bodies with poses and margins, and where they come from.

`scene` defines `Scene`; `files` reads and writes scenes, `maps` reads occupancy grids, and `mjcf_models` and
`mjcf_limits` read MuJoCo models.
"""
