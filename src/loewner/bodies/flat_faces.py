"""Find the flat faces of a mesh, that is, neighbouring triangles in one plane."""

from __future__ import annotations

import numpy as np

from loewner._base._matrices import components, normals_of
from loewner._base._validate import Floats, Ints

# Two neighbouring triangles count as coplanar if the angle between them is smaller than this [rad].
FLAT = 1e-3


def flat_faces(vertices: Floats, triangles: Ints) -> Ints:
    """Number the faces of a mesh, and return the face of each triangle.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    triangles : ndarray of int, shape (T, 3)

    Returns
    -------
    ndarray of int, shape (T,)
        Two triangles that share an edge have the same number if they are coplanar or nearly coplanar. Small triangles
        of a smooth surface may therefore form a single curved face.
    """
    normals = normals_of(vertices[triangles])
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    order = np.lexsort(edges.T)
    same = (edges[order[1:]] == edges[order[:-1]]).all(axis=1)
    one, other = order[:-1][same] // 3, order[1:][same] // 3
    squares = (normals**2).sum(axis=1)
    bend = (np.cross(normals[one], normals[other]) ** 2).sum(axis=1)
    flat = bend <= FLAT * FLAT * squares[one] * squares[other]
    return components(len(triangles), one[flat], other[flat])
