"""Scenes: named bodies in the world or attached to a robot's links, allowed contacts, and margins.

A `Scene` may change between queries: bodies are added, moved, grasped and put down by name. The bodies themselves never
change, so a change replaces a few dictionary entries and needs no new fit. A scene has no robot; `CollisionChecker`
combines a scene with a robot, and checks the names of links.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._pictures import COLOURS, MOST_BODIES, MOST_NAMES, Shape, bodies, pictured
from loewner._base._plausible import doubt_about_size, warn
from loewner._base._read_only import KeepsReadOnly
from loewner._base._rotations import pose_of
from loewner._base._validate import Entry, Floats, Ints, Pair, expect_name
from loewner._kernels.columns import OUTER_RADIUS
from loewner.bodies import Bodies, Body, for_pictures, packed_of, reach_of
from loewner.errors import InputError
from loewner.queries import crowds
from loewner.queries import pairs as queries
from loewner.queries.pairs import Bounds, Distance, Measured
from loewner.queries.pose_paths import PoseBounds, PosePath, path_of, with_twist
from loewner.scenes import maps as _maps

# One name or a pair of names; None in place of a name means any link.
MarginKey = tuple[str | None, ...]

# This lock is held for microseconds while a scene changes or is copied. All scenes share the lock, so that copies and
# pickles contain no lock, and a fork has to handle only one lock.
_CHANGING = threading.RLock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_CHANGING.acquire, after_in_parent=_CHANGING.release, after_in_child=_CHANGING.release)


@dataclass(frozen=True, eq=False)
class Contact:
    """Two named bodies that touch, overlap, or come within their margin.

    Attributes
    ----------
    name_a, name_b : str
        Names of a scene's bodies or of a robot's links.
    distance : float
        In metres. A negative distance is minus the depth of the two pieces that overlap most deeply. The distance is
        positive for bodies that are apart but within their margin. For bodies that just touch, rounding may make it
        slightly positive.
    witness_a, witness_b : ndarray, shape (3,)
        Points of a and of b in world coordinates, such that witness_b - witness_a = distance * normal.
    normal : ndarray, shape (3,)
        Unit vector from a to b.

    Examples
    --------
    >>> scene = Scene()
    >>> scene.add("ball", Body.sphere(1.0))
    >>> scene.add("box", Body.box([1, 1, 1]))
    >>> (contact,) = scene.pairs()
    >>> contact.name_a, contact.name_b, contact.distance < 0
    ('ball', 'box', True)
    """

    name_a: str
    name_b: str
    distance: float
    witness_a: Floats
    witness_b: Floats
    normal: Floats

    @classmethod
    def from_distances(cls, names: Iterable[Pair], found: Distance) -> tuple[Contact, ...]:
        """Make one contact per pair of names, from exact distances.

        Parameters
        ----------
        names : iterable of pairs of str
        found : Distance
            One distance per pair of names, computed with ``exact=True``.

        Returns
        -------
        tuple of Contact

        Raises
        ------
        InputError
            If the number of names differs from the number of exact distances.
        """
        if not isinstance(found, Distance) or found.normal is None or found.normal.ndim != 2:
            raise InputError(f"found: expected exact distances of a row of pairs, found {_validate.short(found)}")
        listed = [_pair_as_given(pair) for pair in _validate.listed(names, "names")]
        if len(listed) != len(found.normal):
            raise InputError(f"names: expected {len(found.normal)} pairs, as found, found {len(listed)}")
        rows = zip(listed, found.distance.tolist(), found.witness_a, found.witness_b, found.normal, strict=True)
        return tuple(cls(a, b, distance, *vectors) for (a, b), distance, *vectors in rows)


@dataclass(frozen=True, eq=False)
class Attachment(KeepsReadOnly):
    """How a body is attached to a robot's link.

    Attributes
    ----------
    link : str
        The link that carries the body.
    T_link_body : ndarray, shape (4, 4)
        Pose of the body in the frame of the link; translation in metres.
    touch_links : tuple of str
        Links that the body may touch while it is attached, sorted; they include the link that carries the body.

    Examples
    --------
    >>> scene = Scene()
    >>> scene.add("can", Body.cylinder(radius=0.03, length=0.14))
    >>> scene.attach("can", "hand", touch_links=["finger"])
    >>> scene.attachments["can"].touch_links
    ('finger', 'hand')
    """

    link: str
    T_link_body: Floats
    touch_links: tuple[str, ...]


@guarded
class Scene:
    """Named bodies with poses, attachments to links, allowed pairs and margins.

    Parameters
    ----------
    margin : float
        Distance in metres that every pair with at least one body of the scene has to keep; see `margin_of`.

    Notes
    -----
    Iterating over a scene yields the names of its bodies, in the order in which they were added. The scene's own
    queries (`pairs`, `collide`, `distance`) do not consider attached bodies, whose poses depend on a robot's
    configuration. If a time is passed, `pairs` and `collide` also consider bodies that follow motions (`follow`).
    `distance` accepts only static bodies.

    A thread may change a scene while other threads query it: each change is atomic, and each query uses one consistent
    state. Adding a body that is probably not in metres causes a warning, once per scene.

    Examples
    --------
    >>> scene = Scene()
    >>> scene.add("table", Body.box([1.0, 1.0, 0.1]))
    >>> T = np.eye(4)
    >>> T[2, 3] = 0.3
    >>> scene.add("ball", Body.sphere(0.1), T)
    >>> scene.collide()
    False
    >>> T[2, 3] = 0.1
    >>> scene.move("ball", T)
    >>> [(contact.name_a, contact.name_b, round(contact.distance, 9)) for contact in scene.pairs()]
    [('table', 'ball', -0.05)]
    """

    def __init__(self, *, margin: float = 0.0) -> None:
        self._margin = _validate.positive_scalar(margin, "margin", zero=True)
        self._bodies: dict[str, Body] = {}
        self._poses: dict[str, Floats] = {}
        self._attachments: dict[str, Attachment] = {}
        self._following: dict[str, PosePath] = {}
        self._bounds: dict[str, PoseBounds] = {}
        self._off: dict[str, float] = {}  # in a snapshot: how far points of bodies may deviate [m]
        self._allowed: set[Pair] = set()
        self._leaving: set[Pair] = set()
        self._reaching: set[Pair] = set()
        self._margins: dict[MarginKey, float] = {}
        self._lowered: set[MarginKey] = set()
        self._version = self._structure_version = 0
        self._packed: tuple[int, Bodies] | None = None
        self._doubted = False

    def __getstate__(self) -> dict[str, Any]:
        return self.snapshot().__dict__

    def __repr__(self) -> str:
        count = "1 body" if len(self) == 1 else f"{len(self)} bodies"
        off = f", {len(self._bounds)} known by bounds" if self._bounds else ""
        return f"Scene({count}, {len(self._attachments)} attached{off})"

    @pictured
    def _repr_html_(self) -> str:
        shapes, entries, note = drawn(self, {})
        return bodies(shapes, (), entries, note)

    # -- contents -----------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self._bodies)

    def __contains__(self, name: object) -> bool:
        return name in self._bodies

    def __iter__(self) -> Iterator[str]:
        return iter(self._bodies)

    def __getitem__(self, name: str) -> Body:
        return self._bodies[self._known(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies, in the order in which they were added."""
        return tuple(self._bodies)

    @property
    def static_names(self) -> tuple[str, ...]:
        """Names of the static bodies, in the order of `names`; a static body is not attached and follows no motion."""
        with _CHANGING:
            return tuple(name for name in self._bodies if name in self._poses)

    @property
    def static_bodies(self) -> Bodies:
        """The bodies in `static_names`, packed; the same object is returned until `structure_version` increases."""
        with _CHANGING:
            packed, version = self._packed, self._structure_version
            standing = [self._bodies[name] for name in self.static_names]
        if packed is None or packed[0] != version:
            self._packed = packed = version, Bodies(standing)
        return packed[1]

    @property
    def static_poses(self) -> Floats:
        """World poses of the bodies in `static_names`, shape (n, 4, 4), as a new array."""
        with _CHANGING:
            poses = self._poses  # without bodies that move
            # The bytes of the poses are joined, because NumPy takes twice as long for a list of arrays.
            joined = bytearray().join([poses[name] for name in self._bodies if name in poses])
        return np.frombuffer(joined).reshape(-1, 4, 4)

    @property
    def attachments(self) -> dict[str, Attachment]:
        """Links and poses of the attached bodies, keyed by the names of the bodies."""
        return _validate.Named("attached body", self._in_order(self._attachments))

    @property
    def following(self) -> dict[str, PosePath]:
        """The motions that bodies follow, keyed by the names of the bodies."""
        return _validate.Named("body that follows a motion", self._in_order(self._following))

    @property
    def bounds(self) -> dict[str, PoseBounds]:
        """Bounds on how far bodies may be from their poses or motions, keyed by name; all other poses are exact."""
        return self._in_order(self._bounds)

    def _in_order(self, held: dict[str, Entry]) -> dict[str, Entry]:
        """Copy entries of bodies, in the order in which the bodies were added."""
        with _CHANGING:
            return {name: held[name] for name in self._bodies if name in held}

    @property
    def version(self) -> int:
        """A number that grows with every change, by which data prepared from an older state can be recognised."""
        return self._version

    @property
    def structure_version(self) -> int:
        """A number that grows with every change except changes of poses and motions."""
        return self._structure_version

    def pose(self, name: str) -> Floats:
        """Return the pose of a body in the world, shape (4, 4), as a new array.

        Parameters
        ----------
        name : str

        Returns
        -------
        ndarray, shape (4, 4)
            T_world_body; translation in metres.

        Raises
        ------
        InputError
            If the body is attached to a link, or follows a motion (see `following`).
        """
        with _CHANGING:
            return self._poses[self._placed(name)].copy()

    def copy(self) -> Scene:
        """Return a copy of the scene; later changes to one of the two do not affect the other.

        Returns
        -------
        Scene
            A scene with the same bodies, margins and rules; both scenes share the bodies, since these never change.
        """
        other = self.snapshot()
        other._version = other._structure_version = 0
        other._packed = None
        return other

    def snapshot(self) -> Scene:
        """Copy the scene and its versions in one consistent state.

        Changes in other threads then do not affect a query of the copy.

        Returns
        -------
        Scene
            A copy, which shares arrays that are already packed.
        """
        other = object.__new__(Scene)
        with _CHANGING:
            for name, value in self.__dict__.items():
                other.__dict__[name] = value.copy() if isinstance(value, (dict, set)) else value
        return other

    # -- changes ------------------------------------------------------------------------------

    @classmethod
    def from_map(
        cls, path: str | os.PathLike[str], *, height: float, unknown: bool = True, margin: float = 0.0
    ) -> Scene:
        """Make a scene from a map of the ROS map server; the map's occupied cells become boxes on the plane z = 0.

        Parameters
        ----------
        path : path
            The YAML file, which names the image. PNG and BMP images need Pillow (the ``plots`` extra); PGM images do
            not. The mode must be trinary or scale. In mode scale, all cells that are not free count as occupied.
        height : float
            Height of the boxes, in metres.
        unknown : bool
            Whether unknown cells count as occupied. Everything outside the map is free.
        margin : float
            As for `Scene`.

        Returns
        -------
        Scene
            A scene with the body "map", or without bodies if no cell is occupied. Cells that form a rectangle become
            one box. The pose of the body is the origin of the map.

        Raises
        ------
        FileError
            If a file is missing, damaged or not greyscale, a key is missing or unknown, or a threshold is not between 0
            and 1.
        InputError
            If the height is not positive.
        MissingExtraError
            If PyYAML (the ``robots`` extra) or Pillow is missing.
        """
        top = _validate.positive_scalar(height, "height")
        counted = _validate.flag(unknown, "unknown")
        grid = _maps.read_map(path)
        scene = cls(margin=margin)
        body = _maps.body_of(grid, top, unknown=counted)
        if body is not None:
            scene.add("map", body, _maps.corner(grid))
        return scene

    def add(
        self,
        name: str,
        body: Body,
        T_world_body: ArrayLike | None = None,
        *,
        margin: float | None = None,
        error: ArrayLike | None = None,
    ) -> None:
        """Put a body into the world.

        Parameters
        ----------
        name : str
            A name that no body of the scene has yet.
        body : Body
        T_world_body : array_like, shape (4, 4), or None
            Pose of the body, with its translation in metres; None is the identity.
        margin : float, optional
            Distance in metres that this body has to keep, unless a larger margin applies; see `margin_of`.
        error : array_like, shape (2,), optional
            Bounds on the error of the pose, in metres and radians, as for `move`.

        Raises
        ------
        InputError
            If the name is taken or not a string, `body` is not a body, or the margin or an error is negative or not
            finite.
        PoseError
            If the pose is not a rigid motion.

        Warns
        -----
        UserWarning
            Once per scene, if a body is probably not in metres, because it is kilometres across, kilometres away, or
            much smaller than a millimetre.
        """
        name = expect_name(name)
        _validate.instance(body, f"body of {name!r}", Body)
        T = _validate.pose(T_world_body, f"T_world_body of {name!r}")
        keep = None if margin is None else _validate.positive_scalar(margin, f"margin of {name!r}", zero=True)
        bounds = _bounds_of(body, _validate.pose_error(error, f"error of {name!r}"))
        with self._change():
            if name in self._bodies:
                raise InputError(f"name: expected a new name, found {name!r}, which is taken; replace or remove it")
            self._bodies[name] = body
            self._poses[name] = T
            self._set_bounds(name, bounds)
            if keep is not None:
                self._margins[(name,)] = keep
        if not self._doubted:
            self._doubt(name, body, T)

    def _doubt(self, name: str, body: Body, T: Floats) -> None:
        """Warn, once per scene, if a body is probably not in metres."""
        radius = float(packed_of(body).kernel.table[:, OUTER_RADIUS].max(initial=0.0))
        doubt = doubt_about_size(radius, max(map(abs, T[:3, 3].tolist())))
        if doubt:
            self._doubted = True
            warn(f"body {name!r}: expected {doubt} (this warning is given once for each scene)")

    def remove(self, name: str) -> None:
        """Remove a body, with all margins and allowed pairs that name it.

        Parameters
        ----------
        name : str

        Raises
        ------
        UnknownNameError
            If there is no such body.
        """
        with self._change():
            del self._bodies[self._known(name)]
            self._let_go(name)
            # A body that is later added under the same name must not inherit permission to touch.
            self._allowed -= {pair for pair in self._allowed if name in pair}
            self._margins = {key: margin for key, margin in self._margins.items() if name not in key}
            self._lowered.intersection_update(self._margins)

    def replace(self, name: str, body: Body) -> None:
        """Replace a body with a new body, for instance from a camera's next image; everything else stays the same.

        Parameters
        ----------
        name : str
            Name of the body to replace. The new body takes over the old body's pose or attachment, bounds on the pose,
            margins and allowed pairs.
        body : Body

        Raises
        ------
        UnknownNameError
            If there is no such body.
        InputError
            If `body` is not a body.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("camera", Body.from_cloud([[0, 0, 1]], radius=0.01), margin=0.02)
        >>> scene.replace("camera", Body.from_cloud([[0, 0, 1.1]], radius=0.01))
        >>> scene.margins
        {('camera',): 0.02}
        """
        _validate.instance(body, f"body of {_validate.short(name)}", Body)
        with self._change():
            self._bodies[self._known(name)] = body
            if name in self._bounds:
                self._bounds[name] = replace(self._bounds[name], reach=reach_of(body))
            T = self._poses.get(name)  # None for a body on a link or with a motion
        if not self._doubted and T is not None:
            self._doubt(name, body, T)

    def move(
        self,
        name: str | Mapping[str, ArrayLike | None],
        T_world_body: ArrayLike | None = None,
        *,
        error: ArrayLike | None = None,
    ) -> None:
        """Move one body, ``move(name, T)``, or several bodies, ``move({name: T, ...})``.

        Parameters
        ----------
        name : str, or mapping from names to poses
            The name of the body, or a mapping from names to poses. If any name or pose of a mapping is wrong, no body
            is moved.
        T_world_body : array_like, shape (4, 4), or None
            The new pose, with its translation in metres; None is the identity.
        error : array_like, shape (2,), optional
            How far the pose may be wrong, in metres and radians: the body's origin deviates by at most the first
            number, and its orientation by at most the second number. A point at distance ρ from the body's origin then
            deviates by at most ``error[0]`` + ρ · ``error[1]``; `bounds` contains the largest ρ. Answers hold for all
            poses within the error: FREE means free at each such pose. By default, the new pose is exact, even if the
            earlier pose was not.

        Raises
        ------
        InputError
            If a body is attached to a link (detach it first), or an error is negative or not finite.

        Notes
        -----
        With an error, `collide` is True if the body may collide. COLLIDING means a collision at the pose
        `T_world_body`; everything else that is not free is AMBIGUOUS. Exact distances apply to this pose. Bounds on
        distances, and clearances, hold for all poses within the error.

        An error is added to the margins of the body, so a checker has to prepare its pairs again whenever the error
        changes. Moving a body with an unchanged error is as fast as moving it without an error.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("crate", Body.box([0.6, 0.8, 0.2]))
        >>> scene.move("crate", np.eye(4), error=(0.01, 0.1))
        >>> print(round(scene.bounds["crate"].off(0.0), 3))  # 0.01 + 0.51 * 0.1
        0.061
        """
        if isinstance(name, Mapping):
            if T_world_body is not None:
                raise InputError("T_world_body: expected none with a mapping from names to poses, found one")
            moves = name
        else:
            moves = {self._known(name): T_world_body}
        checked = {key: _validate.pose(T, f"T_world_body of {key!r}") for key, T in moves.items()}
        self._move(checked, _validate.pose_error(error, "error"))

    def _move(self, moves: Mapping[Any, Floats], error: tuple[float, float]) -> None:
        with _CHANGING:
            self._poses.update({self._placed(key): T for key, T in moves.items()})
            if any(error) or self._bounds:
                before = self._bounds.copy()
                for key in moves:
                    self._set_bounds(key, _bounds_of(self._bodies[key], error))
                self._structure_version += self._bounds != before
            self._version += 1

    def _set_bounds(self, name: str, bounds: PoseBounds | None) -> None:
        if bounds is None:
            self._bounds.pop(name, None)
        else:
            self._bounds[name] = bounds

    def move_all(self, names: Iterable[str], Ts: ArrayLike, *, error: ArrayLike | None = None) -> None:
        """Move many bodies, such as objects that a tracker reports; this is faster than `move` with a mapping.

        Parameters
        ----------
        names : iterable of str
            The bodies, each once.
        Ts : array_like, shape (n, 4, 4)
            The new poses of the bodies, with translations in metres. If any name or pose is wrong, no body is moved.
        error : array_like, shape (2,), optional
            How far each pose may be wrong, as for `move`.

        Raises
        ------
        InputError
            If the numbers of names and poses differ, a name occurs twice, or a body is attached to a link (detach it
            first).
        PoseError
            If a pose is not a rigid motion.
        UnknownNameError
            If there is no such body.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("a", Body.sphere(0.1))
        >>> scene.add("b", Body.sphere(0.1))
        >>> T = np.tile(np.eye(4), (2, 1, 1))
        >>> T[:, 0, 3] = 1.0, 2.0
        >>> scene.move_all(["a", "b"], T)
        >>> float(scene.pose("b")[0, 3])
        2.0
        """
        moving = _validate.listed(names, "names", wanted="several names")
        poses = _validate.poses(Ts, "Ts")
        if poses.shape != (len(moving), 4, 4):
            shape = _validate.shape_text(poses.shape)
            raise InputError(f"Ts: expected a pose for each of {len(moving)} names, shape (n, 4, 4), found {shape}")
        off = _validate.pose_error(error, "error")
        with _CHANGING:
            moves = dict(zip(map(self._placed, moving), poses.copy(), strict=True))
            if len(moves) < len(moving):
                raise InputError(f"names: expected names that differ, found {_validate.short(moving)}")
            self._move(moves, off)

    def follow(
        self,
        name: str,
        times: ArrayLike,
        poses: ArrayLike,
        *,
        repeat: bool = False,
        twist: ArrayLike | None = None,
        speed: float = 0.0,
        turn: float = 0.0,
        since: float | None = None,
        error: ArrayLike | None = None,
    ) -> None:
        """Let a body, such as a part on a conveyor, a door or an object whose path a tracker predicts, follow a motion.

        From then on, queries of a `CollisionChecker` need times, and its proofs of the robot's motions take the body's
        motion into account. A checker does not check the scene's bodies against each other; `pairs` does.

        Parameters
        ----------
        name : str
            A body of the scene. If the body already follows a motion, the new motion replaces the old one.
        times : array_like, shape (n,)
            At least two increasing times, in seconds; or one time, for a body at rest with a `speed`, `turn` or
            `error`.
        poses : array_like, shape (n, 4, 4)
            T_world_body at these times; translation in metres. Between two times, the position changes linearly, and
            the body turns at a constant rate through the smaller angle.
        repeat : bool
            Whether the motion starts again when it ends; the last pose must then equal the first one. By default, the
            body waits at the first pose before the motion, and at the last pose after the motion.
        twist : array_like, shape (6,), optional
            Velocity of the body's origin [m/s] and angular velocity [rad/s], both in the world's frame, and constant
            between two `times`; with a twist, `poses` is only the first pose, shape (4, 4). The origin moves along a
            straight line, and the body turns about its origin, so the motion is not a screw motion about another axis.
        speed, turn : float
            Bounds on how fast the body departs from this motion [m/s, rad/s], such as 1.6 m/s for a person. At time t,
            the body's origin deviates by at most speed · \\|t - since\\|, and its orientation by at most turn · \\|t -
            since\\|. A point at distance ρ from the origin then deviates by at most (speed + ρ · turn) · \\|t -
            since\\|. `bounds` contains the largest ρ. For tight bounds, put the origin of the body's frame in the
            middle of the body.
        since : float, optional
            Time in seconds at which the body was last seen; the default is the first of `times`.
        error : array_like, shape (2,), optional
            Bounds on the error at the time `since`, in metres and radians, which add to the deviations above; see
            `move`.

        Notes
        -----
        With `speed`, `turn` or `error`, answers hold for all motions within these bounds: FREE means free on each such
        motion, and `collide` is True if the body may collide. COLLIDING means a collision with the body on the motion
        itself; everything else that is not free is AMBIGUOUS. Distances and their bounds apply only to the motion
        itself. Calling `follow` again without these arguments removes the bounds.

        Raises
        ------
        InputError
            If the body is attached to a link; if times do not increase; if the numbers of times and poses differ; if
            two successive poses differ by half a turn; or if a bound is negative or not finite.
        PoseError
            If a pose is not a rigid motion.
        UnknownNameError
            If there is no such body.

        See Also
        --------
        detach : Stop the body.
        attach : Stop the body and attach it to a link.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("box", Body.box([0.2, 0.2, 0.2]))
        >>> T = np.tile(np.eye(4), (2, 1, 1))
        >>> T[:, 0, 3] = -1.0, 1.0
        >>> scene.follow("box", [0.0, 10.0], T)  # 0.2 m/s along x
        >>> scene.static_names, scene.following["box"].poses(2.5)[:3, 3].tolist()
        ((), [-0.5, 0.0, 0.0])
        >>> scene.follow("box", [0.0, 10.0], T[0], twist=[0.2, 0.0, 0.0, 0.0, 0.0, 1.0])  # the same, and it turns

        A person was last seen at the origin at 2 s, and has since walked in an unknown direction:

        >>> scene.add("person", Body.capsule(radius=0.3, length=1.2))
        >>> scene.follow("person", [2.0], np.eye(4)[None], speed=1.6)
        >>> print(round(scene.bounds["person"].off(2.5), 9))
        0.8
        """
        self._known(name)
        rates = (
            _validate.positive_scalar(speed, "speed", zero=True), _validate.positive_scalar(turn, "turn", zero=True),
        )  # fmt: skip
        off = _validate.pose_error(error, "error")
        begin = None if since is None else _validate.real(since, "since")
        if begin is not None and not any(rates):
            raise InputError(f"since: expected speed or turn with it, found since = {begin:.15g} alone")
        if any((*rates, *off)) and twist is None:
            times, poses = _rest(times, poses)
        path = path_of(*((times, poses) if twist is None else with_twist(times, poses, twist)), repeat)
        with _CHANGING:
            before = self._following.get(self._known(name))
            was_bounded = name in self._bounds
            rested = before is not None and before.rests and was_bounded
            if before is None:
                self._poses.pop(self._placed(name))
            self._following[name] = path
            body = self._bodies[name]
            first = float(path.times[0]) if begin is None else begin
            self._set_bounds(name, _bounds_of(body, off, rates, first))
            bounded = name in self._bounds
            self._structure_version += before is None or was_bounded != bounded or rested != (path.rests and bounded)
            self._version += 1
        if not self._doubted:
            self._doubt(name, body, pose_of(np.eye(3), np.abs(path.positions).max(axis=0)))

    def attach(
        self,
        name: str,
        link: str,
        T_link_body: ArrayLike | None = None,
        *,
        touch_links: Iterable[str] = (),
        leave: Iterable[str] = (),
        reach: Iterable[str] = (),
    ) -> None:
        """Attach a body, such as a grasped object, to a link, with which the body then moves.

        Parameters
        ----------
        name : str
            A body of the scene. If the body is already attached to a link, it is handed over to the new link. If it
            follows a motion, it stops following the motion. Bounds on its pose are dropped.
        link : str
            Name of a link; the name is checked when the scene is combined with a robot.
        T_link_body : array_like, shape (4, 4), or None
            Pose of the body in the frame of the link, with its translation in metres; None is the identity.
        touch_links : iterable of str
            Links that the body may touch while it is attached, in addition to `link` itself.
        leave : iterable of str
            Bodies or links that the body touches now and must leave, such as the table below it; see `leave`.
        reach : iterable of str
            Bodies or links that the body may touch at the end of a motion, such as the shelf on which it is placed; see
            `reach`.

        Warns
        -----
        UserWarning
            If `allow` permits contact between this body and another body or link, since proofs of motions ignore that
            pair.

        Notes
        -----
        Attaching a body ends earlier rules of `leave` and `reach` that name the body. Detaching the body ends the new
        rules.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("table", Body.box([1.0, 1.0, 0.1]))
        >>> scene.add("can", Body.cylinder(radius=0.03, length=0.14))
        >>> scene.attach("can", "hand", touch_links=["left_finger", "right_finger"], leave=["table"])
        >>> scene.static_names, scene.leaving
        (('table',), frozenset({('can', 'table')}))
        """
        self._known(name)
        link = expect_name(link, "link: expected a name")
        touching = {link, *_names(touch_links, "touch_links")}
        leaving = {_pair(name, other) for other in _names(leave, "leave")}
        reaching = {_pair(name, other) for other in _names(reach, "reach")}
        T = _validate.pose(T_link_body, f"T_link_body of {name!r}")
        T.setflags(write=False)
        with self._change():
            self._let_go(self._known(name))
            self._attachments[name] = Attachment(link, T, tuple(sorted(touching)))
            self._leaving |= leaving
            self._reaching |= reaching
            unseen = sorted(
                pair for pair in self._allowed - leaving - reaching if name in pair and not touching.intersection(pair)
            )
        if unseen:
            warn(
                f"attach of {name!r}: {', '.join(map(_text, unseen))} stay allowed to touch by Scene.allow, so that "
                "proofs of motions ignore them; name the support of the body in leave=[...], or forbid the pair"
            )

    def detach(self, name: str, T_world_body: ArrayLike | None) -> None:
        """Put an attached body back into the world, or stop a body that follows a motion.

        Parameters
        ----------
        name : str
        T_world_body : array_like, shape (4, 4), or None
            The new pose in the world, with its translation in metres; None is the identity. To release a body in place,
            pass the link's pose times `T_link_body`.

        Raises
        ------
        InputError
            If the body is neither attached nor following a motion.
        """
        T = _validate.pose(T_world_body, f"T_world_body of {self._known(name)!r}")
        with self._change():
            if self._known(name) in self._poses:
                raise InputError(f"{name!r}: expected an attached body, found one that stands in the world")
            self._let_go(name)
            self._poses[name] = T

    # -- rules --------------------------------------------------------------------------------

    @property
    def allowed(self) -> frozenset[Pair]:
        """Pairs whose contact is allowed, each sorted by name."""
        with _CHANGING:
            return frozenset(self._allowed)

    def allow(self, a: str, b: str) -> None:
        """Allow two bodies or links to touch; from then on, queries ignore contact between the two.

        Parameters
        ----------
        a, b : str
            Names of bodies, which may be added later, or of links.
        """
        self._add_rule(self._allowed, _pair(a, b))

    def forbid(self, a: str, b: str) -> None:
        """Undo `allow`.

        Parameters
        ----------
        a, b : str
            The names of the pair, in either order.

        Raises
        ------
        UnknownNameError
            If the pair was not allowed. Without this error, a misspelt name would silently leave a pair allowed.
        """
        pair = _pair(a, b)
        with self._change():
            if pair not in self._allowed:
                raise _validate.unknown_name("allowed pair", _text(pair), map(_text, sorted(self._allowed)))
            self._allowed.remove(pair)

    @property
    def leaving(self) -> frozenset[Pair]:
        """Pairs that may be in contact at the start of a motion and must separate, each sorted by name; see `leave`."""
        with _CHANGING:
            return frozenset(self._leaving)

    @property
    def reaching(self) -> frozenset[Pair]:
        """Pairs that may come into contact at the end of a motion, each sorted by name; see `reach`."""
        with _CHANGING:
            return frozenset(self._reaching)

    def leave(self, a: str, b: str) -> None:
        """Let two bodies be in contact at the start of a motion, if they then separate without deepening the contact.

        Parameters
        ----------
        a, b : str
            Names of bodies or links, made of convex pieces: for instance a can and the table below it, or a finger and
            the can that it has released.

        See Also
        --------
        reach : The corresponding rule for the end of a motion.
        allow : Allow contact at any time, however deep.

        Notes
        -----
        The rule applies to motions and to whole curves (see `CollisionChecker.certify_edges` and
        `CollisionChecker.certify_trajectory`). Suppose that a motion or curve starts with the two bodies in contact, or
        within their margin. The motion is FREE if two conditions are proven. First, on an initial stretch, the contact
        does not worsen by more than the tolerance of the proof: no two pieces penetrate each other more deeply than at
        the start, and pieces that are apart but within their margin come no nearer. Second, on the rest of the motion,
        the bodies keep their margin.

        The bodies have parted once their distance exceeds their margin by a ten-thousandth of the robot's reach; the
        initial stretch ends before they come near again. To find this end, distances are measured at several places
        along the motion, chosen according to how far the bodies move in between. The end of the contact is therefore
        not proven: contact might end and begin again between two places, but no deeper than at the start.

        The rule takes precedence over `allow`. At a single configuration, contact is a collision, as for all pairs.

        The rule ends when one of the two bodies is attached, detached or removed.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.leave("can", "left_finger")
        >>> scene.leaving
        frozenset({('can', 'left_finger')})
        """
        self._add_rule(self._leaving, _pair(a, b))

    def reach(self, a: str, b: str) -> None:
        """Let two bodies come into contact at the end of a motion.

        At the end of the motion or curve, the bodies may touch or be within their margin; they may overlap by no more
        than the tolerance of the proof. Before the end, the contact must be no deeper than at the end, up to the
        tolerance.

        Parameters
        ----------
        a, b : str
            Names of bodies or links, made of convex pieces.

        See Also
        --------
        leave : The corresponding rule for the start of a motion.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.reach("can", "shelf")
        >>> scene.reaching
        frozenset({('can', 'shelf')})
        """
        self._add_rule(self._reaching, _pair(a, b))

    def _add_rule(self, rules: set[Pair], pair: Pair) -> None:
        with self._change():
            rules.add(pair)

    def _let_go(self, name: str) -> None:
        """Drop the pose or motion of a body, and its rules of `leave` and `reach`, because its contacts will change."""
        places: tuple[dict[str, Any], ...] = (self._poses, self._attachments, self._following, self._bounds)
        for held in places:
            held.pop(name, None)
        for rules in (self._leaving, self._reaching):
            rules.difference_update([pair for pair in rules if name in pair])

    @property
    def margin(self) -> float:
        """Distance in metres that every pair with at least one body of the scene has to keep."""
        return self._margin

    @property
    def margins(self) -> dict[MarginKey, float]:
        """All margins except the scene's own, keyed by names.

        The margin of a body or link has the key ``(name,)``, or ``(name, None)`` if it applies only against links. The
        margin of a pair has the sorted names ``(a, b)`` as its key, and the margin between links has ``(None, None)``.
        """
        with _CHANGING:
            return dict(self._margins)

    @property
    def lowered(self) -> frozenset[MarginKey]:
        """Keys of the `margins` that were set with ``lower=True``."""
        with _CHANGING:
            return frozenset(self._lowered)

    def set_margin(
        self,
        margin: float | None,
        a: str | None = None,
        b: str | None = None,
        *,
        against: Literal["links"] | None = None,
        lower: bool = False,
    ) -> None:
        """Set the margin of a pair, of one body or link, of the whole scene, or of all pairs of links.

        The new margin replaces an earlier margin for the same names. If a larger margin applies to a pair for another
        reason, the larger margin holds, unless `lower` is true; see `margin_of`.

        Parameters
        ----------
        margin : float or None
            Margin in metres; None removes the margin of the pair, body or link.
        a, b : str, optional
            Names of bodies or links: both for the margin of a pair, only `a` for one body or link, and neither for the
            scene's margin.
        against : "links", optional
            Apply the margin only against links: with `a`, between `a` and all links; without `a`, to all pairs of
            links. (The scene's margin does not apply to pairs of links.)
        lower : bool
            Whether this margin overrides more general margins, so that two bodies may come closer together.

        Raises
        ------
        InputError
            If the margin is negative or not finite, a name is not a string, or `against` is given with a pair.

        Examples
        --------
        >>> scene = Scene(margin=0.05)
        >>> scene.add("table", Body.box([1.0, 1.0, 0.1]))
        >>> scene.set_margin(0.001, "hand", against="links")
        >>> scene.margin_of("table", "hand"), scene.margin_of("forearm", "hand")
        (0.05, 0.001)
        >>> scene.set_margin(0.002, "hand", "table", lower=True)
        >>> scene.margin_of("table", "hand")
        0.002
        """
        keep = None if margin is None else _validate.positive_scalar(margin, "margin", zero=True)
        lower = _validate.flag(lower, "lower")
        key = _margin_key(a, b, against)
        if not key and keep is None:
            raise InputError("margin: expected a number of metres for the whole scene, found None")
        with self._change():
            self._lowered.discard(key)
            if keep is None:
                self._margins.pop(key, None)
            elif not key:
                self._margin = keep
            else:
                self._margins[key] = keep
                if lower:
                    self._lowered.add(key)

    def widen(self, least: float) -> None:
        """Raise margins to at least `least` for all pairs with a body of this scene, but not the margins between links.

        Parameters
        ----------
        least : float
            Least margin in metres. The scene's own margin is raised as well; larger margins do not change.

        Raises
        ------
        InputError
            If `least` is negative or not finite.

        Examples
        --------
        >>> scene = Scene(margin=0.01)
        >>> scene.add("table", Body.box([1.0, 1.0, 0.1]))
        >>> scene.add("person", Body.capsule(radius=0.3, length=1.2), margin=0.05)
        >>> scene.widen(0.02)
        >>> scene.margin_of("person", "arm"), scene.margin_of("table", "arm")
        (0.05, 0.02)
        """
        least = _validate.positive_scalar(least, "least", zero=True)
        with self._change():
            self._margin = max(least, self._margin)
            # All pairs with bodies now keep this margin, except pairs with lowered margins, which are raised below.
            for key in [key for key in self._lowered if self._margins[key] < least]:
                if any(name in self._bodies for name in key):
                    self._margins[key] = least
                elif len(key) == 1:  # a link's margin also applies against other links, so it stays
                    for body in self._bodies:
                        pair = _pair(body, key[0])
                        self._margins[pair] = max(least, self._margins.get(pair, 0.0))

    def margin_of(self, a: str, b: str) -> float:
        """Return the margin between two bodies or links, in metres: the largest margin that applies to them.

        The scene's margin applies to every pair with a body of the scene, and the links' margin (``against="links"``)
        applies to every pair of links. In addition, the margin of each body or link and the margin of the pair apply. A
        margin that was set with ``lower=True`` overrides more general margins, even if these are larger. The margin of
        a body or link then overrides the scene's and the links' margin, and the margin of a pair overrides all others.

        Parameters
        ----------
        a, b : str
            Names of bodies of the scene; all other names are assumed to be links.

        Returns
        -------
        float
            The margin in metres.

        Examples
        --------
        >>> scene = Scene(margin=0.05)
        >>> scene.add("person", Body.capsule(radius=0.3, length=1.2), margin=0.5)
        >>> scene.add("table", Body.box([1.0, 1.0, 0.1]), margin=0.01)
        >>> scene.margin_of("person", "table"), scene.margin_of("table", "arm"), scene.margin_of("hand", "arm")
        (0.5, 0.05, 0.0)
        """
        pair = _pair(a, b)
        with _CHANGING:
            links = [name not in self._bodies for name in pair]
            kept = self._margins.get((None, None), 0.0) if all(links) else self._margin
            own: list[MarginKey] = [(name,) for name in pair]
            own += [(name, None) for name, other_is_link in zip(pair, reversed(links), strict=True) if other_is_link]
            for keys in (own, [pair]):
                margin_keys = [key for key in keys if key in self._margins]
                if not self._lowered.isdisjoint(margin_keys):
                    kept = 0.0
                kept = max([kept, *(self._margins[key] for key in margin_keys)])
            return kept

    # -- queries ------------------------------------------------------------------------------

    def pairs(self, time: float | None = None) -> tuple[Contact, ...]:
        """List all pairs of bodies in the world that touch, overlap or come within their margin, except allowed pairs.

        Parameters
        ----------
        time : float, optional
            Time in seconds; required if bodies follow motions, since the time determines their poses.

        Returns
        -------
        tuple of Contact
            Each pair once, in the order in which the bodies were added. All other pairs are allowed or proven free.
            Attached bodies are left out; a `CollisionChecker` checks them.

        Raises
        ------
        InputError
            If bodies follow motions and no time is given, or if the time is not a finite number.
        ConvergenceError
            If the exact search could not settle a pair. Such a pair is never reported as free.
        """
        now = self._standing_at(time)
        first, second = now._meeting().T
        bodies, poses, names = now.static_bodies, now.static_poses, now.static_names
        distances = queries.distance(bodies[first], poses[first], bodies[second], poses[second], exact=True)
        return Contact.from_distances(((names[i], names[j]) for i, j in zip(first, second, strict=True)), distances)

    def collide(self, time: float | None = None) -> bool:
        """Decide whether any two bodies in the world collide, ignoring allowed pairs; `pairs` lists the collisions.

        Parameters
        ----------
        time : float, optional
            Time in seconds; required if bodies follow motions, as for `pairs`.

        Returns
        -------
        bool
            True if two bodies overlap, touch or come within their margin. Attached bodies are left out.

        Raises
        ------
        InputError
            As for `pairs`.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("belt", Body.box([2.0, 0.5, 0.1]))
        >>> scene.add("box", Body.box([0.2, 0.2, 0.2]))
        >>> poses = np.tile(np.eye(4), (2, 1, 1))
        >>> poses[1, 2, 3] = 1.0
        >>> scene.follow("box", [0.0, 1.0], poses)
        >>> scene.collide(0.0), scene.collide(1.0)
        (True, False)
        """
        return len(self._standing_at(time)._meeting()) > 0

    @overload
    def distance(self, a: str, b: str, *, exact: Literal[False] = ...) -> Bounds[float]: ...
    @overload
    def distance(self, a: str, b: str, *, exact: Literal[True]) -> Measured[float]: ...
    @overload
    def distance(self, a: str, b: str, *, exact: bool) -> Distance: ...
    def distance(self, a: str, b: str, *, exact: bool = False) -> Distance:
        """Compute the signed distance between two named bodies in the world; margins and allowed pairs are ignored.

        See `loewner.distance`. The bounds hold for all poses within the errors of the bodies' poses. The exact distance
        applies to the poses themselves.

        Parameters
        ----------
        a, b : str
            Names of static bodies in the world.
        exact : bool
            Whether to compute the distance or depth, the witnesses and the normal in addition to bounds.

        Returns
        -------
        Distance
            The distance or its bounds; all lengths are in metres.

        Examples
        --------
        >>> scene = Scene()
        >>> scene.add("a", Body.sphere(1.0))
        >>> scene.add("b", Body.sphere(1.0), [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> round(scene.distance("a", "b", exact=True).distance, 9)
        1.0
        """
        with _CHANGING:
            one, T_one, other, T_other = self[a], self.pose(a), self[b], self.pose(b)
            off = sum(bounds.off(0.0) for name, bounds in self.bounds.items() if name in (a, b))
        distance = queries.distance(one, T_one, other, T_other, exact=exact)
        if off == 0.0:
            return distance
        lower, upper = np.nextafter(distance.lower - off, -np.inf), np.nextafter(distance.upper + off, np.inf)
        return replace(distance, lower=float(lower), upper=float(upper))

    def _standing_at(self, time: float | None) -> Scene:
        """Return a snapshot with packed bodies.

        If no body moves, the packed bodies are kept for the next snapshot.
        """
        now, t = self.snapshot(), 0.0 if time is None else _validate.real(time, "time")
        moving = now.following
        if moving and time is None:
            raise InputError(f"time: expected seconds, since bodies follow motions ({', '.join(moving)}), found None")
        bounds = now.bounds
        for name, motion in moving.items():
            now.detach(name, motion.poses(t))
        now._off = {name: one.off(t) for name, one in bounds.items()} if bounds else {}
        _ = now.static_bodies
        if not moving:
            self._packed = now._packed  # a snapshot has its own version
        return now

    def _meeting(self) -> Ints:
        """Find the colliding pairs of bodies in the world, as indices into `static_names`, shape (m, 2)."""
        bodies, poses, names = self.static_bodies, self.static_poses, self.static_names
        # The broad phase uses the largest margin for all pairs, so that it misses no pair. Pairs outside their own
        # margin are dropped below.
        off = self._off
        widest = max([self._margin, *self._margins.values()]) + sum(sorted(off.values())[-2:])
        pairs = crowds.overlapping_pairs(bodies, poses, margin=widest)
        if self._allowed:
            pairs = pairs[[_pair(names[i], names[j]) not in self._allowed for i, j in pairs]]
        if not self._margins and not off:
            return pairs
        margins = np.array(
            [self.margin_of(names[i], names[j]) + off.get(names[i], 0.0) + off.get(names[j], 0.0) for i, j in pairs]
        )
        meet = np.ones(len(pairs), dtype=bool)
        for margin in np.unique(margins[margins < widest]):
            at = np.flatnonzero(margins == margin)
            first, second = pairs[at].T
            meet[at] = queries.collide(bodies[first], poses[first], bodies[second], poses[second], margin=margin)
        return pairs[meet]

    # -- names --------------------------------------------------------------------------------

    @contextmanager
    def _change(self) -> Iterator[None]:
        """Keep other threads out while a block changes the structure; increase both versions unless the block fails."""
        with _CHANGING:
            yield
            # The structure's version changes first, so that a thread that reads the new version also finds the new
            # structure.
            self._structure_version += 1
            self._version += 1

    def _known(self, name: Any) -> str:
        if not isinstance(name, str) or name not in self._bodies:
            with _CHANGING:
                raise _validate.unknown_name("body", name, self._bodies)
        return name

    def _placed(self, name: Any) -> str:
        if self._known(name) in self._attachments:
            link = self._attachments[name].link
            raise InputError(
                f"{name!r}: expected a body that stands in the world, found one on link {link!r}; detach or reattach it"
            )
        if name in self._following:
            raise InputError(
                f"{name!r}: expected a body that stands in the world, found one that follows a motion; "
                "Scene.following has its poses, and detach stops it"
            )
        return str(name)


def in_world(scene: Scene) -> tuple[Floats, dict[str, PosePath], dict[str, PoseBounds]]:
    """Return the parts of a scene that may change while its structure version stays the same.

    Returns
    -------
    poses : ndarray, shape (n, 4, 4)
        `static_poses`, followed by the poses of the bodies in `Scene.following` that are at rest and have bounds.
    following : dict of str to PosePath
        The motions of all other bodies in `Scene.following`.
    bounds : dict of str to PoseBounds
        The bounds of all bodies that follow motions: first of the bodies in ``following``, then of the bodies at rest.
    """
    following, bounds = dict(scene.following), scene.bounds
    resting = [name for name, path in following.items() if path.rests and name in scene._bounds]
    poses = [scene.static_poses, *(following.pop(name).poses(0.0)[None] for name in resting)]
    return np.concatenate(poses), following, {name: bounds[name] for name in (*following, *resting) if name in bounds}


def poses_since(
    scene: Scene, structure_version: int
) -> tuple[Floats, tuple[PosePath, ...], dict[str, PoseBounds], int] | None:
    """Return the results of `in_world` and the scene's version; None if the scene has another structure version."""
    with _CHANGING:
        if scene.structure_version != structure_version:
            return None
        if not scene._following:
            return scene.static_poses, (), {}, scene.version
        poses, following, bounds = in_world(scene)
        return poses, tuple(following.values()), bounds, scene.version


def drawn(scene: Scene, held: Mapping[str, Floats]) -> tuple[list[Shape], list[tuple[str, str]], str]:
    """Return shapes, names of bodies with their colours, and a note; `held` contains the poses of attached bodies."""
    scene = scene.snapshot()
    poses = scene._poses | {name: path.poses(path.times[0]) for name, path in scene._following.items()} | dict(held)
    names = [name for name in scene if name in poses][:MOST_BODIES]
    colours = [COLOURS[1 + k % MOST_NAMES] for k in range(len(names))]
    shapes = [
        for_pictures(packed_of(scene[name]), len(names) > MOST_NAMES).at(poses[name], colour)
        for name, colour in zip(names, colours, strict=True)
    ]
    left = len(scene) - len(names)
    entries = list(zip(names, colours, strict=True)) if len(names) <= MOST_NAMES else []
    return shapes, entries, f"; {left} of {len(scene)} bodies are not drawn" if left else ""


def _bounds_of(
    body: Body, error: tuple[float, float], rates: tuple[float, float] = (0.0, 0.0), since: float = 0.0
) -> PoseBounds | None:
    """Make the bounds on a body's pose; None if the pose is exact."""
    return PoseBounds(*error, *rates, since, reach_of(body)) if any((*error, *rates)) else None


def _rest(times: ArrayLike, poses: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
    """If there is a single time with a pose, add a later time with the same pose."""
    at = _validate.finite_array(times, "times", (None,))
    T = _validate.poses(poses, "poses")
    if len(at) != 1 or T.shape not in ((4, 4), (1, 4, 4)):
        return at, T
    later = float(at[0]) + max(1.0, float(np.spacing(abs(at[0]))))
    return np.array([float(at[0]), later]), np.broadcast_to(T.reshape(4, 4), (2, 4, 4))


def _names(given: Any, what: str) -> list[str]:
    listed = _validate.listed(given, what, wanted="several names")
    return [expect_name(name, f"{what}: expected a name") for name in listed]


def _pair_as_given(pair: Any) -> Pair:
    try:
        a, b = pair
    except Exception:  # not two names, or an error from the caller's object
        raise InputError(f"names: expected pairs of names, found {_validate.short(pair)}") from None
    return expect_name(a, "names: expected a name"), expect_name(b, "names: expected a name")


def _pair(a: Any, b: Any) -> Pair:
    """Check two names, which must differ, and sort them."""
    a, b = expect_name(a, "a: expected a name"), expect_name(b, "b: expected a name")
    if a == b:
        raise InputError(f"a, b: expected two names, found {a!r} twice")
    return (a, b) if a < b else (b, a)


def _margin_key(a: Any, b: Any, against: Any) -> MarginKey:
    """Make the key of a margin; the margin of the whole scene has the key ()."""
    if a is None and b is not None:
        raise InputError(f"a: expected a name with b = {b!r}, found None")
    if against is not None:
        _validate.choice(against, "against", ("links",))
        if b is not None:
            raise InputError(f"against: expected none with a pair, found {against!r} with b = {b!r}")
        return (None if a is None else expect_name(a, "a: expected a name"), None)
    if a is None:
        return ()
    return (expect_name(a, "a: expected a name"),) if b is None else _pair(a, b)


def _text(pair: Pair) -> str:
    return f"({pair[0]}, {pair[1]})"
