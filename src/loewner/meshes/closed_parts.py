"""Split a mesh into closed parts that are separated at shared edges and oriented outward, each with its cavities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._base import _elementary
from loewner._base._matrices import components
from loewner._base._validate import Floats, Ints
from loewner.meshes.protrusion import Solid

# Triangles at a smaller angle [rad] about their common edge count as coincident; the angle is somewhat above the errors
# of single precision.
SAME_ANGLE = 1e-5

# Number of corners that are tested to decide whether a part lies in another part.
WITNESSES = 64


class ClosedPart(NamedTuple):
    """A closed surface with its cavities.

    Attributes
    ----------
    triangles : ndarray of int, shape (t, 3)
        Triangles, counter-clockwise when seen from outside the solid. For a cavity, "outside" means within the
        cavity.
    volume : float
        Enclosed volume without the cavities, in cubic metres.
    """

    triangles: Ints
    volume: float


def closed_parts(vertices: Floats, triangles: Ints) -> list[ClosedPart] | None:
    """Split a mesh into closed parts; return None if the surface has a border or is inconsistently oriented.

    Parts may overlap, and may share edges and corners. A part of negative volume is a cavity of the smallest part that
    contains it. If no part contains it, the part was inside out and is reversed.
    """
    neighbours = _neighbours(vertices, triangles)
    if neighbours is None:
        return None
    label = components(len(triangles), *neighbours)
    order = np.argsort(label, kind="stable")
    surfaces = np.split(triangles[order], np.cumsum(np.bincount(label))[:-1])
    volumes = [volume(vertices, surface) for surface in surfaces]
    if sum(volumes) < 0:  # the whole mesh is inside out
        surfaces, volumes = [surface[:, ::-1] for surface in surfaces], [-v for v in volumes]

    solids = [k for k, enclosed in enumerate(volumes) if enclosed >= 0]
    cavities: dict[int, list[int]] = {k: [] for k in solids}
    for k in range(len(surfaces)):
        if volumes[k] < 0:
            around = [j for j in solids if volumes[j] > -volumes[k] and _lies_in(vertices, surfaces[k], surfaces[j])]
            if around:
                cavities[min(around, key=volumes.__getitem__)].append(k)
            else:
                surfaces[k], volumes[k] = surfaces[k][:, ::-1], -volumes[k]
                cavities[k] = []
    return [
        ClosedPart(
            np.concatenate([surfaces[k], *(surfaces[hole] for hole in holes)]),
            volumes[k] + sum(volumes[hole] for hole in holes),
        )
        for k, holes in sorted(cavities.items())
    ]


def volume(vertices: Floats, triangles: Ints) -> float:
    """Compute a closed mesh's signed volume by the divergence theorem.

    Coordinates are taken relative to the center of the mesh, to reduce cancellation.
    """
    corners = vertices[triangles]
    a, b, c = (corners - corners.mean(axis=(0, 1))).transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _neighbours(vertices: Floats, triangles: Ints) -> tuple[Ints, Ints] | None:
    """Pair the triangles that bound the same solid at an edge; None if an edge has only one triangle."""
    count, span = len(triangles), int(triangles.max()) + 1
    start, end = triangles.T.reshape(-1), np.roll(triangles, -1, axis=1).T.reshape(-1)
    forth = start < end
    key = np.minimum(start, end) * span + np.maximum(start, end)
    # Sort by edge, with the triangles that run forward along the edge before the triangles that run backward.
    order = np.lexsort((~forth, key))
    first = np.flatnonzero(np.r_[True, np.diff(key[order]) != 0])
    uses = np.diff(np.r_[first, len(order)])
    if (2 * np.add.reduceat(forth[order].astype(np.int64), first) != uses).any():
        return None
    one, other = order[first], order[first + 1]
    simple = uses == 2
    pairs = [(one[simple] % count, other[simple] % count)]
    for at, k in zip(first[~simple], uses[~simple], strict=True):
        corners = order[at : at + k]
        pairs.append(_paired(vertices, triangles, corners % count, corners // count, forth[corners]))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def _paired(vertices: Floats, triangles: Ints, of: Ints, corner: Ints, forth: np.ndarray) -> tuple[Ints, Ints]:
    """Pair the triangles around an edge so that the solid lies between the two triangles of each pair."""
    start, end = triangles[of[0], corner[0]], triangles[of[0], (corner[0] + 1) % 3]
    low, high = sorted((int(start), int(end)))
    axis = vertices[high] - vertices[low]
    axis /= max(float(np.linalg.norm(axis)), np.finfo(float).tiny)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    arms = vertices[triangles[of, (corner + 2) % 3]] - vertices[low]
    angle = _elementary.arctan2(arms @ np.cross(axis, side), arms @ side)
    # Counter-clockwise about the edge, the solid begins at a triangle that runs backward along the edge and ends at a
    # triangle that runs forward. Where two triangles coincide, ends come before beginnings.
    rank = np.argsort(angle, kind="stable")
    place = np.empty(len(of), dtype=np.int64)
    place[rank] = np.cumsum(np.r_[0, np.diff(angle[rank]) > SAME_ANGLE])
    if angle.min() + 2 * np.pi - angle.max() <= SAME_ANGLE:
        place[place == place.max()] = 0
    rank = np.lexsort((~forth, place))
    depth = np.cumsum(np.where(forth[rank], -1, 1))
    rank = np.roll(rank, -(int(depth.argmin()) + 1))
    # The part that begins first is assumed to end first; if parts overlap, every way of pairing results in closed
    # surfaces.
    return of[rank[~forth[rank]]], of[rank[forth[rank]]]


def _lies_in(vertices: Floats, inner: Ints, outer: Ints) -> bool:
    """Decide, from some of its corners, whether a closed surface lies inside another closed surface."""
    corners, around = np.unique(inner), vertices[outer]
    points = vertices[corners[:: max(1, len(corners) // WITNESSES)]]
    lower, upper = around.min(axis=(0, 1)), around.max(axis=(0, 1))
    if not ((points >= lower) & (points <= upper)).all():
        return False
    return bool((Solid(around, closed=True).winding_numbers(points) != 0).mean() > 0.5)
