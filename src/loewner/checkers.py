"""Is a robot free in a scene: at one configuration, at a million, along motions.

A `CollisionChecker` prepares a robot and a scene once: which pairs of bodies can meet at all, and the arrays that the
kernel walks through (`loewner._kernels.states`). It notices when the scene changes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner import _check, queries
from loewner._check import Floats
from loewner._kernels import handles, kinematics, rigid, shapes, states, verdicts
from loewner._kernels.contact import SHAPE_ROUNDINGS
from loewner._threads import over_blocks, share
from loewner.bodies import Bodies, Ints, Packed
from loewner.errors import ConvergenceError, InputError, UnknownNameError
from loewner.queries import Verdict
from loewner.robots import Robot
from loewner.scenes import Contact, Pair, Scene

# Configurations a thread takes at a time, at least: about half a millisecond of work.
LEAST_SHARE = 512

# Pairs are put in another order after so many configurations, and again each time their number has doubled.
FIRST_LOOK = 256

# Configurations of edges that are worth a call.
AT_LEAST = 64

# What a motion may be divided into; more is a slip in a unit.
MOST_STEPS = 2**24

# Configurations that `collide_by_pair` works on at a time: of a hundred bodies, the poses take 13 MB.
BY_PAIR = 1024

# Room for rounding, and for what a pose that is accepted as rigid may stretch lengths by.
STRETCH = 1 + 4 * rigid.ROTATION_TOLERANCE

# Piece pairs of bounds that `distance` works on at a time: 30 MB.
AT_ONCE = 50_000

# Of the arrays that the kernel takes (`handles.checking_of`): the order of pairs; and the first of the three about
# bodies that stand still, which change with their poses.
ORDER, STANDING = 10, 11

_OPEN = int(Verdict.AMBIGUOUS)
_NO_FRACTIONS = np.empty(0)


@dataclass(frozen=True, eq=False)
class StateDistance:
    """How far a robot is from touching, at one configuration or many; metres, negative is a depth.

    Attributes
    ----------
    lower, upper : float or ndarray
        Certified bounds from the ellipsoids: the least over all pairs that are checked.
    distance : float or ndarray, or None
        With ``exact=True``: the distance of the nearest pair, or minus the depth of the deepest.
    names : tuple of str, or ndarray of str, shape (..., 2), or None
        That pair.
    witness_a, witness_b, normal : ndarray, shape (..., 3), or None
        Where it is nearest; see `Distance`.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> found = CollisionChecker(Robot.from_urdf("arm.urdf"), scene).distance([0.5, 0.0], exact=True)
    >>> found.names, round(found.distance, 9), found.lower <= found.distance <= found.upper
    (('rail', 'post'), 0.35, True)
    """

    lower: Any
    upper: Any
    distance: Any = None
    names: Any = None
    witness_a: Any = None
    witness_b: Any = None
    normal: Any = None


@dataclass(frozen=True)
class Settled:
    """How many configurations each tier settled.

    Attributes
    ----------
    free_by_bounds, free_by_ellipsoids, free_by_planes, free_by_search : int
        Free, with the costliest test that any pair needed: bounding spheres and boxes; outer ellipsoids; planes about
        the pieces themselves, square to the contact normal of the ellipsoids; or the exact search.
    colliding_by_ellipsoids, colliding_by_search : int
        Colliding, found by inner ellipsoids or by the exact search.

    Examples
    --------
    >>> from loewner import CollisionChecker
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> settled = CollisionChecker(robot).tiers(robot.random_configurations(100))
    >>> settled.total, settled.colliding
    (100, 0)
    """

    free_by_bounds: int
    free_by_ellipsoids: int
    free_by_planes: int
    free_by_search: int
    colliding_by_ellipsoids: int
    colliding_by_search: int

    @property
    def total(self) -> int:
        """All configurations."""
        return self.free + self.colliding

    @property
    def free(self) -> int:
        """Configurations without contact."""
        return self.free_by_bounds + self.free_by_ellipsoids + self.free_by_planes + self.free_by_search

    @property
    def colliding(self) -> int:
        """Configurations with contact."""
        return self.colliding_by_ellipsoids + self.colliding_by_search


@dataclass(frozen=True, eq=False)
class _Prepared:
    """What a kernel takes, and what it was made of."""

    version: int
    structure_version: int
    names: tuple[str, ...]
    bodies: Bodies
    moving: int
    pairs: Ints
    margins: Floats
    arrays: tuple[Any, ...]
    # Collisions found, by pair. Threads may lose each other's counts: these only choose the order of pairs.
    hits: NDArray[np.int64]
    table: NDArray[np.int64]
    handle: int = 0


class CollisionChecker:
    """Checks configurations of a robot for collisions with itself and with a scene.

    Parameters
    ----------
    robot : Robot
    scene : Scene, optional
        May be changed afterwards; the next query sees it. None: the robot alone.
    allowed : iterable of pairs of str, optional
        Links that may touch, besides the robot's `disabled_pairs`: for instance the keys of `pairs_by_sampling`.
    skip_adjacent : bool, optional
        Leave out links that a joint joins, which mostly overlap by design. Default: only if the robot came without an
        SRDF, which usually disables those that must be.

    Raises
    ------
    InputError
        If the robot has no collision geometry: it would always be free.
    UnknownNameError
        If a link in `allowed` is not the robot's.

    Notes
    -----
    Checked are all pairs of links that can move against each other, and of links and what is attached to them with
    the bodies of the scene, but for pairs that are allowed. What is rigidly joined is never checked against each
    other. Bodies of the scene are not checked against each other: see `Scene.pairs`.

    The scene's margin holds for pairs with a body of the scene; pairs of links keep a margin only if one of the two,
    or the pair, was given one by `Scene.set_margin`.

    Where no pair is checked (a robot of one link alone; all pairs allowed), every configuration is free: look at
    `checked_pairs`.

    A checker may be used by several threads at once.

    Examples
    --------
    >>> from loewner import Body
    >>> scene = Scene(margin=0.01)
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot, scene)
    >>> checker.collide([[0.0, 1.57], [1.0, 1.57]])  # the cart beside the post, and in it
    array([False,  True])
    >>> [(contact.name_a, contact.name_b) for contact in checker.pairs([1.0, 1.57])]
    [('cart', 'post')]
    >>> checker.collide(robot.random_configurations(10_000)).shape
    (10000,)
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        allowed: Iterable[Pair] = (),
        skip_adjacent: bool | None = None,
    ) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot: expected loewner.Robot, found {type(robot).__name__}")
        if scene is not None and not isinstance(scene, Scene):
            raise InputError(f"scene: expected loewner.Scene or None, found {type(scene).__name__}")
        if not any(body._packed.piece_start[-1] > 0 for body in robot.bodies.values()):
            raise InputError(
                f"robot: expected a robot with collision geometry, found none in {robot.name!r}; "
                f"links with <visual> only: {', '.join(robot._only_visual) or 'none'}"
            )
        self._robot = robot
        self._scene = Scene() if scene is None else scene
        skipped = set(robot.disabled_pairs)
        if skip_adjacent or (skip_adjacent is None and not robot.disabled_pairs):
            skipped |= robot.adjacent_pairs
        self._skipped = frozenset(skipped) | robot.link_pairs(allowed, "allowed")
        self._prepared: _Prepared | None = None
        self._sides: tuple[Bodies, Bodies, Bodies] | None = None
        self._seen, self._next_look = 0, FIRST_LOOK

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles prepare anew: a handle is an address, and means nothing anywhere else."""
        return {**self.__dict__, "_prepared": None}

    def __repr__(self) -> str:
        return f"CollisionChecker({self.robot!r}, {self.scene!r})"

    # -- queries ------------------------------------------------------------------------------

    # Read-only: what is prepared belongs to these two, and another one would get its answers.
    @property
    def robot(self) -> Robot:
        """The robot that is checked; for another one, or another base, make another checker."""
        return self._robot

    @property
    def scene(self) -> Scene:
        """The scene it is checked in. What is in it may change; for another scene make another checker."""
        return self._scene

    @property
    def checked_pairs(self) -> tuple[Pair, ...]:
        """Names of the pairs that are checked."""
        ready = self._ready()
        return tuple((ready.names[a], ready.names[b]) for a, b in ready.pairs)

    def collide(self, Q: ArrayLike) -> Any:
        """Decide exactly which configurations are in collision.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
            Entries as `Robot.configuration_names`. Limits are not looked at: see `Robot.lower`.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
            Touching, or coming within the margin, is colliding.

        Raises
        ------
        InputError
            If the width is not dof, or an entry is not finite.
        UnknownNameError
            If the scene attaches to, allows or sets a margin for a link that the robot does not have.
        ConvergenceError
            If a configuration could not be settled. It never counts as free instead.
        """
        checked = self.robot.checked(Q)
        out, _ = self._settle(verdicts.EXACT, checked)
        return bool(out[0]) if checked.ndim == 1 else (out == Verdict.COLLIDING).reshape(checked.shape[:-1])

    def classify(self, Q: ArrayLike) -> Any:
        """Certified verdicts from the ellipsoids alone.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        Verdict, or ndarray of int8, shape (...)
            FREE if every pair is proven free, COLLIDING if any is proven colliding, else AMBIGUOUS.

        Raises
        ------
        InputError, UnknownNameError
            As for `collide`.
        """
        checked = self.robot.checked(Q)
        out, _ = self._settle(verdicts.CERTIFY, checked)
        return Verdict(int(out[0])) if checked.ndim == 1 else out.reshape(checked.shape[:-1])

    def tiers(self, Q: ArrayLike) -> Settled:
        """Count what it took to settle configurations exactly.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        Settled
        """
        out, tiers = self._settle(verdicts.EXACT, self.robot.checked(Q))
        free, hit = (np.bincount(tiers[out == verdict], minlength=verdicts.TIERS).tolist() for verdict in (0, 1))
        return Settled(
            free_by_bounds=free[verdicts.BY_SPHERE],
            free_by_ellipsoids=free[verdicts.BY_OUTER],
            free_by_planes=free[verdicts.BY_GAP],
            free_by_search=free[verdicts.BY_SEARCH],
            colliding_by_ellipsoids=hit[verdicts.BY_INNER],
            colliding_by_search=hit[verdicts.BY_SEARCH],
        )

    def valid_edges(self, Q0: ArrayLike, Q1: ArrayLike, resolution: float) -> Any:
        """Decide which straight motions are free of collisions, at steps no longer than `resolution`.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
            Ends, broadcast together.
        resolution : float
            Largest Euclidean distance of two configurations checked, in the units of the joints.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
            True if both ends and all configurations between are free. What happens between two of them is not seen.

        Notes
        -----
        Joint values run straight, quaternions along the shorter arc. A motion is checked at its ends, then in its
        middle, then at quarters: collisions tend to be found early.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> checker.valid_edges([0.0, 1.57], [[0.5, 1.57], [2.0, 1.57]], resolution=0.05)  # the post is in the way
        array([ True, False])
        """
        step = _check.positive_scalar(resolution, "resolution")
        a, b = self.robot.checked(Q0, "Q0"), self.robot.checked(Q1, "Q1")
        if a.ndim == 1 and b.ndim == 1 and self.robot.runs_straight:
            return self._valid_edge(a, b, step)
        try:
            a, b = np.broadcast_arrays(a, b)
        except ValueError:
            texts = _check.shape_text(a.shape), _check.shape_text(b.shape)
            raise InputError(f"expected Q0 and Q1 whose shapes broadcast, found {texts[0]} and {texts[1]}") from None
        shape = a.shape[:-1]
        a, b = _flat(a), _flat(b)
        parts = self._parts(a, b, step)
        valid = np.ones(len(a), dtype=bool)
        for edge, at in _rounds(parts, valid):
            out, _ = self._settle(verdicts.EXACT, self.robot.between(a[edge], b[edge], at))
            valid[edge[out != Verdict.FREE]] = False
        return valid.reshape(shape) if shape else bool(valid[0])

    def pairs(self, q: ArrayLike) -> tuple[Contact, ...]:
        """Name the pairs that touch, overlap or come within their margin at one configuration.

        Parameters
        ----------
        q : array_like, shape (dof,)

        Returns
        -------
        tuple of Contact
            With exact distance or depth, witness points and normal.
        """
        checked = self.robot.checked_one(q)
        ready = self._ready()
        T, meet = self._body_poses(ready, checked[None])[0], np.zeros(len(ready.pairs), dtype=bool)
        for margin in np.unique(ready.margins):
            at = ready.margins == margin
            meet[at] = queries.collide(ready.bodies, T, ready.bodies, T, margin=float(margin), pairs=ready.pairs[at])
        a, b = ready.pairs[meet].T
        found = queries.distance(ready.bodies[a], T[a], ready.bodies[b], T[b], exact=True)
        return Contact.from_distances(((ready.names[i], ready.names[j]) for i, j in zip(a, b, strict=True)), found)

    def collide_by_pair(self, Q: ArrayLike) -> NDArray[np.bool_]:
        """Decide exactly which pairs collide at which configurations; where any pair will do, `collide` is quicker.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        ndarray of bool, shape (..., pairs)
            Pairs as `checked_pairs`.

        Raises
        ------
        InputError, UnknownNameError, ConvergenceError
            As for `collide`.
        """
        checked = self.robot.checked(Q)
        ready = self._ready()
        flat = _flat(checked)
        out = np.empty((len(flat), len(ready.pairs)), dtype=bool)
        for k in range(0, len(flat), BY_PAIR):
            T = self._body_poses(ready, flat[k : k + BY_PAIR])
            for p, (a, b) in enumerate(ready.pairs.tolist()):
                one, other, margin = ready.bodies[a], ready.bodies[b], float(ready.margins[p])
                out[k : k + BY_PAIR, p] = queries.collide(one, T[:, a], other, T[:, b], margin=margin)
        return out.reshape(*checked.shape[:-1], len(ready.pairs))

    def distance(self, Q: ArrayLike, *, exact: bool = False) -> StateDistance:
        """Bounds on how far the nearest pair is apart, and on request its exact distance; margins are not looked at.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        exact : bool
            Also compute the distance or depth, the pair, witnesses and normal.

        Returns
        -------
        StateDistance
            In metres; of one configuration floats and names, of a batch arrays.

        Raises
        ------
        InputError
            As for `collide`; also if there is no pair to check.
        ConvergenceError
            As for `loewner.distance`.
        """
        checked = self.robot.checked(Q)
        ready = self._ready()
        if len(ready.pairs) == 0:
            raise InputError("distance: expected a robot and a scene with pairs to check, found none")
        flat = _flat(checked)
        each = max(1, AT_ONCE // len(ready.pairs))
        parts = [self._distances(ready, flat[k : k + each], exact) for k in range(0, len(flat), each)]
        columns = [np.concatenate(c) for c in zip(*parts, strict=True)] if parts else _no_distances(exact)
        batch = checked.shape[:-1]
        if batch:
            return StateDistance(*(c.reshape(batch + c.shape[1:]) for c in columns))
        return StateDistance(
            *(float(c[0]) if c.ndim == 1 else tuple(c[0].tolist()) if c.dtype.kind == "U" else c[0] for c in columns)
        )

    # -- inside -------------------------------------------------------------------------------

    def _settle(self, mode: int, Q: Floats) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        """Verdict and tier of every configuration."""
        ready = self._ready()
        flat = _flat(Q)
        total = len(flat)
        out, tiers = np.empty(total, dtype=np.int8), np.empty(total, dtype=np.int8)
        pack = ready.bodies._packed.handle

        def run(first: int, last: int) -> None:
            states.check_states(mode, first, last, flat, _NO_FRACTIONS, pack, ready.handle, out, tiers, ready.hits)

        if total <= LEAST_SHARE:
            run(0, total)
        else:
            for _ in over_blocks(run, total, share(total, LEAST_SHARE)):
                pass
        self._learn(ready, total)
        if mode == verdicts.EXACT and (out[0] == _OPEN if total == 1 else (out == _OPEN).any()):
            for k in np.flatnonzero(out == _OPEN):
                out[k] = self._settle_with_care(ready, flat[k])
        return out, tiers

    def _parts(self, a: Floats, b: Floats, step: float) -> Any:
        """How many steps motions are divided into."""
        lengths = self.robot._distances(a, b)
        longest = float(np.max(lengths, initial=0.0)) if isinstance(lengths, np.ndarray) else lengths
        if not longest / step <= MOST_STEPS:
            raise InputError(
                f"resolution: expected at most {MOST_STEPS} steps on the longest motion ({longest:g}), found {step:g}"
            )
        if isinstance(lengths, np.ndarray):
            return np.maximum(np.ceil(lengths / step), 1).astype(np.int64)
        return max(math.ceil(lengths / step), 1)

    def _valid_edge(self, a: Floats, b: Floats, step: float) -> bool:
        """The same for one motion of joints that run straight, in one call."""
        ready = self._ready()
        fractions = _coarse_first(self._parts(a, b, step))
        total = len(fractions)
        out, tiers = np.empty(total, dtype=np.int8), np.empty(total, dtype=np.int8)
        ends, pack = np.array((a, b)), ready.bodies._packed.handle
        done = states.check_states(
            verdicts.EXACT, 0, total, ends, fractions, pack, ready.handle, out, tiers, ready.hits
        )
        self._learn(ready, done)
        if not out[:done].any():
            return True
        if (out[:done] == Verdict.COLLIDING).any():
            return False
        still_open = self.robot.between(a, b, fractions[np.flatnonzero(out == _OPEN)])
        return all(self._settle_with_care(ready, q) == Verdict.FREE for q in still_open)

    def _settle_with_care(self, ready: _Prepared, q: Floats) -> int:
        """One configuration that the fast searches left open, pair by pair."""
        T = self._body_poses(ready, q[None])[0]
        open_pairs = []
        for p, (a, b) in enumerate(ready.pairs):
            try:
                if queries.collide(
                    ready.bodies[int(a)], T[a], ready.bodies[int(b)], T[b], margin=float(ready.margins[p])
                ):
                    return int(Verdict.COLLIDING)
            except ConvergenceError:
                open_pairs.append((ready.names[a], ready.names[b]))
        if open_pairs:
            raise ConvergenceError(
                f"collide: {open_pairs[0][0]} and {open_pairs[0][1]} could not be settled at configuration "
                f"{np.array2string(q, precision=17)}; treat it as colliding or change it by a hair"
            )
        return int(Verdict.FREE)

    def _learn(self, ready: _Prepared, count: int) -> None:
        """Put the pairs that hit most often first, now and then."""
        self._seen += count
        if self._seen >= self._next_look and self._prepared is ready:
            self._next_look = 2 * self._seen
            self._prepared = _ordered(ready)

    def _ready(self) -> _Prepared:
        """What the kernel takes, made anew if the scene has changed."""
        ready, scene = self._prepared, self.scene
        if ready is not None and ready.version == scene.version:
            return ready
        if ready is None or ready.structure_version != scene.structure_version:
            ready = self._prepare()
            self._seen, self._next_look = 0, FIRST_LOOK
        else:
            ready = _with_poses(ready, scene)
        self._prepared = ready
        return ready

    def _prepare(self) -> _Prepared:
        robot, scene = self.robot, self.scene
        version, structure_version = scene.version, scene.structure_version
        self._check_names()
        links = {name: k for k, name in enumerate(robot.link_names)}
        attached = scene.attachments
        moving = [(name, links[name], body) for name, body in robot.bodies.items()]
        moving += [
            (name, links[held.link], scene[name].transformed(held.T_link_body)) for name, held in attached.items()
        ]
        moving = [entry for entry in moving if entry[2]._packed.piece_start[-1] > 0]
        names = (*(name for name, _, _ in moving), *scene.static_names)
        bodies = Bodies([*(body for _, _, body in moving), *(scene[name] for name in scene.static_names)])
        link = np.array([number for _, number, _ in moving], dtype=np.int64)
        # Links that are rigidly joined are one thing; its number is that of its first link.
        parent, kind = robot.tree[0], robot.tree[1]
        thing = np.where((kind == kinematics.FIXED), parent, np.arange(len(parent)))
        pairs, margins = [], []
        may_touch = self._allowed_pairs()
        for a in range(len(moving)):
            for b in range(a + 1, len(names)):
                rigid = b < len(moving) and thing[link[a]] == thing[link[b]]
                if not rigid and frozenset((names[a], names[b])) not in may_touch:
                    pairs.append((a, b))
                    margins.append(self._margin(names[a], names[b]))
        balls = np.array([_ball(bodies, k) for k in range(len(moving))]).reshape(-1, 5)
        arrays = (
            *robot.tree, link, balls, np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(margins, dtype=float),
            np.arange(len(pairs)),
        )  # fmt: skip
        ready = _Prepared(
            version, structure_version, names, bodies, len(moving), arrays[8], arrays[9], arrays,
            np.zeros(len(pairs), dtype=np.int64), np.zeros(0, dtype=np.int64),
        )  # fmt: skip
        return _with_poses(ready, scene)

    def _check_names(self) -> None:
        robot, scene = self.robot, self.scene
        links, all_names = robot.link_names, (*scene.names, *robot.link_names)
        for body, held in scene.attachments.items():
            if held.link not in links:
                raise _check.unknown_name(f"link in attach of {body!r}", held.link, links)
            for name in held.touch_links:
                if name not in all_names:
                    raise _check.unknown_name(f"touch link in attach of {body!r}", name, links)
        for place, named in (("an allowed pair", scene.allowed), ("margins", scene.margins)):
            for name in (name for names in sorted(named) for name in names):
                if name not in all_names:
                    raise _check.unknown_name(f"body or link in {place}", name, all_names)
        for name in scene.names:
            if name in robot.link_names:
                raise UnknownNameError(f"expected bodies with names of their own, found {name!r}, which is also a link")

    def _allowed_pairs(self) -> set[frozenset[str]]:
        held = self.scene.attachments.items()
        touching = {frozenset((name, link)) for name, how in held for link in how.touch_links}
        return {frozenset(pair) for pair in self._skipped | self.scene.allowed} | touching

    def _margin(self, a: str, b: str) -> float:
        if a in self.scene or b in self.scene:
            return self.scene.margin_of(a, b)
        margins = self.scene.margins
        own = margins.get((min(a, b), max(a, b)))
        return own if own is not None else max(margins.get((a,), 0.0), margins.get((b,), 0.0))

    def _body_poses(self, ready: _Prepared, Q: Floats) -> Floats:
        """Poses of all bodies in the world, shape (N, bodies, 4, 4)."""
        link, standing = ready.arrays[6], ready.arrays[13].reshape(-1, 4, 4)
        moving = self.robot.forward_kinematics(Q)[:, link]
        return np.concatenate([moving, np.broadcast_to(standing, (len(Q), *standing.shape))], axis=1)

    def _distances(self, ready: _Prepared, Q: Floats, exact: bool) -> tuple[Any, ...]:
        """Columns of a `StateDistance` for some configurations."""
        T = self._body_poses(ready, Q)
        a, b = ready.pairs[:, 0], ready.pairs[:, 1]
        sides = self._sides
        if sides is None or sides[0] is not ready.bodies:
            # Kept, for packing the bodies of all pairs takes longer than asking about them once.
            self._sides = sides = ready.bodies, ready.bodies[a], ready.bodies[b]
        bounds = queries.distance(sides[1], T[:, a], sides[2], T[:, b])
        lower, upper = bounds.lower.min(axis=1), bounds.upper.min(axis=1)
        if not exact:
            return lower, upper
        best = np.full(len(Q), np.inf)
        nearest = np.zeros(len(Q), dtype=np.int64)
        vectors = np.zeros((3, len(Q), 3))
        for p in range(len(a)):
            at = np.flatnonzero(bounds.lower[:, p] <= np.minimum(upper, best))
            if len(at) == 0:
                continue
            found = queries.distance(
                ready.bodies[int(a[p])], T[at, a[p]], ready.bodies[int(b[p])], T[at, b[p]], exact=True
            )
            better = found.distance < best[at]
            rows = at[better]
            best[rows], nearest[rows] = found.distance[better], p
            for column, values in zip(vectors, (found.witness_a, found.witness_b, found.normal), strict=True):
                column[rows] = values[better]
        names = np.array(ready.names)[ready.pairs[nearest]]
        return lower, upper, best, names, *vectors


def pairs_by_sampling(
    robot: Robot,
    samples: int = 10_000,
    seed: int = 0,
    *,
    known_free: ArrayLike | None = None,
    always: float = 0.95,
) -> dict[Pair, str]:
    """Pairs of links that need no check, for a robot without an SRDF, as MoveIt's setup assistant finds them.

    Parameters
    ----------
    robot : Robot
        Its `disabled_pairs` are not looked at.
    samples : int
        Random configurations within the limits, see `Robot.random_configurations`.
    seed : int
    known_free : array_like, shape (..., dof), optional
        Configurations that the robot is known to be free at, such as one that it stands in: what collides there does so
        because its bodies are larger than the links.
    always : float
        Share of the samples, above 0 and up to 1, from which on two links count as always colliding.

    Returns
    -------
    dict
        Sorted pairs of links, and why: "adjacent" if a joint joins them; "default" if they collide at `known_free`;
        "always", or "never", if they collide at all samples or at none. Links that are rigidly joined are never
        checked, and not in it.

    Raises
    ------
    InputError
        If the robot has no collision geometry, or an argument is none of what it should be.

    Notes
    -----
    "never" is no proof: a pair that meets in one configuration of a million is likely to be missed by ten thousand
    samples. Give the pairs to `Robot.disabling`, all or only those of some kinds.

    Examples
    --------
    >>> from loewner import pairs_by_sampling
    >>> pairs_by_sampling(Robot.from_urdf("arm.urdf"), 100)
    {('cart', 'forearm'): 'adjacent', ('cart', 'rail'): 'adjacent', ('forearm', 'rail'): 'never'}
    """
    samples = _check.whole_number(samples, "samples", 1)
    if not 0 < _check.positive_scalar(always, "always") <= 1:
        raise InputError(f"always: expected a share above 0 and up to 1, found {always:g}")
    checker = CollisionChecker(replace(robot, disabled_pairs=frozenset()), skip_adjacent=False)
    counts = checker.collide_by_pair(robot.random_configurations(samples, seed)).sum(axis=0)
    known = robot.checked(np.empty((0, robot.dof)) if known_free is None else known_free, "known_free")
    overlapping = checker.collide_by_pair(_flat(known)).sum(axis=0).tolist()
    found = {}
    for (a, b), count, overlaps in zip(checker.checked_pairs, counts.tolist(), overlapping, strict=True):
        pair = (min(a, b), max(a, b))
        if pair in robot.adjacent_pairs:
            found[pair] = "adjacent"
        elif overlaps:
            found[pair] = "default"
        elif count >= always * samples:
            found[pair] = "always"
        elif count == 0:
            found[pair] = "never"
    return dict(sorted(found.items()))


def _flat(Q: Floats) -> Floats:
    """All configurations in one column; also of a robot without joints, where a length of -1 tells nothing."""
    return Q.reshape(math.prod(Q.shape[:-1]), Q.shape[-1])


def _no_distances(exact: bool) -> list[Any]:
    empty = np.empty(0)
    return (
        [empty, empty, empty, np.empty((0, 2), "U1"), *(np.empty((0, 3)) for _ in range(3))] if exact else [empty] * 2
    )


def _ball(bodies: Bodies, k: int) -> tuple[float, ...]:
    """Center and radius of a ball about all pieces of a body, and the farthest it reaches from the origin."""
    packed = bodies._packed
    first, last = packed.piece_start[k], packed.piece_start[k + 1]
    table = packed.kernel[0][first:last]
    centers = table[:, shapes.OUTER_CENTER : shapes.OUTER_CENTER + 3]
    # The kernel takes the center of a single piece to be that of its outer ellipsoid.
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    away = [_farthest(bodies, p, middle) for p in range(first, last)]
    radius = max(away) * STRETCH
    return (*middle, radius, (np.linalg.norm(middle) + radius) * STRETCH)


def _farthest(bodies: Bodies, p: int, center: Floats) -> float:
    """Upper bound on the distance of the points of a piece from a center, for bodies that are not stretched."""
    packed = bodies._packed
    row = packed.kernel[0][p]
    bound = np.linalg.norm(row[shapes.OUTER_CENTER : shapes.OUTER_CENTER + 3] - center) + row[shapes.OUTER_RADIUS]
    if packed.layout[p, shapes.KIND] == shapes.POLYTOPE:
        corners = packed.points[packed.layout[p, shapes.POINTS_FROM] : packed.layout[p, shapes.POINTS_TO]]
        bound = min(bound, np.linalg.norm(corners - center, axis=1).max())
    return float(bound)


def _with_poses(ready: _Prepared, scene: Scene) -> _Prepared:
    """The same with the bodies that stand still where the scene has them now."""
    # Read before the poses: whatever another thread moves meanwhile is then noticed the next time.
    version = scene.version
    packed, first = ready.bodies._packed, ready.moving
    poses = scene.static_poses
    start = packed.piece_start[first:]
    flat = np.ascontiguousarray(poses.reshape(-1, 16))
    if len(ready.arrays) > STANDING:
        # New arrays, since another thread may be reading the old ones; most of what is in them still holds.
        standing, rows = (array.copy() for array in ready.arrays[STANDING : STANDING + 2])
        moved = np.flatnonzero((flat != ready.arrays[STANDING + 2]).any(axis=1))
    else:
        standing = np.zeros((len(poses), states.BOUNDS), dtype=np.float32)
        rows = np.empty((start[-1] - start[0], shapes.HOT), dtype=np.float32)
        moved = np.arange(len(poses))
    for k in moved:
        T = poses[k]
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        for p in range(start[k], start[k + 1]):
            row = _placed_row(packed.kernel[4][p], T)
            rows[p - start[0]] = _single(row)
            least, most = _box(packed, p, T, row)
            lower, upper = np.minimum(lower, least), np.maximum(upper, most)
        reach = packed.kernel[0][start[k] : start[k + 1], shapes.REACH].max(initial=0.0) + np.abs(T[:3, 3]).sum()
        off = 2 * states.OFF * reach + states.LEAST
        center, half = (lower + upper) / 2, (upper - lower) / 2 + off
        ball = max((_far_from(packed, p, T, center) for p in range(start[k], start[k + 1])), default=0.0)
        wide = (min(ball, float(np.linalg.norm(half))) + off) * STRETCH
        standing[k, :7] = _single(np.array((*center, wide, *(half * STRETCH))))
    now = replace(ready, version=version)
    return _with_arrays(now, (*ready.arrays[:STANDING], standing, rows, flat))


def _ordered(ready: _Prepared) -> _Prepared:
    """The same with the pairs that hit most often first."""
    arrays = (*ready.arrays[:ORDER], np.argsort(-ready.hits, kind="stable"), *ready.arrays[ORDER + 1 :])
    return _with_arrays(ready, arrays)


def _with_arrays(ready: _Prepared, arrays: tuple[Any, ...]) -> _Prepared:
    table = handles.table_of(arrays)
    return replace(ready, arrays=arrays, table=table, handle=table.ctypes.data)


# Entries of a symmetric matrix in the order of the kernels, and back.
_UPPER = np.triu_indices(3)
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


def _placed_row(hot: Floats, T: Floats) -> Floats:
    """The ellipsoids of a piece in world coordinates, as a row of the certificate."""
    R, t = T[:3, :3], T[:3, 3]
    row = hot.copy()
    for at in (shapes.OUTER_CENTER, shapes.INNER_CENTER):
        row[at : at + 3] = R @ hot[at : at + 3] + t
    for at in (shapes.OUTER_SHAPE, shapes.INNER_SHAPE):
        row[at : at + 6] = (R @ hot[at + _SYMMETRIC] @ R.T)[_UPPER]
    row[shapes.REACH] += np.abs(t).sum()
    row[[shapes.OUTER_RADIUS, shapes.REACH, shapes.INNER_GRIP]] *= states.UP
    return row


def _single(rows: Floats) -> NDArray[np.float32]:
    """The same in single precision; what is too large is infinite there, and certifies nothing."""
    with np.errstate(over="ignore"):
        return rows.astype(np.float32)


def _box(packed: Packed, p: int, T: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Corners of a box along the axes of the world about a placed piece, up to rounding."""
    center = row[shapes.OUTER_CENTER : shapes.OUTER_CENTER + 3]
    Q = row[[shapes.OUTER_SHAPE, shapes.OUTER_SHAPE + 3, shapes.OUTER_SHAPE + 5]]
    half = np.sqrt(Q + SHAPE_ROUNDINGS * Q.sum())
    least, most = center - half, center + half
    if packed.layout[p, shapes.KIND] == shapes.POLYTOPE:
        corners = _corners(packed, p, T)
        least, most = np.maximum(least, corners.min(axis=0)), np.minimum(most, corners.max(axis=0))
    return least, most


def _far_from(packed: Packed, p: int, T: Floats, center: Floats) -> float:
    """Distance of the farthest point of a placed piece from a point of the world, or more."""
    if packed.layout[p, shapes.KIND] == shapes.POLYTOPE:
        return float(np.linalg.norm(_corners(packed, p, T) - center, axis=1).max())
    row = packed.kernel[0][p]
    middle = T[:3, :3] @ row[shapes.OUTER_CENTER : shapes.OUTER_CENTER + 3] + T[:3, 3]
    return float(np.linalg.norm(middle - center) + row[shapes.OUTER_RADIUS])


def _corners(packed: Packed, p: int, T: Floats) -> Floats:
    points = packed.points[packed.layout[p, shapes.POINTS_FROM] : packed.layout[p, shapes.POINTS_TO]]
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


# -- motions ----------------------------------------------------------------------------------


def _rounds(parts: Ints, valid: NDArray[np.bool_]) -> Iterator[tuple[Ints, Floats]]:
    """Yield which edges to check where, as fractions of their way, coarsely first; an edge not `valid` is left out.

    Parameters
    ----------
    parts : ndarray of int64
        How many steps each edge is divided into.
    valid : ndarray of bool
        May change between two rounds.
    """
    done, more = 0, max(2, AT_LEAST // max(1, len(parts)))
    while True:
        going = np.flatnonzero(valid & (parts >= done))
        if len(going) == 0:
            return
        edges, fractions = [], []
        for count in np.unique(parts[going]):
            at = _coarse_first(int(count))[done : done + more]
            those = going[parts[going] == count]
            edges.append(np.repeat(those, len(at)))
            fractions.append(np.tile(at, len(those)))
        yield np.concatenate(edges), np.concatenate(fractions)
        done, more = done + more, max(more, done + more)


@lru_cache(maxsize=256)
def _coarse_first(parts: int) -> Floats:
    """0, 1, then the multiples of 1 / parts between: the middle, the quarters, and so on."""
    digits = max(1, (parts - 1).bit_length())
    numbers = np.arange(1, 2**digits)
    reversed_bits = np.zeros_like(numbers)
    for k in range(digits):
        reversed_bits |= (numbers >> k & 1) << (digits - 1 - k)
    return np.concatenate([[0.0, 1.0], reversed_bits[reversed_bits < parts] / parts])
