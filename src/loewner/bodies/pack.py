"""Select, join and move pieces of many bodies, which are stored in flat arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from loewner._base import _elementary, _memory, _validate
from loewner._base._matrices import image, lengths, product, singular_values
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns, records
from loewner.bodies.layout import (
    ARRAYS,
    SINGULAR_ROUNDINGS,
    Maps,
    PieceArrays,
    arrays_of,
    direction_maps,
    heights_of,
    joined_kernel,
    kernel_arrays,
    laid_out,
    one_body,
    starts,
    surface_trees,
)
from loewner.bodies.surface_trees import Trees, around_point
from loewner.errors import GeometryError


@dataclass(frozen=True, eq=False)
class Prepared(PieceArrays):
    """Pieces of n bodies, with derived data that is slow to compute.

    Attributes
    ----------
    maps : dict
        The direction maps of the large polytopes, keyed by piece index, made by
        `loewner._kernels.pieces.directions.direction_map`.
    trees : dict
        The trees of the pieces that are surfaces, keyed by piece index.
    """

    maps: Maps
    trees: Trees

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        held = [*arrays_of(self).values(), *chain.from_iterable(self.maps.values()), *self.trees.values()]
        return sum(int(one.nbytes) for one in held)

    def packed(self) -> Packed:
        """Return the pieces with the arrays for kernels."""
        return Packed.of(PieceArrays(**arrays_of(self)), self.maps, self.trees)


@dataclass(frozen=True, eq=False)
class Packed(Prepared):
    """Pieces of n bodies with the arrays for kernels; made by `of`.

    Attributes
    ----------
    kernel : records.Pieces
        The arrays that kernels receive.
    addresses : ndarray of int64
        The addresses and lengths of the kernels' arrays.
    handle : int
        Address of `addresses` (see `loewner._kernels.pieces.pack`); it is valid as long as this object exists.
    """

    kernel: Any
    addresses: Ints
    handle: int

    @classmethod
    def of(cls, pieces: PieceArrays, maps: Maps | None = None, trees: Trees | None = None) -> Packed:
        """Make the arrays for kernels; direction maps and the trees of surfaces are made unless they are passed.

        Raises
        ------
        GeometryError
            If a piece is too small or too large for kernels.
        """
        _memory.expect_place(_memory.KERNELS)
        if maps is None:
            maps = direction_maps(pieces.layout, pieces.points)
        if trees is None:
            trees = surface_trees(pieces)
        pieces = _with_inner_of_solids(pieces, trees)
        prepared = Prepared(**arrays_of(pieces), maps=maps, trees=trees)
        return cls.with_kernel(prepared, kernel_arrays(pieces, maps, trees))

    @classmethod
    def with_kernel(cls, made: Prepared, kernel: records.Pieces) -> Packed:
        """Combine pieces with their arrays for kernels."""
        table = records.table_of(kernel)
        return cls(**vars(made), kernel=kernel, addresses=table, handle=table.ctypes.data)

    def __reduce__(self) -> Any:
        """Make copies and pickles rebuild the handle, because it is an address that is valid only for this object."""
        return type(self).of, (PieceArrays(**arrays_of(self)), self.maps, self.trees)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, including the kernels' arrays."""
        return super().nbytes + sum(int(array.nbytes) for array in self.kernel)


def _with_inner_of_solids(pieces: PieceArrays, trees: Trees) -> PieceArrays:
    """Replace the inner ellipsoid of each solid with the largest ellipsoid proven to lie inside."""
    solids = [i for i in trees if pieces.layout[i, columns.KIND] == columns.SOLID]
    if not solids:
        return pieces
    arrays = arrays_of(pieces)
    for name in ("inner_center", "inner_factor", "gaps"):
        arrays[name] = arrays[name].copy()
    for i in solids:
        center, factor = trees[i].inner_center, trees[i].inner_factor
        if len(center):
            arrays["inner_center"][i], arrays["inner_factor"][i] = center[0], factor[0]
        else:
            corner = pieces.points_of(i)[pieces.triangles_of(i)[0, 0]]
            arrays["inner_center"][i], arrays["inner_factor"][i] = corner, around_point(pieces.frames[i, 0])
        # The largest ellipsoid inside a solid has at most the volume of the outer ellipsoid.
        volumes = np.linalg.slogdet(np.stack([pieces.outer_factor[i], arrays["inner_factor"][i]]))[1]
        arrays["gaps"][i, 0] = volumes[0] - volumes[1] if np.isfinite(volumes).all() else 0.0
    return PieceArrays(**arrays)


def empty() -> Packed:
    """Make the pack of no bodies."""
    inner, outer = ((np.zeros((0, 3)), np.zeros((0, 3, 3))) for _ in range(2))
    start = np.zeros(1, dtype=np.int64)
    return Packed.of(laid_out(columns.POLYTOPE, inner, outer, np.zeros((0, 2)), piece_start=start))


def join(parts: Sequence[Packed]) -> Packed:
    """Join all bodies of several packs, in order; the kernels' arrays are joined, not recomputed."""
    _memory.expect_place(_memory.KERNELS)
    return Packed.with_kernel(joined(parts), joined_kernel(parts))


def as_one(parts: Sequence[Packed]) -> Packed:
    """Combine all pieces of several packs into one body."""
    pieces = joined(parts)
    kernel = one_body(joined_kernel(parts))
    return Packed.with_kernel(replace(pieces, piece_start=np.array([0, len(pieces.layout)])), kernel)


def joined(parts: Sequence[Prepared]) -> Prepared:
    """Join packs, without the arrays for kernels."""
    copied = sum(array.nbytes for part in parts for array in arrays_of(part).values())
    _validate.fits_memory(copied, f"{len(parts)} bodies")
    arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ARRAYS}
    sizes = np.array([[len(p.points), len(p.planes), len(p.layout), len(p.triangles)] for p in parts])
    shift = np.concatenate([np.zeros((1, 4), dtype=np.int64), np.cumsum(sizes, axis=0)[:-1]])
    arrays["layout"][:, columns.POINTS_FROM :] += np.repeat(np.repeat(shift[:, :2], 2, axis=1), sizes[:, 2], axis=0)
    for name, column in (("piece_start", 2), ("triangle_start", 3)):
        tails = [getattr(p, name)[1:] + s[column] for p, s in zip(parts, shift, strict=True)]
        arrays[name] = np.concatenate([[0], *tails]).astype(np.int64)
    maps = {int(i + s[2]): entry for p, s in zip(parts, shift, strict=True) for i, entry in p.maps.items()}
    trees = {int(i + s[2]): entry for p, s in zip(parts, shift, strict=True) for i, entry in p.trees.items()}
    return Prepared(**arrays, maps=maps, trees=trees)


def ranges(starts: Ints, stops: Ints) -> Ints:
    """Concatenate the index ranges starts[i] .. stops[i]."""
    lengths = stops - starts
    if lengths.sum() == 0:
        return np.zeros(0, dtype=np.int64)
    offsets = np.repeat(starts - np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths)
    return np.asarray(np.arange(lengths.sum()) + offsets)


def take(p: Packed, bodies: Ints) -> Packed:
    """Make a pack of the selected bodies; a body may be selected several times."""
    _validate.fits_memory(len(bodies) * p.nbytes // max(1, len(p.piece_start) - 1), f"{len(bodies)} bodies")
    first, last = p.piece_start[bodies], p.piece_start[bodies + 1]
    return some(p, ranges(first, last), starts(last - first)).packed()


def some(p: Prepared, pieces: Ints, piece_start: Ints) -> Prepared:
    """Regroup the selected pieces, possibly with repeats, into bodies that begin at the indices `piece_start`."""
    layout = p.layout[pieces]
    points = ranges(layout[:, columns.POINTS_FROM], layout[:, columns.POINTS_TO])
    planes = ranges(layout[:, columns.PLANES_FROM], layout[:, columns.PLANES_TO])
    triangles = ranges(p.triangle_start[pieces], p.triangle_start[pieces + 1])
    regrouped = laid_out(
        layout[:, columns.KIND],
        (p.inner_center[pieces], p.inner_factor[pieces]),
        (p.outer_center[pieces], p.outer_factor[pieces]),
        p.gaps[pieces],
        point_start=starts(layout[:, columns.POINTS_TO] - layout[:, columns.POINTS_FROM]), points=p.points[points],
        plane_start=starts(layout[:, columns.PLANES_TO] - layout[:, columns.PLANES_FROM]), planes=p.planes[planes],
        triangle_start=starts(p.triangle_start[pieces + 1] - p.triangle_start[pieces]),
        triangles=p.triangles[triangles], piece_start=piece_start, frames=p.frames[pieces],
    )  # fmt: skip
    maps = {new: p.maps[old] for new, old in enumerate(pieces.tolist()) if old in p.maps} if p.maps else {}
    trees = {new: p.trees[old] for new, old in enumerate(pieces.tolist()) if old in p.trees} if p.trees else {}
    return Prepared(**arrays_of(regrouped), maps=maps, trees=trees)


def moved(p: Packed, T: Floats) -> Packed:
    """Move all pieces by one rigid motion, and adjust the ellipsoids so that rounding does not break containment."""
    R, t = T[:3, :3], T[:3, 3]
    points = image(R, p.points) + t + 0.0  # without negative zeros
    normals = image(R, p.planes[:, :3])
    normals /= lengths(normals)[:, None]
    centers, factors = image(R, p.inner_center) + t, product(R, p.inner_factor)
    offsets = np.empty(len(normals))
    for i in np.flatnonzero(p.layout[:, columns.KIND] == columns.POLYTOPE):
        its = points[p.layout[i, columns.POINTS_FROM] : p.layout[i, columns.POINTS_TO]]
        faces = slice(p.layout[i, columns.PLANES_FROM], p.layout[i, columns.PLANES_TO])
        if len(its) > columns.LARGE:
            offsets[faces], _ = heights_of(its, normals[faces], centers[i], factors[i])
        else:
            offsets[faces] = product(normals[faces], its.T).max(axis=1)
    frames = p.frames.copy()
    curved = p.layout[:, columns.KIND] > columns.POLYTOPE
    frames[curved, 1:4] = image(R, p.frames[curved, 1:4]) + t
    frames[:, 4:] = product(R, p.frames[:, 4:].reshape(-1, 3, 3)).reshape(-1, 9)
    # A moved point, center or factor differs from its exact image by at most 8 roundings of the lengths involved. R
    # also stretches lengths, because it is only nearly orthonormal.
    table = p.kernel.table
    shift = 2.0**-53 * 32 * (table[:, columns.REACH] + np.abs(t).sum())
    inside = p.inner_factor.any(axis=(1, 2))  # the inner ellipsoid of an open surface without a radius is a point
    shrink = np.where(inside, 1 - shift / table[:, columns.INNER_SIGMA], 1.0)
    grow = 1 + shift / table[:, columns.OUTER_SIGMA]
    # R stretches the ellipsoids and the core of a piece, but the radius of the added ball stays the same. The moved
    # ellipsoids therefore fit the stretched core with a stretched ball. Scaling the ellipsoids about their centers by
    # the stretch makes them fit the stretched core with the unchanged ball.
    stretched = singular_values(R[None])[0]
    stretch = max(stretched[0], 1 / stretched[-1]) * (1 + 2 * SINGULAR_ROUNDINGS)
    rounded = p.frames[:, 0] > 0
    shrink[rounded] /= stretch
    grow[rounded] *= stretch
    if not (shrink > 0.5).all():
        raise GeometryError(
            f"T: expected a shorter translation for a piece this thin, found {np.abs(t).max():g} m, which leaves no "
            "digits; pass the pose to the query instead"
        )
    arrays = arrays_of(p)
    arrays.update(
        points=points,
        planes=np.column_stack([normals, offsets]),
        frames=frames,
        inner_center=centers,
        inner_factor=factors * shrink[:, None, None],
        outer_center=image(R, p.outer_center) + t,
        outer_factor=product(R, p.outer_factor) * grow[:, None, None],
        gaps=p.gaps + 3 * np.column_stack([-_elementary.log(shrink), _elementary.log(grow)]),
    )
    return Packed.of(PieceArrays(**arrays))
