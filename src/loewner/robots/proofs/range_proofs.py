"""Write proofs that pairs are never nearer than a margin, for ranges of joint values; see docs/proof-format.md.

The box of all values of the joints between two bodies is halved until a plane separates the bodies in each part. The
plane is perpendicular to the shortest connection between the bodies at the center of the box, and is checked at the
box's corners. Boxes are examined in batches, in floating point, with room for the checkers' rounding.
"""

from __future__ import annotations

import itertools
import struct
from typing import NamedTuple

import numpy as np

from loewner._base._rotations import rotations_of
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns as kernel_columns
from loewner.bodies import CURVED, Body, bodies_of
from loewner.bodies.pack import some
from loewner.errors import ConvergenceError, InputError
from loewner.queries import pairs as queries
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs.proof_models import FARTHEST, HULL, KINDS, LARGEST, SLIDES, STAYS, TURNS, Links, Model
from loewner.robots.proofs.written_proofs import FARTHEST_TURN, RANGES, VERSION, Proof, assembled

# Largest size of a file [bytes], and largest number of products of a point and a normal that checkers compute.
MOST_BYTES, MOST_WORK = 5_000_000, 2**29

# MOST_NODES limits the nodes in the trees of all pairs together, and DEEPEST limits the levels of a tree. MOST_HALVED
# limits the halvings of a side, so that the ends of its parts are exact doubles.
MOST_NODES, DEEPEST, MOST_HALVED = 2**19, 64, 48

# Maximum number of corners that are examined at a time, and maximum number of sides of a box. Planes are checked at all
# corners.
AT_ONCE, MOST_SIDES = 4096, 8

# Room for checkers that compute with enclosures: shares of the terms of the condition, and of the model's size.
OF_TERMS, OF_SIZE = 2e-9, 2e-11

# A plane is written with 16 bits per coordinate if the gap exceeds the margin by the share COARSE of the bodies' size.
# The normal then has the length LONGEST.
COARSE, LONGEST = 3e-4, 32767

# Pieces are divided if the plane of the nearest points leaves less room than the share OF_ROOM of the gap between the
# bodies.
OF_ROOM = 0.5

# Tokens for a halved box, for the last plane again, and for planes with 16 bits per coordinate and with doubles.
HALVED, LAST, NORMAL, DOUBLES = 0, 3, 16, 18


class Claim(NamedTuple):
    """Two bodies, as indices in the model; their margin; and the columns of the joints between them, with ranges."""

    pair: tuple[int, int]
    margin: float
    columns: Ints
    lower: Floats
    upper: Floats


def proof_of_ranges(model: Model, ready: Problem, claims: list[Claim]) -> Proof:
    """Write the proof of pairs that are NEVER nearer than their margins.

    Parameters
    ----------
    model : Model
        The problem's model; see `proof_models.model_of`.
    ready : Problem
    claims : list of Claim

    Raises
    ------
    InputError
        If a body of a pair has a surface, a joint turns too far, there are too many joint values between two bodies, or
        the file would be larger than `MOST_BYTES`.
    ConvergenceError
        If the bounds of the format do not suffice because a pair comes too close to its margin.
    """
    blocks, nodes, work = [struct.pack("<I", len(claims))], 0, 0
    for claim in sorted(claims, key=lambda claim: claim.pair):
        names = " and ".join(ready.names[k] for k in claim.pair)
        _refuse(ready, claim, names)
        search = _Search(model, ready, claim, names, MOST_NODES - nodes, MOST_WORK - work)
        tree = search.tree()
        nodes, work = nodes + search.nodes, work + search.work
        ends = np.column_stack([search.lower, search.upper])
        blocks += [struct.pack("<IId", *claim.pair, claim.margin), ends.astype("<f8").tobytes(), tree]
    block = b"".join(blocks)
    if len(block) + len(model.data) > MOST_BYTES:
        raise InputError(
            f"proof: expected a file of at most {MOST_BYTES} bytes, found {len(block) + len(model.data)}; prove fewer "
            "pairs at a time, or narrower ranges"
        )
    return assembled(RANGES, model.data, block, VERSION)


def _refuse(ready: Problem, claim: Claim, names: str) -> None:
    """Refuse pairs that cannot be written."""
    if any((ready.packs[k].layout[:, kernel_columns.KIND] <= kernel_columns.SURFACE).any() for k in claim.pair):
        raise InputError(
            f"proof: expected bodies of convex pieces, found a surface in {names}; a robot that is read with "
            'meshes="hull" has hulls, which hold its meshes'
        )
    if not (np.abs([claim.lower, claim.upper]) < LARGEST).all():
        raise InputError(f"proof: expected ranges below {LARGEST:g}, found others for {names}")


# -- the joints between two bodies ------------------------------------------------------------


def _path(links: Links, a: int, b: int) -> tuple[list[int], list[int]]:
    """Return the links from each of two links up to their nearest common link, which is left out."""
    ups: tuple[list[int], list[int]] = ([], [])
    while a != b:  # a link comes after the link above it
        ups[a < b].append(max(a, b))
        a, b = (int(links.above[k]) if k == max(a, b) else k for k in (a, b))
    return ups


class _Joints:
    """The joints between two bodies: poses of one body seen from the other, and bounds on their motion."""

    def __init__(self, model: Model, claim: Claim) -> None:
        self.links, self.claim = model.links, claim
        self.paths = _path(model.links, *(int(model.bodies.link[k]) for k in claim.pair))
        links = model.links
        moving = [k for k in itertools.chain(*self.paths) if links.moves[k] != STAYS and links.multiplier[k] != 0.0]
        self.values = np.array(sorted({int(links.value[k]) for k in moving}), dtype=np.int64)
        self.place = {int(value): k for k, value in enumerate(self.values)}
        at = np.searchsorted(claim.columns, self.values)
        self.lower, self.upper = claim.lower[at], claim.upper[at]
        unit = links.quaternion / np.linalg.norm(links.quaternion, axis=1, keepdims=True)
        self.turn, self.length = rotations_of(unit), np.linalg.norm(links.axis, axis=1)
        for k in moving:
            if links.moves[k] == TURNS and self.far(k) > FARTHEST_TURN:
                raise InputError(f"proof: expected joints that turn to {FARTHEST_TURN:g} rad at most, found others")

    def far(self, k: int) -> float:
        """Return the largest absolute value of a joint."""
        m, f = float(self.links.multiplier[k]), float(self.links.offset[k])
        at = self.place.get(int(self.links.value[k]))
        return abs(f) if at is None else max(abs(m * self.lower[at] + f), abs(m * self.upper[at] + f))

    def _local(self, k: int, Q: Floats) -> tuple[Floats, Floats]:
        """Return the pose of a link in the frame of the link above."""
        links, F, t = self.links, self.turn[k], self.links.translation[k]
        if links.moves[k] == STAYS:
            return np.broadcast_to(F, (len(Q), 3, 3)), np.broadcast_to(t, (len(Q), 3))
        at = self.place.get(int(links.value[k]))
        v = links.offset[k] + (0.0 if at is None else links.multiplier[k] * Q[:, at]) + np.zeros(len(Q))
        if links.moves[k] == SLIDES:
            return np.broadcast_to(F, (len(Q), 3, 3)), t + v[:, None] * (F @ links.axis[k])
        x, y, z = e = links.axis[k] / self.length[k]
        cross, outer = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]), np.outer(e, e)
        s, c = np.sin(v)[:, None, None], np.cos(v)[:, None, None]
        return F @ (c * np.eye(3) + s * cross + (1.0 - c) * outer), np.broadcast_to(t, (len(Q), 3))

    def seen(self, Q: Floats) -> tuple[Floats, Floats]:
        """Return the rotation and the place of the second body's link in the frame of the first body's link."""
        poses = []
        for path in self.paths:
            turn, shift = np.tile(np.eye(3), (len(Q), 1, 1)), np.zeros((len(Q), 3))
            for k in reversed(path):
                own, step = self._local(k, Q)
                turn, shift = turn @ own, shift + np.einsum("nij,nj->ni", turn, step)
            poses.append((turn, shift))
        (one, start), (other, end) = poses
        return np.swapaxes(one, 1, 2) @ other, np.einsum("nji,nj->ni", one, end - start)

    def bends(self, lower: int, center: Floats, radius: float) -> Floats:
        """Bound second derivatives, with respect to each value, of points in a ball on the upper body."""
        links, passed = self.links, list[tuple[int, float]]()
        for path, upward in ((self.paths[1 - lower], True), (self.paths[lower][::-1], False)):
            for k in path:
                F, t = self.turn[k], links.translation[k]
                if not upward:
                    center = F.T @ (center - t)
                if links.moves[k] == TURNS:
                    e = links.axis[k] / self.length[k]
                    foot = (center @ e) * e
                    center, radius = foot, radius + float(np.linalg.norm(center - foot))
                    passed.append((k, radius))
                elif links.moves[k] == SLIDES:
                    radius += self.length[k] * self.far(k)
                    passed.append((k, self.length[k]))
                if upward:
                    center = t + F @ center
        bends, turned = np.zeros((2, len(self.values)))
        for k, reach in reversed(passed):
            at, m = self.place.get(int(links.value[k])), abs(float(links.multiplier[k]))
            if at is not None:
                turns = m if links.moves[k] == TURNS else 0.0
                bends[at] += reach * m * (turns + 2.0 * turned[at])
                turned[at] += turns
        return bends

    def size(self, link: int) -> float:
        """Return the length of the chain from the world to a link, including slides."""
        total = 0.0
        while link >= 0:
            slide = self.length[link] * self.far(link) if self.links.moves[link] == SLIDES else 0.0
            total += float(np.linalg.norm(self.links.translation[link])) + slide
            link = int(self.links.above[link])
        return total


# -- shapes -----------------------------------------------------------------------------------


class _Shape:
    """The pieces of a body in the frame of its link, and the ball about them."""

    def __init__(self, model: Model, ready: Problem, body: int) -> None:
        bodies, pieces = model.bodies, model.bodies.pieces
        first, last = pieces.start[body : body + 2].tolist()
        M, s, self.pack, self.turn = bodies.turn[body], bodies.shift[body], ready.packs[body], bodies.turn[body]
        self.shift, self.count = s, last - first
        self.kind, self.radius, own = (a[first:last] for a in (pieces.kind, pieces.radius, pieces.points))
        self.points = [
            (points if kind == HULL else points[:1]) @ M.T + s for kind, points in zip(self.kind, own, strict=True)
        ]
        self.factor = [None if kind == HULL else M @ points[1:] for kind, points in zip(self.kind, own, strict=True)]
        radii = np.concatenate([
            np.full(len(points), r + (0.0 if G is None else FARTHEST[kind] * np.linalg.norm(G)))
            for points, r, kind, G in zip(self.points, self.radius, self.kind, self.factor, strict=True)
        ])  # fmt: skip
        points = np.concatenate(self.points)
        low, high = (points - radii[:, None]).min(axis=0), (points + radii[:, None]).max(axis=0)
        self.center = (low + high) / 2
        self.reach = float((np.linalg.norm(points - self.center, axis=1) + radii).max())
        self.size = float(np.linalg.norm(self.center)) + self.reach
        self.bodies = dict[tuple[int, int], Body]()

    def body(self, part: tuple[int, int]) -> Body:
        """Return consecutive pieces as a body."""
        if part not in self.bodies:
            pieces, starts = np.arange(*part), np.array([0, part[1] - part[0]])
            self.bodies[part] = bodies_of(some(self.pack, pieces, starts).packed())[0]
        return self.bodies[part]

    def cost(self, part: tuple[int, int]) -> int:
        """Count the products that a checker computes for the given pieces."""
        return sum(len(points) + 5 for points in self.points[part[0] : part[1]])

    def support(self, part: tuple[int, int], n: Floats) -> Floats:
        """Return the largest product of each normal with a point of the given pieces."""
        norm, best = np.linalg.norm(n, axis=1), np.full(len(n), -np.inf)
        for k in range(*part):
            far, G = (n @ self.points[k].T).max(axis=1) + self.radius[k] * norm, self.factor[k]
            if G is not None:
                far += CURVED[KINDS[self.kind[k]]].support(n @ G)
            np.maximum(best, far, out=best)
        return best


# -- the search -------------------------------------------------------------------------------


class _Boxes(NamedTuple):
    """Boxes with the same pieces.

    Attributes
    ----------
    node : ndarray of int64
        The node of the tree.
    at, halvings : ndarray, shape (n, values)
        A side reaches from `at` to `at` + 2^-`halvings`, as shares of the range.
    plane : ndarray of int64
        The plane that was best for the box above, or -1.
    """

    node: Ints
    at: Floats
    halvings: Ints
    plane: Ints

    def some(self, which: Ints | Bools | slice) -> _Boxes:
        """Return some of the boxes."""
        return _Boxes(self.node[which], self.at[which], self.halvings[which], self.plane[which])


Part = tuple[int, int]
Parts = tuple[Part, Part]
Level = dict[Parts, list[_Boxes]]


class _Search:
    """The search for the tree of a pair."""

    def __init__(self, model: Model, ready: Problem, claim: Claim, names: str, most: int, most_work: int) -> None:
        self.joints, self.claim, self.names = _Joints(model, claim), claim, names
        self.most, self.most_work = most, most_work
        self.lower, self.upper = self.joints.lower, self.joints.upper
        self.width = self.upper - self.lower
        self.shapes = [_Shape(model, ready, k) for k in claim.pair]
        self.bends = [self.joints.bends(low, shape.center, shape.reach) for low, shape in enumerate(self.shapes[::-1])]
        chain = max(self.joints.size(int(model.bodies.link[k])) for k in claim.pair)
        self.room = OF_SIZE * max(1.0, chain + max(shape.size for shape in self.shapes))
        self.sides = np.flatnonzero(self.width > 0)
        if len(self.sides) > MOST_SIDES:
            raise InputError(
                f"proof: expected at most {MOST_SIDES} values with a range between two bodies, found {len(self.sides)} "
                f"between {names}"
            )
        # For each node: its token, the value across which it is halved, its plane, and the first of its two parts.
        self.kind, self.value, self.plane, self.part = ([0] for _ in range(4))
        self.planes: list[tuple[int, Floats, bool]] = []  # the lower body, the normal, and whether it has doubles
        self.work = 0

    @property
    def nodes(self) -> int:
        """The number of nodes of the tree."""
        return len(self.kind)

    def tree(self) -> bytes:
        """Make the tree, level by level."""
        count = len(self.lower)
        first = _Boxes(np.zeros(1, np.int64), np.zeros((1, count)), np.zeros((1, count), np.int64), np.full(1, -1))
        level: Level = {((0, self.shapes[0].count), (0, self.shapes[1].count)): [first]}
        for _ in range(DEEPEST):
            below: Level = {}
            for parts, rows in level.items():
                boxes = _Boxes(*(np.concatenate(arrays) for arrays in zip(*rows, strict=True)))
                at_once = AT_ONCE >> len(self.sides)
                for begin in range(0, len(boxes.node), at_once):
                    self._examine(boxes.some(slice(begin, begin + at_once)), parts, below)
            if not below:
                return self._written()
            level = below
        raise self._too_near("its tree would be too deep")

    def _too_near(self, why: str) -> ConvergenceError:
        return ConvergenceError(
            f"proof: expected planes between {self.names} over all of the ranges, found none that a proof can hold, "
            f"although they are never nearer than {self.claim.margin:g} m: {why}"
        )

    def _examine(self, boxes: _Boxes, parts: Parts, below: Level) -> None:
        """Find planes for boxes, and divide the boxes that have no plane."""
        boxes = self._with_known_planes(boxes, parts)
        if len(boxes.node) == 0:
            return
        share = boxes.at + np.ldexp(0.5, -boxes.halvings)
        turn, shift = self.joints.seen(self.lower + share * self.width)
        gap, normal = self._nearest(parts, turn, shift)
        if not gap.min() > (1.0 + OF_TERMS) * self.claim.margin + self.room:
            raise self._too_near("they come nearer than the room for rounding that proofs leave")
        size = max(shape.size for shape in self.shapes)
        fine = gap - self.claim.margin < COARSE * size
        room, takes = np.full(len(gap), -np.inf), np.zeros(boxes.at.shape)
        done, tried = np.zeros(len(gap), dtype=bool), np.full(len(gap), -1)
        for low in (0, 1):
            away = normal if low == 0 else -np.einsum("nji,nj->ni", turn, normal)
            directions = away @ self.shapes[low].turn
            directions = np.where(fine[:, None], directions, np.rint(LONGEST * directions))
            holds, left, sides = self._conditions(boxes, parts, low, directions)
            better = (left > room) & ~done
            room, takes = np.where(better, left, room), np.where(better[:, None], sides, takes)
            for k in np.flatnonzero(better | (holds & ~done)).tolist():
                tried[k] = len(self.planes)
                self.planes.append((low, directions[k], bool(fine[k])))
                if holds[k]:
                    self._leaf(int(boxes.node[k]), int(tried[k]), parts)
            done |= holds
        rest = boxes._replace(plane=tried).some(~done)
        self._divide(rest, parts, below, gap[~done] - self.claim.margin, room[~done], takes[~done])

    def _with_known_planes(self, boxes: _Boxes, parts: Parts) -> _Boxes:
        """Prove boxes with the planes of the boxes above them, and return the remaining boxes."""
        rows = np.flatnonzero(boxes.plane >= 0)
        left = np.ones(len(boxes.node), dtype=bool)
        frames = np.array([self.planes[k][0] for k in boxes.plane[rows].tolist()], dtype=np.int64)
        for low in (0, 1):
            at = rows[frames == low]
            if len(at):
                directions = np.stack([self.planes[k][1] for k in boxes.plane[at].tolist()])
                holds, *_ = self._conditions(boxes.some(at), parts, low, directions)
                for k in at[holds].tolist():
                    self._leaf(int(boxes.node[k]), int(boxes.plane[k]), parts)
                left[at] = ~holds
        return boxes.some(left)

    def _leaf(self, node: int, plane: int, parts: Parts) -> None:
        """Make a node a leaf."""
        self.kind[node], self.plane[node] = LAST, plane
        cost = 100 + sum(shape.cost(part) for shape, part in zip(self.shapes, parts, strict=True))
        self.work += (cost + 50 * sum(map(len, self.joints.paths))) * (1 + 2 ** len(self.sides))

    def _nearest(self, parts: Parts, turn: Floats, shift: Floats) -> tuple[Floats, Floats]:
        """Return distances and normals, from the first body to the second, in the frame of the first body's link."""
        poses = np.tile(np.eye(4), (2, len(turn), 1, 1))
        poses[0, :, :3, :3], poses[0, :, :3, 3] = self.shapes[0].turn, self.shapes[0].shift
        poses[1, :, :3, :3] = turn @ self.shapes[1].turn
        poses[1, :, :3, 3] = shift + turn @ self.shapes[1].shift
        one, other = (shape.body(part) for shape, part in zip(self.shapes, parts, strict=True))
        try:
            gaps = queries.distance(one, poses[0], other, poses[1], exact=True)
        except ConvergenceError as error:
            raise self._too_near("their distance is not computed") from error
        return np.asarray(gaps.distance), np.asarray(gaps.normal)

    def _conditions(self, boxes: _Boxes, parts: Parts, low: int, given: Floats) -> tuple[Bools, Floats, Floats]:
        """Check the conditions of planes over boxes.

        Return whether each plane satisfies its condition, the room that the plane leaves at the center of its box, and
        the room that each side of the box takes.
        """
        lower, count = self.shapes[low], len(given)
        n = given @ lower.turn.T
        norm = np.linalg.norm(n, axis=1)
        base = lower.support(parts[low], n) / norm + self.room + (1.0 + OF_TERMS) * self.claim.margin
        side = np.ldexp(1.0, -boxes.halvings)
        takes = (1.0 + OF_TERMS) * self.bends[low] * (side * self.width) ** 2 / 8
        room = self._least(parts, low, n, norm, boxes.at + side / 2) - base
        ends = np.array(list(itertools.product((0.0, 1.0), repeat=len(self.sides))))
        corners = np.repeat(boxes.at[:, None], len(ends), axis=1)
        corners[:, :, self.sides] += ends * side[:, None, self.sides]
        many = np.repeat(n, len(ends), axis=0), np.repeat(norm, len(ends)), corners.reshape(-1, side.shape[1])
        g = self._least(parts, low, *many).reshape(count, len(ends))
        holds = g.min(axis=1) - base > takes.sum(axis=1)
        for k, across in enumerate(self.sides.tolist()):
            two = g.reshape(count, 2**k, 2, -1)
            takes[:, across] += np.abs(two[:, :, 1] - two[:, :, 0]).max(axis=(1, 2)) / 2
        return holds, room, takes

    def _least(self, parts: Parts, low: int, n: Floats, norm: Floats, share: Floats) -> Floats:
        """Return the least product of each normal, divided by its length, with a point of the upper pieces."""
        turn, shift = self.joints.seen(self.lower + share * self.width)
        if low == 0:
            back, away = np.einsum("nji,nj->ni", turn, n), np.einsum("ni,ni->n", n, shift)
        else:
            back = np.einsum("nij,nj->ni", turn, n)
            away = -np.einsum("ni,ni->n", back, shift)
        return np.asarray((away - self.shapes[1 - low].support(parts[1 - low], -back)) / norm)

    def _divide(self, boxes: _Boxes, parts: Parts, below: Level, gap: Floats, room: Floats, takes: Floats) -> None:
        """Halve boxes across a value, or divide their pieces."""
        if len(boxes.node) == 0:
            return
        if self.nodes + 2 * len(boxes.node) > self.most or self.work > self.most_work:
            raise InputError(
                f"proof: expected a file of at most {MOST_BYTES} bytes, found that {self.names} take more over these "
                "ranges; prove a smaller margin, fewer pairs or narrower ranges"
            )
        counts = [last - first for first, last in parts]
        pieces = (room < OF_ROOM * gap) & (max(counts) > 1)
        if not pieces.all() and len(self.sides) == 0:
            raise self._too_near("they come nearer than the room for rounding that proofs leave")
        self.work += 2000 * sum(map(len, self.joints.paths)) * len(boxes.node)
        which = int(counts[1] > counts[0])
        for node, divided in zip(boxes.node.tolist(), pieces.tolist(), strict=True):
            self.kind[node], self.part[node] = 1 + which if divided else HALVED, self.nodes
            for array, new in ((self.kind, 0), (self.value, 0), (self.plane, -1), (self.part, -1)):
                array += [new, new]
        children = np.array([self.part[node] for node in boxes.node.tolist()])
        if pieces.any():
            first, last = parts[which]
            middle = first + (last - first) // 2
            for number, half in enumerate(((first, middle), (middle, last))):
                key = (half, parts[1]) if which == 0 else (parts[0], half)
                own = boxes.some(pieces)._replace(node=children[pieces] + number)
                below.setdefault(key, []).append(own)
        halved = np.flatnonzero(~pieces)
        if len(halved) == 0:
            return
        side = self.sides[takes[halved][:, self.sides].argmax(axis=1)]
        for k, value in zip(halved.tolist(), side.tolist(), strict=True):
            self.value[boxes.node[k]] = value
        one, row = boxes.some(halved), np.arange(len(halved))
        if one.halvings.max() >= MOST_HALVED:
            raise self._too_near("its tree would be too deep")
        halvings, other = one.halvings.copy(), one.at.copy()
        halvings[row, side] += 1
        other[row, side] += np.ldexp(1.0, -halvings[row, side])
        for number, at in enumerate((one.at, other)):
            below.setdefault(parts, []).append(_Boxes(children[halved] + number, at, halvings, one.plane))

    # -- bytes --------------------------------------------------------------------------------

    def _written(self) -> bytes:
        """Write the tree; a plane that equals the previous plane is not named again."""
        data, last, rest = list[bytes](), -1, [0]
        while rest:
            node = rest.pop()
            kind = self.kind[node]
            if kind < LAST:
                data.append(struct.pack("<BB", kind, self.value[node]) if kind == HALVED else struct.pack("<B", kind))
                rest += [self.part[node] + 1, self.part[node]]
                continue
            if self.plane[node] != last:
                last = self.plane[node]
                low, direction, fine = self.planes[last]
                token = (DOUBLES if fine else NORMAL) + low
                numbers = direction.tolist() if fine else [int(x) for x in direction]
                data.append(struct.pack("<B3d" if fine else "<B3h", token, *numbers))
            else:
                data.append(struct.pack("<B", LAST))
        return b"".join(data)
