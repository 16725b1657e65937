"""From mesh files to convex pieces, and how closely they approximate it.

`files` reads the formats. `decomposition` divides a mesh into convex pieces, `plane_cuts` does so within a tolerance,
and `closed_parts` finds the closed parts of a mesh. `coverage` and `protrusion` measure the parts that pieces miss and
how far pieces stick out, `inscribed` fits ellipsoids inside a mesh, and `triangles` prepares arrays.
"""

from loewner.meshes.decomposition import convex_pieces, load

__all__ = ["convex_pieces", "load"]
