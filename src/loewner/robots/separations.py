"""Find planes that separate all pairs of bodies along motions: the trees of a proof, see docs/proof-format.md.

The search proceeds by levels of the trees, and handles all open intervals of a level, of all motions and pairs,
together. It uses no result of the kernel that proved the motions.
"""

from __future__ import annotations

import struct
from itertools import pairwise
from math import comb
from typing import Any, NamedTuple

import numpy as np

from loewner._kernels import columns, records
from loewner._measure import measure
from loewner._native import entries
from loewner._rotations import rotations_of
from loewner._validate import Bools, Floats, Ints
from loewner.bodies import Packed
from loewner.errors import ConvergenceError
from loewner.robots.problem import Problem
from loewner.robots.proof_models import BALL, CYLINDER, HULL, PAIR, SLIDES, STAYS, TURNS, Model
from loewner.robots.robot import Robot, link_poses

# Tokens of the trees.
HALVED, FIRST_DIVIDED, SECOND_DIVIDED, SAME, AXES, NORMAL, DOUBLES = 0, 1, 2, 3, 4, 16, 18

# Trees get no deeper, so that intervals have few digits; checkers allow 64.
DEEPEST = 40

# Room for checkers that compute with enclosures: as a share of the lengths on the right, and of the model's size.
SHARE, ROOM = 1.0 + 2e-9, 2e-11

# Normals are whole numbers up to this one, at one of some scales, since rounding turns a normal. On deep levels, and
# between bodies that do not move, they are also tried as they are, in doubles.
LARGEST, SCALES, DEEP = 32767, 3, 10

# Boxes are compared first, and must be apart by this much of the model's size: poses may bend a little.
BOX_ROOM = 4e-6

# Trees, and motions, that are proven at a time.
AT_ONCE, MOTIONS_AT_ONCE = 2**15, 2**10

# Open intervals at a time, besides sixteen for each tree: with more of them, the search would not end.
MOST_OPEN = 2**16

# Candidates among the axes that are tried after the boxes.
BEST_AXES = 3


class Clusters(NamedTuple):
    """Consecutive pieces of bodies, as trees may divide them.

    Attributes
    ----------
    of_body : ndarray of int64
        The cluster of all pieces of each body.
    first, last : ndarray of int64
        The first piece, and the one after the last.
    left, right : ndarray of int64
        Its two halves; -1 if it is a single piece.
    center, half : ndarray, shape (3, C)
        A box around it along the axes of the body: its center in the frame of the link, and half of its edges.
    points : ndarray, shape (V, 4)
        Corners of hulls in the frame of the link, and the radius about each.
    begin, end : ndarray of int64
        The cluster's rows in `points`.
    curved : list of lists of _Curved
        Its other pieces.
    balls : ndarray, shape (bodies, 4)
        Centers and radii of the balls around bodies, as the format defines them.
    """

    of_body: Ints
    first: Ints
    last: Ints
    left: Ints
    right: Ints
    center: Floats
    half: Floats
    points: Floats
    begin: Ints
    end: Ints
    curved: list[list[_Curved]]
    balls: Floats


class Bends(NamedTuple):
    """A and V of the format: arrays of shape (motions, pairs, 2), with either body as the lower one."""

    curvature: Floats
    deviation: Floats


class Tasks(NamedTuple):
    """Open intervals: numbers of motion, pair, both clusters and node, and the interval."""

    motion: Ints
    pair: Ints
    a: Ints
    b: Ints
    node: Ints
    low: Floats
    high: Floats

    def at(self, chosen: Any) -> Tasks:
        """Select some."""
        return Tasks(*(array[chosen] for array in self))


class Placed(NamedTuple):
    """Poses of the links of both bodies at both ends: arrays of shapes (3, 3, 2, 2, T) and (3, 2, 2, T)."""

    turn: Floats
    shift: Floats

    def at(self, chosen: Any) -> Placed:
        """Select some tasks."""
        return Placed(self.turn[..., chosen], self.shift[..., chosen])


class Planes(NamedTuple):
    """Candidates, or planes that were found: the side whose body is the lower one, and normals."""

    side: Ints
    normal: Floats


def trees(ready: Problem, model: Model, courses: Floats, deviations: Floats) -> bytes:
    """Make the trees of all motions and pairs, in order.

    Raises
    ------
    ConvergenceError
        If planes that the format can express do not prove a pair to be apart.
    """
    cut = ready.in_parts
    search = _Search(cut.names, cut.packed, model, deviations, ready.robot)
    step = min(max(1, AT_ONCE // max(1, len(model.pairs))), MOTIONS_AT_ONCE)
    return b"".join(search.of(courses[k : k + step], k) for k in range(0, len(courses), step))


def still(packed: Packed, model: Model, room: float) -> bytes:
    """Make the tree of two bodies that do not move, with a gap that exceeds the margin by `room` of all lengths.

    Raises
    ------
    ConvergenceError
        As for `trees`.
    """
    none = np.empty((1, 2, 0))
    return written(none[0, 0], none) + _Search(PAIR, packed, model, none[0, 0], room=room).of(none, 0)


class _Search:
    """The search for the trees of some motions; `named` is the plane that was named last for each pair."""

    def __init__(
        self, names: tuple[str, ...], packed: Packed, model: Model, deviations: Floats, robot: Robot | None = None,
        room: float = ROOM,
    ) -> None:  # fmt: skip
        self.names, self.robot, self.model, self.deviations, self.room = names, robot, model, deviations, room
        self.clusters = clusters_of(model)
        self.chains = _Chains(model, self.clusters.balls, deviations)
        self.named = np.full((len(model.pairs), 4), -1.0)
        self.recent = np.zeros((len(model.pairs), 4))
        links = np.append(model.links.of_robot, -1)[model.link]  # behind the robot's links, the world
        self.turn = np.ascontiguousarray(model.turn.transpose(1, 2, 0))
        self.kernel, self.cut = _kernel(packed, model), bool(packed.trees)
        self.count = 0 if robot is None else len(robot.link_names)
        self.link = np.where(links < 0, self.count, links)

    def of(self, courses: Floats, first: int) -> bytes:
        """Make the trees of some motions, from number `first` on."""
        motions, pairs = len(courses), len(self.model.pairs)
        self.courses, self.first = courses, first
        self.bends, self.size = self.chains.bends(courses)
        m, p = (array.ravel() for array in np.indices((motions, pairs)))
        a, b = self.clusters.of_body[self.model.pairs[p]].T
        open_ = Tasks(m, p, a, b, np.arange(len(m)), np.zeros(len(m)), np.ones(len(m)))
        token, normal = np.zeros(len(m), dtype=np.int64), np.zeros((len(m), 3))
        child = np.full(len(m), -1, dtype=np.int64)
        owner, count, begins = p, len(m), [0]
        for depth in range(DEEPEST + 1):
            if not len(open_.node):
                break
            if depth == DEEPEST or len(open_.node) > MOST_OPEN + 16 * len(m):
                self._fail(open_, 0)
            found, planes, divide = self._level(open_, depth)
            at = open_.node[found]
            token[at], normal[at] = planes.side, planes.normal
            rest = open_.at(~found)
            token[rest.node] = divide
            child[rest.node] = count + 2 * np.arange(len(rest.node))
            open_ = self._halves(rest, divide, count)
            begins.append(count)
            count += len(open_.node)
            token, child = (np.append(array, np.full(len(open_.node), -1)) for array in (token, child))
            normal = np.append(normal, np.zeros((len(open_.node), 3)), axis=0)
            owner = np.append(owner, open_.pair)
        return self._written(token, normal, child, owner, motions * pairs, [*begins, count])

    # -- levels -------------------------------------------------------------------------------

    def _level(self, tasks: Tasks, depth: int) -> tuple[Bools, Planes, Ints]:
        """Find planes for some of the tasks.

        Returns
        -------
        found : ndarray of bool
        planes : Planes
            For those found; instead of a side, the token.
        divide : ndarray of int64
            For the others, how they are divided.
        """
        total = len(tasks.node)
        placed = self._poses(tasks)
        need = self.bends.deviation[tasks.motion, tasks.pair]
        need = need + self.bends.curvature[tasks.motion, tasks.pair] * ((tasks.high - tasks.low) ** 2 / 8)[:, None]
        need = SHARE * (self.model.margins[tasks.pair][:, None] + need)
        token, normal = np.full(total, -1), np.zeros((total, 3))
        scores = self._boxes(tasks, placed, need)
        best = scores.argmax(axis=0)
        sure = scores[best, np.arange(total)] > BOX_ROOM * self.size
        token[sure] = AXES + best[sure]
        at = np.flatnonzero(~sure)
        divide = np.zeros(total, dtype=np.int64)
        if len(at):
            token[at], normal[at], divide[at] = self._search(
                tasks.at(at), placed.at(at), need[at], scores[:, at], depth
            )
        found = token >= 0
        return found, Planes(token[found], normal[found]), divide[~found]

    def _search(
        self, tasks: Tasks, placed: Placed, need: Floats, scores: Floats, depth: int
    ) -> tuple[Ints, Floats, Ints]:  # fmt: skip
        """Look for planes of tasks that boxes do not settle.

        Returns
        -------
        token : ndarray of int64
            -1 for those without a plane.
        normal : ndarray, shape (T, 3)
        divide : ndarray of int64
            How those without a plane are divided.
        """
        # The best axes, and the plane that was found last for this pair.
        order = np.argsort(-scores, axis=0)[:BEST_AXES]
        recent = self.recent[tasks.pair]
        sides = np.append(order // 6, recent[None, :, 0].astype(np.int64), axis=0)
        tried = Planes(sides, np.append(_AXES[order], recent[None, :, 1:], axis=0))
        token, normal, spare = self._tried(tasks, placed, need, tried)
        axis = token >= 0
        axis[axis] = token[axis] < BEST_AXES
        token = np.where(axis, AXES + order[np.minimum(token, BEST_AXES - 1), np.arange(len(token))], token)
        again = (token >= 0) & ~axis
        token[again] = _tokens(recent[again, 0], normal[again])
        divide = np.zeros(len(token), dtype=np.int64)
        open_ = np.flatnonzero(token < 0)
        if len(open_) == 0:
            return token, normal, divide
        some, placed, need, spare = tasks.at(open_), placed.at(open_), need[open_], spare[:, open_]
        distance, normals = self._distances(some, placed)
        least = self.model.margins[some.pair] + self.bends.deviation[some.motion, some.pair].min(axis=1)
        counts = np.stack([(self.clusters.last - self.clusters.first)[c] for c in (some.a, some.b)])
        near = np.flatnonzero((distance > need.min(axis=1) + self.room * self.size).all(axis=0))
        if len(near):
            chosen, placed = some.at(near), placed.at(near)
            tried = self._normals(chosen, placed, normals[..., near], depth)
            which, own, more = self._tried(chosen, placed, need[near], tried)
            spare[:, near] = np.fmax(spare[:, near], more)
            good = which >= 0
            at = open_[near[good]]
            side = tried.side[which[good], good]
            token[at], normal[at] = _tokens(side, own[good]), own[good]
            self.recent[chosen.pair[good]] = np.column_stack([side, own[good]])
        # Halving does not help where the bodies are too near at one end, by their distance or by precise normals.
        sunk = (distance < least - BOX_ROOM * self.size).any(axis=0)
        deep = depth >= DEEP or self.robot is None
        if deep:
            sunk |= (distance < least + self.room * self.size).any(axis=0)
            sunk[near] |= ((spare <= self.room * self.size).any(axis=0) & (counts == 1).all(axis=0))[near]
        for k in np.flatnonzero(sunk & (token[open_] < 0))[:1]:
            self._fail(some, k)
        # Pieces that no plane separates, although they are apart, are divided.
        stuck = ((spare <= self.room * self.size).any(axis=0) | deep) & (counts.max(axis=0) > 1)
        divide[open_] = np.where(stuck, np.where(counts[0] >= counts[1], FIRST_DIVIDED, SECOND_DIVIDED), HALVED)
        return token, normal, divide

    def _tried(self, tasks: Tasks, placed: Placed, need: Floats, tried: Planes) -> tuple[Ints, Floats, Floats]:
        """Return for each task the number of the first candidate that proves it, or -1; its normal; and by how much the
        gaps of all candidates exceed margin and deviations at either end, at most, shape (2, T)."""
        length = np.linalg.norm(tried.normal, axis=2)
        gaps = self._gaps(tasks, placed, tried) / np.maximum(length, 1e-300)
        gaps[:, length == 0] = -np.inf
        each = np.arange(len(need))
        held = gaps.min(axis=0) > need[each, tried.side] + self.room * self.size
        which = np.where(held.any(axis=0), held.argmax(axis=0), -1)
        gaps -= self.model.margins[tasks.pair] + self.bends.deviation[tasks.motion, tasks.pair][each, tried.side]
        return which, tried.normal[which, each], gaps.max(axis=1)

    def _halves(self, tasks: Tasks, divide: Ints, count: int) -> Tasks:
        """Make the two halves of each task, one after the other."""
        middle = (tasks.low + tasks.high) / 2
        twice = tasks.at(np.repeat(np.arange(len(tasks.node)), 2))
        second = np.tile([False, True], len(tasks.node))
        kind = np.repeat(divide, 2)
        low = np.where((kind == HALVED) & second, np.repeat(middle, 2), twice.low)
        high = np.where((kind == HALVED) & ~second, np.repeat(middle, 2), twice.high)
        halves = [np.where(second, self.clusters.right[c], self.clusters.left[c]) for c in (twice.a, twice.b)]
        a = np.where(kind == FIRST_DIVIDED, halves[0], twice.a)
        b = np.where(kind == SECOND_DIVIDED, halves[1], twice.b)
        return Tasks(twice.motion, twice.pair, a, b, count + np.arange(len(a)), low, high)

    def _fail(self, tasks: Tasks, k: int) -> None:
        if self.robot is None:
            why = "the hulls of parts of a surface or a cloud are nearer" if self.cut else "their gap is too small"
            raise ConvergenceError(f"proof: expected planes between the bodies, which are apart, found none: {why}")
        a, b = (self.names[n] for n in self.model.pairs[tasks.pair[k]])
        why = "they come nearer than the room for rounding that proofs leave"
        if self.deviations.any():
            why = "its bound on joint errors is coarser than that of certify_edges; lower joint_error"
        raise ConvergenceError(
            f"proof: expected planes between {a} and {b} all along motion {self.first + tasks.motion[k]}, found none "
            f"from the fraction {tasks.low[k]:.6g} to {tasks.high[k]:.6g} that a proof can hold, although the motion "
            f"is free: {why}"
        )

    # -- geometry -----------------------------------------------------------------------------

    def _poses(self, tasks: Tasks) -> Placed:
        """Return the world poses of the links of both bodies at both ends."""
        times = np.stack([tasks.low, tasks.high])
        known, where = np.unique(tasks.motion + times / 2, return_inverse=True)  # fractions have few digits
        number = np.minimum(known.astype(np.int64), len(self.courses) - 1)
        t = (2 * (known - number))[:, None]
        degree = self.courses.shape[1] - 1
        Q = sum(comb(degree, k) * t**k * (1 - t) ** (degree - k) * self.courses[number, k] for k in range(degree + 1))
        world = np.empty((4, 4, len(known), self.count + 1))
        if self.robot is not None:
            world[..., :-1] = link_poses(self.robot, np.ascontiguousarray(Q)).transpose(2, 3, 0, 1)
        world[..., -1] = np.eye(4)[..., None]
        bodies = self.model.pairs[tasks.pair].T
        flat = (
            where.reshape(times.shape) * world.shape[3] + self.link[bodies][:, None]
        )  # which is a body, an end, a task
        found = np.take(world.reshape(4, 4, -1), flat, axis=2)
        return Placed(found[:3, :3], found[:3, 3])

    def _boxes(self, tasks: Tasks, placed: Placed, need: Floats) -> Floats:
        """Compute by how much the gaps of boxes along twelve axes, in the order of tokens, exceed those needed."""
        made, bodies, clusters = self.clusters, self.model.pairs[tasks.pair].T, np.stack([tasks.a, tasks.b])
        axes = np.einsum("ikbet,kjbt->ijbet", placed.turn, self.turn[:, :, bodies])
        centers = np.einsum("ikbet,kbt->ibet", placed.turn, made.center[:, clusters]) + placed.shift
        half = made.half[:, clusters]
        apart = centers[:, 1] - centers[:, 0]
        cross = np.abs(np.einsum("ijet,iket->jket", axes[:, :, 0], axes[:, :, 1]))
        scores = np.empty((2, 2, 3, len(need)))
        for side, widths in enumerate(
            (np.einsum("jket,kt->jet", cross, half[:, 1]), np.einsum("jket,jt->ket", cross, half[:, 0]))
        ):
            along = np.einsum("iet,ijet->jet", apart if side == 0 else -apart, axes[:, :, side])
            widths += half[:, side, None]
            scores[side, 0] = (along - widths).min(axis=1) - need[:, side]
            scores[side, 1] = (-along - widths).min(axis=1) - need[:, side]
        return scores.reshape(12, -1)

    def _gaps(self, tasks: Tasks, placed: Placed, tried: Planes) -> Floats:
        """Compute the gaps of candidates at both ends, shape (2, K, T), undivided by the lengths of their normals."""
        side = tried.side.astype(bool)
        bodies = self.model.pairs[tasks.pair].T
        normal = np.ascontiguousarray(np.moveaxis(tried.normal, 2, 0))
        n = np.einsum("ijkt,jkt->ikt", self.turn[:, :, np.where(side, bodies[1], bodies[0])], normal)
        R, t = placed.turn[:, :, :, :, None], placed.shift[:, :, :, None]
        world = np.einsum("ijekt,jkt->iekt", np.where(side, R[:, :, 1], R[:, :, 0]), n)
        apart = t[:, 1] - t[:, 0]
        offset = np.einsum("iekt,iekt->ekt", world, np.where(side, -apart, apart))
        turned = -np.einsum("jiekt,jekt->iekt", np.where(side, R[:, :, 0], R[:, :, 1]), world)
        lower, upper = np.where(side, tasks.b, tasks.a), np.where(side, tasks.a, tasks.b)
        directions = np.concatenate([n[:, None], turned], axis=1).reshape(3, -1)
        reach = self.supports(np.stack([lower, upper, upper]).ravel(), directions).reshape(3, *side.shape)
        return np.asarray(offset - reach[1:] - reach[:1])

    def supports(self, cluster: Ints, directions: Floats) -> Floats:
        """Compute the largest products of directions, shape (3, N), with points of clusters, shape (N,)."""
        made = self.clusters
        order = np.argsort(cluster, kind="stable")
        rows = np.vstack([directions, np.sqrt((directions * directions).sum(axis=0))])[:, order]
        cluster = cluster[order]
        bounds = [0, *(np.flatnonzero(np.diff(cluster)) + 1).tolist(), len(order)]
        best = np.full(len(order), -np.inf)
        for first, last in pairwise(bounds if len(order) else []):
            c = cluster[first]
            n, points = rows[:, first:last], made.points[made.begin[c] : made.end[c]]
            if len(points):
                (points @ n).max(axis=0, out=best[first:last])
            for shape in made.curved[c]:
                best[first:last] = np.maximum(best[first:last], shape.reach(n.T))
        found = np.empty(len(order))
        found[order] = best
        return found

    def _distances(self, tasks: Tasks, placed: Placed) -> tuple[Floats, Floats]:
        """Compute distances of the clusters at both ends, shape (2, T), and normals from a to b, shape (3, 2, T)."""
        count = len(tasks.node)
        total = 2 * count
        operands: list[Any] = [np.array([[total], [2], [1], [2], [1]]), np.empty((2, 0), dtype=np.int64)]
        kept = []
        for k, cluster in enumerate((tasks.a, tasks.b)):
            body = self.model.pairs[tasks.pair, k]
            start = np.tile(np.stack([self.clusters.first[cluster], self.clusters.last[cluster]], axis=1), (2, 1))
            R, t, T = placed.turn[:, :, k], placed.shift[:, k], np.zeros((4, 4, 2, count))
            T[:3, :3] = np.einsum("ijet,jkt->iket", R, self.turn[:, :, body])
            T[:3, 3] = np.einsum("ijet,jt->iet", R, self.model.shift[body].T) + t
            T[3, 3] = 1.0
            record = self.kernel._replace(piece_start=start.ravel(), roots=np.full(2 * total, -1))
            kept.append((record, records.table_of(record)))
            operands += [kept[-1][1].ctypes.data, np.ascontiguousarray(T.transpose(2, 3, 0, 1).reshape(-1, 4, 4))]
        found = measure(True, total, tuple(operands))
        distance = np.where(found.unsettled, found.upper, found.distance)
        return distance.reshape(2, -1), np.nan_to_num(found.normal).T.reshape(3, 2, -1)

    def _normals(self, tasks: Tasks, placed: Placed, normals: Floats, depth: int) -> Planes:
        """Make candidates of the normals at both ends: their mean and each of them, in the frame of either body."""
        tried = []
        for side, sign in ((0, 1.0), (1, -1.0)):
            turn = self.turn[:, :, self.model.pairs[tasks.pair, side]]
            local = sign * np.einsum("kjt,lket,let->etj", turn, placed.turn[:, :, side], normals, optimize=True)
            tried += [local.sum(axis=0), *local]
        exact = np.stack([tried[k] for k in (0, 3, 1, 2, 4, 5)])
        made, sides = rounded(exact), np.array([[0], [1], [0], [0], [1], [1]])
        if depth >= DEEP or self.robot is None:
            made, sides = np.append(made, exact, axis=0), np.append(sides, sides, axis=0)
        return Planes(np.broadcast_to(sides, made.shape[:2]), made)

    # -- bytes --------------------------------------------------------------------------------

    def _written(self, token: Ints, normal: Floats, child: Ints, pair: Ints, roots: int, begins: list[int]) -> bytes:
        """Write trees by depth, first children first."""
        inner = child >= 0
        size, place = np.ones(len(token), dtype=np.int64), np.zeros(len(token), dtype=np.int64)

        def laid_out() -> None:
            """Find where each node begins, in units that keep the order."""
            size[:] = 1 + 6 * (token >= NORMAL) + 18 * (token >= DOUBLES)
            for first, last in reversed(list(pairwise(begins))):
                at = first + np.flatnonzero(inner[first:last])
                size[at] += size[child[at]] + size[child[at] + 1]
            place[:roots] = np.append(0, np.cumsum(size[:roots])[:-1])
            for first, last in pairwise(begins):
                at = first + np.flatnonzero(inner[first:last])
                place[child[at]] = place[at] + 1
                place[child[at] + 1] = place[at] + 1 + size[child[at]]

        laid_out()
        # A plane that was the last one for its pair need not be named again.
        leaves = np.flatnonzero(~inner)
        leaves = leaves[np.lexsort((place[leaves], pair[leaves]))]
        plane = np.column_stack([token[leaves], normal[leaves]])
        first = np.append(True, np.diff(pair[leaves]) > 0)[: len(leaves)]
        before = np.roll(plane, 1, axis=0)
        before[first] = self.named[pair[leaves[first]]]
        last = np.append(first[1:], True)[: len(leaves)]
        self.named[pair[leaves[last]]] = plane[last]
        token[leaves[(plane == before).all(axis=1) & (plane[:, 0] >= NORMAL)]] = SAME
        laid_out()
        data = np.zeros(int(size[:roots].sum()), dtype=np.uint8)
        data[place] = token
        for at, form in ((token >= NORMAL) & (token < DOUBLES), "<i2"), (token >= DOUBLES, "<f8"):
            own = normal[at].astype(form).view(np.uint8)
            data[place[at][:, None] + np.arange(1, own.shape[1] + 1)] = own
        return data.tobytes()


# -- directions and shapes --------------------------------------------------------------------

_AXES = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (2, 1))


def rounded(n: Floats) -> Floats:
    """Round directions, shape (..., 3), to whole numbers: of some multiples, the one that is turned least."""
    flat = n / np.maximum(np.abs(n).max(axis=-1, keepdims=True), 1e-300)
    unit = flat / np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), 1e-300)
    whole = np.rint(np.multiply.outer(np.linspace(LARGEST, LARGEST / 2, SCALES), flat))
    along = (whole * unit).sum(axis=-1, keepdims=True)
    off = ((whole - along * unit) ** 2).sum(axis=-1, keepdims=True) / np.maximum(along, 1e-150) ** 2
    return np.asarray(np.take_along_axis(whole, off.argmin(axis=0)[None], axis=0)[0])


def _tokens(side: Ints | Floats, normal: Floats) -> Ints:
    """Return the tokens of planes with these normals: doubles, unless they are whole numbers of 16 bits."""
    short = ((normal == np.rint(normal)) & (np.abs(normal) <= LARGEST)).all(axis=-1)
    return np.where(short, NORMAL, DOUBLES) + side.astype(np.int64)


def _kernel(packed: Packed, model: Model) -> Any:
    """Return the arrays for kernels with surfaces as the hulls of their corners."""
    kernel, layout = packed.kernel, packed.kernel.layout.copy()
    blocks, count = [kernel.points], len(kernel.points) // 3
    for k in np.flatnonzero(layout[:, columns.KIND] <= columns.SURFACE):
        own, kind, nodes = model.pieces.points[k], columns.POLYTOPE, np.empty(0)
        if len(own) > columns.LARGE:
            chosen, nodes = entries.direction_map(own)
            own, kind = own[chosen], columns.MAPPED
        own = np.concatenate([own, np.repeat(own[-1:], -len(own) % columns.BLOCK, axis=0)])
        layout[k, : columns.POINTS_TO + 1] = kind, count, count + len(own)
        blocks.append(own.reshape(-1, columns.BLOCK, 3).transpose(0, 2, 1).ravel())
        blocks.append(np.append(nodes, np.zeros(-nodes.size % (3 * columns.BLOCK))))
        count += len(own) + len(blocks[-1]) // 3
    if len(blocks) == 1:
        return kernel
    points = records.aligned(3 * count)
    points[:] = np.concatenate(blocks)
    vertices = records.aligned(len(points) if len(kernel.single) else 0, np.float32)
    vertices[:] = points[: len(vertices)]
    return kernel._replace(layout=layout, points=points, vertices=vertices)


class _Curved(NamedTuple):
    """A curved piece in the frame of a link."""

    kind: int
    radius: float
    center: Floats
    factor: Floats

    def reach(self, n: Floats) -> Floats:
        """Compute the largest products of directions with its points; n has their lengths in a fourth column."""
        v = n[:, :3] @ self.factor
        across = np.hypot(v[:, 0], v[:, 1])
        if self.kind == BALL:
            wide = np.hypot(across, v[:, 2])
        elif self.kind == CYLINDER:
            wide = across + np.abs(v[:, 2])
        else:
            wide = np.maximum(v[:, 2], across - v[:, 2])
        return np.asarray(n[:, :3] @ self.center + self.radius * n[:, 3] + wide)

    @property
    def ball(self) -> Floats:
        """The center and the radius of the ball around it that the format names."""
        share = 1.0 if self.kind == BALL else np.sqrt(2.0)
        return np.append(self.center, self.radius + share * np.linalg.norm(self.factor))


def clusters_of(model: Model) -> Clusters:
    """Place the pieces of all bodies, and divide the pieces of each body again and again."""
    start, pieces = model.pieces.start, model.pieces
    body_of = np.repeat(np.arange(len(start) - 1), np.diff(start))
    hull = pieces.kind == HULL
    counts = np.array([len(points) if own else 0 for points, own in zip(pieces.points, hull, strict=True)])
    begin = np.append(0, np.cumsum(counts))
    owner, piece = np.repeat(body_of, counts), np.repeat(np.arange(len(counts)), counts)
    given = [pieces.points[k] for k in np.flatnonzero(hull)]
    points = np.zeros((len(owner), 4))
    points[:, :3] = np.einsum("vij,vj->vi", model.turn[owner], np.concatenate([*given, np.empty((0, 3))]))
    points[:, :3] += model.shift[owner]
    points[:, 3] = pieces.radius[piece]
    # How far pieces reach along the axes of their bodies, and the balls from which the format makes one around a body.
    lengths = np.linalg.norm(model.turn, axis=1)
    low, high = np.empty((len(counts), 3)), np.empty((len(counts), 3))
    if len(given):
        along = np.einsum("vij,vi->vj", model.turn[owner], points[:, :3])
        grown, first = points[:, 3:] * lengths[owner], begin[:-1][hull]
        low[hull], high[hull] = np.minimum.reduceat(along - grown, first), np.maximum.reduceat(along + grown, first)
    curved = {}
    for k in np.flatnonzero(~hull).tolist():
        M, s = model.turn[body_of[k]], model.shift[body_of[k]]
        own = pieces.points[k]
        curved[k] = _Curved(int(pieces.kind[k]), float(pieces.radius[k]), M @ own[0] + s, M @ own[1:])
        both = np.column_stack([np.concatenate([M.T, -M.T]), np.tile(lengths[body_of[k]], 2)])
        high[k], low[k] = np.split(curved[k].reach(both), 2) * np.array([[1], [-1]])
    at = begin[list(curved)]
    balls, of_ball = points, owner
    if curved:
        balls = np.insert(points, at, [one.ball for one in curved.values()], axis=0)
        of_ball = np.insert(owner, at, body_of[list(curved)])
    return _divided(model, body_of, begin, points, curved, (low, high), balls, of_ball)


def _divided(
    model: Model, body_of: Ints, begin: Ints, points: Floats, curved: dict[int, _Curved], ends: tuple[Floats, Floats],
    balls: Floats, of_ball: Ints,
) -> Clusters:  # fmt: skip
    """Make the clusters and the balls of placed pieces."""
    start = model.pieces.start
    rows: list[list[int]] = []
    of_body = []
    for one, ends_ in enumerate(pairwise(start.tolist())):
        k = len(rows)
        of_body.append(k)
        rows.append([one, *ends_, -1, -1])
        while k < len(rows):
            begins, stops = rows[k][1:3]
            if stops - begins > 1:
                middle = begins + (stops - begins) // 2
                rows[k][3:] = len(rows), len(rows) + 1
                rows += [[one, begins, middle, -1, -1], [one, middle, stops, -1, -1]]
            k += 1
    body, first, last, left, right = np.array(rows, dtype=np.int64).reshape(-1, 5).T
    low, high = (array[first] for array in ends)
    for k in np.flatnonzero(last - first > 1).tolist():
        low[k], high[k] = ends[0][first[k] : last[k]].min(axis=0), ends[1][first[k] : last[k]].max(axis=0)
    M = model.turn[body]
    square = (M * M).sum(axis=1)
    center = np.einsum("cij,cj->ic", M, (low + high) / 2 / square)
    half = ((high - low) / 2 / square).T
    own = [
        [curved[piece] for piece in range(*ends_) if piece in curved]
        for ends_ in zip(first.tolist(), last.tolist(), strict=True)
    ]
    of = np.searchsorted(of_ball, np.arange(len(start) - 1))
    least = np.minimum.reduceat(balls[:, :3] - balls[:, 3:], of)
    centers = (least + np.maximum.reduceat(balls[:, :3] + balls[:, 3:], of)) / 2
    radius = np.maximum.reduceat(np.linalg.norm(balls[:, :3] - centers[of_ball], axis=1) + balls[:, 3], of)
    return Clusters(
        np.array(of_body, dtype=np.int64), first, last, left, right, center, half, points, begin[first], begin[last],
        own, np.column_stack([centers, radius]),
    )  # fmt: skip


# -- bounds -----------------------------------------------------------------------------------


class _Chains:
    """The joints between the links of all pairs, and how far bodies are from them.

    Chains are numbered (pair, side), flat. Joints are in the order in which the ball passes them, from the upper body
    to the lower one.
    """

    def __init__(self, model: Model, balls: Floats, deviations: Floats) -> None:
        links, pairs = model.links, model.pairs
        self.links, self.deviations = links, deviations
        self.path: list[list[int]] = []
        for k, (above, moves) in enumerate(zip(links.above.tolist(), links.moves.tolist(), strict=True)):
            self.path.append((self.path[above] if above >= 0 else []) + ([k] if moves != STAYS else []))
        lower, upper = pairs.ravel(), pairs[:, ::-1].ravel()
        count = len(links.above) + 1
        ends, number = np.unique(count * (model.link[upper] + 1) + model.link[lower] + 1, return_inverse=True)
        chains = []
        for end in ends.tolist():
            up, down = ([*self.path, []][k - 1] for k in divmod(end, count))
            common = sum(x == y for x, y in zip(up, down, strict=False))
            chains.append([(k, True) for k in reversed(up[common:])] + [(k, False) for k in down[common:]])
        length = max(map(len, chains), default=0)
        table = np.full((len(chains), length, 2), [-1, 0])
        for row, chain in zip(table, chains, strict=True):
            row[: len(chain)] = np.array(chain, dtype=np.int64).reshape(-1, 2)
        self.joint, climbs = table[number, :, 0], table[number, :, 1] == 1
        self.radius, c = balls[upper, 3], balls[upper, :3]
        self.longest = float(np.linalg.norm(balls[:, :3], axis=1).max(initial=0.0) + balls[:, 3].max(initial=0.0))
        F = rotations_of(links.quaternion / np.linalg.norm(links.quaternion, axis=1, keepdims=True))
        e = links.axis / np.maximum(np.linalg.norm(links.axis, axis=1), 1e-300)[:, None]
        # How far the center is from the axis of each joint that turns.
        self.away = np.zeros(self.joint.shape)
        for k in range(length):
            j, up, there = self.joint[:, k], climbs[:, k], self.joint[:, k] >= 0
            c = np.where((up | ~there)[:, None], c, np.einsum("tji,tj->ti", F[j], c - links.translation[j]))
            onto = (c * e[j]).sum(axis=1)[:, None] * e[j]
            turns = there & (links.moves[j] == TURNS)
            self.away[:, k] = np.where(turns, np.linalg.norm(c - onto, axis=1), 0.0)
            c = np.where(turns[:, None], onto, c)
            c = np.where((up & there)[:, None], np.einsum("tij,tj->ti", F[j], c) + links.translation[j], c)

    def bends(self, courses: Floats) -> tuple[Bends, float]:
        """Compute the bounds for motions, and the size of the model on them."""
        links, degree = self.links, courses.shape[1] - 1
        m = np.where(links.value < 0, 0.0, np.abs(links.multiplier))
        P = np.pad(courses, ((0, 0), (0, 0), (0, 1)))[:, :, links.value]  # links that do not move follow the last one
        rates = m * degree * np.abs(np.diff(P, axis=1)).max(axis=1)
        bend = m * degree * (degree - 1) * np.abs(np.diff(P, n=2, axis=1)).max(axis=1, initial=0.0)
        off = m * np.append(self.deviations, 0.0)[links.value]
        length, slides = np.linalg.norm(links.axis, axis=1), links.moves == SLIDES
        far = np.abs(links.multiplier * P + links.offset).max(axis=1)
        far = np.where(slides, length * (far + off), 0.0)
        there = self.joint >= 0
        grows = there * (np.where(slides[self.joint], far[:, self.joint], 0.0) + self.away)
        reach = np.where(slides[self.joint], length[self.joint], self.radius[:, None] + np.cumsum(grows, axis=2))
        curvature, deviation, turned = (np.zeros(reach.shape[:2]) for _ in range(3))
        for k in reversed(range(self.joint.shape[1])):  # from the lower body to the upper one
            j = self.joint[:, k]
            own, turns = np.where(there[:, k], reach[:, :, k], 0.0), there[:, k] & ~slides[j]
            rate = rates[:, j]
            curvature += own * (rate * (turns * rate + 2 * turned) + bend[:, j])
            deviation += own * off[j]
            turned += turns * rate
        shape = (len(courses), -1, 2)
        steps = np.linalg.norm(links.translation, axis=1) + far.max(axis=0, initial=0.0)
        longest = max((steps[path].sum() for path in self.path), default=0.0)
        return Bends(curvature.reshape(shape), deviation.reshape(shape)), max(1.0, 2 * float(longest + self.longest))


def written(deviations: Floats, courses: Floats) -> bytes:
    """Write the motions of a proof."""
    head = deviations.astype("<f8").tobytes() + struct.pack("<I", len(courses))
    degree = struct.pack("<B", courses.shape[1] - 1)
    return head + b"".join(degree + course.astype("<f8").tobytes() for course in courses)
