"""Find the pairs that meet among many bodies, first by boxes and then by verdicts, and compute their depths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._threads import get_num_threads, in_shares
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes, columns
from loewner._native import entries
from loewner.bodies import Bodies, Body, Packed, packed_of
from loewner.errors import ConvergenceError, InputError, PoseError
from loewner.queries._measure import EXACT_BYTES, measure
from loewner.queries._settle import Operands, settle

# The smallest number of bodies that is worth a thread of its own.
CHUNK = 4096

# Candidate pairs are settled once there are at least this many. The last group of boxes may add up to WIDE pairs per
# body.
CANDIDATES = 65536

# Bytes per body: two corners of its box, its keys and sorted keys, its place in the order, and its share of the groups'
# boxes.
BODY_BYTES = 128

# Bytes per returned pair: its key, copies of the key when all keys are concatenated, and two returned numbers.
PAIR_BYTES = 40

# Additional bytes per measured pair: a copy of its row numbers, and its distance.
DEPTH_BYTES = 16 + EXACT_BYTES

# A tree: its groups of boxes, the start of each level, and the order of the bodies on the lowest level.
Tree: TypeAlias = tuple[Floats, Ints, Ints]

MODES = {"exact": codes.EXACT, "certified": codes.CERTIFY}


@dataclass(frozen=True, eq=False, repr=False)
class Overlaps(_validate.Brief):
    """The pairs of bodies that meet, and their distances or depths, with one entry per pair.

    Distances, witnesses and normals are the same as from `distance` with ``exact=True``.

    Attributes
    ----------
    pairs : ndarray of int64, shape (m, 2)
        Indices i < j of the bodies, in lexicographic order.
    distance : ndarray, shape (m,)
        Distance in metres. A negative value is a depth; for bodies with several pieces, it is the depth of the two
        pieces that overlap most deeply, as in `Distance`. The value is positive for bodies that are apart but within
        the margin. For bodies that just touch, rounding may make it slightly positive.
    witness_a, witness_b : ndarray, shape (m, 3)
        Points of bodies i and j in world coordinates, such that witness_b - witness_a = distance * normal.
    normal : ndarray, shape (m, 3)
        Unit vectors from i to j; moving body j along the vector separates the two pieces fastest.

    Examples
    --------
    >>> from loewner import Bodies, overlapping_pairs
    >>> T = np.tile(np.eye(4), (3, 1, 1))
    >>> T[:, 0, 3] = [0.0, 1.0, 5.0]
    >>> found = overlapping_pairs(Bodies.spheres([1.0, 0.5, 3.0]), T, depth=True)
    >>> len(found), found.pairs, found.distance, found.normal
    (1, array([[0, 1]]), array([-0.5]), array([[1., 0., 0.]]))
    """

    pairs: Ints
    distance: Floats
    witness_a: Floats
    witness_b: Floats
    normal: Floats

    def __len__(self) -> int:
        return len(self.pairs)


# fmt: off
@overload
def overlapping_pairs(
    bodies: Body | Bodies, T_world: ArrayLike | None = ..., *,
    margin: float = ..., method: str = ..., depth: Literal[False] = ...,
) -> Ints: ...
@overload
def overlapping_pairs(
    bodies: Body | Bodies, T_world: ArrayLike | None = ..., *,
    margin: float = ..., method: str = ..., depth: Literal[True],
) -> Overlaps: ...
@overload
def overlapping_pairs(
    bodies: Body | Bodies, T_world: ArrayLike | None = ..., *,
    margin: float = ..., method: str = ..., depth: bool,
) -> Ints | Overlaps: ...
# fmt: on
@guarded
def overlapping_pairs(
    bodies: Body | Bodies,
    T_world: ArrayLike | None = None,
    *,
    margin: float = 0.0,
    method: str = "exact",
    depth: bool = False,
) -> Ints | Overlaps:
    """Find all pairs of bodies that touch, overlap, or come within `margin` of each other.

    Time and memory grow with the number of bodies and with the number of returned pairs, not with the number of all
    pairs.

    Parameters
    ----------
    bodies : Bodies, or Body
        n bodies, or one body that is placed at each of n poses.
    T_world : array_like, shape (n, 4, 4), or None
        Poses of the bodies, with translations in metres; None is the identity for all bodies.
    margin : float
        Distance in metres up to which bodies count as colliding.
    method : {"exact", "certified"}
        "exact" finds the pairs for which `collide` is true. "certified" finds the pairs that neither boxes nor
        ellipsoids prove free, that is, all colliding pairs and some ambiguous pairs; `classify` distinguishes the two.
    depth : bool
        Whether to compute the distance or depth, normal and witnesses of each pair as well.

    Returns
    -------
    ndarray of int64, shape (m, 2), or Overlaps
        Indices i < j of the bodies, each pair once, in lexicographic order. All other pairs are proven free. With
        ``depth=True``, an `Overlaps` whose `pairs` are this array.

    Raises
    ------
    PoseError
        If the number of poses differs from the number of bodies, or a pose is not a rigid motion.
    InputError
        If `bodies` has entries that are not bodies, the margin is negative or not finite, or ``depth`` is neither True
        nor False.
    UnknownNameError
        If `method` is not one of the names above.
    ConvergenceError
        If the exact search could not settle a pair; such a pair is never reported as free. With ``depth=True``, also if
        a distance could not be computed, as in `distance`. In the latter case, the error's `indices` are rows of the
        list of pairs, and its `partial` has all other results.

    Examples
    --------
    >>> from loewner import Bodies, overlapping_pairs
    >>> T = np.tile(np.eye(4), (3, 1, 1))
    >>> T[:, 0, 3] = [0.0, 1.0, 5.0]
    >>> overlapping_pairs(Bodies.spheres([1.0, 0.5, 3.0]), T)
    array([[0, 1]])
    """
    mode = MODES[_validate.choice(method, "method", MODES)]
    keep = _validate.positive_scalar(margin, "margin", zero=True)
    measured = _validate.flag(depth, "depth")
    crowd = _prepare(bodies, T_world)
    pairs = _met(mode, keep, crowd)
    return _measured(pairs, crowd) if measured else pairs


class _Crowd(NamedTuple):
    """Bodies at poses.

    `n` is the number of bodies. `steps` has two numbers, 1 or 0: whether each body has its own pieces, and whether each
    has its own pose.
    """

    n: int
    steps: tuple[int, int]
    packed: Packed
    T: Floats

    def asked(self, rows: Ints) -> Operands:
        """Make the operands for listed pairs; both operands are the bodies of the crowd."""
        plan = np.array([rows.shape[1], *self.steps, *self.steps], dtype=np.int64)[:, None]
        return plan, rows, self.packed.handle, self.T, self.packed.handle, self.T


def _met(mode: int, margin: float, crowd: _Crowd) -> Ints:
    """List, in lexicographic order, the pairs of bodies that are not proven free."""
    n = crowd.n
    if n < 2:
        return np.empty((0, 2), dtype=np.int64)
    threads = min(get_num_threads(), -(-n // CHUNK))
    _validate.fits_memory(
        BODY_BYTES * n + threads * 16 * (columns.WIDE * n + CANDIDATES), f"candidate pairs of {n} bodies"
    )
    tree = _tree(crowd)
    counts: list[int] = []  # numbers of pairs found so far

    def settled(first: int, last: int) -> Ints:
        return _settled(mode, margin, first, last, tree, crowd, counts)

    leaves = -(-n // columns.WIDE)
    keys = np.concatenate(in_shares(settled, leaves, CHUNK // columns.WIDE))
    keys.sort()
    return np.stack(np.divmod(keys, n), axis=1)


def _measured(pairs: Ints, crowd: _Crowd) -> Overlaps:
    """Measure the distances of pairs; the poses have already been checked."""
    count = len(pairs)
    _validate.fits_memory(DEPTH_BYTES * count, f"distances of {count} pairs")
    measures = measure(True, count, crowd.asked(np.ascontiguousarray(pairs.T)))
    overlaps = Overlaps(pairs, measures.distance, measures.witness_a, measures.witness_b, measures.normal)
    indices = np.flatnonzero(measures.unsettled)
    if len(indices):
        raise ConvergenceError(
            f"overlapping_pairs: the distances of {len(indices)} of {count} pairs could not be settled, the first of "
            f"them {tuple(pairs[indices[0]].tolist())} (the error's `indices` name the rows, its `partial` has the "
            "distances of all others)",
            indices,
            overlaps,
        )
    return overlaps


def _prepare(bodies: Body | Bodies, T_world: ArrayLike | None) -> _Crowd:
    """Check bodies and poses."""
    if not isinstance(bodies, (Body, Bodies)):
        raise InputError(f"bodies: expected loewner.Bodies or loewner.Body, found {type(bodies).__name__}")
    T = _validate.poses(T_world, "T_world")
    if T_world is not None and T.ndim != 3:
        raise PoseError(f"T_world: expected shape (n, 4, 4), found {_validate.shape_text(T.shape)}")
    T = T.reshape(-1, 4, 4)
    n = len(bodies) if isinstance(bodies, Bodies) else len(T)
    if T_world is not None and len(T) != n:
        raise PoseError(f"T_world: expected one pose for each of {n} bodies, found {len(T)}")
    steps = int(isinstance(bodies, Bodies)), int(T_world is not None)
    return _Crowd(n, steps, packed_of(bodies), T)


def _tree(crowd: _Crowd) -> Tree:
    """Group the boxes of bodies in a tree."""
    lower, upper = np.empty((2, crowd.n, 3))

    def box(first: int, last: int) -> None:
        entries.body_boxes(first, last, *crowd.steps, crowd.packed.handle, crowd.T, lower, upper)

    in_shares(box, crowd.n, CHUNK)
    order = entries.curve_order(lower, upper)
    return (*entries.box_tree(lower, upper, order), order)


def _settled(mode: int, margin: float, first: int, last: int, tree: Tree, crowd: _Crowd, counts: list[int]) -> Ints:
    """List the pairs that are not proven free and whose earlier body is in the leaf groups from `first` to `last`.

    The pair of bodies i and j is encoded as i n + j. The number of pairs is appended to `counts`, which all threads
    share.
    """
    n = crowd.n
    rows = np.empty((2, columns.WIDE * n + CANDIDATES), dtype=np.int64)
    encoded_pairs: list[Ints] = []
    leaf = first
    while leaf < last:
        leaf, count = entries.meeting_boxes(leaf, last, margin, *tree, rows[0], rows[1])
        if count == 0:
            continue
        listed = rows[:, :count].copy()
        a, b = listed
        out = np.empty(count, dtype=np.int8)
        if settle(mode, margin, 0, count, crowd.asked(listed), out) is None:
            _validate.rigid_motions(crowd.T, "T_world")
            raise PoseError("T_world: expected rigid motions, found poses that changed during the call")
        if mode == codes.EXACT:
            _refuse_unsettled(out, a, b)
        kept = out != codes.FREE
        encoded_pairs.append(a[kept] * n + b[kept])
        counts.append(len(encoded_pairs[-1]))
        total = sum(counts)
        _validate.fits_memory(PAIR_BYTES * total, f"more than {total} pairs of {n} bodies")
    return np.concatenate([np.empty(0, dtype=np.int64), *encoded_pairs])


def _refuse_unsettled(out: NDArray[np.int8], a: Ints, b: Ints) -> None:
    """Raise an error, instead of guessing, if arithmetic could not settle a pair."""
    unsettled = np.flatnonzero(out == codes.AMBIGUOUS)
    if len(unsettled):
        pair = int(a[unsettled[0]]), int(b[unsettled[0]])
        raise ConvergenceError(
            f"overlapping_pairs: {len(unsettled)} pairs could not be settled, the first of them {pair}; treat them as "
            'colliding, or ask for method="certified"'
        )
