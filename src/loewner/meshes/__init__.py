"""Turn mesh files into convex pieces, and measure how closely the pieces approximate the mesh.

`files` reads the formats. `decomposition` divides a mesh into convex pieces, `plane_cuts` cuts a mesh into pieces that
stick out by at most a tolerance, and `closed_parts` finds the closed parts of a mesh. `coverage` measures the parts of
a mesh that pieces miss, and `protrusion` measures how far pieces stick out. `inscribed` fits ellipsoids inside a mesh,
and `triangles` halves, cuts and measures triangles.
"""

from loewner.meshes.decomposition import convex_pieces, load

__all__ = ["convex_pieces", "load"]
