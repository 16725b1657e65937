"""How a robot's links move with its configuration, and what a force on a link does to the joints.

Each value of a configuration moves links by a twist: the velocity of what is at the world's origin, and an angular
velocity, both in the world's axes. Forces go the other way: the power of a wrench (a force, and its moment about the
world's origin) along a twist is what the value changes by.

References
----------
Lynch and Park, Modern Robotics (2017), chapter 5: space Jacobians and wrenches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loewner._kernels import columns
from loewner._kernels.records import Tree
from loewner._validate import Bools, Floats, Ints

# How a value of a configuration moves a link: about an axis of the link, along a direction of what it hangs on, or by
# an entry of a quaternion.
TURNS, SLIDES, QUATERNION = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Joints:
    """What each value of a joint does; those that mimic another joint share its value.

    Attributes
    ----------
    kind, link, parent, column : ndarray of int64, shape (K,)
        How it moves, which link, what that hangs on (-1: the world), and which value of the configuration it is.
    direction : ndarray, shape (K, 3)
        Of unit length but for the joint's multiplier: in the link's frame of what turns, else in the parent's.
    moves : ndarray of bool, shape (L + 1, K)
        Which links each moves; the last row is of what stands in the world.
    sums : ndarray, shape (K, dof)
        1 where a value of the configuration is the joint's, else 0.
    frame : dict of int to ndarray, shape (3, 3)
        For quaternions, by link: the axes that they turn in, in the parent's frame.
    """

    kind: Ints
    link: Ints
    parent: Ints
    column: Ints
    direction: Floats
    moves: Bools
    sums: Floats
    frame: dict[int, Floats]

    @classmethod
    def of(cls, tree: Tree, dof: int) -> Joints:
        """Look up what the joints of a robot do."""
        rows: list[tuple[int, int, int, Floats]] = []  # kind, link, column, direction
        frame = {}
        for link, what in enumerate(tree.kind):
            constants, first, times = tree.constants[link], int(tree.column[link]), float(tree.multiplier[link])
            across, along = (constants[k : k + 3] for k in (columns.ACROSS, columns.ALONG))
            if what == columns.REVOLUTE:
                rows.append((TURNS, link, first, times * _axis(constants)))
            elif what == columns.PRISMATIC:
                rows.append((SLIDES, link, first, times * across))
            elif what == columns.PLANAR:
                rows += [(SLIDES, link, first, across), (SLIDES, link, first + 1, along)]
                rows.append((TURNS, link, first + 2, _axis(constants)))
            elif what == columns.FLOATING:
                frame[link] = constants[columns.ROTATION : columns.ROTATION + 9].reshape(3, 3)
                rows += [(SLIDES, link, first + k, frame[link][:, k]) for k in range(3)]
                rows += [(QUATERNION, link, first + 3 + k, np.zeros(3)) for k in range(4)]
        kinds, links, values = np.array([row[:3] for row in rows], dtype=np.int64).reshape(-1, 3).T
        moves = np.zeros((len(tree.parent) + 1, len(rows)), dtype=bool)
        for number, above in enumerate(tree.parent):
            if above >= 0:
                moves[number] = moves[above]
            moves[number] |= links == number
        direction = np.array([row[3] for row in rows]).reshape(-1, 3)
        sums = (values[:, None] == np.arange(dof)).astype(float)
        return cls(kinds, links, np.asarray(tree.parent)[links], values, direction, moves, sums, frame)

    def twists(self, Q: Floats, T: Floats) -> Floats:
        """Twists of all values, shape (N, K, 6), at configurations (N, dof) with links at T, shape (N, L, 4, 4)."""
        found = np.zeros((len(Q), len(self.kind), 6))
        turns, slides = np.flatnonzero(self.kind == TURNS), np.flatnonzero(self.kind == SLIDES)
        at = T[:, self.link[turns], :3]
        axis = (at[..., :3] @ self.direction[turns][:, :, None])[..., 0]
        found[:, turns, :3], found[:, turns, 3:] = np.cross(at[..., 3], axis), axis
        if len(slides):
            # Of what hangs on the world the last link's pose is read, and not used.
            parent = self.parent[slides]
            frames = np.where((parent >= 0)[:, None, None], T[:, parent, :3, :3], np.eye(3))
            found[:, slides, :3] = (frames @ self.direction[slides][:, :, None])[..., 0]
        for link, frame in self.frame.items():
            k = np.flatnonzero((self.link == link) & (self.kind == QUATERNION))
            above = int(self.parent[k[0]])
            axes = T[:, above, :3, :3] @ frame if above >= 0 else frame
            axis = np.swapaxes(axes @ _quaternion_turns(Q[:, self.column[k]]), 1, 2)
            found[:, k, :3], found[:, k, 3:] = np.cross(T[:, link, None, :3, 3], axis), axis
        return found


def _axis(constants: Floats) -> Floats:
    """Axis of a turning joint in the frame of what it moves: that of the derivative of its rotation at 0."""
    zero = constants[columns.ROTATION : columns.ROTATION + 9] + constants[columns.COSINE : columns.COSINE + 9]
    W = zero.reshape(3, 3).T @ constants[columns.SINE : columns.SINE + 9].reshape(3, 3)
    return np.array([W[2, 1], W[0, 2], W[1, 0]])


def _quaternion_turns(q: Floats) -> Floats:
    """Angular velocities by the four entries of quaternions, shape (N, 3, 4).

    Of any length, since only the direction counts: 2 vec(dq q*) / |q|².
    """
    w, v = q[:, 0], q[:, 1:]
    turns = np.empty((len(q), 3, 4))
    turns[:, :, 0] = -v
    for k, unit in enumerate(np.eye(3)):
        turns[:, :, 1 + k] = w[:, None] * unit + np.cross(v, unit)
    turns *= (2 / np.sum(q * q, axis=1))[:, None, None]
    return turns
