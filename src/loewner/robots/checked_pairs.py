"""The pairs of a robot and a scene that can meet at all, and their arrays, through which the kernel walks.

Work that is the same for every query is done here, once: names, pairs, margins, balls about moving bodies, and bounds
and ellipsoids of static bodies in world coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner import _archives, _validate
from loewner._kept import kept
from loewner._kernels import columns, records, tolerances
from loewner._kernels.records import MotionTables
from loewner._native import entries, singles
from loewner._validate import Bools, Floats, Ints, Pair
from loewner.bodies import Bodies, Body, Packed
from loewner.bodies.layout import arrays_of, starts
from loewner.bodies.pack import ranges
from loewner.bodies.parts import in_parts
from loewner.errors import InputError, UnknownNameError
from loewner.robots.motion_tables import motion_tables
from loewner.robots.robot import Robot
from loewner.scenes import Scene

# An allowance for rounding, and for what a pose that is accepted as rigid may stretch lengths by.
STRETCH = 1 + 4 * tolerances.ROTATION_TOLERANCE

# Pairs that are worth preparing: some two gigabytes of arrays, and minutes for each configuration that is not free.
MOST_PAIRS = 2**24

# Configurations a thread takes at a time, at least: about half a millisecond of work.
LEAST_SHARE = 512

# Configurations whose poses are made at a time: of a hundred bodies, they take 13 MB.
IN_TURN = 1024

# Poses of bodies at most, of all those configurations together: 100 MB.
POSES_AT_ONCE = 2**20 * 3 // 4

# Entries of a symmetric matrix in the order of the kernels, and back.
_UPPER = np.triu_indices(3)
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class PreparedMotions(NamedTuple):
    """The additional input of the kernel that proves motions.

    Attributes
    ----------
    tables : MotionTables
    handle : int
        Addresses of the arrays, for the kernel; valid as long as this object lives.
    memory : int
        Scratch bytes for the kernel.
    table : ndarray
        The arrays to which the handle points.
    """

    tables: MotionTables
    handle: int
    memory: int
    table: Ints


class OfMargin(NamedTuple):
    """Pairs with the same margin, as `loewner._settle.settle` takes them."""

    margin: float
    at: Ints  # their places among all
    plan: Ints
    rows: Ints


@dataclass(frozen=True, eq=False)
class CheckedPairs:
    """The pairs to check, at one state of the scene, with the arrays for the kernel; made by `prepared`.

    Attributes
    ----------
    robot : Robot
    version, structure_version : int
        Versions of the scene to which this belongs.
    names : tuple of str
        Names of all bodies: first the bodies that move with links, then the static ones.
    bodies : Bodies
        The bodies in the same order, packed; moving bodies in the frame of their link.
    link, balls, pairs, margins, order, standing, standing_rows, standing_poses : ndarray
        See `pack.problem_of`.
    leaving, reaching : ndarray of bool, shape (pairs,)
        Pairs that may be in contact where a motion starts, or ends: see `Scene.leave` and `Scene.reach`.
    hits : ndarray of int64, shape (pairs,)
        Number of collisions found, by pair. Threads may lose each other's counts, which only determine the order of
        pairs.
    handle : int
        Addresses of the arrays, for the kernel; valid as long as this object lives.
    memory : int
        Scratch bytes to which the kernel writes.
    single : object
        Queries of one configuration or motion, see `loewner._native.singles`.
    taken : dict of int to Body
        Bodies that were requested separately, by index; see `body`.
    """

    robot: Robot
    version: int
    structure_version: int
    names: tuple[str, ...]
    bodies: Bodies
    link: Ints
    balls: Floats
    pairs: Ints
    margins: Floats
    leaving: Bools
    reaching: Bools
    order: Ints
    standing: NDArray[np.float32]
    standing_rows: NDArray[np.float32]
    standing_poses: Floats
    hits: Ints
    taken: dict[int, Body] = field(default_factory=dict, repr=False)
    handle: int = field(init=False)
    memory: int = field(init=False)
    single: Any = field(init=False, repr=False)
    _table: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        arrays = (
            *self.robot.tree, self.link, self.balls, self.pairs, self.margins, self.order,
            self.standing, self.standing_rows, self.standing_poses,
        )  # fmt: skip
        table = records.table_of(arrays)
        object.__setattr__(self, "_table", table)
        object.__setattr__(self, "handle", table.ctypes.data)
        memory = entries.memory_size(self.bodies._packed.handle, self.handle, self.robot.dof)
        object.__setattr__(self, "memory", memory)
        held = table, arrays, self.bodies._packed
        plain = self.robot._watch.range if self.robot.runs_straight else None
        counts = np.diff(self.bodies._packed.piece_start)
        piece_pairs = int(counts[self.pairs].prod(axis=1).sum())
        pack = self.bodies._packed.handle
        single = singles.configurations(pack, self.handle, memory, piece_pairs, plain, self.hits, held)
        object.__setattr__(self, "single", single)

    def body(self, number: int) -> Body:
        """One of the bodies, packed separately when it is first requested: a cloud takes milliseconds."""
        if number not in self.taken:
            self.taken[number] = self.bodies[number]
        return self.taken[number]

    def only(self, pairs: Ints) -> CheckedPairs:
        """A subset of the pairs, by index, with the same bodies."""
        chosen = replace(
            self, pairs=self.pairs[pairs], margins=self.margins[pairs], leaving=self.leaving[pairs],
            reaching=self.reaching[pairs], order=np.arange(len(pairs)), hits=np.zeros(len(pairs), dtype=np.int64),
        )  # fmt: skip
        if self.in_parts is not self:  # surfaces are cut once
            vars(chosen)["in_parts"] = self.in_parts.only(pairs)
        return chosen

    def ordered(self) -> CheckedPairs:
        """A copy in which the pairs that hit most often come first."""
        ordered = replace(self, order=np.argsort(-self.hits, kind="stable"))
        for name in ("motions", "in_parts"):  # which have an order of their own
            if name in vars(self) and vars(self)[name] is not self:
                vars(ordered)[name] = vars(self)[name]
        return ordered

    def placed(self, scene: Scene, version: int) -> CheckedPairs:
        """A copy with the static bodies at their current poses in the scene.

        Parameters
        ----------
        scene : Scene
            With the bodies and rules from which this was prepared.
        version : int
            The scene's version, read before anything else of it.
        """
        placed = self._placed(scene.static_poses, version)
        if "in_parts" in vars(self) and self.in_parts is not self:
            vars(placed)["in_parts"] = self.in_parts._placed(scene.static_poses, version)
        return placed

    def _placed(self, poses: Floats, version: int) -> CheckedPairs:
        packed = self.bodies._packed
        start = packed.piece_start[len(self.link) :]
        flat = np.ascontiguousarray(poses.reshape(-1, 16))
        # New arrays, since another thread may be reading the old ones; most of what is in them still holds.
        standing, rows = self.standing.copy(), self.standing_rows.copy()
        for k in np.flatnonzero((flat != self.standing_poses).any(axis=1)):
            placed = _placed_rows(packed.kernel.hot[start[k] : start[k + 1]], poses[k])
            rows[start[k] - start[0] : start[k + 1] - start[0]] = _single(placed)
            standing[k, :7] = _single(_bounds(packed, start[k], placed, poses[k]))
        return replace(self, version=version, standing=standing, standing_rows=rows, standing_poses=flat)

    @kept
    def memory_of_nearest(self) -> int:
        """Scratch bytes for distances."""
        return int(entries.memory_of_nearest(self.bodies._packed.handle, self.handle, self.robot.dof))

    @kept
    def memory_of_clearances(self) -> int:
        """Scratch bytes for smooth clearances."""
        return int(entries.memory_of_clearances(self.bodies._packed.handle, self.handle, self.robot.dof))

    @kept
    def in_parts(self) -> CheckedPairs:
        """A copy for proofs of motions, with static surfaces in parts; made when it is first needed.

        Static bodies are in the world or attached to links that are fixed to the root.

        Parts of a solid cover only its surface: a motion that is free of them is free if it is free at its start, since
        a body outside can only enter through the surface. `starts_matter` is true if there are such parts.
        """
        packed = in_parts(self.bodies._packed, self._stand)
        if packed is self.bodies._packed:
            return self
        first = packed.piece_start[len(self.link)]
        unplaced = replace(
            self,
            bodies=Bodies._wrap(packed),
            taken={},
            standing=np.zeros_like(self.standing),
            standing_rows=np.zeros((packed.piece_start[-1] - first, columns.HOT), dtype=np.float32),
            standing_poses=np.full_like(self.standing_poses, np.nan),
        )
        return unplaced._placed(self.standing_poses.reshape(-1, 4, 4), self.version)

    @kept
    def starts_matter(self) -> bool:
        """Whether motions that are free of all parts have to be free at their starts as well."""
        packed = self.bodies._packed
        solid = packed.layout[:, columns.KIND] == columns.SOLID
        return self.in_parts is not self and bool((solid & np.repeat(self._stand, np.diff(packed.piece_start))).any())

    @kept
    def by_margin(self) -> list[OfMargin]:
        """All pairs, grouped by margin."""
        found = []
        for margin in np.unique(self.margins).tolist():
            at = np.flatnonzero(self.margins == margin)
            plan = np.array([[len(at)], [1], [1], [1], [1]], dtype=np.int64)
            found.append(OfMargin(margin, at, plan, np.ascontiguousarray(self.pairs[at].T)))
        return found

    @kept
    def ruled(self) -> Ints:
        """Indices of the pairs that may be in contact where a motion starts or ends."""
        return np.flatnonzero(self.leaving | self.reaching)

    @kept
    def unruled(self) -> CheckedPairs:
        """A copy without these pairs."""
        return self.only(np.flatnonzero(~(self.leaving | self.reaching)))

    @property
    def _stand(self) -> Bools:
        """Which bodies are at one pose, whatever the configuration is."""
        stand = np.ones(len(self.bodies), dtype=bool)
        stand[: len(self.link)] = _rigid_with(self.robot)[self.link] == _rigid_with(self.robot)[0]
        return stand

    @kept
    def motions(self) -> PreparedMotions:
        """The additional data for certifying motions; made when it is first needed."""
        packed = self.bodies._packed
        start = packed.piece_start[len(self.link) :]
        rows = [
            _placed_rows(packed.kernel.hot[start[k] : start[k + 1]], T)
            for k, T in enumerate(self.standing_poses.reshape(-1, 4, 4))
        ]
        tables = motion_tables(
            self.robot.tree, packed, self.link, self.balls, self.pairs, self.standing.astype(np.float64),
            self.standing_poses, np.concatenate([np.empty((0, columns.HOT)), *rows]),
        )  # fmt: skip
        table = records.table_of(tables)
        memory = entries.motion_memory(packed.handle, self.handle, self.robot.dof)
        return PreparedMotions(tables, table.ctypes.data, memory, table)

    def fingerprint(self) -> str:
        """A checksum of everything on which a verdict depends: joint tree, bodies, pairs, margins, poses."""
        arrays = {
            **self.robot.tree._asdict(), **arrays_of(self.bodies._packed), "link": self.link, "pairs": self.pairs,
            "margins": self.margins, "standing_poses": self.standing_poses,
        }  # fmt: skip
        return _archives.digest(arrays)

    def poses(self, Q: Floats) -> Floats:
        """Poses of all bodies in the world, shape (N, bodies, 4, 4), at checked configurations."""
        moving = self.robot.forward_kinematics(Q)[:, self.link]
        standing = self.standing_poses.reshape(-1, 4, 4)
        # In C order, which the kernels take for granted; NumPy may choose another.
        return np.ascontiguousarray(
            np.concatenate([moving, np.broadcast_to(standing, (len(Q), *standing.shape))], axis=1)
        )

    def poses_in_turn(self, Q: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield the poses of all bodies for blocks of configurations, with the index of the first configuration."""
        each = max(1, min(IN_TURN, POSES_AT_ONCE // max(1, len(self.names))))
        for first in range(0, len(Q), each):
            yield first, self.poses(Q[first : first + each])


def prepared(robot: Robot, scene: Scene, skipped: Iterable[Pair], version: int) -> CheckedPairs:
    """Prepare all pairs that can meet and may not touch.

    Parameters
    ----------
    robot : Robot
    scene : Scene
    skipped : iterable of pairs of str
        Links that may touch, in addition to the pairs that the scene allows.
    version : int
        The scene's version, read before anything else of it.

    Raises
    ------
    UnknownNameError
        If the scene names a link that the robot does not have, or a body as one of its links.
    InputError
        If there are more than `MOST_PAIRS` pairs.
    """
    structure_version = scene.structure_version
    _check_names(robot, scene)
    names, bodies, link = _bodies(robot, scene)
    pairs = _pairs(robot, names, link, _allowed_pairs(scene, skipped))
    leaving, reaching = (_of_rules(rules, names, pairs) for rules in (scene.leaving, scene.reaching))
    _check_convex(names, bodies, pairs[leaving | reaching])
    margins = _margins(scene, names, pairs)
    unplaced = arranged(robot, (version, structure_version), names, bodies, link, pairs, margins, leaving, reaching)
    return unplaced.placed(scene, version)


def arranged(
    robot: Robot,
    versions: tuple[int, int],
    names: tuple[str, ...],
    bodies: Bodies,
    link: Ints,
    pairs: Ints,
    margins: Floats,
    leaving: Bools,
    reaching: Bools,
) -> CheckedPairs:
    """Pairs of bodies, the moving ones first; static ones are not placed yet.

    Parameters
    ----------
    robot : Robot
    versions : tuple of 2 int
        The scene's version and structure version.
    names, bodies, link, pairs, margins, leaving, reaching
        As in `CheckedPairs`.
    """
    start = bodies._packed.piece_start[len(link) :]
    count = len(start) - 1
    return CheckedPairs(
        robot, *versions, names, bodies, link,
        balls=np.array([_ball(bodies._packed, k) for k in range(len(link))]).reshape(-1, 5),
        pairs=pairs,
        margins=margins,
        leaving=leaving,
        reaching=reaching,
        order=np.arange(len(pairs)),
        standing=np.zeros((count, columns.BOUNDS), dtype=np.float32),
        standing_rows=np.zeros((start[-1] - start[0], columns.HOT), dtype=np.float32),
        standing_poses=np.full((count, 16), np.nan),  # differs from every pose
        hits=np.zeros(len(pairs), dtype=np.int64),
    )  # fmt: skip


# -- names and pairs --------------------------------------------------------------------------


def _check_names(robot: Robot, scene: Scene) -> None:
    links, all_names = set(robot.link_names), dict.fromkeys((*scene.names, *robot.link_names))
    for body, held in scene.attachments.items():
        if held.link not in links:
            raise _validate.unknown_name(f"link in attach of {body!r}", held.link, robot.link_names)
        for name in held.touch_links:
            if name not in all_names:
                raise _validate.unknown_name(f"touch link in attach of {body!r}", name, robot.link_names)
    rules = (
        ("an allowed pair", scene.allowed),
        ("a pair of leave", scene.leaving),
        ("a pair of reach", scene.reaching),
        ("margins", scene.margins),
    )
    for place, named in rules:
        for name in sorted({name for names in named for name in names if name is not None}):
            if name not in all_names:
                raise _validate.unknown_name(f"body or link in {place}", name, all_names)
    for name in scene.names:
        if name in links:
            raise UnknownNameError(f"expected bodies with names of their own, found {name!r}, which is also a link")


def _bodies(robot: Robot, scene: Scene) -> tuple[tuple[str, ...], Bodies, Ints]:
    """Names and bodies, those that move first; and the link that each of these moves with."""
    links = {name: k for k, name in enumerate(robot.link_names)}
    moving = [(name, links[name], body) for name, body in robot.bodies.items()]
    moving += [
        (name, links[held.link], scene[name].transformed(held.T_link_body)) for name, held in scene.attachments.items()
    ]
    moving = [entry for entry in moving if entry[2]._packed.piece_start[-1] > 0]
    standing = scene.static_names
    bodies = Bodies([*(body for _, _, body in moving), *(scene[name] for name in standing)])
    link = np.array([number for _, number, _ in moving], dtype=np.int64)
    return (*(name for name, _, _ in moving), *standing), bodies, link


def _allowed_pairs(scene: Scene, skipped: Iterable[Pair]) -> set[frozenset[str]]:
    touching = {frozenset((name, link)) for name, held in scene.attachments.items() for link in held.touch_links}
    always = scene.allowed - scene.leaving - scene.reaching
    return {frozenset(pair) for pair in (*skipped, *always)} | touching


def _rigid_with(robot: Robot) -> Ints:
    """Links that are rigidly joined are one thing: for each link, its first one."""
    parent, kind = robot.tree.parent, robot.tree.kind
    return np.asarray(np.where(kind == columns.FIXED, parent, np.arange(len(parent))))


def _pairs(robot: Robot, names: tuple[str, ...], link: Ints, may_touch: set[frozenset[str]]) -> Ints:
    """Pairs of bodies, as places in `names`, the first of which moves."""
    thing = _rigid_with(robot)[link]
    moving, total = len(link), len(names)
    others = total - 1 - np.arange(moving)  # each with all that come after it
    if others.sum() > MOST_PAIRS:
        raise InputError(
            f"expected at most {MOST_PAIRS} pairs to check, found {others.sum()}: {moving} bodies that move, each "
            f"against the others and against {total - moving} that stand; leave out bodies, or unite those that belong "
            "together (Body.union)"
        )
    first = np.cumsum(others) - others  # place of each one's first pair
    a = np.repeat(np.arange(moving), others)
    b = np.arange(len(a)) - first[a] + a + 1
    meet = np.ones(len(a), dtype=bool)
    joined = np.flatnonzero(b < moving)
    meet[joined] = thing[a[joined]] != thing[b[joined]]
    place = {name: k for k, name in enumerate(names)}
    for pair in may_touch:
        at = sorted(place[name] for name in pair if name in place)
        if len(at) == 2 and at[0] < moving:
            meet[first[at[0]] + at[1] - at[0] - 1] = False
    return np.stack([a[meet], b[meet]], axis=1).astype(np.int64)


def _margins(scene: Scene, names: tuple[str, ...], pairs: Ints) -> Floats:
    """What each pair keeps, metres, as `Scene.margin_of`."""
    a, b = pairs.T
    is_link = np.array([name not in scene for name in names], dtype=bool)
    rules, lowered = scene.margins, scene.lowered
    margins = np.where(is_link[a] & is_link[b], rules.get((None, None), 0.0), scene.margin)
    if not rules:
        return margins
    # Each one's own, those against links only for pairs with a link; one that is not there is as good as 0.
    own = np.zeros(len(pairs))
    lower = np.zeros(len(pairs), dtype=bool)
    for one, holds in ((a, True), (b, True), (a, is_link[b]), (b, is_link[a])):
        keys = [(name,) if holds is True else (name, None) for name in names]
        own = np.fmax(own, np.where(holds, np.array([rules.get(key, 0.0) for key in keys])[one], 0.0))
        lower |= holds & np.array([key in lowered for key in keys], dtype=bool)[one]
    margins = np.fmax(own, np.where(lower, 0.0, margins))
    for rule, found in zip(rules, _numbers(rules, names, pairs), strict=True):
        if found >= 0:
            margins[found] = rules[rule] if rule in lowered else max(rules[rule], margins[found])
    return margins


def _numbers(named: Iterable[tuple[str | None, ...]], names: tuple[str, ...], pairs: Ints) -> list[int]:
    """Numbers of the checked pairs of two names each; -1 for those that are not checked."""
    place = {name: k for k, name in enumerate(names)}
    number = pairs[:, 0] * len(names) + pairs[:, 1]  # ascending, as the pairs are
    numbers = []
    for pair in named:
        at = sorted(place[name] for name in pair if name in place)
        found = int(np.searchsorted(number, at[0] * len(names) + at[1])) if len(at) == 2 else len(pairs)
        numbers.append(found if found < len(pairs) and pairs[found].tolist() == at else -1)
    return numbers


def _of_rules(rules: Iterable[Pair], names: tuple[str, ...], pairs: Ints) -> Bools:
    """Which of the pairs a rule names."""
    ruled = np.zeros(len(pairs) + 1, dtype=bool)
    ruled[_numbers(rules, names, pairs)] = True  # -1 is behind the last
    return ruled[:-1]


def _check_convex(names: tuple[str, ...], bodies: Bodies, pairs: Ints) -> None:
    """Refuse rules about the contact of surfaces: their depth is not that of convex pieces."""
    packed = bodies._packed
    for pair in pairs:
        for k in pair:
            first, last = packed.piece_start[k], packed.piece_start[k + 1]
            if (packed.layout[first:last, columns.KIND] <= columns.SURFACE).any():
                a, b = (names[n] for n in pair)
                raise InputError(
                    f"leave or reach of {a} and {b}: expected bodies of convex pieces, found {names[k]!r}, which is a "
                    "surface or a cloud; take a box, pieces or voxels for what is touched"
                )


# -- bounds and rows --------------------------------------------------------------------------


def _ball(packed: Packed, k: int) -> tuple[float, ...]:
    """Center and radius of a ball about all pieces of a body, and the farthest it reaches from the origin."""
    first, last = packed.piece_start[k], packed.piece_start[k + 1]
    centers = packed.kernel.table[first:last, columns.OUTER_CENTER : columns.OUTER_CENTER + 3]
    # The kernel takes the center of a single piece to be that of its outer ellipsoid.
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    radius = _farthest(packed, first, last, np.eye(4), middle) * STRETCH
    return (*middle, radius, (np.linalg.norm(middle) + radius) * STRETCH)


def _bounds(packed: Packed, first: int, placed: Floats, T: Floats) -> Floats:
    """Center of a box along the axes of the world about a placed body, radius of a ball about it, half the box's sides.

    Parameters
    ----------
    packed : Packed
    first : int
        The body's first piece.
    placed : ndarray, shape (pieces, HOT)
        `_placed_rows` of its pieces.
    T : ndarray, shape (4, 4)
        Where it stands.
    """
    last = first + len(placed)
    lower, upper = _box(packed, first, last, T, placed)
    reach = packed.kernel.table[first:last, columns.REACH].max(initial=0.0) + np.abs(T[:3, 3]).sum()
    off = 2 * tolerances.OFF * reach + tolerances.LEAST
    center, half = (lower + upper) / 2, (upper - lower) / 2 + off
    ball = _farthest(packed, first, last, T, center)
    wide = (min(ball, float(np.linalg.norm(half))) + off) * STRETCH
    return np.array((*center, wide, *(half * STRETCH)))


def _placed_rows(hot: Floats, T: Floats) -> Floats:
    """The ellipsoids of pieces in world coordinates, as rows of the certificate."""
    R, t = T[:3, :3], T[:3, 3]
    rows = hot.copy()
    for at in (columns.OUTER_CENTER, columns.INNER_CENTER):
        rows[:, at : at + 3] = hot[:, at : at + 3] @ R.T + t
    for at in (columns.OUTER_SHAPE, columns.INNER_SHAPE):
        rows[:, at : at + 6] = (R @ hot[:, at + _SYMMETRIC] @ R.T)[:, *_UPPER]
    rows[:, columns.REACH] += np.abs(t).sum()
    rows[:, [columns.OUTER_RADIUS, columns.REACH, columns.INVERSE_INNER_SIGMA]] *= tolerances.UP
    return rows


def _single(rows: Floats) -> NDArray[np.float32]:
    """The same in single precision; what is too large is infinite there, and certifies nothing."""
    with np.errstate(over="ignore"):
        return rows.astype(np.float32)


def _box(packed: Packed, first: int, last: int, T: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Corners of a box along the axes of the world about some placed pieces, up to rounding.

    The box of a piece is no larger than that of its ellipsoid, and than that of its corners.
    """
    center = rows[:, columns.OUTER_CENTER : columns.OUTER_CENTER + 3]
    Q = rows[:, [columns.OUTER_SHAPE, columns.OUTER_SHAPE + 3, columns.OUTER_SHAPE + 5]]
    half = np.sqrt(Q + tolerances.SHAPE_ROUNDINGS * Q.sum(axis=1, keepdims=True))
    least, most = center - half, center + half
    corners, start, polytopes = _corners(packed, first, last, T)
    if len(start):
        least[polytopes] = np.maximum(least[polytopes], np.minimum.reduceat(corners, start))
        most[polytopes] = np.minimum(most[polytopes], np.maximum.reduceat(corners, start))
    return least.min(axis=0, initial=np.inf), most.max(axis=0, initial=-np.inf)


def _farthest(packed: Packed, first: int, last: int, T: Floats, center: Floats) -> float:
    """Distance of the farthest point of some placed pieces from a point of the world, or more; up to rounding."""
    corners, _, polytopes = _corners(packed, first, last, T)
    others = packed.kernel.table[first:last][~polytopes]
    middles = others[:, columns.OUTER_CENTER : columns.OUTER_CENTER + 3] @ T[:3, :3].T + T[:3, 3]
    reach = np.linalg.norm(middles - center, axis=1) + others[:, columns.OUTER_RADIUS]
    return float(max(np.linalg.norm(corners - center, axis=1).max(initial=0.0), reach.max(initial=0.0)))


def _corners(packed: Packed, first: int, last: int, T: Floats) -> tuple[Floats, Ints, NDArray[np.bool_]]:
    """Placed corners of the polytopes among some pieces, the first row of each, and which pieces these are."""
    layout = packed.layout[first:last]
    polytopes = layout[:, columns.KIND] == columns.POLYTOPE
    begin, end = layout[polytopes, columns.POINTS_FROM], layout[polytopes, columns.POINTS_TO]
    points = packed.points[ranges(begin, end)]
    return points @ T[:3, :3].T + T[:3, 3], starts(end - begin)[:-1], polytopes
