"""Turn mesh files into convex pieces, and measure how closely the pieces approximate the mesh.

`files` reads the formats. `decomposition` divides a mesh into convex pieces, `plane_cuts` does so within a tolerance,
and `closed_parts` finds the closed parts of a mesh. `coverage` measures the parts of a mesh that pieces miss, and
`protrusion` how far pieces stick out. `inscribed` fits ellipsoids inside a mesh, and `triangles` prepares arrays.
"""

from loewner.meshes.decomposition import convex_pieces, load

__all__ = ["convex_pieces", "load"]
