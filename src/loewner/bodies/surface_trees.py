"""Build trees over the triangles of surfaces, for kernels to traverse."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base._matrices import cholesky, product
from loewner._base._validate import Floats, Ints
from loewner._kernels import records
from loewner._native import entries
from loewner.meshes.inscribed import FEWEST_TRIANGLES, inscribed_ellipsoids

# Largest number of ellipsoids inside a solid. More ellipsoids would take longer to find, and prove little more.
MOST_INSIDE = 8

# Bound on the error of a shape matrix's root in single precision, in units of its roundoff.
SINGLE_ROUNDINGS = 8.0

# Bound on the rounding errors of an ellipsoid inside, or around, the sum of an ellipsoid and a ball, relative to its
# size.
SUM_ROUNDING = 2.0**-44


@dataclass(frozen=True, eq=False)
class SurfaceTree:
    """A tree over the triangles of a surface, and the addresses of its arrays; made by `of`.

    Attributes
    ----------
    boxes : ndarray of float32
    children : ndarray of int64
    blocks : ndarray
        Inputs of kernels; `loewner._kernels.trees.triangle_tree` describes them.
    parts : ndarray, shape (3 parts,)
        One vertex of each connected part.
    diagonals, ellipsoids : ndarray of float32
        Further arrays that `loewner._kernels.trees.triangle_tree` describes.
    inner_center, inner_factor : ndarray, shapes (k, 3) and (k, 3, 3)
        Ellipsoids inside a solid, largest first; empty for other surfaces.
    table : ndarray of int64
        Addresses of the first five arrays; kernels receive the address of this table.
    """

    boxes: NDArray[np.float32]
    children: Ints
    blocks: Floats
    parts: Floats
    diagonals: NDArray[np.float32]
    ellipsoids: NDArray[np.float32]
    inner_center: Floats
    inner_factor: Floats
    table: Ints

    @classmethod
    def of(cls, vertices: Floats, triangles: Ints, solid: bool) -> SurfaceTree:
        """Build the tree over at least one triangle; connected triangles must share vertices."""
        boxes, children, blocks, diagonals, ellipsoids, _ = entries.triangle_tree(vertices, triangles)
        parts = vertices[entries.part_vertices(len(vertices), triangles)].ravel()
        tree = cls._at(boxes, children, blocks, parts, diagonals, ellipsoids, np.zeros((0, 3)), np.zeros((0, 3, 3)))
        if not solid or len(triangles) < FEWEST_TRIANGLES:
            return tree
        center, factor = inscribed_ellipsoids(vertices, triangles, MOST_INSIDE, (tree.boxes, tree.table))
        return replace(tree, inner_center=center, inner_factor=factor)

    @classmethod
    def _at(cls, boxes: Any, children: Any, blocks: Any, parts: Any, diagonals: Any, *others: Any) -> SurfaceTree:
        f = np.float32
        arrays = _lines(boxes, f), children, _lines(blocks, float), parts, _lines(diagonals, f)
        return cls(*arrays, *others, records.table_of(arrays))  # type: ignore[call-arg]  # nine in all

    def __reduce__(self) -> Any:
        """Make copies rebuild their table, because the table contains addresses."""
        return type(self)._at, self._arrays

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return tuple(getattr(self, field.name) for field in fields(self) if field.name != "table")

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(int(a.nbytes) for a in (*self._arrays, self.table))

    def outer_ellipsoids(self, radius: float) -> tuple[Floats, Floats]:
        """Compute centers and factors of ellipsoids around the parts below the root, which are thickened by a radius.

        The ellipsoids of the tree are in single precision. The radius is increased by the errors of this rounding.
        """
        top = max(int(self.children[0]), 0)
        wide = self.ellipsoids.size // 9
        filled = self.boxes.reshape(-1, 6, wide)[top, 3] >= 0
        rows = self.ellipsoids.reshape(9, wide)[:, filled].T.astype(float)
        root = rows[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3)
        sizes = np.sqrt((root**2).sum(axis=(1, 2)))
        least = 1e-12 + 1e-14 * np.abs(rows[:, :3]).max()  # least size, for a part that is a point
        reach = np.maximum(radius + SINGLE_ROUNDINGS * 2.0**-24 * sizes, least)
        return rows[:, :3], around_sums(product(root, root), reach)


def around_point(radius: float) -> Floats:
    """Compute the inner ellipsoid's factor for an open surface: a ball about one of its points, or only the point."""
    return np.eye(3) * radius * (1 - SUM_ROUNDING)


def around_sums(shape: Floats, radius: Floats) -> Floats:
    """Compute factors of ellipsoids around sums of balls and ellipsoids, which are given by shape matrices.

    Let Q be a shape matrix and r a radius. For all p > 0, the ellipsoid with the shape matrix (1 + 1/p) Q + (1 + p) r²
    1 contains the sum. The p used here minimises the trace of that matrix. Kurzhanski and Valyi (1997), Ellipsoidal
    Calculus for Estimation and Control, section 2.2.
    """
    # The size is p times the radius. The lower limit on the size is allowed because every p > 0 is valid.
    size = np.maximum(np.sqrt(np.trace(shape, axis1=1, axis2=2) / 3), 1e-9 * radius)
    joint = (1 + radius / size)[:, None, None] * shape + ((radius + size) * radius)[:, None, None] * np.eye(3)
    return cholesky(joint) * (1 + SUM_ROUNDING)


def _lines(array: NDArray[Any], kind: type[np.floating[Any]] | type[float]) -> NDArray[Any]:
    """Copy an array to an aligned address, so that no vector straddles two cache lines."""
    copy: NDArray[Any] = records.aligned(array.size, kind)
    copy[:] = array
    return copy


Trees = dict[int, SurfaceTree]
