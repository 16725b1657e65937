"""Bound how far a link strays from a straight line between two configurations; docs/certified.md derives it (B55)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._kernels import columns
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._validate import Bools, Floats, Ints
from loewner.errors import InputError
from loewner.robots import Robot
from loewner.robots.reaching import Chain
from loewner.robots.robot import link_poses

# Rounding of a computed deviation, for each joint, times the lengths and one plus the square of the turns.
LINE_ROUNDINGS = 256.0 * UNIT_ROUNDOFF  # derived 180, certified.md B55

SPARE = 1e-9  # relative; covers the rounding of third derivatives and of lengths, docs/certified.md

MIDDLE = 0.125  # the largest value of s (1 - s) / 2: a curve's distance from its chord, over its second derivative


class Turns(NamedTuple):
    """Single joints from the root to a link, in order; a planar joint counts as three.

    Attributes
    ----------
    frames : ndarray of int64, shape (J,)
        For a joint that turns the entry of the chain's path that it moves, for one that slides the entry before it.
    axes : ndarray, shape (J, 3)
        In these frames; entry -1 is the world.
    turning : ndarray, shape (J,)
        1 for joints that turn, 0 for those that slide.
    columns : ndarray of int64, shape (J,)
        Columns of configurations.
    multipliers : ndarray, shape (J,)
    after : ndarray of bool, shape (J, L)
        Which links of the chain come after the joint's own.
    """

    frames: Ints
    axes: Floats
    turning: Floats
    columns: Ints
    multipliers: Floats
    after: Bools

    @classmethod
    def of(cls, chain: Chain, link: str) -> Turns:
        """List the joints that may move; floating and ball joints may not, for they do not move along straight lines.

        Raises
        ------
        InputError
            If a floating or ball joint is to move.
        """
        rows: list[tuple[int, Floats, float, int, float, int]] = []
        for k, (moves, kind, at) in enumerate(chain.links.tolist()):
            if not moves:
                continue
            c = chain.constants[k]
            axis, across, along = (c[first : first + 3] for first in (columns.AXIS, columns.ACROSS, columns.ALONG))
            column, factor = int(chain.columns[at]), float(c[columns.MULTIPLIER])
            if kind == columns.REVOLUTE:
                rows.append((k, axis, 1.0, column, factor, k))
            elif kind == columns.PRISMATIC:
                rows.append((k - 1, across, 0.0, column, factor, k))
            elif kind == columns.PLANAR:
                rows += [(k - 1, across, 0.0, column, 1.0, k), (k - 1, along, 0.0, column + 1, 1.0, k)]
                rows.append((k, axis, 1.0, column + 2, 1.0, k))
            else:
                raise InputError(
                    f"joints: expected joints that turn or slide before {link!r}, found a floating or ball joint; name "
                    "the joints that are to move"
                )
        frames, axes, turning, places, factors, links = zip(*rows, strict=True)
        after = np.arange(len(chain.path)) > np.array(links)[:, None]
        return cls(
            np.array(frames), np.array(axes), np.array(turning), np.array(places), np.array(factors), after
        )  # fmt: skip


class Line(NamedTuple):
    """A line of poses: the position moves along a straight line, and the rotation turns about a fixed axis.

    Attributes
    ----------
    start, way : ndarray, shape (3,)
        The position at the fraction u is start + u way.
    rotation : ndarray, shape (3, 3)
        At the fraction 0.
    angle : float
    sine, cosine : ndarray, shape (3, 3)
        The rotation at the fraction u is rotation + sin(u angle) sine + (1 - cos(u angle)) cosine.
    """

    start: Floats
    way: Floats
    rotation: Floats
    angle: float
    sine: Floats
    cosine: Floats

    @classmethod
    def between(cls, T0: Floats, T1: Floats) -> Line:
        """Make the line between two poses; the angle is at most half a turn."""
        axis, angle = axis_and_angle(T1[:3, :3] @ T0[:3, :3].T)
        K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
        sine = K @ T0[:3, :3]
        return cls(T0[:3, 3], T1[:3, 3] - T0[:3, 3], T0[:3, :3], angle, sine, K @ sine)

    def poses(self, u: Floats) -> Floats:
        """Compute the poses at fractions, shape (n, 4, 4)."""
        angles = (self.angle * u)[:, None, None]
        T = np.zeros((len(u), 4, 4))
        T[:, :3, :3] = self.rotation + np.sin(angles) * self.sine + 2 * np.sin(angles / 2) ** 2 * self.cosine
        T[:, :3, 3] = self.start + u[:, None] * self.way
        T[:, 3, 3] = 1.0
        return T


def _cross(a: Floats, b: Floats) -> Floats:
    """The products a × b; NumPy's function takes several times as long."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def axis_and_angle(R: Floats) -> tuple[Floats, float]:
    """Compute the axis and the angle, from 0 to π, of a rotation, by its quaternion."""
    squares = np.array([np.trace(R), *R.diagonal()])
    k = int(squares.argmax())
    if k == 0:
        q = np.array([1 + squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q = np.zeros(4)
        q[0], q[1 + i] = R[m, j] - R[j, m], 1 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j], q[1 + m] = R[j, i] + R[i, j], R[m, i] + R[i, m]
    q = -q if q[0] < 0 else q
    length = float(np.linalg.norm(q[1:]))
    if length == 0:
        return np.array([0.0, 0.0, 1.0]), 0.0
    return q[1:] / length, 2 * float(np.arctan2(length, q[0]))


class Strays(NamedTuple):
    """Bounds for motions: metres, the Frobenius norm of the rotation's error, and what a direction of the link moves.

    Attributes
    ----------
    positions, rotations : ndarray, shape (n,)
        Largest deviations from the line at any real fraction of each motion.
    leasts : ndarray, shape (n,)
        Lower bounds on the product of the kept axis of the link and its direction in the world; 1 if there is none.
    cosines : ndarray, shape (n + 1,)
        This product at the configurations.
    bends, twists : ndarray, shape (2, n)
        The parts of the deviations that fall with the square, and those that fall with the cube of a motion's length.
    """

    positions: Floats
    rotations: Floats
    leasts: Floats
    cosines: Floats
    bends: Floats
    twists: Floats


def strays(
    robot: Robot,
    chain: Chain,
    turns: Turns,
    line: Line,
    u: Floats,
    Q: Floats,
    number: int,
    kept: tuple[Floats, Floats] | None,
) -> Strays:
    """Bound how far a link strays from the line on the motions between successive configurations.

    Parameters
    ----------
    robot : Robot
    chain : Chain
    turns : Turns
    line : Line
    u : ndarray, shape (n + 1,)
        Fractions of the line that belong to the configurations.
    Q : ndarray, shape (n + 1, dof)
    number : int
        Of the link.
    kept : pair of ndarray, shape (3,), optional
        An axis of the link, and the direction in the world near which it must stay.
    """
    n = len(Q) - 1
    poses = link_poses(robot, np.concatenate([Q, 0.5 * (Q[:-1] + Q[1:])]))
    ends, targets = poses[: n + 1, number], line.poses(np.concatenate([u, 0.5 * (u[:-1] + u[1:])]))
    off = np.linalg.norm(ends[:, :3, 3] - targets[: n + 1, :3, 3], axis=1)
    turned = np.linalg.norm(ends[:, :3, :3] - targets[: n + 1, :3, :3], axis=(1, 2))
    # Second derivatives in the middle, where C is what the joints before each one turn together.
    middle = poses[n + 1 :]
    frames = np.concatenate([middle[:, chain.path], np.broadcast_to(np.eye(4), (n, 1, 4, 4))], axis=1)
    here = frames[:, turns.frames]
    z = (here[:, :, :3, :3] * turns.axes[:, None]).sum(axis=-1)
    p, R = middle[:, number, :3, 3], middle[:, number, :3, :3]
    v = np.where(turns.turning[:, None] > 0, _cross(z, p[:, None] - here[:, :, :3, 3]), z)
    d = (Q[1:] - Q[:-1])[:, turns.columns] * turns.multipliers
    b = (turns.turning * d)[:, :, None] * z
    a = 2 * (np.cumsum(b, axis=1) - b) + b
    second = np.linalg.norm((d[:, :, None] * _cross(a, v)).sum(axis=1), axis=1)
    M = b.swapaxes(1, 2) @ a - (a * b).sum(axis=(1, 2))[:, None, None] * np.eye(3)
    bent, share = M @ R, line.angle * (u[1:] - u[:-1])
    target_bent = (line.rotation + line.cosine) - targets[n + 1 :, :3, :3]  # per squared angle
    second_turn = np.linalg.norm(bent - (share**2)[:, None, None] * target_bent, axis=(1, 2))
    # Third derivatives anywhere: each turn before a joint moves its derivative by no more than its length.
    size = np.abs(d)
    angle = turns.turning * size
    before = np.cumsum(angle, axis=1) - angle
    total = angle.sum(axis=1)
    reach, length = _lengths(chain, turns, Q)
    third = np.where(turns.turning > 0, reach * ((before + size) ** 3 - before**3), 3 * size * before**2).sum(axis=1)
    third_turn = np.sqrt(2.0) * (total**3 + share**3)
    rounding = LINE_ROUNDINGS * (len(chain.path) + 1) * (1 + total**2) * max(1.0, float(np.abs(Q).max()))
    bends, twists = MIDDLE * np.stack([second, second_turn]), 0.5 * (1 + SPARE) * MIDDLE * np.stack([third, third_turn])
    positions = np.maximum(off[:-1], off[1:]) + bends[0] + twists[0] + rounding * length
    rotations = np.maximum(turned[:-1], turned[1:]) + bends[1] + twists[1] + rounding
    leasts, cosines = np.ones(n), np.ones(n + 1)
    if kept is not None:
        axis, direction = kept
        cosines = ends[:, :3, :3] @ axis @ direction
        curved = np.abs(bent @ axis @ direction) + 0.5 * (1 + SPARE) * total**3
        leasts = np.minimum(cosines[:-1], cosines[1:]) - MIDDLE * curved - rounding
    return Strays(positions, rotations, leasts, cosines, bends, twists)


def _lengths(chain: Chain, turns: Turns, Q: Floats) -> tuple[Floats, float]:
    """How far the link can be from the axis of each joint, shape (J,), and all lengths of the chain together."""
    links = np.linalg.norm(chain.constants[:, columns.TRANSLATION : columns.TRANSLATION + 3], axis=1)
    for k, (_, kind, at) in enumerate(chain.links.tolist()):
        if kind in (columns.PRISMATIC, columns.PLANAR, columns.FLOATING):
            wide = {columns.PRISMATIC: 1, columns.PLANAR: 2, columns.FLOATING: 3}[kind]
            values = Q[:, chain.columns[at : at + wide]]
            factor, offset = chain.constants[k, columns.MULTIPLIER], chain.constants[k, columns.OFFSET]
            links[k] += np.abs(values * factor + offset).max(axis=0).sum()
    return (1 + SPARE) * (turns.after @ links), (1 + SPARE) * float(links.sum())
