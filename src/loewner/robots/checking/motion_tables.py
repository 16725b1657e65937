"""Describe the joints between the world and each link, for the proofs of motions.

The kernel `loewner._kernels.robots.standing` computes how far bodies are from these joints.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from loewner._base import _matrices
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns, tolerances
from loewner._kernels.records import Tree
from loewner.bodies import Packed
from loewner.robots.description.robot import Robot

# An allowance for rounding, and for the stretching by poses of a base or a body that are accepted as rigid.
STRETCH = 1 + 8 * tolerances.ROTATION_TOLERANCE

# Pairs in a group.
LANES = 8

# Cosines of eighths of a turn, at which a joint's rotation is compared with an orthonormal one. The difference is a sum
# of waves of up to twice the angle, and its maximum is less than twice the largest of eight samples.
DIAGONAL = math.sqrt(0.5)
COSINES = np.array([1.0, DIAGONAL, 0.0, -DIAGONAL, -1.0, -DIAGONAL, 0.0, DIAGONAL])


class Chains(NamedTuple):
    """What proofs of motions take of a robot alone.

    Attributes
    ----------
    path_start, path_link : ndarray of int64
        See `records.MotionTables`.
    lengths : ndarray, shape (L,)
        Lengths of the chains of links, from the world's origin to the origin of each link.
    bend : float
        Bound on the departure of all rotations together from orthonormality.
    """

    path_start: Ints
    path_link: Ints
    lengths: Floats
    bend: float

    def depth(self, link: Ints) -> Ints:
        """Count the joints between the world and links."""
        return np.asarray(np.diff(self.path_start)[link])

    def chain(self, packed: Packed, link: Ints) -> Floats:
        """Describe the longest chain up to the points of bodies on links; see `records.MotionTables`."""
        start = packed.piece_start[: len(link) + 1]
        reaches = packed.kernel.table[: start[-1], columns.REACH]
        far = np.maximum.reduceat(reaches, start[:-1]) if len(link) else reaches
        longest = float((self.lengths[link] + far).max(initial=0.0)) * STRETCH
        return np.array([1 + self.depth(link).max(initial=0), longest, self.bend])


_known: WeakKeyDictionary[Robot, Chains] = WeakKeyDictionary()


def chains_of(robot: Robot) -> Chains:
    """Describe a robot's chains of links, once."""
    known = _known.get(robot)
    if known is None:
        known = _known[robot] = Chains(*_paths(robot.tree), _lengths(robot.tree), _bend(robot.tree))
    return known


def pairs_in_groups(moving: int, pairs: Ints) -> tuple[Ints, Ints]:
    """Put the pairs with static bodies in groups of eight: `group_start`, `group_pairs` of `records.MotionTables`."""
    at = np.flatnonzero(pairs[:, 1] >= moving)
    at = at[np.argsort(pairs[at, 0], kind="stable")]
    counts = np.bincount(pairs[at, 0], minlength=moving)
    ends, groups = np.cumsum(counts), -(-counts // LANES)
    start = np.cumsum([0, *groups])
    body = np.repeat(np.arange(moving), LANES * groups)
    number = np.arange(LANES * start[-1]) - LANES * start[body] + (ends - counts)[body]
    return start, at[np.minimum(number, ends[body] - 1)]


def _paths(tree: Tree) -> tuple[Ints, Ints]:
    """List the joints between the world and each link, in the form of `records.MotionTables`."""
    paths: list[list[int]] = []
    for link, (above, kind) in enumerate(zip(tree.parent.tolist(), tree.kind.tolist(), strict=True)):
        paths.append((paths[above] if above >= 0 else []) + ([link] if kind != columns.FIXED else []))
    start = np.cumsum([0, *map(len, paths)])
    return start.astype(np.int64), np.array([k for path in paths for k in path], dtype=np.int64)


def _lengths(tree: Tree) -> Floats:
    lengths = _matrices.lengths(tree.constants[:, columns.TRANSLATION : columns.TRANSLATION + 3])
    for k, above in enumerate(tree.parent):
        lengths[k] += lengths[above] if above >= 0 else 0.0
    return np.asarray(lengths)


def _bend(tree: Tree) -> float:
    """Bound, from the joints' constants, how far the product of all rotations departs from orthonormality.

    Sums have the order that they have in C (`bend_of`), so that both give the same bits.
    """
    turns = np.isin(tree.kind, (columns.REVOLUTE, columns.PLANAR))[:, None]
    sine = np.where(turns, np.roll(COSINES, 2), 0.0)
    cosine = np.where(turns, COSINES, 1.0)
    fixed, with_sine, with_cosine = (
        tree.constants[:, first : first + 9].T[..., None] for first in (columns.ROTATION, columns.SINE, columns.COSINE)
    )
    R = fixed + sine * with_sine + cosine * with_cosine
    squares = np.zeros(sine.shape)
    for a, b in itertools.product(range(3), range(3)):
        off = R[a] * R[b] + R[3 + a] * R[3 + b] + R[6 + a] * R[6 + b] - (a == b)
        squares += off * off
    total = 0.0
    for worst in np.sqrt(squares).max(axis=1).tolist():
        total += 2 * worst
    return total
