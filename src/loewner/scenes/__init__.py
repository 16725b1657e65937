"""Named bodies with poses and margins, and the files that define them.

`scene` defines `Scene`, `files` reads and writes scenes, and `maps` reads occupancy grids. `mjcf_models` reads MuJoCo
models, whose size `mjcf_limits` checks first.
"""
