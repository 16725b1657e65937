"""Make convex polytopes in any dimension, with vertices and faces, from points or from half-spaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _memory, _validate
from loewner._base._guard import guarded
from loewner._base._matrices import dot, least_of
from loewner._base._read_only import KeepsReadOnly, read_only
from loewner._base._threads import in_shares
from loewner._base._validate import Floats, Ints, Progress
from loewner._kernels import codes
from loewner._native import entries
from loewner.errors import GeometryError, InputError

# SciPy's hulls and linear programs are imported where they are used: together they take longer to import than the rest
# of `loewner`.


# Smallest and largest number of hulls or pieces that a thread takes at a time, for a progress report every 10 to 50 ms.
LEAST_SHARE, BLOCK = 16, 512

# A set of points is flat if its width in some direction is at most FLATNESS times its length. If a flatter body is
# rotated, float64 coordinates do not resolve its shape: four digits remain at this aspect ratio, and none at 1e-16.
FLATNESS = 1e-12
EPS = float(np.finfo(float).eps)
# If there are MANY_POINTS points or more in 3-D, points inside the hull of a sample are left out. The sample has a
# fiftieth of the points, but at least LEAST_SAMPLE and at most MOST_SAMPLE. The step is skipped if more than the share
# WORTHWHILE of the sample are vertices of its hull, or if the hull has a face nearer to its middle than SHALLOW,
# relative to the size of all points. The hull is shrunk by the share SHRINK.
MANY_POINTS, LEAST_SAMPLE, MOST_SAMPLE = 20_000, 1_000, 20_000
WORTHWHILE, SHALLOW, SHRINK = 0.5, 1e-3, 1e-6
# Number of points that a kernel examines between two checks for an interrupt, which takes about 10 ms.
POINTS_AT_ONCE = 2**18
# Limits on lengths, since lengths are squared and flatness is judged twelve orders of magnitude below them.
SMALLEST, LARGEST = 1e-140, 1e140


@guarded
@dataclass(frozen=True, eq=False)
class Polytope(KeepsReadOnly):
    """A bounded convex polytope with an interior.

    Make a polytope with `from_points` or `from_halfspaces`. The shape is exactly the convex hull of the stored
    `vertices`; the faces are derived from the vertices and rounded.

    Attributes
    ----------
    vertices : ndarray, shape (v, n)
        Vertices in metres.
    normals : ndarray, shape (f, n)
        Unit outward normals of the faces; coplanar facets are merged.
    offsets : ndarray, shape (f,)
        The largest product normal·vertex for each face. Up to rounding, the polytope is {x : normals x <= offsets}.
    simplices : ndarray of int, shape (s, n)
        The boundary, cut into simplices, as indices of vertices. For n = 3 these are triangles, counter-clockwise when
        seen from outside.
    face_of_simplex : ndarray of int, shape (s,)
        The face in which each simplex lies.

    Examples
    --------
    >>> square = Polytope.from_points([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]])
    >>> len(square.vertices), len(square.normals)
    (4, 4)
    """

    vertices: Floats
    normals: Floats
    offsets: Floats
    simplices: Ints
    face_of_simplex: Ints

    def __post_init__(self) -> None:
        read_only(self.vertices, self.normals, self.offsets, self.simplices, self.face_of_simplex)

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.vertices.shape[1])

    @classmethod
    def from_points(cls, points: ArrayLike) -> Polytope:
        """Make the convex hull of points.

        Duplicate points, interior points, and points within rounding of a face (about 1e-14 of the width) are dropped.

        Parameters
        ----------
        points : array_like, shape (m, n)
            Points in metres, with m > n >= 2.

        Raises
        ------
        InputError
            If the shape is wrong or entries are not finite.
        MemoryLimitError
            If the coordinates do not fit into memory.
        GeometryError
            If there are fewer than n + 1 points, or the points lie in a space of lower dimension, to within `FLATNESS`.

        References
        ----------
        Barber, Dobkin and Huhdanpaa, The Quickhull algorithm (1996), doi:10.1145/235815.235821.

        Examples
        --------
        >>> Polytope.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        Polytope(4 vertices, 4 faces, n=3)
        """
        return cls(*_hull(_validate.finite_array(points, "points", ("m", "n")), "points"))

    @classmethod
    def from_halfspaces(cls, A: ArrayLike, b: ArrayLike) -> Polytope:
        """Make the intersection of half-spaces {x : A x <= b}, which must be bounded.

        Parameters
        ----------
        A : array_like, shape (m, n)
            Normals of the half-spaces, with n >= 2. Rows may have any length, and redundant rows are allowed.
        b : array_like, shape (m,)

        Raises
        ------
        InputError
            If shapes are wrong or entries are not finite.
        GeometryError
            If the intersection is empty, flat or unbounded.

        Examples
        --------
        >>> A, b = [[1, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 2, 2]
        >>> Polytope.from_halfspaces(A, b)
        Polytope(4 vertices, 4 faces, n=2)
        """
        rows, bounds = check_halfspaces(A, b)
        if rows.shape[1] < 2:
            raise InputError(f"A: expected half-spaces in dimension n >= 2, found shape {rows.shape}")
        x = interior_point(rows, bounds)
        frame, shift = np.empty((rows.shape[1],) * 2), np.empty(rows.shape[1])
        code = entries.center_in(rows, bounds, x, frame, shift, FLATNESS)
        if code != 0:
            raise center_error(code, rows, shift)
        _memory.expect_place(_memory.KERNELS, _memory.SCIPY)
        # In coordinates about the polytope's analytic center that whiten the faces, the facets of the dual polytope
        # correspond to the vertices.
        dual = _qhull((rows @ frame) / (bounds - rows @ x)[:, None], "A, b: no vertices found")
        equations = np.unique(dual[2], axis=0)
        return cls(*_hull(x - (equations[:, :-1] / equations[:, -1:]) @ frame.T, "A, b"))

    def __repr__(self) -> str:
        return f"Polytope({len(self.vertices)} vertices, {len(self.normals)} faces, n={self.dim})"


def heights_about_mean(hull: Polytope) -> tuple[Floats, Floats]:
    """Return the mean of a hull's vertices, and for each face the least height of its vertices above the mean."""
    center = np.add.reduce(hull.vertices, axis=0) / len(hull.vertices)
    normals, vertices = hull.normals[hull.face_of_simplex], hull.vertices[hull.simplices] - center
    heights = dot(normals[:, None], vertices).min(axis=1)
    return center, least_of(heights, hull.face_of_simplex, len(hull.normals))


def check_enough(points: Floats, name: str, least_dim: int = 1, given: Floats | None = None) -> None:
    """Check that there are at least n + 1 points (n with a given center), and that n is a sensible dimension."""
    m, n = points.shape
    if n < least_dim:
        raise InputError(f"{name}: expected points in dimension n >= {least_dim}, found shape {points.shape}")
    least = n + 1 if given is None else n
    if m < least:
        raise GeometryError(f"{name}: expected at least {least} points in dimension {n}, found {m}")
    check_size(max(float(points.max()), -float(points.min())), name)  # avoids a copy of a million points


def check_size(size: float, name: str) -> None:
    """Check that squares of lengths neither overflow nor underflow."""
    if not (size == 0 or SMALLEST <= size <= LARGEST):
        raise InputError(f"{name}: expected sizes between {SMALLEST:g} and {LARGEST:g} m, found {size:g}; rescale")


def writeable(array: NDArray[Any]) -> NDArray[Any]:
    """Return `array`, or a copy if it is read-only, since Numba would compile again for read-only arrays."""
    return array if array.flags.writeable else array.copy()


def flat_error(name: str, points: Floats) -> GeometryError:
    """Describe how flat the points are, and in how many directions they extend.

    The kernels stop at the first direction without a width, although wider directions may follow: a sheet has no width
    in the direction perpendicular to it, which may be tried first. This function therefore finds the directions anew,
    widest first.
    """
    n = points.shape[1]
    offsets = points - points[0]
    length = float(np.abs(offsets).max())
    widths = np.zeros(n)
    if length > 0:
        directions = np.linalg.svd(offsets / length, full_matrices=len(points) < n)[2]
        widths = np.sort(np.ptp(offsets @ directions.T, axis=0))[::-1]
    noise = 2 * n * EPS * float(np.abs(points).max())
    rank = min(int((widths > max(FLATNESS * widths[0], noise)).sum()), n - 1)
    what = {0: "in one place", 1: "on a line", 2: "in a plane"}.get(rank, f"in a flat of dimension {rank}")
    return GeometryError(
        f"{name}: expected points that span all {n} dimensions, found all of them {what}: "
        f"the next width is {widths[rank]:.3g} m against a length of {widths[0]:.3g} m (flat means at most "
        f"{FLATNESS:g} of it, or lost in the rounding of the coordinates)"
    )


def check_halfspaces(A: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    """Check half-spaces, drop empty rows, and scale rows exactly, by powers of two, to lengths of about 1."""
    rows = _validate.finite_array(A, "A", ("m", "n"))
    bounds = _validate.finite_array(b, "b", (len(rows),))
    if rows.shape[1] < 1 or len(rows) < 1:
        raise InputError(f"A: expected at least one half-space in dimension n >= 1, found shape {rows.shape}")
    size = np.abs(rows).max(axis=1)
    nothing = size == 0
    if (bounds[nothing] < 0).any():
        i = int(np.flatnonzero(nothing & (bounds < 0))[0])
        raise GeometryError(f"A, b: empty: row {i} requires 0 <= {bounds[i]:g}")
    scale = -np.frexp(size[~nothing])[1]
    with np.errstate(over="ignore"):  # infinite numbers are reported as too large
        scaled = np.ldexp(bounds[~nothing], scale)
    farthest = float(np.abs(scaled).max(initial=0.0))
    if farthest and not SMALLEST <= farthest <= LARGEST:
        i = np.flatnonzero(~nothing)[np.abs(scaled).argmax()]
        raise InputError(
            f"A, b: expected half-spaces at distances between {SMALLEST:g} and {LARGEST:g} m, found row {i} with "
            f"a largest entry of {size[i]:g} and the bound {bounds[i]:g}; rescale"
        )
    return np.ldexp(rows[~nothing], scale[:, None]), scaled


def interior_point(A: Floats, b: Floats) -> Floats:
    """Find a point that provably satisfies A x < b: the origin, or the point whose least slack is largest.

    A linear program finds the point whose least slack is largest. A solver's tolerance is about 1e-7 relative to the
    whole data, not to each row. The linear program is therefore magnified about its solution and solved again, until
    the slack clearly exceeds rounding (Gleixner, Steffy and Wolter 2016).

    Raises
    ------
    GeometryError
        If the polytope is empty or flat; the message gives the slack that was reached.
    """
    m, n = A.shape
    x = np.zeros(n)
    if (b > 0).all():
        return x
    _memory.expect_place(_memory.KERNELS, _memory.SCIPY)
    from scipy.optimize import linprog

    magnify = 1.0 / (float(np.abs(b).max()) or 1.0)  # a cone or a single point has no scale of its own
    least, noise = -np.inf, 0.0
    for _ in range(4):
        slack = b - A @ x
        answer = linprog(
            np.r_[np.zeros(n), -1.0],
            A_ub=np.c_[A, np.ones(m)],
            b_ub=slack * magnify,
            bounds=[(None, None)] * n + [(None, 1.0)],
            method="highs",
        )
        if answer.x is None:
            raise GeometryError(f"A, b: no interior point found: {answer.message}")
        x = x + answer.x[:n] / magnify
        slack = b - A @ x
        least = float(slack.min())
        noise = float((4 * n * EPS * (np.abs(b) + np.abs(A) @ np.abs(x))).max())
        if least > noise or least < -1e-3 / magnify or least == noise == 0.0:  # the last case is exactly flat
            break
        magnify = min(magnify * 1e6, 1.0 / max(abs(least), noise))
    distance = (b - A @ x) / np.linalg.norm(A, axis=1)
    size = float(np.abs(distance).max())
    if least > max(noise, FLATNESS * size):
        return x
    if least < -max(noise, FLATNESS * size):
        raise GeometryError(f"A, b: empty: every point is outside a half-space, the best one by {-distance.min():.3g}")
    raise GeometryError(
        f"A, b: flat: the innermost point is {distance.min():.3g} from a face; size {size:.3g}, rounding {noise:.3g}"
    )


def center_error(code: int, A: Floats, direction: Floats) -> GeometryError:
    """Make the error if no center was found; for an unbounded polytope, the message names an unbounded direction."""
    if code != codes.UNBOUNDED:
        return GeometryError("A, b: no center found; the half-spaces are too close to flat or unbounded for float64")
    if not direction.any():  # the normals do not span the space; take any vector orthogonal to them
        direction = np.linalg.svd(A)[2][-1]
    way = np.array2string(direction / np.linalg.norm(direction), precision=3, suppress_small=True)
    return GeometryError(f"A, b: unbounded: no half-space limits the direction {way}")


def _hull(points: Floats, name: str) -> tuple[Floats, Floats, Floats, Ints, Ints]:
    """Compute vertices, normals, offsets, simplices and the face of each simplex."""
    _memory.expect_place(_memory.KERNELS, _memory.SCIPY)
    check_enough(points, name, least_dim=2)
    _memory.expect_left(points.nbytes + len(points), f"{name}: hull of {len(points)} points")
    points = writeable(points)
    code, _, _, _, _, frame, coordinates = entries.to_unit_size(points, FLATNESS)
    if code == codes.FLAT:
        raise flat_error(name, points)
    if len(points) >= MANY_POINTS and points.shape[1] == 3:
        left = _not_inside(frame, coordinates)
        points, coordinates = points[left], coordinates[left]
    simplices, neighbors, equations = _qhull(coordinates, f"{name}: no hull found")
    code, worst, used, face_of, normals, offsets = entries.finish_hull(
        points, frame, coordinates, simplices, neighbors, equations
    )
    if code != 0:
        raise GeometryError(f"{name}: {_HULL_FAULTS[code].format(worst=worst)}")
    rename = np.cumsum(used) - 1
    return points[used], normals, offsets, rename[simplices], face_of


def _qhull(coordinates: Floats, fault: str) -> tuple[Ints, Ints, Floats]:
    """Run Qhull for the simplices, their neighbours and their equations; messages begin with `fault`."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(coordinates)
    except QhullError as error:
        reason = str(error).strip().splitlines()[0]
        if "insufficient memory" in str(error):
            raise MemoryError(reason) from None
        raise GeometryError(f"{fault}: {reason}") from None
    return hull.simplices.astype(np.int64), hull.neighbors.astype(np.int64), hull.equations


def _not_inside(frame: Floats, coordinates: Floats) -> Ints | slice:
    """Select 3-D points that may be vertices of the hull of all; the hull of the selection certainly contains the rest.

    The points that are left out lie inside the hull of a sample, {y : a·(y - c) <= 1 for all faces}. A point is left
    out if a·(y - c) is less than 1 - `shrink` for each face. The smallest a·(v - c) over a face's own vertices v is 1,
    so no vertex is left out. By the lemma of docs/containment.md, the hull of the vertices therefore contains the
    omitted point in these coordinates. The coordinates are off by at most 5 u B |y| (u, B: `_kernels.fits.many`), which
    moves a·(y - c) by at most 5 u B |y| / s, where s is the least distance of a face from c. Both the point and the
    vertices move, which uses up 10 u of the 128 u in `shrink`. The first term of `shrink` is far above the rounding of
    the products, which is less than 20 u |y| / s.
    """
    sample_hull = _hull_of_sample(coordinates)
    if sample_hull is None:
        return slice(None)
    center, normals, depths = sample_hull
    size = np.sqrt(3) * max(float(coordinates.max()), -float(coordinates.min()))
    bend = float(np.linalg.norm(np.abs(np.linalg.inv(frame)) @ np.abs(frame)))
    least = float(depths.min())
    if not least > SHALLOW * size:
        return slice(None)
    shrink = SHRINK + 64 * EPS * bend * size / least
    rows = normals / depths[:, None]
    leaves, nodes = entries.direction_map(rows)
    rows, nodes = rows[leaves], nodes.ravel()
    beyond = np.empty(len(coordinates), dtype=bool)
    for first in range(0, len(beyond), POINTS_AT_ONCE):
        last = min(first + POINTS_AT_ONCE, len(beyond))
        entries.mark_beyond(first, last, coordinates, center, rows, nodes, 1 - shrink, beyond)
    return np.flatnonzero(beyond)


def _hull_of_sample(coordinates: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Return the mean of a sample hull's vertices, and the hull's face normals and distances; None if useless.

    The sample includes the extreme points along the axes, so that its hull is not much smaller than the hull of all
    points. The share of all points that lie outside the hull of a random sample nearly equals the share of the sample
    that are vertices of this hull (Efron 1965, doi:10.1093/biomet/52.3-4.331). The sample therefore shows whether
    testing all points is worthwhile.
    """
    m = len(coordinates)
    some = np.random.default_rng(0).integers(0, m, min(max(m // 50, LEAST_SAMPLE), MOST_SAMPLE))
    ends = [at for axis in coordinates.T for at in (axis.argmin(), axis.argmax())]  # axis=0 takes ten times as long
    chosen = np.unique(np.concatenate([some, ends]))
    sample, unit = coordinates[chosen], np.eye(3)
    try:
        simplices, neighbors, equations = _qhull(sample, "no hull of a sample")
    except GeometryError:  # the sample is flat to rounding, but the whole set may not be
        return None
    code, _, used, face_of, normals, _ = entries.finish_hull(sample, unit, sample, simplices, neighbors, equations)
    if code != 0 or used.sum() > WORTHWHILE * len(sample):
        return None
    center = sample[used].mean(axis=0)
    heights = np.einsum("sj,skj->sk", normals[face_of], sample[simplices] - center).min(axis=1)
    return center, normals, least_of(heights, face_of, len(normals))


_HULL_FAULTS = {
    codes.NOT_CLOSED: "the hull does not close up; the points are too close to flat for their rounding",
    codes.FACE_OFF: "a face of the hull misses its own vertices by {worst:.3g} m; the points are too close to flat",
    codes.INSIDE_OUT: "the hull cannot be oriented; the points are too close to flat for their rounding",
}


@dataclass(frozen=True, eq=False)
class Hulls:
    """Many 3-D hulls, packed: hull i has rows start[i]:start[i+1] of an array, where `start` depends on the array.

    Attributes
    ----------
    vert_start, face_start, triangle_start : ndarray of int, shape (P + 1,)
    vertices : ndarray, shape (total vertices, 3)
    normals : ndarray, shape (total faces, 3)
    offsets : ndarray, shape (total faces,)
    triangles : ndarray of int, shape (total triangles, 3)
        Indices into the hull's own vertices, counter-clockwise when seen from outside.
    """

    vert_start: Ints
    vertices: Floats
    face_start: Ints
    normals: Floats
    offsets: Floats
    triangle_start: Ints
    triangles: Ints

    def __len__(self) -> int:
        return len(self.vert_start) - 1

    @classmethod
    def of(cls, polytopes: Sequence[Polytope]) -> Hulls:
        """Pack polytopes in 3-D."""
        return cls._packed([(p.vertices, p.normals, p.offsets, p.simplices) for p in polytopes])

    @classmethod
    def _packed(cls, parts: Sequence[tuple[Floats, Floats, Floats, Ints]]) -> Hulls:
        """Pack vertices, normals, offsets and triangles of each hull."""
        none = np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty((0, 3), dtype=np.int64)
        columns = list(zip(none, *parts, strict=True))
        vertices, normals, offsets, triangles = map(np.concatenate, columns)
        starts = [np.cumsum([len(array) for array in column], dtype=np.int64) for column in columns]
        return cls(starts[0], vertices, starts[1], normals, offsets, starts[3], triangles)


@guarded
def hulls(point_sets: Sequence[Any], progress: Progress | None = None, *, names: Sequence[str] | None = None) -> Hulls:
    """Compute convex hulls of many sets of points in 3-D, packed into flat arrays.

    Parameters
    ----------
    point_sets : sequence of array_like, each of shape (m_i, 3)
        Points in metres.
    progress : callable, optional
        Called as ``progress(done, total)`` from time to time.
    names : sequence of str, optional
        The caller's name for each set, for messages; the default is ``point_sets[i]``.

    Raises
    ------
    InputError, GeometryError
        As for `Polytope.from_points`; the message begins with the name of the set.
    """

    def run(first: int, last: int) -> list[tuple[Floats, Floats, Floats, Ints]]:
        hull_arrays = []
        for i in range(first, last):
            name = f"point_sets[{i}]" if names is None else names[i]
            hull_arrays.append(_hull(_validate.finite_array(point_sets[i], name, (None, 3)), name)[:4])
        return hull_arrays

    shares = in_shares(run, len(point_sets), LEAST_SHARE, most=BLOCK, progress=progress)
    return Hulls._packed(list(chain.from_iterable(shares)))


# Corners of the box with half edge lengths 1, and its faces and triangles as Qhull finds them, in Qhull's order.
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_NORMALS = np.array([[0, 0, -1], [0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
_BOX_TRIANGLES = np.array(
    [
        *([6, 0, 2], [6, 4, 0], [5, 0, 4], [5, 1, 0], [5, 4, 6], [5, 6, 7]),
        *([3, 2, 0], [3, 0, 1], [3, 6, 2], [3, 7, 6], [3, 1, 5], [3, 5, 7]),
    ]
)


def box_hull(half: Floats, name: str) -> Hulls:
    """Make the hull of an axis-aligned box about the origin without Qhull; it equals the result of `hulls`.

    Parameters
    ----------
    half : ndarray, shape (3,)
        Half of each edge length, in metres.
    name : str
        The caller's name for the edges, for messages.

    Raises
    ------
    InputError, GeometryError
        As for `Polytope.from_points` with the corners of the box.
    """
    check_size(float(half.max()), name)
    corners = _CORNERS * half
    edges = 2 * half
    # Repeat the kernel's test of the corners, which compares the edge along each axis with the longest edge so far.
    if not (edges > np.maximum(FLATNESS * np.maximum.accumulate(edges), 6 * EPS * half.max())).all():
        raise flat_error(name, corners)
    return Hulls._packed([(corners, _BOX_NORMALS, np.abs(_BOX_NORMALS) @ half, _BOX_TRIANGLES)])
