"""Find planes that separate all pairs of bodies along motions: the trees of a proof, see docs/proof-format.md.

The kernel `plane_trees` searches for the planes. This kernel uses no result of the kernel that proved the motions. This
module prepares the input: the pieces of all bodies, which trees may divide, and the joints between the bodies of each
pair.
"""

from __future__ import annotations

import struct
from itertools import chain, pairwise
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from loewner._base._rotations import rotations_of
from loewner._base._validate import Floats, Ints
from loewner._kernels import records
from loewner._kernels.columns import BLOCK, KIND, SURFACE
from loewner._native import entries
from loewner.errors import ConvergenceError
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import contacts
from loewner.robots.proofs.courses import between, configurations
from loewner.robots.proofs.proof_models import AT_END, AT_START, HULL, KINDS, SLIDES, Model, Placed

# Tokens for planes whose normals have 16 bits per coordinate, and for planes with doubles. Token 3 repeats the last
# plane.
NORMAL, DOUBLES = 16, 18

# Room for checkers that compute with enclosures, as a share of the model's size.
ROOM = 2e-11

# Maximum number of nodes, and of normals, in the trees of one motion. These limits make the search end.
MOST_NODES, MOST_NORMALS = 2**20, 2**18

# Columns of the kernel's memory that contain the plane that was last named for a pair. The columns after these contain
# normals to try.
NAMED = slice(4, 8)

# Largest number of times that a motion, or half of a motion, is halved to shorten a contact.
MOST_HALVED = 15

# The kernel multiplies required gaps by a factor above 1, which would lower a negative least distance. For the search,
# negative least distances are therefore raised by the share DEPTH_ROOM.
DEPTH_ROOM = 4e-9

# Joints for the model of two static bodies, which has no robot.
_NONE = np.empty(0, dtype=np.int64)
_NO_TREE = records.Tree(_NONE, _NONE, _NONE, np.empty(0), np.empty(0), np.empty((0, 1)))


class Contact(NamedTuple):
    """A contact in the proof format: the motion, the pair's index, the end, the length 2^-k, and the least distance."""

    motion: int
    pair: int
    end: int
    k: int
    least: float


def trees(
    ready: Problem, model: Model, courses: Floats, deviations: Floats, tolerance: float | None
) -> tuple[list[Contact], bytes]:
    """Make the trees for all motions and pairs, in order, with the contacts that they need.

    Parameters
    ----------
    ready, model, courses, deviations, tolerance
        See `written_proofs.proof_of`.

    Raises
    ------
    ConvergenceError
        If planes that the format can express do not prove a pair to be apart.
    """
    prepared = _known.get(ready)
    if prepared is None:
        links = np.append(model.links.of_robot, -1)[model.bodies.link]  # the world comes after the robot's links
        placed_by = np.where(links < 0, len(ready.robot.link_names), links)
        prepared = _known[ready] = _Prepared(model, ready.robot.tree, placed_by)
    speeds, memory = prepared.speeds(courses, deviations), _Memory.of(model)
    # Motions that are joined are one curve.
    first = np.flatnonzero(np.append(True, (courses[1:, 0] != courses[:-1, -1]).any(axis=1)))
    ruled, touching, all_trees = np.flatnonzero(model.rules), list[Contact](), list[list[bytes]]()
    for low, high in pairwise(sorted({0, len(model.pairs), *ruled.tolist(), *(ruled + 1).tolist()})):
        deeper, group_trees = tolerance if low in ruled else None, list[bytes | Failed]()
        for course, speed in zip(courses, speeds, strict=True):
            tree = prepared.trees(course, speed, ROOM, memory, slice(low, high))
            group_trees.append(tree)
            if isinstance(tree, Failed):
                if deeper is None:
                    break
                memory.state[low, NAMED] = 0.0  # the planes of this tree are not in the file
        for begin, end in pairwise([*first.tolist(), len(courses)]):
            own = slice(begin, end)
            if deeper is not None and any(isinstance(tree, Failed) for tree in group_trees[own]):
                search = _Search(prepared, ready, model, begin, courses[own], speeds[own], low, memory, deeper)
                group_trees[own] = search.with_contacts(group_trees[own], touching)
        touches, off = deeper is not None, bool(deviations.any())
        all_trees.append([_expect_tree(ready, model, k, tree, touches, off) for k, tree in enumerate(group_trees)])
    touching.sort()
    return touching, b"".join(chain.from_iterable(zip(*all_trees, strict=True)))


def _expect_tree(ready: Problem, model: Model, motion: int, tree: bytes | Failed, touches: bool, off: bool) -> bytes:
    """Refuse a pair for which no planes were found."""
    if not isinstance(tree, Failed):
        return tree
    a, b = (ready.names[n] for n in model.pairs[tree.pair])
    why = "they come nearer than the room for rounding that proofs leave"
    if tree.many:
        why = f"the trees would have more than {MOST_NODES} nodes; divide the motion"
    elif touches:
        why = "the planes of their contact, which may get deeper by the tolerance once, do not suffice"
    elif any((ready.packs[n].layout[:, KIND] <= SURFACE).any() for n in model.pairs[tree.pair]):
        why = (
            "a proof contains hulls of parts of surfaces and solids, which reach beyond the parts; links read with "
            'meshes="hull" have none'
        )
    elif off:
        why = "its bound on joint errors is coarser than that of certify_edges; lower joint_error"
    raise ConvergenceError(
        f"proof: expected planes between {a} and {b} all along motion {motion}, found none that a proof can express "
        f"from fraction {tree.low:.6g} to {tree.high:.6g}, although the motion is free: {why}"
    )


def still(model: Model, room: float, normal: Floats | None = None) -> bytes | None:
    """Make the tree for two static bodies, with a gap that exceeds the margin by `room` times the size of the model.

    If `normal` is given, in world axes and from the first body to the second one, it is tried before other normals. If
    planes that the format can express do not separate the bodies, the result is None.
    """
    none = np.empty((1, 2, 0))
    prepared = _Prepared(model, _NO_TREE, np.zeros(2, dtype=np.int64))
    memory = _Memory.of(model)
    if normal is not None:
        memory.state[0, 1:4] = normal @ model.bodies.turn[0]
    tree = prepared.trees(none[0], prepared.speeds(none, none[0, 0])[0], room, memory)
    return None if isinstance(tree, Failed) else written(none[0, 0], none) + tree


class Failed(NamedTuple):
    """A pair without planes, the part of the motion that lacks them, and whether there were too many nodes."""

    pair: int
    low: float
    high: float
    many: bool


class _Memory(NamedTuple):
    """Memory for a proof: the planes that the kernel remembers from motion to motion, and its output."""

    state: Floats
    tokens: NDArray[np.uint8]
    normals: Floats

    @classmethod
    def of(cls, model: Model) -> _Memory:
        """Make the memory for a proof."""
        return cls(np.zeros((len(model.pairs), 8)), np.empty(MOST_NODES, dtype=np.uint8), np.empty((MOST_NORMALS, 3)))


class _Prepared:
    """The input of the kernel that depends on the model alone."""

    def __init__(self, model: Model, tree: records.Tree, placed_by: Ints) -> None:
        links, bodies, (points, pieces, numbers, of_body) = model.links, model.bodies, clusters_of(model.bodies)
        self.links, self.slides = links, np.where(links.moves == SLIDES, np.linalg.norm(links.axis, axis=1), 0.0)
        depth = np.zeros(len(links.above), dtype=np.int64)
        for k, above in enumerate(links.above.tolist()):
            depth[k] = depth[above] + 1 if above >= 0 else 0
        turn = rotations_of(links.quaternion / np.linalg.norm(links.quaternion, axis=1, keepdims=True))
        axis = links.axis / np.maximum(np.linalg.norm(links.axis, axis=1), 1e-300)[:, None]
        joints = np.column_stack([links.moves, self.slides, turn.reshape(-1, 9), links.translation, axis])
        one = records.PlaneModel(
            points, pieces, numbers, np.empty((len(numbers), 9)), np.column_stack([bodies.link, placed_by, of_body]),
            bodies.turn.reshape(-1, 9), np.empty((len(bodies.link), 4)), model.pairs, model.margins,
            np.column_stack([links.above, depth]), joints,
        )  # fmt: skip
        self.model = records.PlaneModel(*map(np.ascontiguousarray, one))
        self.tree = records.Tree(*map(np.ascontiguousarray, tree))
        entries.measure_model(records.table_of(self.model).ctypes.data)

    def speeds(self, courses: Floats, deviations: Floats) -> Floats:
        """Bound speeds, second derivatives, deviations and travel of joints on motions, shape (N, joints, 4)."""
        links, degree = self.links, courses.shape[1] - 1
        m = np.where(links.value < 0, 0.0, np.abs(links.multiplier))
        P = np.pad(courses, ((0, 0), (0, 0), (0, 1)))[:, :, links.value]  # fixed links have the added value 0
        rates = m * degree * np.abs(np.diff(P, axis=1)).max(axis=1)
        bends = m * degree * (degree - 1) * np.abs(np.diff(P, n=2, axis=1)).max(axis=1, initial=0.0)
        off = np.broadcast_to(m * np.append(deviations, 0.0)[links.value], rates.shape)
        far = self.slides * (np.abs(links.multiplier * P + links.offset).max(axis=1) + off)
        return np.ascontiguousarray(np.stack([rates, bends, off, far], axis=2))

    def trees(
        self, course: Floats, speeds: Floats, room: float, memory: _Memory, pairs: slice = slice(None),
        margins: Floats | None = None,
    ) -> bytes | Failed:  # fmt: skip
        """Make the trees of all pairs, or of consecutive pairs, for one motion."""
        own = self.model.margins[pairs] if margins is None else margins
        some = self.model._replace(pairs=self.model.pairs[pairs], margins=own)
        tables = records.table_of(some), records.table_of(self.tree)
        nodes, planes, pair, low, high = entries.plane_trees(
            *(table.ctypes.data for table in tables), np.ascontiguousarray(course), speeds, room, memory.state[pairs],
            memory.tokens, memory.normals,
        )  # fmt: skip
        if pair >= 0:
            return Failed((pairs.start or 0) + pair, low, high, nodes == MOST_NODES or planes == MOST_NORMALS)
        token, normal = memory.tokens[:nodes], memory.normals[:planes]
        size_of = 1 + 6 * (token >= NORMAL) + 18 * (token >= DOUBLES)
        place = np.cumsum(size_of) - size_of
        data = np.zeros(int(size_of.sum()), dtype=np.uint8)
        data[place] = token
        of, named = token >= DOUBLES, token >= NORMAL
        doubles, at = of[named], place[named]
        for chosen, form in ((~doubles, "<i2"), (doubles, "<f8")):
            own = normal[chosen].astype(form).view(np.uint8)
            data[at[chosen][:, None] + np.arange(1, own.shape[1] + 1)] = own
        return data.tobytes()


_known: WeakKeyDictionary[Problem, _Prepared] = WeakKeyDictionary()


# -- contacts ---------------------------------------------------------------------------------


class _Search(NamedTuple):
    """The search for the trees of a pair that may be in contact at an end of a curve, whose first motion is `first`."""

    prepared: _Prepared
    ready: Problem
    model: Model
    first: int
    courses: Floats
    speeds: Floats
    pair: int
    memory: _Memory
    tolerance: float

    def with_contacts(self, trees: list[bytes | Failed], touching: list[Contact]) -> list[bytes | Failed]:
        """Make the missing trees, if contacts suffice, and append the contacts, each as short as possible.

        The contacts of a pair form one stretch from the start of the curve, or one stretch to its end.
        """
        failed = [k for k, tree in enumerate(trees) if isinstance(tree, Failed)]
        rules, middle = int(self.model.rules[self.pair]), -1 if self.model.rules[self.pair] == AT_END else len(trees)
        if rules == AT_START + AT_END:
            whole = contacts.Run.whole(self.courses, np.zeros_like(self.courses[:, 0]))
            middle, _ = contacts.farthest(self.ready, self.pair, whole)
        touches = {
            end: self._touch(end, count)
            for end, count in enumerate((min(failed[-1], middle) + 1, len(trees) - max(failed[0], middle)))
            if rules & (AT_START, AT_END)[end]
        }
        pair_contacts, start, end = list[Contact](), [(0.0, 1.0, 0)], [(0.0, 1.0, 1)]
        halves = [(0.0, 0.5, 0), (0.5, 1.0, 1)]
        for k in failed:
            # In the motion between the two contacts, either each half is in contact at its outer end, or the whole
            # motion is in contact at one end.
            for way in [halves, start, end] if k == middle else [start] if k < middle else [end]:
                new = list[Contact]()
                part_trees = [self._part(k, *part, touches[part[2]], new) for part in way]
                done = [tree for tree in part_trees if not isinstance(tree, Failed)]
                if len(done) == len(part_trees):
                    pair_contacts += new
                    trees[k] = b"\0" * (len(part_trees) - 1) + b"".join(done)
                    break
            else:
                return trees
        self.memory.state[self.pair, NAMED] = 0.0  # planes were not named in the order of the file
        # A contact lasts from the start of the curve to its last motion in contact, or from its first motion in contact
        # to the end.
        ends = {end: [contact for contact in pair_contacts if contact.end == end] for end in (0, 1)}
        for last in ends[0][-1:]:
            touching += [last._replace(motion=k, k=0) for k in range(self.first, last.motion)] + [last]
        for last in ends[1][:1]:
            after = range(last.motion + 1, self.first + len(trees))
            touching += [last] + [last._replace(motion=k, k=0) for k in after]
        return trees

    def _touch(self, end: int, count: int) -> tuple[float, Floats]:
        """Return the least distance for a contact of `count` motions at an end, and normals for the kernel."""
        places = np.append(0.0, count * contacts.STRETCHES[::-1])
        places = len(self.courses) - places if end else places
        k = np.minimum(places.astype(np.int64), len(self.courses) - 1)
        Q = configurations(self.ready.robot, self.courses[k], places - k)
        at_end = contacts.distance_at(self.ready, self.pair, Q[0])
        normals = contacts.contact_normals(self.ready.in_small_parts, self.pair, Q, self.tolerance)
        at = np.unique(normals.round(12), axis=0, return_index=True)[1]
        least = min(at_end, float(self.model.margins[self.pair])) - self.tolerance
        return least, np.column_stack([np.ones(len(at)), normals[at]])

    def _part(
        self, k: int, low: float, high: float, end: int, touch: tuple[float, Floats], made: list[Contact]
    ) -> bytes | Failed:
        """Make the tree of a part of a motion, with a contact at one end of the part if necessary."""
        whole = self._tree(k, low, high)
        least, normals = touch
        if not isinstance(whole, Failed) or len(normals) == 0:  # nothing touches
            return whole
        # Split off halves at the other end, as long as they keep the margin.
        rest, width = list[bytes](), high - low
        while len(rest) < MOST_HALVED:
            width /= 2.0
            half = (high - 2.0 * width, high - width) if end else (low + width, low + 2.0 * width)
            tree = self._tree(k, *half)
            if isinstance(tree, Failed):
                break
            rest.append(tree)
        width = (high - low) * 0.5 ** len(rest)
        tree = self._tree(k, *((high - width, high) if end else (low, low + width)), least, normals)
        if isinstance(tree, Failed):
            return tree
        made.append(Contact(self.first + k, self.pair, end, round(-np.log2(width)), least))
        return b"".join([b"\0" + half for half in rest] + [tree] if end else [b"\0" * len(rest), tree, *rest[::-1]])

    def _tree(
        self, k: int, low: float, high: float, least: float | None = None, normals: Floats | None = None
    ) -> bytes | Failed:  # fmt: skip
        """Make the tree of a part of a motion, with the margin of the pair or with another distance."""
        width, one = high - low, self.courses[k : k + 1]
        (course,) = between(self.ready.robot, one, np.array([low]), np.array([high]))
        memory, margins = self.memory, None
        memory.state[self.pair, NAMED] = 0.0
        if least is not None and normals is not None:
            state = np.append(memory.state, np.tile(normals.ravel(), (len(memory.state), 1)), axis=1)
            memory, margins = memory._replace(state=state), np.array([least + DEPTH_ROOM * abs(least)])
        speeds, alone = self.speeds[k] * [width, width * width, 1.0, 1.0], slice(self.pair, self.pair + 1)
        tree = self.prepared.trees(course, speeds, ROOM, memory, alone, margins)
        if isinstance(tree, Failed):
            return tree._replace(low=low + width * tree.low, high=low + width * tree.high)
        return tree


# -- shapes -----------------------------------------------------------------------------------


def clusters_of(bodies: Placed) -> tuple[Floats, Floats, Ints, Ints]:
    """Place the pieces of all bodies, and divide the pieces of each body repeatedly.

    Returns
    -------
    points : ndarray
        Corners of hulls in the frame of the link, and the radius around each, in blocks of eight columns with four
        rows.
    pieces : ndarray, shape (P, 14)
        Kind, radius, center and factor of each piece in the frame of its link; the last two only for curved pieces.
    numbers : ndarray of int64, shape (C, 7)
        For each cluster of consecutive pieces: the first piece and the index after the last one; the two halves, or -1
        for a single piece; the columns of `points` where its corners begin and end; and the number of its curved
        pieces.
    of_body : ndarray of int64
        The cluster of all pieces of each body.
    """
    start, pieces = bodies.pieces.start, bodies.pieces
    body_of = np.repeat(np.arange(len(start) - 1), np.diff(start))
    curved = pieces.kind != HULL
    counts = np.array([0 if other else len(points) for points, other in zip(pieces.points, curved, strict=True)])
    begin = np.append(0, np.cumsum(counts))
    # Blocks of eight corners, each filled up with repeats of the last corner.
    filled = -(-counts // BLOCK) * BLOCK
    column = np.append(0, np.cumsum(filled))
    piece = np.repeat(np.arange(len(counts)), filled)
    rows = np.minimum(np.arange(column[-1]) - (column - begin)[piece], begin[1:][piece] - 1)
    corners = np.concatenate([*(pieces.points[k] for k in np.flatnonzero(~curved)), np.empty((0, 3))])[rows]
    owner = body_of[piece]
    placed = np.einsum("vij,vj->vi", bodies.turn[owner], corners) + bodies.shift[owner]
    points = records.aligned(4 * len(rows))
    points[:] = np.column_stack([placed, pieces.radius[piece]]).reshape(-1, BLOCK, 4).transpose(0, 2, 1).ravel()
    table = np.zeros((len(counts), 14))
    table[:, 0], table[:, 1] = np.array(KINDS)[pieces.kind], pieces.radius
    at = np.flatnonzero(curved)
    if len(at):
        own, M = np.stack([pieces.points[k] for k in at]), bodies.turn[body_of[at]]
        table[at, 2:5] = np.einsum("kij,kj->ki", M, own[:, 0]) + bodies.shift[body_of[at]]
        table[at, 5:] = (M @ own[:, 1:]).reshape(-1, 9)
    clusters, of_body = list[tuple[int, int, int, int]](), []
    for first, last in pairwise(start.tolist()):
        k = len(clusters)
        of_body.append(k)
        ranges = [(first, last)]
        for low, high in ranges:
            halves = -1, -1
            if high - low > 1:
                middle = low + (high - low) // 2
                halves = k + len(ranges), k + len(ranges) + 1
                ranges += [(low, middle), (middle, high)]
            clusters.append((low, high, *halves))
    low, high, left, right = np.array(clusters, dtype=np.int64).reshape(-1, 4).T
    many = np.append(0, np.cumsum(curved))
    numbers = np.column_stack([low, high, left, right, column[low], column[high], many[high] - many[low]])
    return points, table, numbers, np.array(of_body, dtype=np.int64)


def written(deviations: Floats, courses: Floats) -> bytes:
    """Write the motions of a proof."""
    head = deviations.astype("<f8").tobytes() + struct.pack("<I", len(courses))
    degree = struct.pack("<B", courses.shape[1] - 1)
    return head + b"".join(degree + course.astype("<f8").tobytes() for course in courses)


def written_contacts(model: Model, touching: list[Contact]) -> bytes:
    """Write the contacts of a proof; without rules in the model, the result is empty."""
    rows = [struct.pack("<3I2Bd", k, *model.pairs[pair].tolist(), *rest) for k, pair, *rest in touching]
    return struct.pack("<I", len(rows)) + b"".join(rows) if model.rules.any() else b""
