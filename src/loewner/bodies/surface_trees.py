"""Trees over the triangles of surfaces, as kernels walk through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._kernels import columns, records
from loewner._native import entries
from loewner._validate import Floats, Ints


@dataclass(frozen=True, eq=False)
class SurfaceTree:
    """A tree, and where its arrays are; made by `of`.

    Attributes
    ----------
    boxes : ndarray of float32
    children : ndarray of int64
    blocks : ndarray
        Described in `loewner._kernels.trees.triangle_tree`.
    parts : ndarray, shape (3 parts,)
        A vertex of each connected part.
    ellipsoids : ndarray of float32
        Of the nodes, described there, too.
    table : ndarray of int64
        Where these are; kernels get its address.
    """

    boxes: NDArray[np.float32]
    children: Ints
    blocks: Floats
    parts: Floats
    ellipsoids: NDArray[np.float32]
    table: Ints

    @classmethod
    def of(cls, vertices: Floats, triangles: Ints) -> SurfaceTree:
        """Build the tree over some triangles, at least one."""
        boxes, children, blocks, ellipsoids = entries.triangle_tree(vertices, triangles)
        _, number = entries.equal_vertices(vertices)
        parts = vertices[_first(number)[entries.part_vertices(len(vertices), number[triangles])]].ravel()
        return cls._at(boxes.astype(np.float32), children, blocks, parts, ellipsoids.astype(np.float32))

    @classmethod
    def _at(cls, boxes: Any, children: Ints, blocks: Floats, parts: Floats, ellipsoids: Any) -> SurfaceTree:
        table = records.table_of((boxes, children, blocks, parts, ellipsoids))
        return cls(boxes, children, blocks, parts, ellipsoids, table)

    def __reduce__(self) -> Any:
        """Copies are made anew: the table is of addresses."""
        return type(self)._at, self._arrays

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self.boxes, self.children, self.blocks, self.parts, self.ellipsoids

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(int(a.nbytes) for a in (*self._arrays, self.table))


Trees = dict[int, SurfaceTree]


def surface_trees(layout: Ints, points: Floats, triangles: Ints, triangle_start: Ints) -> Trees:
    """Trees of the surfaces among pieces, by number of the piece."""
    made = {}
    for i in np.flatnonzero(layout[:, columns.KIND] <= columns.SURFACE):
        vertices = points[layout[i, columns.POINTS_FROM] : layout[i, columns.POINTS_TO]]
        made[int(i)] = SurfaceTree.of(vertices, triangles[triangle_start[i] : triangle_start[i + 1]])
    return made


def _first(number: Ints) -> Ints:
    """Where each number appears first."""
    first = np.empty(len(number), dtype=np.int64)
    first[number[::-1]] = np.arange(len(number))[::-1]
    return first
