"""Find the pairs of bodies that can meet but, by the rules of the robot and the scene, may not touch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import is_
from weakref import WeakKeyDictionary

import numpy as np

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints, Pair
from loewner._kernels import columns
from loewner.bodies import Body, Packed, packed_of
from loewner.errors import InputError, UnknownNameError
from loewner.queries.pose_paths import PoseBounds
from loewner.robots.checking.problem import Problem, rigid_with
from loewner.robots.description.assembly import with_moving_bodies
from loewner.robots.description.robot import Robot
from loewner.scenes.scene import Attachment, Scene, in_world

# Pairs that are worth preparing: some two gigabytes of arrays, and minutes for each configuration that is not free.
MOST_PAIRS = 2**24


# Attached bodies in the frame of their link, and the bodies from which they were made.
_carried: WeakKeyDictionary[Attachment, tuple[Body, Packed]] = WeakKeyDictionary()


def prepared(robot: Robot, scene: Scene, skipped: Iterable[Pair], version: int, before: Problem | None) -> Problem:
    """Prepare all pairs that can meet but may not touch.

    Parameters
    ----------
    robot : Robot
    scene : Scene
    skipped : iterable of pairs of str
        Pairs of links that may touch, in addition to the pairs that the scene allows.
    version : int
        The scene's version, read before any of its other contents.
    before : Problem or None
        The result for an earlier version and the same robot.

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
    pairs = _pairs(whole, names, link, _allowed_pairs(scene, skipped))
    pairs = pairs[link[pairs[:, 0]] < len(robot.link_names)]  # bodies of the scene are not checked against each other
    leaving, reaching = (_of_rules(rules, names, pairs) for rules in (scene.leaving, scene.reaching))
    _check_convex(names, packs, pairs[leaving | reaching])
    given = _margins(scene, names, pairs)
    bounds = scene.bounds
    errors = np.array([0.0 if name in growing or name not in bounds else bounds[name].off(0.0) for name in names])
    _check_known(names, pairs[leaving | reaching], bounds)
    margins = given + errors[pairs].sum(axis=1) if errors.any() else given
    count = len(link)
    same = before is not None and count == len(before.link) and all(map(is_, packs[:count], before.packs))
    made = Problem.of(
        whole, (version, structure_version), names, packs, link, pairs, margins, leaving, reaching,
        before.moving if same and before is not None else None,
    ).with_poses(poses, version)  # fmt: skip
    if errors.any():
        made = made.with_errors(given, errors)
    return made.with_paths(tuple(following.values()), growing) if following or growing else made


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
            _validate.known(name, f"body or link in {place}", all_names)
    for name in scene.names:
        if name in links:
            raise UnknownNameError(f"expected bodies with names of their own, found {name!r}, which is also a link")


def _bodies(robot: Robot, scene: Scene, following: list[str]) -> tuple[tuple[str, ...], list[Packed], Ints]:
    """List names and bodies, the moving ones first, and the link with which each moving body moves."""
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
    """Return an attached body in the frame of its link, made once for each attachment."""
    known = _carried.get(held)
    if known is None or known[0] is not body:
        known = _carried[held] = body, packed_of(body.transformed(held.T_link_body))
    return known[1]


def _allowed_pairs(scene: Scene, skipped: Iterable[Pair]) -> set[frozenset[str]]:
    touching = {frozenset((name, link)) for name, held in scene.attachments.items() for link in held.touch_links}
    always = scene.allowed - scene.leaving - scene.reaching
    return {frozenset(pair) for pair in (*skipped, *always)} | touching


def _pairs(robot: Robot, names: tuple[str, ...], link: Ints, may_touch: set[frozenset[str]]) -> Ints:
    """Pair bodies, as indices into `names`; the first body of each pair moves."""
    thing = rigid_with(robot)[link]
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
    """Compute the margin of each pair, in metres, as `Scene.margin_of` does."""
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
    """Look up the indices of named pairs among the checked pairs; -1 for a pair that is not checked."""
    place = {name: k for k, name in enumerate(names)}
    number = pairs[:, 0] * len(names) + pairs[:, 1]  # ascending, as the pairs are
    numbers = []
    for pair in named:
        at = sorted(place[name] for name in pair if name in place)
        found = int(np.searchsorted(number, at[0] * len(names) + at[1])) if len(at) == 2 else len(pairs)
        numbers.append(found if found < len(pairs) and pairs[found].tolist() == at else -1)
    return numbers


def _of_rules(rules: Iterable[Pair], names: tuple[str, ...], pairs: Ints) -> Bools:
    """Mark the pairs that a rule names."""
    ruled = np.zeros(len(pairs) + 1, dtype=bool)
    ruled[_numbers(rules, names, pairs)] = True  # -1 is behind the last
    return ruled[:-1]


def _check_known(names: tuple[str, ...], pairs: Ints, bounds: Mapping[str, PoseBounds]) -> None:
    """Refuse rules about the contact of bodies whose poses are not known."""
    for pair in pairs:
        a, b = (names[n] for n in pair)
        if a in bounds or b in bounds:
            raise InputError(
                f"leave or reach of {a} and {b}: expected bodies at known poses, found {a if a in bounds else b!r}, "
                "whose pose is known by bounds only (error, speed or turn)"
            )


def _check_convex(names: tuple[str, ...], packs: Sequence[Packed], pairs: Ints) -> None:
    """Refuse rules about the contact of surfaces, whose depth is not defined as for convex pieces."""
    for pair in pairs:
        for k in pair:
            if (packs[k].layout[:, columns.KIND] <= columns.SURFACE).any():
                a, b = (names[n] for n in pair)
                raise InputError(
                    f"leave or reach of {a} and {b}: expected bodies of convex pieces, found {names[k]!r}, which is a "
                    "surface or a cloud; take a box, pieces or voxels for what is touched"
                )
