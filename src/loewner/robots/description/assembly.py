"""Assemble robots: join several robots, put a robot on a moving base, or add a body on a joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._matrices import dot, lengths
from loewner._base._read_only import read_only
from loewner._base._validate import Floats, Named
from loewner._kernels import columns
from loewner._kernels.records import Tree
from loewner.bodies import Body
from loewner.errors import GeometryError, InputError, UnknownNameError
from loewner.meshes.files import parts
from loewner.robots.description.links import Joint as LinkJoint
from loewner.robots.description.links import checked_joint
from loewner.robots.description.srdf import Semantics
from loewner.robots.description.tree import constant_pose, placed_tree
from loewner.robots.description.urdf import RATES, VALUES, Description, Joint
from loewner.robots.description.watch import Watch

# Maximum number of corners of a footprint. There is a limit because each side is compared with all other sides.
MOST_CORNERS = 5_000

# Relative tolerance for a footprint: smaller areas, distances and differences of areas count as zero.
FLAT = 1e-9

# The class of robots, which a higher module defines.
R = TypeVar("R")

# Attributes of a robot that contain one number for each value of a configuration.
LIMITS = ("lower", "upper", "hard_lower", "hard_upper", *RATES)

# Kinds of joints that need limits.
LIMITED = ("revolute", "prismatic")


class Source(NamedTuple):
    """The source from which a robot, or a part of a robot, was read.

    Attributes
    ----------
    prefix : str
        Prefix of the names from this source.
    format : str
        "URDF" or "MJCF".
    path : Path
        The file, or a placeholder.
    text : str or None
        The contents, if they did not come from a file.
    package_dirs : tuple of Path
    """

    prefix: str
    format: str
    path: Path
    text: str | None
    package_dirs: tuple[Path, ...]


@dataclass(frozen=True, eq=False)
class Part(Generic[R]):
    """One of several robots that were joined; see `Robot.join`.

    Attributes
    ----------
    robot : Robot
        The robot that was joined. Its pose is relative to the world or, on a moving base, relative to the base.
    columns : slice
        The columns of the part's values in a configuration of the joined robot: ``Q[..., part.columns]`` are
        configurations of `robot`, and assigning to these entries moves only this robot.
    joint_names, link_names : tuple of str
        Names of the part's joints and links in the joined robot.

    Examples
    --------
    >>> from loewner import Robot
    >>> arm = Robot.from_urdf("arm.urdf")
    >>> part = Robot.join({"left": arm, "right": arm}).part("right")
    >>> part.columns, part.joint_names
    (slice(2, 4, None), ('right/rail', 'right/elbow'))
    """

    robot: R
    columns: slice
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    # The part's tree before the joined robot is placed; None on a moving base.
    _tree: Tree | None = field(default=None, repr=False)


def joined(kind: type[R], parts: Mapping[str, R], poses: Mapping[str, ArrayLike | None] | None) -> R:
    """Make one robot from several; see `Robot.join`."""
    _validate.mapping(parts, "parts", "from names to robots", 1)
    for name, robot in parts.items():
        _validate.expect_name(name, "parts: expected names")
        _validate.instance(robot, f"parts, {name!r}", kind)
        for other in parts:
            if isinstance(other, str) and other.startswith(f"{name}/"):
                raise InputError(
                    f"parts: expected names that do not begin with another one and a slash, found {name!r}, {other!r}"
                )
    poses = _validate.mapping(poses, "poses", "from names to poses")
    for name in poses:
        _validate.known(name, "part in poses", parts)
    placed: dict[str, Any] = dict(parts)
    placed |= {name: placed[name].placed(T) for name, T in poses.items()}
    assembly = _combined([_Piece(f"{name}/", robot) for name, robot in placed.items()], " and ".join(parts))
    if any(robot._lists_pairs for robot in placed.values()):
        left = [(f"{name}/", robot) for name, robot in placed.items() if not robot._lists_pairs]
        more = {(prefix + a, prefix + b) for prefix, robot in left for a, b in robot.adjacent_pairs}
        assembly = replace(assembly, disabled_pairs=assembly.disabled_pairs | more)
    at, of_parts = 0, dict(assembly._parts)
    for name, robot in placed.items():
        joints, links = _prefixed(f"{name}/", robot.joint_names), _prefixed(f"{name}/", robot.link_names)
        of_parts[name] = Part(robot, slice(at, at + robot.dof), joints, links, robot.tree)
        at += robot.dof
    return cast(R, replace(assembly, _parts=of_parts))


def part(self: R, name: str) -> Part[R]:
    """Return one of the robots that were joined.

    Parameters
    ----------
    name : str
        The part's name in `Robot.join`; for a part of a part, "outer/inner".

    Returns
    -------
    Part

    Raises
    ------
    UnknownNameError
        If there is no such part, or the robot was not made by `Robot.join`.

    Examples
    --------
    >>> from loewner import Robot
    >>> arm = Robot.from_urdf("arm.urdf")
    >>> both = Robot.join({"left": arm, "right": arm})
    >>> q = both.configuration()
    >>> q[both.part("right").columns] = 0.5, 1.0
    >>> q
    array([0. , 0. , 0.5, 1. ])
    """
    parts: dict[str, Part[R]] = cast(Any, self)._parts
    if not parts and isinstance(name, str):
        raise UnknownNameError(f"part {name!r}: expected a robot that Robot.join has made, found another one")
    return parts[_validate.known(name, "part", parts)]


def add_base(self: R, kind: Literal["planar", "floating"], bounds: ArrayLike | None = None, *, name: str = "base") -> R:
    """Return the same robot on a moving base.

    Parameters
    ----------
    kind : {"planar", "floating"}
        "planar": two joints that slide along x and y, and a joint that turns about z; planners move them like all other
        joints. "floating": one joint with a position and a quaternion.
    bounds : array_like, shape (2, 2) for a planar base or (3, 2) for a floating one, optional
        Lowest and highest position along each axis, in metres. By default there are no limits.
    name : str
        Prefix of the names of the new joints and links.

    Returns
    -------
    Robot
        Configurations of the new robot begin with ``name/x``, ``name/y`` and ``name/theta``, or with the seven values
        of a floating joint. The new root link is ``name/world``, which does not move.

    Raises
    ------
    InputError
        If the bounds have the wrong shape, a lower bound is above the upper bound, or a name is taken. If `with_body`
        has added a body to the world, since this body would move with the base.
    UnknownNameError
        If `kind` is unknown.

    Examples
    --------
    >>> from loewner import Robot
    >>> robot = Robot.from_urdf("arm.urdf").add_base("planar", [[-2, 2], [-1, 1]])
    >>> robot.configuration_names
    ('base/x', 'base/y', 'base/theta', 'rail', 'elbow')
    >>> robot.upper[:3]
    array([ 2.,  1., inf])
    """
    _validate.choice(kind, "kind", ("planar", "floating"))
    refuse_bodies_in_world(self, "put on a base")
    axes = 2 if kind == "planar" else 3
    limits = np.full((axes, 2), [-np.inf, np.inf])
    if bounds is not None:
        limits = _validate.finite_array(bounds, "bounds", (axes, 2))
        if not (limits[:, 0] <= limits[:, 1]).all():
            raise InputError(f"bounds: expected rows of a lower and an upper position, found {limits.tolist()}")
    _validate.expect_name(name)
    joints = [Joint(name, "floating", "", "", np.eye(4), bounds=(limits[:, 0], limits[:, 1]))]
    if kind == "planar":
        slides = zip("xy", np.eye(3), limits.tolist(), strict=False)
        joints = [Joint(f"{name}/{value}", "prismatic", "", "", np.eye(4), axis, *ends) for value, axis, ends in slides]
        joints.append(Joint(f"{name}/theta", "continuous", "", "", np.eye(4), np.array([0.0, 0.0, 1.0])))
    base = _chain(self, f"{name}/world", joints)
    robot: Any = self
    return cast(R, _combined([_Piece("", base), _Piece("", robot, base.link_names[-1])], robot.name))


def footprint_body(polygon: ArrayLike, height: float) -> Body:
    """Make a prism over a polygon: one convex piece if the polygon is convex, otherwise a prism for each triangle.

    Raises
    ------
    InputError
        If the polygon has fewer than three corners, is flat or crosses itself. If the height is not positive.
    """
    corners = _validate.finite_array(polygon, "polygon", ("n", 2))
    top = _validate.positive_scalar(height, "height")
    if len(corners) > MOST_CORNERS:
        raise InputError(f"polygon: expected at most {MOST_CORNERS} corners, found {len(corners)}")
    corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]  # without repeated corners
    x, y = corners.T - corners.mean(axis=0)[:, None] if len(corners) else corners.T
    area = abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2.0
    if len(corners) < 3 or not area > FLAT * float(np.square(np.ptp(corners, axis=0)).sum()):
        raise InputError(
            f"polygon: expected at least three corners around an area, found {len(corners)} around {area:g} m²"
        )
    if not _is_simple(corners):
        raise InputError("polygon: expected one that does not cross itself, found one whose sides meet")
    flat, ring = np.column_stack([corners, np.zeros(len(corners))]), np.arange(len(corners))
    triangles = parts.cut(flat, ring, np.array([len(ring)]), lambda text, place: None, str)
    a, b, c = (np.column_stack([x, y])[triangles[:, k]] for k in range(3))
    areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2.0
    if not abs(float(areas.sum()) - area) <= FLAT * area:
        raise InputError("polygon: expected one that does not cross itself, found one whose sides meet")
    sides = np.roll(corners, -1, axis=0) - corners
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    is_convex = (turns >= 0.0).all() or (turns <= 0.0).all()
    pieces = [ring] if is_convex else list(triangles[areas > 0.0])
    lifted = np.array([0.0, 0.0, top])
    try:
        return Body.from_pieces([np.concatenate([flat[piece], flat[piece] + lifted]) for piece in pieces])
    except GeometryError as error:
        raise InputError(f"polygon: expected parts with some width, found one that is too thin ({error})") from error


def _is_simple(corners: Floats) -> bool:
    """Return whether the sides of a polygon meet only at common corners; sides that nearly touch count as meeting."""
    ends, size = np.roll(corners, -1, axis=0), float(np.ptp(corners, axis=0).max())
    sides, count = ends - corners, len(corners)
    before = np.roll(sides, 1, axis=0)
    back = np.abs(sides[:, 0] * before[:, 1] - sides[:, 1] * before[:, 0]) <= FLAT * lengths(sides) * lengths(before)
    if (back & (dot(sides, before) <= 0.0)).any():
        return False
    for k in range(count):
        others = np.setdiff1d(np.arange(count), [k - 1 if k else count - 1, k, (k + 1) % count])
        one, way = corners[k], sides[k]
        to_start, to_end = corners[others] - one, ends[others] - one
        across = [way[0] * to[:, 1] - way[1] * to[:, 0] for to in (to_start, to_end)]
        back_to = one - corners[others], ends[k] - corners[others]
        over = [sides[others, 0] * to[:, 1] - sides[others, 1] * to[:, 0] for to in back_to]
        near = FLAT * size * np.maximum(float(lengths(way)), lengths(sides[others]))
        apart = np.minimum(*across) > near
        apart |= np.maximum(*across) < -near
        apart |= np.minimum(*over) > near
        apart |= np.maximum(*over) < -near
        # Sides on one line are apart if their extents along the line are apart.
        along = [dot(to, way) for to in (to_start, to_end)]
        apart |= (np.maximum(*along) < -near) | (np.minimum(*along) > float(dot(way, way)) + near)
        if not apart.all():
            return False
    return True


def with_body(
    self: R,
    name: str,
    body: Body,
    T_parent_joint: ArrayLike | None = None,
    *,
    joint: Literal["fixed", "prismatic", "revolute", "continuous", "planar", "floating"] = "floating",
    parent: str | None = None,
    axis: ArrayLike = (0.0, 0.0, 1.0),
    limits: tuple[float, float] | None = None,
    velocity: float | None = None,
    mimic: tuple[str, float, float] | None = None,
) -> R:
    """Return the same robot with a body as an additional link, on its own joint.

    A door, a drawer or a moving obstacle thus becomes part of the configuration, and its motions are proven together
    with the robot's motions. If the parent has a body, the parent and the new link are an adjacent pair.

    Parameters
    ----------
    name : str
        Name of the new link and of the new joint.
    body : Body
        The body in the frame of the new link.
    T_parent_joint : array_like, shape (4, 4), optional
        Pose of the joint in the frame of the parent; translation in metres. Default: the identity.
    joint : str
        Kind of the joint.
    parent : str, optional
        The link that carries the joint. Default: the world. Before you add a body to the world, place the robot or add
        its base.
    axis : array_like, shape (3,)
        Axis along which the joint slides or about which it turns.
    limits : (float, float), optional
        Least and greatest value, in metres or radians; required for a prismatic or a revolute joint.
    velocity : float, optional
        Largest rate of a joint with one value [rad/s or m/s], for trajectories. By default the rate is unknown.
    mimic : (str, float, float), optional
        The name of the existing joint that the new joint follows, a multiplier and an offset; only for a new joint with
        one value. The limits of the followed joint are narrowed to values at which the new joint is within its own
        limits.

    Returns
    -------
    Robot
        The values of the new joint come last in configurations.

    Raises
    ------
    InputError
        If a name is taken, `body` is not a body, the axis has no direction, or limits are missing or not in order. If a
        velocity or a mimic is given for a joint that does not have exactly one value. If the narrowed limits of the
        followed joint would contain no values.
    PoseError
        If the pose is not a rigid motion.
    UnknownNameError
        If there is no such kind of joint or no such link, or if the joint to follow does not exist or has no value of
        its own.

    Examples
    --------
    >>> from loewner import Body, Robot
    >>> door = Body.box([0.8, 0.02, 1.0]).transformed([[1, 0, 0, 0.4], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]])
    >>> hinge = [[1, 0, 0, 2.5], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> robot = Robot.from_urdf("arm.urdf").with_body("door", door, hinge, joint="revolute", limits=(0, 1.5))
    >>> robot.configuration_names
    ('rail', 'elbow', 'door')
    """
    _validate.expect_name(name)
    _validate.instance(body, f"body of {name!r}", Body)
    _validate.choice(joint, "joint", [kind for kind in VALUES if kind != "ball"])
    robot: Any = self
    if parent is not None:
        _validate.known(parent, "parent", robot.link_names)
    T = _validate.pose(T_parent_joint, "T_parent_joint")
    if (limits is None) == (joint in LIMITED):
        expected = "two numbers for prismatic and revolute joints, and none for others"
        raise InputError(f"limits: expected {expected}, found {limits} for a {joint} joint")
    low, high = (-np.inf, np.inf) if limits is None else _validate.finite_array(limits, "limits", (2,)).tolist()
    if low > high:
        raise InputError(f"limits: expected a lower and an upper one, found {limits}")
    stated = LinkJoint(name, joint, "", "", axis=axis, lower=low, upper=high, velocity=velocity, mimic=mimic)
    moving, _ = checked_joint(stated, "")
    branch = _chain(self, f"{name}/world", [replace(moving, mimic=None)])
    branch = replace(branch, bodies={name: body}).placed(T)
    adjacent = {(min(name, parent), max(name, parent))} if parent in robot.bodies and parent is not None else set()
    robot = _combined([_Piece("", robot), _Piece("", branch, parent, without_root=True)], robot.name)
    if moving.mimic is not None:
        robot = replace(_coupled(robot, *moving.mimic), _layout=cast(Any, self)._layout)
    in_world = (*robot._in_world, name) if parent is None else robot._in_world
    return cast(R, replace(robot, adjacent_pairs=robot.adjacent_pairs | adjacent, _in_world=in_world))


def _coupled(robot: Any, followed: str, multiplier: float, offset: float) -> Any:
    """Let the last joint, which has one value, follow another joint with one value."""
    name = robot.joint_names[-1]
    one_value = [joint for joint, at in robot._columns.items() if at.stop - at.start == 1 and joint != name]
    _validate.known(followed, "joint of one value of its own in mimic", one_value)
    at, own = robot._columns[followed].start, robot.dof - 1
    limits = {key: getattr(robot, key)[:-1].copy() for key in LIMITS}
    if multiplier:
        lower, upper = limits["lower"], limits["upper"]
        ends = [(float(end[own]) - offset) / multiplier for end in (robot.lower, robot.upper)]
        least, most = max(lower[at], min(ends)), min(upper[at], max(ends))
        if least > most:
            raise InputError(
                f"mimic: expected limits that leave {followed!r} values, found {lower[at]:g} .. {upper[at]:g} "
                f"with {min(ends):g} .. {max(ends):g}"
            )
        lower[at], upper[at] = least, most
        for key in RATES:
            limits[key][at] = np.fmin(limits[key][at], getattr(robot, key)[own] / abs(multiplier))
    read_only(*limits.values())
    tree, last = robot.tree, len(robot.link_names) - 1
    tree = Tree(*(array.copy() for array in tree))
    tree.column[last], tree.multiplier[last], tree.offset[last] = at, multiplier, offset
    names, watch = robot.configuration_names[:-1], robot._watch
    hard = limits["hard_lower"], limits["hard_upper"]
    return replace(
        robot,
        joint_names=robot.joint_names[:-1],
        configuration_names=names,
        **limits,
        mimics={**robot.mimics, name: (followed, multiplier)},
        tree=tree,
        _rooted=tree,
        _columns={joint: columns for joint, columns in robot._columns.items() if joint != name},
        _watch=Watch(robot.name, names, *hard, watch.turns[:-1], watch.free[:-1]),
    )


def with_moving_bodies(self: R, names: Sequence[str]) -> R:
    """For each name, add a floating joint and a link without a body, after the robot's own joints and links."""
    joints = [Joint(f"{name} in the scene", "floating", "", "", np.eye(4)) for name in names]
    chains = [_chain(self, f"{joint.name}/world", [joint]) for joint in joints]
    robot: Any = self
    added = [_Piece("", chain, None, without_root=True) for chain in chains]
    return cast(R, _combined([_Piece("", robot), *added], robot.name))


def refuse_bodies_in_world(robot: Any, what: str) -> None:
    """Refuse to move a robot if `with_body` has added bodies to the world, since these bodies would stay behind."""
    for name in robot._in_world:
        raise InputError(
            f"expected a robot without bodies in the world, to be {what}, found {name!r}; call with_body afterwards"
        )


def parts_of(robot: Any) -> Mapping[str, Part[Any]]:
    """Return the parts of a joined robot, by name; for a robot that was not joined, the mapping is empty."""
    parts: Mapping[str, Part[Any]] = robot._parts
    return parts


def placed_parts(parts: Mapping[str, Part[Any]], T: Floats) -> dict[str, Part[Any]]:
    """Place the parts of a joined robot together with the robot."""
    return {
        name: part if part._tree is None else replace(part, robot=replace(part.robot, tree=placed_tree(part._tree, T)))
        for name, part in parts.items()
    }


# -- assembly ---------------------------------------------------------------------------------


class _Piece(NamedTuple):
    """A robot to be combined with other robots, with the prefix of its names and the link that carries its root.

    If `on` is None, the root is fixed to the world. If `without_root` is true, the root is left out.
    """

    prefix: str
    robot: Any
    on: str | None = None
    without_root: bool = False


def _prefixed(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(prefix + name for name in names)


def _chain(robot: Any, root: str, joints: Sequence[Joint]) -> Any:
    """Make a robot from a chain of joints; each link has no body, and the name of the joint above it."""
    links = [root, *(joint.name for joint in joints)]
    by_name = {one.name: replace(one, parent=above, child=one.name) for one, above in zip(joints, links, strict=False)}
    description = Description(root, Path(root), dict.fromkeys(links, ()), by_name, by_name, ())
    made_robot = type(robot)._of(description, {}, Semantics(), frozenset(), (), "none", None)
    return replace(made_robot, _sources=())


def _combined(pieces: Sequence[_Piece], name: str) -> Any:
    """Combine several robots into one."""
    robots = [piece.robot for piece in pieces]
    links = [n for p in pieces for n in _prefixed(p.prefix, p.robot.link_names[p.without_root :])]
    joints = [n for p in pieces for n in _prefixed(p.prefix, (*p.robot.joint_names, *p.robot.mimics))]
    for names in (links, joints):
        taken = next((own for k, own in enumerate(names) if own in names[:k]), None)
        if taken is not None:
            raise InputError(f"expected names of links and joints that differ, found {taken!r} twice")
    first = np.cumsum([0, *(robot.dof for robot in robots)]).tolist()
    limits = {key: np.concatenate([getattr(robot, key) for robot in robots]) for key in LIMITS}
    read_only(*limits.values())
    configuration_names = tuple(n for piece in pieces for n in _prefixed(piece.prefix, piece.robot.configuration_names))
    turns = [turns for robot in robots for turns in robot._watch.turns]
    free = [free for robot in robots for free in robot._watch.free]
    tree = _tree(pieces, first)

    def named(what: str, of: Any) -> Any:
        return Named(what, {p.prefix + key: value for p in pieces for key, value in of(p).items()})

    def pairs(key: str) -> frozenset[tuple[str, str]]:
        return frozenset((p.prefix + a, p.prefix + b) for p in pieces for a, b in getattr(p.robot, key))

    return replace(
        next(robot for robot in robots if robot._sources),
        name=name,
        link_names=tuple(links),
        joint_names=tuple(n for p in pieces for n in _prefixed(p.prefix, p.robot.joint_names)),
        configuration_names=configuration_names,
        **limits,
        bodies=named("link with a body", lambda p: p.robot.bodies),
        shapes=named("link with shapes of a URDF", lambda p: p.robot.shapes),
        groups=named("group", lambda p: {g: _prefixed(p.prefix, joints) for g, joints in p.robot.groups.items()}),
        states=named("state", _states),
        disabled_pairs=pairs("disabled_pairs"),
        adjacent_pairs=pairs("adjacent_pairs"),
        mimics={
            p.prefix + joint: (p.prefix + other, by) for p in pieces for joint, (other, by) in p.robot.mimics.items()
        },
        tree=tree,
        _rooted=tree,
        _columns={
            p.prefix + joint: slice(at.start + shift, at.stop + shift)
            for p, shift in zip(pieces, first, strict=False) for joint, at in p.robot._columns.items()
        },
        _above={link: above for piece in pieces for link, above in _above(piece).items()},
        _ruled=any(robot._ruled for robot in robots),
        _only_visual=tuple(n for p in pieces for n in _prefixed(p.prefix, p.robot._only_visual)),
        _watch=Watch(name, configuration_names, limits["hard_lower"], limits["hard_upper"], turns, free),
        _sources=tuple(source._replace(prefix=p.prefix + source.prefix) for p in pieces for source in p.robot._sources),
        _layout=robots[0]._layout if len(configuration_names) == robots[0].dof else None,
        _in_world=tuple(n for p in pieces for n in _prefixed(p.prefix, p.robot._in_world)),
        _parts={
            p.prefix + key: _shifted(p, part, shift)
            for p, shift in zip(pieces, first, strict=False) for key, part in p.robot._parts.items()
        },
    )  # fmt: skip


def _above(piece: _Piece) -> dict[str, tuple[str, str | None]]:
    """Return the joint above each link of a piece, and the link's parent, with the names of the combined robot."""
    left_out = piece.robot.link_names[0] if piece.without_root else None
    above = {}
    for link in piece.robot.link_names[piece.without_root :]:
        joint, parent = piece.robot._above.get(link, ("", None))
        on = piece.on if parent in (None, left_out) else piece.prefix + parent
        above[piece.prefix + link] = joint and piece.prefix + joint, on
    return above


def _states(piece: _Piece) -> dict[str, Any]:
    return {
        name: (group and piece.prefix + group, {piece.prefix + joint: value for joint, value in values.items()})
        for name, (group, values) in piece.robot.states.items()
    }


def _shifted(piece: _Piece, part: Part[Any], by: int) -> Part[Any]:
    at = slice(part.columns.start + by, part.columns.stop + by)
    joints, links = _prefixed(piece.prefix, part.joint_names), _prefixed(piece.prefix, part.link_names)
    on_base = piece.on is not None or part._tree is None
    return Part(part.robot, at, joints, links, None if on_base else part.robot.tree)


def _tree(pieces: Sequence[_Piece], first_column: Sequence[int]) -> Tree:
    """Join the trees of robots into one tree, each at the link that carries it."""
    trees: list[Tree] = []
    numbers: dict[str, int] = {}
    for piece, column in zip(pieces, first_column, strict=False):
        tree, above, count = piece.robot.tree, -1, len(numbers)
        if piece.on is not None:
            # A fixed link is stored as a frame of the first link in its rigid group.
            above = numbers[piece.on]
            before = Tree(*(np.concatenate(arrays) for arrays in zip(*trees, strict=True)))
            if before.kind[above] == columns.FIXED:
                tree, above = placed_tree(tree, constant_pose(before.constants[above])), int(before.parent[above])
        skip = int(piece.without_root)
        parent = np.where(tree.parent < skip, above, tree.parent + count - skip)
        tree = tree._replace(parent=parent, column=np.where(tree.kind == columns.FIXED, 0, tree.column + column))
        trees.append(Tree(*(array[skip:] for array in tree)))
        for name in piece.robot.link_names[skip:]:
            numbers[piece.prefix + name] = len(numbers)
    return Tree(*(np.ascontiguousarray(np.concatenate(arrays)) for arrays in zip(*trees, strict=True)))
