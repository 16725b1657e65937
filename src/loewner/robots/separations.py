"""Find planes that separate all pairs of bodies along motions: the trees of a proof, see docs/proof-format.md.

The search proceeds by levels of the trees, and handles all open intervals of a level, of all motions and pairs,
together. It knows nothing of how the kernel proved the motions.
"""

from __future__ import annotations

import struct
from math import comb
from typing import Any, NamedTuple

import numpy as np

from loewner._kernels import columns, records
from loewner._measure import measure
from loewner._validate import Bools, Floats, Ints
from loewner.errors import ConvergenceError
from loewner.robots.problem import Problem
from loewner.robots.proof_models import BALL, CONE, CYLINDER, HULL, SLIDES, STAYS, TURNS, Model
from loewner.robots.robot import link_poses

# Tokens of the trees.
HALVED, FIRST_DIVIDED, SECOND_DIVIDED, SAME, AXES, NORMAL = 0, 1, 2, 3, 4, 16

# Checkers may refuse trees that are deeper.
DEEPEST = 64

# What is left for checkers that compute with enclosures: of the lengths on the right, and of the model's size.
SHARE, ROOM = 1.0 + 2e-9, 2e-11

# Normals are whole numbers up to this one. Some scales are tried, on deep levels many, since rounding turns a normal.
LARGEST, SCALES, DEEP, DEEP_SCALES = 32767, 16, 6, 4096

# Boxes are compared first, and must be apart by this much of the model's size: poses may bend a little.
BOX_ROOM = 4e-6

# Motions whose trees are made at a time.
AT_ONCE = 64

# Candidates among the axes that are tried after the boxes.
BEST_AXES = 3


class Clusters(NamedTuple):
    """Consecutive pieces of bodies, as trees may divide them.

    Attributes
    ----------
    of_body : ndarray of int64
        The cluster of all pieces of each body.
    body, first, last : ndarray of int64
        The body, the first piece, and the one after the last.
    left, right : ndarray of int64
        Its two halves; -1 if it is a single piece.
    center, edges : ndarray, shapes (C, 3) and (C, 3, 3)
        A box around it along the axes of the body, in the frame of the link; half edges in columns.
    points : list of ndarray, shape (k, 4)
        Corners in the frame of the link, and the radius about each.
    curved : list of lists of (kind, radius, center, factor)
    """

    of_body: Ints
    body: Ints
    first: Ints
    last: Ints
    left: Ints
    right: Ints
    center: Floats
    edges: Floats
    points: list[Floats]
    curved: list[list[tuple[int, float, Floats, Floats]]]


class Bends(NamedTuple):
    """What a plane has to allow for: arrays of shape (motions, pairs, 2), with the first or the second body as the
    lower one: A and V of the format."""

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
        return Tasks(*(array[chosen] for array in self))


class Planes(NamedTuple):
    """One candidate for each task: the side whose body is the lower one, and the normal in whole numbers."""

    side: Ints
    normal: Ints


def trees(ready: Problem, model: Model, courses: Floats, deviations: Floats) -> bytes:
    """Make the trees of all motions and pairs, in order.

    Raises
    ------
    ConvergenceError
        If planes that the format can express do not prove a pair to be apart.
    """
    search = _Search(ready.in_parts, model, deviations)
    return b"".join(search.of(courses[k : k + AT_ONCE]) for k in range(0, len(courses), AT_ONCE))


class _Search:
    """The search for the trees of some motions; `named` is the plane that was named last for each pair."""

    def __init__(self, ready: Problem, model: Model, deviations: Floats) -> None:
        self.ready, self.model, self.deviations = ready, model, deviations
        self.clusters = _clusters(model)
        self.chains = _Chains(model, deviations)
        self.named = np.full((len(model.pairs), 4), -1, dtype=np.int64)
        self.recent = np.zeros((len(model.pairs), 4), dtype=np.int64)
        links = np.append(model.links.of_robot, -1)[model.link]  # behind the robot's links, the world
        self.link = np.where(links < 0, len(ready.robot.link_names), links)

    def of(self, courses: Floats) -> bytes:
        """Make the trees of some motions."""
        motions, pairs = len(courses), len(self.model.pairs)
        self.courses = courses
        self.bends, self.size = self.chains.bends(courses)
        m, p = (array.ravel() for array in np.indices((motions, pairs)))
        a, b = self.clusters.of_body[self.model.pairs[p]].T
        open_ = Tasks(m, p, a, b, np.arange(len(m)), np.zeros(len(m)), np.ones(len(m)))
        token, normal = np.zeros(len(m), dtype=np.int64), np.zeros((len(m), 3), dtype=np.int64)
        child = np.full(len(m), -1, dtype=np.int64)
        owner, count, begins = p, len(m), [0]
        for depth in range(DEEPEST + 1):
            if not len(open_.node):
                break
            if depth == DEEPEST:
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
            normal = np.append(normal, np.zeros((len(open_.node), 3), dtype=np.int64), axis=0)
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
        token, normal = np.full(total, -1), np.zeros((total, 3), dtype=np.int64)
        scores = self._boxes(tasks, placed, need)
        best = scores.argmax(axis=1)
        sure = scores[np.arange(total), best] > BOX_ROOM * self.size
        token[sure] = AXES + best[sure]
        at = np.flatnonzero(~sure)
        divide = np.zeros(total, dtype=np.int64)
        if len(at):
            self._search(tasks.at(at), tuple(T[at] for T in placed), need[at], scores[at], depth, at, token, normal, divide)
        found = token >= 0
        return found, Planes(token[found], normal[found]), divide[~found]

    def _search(
        self, tasks: Tasks, placed: Any, need: Floats, scores: Floats, depth: int, at: Ints,
        token: Ints, normal: Ints, divide: Ints,
    ) -> None:  # fmt: skip
        """Try planes one after the other on tasks that boxes do not settle, and decide how the others are divided."""
        total = len(at)
        order = np.argsort(-scores, axis=1)[:, :BEST_AXES]
        # The axes, and the plane that was found last for this pair.
        tried = [Planes(k // 6, _AXES[k]) for k in order.T]
        recent = self.recent[tasks.pair]
        tried.append(Planes(recent[:, 0], recent[:, 1:]))
        gaps = self._gaps(tasks, placed, tried)
        open_ = np.arange(total)
        for k in range(len(tried)):
            good = open_[self._holds(gaps[k][:, open_], tried[k], need, open_)]
            token[at[good]] = AXES + order[good, k] if k < BEST_AXES else NORMAL + tried[k].side[good]
            normal[at[good]] = tried[k].normal[good]
            open_ = open_[token[at[open_]] < 0]
        if not len(open_):
            return
        some, T, need, gaps = tasks.at(open_), tuple(T[open_] for T in placed), need[open_], gaps[:, :, open_]
        distance, normals = self._distances(some, T)
        least = need.min(axis=1) + ROOM * self.size
        hopeless = self.model.margins[some.pair] + self.bends.deviation[some.motion, some.pair].min(axis=1)
        for k in np.flatnonzero((distance < hopeless[:, None] - BOX_ROOM * self.size).any(axis=1))[:1]:
            self._fail(some, k)
        near = (distance > least[:, None]).all(axis=1)
        rows = np.flatnonzero(near)
        best = np.max(gaps / np.linalg.norm([p.normal[open_] for p in tried], axis=2)[:, None], axis=0, where=np.isfinite(gaps), initial=-np.inf)
        if len(rows):
            chosen = some.at(rows)
            T = tuple(T_[rows] for T_ in T)
            tried = self._normals(chosen, T, normals[rows], depth)
            gaps = self._gaps(chosen, T, tried)
            left = np.arange(len(rows))
            for k, planes in enumerate(tried):
                best[:, rows] = np.fmax(best[:, rows], gaps[k] / np.linalg.norm(planes.normal, axis=1))
                good = left[self._holds(gaps[k][:, left], planes, need[rows], left)]
                places = at[open_[rows[good]]]
                token[places], normal[places] = NORMAL + planes.side[good], planes.normal[good]
                self.recent[chosen.pair[good], 0], self.recent[chosen.pair[good], 1:] = planes.side[good], planes.normal[good]
                left = left[token[at[open_[rows[left]]]] < 0]
        # Pieces that no plane separates, although they are apart, are divided.
        counts = np.stack([(self.clusters.last - self.clusters.first)[c] for c in (some.a, some.b)])
        stuck = (best <= self.model.margins[some.pair] + ROOM * self.size).any(axis=0) & (counts.max(axis=0) > 1)
        divide[at[open_]] = np.where(stuck, np.where(counts[0] >= counts[1], FIRST_DIVIDED, SECOND_DIVIDED), HALVED)

    def _holds(self, gaps: Floats, planes: Planes, need: Floats, rows: Ints) -> Bools:
        """Return which planes prove tasks, from their gaps at both ends."""
        length = np.linalg.norm(planes.normal[rows], axis=1)
        side = planes.side[rows]
        held = gaps.min(axis=0) > length * (need[rows, side] + ROOM * self.size)
        return np.asarray(held & (length > 0))

    def _halves(self, tasks: Tasks, divide: Ints, count: int) -> Tasks:
        """Make the two halves of each task, one after the other."""
        middle = (tasks.low + tasks.high) / 2
        twice = Tasks(*(np.repeat(array, 2) for array in tasks))
        second = np.tile([False, True], len(tasks.node))
        kind = np.repeat(divide, 2)
        low = np.where((kind == HALVED) & second, np.repeat(middle, 2), twice.low)
        high = np.where((kind == HALVED) & ~second, np.repeat(middle, 2), twice.high)
        halves = [np.where(second, self.clusters.right[c], self.clusters.left[c]) for c in (twice.a, twice.b)]
        a = np.where(kind == FIRST_DIVIDED, halves[0], twice.a)
        b = np.where(kind == SECOND_DIVIDED, halves[1], twice.b)
        return Tasks(twice.motion, twice.pair, a, b, count + np.arange(len(a)), low, high)

    def _fail(self, tasks: Tasks, k: int) -> None:
        a, b = (self.ready.names[n] for n in self.model.pairs[tasks.pair[k]])
        raise ConvergenceError(
            f"proof: expected planes between {a} and {b} all along motion {tasks.motion[k]}, found none from the "
            f"fraction {tasks.low[k]:.6g} to {tasks.high[k]:.6g} that a proof can hold, although the motion is free: "
            "its bound on joint errors is coarser than that of certify_edges; lower joint_error"
        )

    # -- geometry -----------------------------------------------------------------------------

    def _poses(self, tasks: Tasks) -> tuple[Floats, Floats]:
        """Return the world poses of the links of both bodies at both ends: two arrays of shape (T, 2, 4, 4)."""
        times = np.stack([tasks.low, tasks.high], axis=1)
        keys = tasks.motion[:, None] + times / 2  # times are fractions with few digits
        known, where = np.unique(keys, return_inverse=True)
        number = np.minimum(known.astype(np.int64), len(self.courses) - 1)
        t = (2 * (known - number))[:, None]
        degree = self.courses.shape[1] - 1
        Q = sum(
            comb(degree, k) * t**k * (1 - t) ** (degree - k) * self.courses[number, k] for k in range(degree + 1)
        )
        world = link_poses(self.ready.robot, np.ascontiguousarray(Q))
        world = np.concatenate([world, np.broadcast_to(np.eye(4), (len(world), 1, 4, 4))], axis=1)
        where = where.reshape(-1, 2)
        bodies = self.model.pairs[tasks.pair]
        return tuple(world[where, self.link[body][:, None]] for body in bodies.T)  # type: ignore[return-value]

    def _boxes(self, tasks: Tasks, placed: Any, need: Floats) -> Floats:
        """Compute by how much the gaps of boxes along twelve axes, in the order of tokens, exceed what is needed."""
        (Ta, Tb), made = placed, self.clusters
        centers, edges, axes = [], [], []
        for T, cluster, body in ((Ta, tasks.a, 0), (Tb, tasks.b, 1)):
            R = T[..., :3, :3]
            centers.append(np.einsum("tesk,tk->tes", R, made.center[cluster]) + T[..., :3, 3])
            edges.append(np.einsum("tesk,tkj->tesj", R, made.edges[cluster]))
            axes.append(np.einsum("tesk,tkj->tesj", R, self.model.turn[self.model.pairs[tasks.pair, body]]))
        apart = centers[1] - centers[0]
        scores = np.empty((len(need), 2, 6))
        for side in (0, 1):
            along = np.einsum("tes,tesj->tej", apart if side == 0 else -apart, axes[side])
            widths = sum(np.abs(np.einsum("tesk,tesj->tekj", E, axes[side])).sum(axis=2) for E in edges)
            for sign, first in ((1, 0), (-1, 3)):
                scores[:, side, first : first + 3] = (sign * along - widths).min(axis=1) - need[:, side, None]
        return scores.reshape(-1, 12)

    def _gaps(self, tasks: Tasks, placed: Any, tried: list[Planes]) -> Floats:
        """Compute exactly the gaps of candidates, shape (candidates, 2, T): the products with their normals, undivided."""
        gaps = np.empty((len(tried), 2, len(tasks.node)))
        bodies, clusters = self.model.pairs[tasks.pair].T, (tasks.a, tasks.b)
        cluster, direction, offset = [], [], np.empty_like(gaps)
        for k, planes in enumerate(tried):
            side = planes.side.astype(bool)
            lower, upper = (np.where(side, x, y) for x, y in (bodies[::-1], bodies))
            n = np.einsum("tij,tj->ti", self.model.turn[lower], planes.normal)
            which = side[:, None, None, None]
            T, S = np.where(which, placed[1], placed[0]), np.where(which, placed[0], placed[1])
            world = np.einsum("teij,tj->tei", T[..., :3, :3], n)
            offset[k] = np.einsum("tei,tei->et", world, S[..., :3, 3] - T[..., :3, 3])
            turned = -np.einsum("teji,tej->tei", S[..., :3, :3], world)
            cluster += [np.where(side, clusters[1], clusters[0]), *[np.where(side, clusters[0], clusters[1])] * 2]
            direction += [n, turned[:, 0], turned[:, 1]]
        reach = self._supports(np.concatenate(cluster), np.concatenate(direction)).reshape(len(tried), 3, -1)
        gaps[:] = offset - reach[:, 1:] - reach[:, :1]
        return gaps

    def _supports(self, cluster: Ints, directions: Floats) -> Floats:
        """Compute the largest products of directions with points of clusters."""
        found = np.empty(len(cluster))
        rows = np.column_stack([directions, np.linalg.norm(directions, axis=1)])
        order = np.argsort(cluster, kind="stable")
        for same in np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1):
            c = cluster[same[0]]
            n = rows[same]
            points, best = self.clusters.points[c], np.full(len(n), -np.inf)
            if len(points):
                best = (n @ points.T).max(axis=1)
            for kind, radius, center, factor in self.clusters.curved[c]:
                best = np.maximum(best, n[:, :3] @ center + radius * n[:, 3] + width(kind, n[:, :3] @ factor))
            found[same] = best
        return found

    def _distances(self, tasks: Tasks, placed: Any) -> tuple[Floats, Floats]:
        """Compute distances of the clusters at both ends, shape (T, 2), and normals from a to b, shape (T, 2, 3)."""
        total = 2 * len(tasks.node)
        operands: list[Any] = [np.array([[total], [2], [1], [2], [1]]), np.empty((2, 0), dtype=np.int64)]
        kept = []
        kernel = self.ready.packed.kernel
        layout = kernel.layout.copy()
        layout[layout[:, columns.KIND] <= columns.SURFACE, columns.KIND] = columns.POLYTOPE  # the box around it
        for k, cluster in enumerate((tasks.a, tasks.b)):
            body = self.model.pairs[tasks.pair, k]
            ends = np.stack([self.clusters.first[cluster], self.clusters.last[cluster]], axis=1)
            start = np.repeat(ends, 2, axis=0).ravel()
            frame = np.tile(np.eye(4), (len(body), 1, 1))
            frame[:, :3, :3], frame[:, :3, 3] = self.model.turn[body], self.model.shift[body]
            T = np.ascontiguousarray((placed[k] @ frame[:, None]).reshape(-1, 4, 4))
            record = kernel._replace(layout=layout, piece_start=start, roots=np.full(total * 2, -1))
            kept.append((record, records.table_of(record)))
            operands += [kept[-1][1].ctypes.data, T]
        found = measure(True, total, tuple(operands))
        distance = np.where(found.unsettled, found.upper, found.distance)
        return distance.reshape(-1, 2), np.nan_to_num(found.normal).reshape(-1, 2, 3)

    def _normals(self, tasks: Tasks, placed: Any, normals: Floats, depth: int) -> list[Planes]:
        """Make candidates of the normals at both ends: their mean and each of them, in the frame of either body."""
        tried = []
        for side, sign in ((0, 1.0), (1, -1.0)):
            turn = self.model.turn[self.model.pairs[tasks.pair, side]]
            local = sign * np.einsum("tkj,telk,tel->tej", turn, placed[side][..., :3, :3], normals)
            for n in (local.sum(axis=1), local[:, 0], local[:, 1]):
                tried.append(Planes(np.full(len(n), side), rounded(n, DEEP_SCALES if depth >= DEEP else SCALES)))
        return [tried[k] for k in (0, 3, 1, 2, 4, 5)]

    # -- bytes --------------------------------------------------------------------------------

    def _written(
        self, token: Ints, normal: Ints, child: Ints, pair: Ints, roots: int, begins: list[int]
    ) -> bytes:
        """Write trees by depth, first children first."""
        inner = child >= 0
        size, place = np.ones(len(token), dtype=np.int64), np.zeros(len(token), dtype=np.int64)

        def laid_out() -> None:
            """Find where each node begins, in units that keep the order."""
            size[:] = 1 + 6 * (token >= NORMAL)
            for first, last in reversed(list(zip(begins, begins[1:], strict=False))):
                at = first + np.flatnonzero(inner[first:last])
                size[at] += size[child[at]] + size[child[at] + 1]
            place[:roots] = np.append(0, np.cumsum(size[:roots])[:-1])
            for first, last in zip(begins, begins[1:], strict=False):
                at = first + np.flatnonzero(inner[first:last])
                place[child[at]] = place[at] + 1
                place[child[at] + 1] = place[at] + 1 + size[child[at]]

        laid_out()
        # A plane that was the last one for its pair need not be named again.
        leaves = np.flatnonzero(~inner)
        leaves = leaves[np.lexsort((place[leaves], pair[leaves]))]
        plane = np.column_stack([token[leaves], normal[leaves]])
        first = np.append(True, np.diff(pair[leaves]) > 0)
        before = np.roll(plane, 1, axis=0)
        before[first] = self.named[pair[leaves[first]]]
        last = np.append(first[1:], True)
        self.named[pair[leaves[last]]] = plane[last]
        token[leaves[(plane == before).all(axis=1) & (plane[:, 0] >= NORMAL)]] = SAME
        laid_out()
        data = np.zeros(int(size[:roots].sum()), dtype=np.uint8)
        data[place] = token
        at = np.flatnonzero(token >= NORMAL)
        data[place[at][:, None] + np.arange(1, 7)] = normal[at].astype("<i2").view(np.uint8).reshape(-1, 6)
        return data.tobytes()


# -- directions and shapes --------------------------------------------------------------------

_AXES = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (2, 1)).astype(np.int64)


def width(kind: int, v: Floats) -> Floats:
    """Compute the largest products of directions v, shape (N, 3), with points of a unit shape."""
    across = np.hypot(v[:, 0], v[:, 1])
    if kind == BALL:
        return np.hypot(across, v[:, 2])
    return across + np.abs(v[:, 2]) if kind == CYLINDER else np.maximum(v[:, 2], across - v[:, 2])


def rounded(n: Floats, scales: int) -> Ints:
    """Round directions to whole numbers: of some multiples, the one that is turned least."""
    longest = np.maximum(np.abs(n).max(axis=1), 1e-300)
    found = np.rint(n * (LARGEST / longest)[:, None]).astype(np.int64)
    if len(n) == 0:
        return found
    unit = n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
    for k, direction in enumerate(unit):
        multiples = np.linspace(LARGEST / 2, LARGEST, scales) / max(np.abs(direction).max(), 1e-300)
        whole = np.rint(direction * multiples[:, None])
        off = np.linalg.norm(np.cross(whole, direction), axis=1) / np.maximum(np.linalg.norm(whole, axis=1), 1e-300)
        found[k] = whole[off.argmin()]
    return found


def _clusters(model: Model) -> Clusters:
    """Divide the pieces of each body again and again."""
    rows: list[tuple[int, int, int]] = []
    halves: list[list[int]] = []
    of_body = []
    start = model.pieces.start.tolist()
    for body in range(len(start) - 1):
        of_body.append(len(rows))
        rows.append((body, start[body], start[body + 1]))
        halves.append([-1, -1])
        k = of_body[-1]
        while k < len(rows):
            _, first, last = rows[k]
            if last - first > 1:
                middle = first + (last - first) // 2
                halves[k] = [len(rows), len(rows) + 1]
                rows += [(body, first, middle), (body, middle, last)]
                halves += [[-1, -1], [-1, -1]]
            k += 1
    body, first, last = np.array(rows, dtype=np.int64).T
    left, right = np.array(halves, dtype=np.int64).T
    points, curved, center, edges = [], [], np.empty((len(rows), 3)), np.empty((len(rows), 3, 3))
    placed: list[Any] = []
    for b in range(len(start) - 1):
        M, s = model.turn[b], model.shift[b]
        for piece in range(start[b], start[b + 1]):
            kind, radius, given = int(model.pieces.kind[piece]), model.pieces.radius[piece], model.pieces.points[piece]
            if kind == HULL:
                placed.append(np.column_stack([given @ M.T + s, np.full(len(given), radius)]))
            else:
                placed.append((kind, float(radius), M @ given[0] + s, M @ given[1:]))
    for k, (b, low, high) in enumerate(rows):
        own = placed[low:high]
        hulls = [one for one in own if not isinstance(one, tuple)]
        points.append(np.concatenate(hulls) if hulls else np.empty((0, 4)))
        curved.append([one for one in own if isinstance(one, tuple)])
        M = model.turn[b]
        lengths = np.linalg.norm(M, axis=0)
        both = np.concatenate([M.T, -M.T])
        ends = (np.column_stack([both, np.tile(lengths, 2)]) @ points[k].T).max(axis=1, initial=-np.inf)
        for kind, radius, c, G in curved[k]:
            ends = np.maximum(ends, both @ c + radius * np.tile(lengths, 2) + width(kind, both @ G))
        high_, low_ = ends[:3] / lengths**2, -ends[3:] / lengths**2
        center[k], edges[k] = M @ ((high_ + low_) / 2), M * ((high_ - low_) / 2)
    return Clusters(np.array(of_body, dtype=np.int64), body, first, last, left, right, center, edges, points, curved)


# -- bounds -----------------------------------------------------------------------------------


class _Chains:
    """The joints between the links of all pairs, and how far bodies are from them.

    Chains are numbered (pair, side), flat. Joints are in the order in which the ball passes them, from the upper body to
    the lower one.
    """

    def __init__(self, model: Model, deviations: Floats) -> None:
        links, pairs = model.links, model.pairs
        self.model, self.deviations = model, deviations
        F = _rotations(links.quaternion)
        path: list[list[int]] = []
        for k, (above, moves) in enumerate(zip(links.above.tolist(), links.moves.tolist(), strict=True)):
            path.append((path[above] if above >= 0 else []) + ([k] if moves != STAYS else []))
        path.append([])
        own: dict[tuple[int, int], list[tuple[int, bool]]] = {}
        link = model.link
        upper, lower = np.stack([pairs[:, ::-1], pairs]).reshape(2, -1)
        chains = []
        for u, v in zip(link[upper].tolist(), link[lower].tolist(), strict=True):
            if (u, v) not in own:
                up, down = path[u], path[v]
                common = next((k for k, (x, y) in enumerate(zip(up, down, strict=False)) if x != y), min(len(up), len(down)))
                own[u, v] = [(k, True) for k in reversed(up[common:])] + [(k, False) for k in down[common:]]
            chains.append(own[u, v])
        length = max(map(len, chains), default=0)
        self.joint, climbs = np.full((len(chains), length), -1), np.zeros((len(chains), length), dtype=bool)
        for k, chain in enumerate(chains):
            if chain:
                self.joint[k, : len(chain)], climbs[k, : len(chain)] = zip(*chain, strict=True)
        centers, self.radius = _balls(model)
        self.upper = upper
        c = centers[upper]
        e = links.axis / np.maximum(np.linalg.norm(links.axis, axis=1), 1e-300)[:, None]
        # How far the center is from the axis of each joint that turns.
        self.away = np.zeros(self.joint.shape)
        for k in range(length):
            j, up = self.joint[:, k], climbs[:, k]
            c = np.where((up | (j < 0))[:, None], c, np.einsum("tji,tj->ti", F[j], c - links.translation[j]))
            onto = (c * e[j]).sum(axis=1)[:, None] * e[j]
            turns = (j >= 0) & (links.moves[j] == TURNS)
            self.away[:, k] = np.where(turns, np.linalg.norm(c - onto, axis=1), 0.0)
            c = np.where(turns[:, None], onto, c)
            c = np.where((up & (j >= 0))[:, None], np.einsum("tij,tj->ti", F[j], c) + links.translation[j], c)
        self.path = path

    def bends(self, courses: Floats) -> tuple[Bends, float]:
        """Compute the bounds for motions, and the size of the model on them."""
        links, degree = self.model.links, courses.shape[1] - 1
        value, m = np.maximum(links.value, 0), np.where(links.value < 0, 0.0, links.multiplier)
        P = courses[:, :, value]
        w = np.abs(m) * degree * np.abs(np.diff(P, axis=1)).max(axis=1)
        second = np.abs(np.diff(P, n=2, axis=1)).max(axis=1) if degree > 1 else np.zeros_like(w)
        bend = np.abs(m) * degree * (degree - 1) * second
        off = np.abs(m) * self.deviations[value]
        length = np.linalg.norm(links.axis, axis=1)
        slides = links.moves == SLIDES
        far = np.where(slides, length * (np.abs(m * P + links.offset).max(axis=1) + off), 0.0)
        radius = np.broadcast_to(self.radius[self.upper], (len(courses), len(self.upper)))
        curvature, deviation, turned = (np.zeros_like(radius) for _ in range(3))
        # From the lower body to the upper one the radii shrink, so the radius behind the last joint comes first.
        there = self.joint >= 0
        grows = there * (np.where(slides[self.joint], far[:, self.joint], 0.0) + self.away)
        reach = radius[..., None] + np.cumsum(grows, axis=2)
        for k in reversed(range(self.joint.shape[1])):
            j = self.joint[:, k]
            turns, R = there[:, k] & ~slides[j], np.where(slides[j], length[j], reach[:, :, k])
            own = np.where(there[:, k], R, 0.0)
            rate = w[:, j]
            curvature += own * (np.where(turns, rate * rate, 0.0) + 2 * rate * turned + bend[:, j])
            deviation += own * off[j]
            turned = turned + np.where(turns, rate, 0.0)
        shape = (len(courses), -1, 2)
        steps = np.linalg.norm(links.translation, axis=1) + far.max(axis=0, initial=0.0)
        longest = max((steps[path].sum() for path in self.path), default=0.0)
        size = max(1.0, 2 * float(longest + self.radius.max() + np.linalg.norm(_balls(self.model)[0], axis=1).max()))
        return Bends(curvature.reshape(shape), deviation.reshape(shape)), size


def _rotations(wxyz: Floats) -> Floats:
    """Rotations of quaternions, which need not have length 1."""
    from loewner._rotations import rotations_of

    return rotations_of(wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True))


def _balls(model: Model) -> tuple[Floats, Floats]:
    """Compute the balls around the bodies, in the frames of their links, as the format defines them."""
    centers, radii = np.empty((len(model.link), 3)), np.empty(len(model.link))
    start = model.pieces.start.tolist()
    for b in range(len(radii)):
        M, s, rows = model.turn[b], model.shift[b], []
        for piece in range(start[b], start[b + 1]):
            kind, radius, points = int(model.pieces.kind[piece]), model.pieces.radius[piece], model.pieces.points[piece]
            placed, r = points @ M.T + s, radius
            if kind != HULL:
                r = radius + (1.0 if kind == BALL else np.sqrt(2.0)) * np.linalg.norm(M @ points[1:])
                placed = placed[:1]
            rows.append(np.column_stack([placed, np.full(len(placed), r)]))
        own = np.concatenate(rows)
        low, high = (own[:, :3] - own[:, 3:]).min(axis=0), (own[:, :3] + own[:, 3:]).max(axis=0)
        centers[b] = (low + high) / 2
        radii[b] = (np.linalg.norm(own[:, :3] - centers[b], axis=1) + own[:, 3]).max()
    return centers, radii


def written(deviations: Floats, courses: Floats) -> bytes:
    """Write the motions of a proof."""
    head = deviations.astype("<f8").tobytes() + struct.pack("<I", len(courses))
    degree = struct.pack("<B", courses.shape[1] - 1)
    return head + b"".join(degree + course.astype("<f8").tobytes() for course in courses)
