"""Run the paper's four detectors, compiled, and tally their answers against the ground truth.

Use detector 3 (level surfaces) for the paper's estimate, since it also works well on shapes other than the paper's.
Detector 4 (center lines) does not generalise: near contact, it misses a quarter of the collisions of tetrahedra, nearly
half of the collisions of thin rods, and over two thirds of the collisions of thin plates. Detector 1 is the earlier
method, and serves only as the baseline.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns
from loewner._kernels.tolerances import PAPER_ANGLE
from loewner._native import entries
from loewner.bodies import Bodies, packed_of
from loewner.ellipsoids.ellipsoid_pairs import contact_function
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.errors import InputError, UnknownNameError

DETECTORS = {
    1: "earlier method, with polyhedra",
    2: "Lin-Han near points",
    3: "level-surface near points",
    4: "center-line near points",
}
HEURISTICS = ("centroid", "center")
SHORTEST_TIMING = 0.05  # seconds; shorter runs are repeated, because the clock's resolution is limited


@dataclass(frozen=True)
class Confusion:
    """A detector's answers, tallied against the ground truth; "positive" means a collision.

    The paper prints these counts as ((tp, fp), (fn, tn)), with the detector in rows and the truth in columns.

    Attributes
    ----------
    tp, fp, fn, tn : int
        Numbers of detected collisions (tp), false alarms (fp), missed collisions (fn), and free pairs called free (tn).

    Examples
    --------
    >>> from loewner import paper
    >>> paper.Confusion.of(np.array([True, True, False]), np.array([True, False, False]))
    Confusion(tp=1, fp=1, fn=0, tn=1)
    """

    tp: int
    fp: int
    fn: int
    tn: int

    @classmethod
    def of(cls, collides: Bools, truth: Bools) -> Confusion:
        """Tally a detector's answers against the ground truth.

        Parameters
        ----------
        collides, truth : ndarray of bool, shape (n,)

        Raises
        ------
        InputError
            If the lengths differ, or the arrays are not boolean.
        """
        collides, truth = _truths(collides, "collides"), _truths(truth, "truth")
        if collides.shape != truth.shape:
            raise InputError(f"truth: expected shape {collides.shape}, as collides, found {truth.shape}")
        cells = collides & truth, collides & ~truth, ~collides & truth, ~collides & ~truth
        return cls(*(int(cell.sum()) for cell in cells))

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """The counts as a tuple (tp, fp, fn, tn)."""
        return self.tp, self.fp, self.fn, self.tn

    @property
    def total(self) -> int:
        """Number of pairs counted."""
        return sum(self.counts)

    @property
    def accuracy(self) -> float:
        """Share of answers that are right; NaN if there are no pairs."""
        return (self.tp + self.tn) / self.total if self.total else math.nan


def _truths(x: Any, name: str) -> Bools:
    array = _validate.plain_array(x, name)
    if array.dtype != np.bool_ or array.ndim != 1:
        raise InputError(
            f"{name}: expected booleans of shape (n,), found {array.dtype} of shape {_validate.shape_text(array.shape)}"
        )
    return array


@dataclass(frozen=True)
class Faces:
    """The packed half-spaces {x : normals x <= offsets} of n polytopes.

    Attributes
    ----------
    normals : ndarray, shape (f, 3)
    offsets : ndarray, shape (f,)
    start : ndarray of int, shape (n + 1,)
        Polytope k has the rows start[k] : start[k + 1].
    """

    normals: Floats
    offsets: Floats
    start: Ints

    def __getitem__(self, index: NDArray[np.intp]) -> Faces:
        count = np.diff(self.start)[index]
        start = np.concatenate([[0], np.cumsum(count)])
        rows = np.arange(start[-1]) + np.repeat(self.start[index] - start[:-1], count)
        return Faces(self.normals[rows], self.offsets[rows], start)


@dataclass(frozen=True)
class Pairs:
    """The detectors' input for n pairs, all in one frame.

    Attributes
    ----------
    inner_1, outer_1, inner_2, outer_2 : Ellipsoids, batch (n,)
    heuristic_1, heuristic_2 : Ellipsoids, batch (n,)
        The inner ellipsoids of detector 1.
    faces_1, faces_2 : Faces

    Examples
    --------
    >>> from loewner import Bodies, Body, paper
    >>> cubes = Bodies([Body.box([1, 1, 1])] * 2)
    >>> len(paper.Pairs.from_bodies(cubes, cubes))
    2
    """

    inner_1: Ellipsoids
    outer_1: Ellipsoids
    inner_2: Ellipsoids
    outer_2: Ellipsoids
    heuristic_1: Ellipsoids
    heuristic_2: Ellipsoids
    faces_1: Faces
    faces_2: Faces

    def __len__(self) -> int:
        return len(self.inner_1)

    @classmethod
    def from_bodies(cls, a: Bodies, b: Bodies, heuristic: str = "centroid") -> Pairs:
        """Pair body k of `a` with body k of `b`; each body is a single convex polytope.

        Parameters
        ----------
        a, b : Bodies
            Sequences of equal length.
        heuristic : {"centroid", "center"}
            Center of the shrunk outer ellipsoid of detector 1: the mean of the vertices, or the center of the outer
            ellipsoid.

        Raises
        ------
        InputError
            If the sequences differ in length, or a body is not a single convex polytope.
        UnknownNameError
            If the heuristic is unknown.
        """
        _validate.choice(heuristic, "heuristic", HEURISTICS)
        for name, bodies in (("a", a), ("b", b)):
            _validate.instance(bodies, name, Bodies)
        if len(a) != len(b):
            raise InputError(f"bodies: expected equally many on both sides, found {len(a)} and {len(b)}")
        faces_1, points_1 = _unpacked(a)
        faces_2, points_2 = _unpacked(b)
        center_1, center_2 = (points_1, points_2) if heuristic == "centroid" else (a.outer.center, b.outer.center)
        heuristic_1, heuristic_2 = shrunk(a.outer, faces_1, center_1), shrunk(b.outer, faces_2, center_2)
        return cls(a.inner, a.outer, b.inner, b.outer, heuristic_1, heuristic_2, faces_1, faces_2)

    def take(self, index: Any) -> Pairs:
        """Select pairs by an index array, in the order of this array.

        Parameters
        ----------
        index : array_like of int, shape (k,)

        Returns
        -------
        Pairs

        Raises
        ------
        InputError
            If an index is out of range, or `index` does not have the shape (k,).
        """
        index = _validate.integer_array(index, "index")
        if index.ndim != 1 or (index.size and not (index.min() >= 0 and index.max() < len(self))):
            raise InputError(
                f"index: expected pairs from 0 to {len(self) - 1}, shape (k,), found {_validate.short(index)}"
            )
        return Pairs(*(getattr(self, field.name)[index] for field in fields(self)))


@dataclass(frozen=True)
class Answers:
    """A detector's answers for n pairs.

    Attributes
    ----------
    collides : ndarray of bool, shape (n,)
    ambiguous : ndarray of bool, shape (n,)
        Pairs that neither of the detector's two overlap checks decides.

    Examples
    --------
    >>> from loewner import Bodies, Body, paper
    >>> cube = Bodies([Body.box([1, 1, 1])])
    >>> paper.estimate(paper.Pairs.from_bodies(cube, cube))
    Answers(collides=array([ True]), ambiguous=array([False]))
    """

    collides: Bools
    ambiguous: Bools


def detect(detector: int, pairs: Pairs, *, angle: float = PAPER_ANGLE) -> Answers:
    """Run one of the four detectors, on one thread.

    Parameters
    ----------
    detector : {1, 2, 3, 4}
    pairs : Pairs
    angle : float
        Tolerance, in radians, of Lin and Han's method, which only detector 2 uses.

    Returns
    -------
    Answers

    Raises
    ------
    InputError
        If `pairs` is not a `paper.Pairs`, or the angle is not a number above zero; UnknownNameError if the detector is
        unknown.

    Examples
    --------
    >>> from loewner import paper
    >>> found = paper.run(50)
    >>> answers = paper.detect(3, found.pairs)
    >>> bool((answers.collides == found.truth)[~answers.ambiguous].all())
    True
    """
    n = len(_validate.instance(pairs, "pairs", Pairs, "loewner.paper"))
    collides, ambiguous = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
    _bound(detector, pairs, angle, collides, ambiguous)()
    return Answers(collides.astype(bool), ambiguous.astype(bool))


def time_per_check(detector: int, pairs: Pairs, *, angle: float = PAPER_ANGLE) -> float:
    """Measure the average time of one check in microseconds, on one thread, with all code compiled beforehand.

    The result is the median of at least three passes over the pairs. With fewer than about a hundred pairs, the call
    itself takes a noticeable share of the time.
    """
    n = len(_validate.instance(pairs, "pairs", Pairs, "loewner.paper"))
    if n == 0:
        return float("nan")
    call = _bound(detector, pairs, angle, np.zeros(n, np.uint8), np.zeros(n, np.uint8))
    seconds: list[float] = []
    end = time.perf_counter() + SHORTEST_TIMING
    while len(seconds) < 3 or time.perf_counter() < end:
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds)) / n * 1e6


def estimate(pairs: Pairs) -> Answers:
    """Apply the library's rule, F_in F_out <= 1, to the pairs that the two exact overlap checks do not decide.

    Parameters
    ----------
    pairs : Pairs

    Returns
    -------
    Answers

    Examples
    --------
    >>> from loewner import paper
    >>> found = paper.run(50)
    >>> bool((paper.estimate(found.pairs).collides == found.estimate.answers.collides).all())
    True
    """
    _validate.instance(pairs, "pairs", Pairs, "loewner.paper")
    F_inner = contact_function(pairs.inner_1, pairs.inner_2)
    F_outer = contact_function(pairs.outer_1, pairs.outer_2)
    ambiguous = (F_outer <= 1.0) & (F_inner > 1.0)
    return Answers((F_inner <= 1.0) | (ambiguous & (F_inner * F_outer <= 1.0)), ambiguous)


def shrunk(outer: Ellipsoids, faces: Faces, center: Floats) -> Ellipsoids:
    """Make detector 1's heuristic inner ellipsoids: outer ellipsoids moved to `center` and shrunk to touch a face.

    Parameters
    ----------
    outer : Ellipsoids, batch (n,)
    faces : Faces
    center : ndarray, shape (n, 3)
        Points inside the polytopes.
    """
    body = np.repeat(np.arange(len(center)), np.diff(faces.start))
    slack = faces.offsets - (faces.normals * center[body]).sum(axis=1)
    width = np.linalg.norm(np.einsum("kij,ki->kj", outer.factor[body], faces.normals), axis=1)
    scale = np.minimum.reduceat(slack / width, faces.start[:-1])
    return Ellipsoids(center, scale[:, None, None] * outer.factor)


def _bound(detector: int, pairs: Pairs, angle: float, collides: object, ambiguous: object) -> Callable[[], None]:
    """Bind a kernel to its arrays."""
    if isinstance(detector, bool) or not isinstance(detector, (int, np.integer)) or int(detector) not in DETECTORS:
        allowed, actual = ", ".join(map(str, DETECTORS)), _validate.short(detector)
        raise UnknownNameError(f"detector: expected one of {allowed}, found {actual}")
    angle = _validate.positive_scalar(angle, "angle")
    inner_1, inner_2 = (pairs.heuristic_1, pairs.heuristic_2) if detector == 1 else (pairs.inner_1, pairs.inner_2)
    ellipsoids = inner_1, pairs.outer_1, inner_2, pairs.outer_2
    arguments: list[Any] = [np.stack([E.center for E in ellipsoids]), np.stack([E.factor for E in ellipsoids])]
    if detector == 1:
        for faces in (pairs.faces_1, pairs.faces_2):
            arguments += [np.column_stack([faces.normals, faces.offsets]), faces.start]
    if detector == 2:
        arguments += [angle]
    kernel = getattr(entries, f"detector_{detector}")
    return lambda: kernel(*arguments, collides, ambiguous)


def _unpacked(bodies: Bodies) -> tuple[Faces, Floats]:
    """Return the faces of bodies that are single polytopes, and the mean of each body's vertices."""
    packed = packed_of(bodies)
    layout = packed.layout
    single = (np.diff(packed.piece_start) == 1) & (layout[packed.piece_start[:-1], columns.KIND] == columns.POLYTOPE)
    if not single.all():
        k = int(np.flatnonzero(~single)[0])
        raise InputError(f"bodies[{k}]: expected one convex polytope, found {bodies[k]!r}")
    start = np.append(layout[:, columns.PLANES_FROM], len(packed.planes))
    vertices = np.diff(np.append(layout[:, columns.POINTS_FROM], len(packed.points)))
    mean = np.add.reduceat(packed.points, layout[:, columns.POINTS_FROM], axis=0) / vertices[:, None]
    faces = Faces(np.ascontiguousarray(packed.planes[:, :3]), np.ascontiguousarray(packed.planes[:, 3]), start)
    return faces, mean
