"""Prove motions that begin or end in contact, as the rules of `Scene.leave` and `Scene.reach` allow.

Two convex pieces that touch are separated, or nearly separated, by the plane perpendicular to their contact normal. If
this plane is moved back by their depth and by the tolerance, one piece lies in front of it. As long as that piece stays
in front, the two do not penetrate each other deeper than at the start. The space behind the plane is treated as a body,
so the proof of motions also settles whether the piece stays in front; see docs/certified.md, "Contact that has to end".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner import queries
from loewner._kernels import codes, columns
from loewner._validate import Floats, Ints
from loewner.bodies import Bodies, Body, bodies_of, packed_of
from loewner.bodies.layout import starts
from loewner.bodies.pack import some
from loewner.robots import motions
from loewner.robots.problem import Problem

# Lengths of the first stretch that are tried, as shares of the motion: the longest on which the contact recedes is
# used.
STRETCHES = 2.0 ** -np.arange(16)

# Values at the end of a stretch deviate from the motion by less than this share: `motion_path` rounds by 7 units.
OFF = 32 * 2.0**-53

# Distances below this share of the robot's reach have no reliable normal.
LEAST_SHARE = 1e-6

# Relative error allowed for the distance to a wall: ten times the error that `distance` guarantees.
FAR_ROUNDINGS = 1e-8

# Share of the tolerance that remains for the proof; the plane is moved back by the rest.
FOR_PROOF = 0.25

# Pieces that are apart by less than this share of the robot's reach count as touching: `distance` is accurate to a
# thousandth of it. Pieces farther apart must keep their margin.
TOUCHING = 1e-9


def settle(ready: Problem, pair: int, a: Floats, b: Floats, tolerance: float) -> tuple[int, float]:
    """Settle a motion for one pair that may be in contact at the motion's start or end.

    Parameters
    ----------
    ready : Problem
    pair : int
        Index of the pair, for which `ready.leaving` or `ready.reaching` is true.
    a, b : ndarray, shape (dof,)
        The start and the end of the straight motion.
    tolerance : float
        Distance in metres by which the contact may get deeper.

    Returns
    -------
    verdict : int
        FREE; COLLIDING if the two get deeper into each other than allowed; else AMBIGUOUS.
    fraction : float
        Fraction of the motion; NaN if FREE.
    """
    middle = ready.robot.between(a, b, 0.5)
    # Stretches from the end where contact is allowed, with the fractions of the motion at which they begin and end. The
    # depth of a contact at the start of a motion is a fact; at its end it is a choice.
    stretches = {
        (True, False): [(a, b, 0.0, 1.0, np.inf)],
        (False, True): [(b, a, 1.0, 0.0, tolerance)],
        (True, True): [(a, middle, 0.0, 0.5, np.inf), (b, middle, 1.0, 0.5, tolerance)],
    }
    for first, last, low, high, deepest in stretches[bool(ready.leaving[pair]), bool(ready.reaching[pair])]:
        doubtful, least = _leaves(ready, pair, first, last, tolerance, deepest)
        if doubtful:
            fractions = [low + (high - low) * share for share in doubtful]
            distances = [distance_at(ready, pair, ready.robot.between(a, b, fraction)) for fraction in fractions]
            worst = int(np.argmin(distances))
            verdict = codes.COLLIDING if distances[worst] <= least else codes.AMBIGUOUS
            return int(verdict), fractions[worst]
    return codes.FREE, np.nan


def deeper_than_ends(ready: Problem, path: Floats, rows: Ints, tolerance: float) -> tuple[int, int] | None:
    """Find the first row of a path at which a pair is in deeper contact than its rules allow, and the pair.

    On each motion of a path a contact may get deeper by the tolerance, but not by more along the whole path.
    """
    for pair in ready.ruled.tolist():
        allowed = float(ready.margins[pair])
        if ready.leaving[pair]:
            allowed = min(allowed, distance_at(ready, pair, path[0]))
        if ready.reaching[pair]:
            allowed = min(allowed, distance_at(ready, pair, path[-1]))
        for row in rows.tolist():
            if distance_at(ready, pair, path[row]) < allowed - tolerance:
                return row, pair
    return None


def _leaves(
    ready: Problem, pair: int, a: Floats, b: Floats, tolerance: float, deepest: float
) -> tuple[list[float], float]:
    """Find fractions at which a motion may not be free for a pair that may start in contact, and a critical distance.

    The critical distance is the pair's margin or its distance at the start. If the signed distance at a fraction is no
    larger, the pair collides there.
    """
    off = OFF * np.maximum(np.maximum(np.abs(a), np.abs(b)), 1.0)[None]
    alone = ready.only(np.array([pair]))
    margin, at_start = float(ready.margins[pair]), distance_at(ready, pair, a)
    found = motions.settle(alone, np.stack([a, b])[None], FOR_PROOF * tolerance, off)
    if found.verdicts[0] == codes.FREE:
        return [], margin
    if at_start > margin + tolerance:  # no contact to end
        return [float(found.fractions[0])], margin
    if at_start < -deepest:
        return [0.0], -deepest
    least = at_start - tolerance if at_start <= margin + TOUCHING * _reach(ready, pair, a, b) else margin
    (beside, for_proof), doubtful = _beside_planes(ready, pair, a, b, tolerance), []
    for share in STRETCHES.tolist():
        middle = b if share == 1.0 else ready.robot.between(a, b, share)
        found = motions.settle(beside, np.stack([a, middle])[None], for_proof, off)
        if found.verdicts[0] == codes.FREE:
            break
        doubtful.append(share * float(found.fractions[0]))
    else:
        return doubtful, least
    if share < 1.0:
        found = motions.settle(alone, np.stack([middle, b])[None], FOR_PROOF * tolerance, off)
    if found.verdicts[0] == codes.FREE:
        return [], margin
    return [*doubtful, share + (1.0 - share) * float(found.fractions[0])], least


def distance_at(ready: Problem, pair: int, q: Floats) -> float:
    """Compute the signed distance of a pair of bodies at a configuration."""
    i, j = (int(k) for k in ready.pairs[pair])
    T = ready.poses(q[None])[0]
    return float(queries.distance(ready.body(i), T[i], ready.body(j), T[j], exact=True).distance)


def _reach(ready: Problem, pair: int, a: Floats, b: Floats) -> float:
    """Bound how far points of the robot get from the second body of a pair during a motion."""
    T = ready.poses(a[None])[0, ready.pairs[pair, 1]]
    return float(ready.motions.tables.chain[1] + np.maximum(np.abs(a), np.abs(b)).sum() + np.abs(T[:3, 3]).sum())


class _Touched(NamedTuple):
    """The pieces of two bodies, the pairs of them that are apart or touch at a configuration, and contact normals.

    Attributes
    ----------
    ours, theirs : Bodies
        A body of each piece of the first and of the second body.
    apart, planes : ndarray of int64, shape (pairs, 2)
        Pairs of pieces that are apart, and pairs that touch.
    distances : ndarray
        Signed distances of the pairs that touch.
    normals : ndarray, shape (planes, 3)
        Unit vectors in the frame of the second body, which point to the first one.
    """

    ours: Bodies
    theirs: Bodies
    apart: Ints
    planes: Ints
    distances: Floats
    normals: Floats


def contact_normals(ready: Problem, pair: int, Q: Floats, tolerance: float) -> Floats:
    """Find normals of the pieces that touch at the first of some configurations; the others follow on the motion.

    Returns
    -------
    ndarray, shape (planes, 3)
        In the frame of the second body; unit vectors that point to the first body.
    """
    return _touched(ready, pair, ready.poses(Q), _reach(ready, pair, Q[0], Q[-1]), tolerance).normals


def _touched(ready: Problem, pair: int, T: Floats, reach: float, tolerance: float) -> _Touched:
    """Find the pieces that touch at the first of some poses of all bodies, and their normals there or later."""
    i, j = (int(k) for k in ready.pairs[pair])
    ours, theirs = _pieces(ready, i), _pieces(ready, j)
    every = np.moveaxis(np.indices((len(ours), len(theirs))), 0, -1).reshape(-1, 2)
    at_start = queries.distance(ours, T[0, i], theirs, T[0, j], exact=True, pairs=every).distance
    touching = at_start <= float(ready.margins[pair]) + tolerance
    apart, planes = every[~touching], every[touching]
    # Two pieces that just touch have no computable normal; slightly later on the motion, or slightly moved apart, they
    # have one. Any normal is safe, since the proof fails with a bad one.
    u, v = planes.T
    found = queries.distance(ours[u], T[:, None, i], theirs[v], T[:, None, j], exact=True)
    when, nth = (np.abs(found.distance) > LEAST_SHARE * reach).argmax(axis=0), np.arange(len(planes))
    moved = np.tile(T[0, i], (len(planes), 1, 1))
    moved[:, :3, 3] -= LEAST_SHARE * reach * found.normal[0]
    apart_by_little = queries.distance(ours[u], moved, theirs[v], T[0, j], exact=True).normal
    # In the frame of the second body, which carries the planes.
    R = T[when, j, :3, :3]
    normals = -np.einsum("kri,kr->ki", R, np.where((when > 0)[:, None], found.normal[when, nth], apart_by_little))
    return _Touched(ours, theirs, apart, planes, at_start[touching], normals)


def _beside_planes(ready: Problem, pair: int, a: Floats, b: Floats, tolerance: float) -> tuple[Problem, float]:
    """Pair the pieces of the first body with planes in front of which they begin, in place of the touched pieces.

    Also return the tolerance for the proof that they stay in front. The plane of touching pieces leaves most of the
    tolerance; the plane of separate pieces leaves only their margin.
    """
    i, j = (int(k) for k in ready.pairs[pair])
    shares = np.append(0.0, STRETCHES[::-1])
    margin, T = float(ready.margins[pair]), ready.poses(ready.robot.between(a, b, shares))
    reach = _reach(ready, pair, a, b)
    ours, theirs, apart, planes, distances, normals = _touched(ready, pair, T, reach, tolerance)
    # How far the piece reaches along the normal, whatever that is: from its distance to a wall beyond it.
    far = 2 * float(packed_of(theirs).kernel.table[:, columns.REACH].max())
    walls = Bodies([Body.half_space(-n, -far, extent=8 * far) for n in normals])
    reached = far * (1 + FAR_ROUNDINGS) - queries.distance(theirs[planes[:, 1]], None, walls, None, exact=True).distance
    gap = distances - margin
    back = np.where(gap > TOUCHING * reach, gap, (1 - FOR_PROOF) * tolerance)
    offsets = reached + distances - back
    # The space behind a plane is represented by a cube that reaches farther than the robot.
    behind = [Body.half_space(n, offset, extent=8 * reach) for n, offset in zip(normals, offsets, strict=True)]
    bodies = [*(ours[k] for k in range(len(ours))), *(theirs[k] for k in range(len(theirs))), *behind]
    first = len(ours)
    second = np.concatenate([first + apart[:, 1], first + len(theirs) + np.arange(len(planes))])
    pairs = np.column_stack([np.concatenate([apart[:, 0], planes[:, 0]]), second]).astype(np.int64)
    count = len(bodies) - first
    moves = j < len(ready.link)
    link = np.concatenate([np.full(first, ready.link[i]), np.full(count * moves, ready.link[j if moves else i])])
    no_rule = np.zeros(len(pairs), dtype=bool)
    made = Problem.of(
        ready.robot, (ready.version, ready.structure_version), tuple(map(str, range(len(bodies)))),
        [packed_of(body) for body in bodies], link.astype(np.int64), pairs,
        np.where(np.arange(len(pairs)) < len(apart), margin, 0.0), no_rule, no_rule,
    )  # fmt: skip
    for_proof = float(back.min(initial=tolerance)) * FOR_PROOF / (1 - FOR_PROOF)
    return made.with_poses(np.tile(T[0, j], (0 if moves else count, 1, 1)), ready.version), for_proof


def _pieces(ready: Problem, body: int) -> Bodies:
    """Make a body of each piece of a body."""
    packed = ready.packed
    at: Ints = np.arange(packed.piece_start[body], packed.piece_start[body + 1])
    return bodies_of(some(packed, at, starts(np.ones(len(at), dtype=np.int64))).packed())
