"""Find the pairs of bodies that can meet but must not touch under the rules of the robot and the scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints, Pair
from loewner._kernels import columns
from loewner._native import entries
from loewner.bodies import Body, Packed, packed_of
from loewner.errors import InputError, UnknownNameError
from loewner.queries.pose_paths import PoseBounds
from loewner.robots.checking.problem import Problem
from loewner.robots.description.assembly import with_moving_bodies
from loewner.robots.description.robot import Robot
from loewner.scenes.scene import Attachment, Scene, in_world

# Maximum number of pairs. At this number, the arrays take about two gigabytes, and checking a configuration that is not
# free takes minutes.
MOST_PAIRS = 2**24


# Cache that maps each attachment to its body and to a copy of the body in the frame of the link.
_carried: WeakKeyDictionary[Attachment, tuple[Body, Packed]] = WeakKeyDictionary()


def prepared(robot: Robot, scene: Scene, skipped: Iterable[Pair], version: int, before: Problem | None) -> Problem:
    """Prepare all pairs of bodies that can meet but must not touch.

    Parameters
    ----------
    robot : Robot
    scene : Scene
    skipped : iterable of pairs of str
        Pairs of links that may touch, in addition to the pairs that the scene allows.
    version : int
        The scene's version, which must be read before any other contents of the scene.
    before : Problem or None
        The result for the same robot and an earlier version of the scene.

    Raises
    ------
    UnknownNameError
        If the scene names a link that the robot does not have, or has a body with the name of a link.
    InputError
        If there are more than `MOST_PAIRS` pairs.
    """
    structure_version = scene.structure_version
    _check_names(robot, scene)
    poses, following, growing = in_world(scene)
    whole = with_moving_bodies(robot, tuple(following)) if following else robot
    names, packs, link = _bodies(robot, scene, list(following))
    on_links = link[link < len(robot.link_names)]  # bodies of the scene are not checked against each other
    pairs, scene_margins = _pairs(robot, scene, names, on_links, skipped)
    leaving, reaching = (_of_rules(rules, names, pairs) for rules in (scene.leaving, scene.reaching))
    bounds = scene.bounds
    _check_ruled(names, packs, pairs[leaving | reaching], bounds)
    errors = np.array([0.0 if name in growing or name not in bounds else bounds[name].off(0.0) for name in names])
    margins = scene_margins + errors[pairs].sum(axis=1) if errors.any() else scene_margins
    problem = Problem.of(
        whole, (version, structure_version), names, packs, link, pairs, margins, leaving, reaching, before
    ).with_poses(poses, version)  # fmt: skip
    if errors.any():
        problem = problem.with_errors(scene_margins, errors)
    return problem.with_paths(tuple(following.values()), growing) if following or growing else problem


# -- names and pairs --------------------------------------------------------------------------


def _check_names(robot: Robot, scene: Scene) -> None:
    links, all_names = dict.fromkeys(robot.link_names), dict.fromkeys((*scene.names, *robot.link_names))
    for body, held in scene.attachments.items():
        _validate.known(held.link, f"link in attach of {body!r}", links)
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
            _validate.known(name, f"body or link in {place}", all_names)
    for name in scene.names:
        if name in links:
            raise UnknownNameError(f"expected bodies with names of their own, found {name!r}, which is also a link")


def _bodies(robot: Robot, scene: Scene, following: list[str]) -> tuple[tuple[str, ...], list[Packed], Ints]:
    """List the names and the bodies, moving bodies first, and the number of each moving body's link."""
    links = {name: k for k, name in enumerate(robot.link_names)}
    moving = [(name, links[name], packed_of(body)) for name, body in robot.bodies.items()]
    moving += [(name, links[held.link], _on_link(scene[name], held)) for name, held in scene.attachments.items()]
    moving += [(name, len(links) + k, packed_of(scene[name])) for k, name in enumerate(following)]
    moving = [entry for entry in moving if entry[2].piece_start[-1] > 0]
    standing = [*scene.static_names, *(name for name in scene.following if name not in following)]
    packs = [*(pack for _, _, pack in moving), *(packed_of(scene[name]) for name in standing)]
    link = np.array([number for _, number, _ in moving], dtype=np.int64)
    return (*(name for name, _, _ in moving), *standing), packs, link


def _on_link(body: Body, held: Attachment) -> Packed:
    """Return an attached body in the frame of its link; the result is cached for each attachment."""
    entry = _carried.get(held)
    if entry is None or entry[0] is not body:
        entry = _carried[held] = body, packed_of(body.transformed(held.T_link_body))
    return entry[1]


def _pairs(
    robot: Robot, scene: Scene, names: tuple[str, ...], link: Ints, skipped: Iterable[Pair]
) -> tuple[Ints, Floats]:
    """List pairs of bodies, as indices into `names` with a moving body first, and their margins in metres."""
    moving, total = len(link), len(names)
    most = moving * (2 * total - moving - 1) // 2
    if most > MOST_PAIRS:
        raise InputError(
            f"expected at most {MOST_PAIRS} pairs to check, found {most}: {moving} moving bodies, each against the "
            f"others and against {total - moving} static bodies; remove bodies, or unite bodies that belong together "
            "(Body.union)"
        )
    margins, lowered = scene.margins, scene.lowered
    place: dict[str | None, int] = {name: k for k, name in enumerate(names)}
    touching = [(name, other) for name, held in scene.attachments.items() for other in held.touch_links]
    always = scene.allowed - scene.leaving - scene.reaching
    ruled: list[tuple[tuple[str | None, ...], int, bool, float]]
    ruled = [(pair, 1, False, -1.0) for pair in (*skipped, *always, *touching)]
    ruled += [(key, -1, key in lowered, margin) for key, margin in margins.items()]
    rows = [
        (place[pair[0]], place[pair[1]], *rule)
        for pair, *rule in ruled
        if len(set(pair)) == 2 and place.keys() >= set(pair)
    ]
    rules = np.array(rows, dtype=float).reshape(-1, 5)
    marks = [(name not in scene, (name,) in lowered, (name, None) in lowered) for name in names]
    own = [(margins.get((name,), 0.0), margins.get((name, None), 0.0)) for name in names]
    pairs, pair_margins = np.empty((most, 2), dtype=np.int64), np.empty(most)
    count = entries.list_pairs(
        robot.tree.parent, robot.tree.kind, link, np.array(marks, dtype=np.int64).reshape(-1, 3),
        np.array(own).reshape(-1, 2), np.array([scene.margin, margins.get((None, None), 0.0)]),
        rules[:, :4].astype(np.int64), rules[:, 4].copy(), pairs, pair_margins,
    )  # fmt: skip
    return pairs[:count].copy(), pair_margins[:count].copy()


def _of_rules(rules: Iterable[Pair], names: tuple[str, ...], pairs: Ints) -> Bools:
    """Mark the pairs that a rule names."""
    place, ruled = {name: k for k, name in enumerate(names)}, np.zeros(len(pairs), dtype=bool)
    for rule in rules:
        ruled |= (pairs == sorted(place.get(name, -1) for name in rule)).all(axis=1)
    return ruled


def _check_ruled(
    names: tuple[str, ...], packs: Sequence[Packed], pairs: Ints, bounds: Mapping[str, PoseBounds]
) -> None:
    """Refuse rules about contacts of surfaces, and about contacts of bodies whose poses are known only by bounds.

    The depth of surfaces is defined differently from the depth of convex pieces.
    """
    for pair in pairs:
        a, b = (names[n] for n in pair)
        for k in pair:
            if (packs[k].layout[:, columns.KIND] <= columns.SURFACE).any():
                raise InputError(
                    f"leave or reach of {a} and {b}: expected bodies of convex pieces, found {names[k]!r}, which is a "
                    "surface or a cloud; represent the touched body by a box, by pieces or by voxels"
                )
            if names[k] in bounds:
                raise InputError(
                    f"leave or reach of {a} and {b}: expected bodies at known poses, found {names[k]!r}, whose pose is "
                    "known by bounds only (error, speed or turn)"
                )
