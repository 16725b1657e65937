"""Make robots from models of other libraries, and convert configurations to and from the order of such a model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._matrices import product
from loewner._base._plausible import warn
from loewner._base._read_only import KeepsReadOnly, read_only
from loewner._base._validate import Bools, Floats, Ints, Pair
from loewner._kernels import columns
from loewner.bodies import Body
from loewner.errors import ConvergenceError, InputError
from loewner.queries import pairs as queries
from loewner.robots.description.links import Joint
from loewner.robots.description.tree import constant_pose
from loewner.robots.description.xml_elements import some

# A joint, and the columns of its values in a model's configurations.
Move = tuple[Joint, tuple[int, ...]]


class Shape(NamedTuple):
    """A collision shape of a model: a body at a pose in a link."""

    link: str
    name: str
    body: Body
    T_link_body: Floats


class Model(NamedTuple):
    """The parts of a robot that was modelled with another library.

    Attributes
    ----------
    name : str
    links : tuple of str
        The first link is the world.
    joints : tuple of Joint
    shapes : list of Shape
    checked : ndarray of bool, shape (n, n)
        Which shapes are checked against each other; symmetric.
    order : Order
    """

    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    shapes: list[Shape]
    checked: Bools
    order: Order


class Order(NamedTuple):
    """The places of joint values in a model's configurations.

    Attributes
    ----------
    width : int
        Number of values of a configuration.
    columns : mapping
        Maps each joint to the columns of its values, in the robot's order. If a single value has two columns, these
        columns are its cosine and sine.
    constants : mapping
        Maps each column that is constant to its value.
    """

    width: int
    columns: Mapping[str, tuple[int, ...]]
    constants: Mapping[int, float]


@dataclass(frozen=True, eq=False)
class Layout(KeepsReadOnly):
    """Convert configurations of a robot to the order of its model, and back.

    Attributes
    ----------
    names : tuple of str
        The joint of each column of the model, for messages.
    source, factors, offsets : ndarray, shape (width,)
        Each column of the model is a factor times the robot's column `source`, plus an offset. If `source` is dof, zero
        replaces the robot's column.
    own : ndarray, shape (dof,)
        For each of the robot's columns, the column of the model that equals it.
    turning : ndarray, shape (k, 3)
        One row for each angle that the model represents by a cosine and a sine: the robot's column, then the model's
        columns of the cosine and of the sine.
    """

    names: tuple[str, ...]
    source: Ints
    factors: Floats
    offsets: Floats
    own: Ints
    turning: Ints

    def exported(self, Q: Floats) -> Floats:
        """Convert the robot's configurations, shape (..., dof), to the model's configurations."""
        q = self.exported_rates(Q) + self.offsets
        for column, cosine, sine in self.turning.tolist():
            q[..., cosine], q[..., sine] = _elementary.cos(Q[..., column]), _elementary.sin(Q[..., column])
        return q

    def exported_rates(self, rates: Floats) -> Floats:
        """Convert rates of the robot's values to rates of the model's values, which must not be cosines and sines."""
        padded = np.concatenate([rates, np.zeros((*rates.shape[:-1], 1))], axis=-1)
        return np.asarray(self.factors * padded[..., self.source])

    def imported(self, q: Floats, tolerance: float) -> Floats:
        """Convert the model's configurations, shape (..., width), to the robot's order; the couplings must hold."""
        Q = q[..., self.own]
        for column, cosine, sine in self.turning.tolist():
            Q[..., column] = _elementary.arctan2(q[..., sine], q[..., cosine])
        off = np.abs(self.exported(Q) - q)
        if off.size and not off.max() <= tolerance:
            at = np.unravel_index(off.argmax(), off.shape)
            raise InputError(
                f"q: expected values within {tolerance:g} of what couplings, locked joints and norms of cosines and "
                f"sines demand, found {q[at]:.6g} for {self.names[int(at[-1])]!r}, which is {off[at]:.3g} off"
            )
        return np.ascontiguousarray(Q)


def layout_of(order: Order, robot: Any, references: Mapping[str, float]) -> Layout:
    """Determine how a robot's configurations correspond to the configurations of its model.

    Parameters
    ----------
    order : Order
    robot : Robot
    references : mapping
        Maps a joint to its value in the model when its value in the tree is 0. A joint that is not listed then has the
        value 0 in the model, too.
    """
    dof, tree = robot.dof, robot.tree
    source, factors, offsets = np.full(order.width, dof), np.zeros(order.width), np.zeros(order.width)
    own, turning, names = np.zeros(dof, dtype=np.int64), [], ["?"] * order.width
    rows = {joint: robot.link_names.index(link) for link, (joint, _) in robot._above.items()}
    for joint, theirs in order.columns.items():
        at, k = robot._columns.get(joint), rows[joint]
        for column in theirs:
            names[column] = joint
        if at is None:  # the joint mimics another joint
            source[theirs[0]], factors[theirs[0]] = tree.column[k], tree.multiplier[k]
            offsets[theirs[0]] = tree.offset[k] + references.get(joint, 0.0)
        elif len(theirs) == at.stop - at.start:
            source[list(theirs)], factors[list(theirs)] = np.arange(at.start, at.stop), 1.0
            own[at] = theirs
        else:
            turning.append((at.start, *theirs))
            own[at] = theirs[0]
    for column, value in order.constants.items():
        offsets[column] = value
    arrays = source, factors, offsets, own, np.array(turning, dtype=np.int64).reshape(-1, 3)
    read_only(*arrays)
    return Layout(tuple(names), *arrays)


def chained(
    moves: Sequence[Move], parent: str, child: str, T_parent_joint: Floats, T_joint_child: Floats
) -> Iterator[Move]:
    """Connect two links by a chain of joints that together represent one joint of a model."""
    before = T_parent_joint
    for number, (move, theirs) in enumerate(moves, 1):
        below, behind = (child, T_joint_child) if number == len(moves) else (f"{child}/{move.name}", None)
        T = product(before, _validate.pose(move.T_parent_joint, "pose"))
        yield replace(move, parent=parent, child=below, T_parent_joint=T, T_joint_child=behind), theirs
        parent, before = below, np.eye(4)


def made_body(make: Callable[[], Body], what: str) -> Body:
    """Make the body of a shape; errors name the shape."""
    try:
        return make()
    except (InputError, ConvergenceError) as error:
        raise type(error)(f"{what}: {error}") from None


def with_shapes(model: Model) -> tuple[dict[str, list[tuple[Body, Floats]] | None], list[Joint], list[Pair]]:
    """Assign a model's shapes to links, so that rules about pairs of shapes become rules about pairs of links.

    Shapes of a link are grouped by the other shapes against which they are checked: the first group becomes the link's
    body, and each further group becomes a link fixed to it. Each shape of the first link, the world, becomes a separate
    link.

    Returns
    -------
    links, joints, disabled
        As `Robot.from_links` takes them.
    """
    _, links, joints, shapes, checked, _ = model
    classes: dict[tuple[str, object], list[int]] = {}
    for k, shape in enumerate(shapes):
        classes.setdefault((shape.link, k if shape.link == links[0] else checked[k].tobytes()), []).append(k)
    all_links: dict[str, list[tuple[Body, Floats]] | None] = dict.fromkeys(links)
    all_joints = {joint.name: joint for joint in joints}
    names, firsts = [], []
    for (link, _), members in classes.items():
        first, name = shapes[members[0]], link
        if link == links[0] or all_links[link] is not None:
            name = _validate.unused(first.name if link == links[0] else f"{link}/{first.name}", all_links)
            joint = _validate.unused(name, all_joints)
            all_joints[joint] = Joint(joint, "fixed", link, name)
        all_links[name] = [(shapes[k].body, shapes[k].T_link_body) for k in members]
        names.append(name)
        firsts.append(members[0])
    skipped = np.argwhere(np.tril(~checked[np.ix_(firsts, firsts)], -1)).tolist()
    return all_links, list(all_joints.values()), [(names[a], names[b]) for a, b in skipped]


def warn_of_fixed_contacts(model: Model, robot: Any) -> None:
    """Warn about bodies that are fixed to each other and collide.

    The model's library checks such pairs; collision checkers do not.
    """
    bodies, tree = robot.bodies, robot.tree
    fixed = tree.kind == columns.FIXED
    groups = np.where(fixed, tree.parent, np.arange(len(fixed)))
    poses = {
        name: (int(groups[k]), constant_pose(tree.constants[k]) if fixed[k] else np.eye(4))
        for k, name in enumerate(robot.link_names) if name in bodies
    }  # fmt: skip
    contacts = [
        f"{a!r} and {b!r}" for a, b in combinations(sorted(poses), 2)
        if poses[a][0] == poses[b][0] and (a, b) not in robot.disabled_pairs
        and queries.collide(bodies[a], poses[a][1], bodies[b], poses[b][1])
    ]  # fmt: skip
    if contacts:
        warn(f"{model.name}: not checked, since they are fixed to each other, although they collide: {some(contacts)}")


def unique(names: Sequence[str], scopes: Sequence[str]) -> list[str]:
    """Return unique names: a name that occurs twice gets its scope as a prefix, then underscores if necessary."""
    unique_names: list[str] = []
    for name, scope in zip(names, scopes, strict=True):
        candidate = name if names.count(name) == 1 else f"{scope}::{name}"
        unique_names.append(_validate.unused(candidate, unique_names))
    return unique_names


def expect(given: object, kind: str, what: str) -> None:
    """Refuse an object if neither its class nor a base class has the name `kind`."""
    if kind not in (base.__name__ for base in type(given).__mro__):
        raise InputError(f"{what}: expected a {kind}, found {_validate.short(given)}")
