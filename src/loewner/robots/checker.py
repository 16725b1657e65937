"""Is a robot free in a scene: at one configuration, at a million, along motions.

A `CollisionChecker` has a robot and a scene prepared once (`loewner.robots.checked_pairs`), asks the
kernel (`loewner._kernels.robots.configurations`), and notices when the scene changes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner import _validate, queries
from loewner._guard import guarded
from loewner._kernels import codes
from loewner._native import entries
from loewner._settle import settle
from loewner._threads import in_shares
from loewner._validate import Bools, Floats, Ints, OneOrMany, Pair
from loewner._workspaces import workspace
from loewner.errors import ConvergenceError, InputError
from loewner.queries import NOTHING, VERDICTS, Exact, Vector, Verdict
from loewner.robots import contacts, edges, motions
from loewner.robots.checked_pairs import CheckedPairs, prepared
from loewner.robots.motions import CertifiedMotions
from loewner.robots.robot import Robot
from loewner.scenes import Contact, Scene

# Configurations a thread takes at a time, at least: about half a millisecond of work.
LEAST_SHARE = 512

# Pairs are put in another order after so many configurations, and again each time their number has doubled.
FIRST_LOOK = 256

# Configurations that `collide_by_pair` works on at a time: of a hundred bodies, the poses take 13 MB.
BY_PAIR = 1024

# Poses of bodies at most, of all those configurations together: 100 MB.
POSES_AT_ONCE = 2**20 * 3 // 4


@dataclass(frozen=True, eq=False)
class StateDistance(Generic[Exact, Vector]):
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
    gradient : ndarray, shape (..., dof), or None
        With ``gradient=True``: the derivative of the distance by the configuration.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> found = CollisionChecker(Robot.from_urdf("arm.urdf"), scene).distance([0.5, 0.0], exact=True)
    >>> found.names, round(found.distance, 9), found.lower <= found.distance <= found.upper
    (('rail', 'post'), 0.35, True)
    """

    lower: OneOrMany
    upper: OneOrMany
    distance: Exact = NOTHING
    names: Exact = NOTHING
    witness_a: Vector = NOTHING
    witness_b: Vector = NOTHING
    normal: Vector = NOTHING
    gradient: Vector = NOTHING

    def __repr__(self) -> str:
        return _validate.brief(self)


@dataclass(frozen=True, eq=False)
class PairDistances:
    """Pairs of bodies that are near each other, one entry each.

    Attributes
    ----------
    configuration : ndarray of int64, shape (M,)
        Which one, counted over all that were asked about.
    pair : ndarray of int64, shape (M,)
        Its number in `CollisionChecker.checked_pairs`.
    names : ndarray of str, shape (M, 2)
    distance : ndarray, shape (M,)
        Metres; negative is a depth, see `Distance`.
    witness_a, witness_b, normal : ndarray, shape (M, 3)
    gradient : ndarray, shape (M, dof), or None
        With ``gradient=True``: the derivative of the distance by the configuration.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> near = CollisionChecker(Robot.from_urdf("arm.urdf"), scene).distance_by_pair([0.5, 0.0], within=0.4)
    >>> len(near), near.names, near.distance.round(6)
    (1, array([['rail', 'post']], dtype='<U7'), array([0.35]))
    """

    configuration: Ints
    pair: Ints
    names: NDArray[np.str_]
    distance: Floats
    witness_a: Floats
    witness_b: Floats
    normal: Floats
    gradient: Floats | None = None

    def __len__(self) -> int:
        return len(self.distance)

    def __repr__(self) -> str:
        return _validate.brief(self)


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


@guarded
class CollisionChecker:
    """Checks configurations of a robot for collisions with itself and with a scene.

    Parameters
    ----------
    robot : Robot
    scene : Scene, optional
        May be changed afterwards; the next query sees it. None: the robot alone.
    allowed : iterable of pairs of str, optional
        Links that may touch, in addition to the robot's `disabled_pairs`: for instance the keys of `pairs_by_sampling`.
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
    the bodies of the scene, except for pairs that are allowed. What is rigidly joined is never checked against each
    other. Bodies of the scene are not checked against each other: see `Scene.pairs`.

    The scene's margin holds for pairs with a body of the scene; pairs of links keep a margin only if `Scene.set_margin`
    gave one to all links, to one of the two, or to the pair (`Scene.margin_of`).

    Where no pair is checked (a robot of one link alone; all pairs allowed), every configuration is free: look at
    `checked_pairs`.

    A checker may be used by several threads at once, and its scene changed by others: each answer is about the scene as
    it was at one moment.

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
        skip_adjacent = None if skip_adjacent is None else _validate.flag(skip_adjacent, "skip_adjacent")
        if skip_adjacent or (skip_adjacent is None and not robot.disabled_pairs):
            skipped |= robot.adjacent_pairs
        self._skipped = frozenset(skipped) | robot.link_pairs(allowed, "allowed")
        self._prepared: CheckedPairs | None = None
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

    def collide(self, Q: ArrayLike) -> OneOrMany:
        """Decide exactly which configurations are in collision.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
            Entries as `Robot.configuration_names`. Limits are no obstacle: see `Robot.lower`.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
            Touching, or coming within the margin, is colliding.

        Raises
        ------
        InputError
            If the width is not dof, or an entry is not finite; or if there are more than 2^24 pairs to check.
        UnknownNameError
            If the scene attaches to, allows or sets a margin for a link that the robot does not have.
        ConvergenceError
            If a configuration could not be settled. It never counts as free instead.

        Warns
        -----
        UserWarning
            Once for a robot, if a configuration is far outside the limits: see `Robot.checked`.
        """
        ready = self._at_hand()
        if ready is not None:
            collides = ready.single.collide(Q)
            if collides is not None:
                self._learn(ready, 1)
                return collides
        checked = self.robot.checked(Q)
        out, _ = self._settle(codes.EXACT, checked)
        return _collisions(out, checked)

    def classify(self, Q: ArrayLike) -> OneOrMany:
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
        ready = self._at_hand()
        if ready is not None:
            verdict = ready.single.classify(Q)
            if verdict is not None:
                self._learn(ready, 1)
                return VERDICTS[verdict]
        checked = self.robot.checked(Q)
        out, _ = self._settle(codes.CERTIFY, checked)
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
        return self.settle(Q)[1]

    def settle(self, Q: ArrayLike) -> tuple[OneOrMany, Settled]:
        """Decide as `collide` does, and count as `tiers` does, in one go.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        collides : bool, or ndarray of bool, shape (...)
        settled : Settled

        Raises
        ------
        InputError, UnknownNameError, ConvergenceError
            As for `collide`.
        """
        checked = self.robot.checked(Q)
        out, tiers = self._settle(codes.EXACT, checked)
        free = np.bincount(tiers[out == codes.FREE], minlength=codes.TIERS).tolist()
        hit = np.bincount(tiers[out == codes.COLLIDING], minlength=codes.TIERS).tolist()
        settled = Settled(
            free_by_bounds=free[codes.BY_SPHERE],
            free_by_ellipsoids=free[codes.BY_OUTER],
            free_by_planes=free[codes.BY_PLANE],
            free_by_search=free[codes.BY_SEARCH],
            colliding_by_ellipsoids=hit[codes.BY_INNER],
            colliding_by_search=hit[codes.BY_SEARCH],
        )
        return _collisions(out, checked), settled

    def valid_edges(self, Q0: ArrayLike, Q1: ArrayLike, resolution: float) -> OneOrMany:
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
        ready = self._at_hand()
        if ready is not None:
            settled = ready.single.motion(Q0, Q1, resolution, edges.coarse_first)
            if settled is not None:
                self._learn(ready, abs(settled))
                return settled > 0
        step = _validate.positive_scalar(resolution, "resolution")
        a, b = self.robot.checked(Q0, "Q0"), self.robot.checked(Q1, "Q1")
        if a.ndim == 1 and b.ndim == 1 and self.robot.runs_straight:
            return self._valid_edge(a, b, step)
        a, b, shape = _motions(a, b, 40)
        valid = self._valid_edges(self._ready(), a, b, step)
        return valid.reshape(shape) if shape else bool(valid[0])

    def certify_edges(self, Q0: ArrayLike, Q1: ArrayLike, *, tolerance: float = 1e-5) -> CertifiedMotions:
        """Prove which straight motions are free of collisions at every one of their configurations.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
            Ends, broadcast together.
        tolerance : float
            Metres. A motion that comes within this of colliding may be AMBIGUOUS; every other is FREE or COLLIDING.

        Returns
        -------
        CertifiedMotions

        Raises
        ------
        InputError
            If the width is not dof, an entry is not finite, the shapes do not broadcast, the tolerance is not positive
            and finite; or if a motion is so long that it would take more than 458,752 intervals.
        UnknownNameError
            As for `collide`.

        See Also
        --------
        valid_edges : The same at samples, with nothing said about what is between them.

        Notes
        -----
        Joint values run straight, orientations turn at a constant rate along the shorter arc, as in `Robot.between`.
        Nothing is sampled: a plane is found between two bodies that proves a whole interval of the motion, and where
        there is none the interval is halved. docs/certified.md derives it. Surfaces and clouds that stand are seen as
        boxes around up to 128 parts of them: what comes nearer than these boxes allow is AMBIGUOUS. The first call with
        a new surface takes longer, since the parts are made then.

        Pairs named by `Scene.leave` may be in contact at the start of a motion, pairs named by `Scene.reach` at its
        end. On its way the contact gets deeper by no more than the tolerance, and at such an end it is no deeper than
        that.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> found = checker.certify_edges([0.0, 1.57], [[0.5, 1.57], [2.0, 1.57]])  # the post is in the way
        >>> found.verdict, found.names[1].tolist()
        (array([0, 1], dtype=int8), ['cart', 'post'])
        >>> checker.collide(checker.robot.between([0.0, 1.57], [2.0, 1.57], found.fraction[1]))
        True
        """
        tolerance = _validate.positive_scalar(tolerance, "tolerance")
        a, b = self.robot.checked(Q0, "Q0"), self.robot.checked(Q1, "Q1")
        shape: tuple[int, ...] = ()
        if a.ndim == 1 and b.ndim == 1:
            a, b = a[None], b[None]
        else:
            a, b, shape = _motions(a, b, 40)
        ready = self._ready()
        return self._certified(ready, a, b, tolerance).of_shape(shape, ready)

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
        T = ready.poses(checked[None])[0]
        meet = _collisions_by_pair(ready, _listed(ready), checked, T)
        a, b = ready.pairs[meet].T
        found = queries.distance(ready.bodies[a], T[a], ready.bodies[b], T[b], exact=True)
        return Contact.from_distances(((ready.names[i], ready.names[j]) for i, j in zip(a, b, strict=True)), found)

    def collide_by_pair(self, Q: ArrayLike) -> Bools:
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
        _validate.fits_memory(
            len(flat) * len(ready.pairs), f"{len(flat)} configurations of {len(ready.pairs)} pairs of bodies"
        )
        out = np.empty((len(flat), len(ready.pairs)), dtype=bool)
        each, listed = max(1, min(BY_PAIR, POSES_AT_ONCE // len(ready.names))), _listed(ready)
        for k in range(0, len(flat), each):
            for at, (q, T) in enumerate(zip(flat[k : k + each], ready.poses(flat[k : k + each]), strict=True), k):
                out[at] = _collisions_by_pair(ready, listed, q, T)
        return out.reshape(*checked.shape[:-1], len(ready.pairs))

    @overload
    def distance(
        self, Q: ArrayLike, *, exact: Literal[False] = ..., gradient: Literal[False] = ...
    ) -> StateDistance[None, None]: ...
    @overload
    def distance(
        self, Q: ArrayLike, *, exact: Literal[True], gradient: bool = ...
    ) -> StateDistance[OneOrMany, Floats]: ...
    @overload
    def distance(self, Q: ArrayLike, *, exact: bool, gradient: bool = ...) -> StateDistance: ...
    def distance(self, Q: ArrayLike, *, exact: bool = False, gradient: bool = False) -> StateDistance:
        """Bounds on how far the nearest pair is apart, and on request its exact distance; margins are not looked at.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        exact : bool
            Also compute the distance or depth, the pair, witnesses and normal.
        gradient : bool
            Also compute the derivative of the exact distance by the configuration, in metres for each radian or metre.

        Returns
        -------
        StateDistance
            In metres; of one configuration floats and names, of a batch arrays.

        Raises
        ------
        InputError
            As for `collide`; also if there is no pair to check, or a gradient is asked for without the exact distance.
        ConvergenceError
            As for `loewner.distance`.

        Notes
        -----
        The gradient is n · (J_b x_b - J_a x_a), with the normal n from a to b and the Jacobians of the witnesses as
        points of their links. Where the nearest pair, or its witnesses, are not the only ones the distance has a kink
        (two pairs tie; faces or edges are parallel): what is returned is the derivative of one of them. The derivative
        by a quaternion is that of the rotation it stands for, so that its component along the quaternion is 0.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> checker.distance([2.0, 3.0], exact=True, gradient=True).gradient.round(9) + 0.0
        array([-1.,  0.])
        """
        checked = self.robot.checked(Q)
        ready = self._ready()
        if len(ready.pairs) == 0:
            raise InputError("distance: expected a robot and a scene with pairs to check, found none")
        flat = _flat(checked)
        longest = max(map(len, ready.names))
        exact, gradient = _validate.flag(exact, "exact"), _validate.flag(gradient, "gradient")
        if gradient and not exact:
            raise InputError("gradient: expected exact=True with it, found exact=False: bounds have no gradient")
        row = 16 + exact * (8 + 3 * 24 + 2 * 4 * longest) + gradient * 8 * self.robot.dof
        _validate.fits_memory(2 * len(flat) * row, f"distances of {len(flat)} configurations")
        columns = self._nearest(ready, flat, exact)
        if gradient:
            columns.append(self._gradients(ready, flat, *(columns[k] for k in (3, 4, 6))))
        if exact:
            columns[3] = np.array(ready.names)[columns[3]]
        batch = checked.shape[:-1]
        if batch:
            return StateDistance(*(c.reshape(batch + c.shape[1:]) for c in columns))
        return StateDistance(
            *(float(c[0]) if c.ndim == 1 else tuple(c[0].tolist()) if c.dtype.kind == "U" else c[0] for c in columns)
        )

    @overload
    def clearance(self, Q: ArrayLike, *, softness: float = ..., gradient: Literal[False] = ...) -> OneOrMany: ...
    @overload
    def clearance(
        self, Q: ArrayLike, *, softness: float = ..., gradient: Literal[True]
    ) -> tuple[OneOrMany, Floats]: ...
    def clearance(
        self, Q: ArrayLike, *, softness: float = 0.005, gradient: bool = False
    ) -> OneOrMany | tuple[OneOrMany, Floats]:
        """Certified lower bound on the distance of the nearest pair that changes smoothly, and its gradient.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        softness : float
            Metres. The bound lies at most this times the logarithm of the number of pairs of pieces below the least of
            the gaps that it is taken of; the smaller, the nearer, and the sharper its bends.
        gradient : bool
            Also compute the derivative by the configuration.

        Returns
        -------
        clearance : float or ndarray, shape (...)
            In metres; negative where outer ellipsoids overlap. Margins are not looked at.
        gradient : ndarray, shape (..., dof)
            In metres for each radian or metre; only if it is asked for.

        Raises
        ------
        InputError
            As for `collide`; also if there is no pair to check, or the softness is not positive and finite.
        ConvergenceError
            If squares of positions overflow.

        See Also
        --------
        distance : Exact, with kinks.

        Notes
        -----
        Two ellipsoids have a gap between the planes that support them across their contact normal, n·r (1 - 1/√F) / ‖n‖
        with the contact function F of Perram and Wertheim. It is no more than their signed distance, and analytic
        except where centers coincide. Of the gaps g of all pairs of pieces, whose outer ellipsoids these are,
        -softness log Σ exp(-g / softness) is returned, less what rounding may have added. Surfaces and clouds that
        stand enter with up to 128 ellipsoids each, around parts of them, unless one of them is a solid. Where centers
        of two ellipsoids coincide the pair adds nothing to the gradient. The derivative by a quaternion is as in
        `distance`. Where they nearly do, it is finite but may be huge.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("ball", Body.sphere(0.1), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> clearance, gradient = checker.clearance([1.9, 3.0], gradient=True)
        >>> clearance <= checker.distance([1.9, 3.0], exact=True).distance
        True
        """
        checked = self.robot.checked(Q)
        softness, gradient = _validate.positive_scalar(softness, "softness"), _validate.flag(gradient, "gradient")
        ready, flat = self._ready(), _flat(checked)
        if not ready.starts_matter:  # of a solid all is wanted, not its surface
            ready = ready.in_parts
        if len(ready.pairs) == 0:
            raise InputError("clearance: expected a robot and a scene with pairs to check, found none")
        n, dof = flat.shape
        _validate.fits_memory(8 * n * (1 + gradient * dof), f"clearances of {n} configurations")
        lower, slopes = np.empty(n), np.empty((n * gradient, dof))

        def run(first: int, last: int) -> None:
            entries.clearances(
                gradient, softness, first, last, flat, ready.bodies._packed.handle, ready.handle,
                workspace(ready.memory_of_clearances), lower, slopes,
            )  # fmt: skip

        in_shares(run, n, LEAST_SHARE)
        if not np.isfinite(lower).all():
            q = np.array2string(flat[np.argmin(np.isfinite(lower))], precision=17)
            raise ConvergenceError(f"clearance: positions overflow at configuration {q}")
        batch = checked.shape[:-1]
        values: OneOrMany = lower.reshape(batch) if batch else float(lower[0])
        return (values, slopes.reshape(*batch, dof)) if gradient else values

    def distance_by_pair(self, Q: ArrayLike, *, within: float, gradient: bool = False) -> PairDistances:
        """Exact distances of all pairs that come within a distance of each other.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        within : float
            Metres, >= 0; pairs in contact are always listed. Margins are not looked at.
        gradient : bool
            Also compute the derivatives of the distances by the configuration.

        Returns
        -------
        PairDistances
            An entry for each pair at each configuration where it is that near, in the order of the configurations.

        Raises
        ------
        InputError
            As for `collide`, or if `within` is not a number >= 0.
        ConvergenceError
            As for `loewner.distance`.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 3.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> found = checker.distance_by_pair([[2.0, 3.0], [0.0, 3.0]], within=0.75)
        >>> for k, names, d in zip(found.configuration, found.names, found.distance):
        ...     print(k, *names, d.round(6))
        0 rail forearm 0.481002
        0 cart post 0.7
        1 rail forearm 0.481015
        """
        checked = self.robot.checked(Q)
        within, gradient = _validate.positive_scalar(within, "within", zero=True), _validate.flag(gradient, "gradient")
        ready, flat = self._ready(), _flat(checked)
        listed = self._near(ready, flat, within)
        _validate.fits_memory(len(listed) * 256, f"distances of {len(listed)} pairs")
        distance, vectors = np.empty(len(listed)), [np.empty((len(listed), 3)) for _ in range(3)]
        each = max(1, min(BY_PAIR, POSES_AT_ONCE // max(1, len(ready.names))))
        for k in range(0, len(flat), each):
            T, (start, stop) = ready.poses(flat[k : k + each]), np.searchsorted(listed[:, 0], [k, k + each])
            for p in np.unique(listed[start:stop, 1]):
                rows = start + np.flatnonzero(listed[start:stop, 1] == p)
                at, (a, b) = listed[rows, 0] - k, (int(body) for body in ready.pairs[p])
                found = queries.distance(ready.body(a), T[at, a], ready.body(b), T[at, b], exact=True)
                distance[rows] = found.distance
                for column, values in zip(vectors, (found.witness_a, found.witness_b, found.normal), strict=True):
                    column[rows] = values
        near = distance <= within
        listed, distance, vectors = listed[near], distance[near], [column[near] for column in vectors]
        bodies = ready.pairs[listed[:, 1]]
        gradients = self._gradients(ready, flat[listed[:, 0]], bodies, vectors[0], vectors[2]) if gradient else None
        names = np.array(ready.names)[bodies]
        return PairDistances(listed[:, 0], listed[:, 1], names, distance, vectors[0], vectors[1], vectors[2], gradients)

    # -- inside -------------------------------------------------------------------------------

    def _settle(
        self, mode: int, Q: Floats, ready: CheckedPairs | None = None
    ) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        """Verdict and tier of every configuration, in the scene as it is now unless `ready` is of another moment."""
        ready = self._ready() if ready is None else ready
        flat = _flat(Q)
        total = len(flat)
        if total > LEAST_SHARE:
            _validate.fits_memory(2 * total, f"{total} configurations")
        out, tiers = np.empty(total, dtype=np.int8), np.empty(total, dtype=np.int8)

        def run(first: int, last: int, hits: Ints) -> None:
            entries.check_configurations(
                mode, first, last, flat, ready.bodies._packed.handle, ready.handle, out, tiers, hits,
                workspace(ready.memory),
            )  # fmt: skip

        def share(first: int, last: int) -> None:
            # Counts of its own: threads that write side by side slow each other down.
            hits = np.zeros_like(ready.hits)
            run(first, last, hits)
            np.add(ready.hits, hits, out=ready.hits)

        if total <= LEAST_SHARE:
            run(0, total, ready.hits)
        else:
            in_shares(share, total, LEAST_SHARE)
        self._learn(ready, total)
        if mode == codes.EXACT and (out[0] == codes.AMBIGUOUS if total == 1 else (out == codes.AMBIGUOUS).any()):
            for k in np.flatnonzero(out == codes.AMBIGUOUS):
                out[k], tiers[k] = self._settle_pairs(ready, flat[k]), codes.BY_SEARCH
        return out, tiers

    def _valid_edges(self, ready: CheckedPairs, a: Floats, b: Floats, step: float) -> Bools:
        """`valid_edges` for motions of shape (N, dof), all of them in the scene as it was at one moment."""
        parts = edges.steps(self._lengths(a, b, step), step)
        valid = np.ones(len(a), dtype=bool)
        for edge, at in edges.rounds(parts, valid):
            out, _ = self._settle(codes.EXACT, self.robot.between(a[edge], b[edge], at), ready)
            valid[edge[out != Verdict.FREE]] = False
        return valid

    def _valid_edge(self, a: Floats, b: Floats, step: float) -> bool:
        """The same for one motion of joints that run straight, in one call."""
        ready = self._ready()
        fractions = edges.coarse_first(edges.steps(self.robot._distances(a, b), step))
        total = len(fractions)
        out, pack = np.empty(total, dtype=np.int8), ready.bodies._packed.handle
        verdict, settled = entries.check_motion(
            a, b, fractions, pack, ready.handle, out, ready.hits, workspace(ready.memory)
        )
        self._learn(ready, settled)
        if verdict != codes.AMBIGUOUS:
            return bool(verdict == codes.FREE)
        still_open = self.robot.between(a, b, fractions[np.flatnonzero(out == codes.AMBIGUOUS)])
        return all(self._settle_pairs(ready, q) == Verdict.FREE for q in still_open)

    def _certified(self, ready: CheckedPairs, a: Floats, b: Floats, tolerance: float) -> motions.Found:
        """`certify_edges` for motions of shape (N, dof), in the scene as it was at one moment."""
        found = self._without_contact(ready, a, b, tolerance)
        at = np.flatnonzero(found.verdicts != Verdict.FREE) if len(ready.ruled) else ready.ruled
        if len(at) == 0:
            return found
        rest = self._without_contact(ready.unruled, a[at], b[at], tolerance)
        numbers = np.append(np.setdiff1d(np.arange(len(ready.pairs)), ready.ruled), -1)
        found.verdicts[at], found.fractions[at], found.pairs[at] = rest.verdicts, rest.fractions, numbers[rest.pairs]
        found.work[at] += rest.work
        for k in at[rest.verdicts == Verdict.FREE]:
            end = self.robot._on_the_way(a[k], b[k])
            for pair in ready.ruled.tolist():
                verdict, fraction = contacts.settle(ready, pair, a[k], end, tolerance)
                if verdict != Verdict.FREE:
                    found.verdicts[k], found.fractions[k], found.pairs[k] = verdict, fraction, pair
                    if verdict == Verdict.COLLIDING:
                        break
        return found

    def _without_contact(self, ready: CheckedPairs, a: Floats, b: Floats, tolerance: float) -> motions.Found:
        """The same where every contact is a collision, also at the ends of motions."""
        found = motions.certify(ready, a, self.robot._on_the_way(a, b), tolerance)
        self._confirm(ready, a, b, found.verdicts, found.fractions)
        free = np.flatnonzero(found.verdicts == Verdict.FREE)
        for k in free[~self._starts_free(ready, a[free])]:
            verdicts = _pair_verdicts(ready, _listed(ready), ready.poses(a[k : k + 1])[0])
            verdict = Verdict.COLLIDING if (verdicts == Verdict.COLLIDING).any() else Verdict.AMBIGUOUS
            found.verdicts[k], found.fractions[k], found.pairs[k] = verdict, 0.0, (verdicts == verdict).argmax()
        return found

    def _starts_free(self, ready: CheckedPairs, a: Floats) -> Bools:
        """Which motions begin free, where `motions.settle` supposes it; what cannot be settled does not."""
        if not ready.starts_matter or len(a) == 0:
            return np.ones(len(a), dtype=bool)
        try:
            out, _ = self._settle(codes.EXACT, a, ready)
            return np.asarray(out == Verdict.FREE)
        except ConvergenceError:
            if len(a) == 1:
                return np.array([False])
            return np.concatenate([self._starts_free(ready, q[None]) for q in a])

    def _confirm(
        self, ready: CheckedPairs, a: Floats, b: Floats, verdicts: NDArray[np.int8], fractions: Floats
    ) -> None:
        """Leave as COLLIDING only what `collide` says of configurations that `Robot.between` gives.

        Values that run straight are the same bit for bit, but NumPy's sines are not the kernel's: orientations may
        differ in the last place. The scene may have changed since; the question is about what was prepared from it.
        """
        doubtful = verdicts == motions.BY_CARE
        if not self.robot.runs_straight:
            doubtful |= verdicts == Verdict.COLLIDING
        at = np.flatnonzero(doubtful)
        if len(at) == 0:
            return
        Q = self.robot.between(a[at], b[at], fractions[at])
        try:
            out, _ = self._settle(codes.EXACT, Q, ready)
            hit = out == Verdict.COLLIDING
        except ConvergenceError:
            hit = np.array([self._surely_collides(ready, q) for q in Q])
        verdicts[at] = np.where(hit, Verdict.COLLIDING, Verdict.AMBIGUOUS)

    def _surely_collides(self, ready: CheckedPairs, q: Floats) -> bool:
        """Whether one configuration collides; False where it cannot be settled."""
        try:
            out, _ = self._settle(codes.EXACT, q[None], ready)
        except ConvergenceError:
            return False
        return bool(out[0] == Verdict.COLLIDING)

    def _lengths(self, a: Floats, b: Floats, step: float) -> Floats:
        """Lengths of motions, each as if it were alone where the last bit decides in how many steps it is divided."""
        lengths = np.asarray(self.robot._distances(a, b))
        if self.robot.runs_straight:
            for k in edges.nearly_whole(lengths / step):
                lengths[k] = self.robot._distances(a[k], b[k])
        return lengths

    def _settle_pairs(self, ready: CheckedPairs, q: Floats) -> int:
        """One configuration that the fast searches left open, by each of its pairs."""
        verdicts = _pair_verdicts(ready, _listed(ready), ready.poses(q[None])[0])
        if (verdicts == Verdict.COLLIDING).any():
            return int(Verdict.COLLIDING)
        _refuse_unsettled(ready, q, verdicts)
        return int(Verdict.FREE)

    def _learn(self, ready: CheckedPairs, count: int) -> None:
        """Put the pairs that hit most often first, now and then."""
        self._seen += count
        if self._seen >= self._next_look and self._prepared is ready:
            self._next_look = 2 * self._seen
            self._prepared = ready.ordered()

    def _at_hand(self) -> CheckedPairs | None:
        """What the kernel takes, if nothing has changed since it was made."""
        ready = self._prepared
        return ready if ready is not None and ready.version == self._scene._version else None

    def _ready(self) -> CheckedPairs:
        """What the kernel takes, made anew if the scene has changed."""
        ready = self._at_hand()
        if ready is not None:
            return ready
        # Of one moment: what another thread changes meanwhile is noticed the next time.
        scene, ready = self._scene.snapshot(), self._prepared
        if ready is None or ready.structure_version != scene.structure_version:
            ready = prepared(self._robot, scene, self._skipped, scene.version)
            self._seen, self._next_look = 0, FIRST_LOOK
        else:
            ready = ready.placed(scene, scene.version)
        self._prepared = ready
        return ready

    def _nearest(self, ready: CheckedPairs, Q: Floats, exact: bool) -> list[Any]:
        """Columns of a `StateDistance` for some configurations, with numbers of bodies instead of names."""
        n, m, pack = len(Q), len(Q) * exact, ready.bodies._packed
        lower, upper, distance = np.empty(n), np.empty(n), np.empty(m)
        vectors = [np.empty((m, 3)) for _ in range(3)]
        pieces, status = np.empty((m, 2), dtype=np.int64), np.empty(m, dtype=np.int8)

        def run(first: int, last: int) -> None:
            entries.nearest_pairs(
                exact, first, last, Q, pack.handle, ready.handle, workspace(ready.memory_of_nearest),
                lower, upper, distance, *vectors, pieces, status,
            )  # fmt: skip

        in_shares(run, n, LEAST_SHARE)
        if not exact:
            return [lower, upper]
        # The bounds are proven, the value is computed: where rounding puts it outside, they know better.
        np.maximum(lower, np.minimum(distance, upper, out=distance), out=distance)
        bodies = np.searchsorted(pack.piece_start, pieces, side="right") - 1
        for k in np.flatnonzero(status):
            distance[k], bodies[k], *found = _nearest_with_care(ready, Q[k])
            for column, vector in zip(vectors, found, strict=True):
                column[k] = vector
        return [lower, upper, distance, bodies, *vectors]

    def _near(self, ready: CheckedPairs, Q: Floats, within: float) -> Ints:
        """Configurations and pairs that balls and boxes leave within a distance, in that order."""
        listed = np.empty((max(64, 4 * len(Q)), 2), dtype=np.int64)
        memory = workspace(ready.memory_of_nearest)
        while True:
            operands = within, 0, len(Q), Q, ready.bodies._packed.handle, ready.handle, memory
            count = entries.near_pairs(*operands, listed, 0)
            if count <= len(listed):
                found = listed[:count]
                return found[np.lexsort((found[:, 1], found[:, 0]))]
            _validate.fits_memory(16 * count, f"{count} pairs")
            listed = np.empty((count, 2), dtype=np.int64)

    def _gradients(self, ready: CheckedPairs, Q: Floats, bodies: Ints, witness: Floats, normal: Floats) -> Floats:
        """Derivatives of exact distances of pairs of bodies by the configuration, one each."""
        gradients = np.empty((len(Q), self.robot.dof))

        def run(first: int, last: int) -> None:
            entries.pair_gradients(
                first, last, Q, ready.bodies._packed.handle, ready.handle, workspace(ready.memory_of_clearances),
                bodies, normal, witness, gradients,
            )  # fmt: skip

        in_shares(run, len(Q), LEAST_SHARE)
        return gradients


def _nearest_with_care(ready: CheckedPairs, q: Floats) -> tuple[Any, ...]:
    """The nearest pair at a configuration where the fast searches did not find it, by pairs one at a time."""
    T = ready.poses(q[None])[0]
    a, b = ready.pairs.T
    bounds = queries.distance(ready.bodies[a], T[a], ready.bodies[b], T[b])
    best, nearest, found = np.inf, 0, None
    for p in np.argsort(bounds.lower, kind="stable"):
        if bounds.lower[p] > min(best, bounds.upper.min()):
            break
        i, j = (int(body) for body in ready.pairs[p])
        one = queries.distance(ready.body(i), T[i], ready.body(j), T[j], exact=True)
        if one.distance < best:
            best, nearest, found = one.distance, int(p), one
    assert found is not None  # the first bound is below all upper ones
    return best, ready.pairs[nearest], found.witness_a, found.witness_b, found.normal


def _collisions(out: NDArray[np.int8], Q: Floats) -> OneOrMany:
    """Whether configurations collide, from their verdicts."""
    return bool(out[0]) if Q.ndim == 1 else (out == Verdict.COLLIDING).reshape(Q.shape[:-1])


class _Listed(NamedTuple):
    """Pairs of one margin, as `settle` takes them."""

    margin: float
    at: Ints  # their places among all
    plan: Ints
    rows: Ints


def _listed(ready: CheckedPairs) -> list[_Listed]:
    """All pairs, by their margins."""
    found = []
    for margin in np.unique(ready.margins).tolist():
        at = np.flatnonzero(ready.margins == margin)
        plan = np.array([[len(at)], [1], [1], [1], [1]], dtype=np.int64)
        found.append(_Listed(margin, at, plan, np.ascontiguousarray(ready.pairs[at].T)))
    return found


def _pair_verdicts(ready: CheckedPairs, listed: list[_Listed], T: Floats) -> NDArray[np.int8]:
    """Verdict of every pair where the bodies are at T; AMBIGUOUS if none was found, or T is bent by overflow."""
    pack, verdicts = ready.bodies._packed.handle, np.full(len(ready.pairs), codes.AMBIGUOUS, dtype=np.int8)
    for margin, at, plan, rows in listed:
        found = np.empty(len(at), dtype=np.int8)
        if settle(codes.EXACT, margin, 0, len(at), (plan, rows, pack, T, pack, T), found) is not None:
            verdicts[at] = found
    return verdicts


def _collisions_by_pair(ready: CheckedPairs, listed: list[_Listed], q: Floats, T: Floats) -> Bools:
    """Which pairs collide at one configuration, where the bodies are at T."""
    verdicts = _pair_verdicts(ready, listed, T)
    _refuse_unsettled(ready, q, verdicts)
    return np.asarray(verdicts == Verdict.COLLIDING)


def _refuse_unsettled(ready: CheckedPairs, q: Floats, verdicts: NDArray[np.int8]) -> None:
    """An answer that arithmetic could not settle is an exception, never a guess."""
    unsettled = np.flatnonzero(verdicts == Verdict.AMBIGUOUS)
    if len(unsettled):
        a, b = (ready.names[k] for k in ready.pairs[unsettled[0]])
        raise ConvergenceError(
            f"collide: {a} and {b} could not be settled at configuration {np.array2string(q, precision=17)}; treat it "
            "as colliding or change it by a hair"
        )


def _motions(a: Floats, b: Floats, each: int) -> tuple[Floats, Floats, tuple[int, ...]]:
    """Ends of motions broadcast together, in one column each, and their shape; `each` bytes a motion go with them."""
    try:
        a, b = np.broadcast_arrays(a, b)
    except ValueError:
        texts = _validate.shape_text(a.shape), _validate.shape_text(b.shape)
        raise InputError(f"expected Q0 and Q1 whose shapes broadcast, found {texts[0]} and {texts[1]}") from None
    shape = a.shape[:-1]
    _validate.fits_memory(math.prod(shape) * (16 * a.shape[-1] + each), f"{_validate.shape_text(shape)} motions")
    return np.ascontiguousarray(_flat(a)), np.ascontiguousarray(_flat(b)), shape


def _flat(Q: Floats) -> Floats:
    """All configurations in one column; also of a robot without joints, where a length of -1 tells nothing."""
    return Q.reshape(math.prod(Q.shape[:-1]), Q.shape[-1])
