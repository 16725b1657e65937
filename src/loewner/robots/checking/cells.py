"""Save a robot in a scene, with all pairs that are checked, for programs in C and C++: see `loewner.h`."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from loewner.bodies import native_files
from loewner.errors import InputError
from loewner.robots.checking.problem import Problem
from loewner.robots.description.robot import Robot, unlimited
from loewner.scenes.scene import Scene

# Largest margin that the library for C accepts. The kernels limit the size of bodies to the same number.
MOST_MARGIN = 1e30


def save(path: str | os.PathLike[str], robot: Robot, scene: Scene, ready: Problem) -> None:
    """Write a cell file.

    Parameters
    ----------
    path : path
    robot : Robot
    scene : Scene
    ready : Problem
        The pairs of this robot and scene.

    Raises
    ------
    InputError
        If bodies of the scene follow motions, since programs that read the file cannot pass a time. If bodies have
        inexact poses, since the file cannot contain bounds on errors. If the robot has no joints, a margin is larger
        than `MOST_MARGIN`, or a name contains a NUL.
    """
    if ready.margins.max(initial=scene.margin) > MOST_MARGIN or robot.dof == 0:
        raise InputError(f"expected joints, and margins of at most {MOST_MARGIN:g} m, found none or larger ones")
    for name in scene.bounds:
        raise InputError(
            f"expected exact poses, found bounds on the pose of {name!r}: move it without an error, save, and call "
            "loewner_checker_set_bounds in the program"
        )
    if ready.paths is not None:
        raise InputError("expected a scene without bodies that follow motions, found some: only Python has them")
    tree, whole = robot.tree, ready.packed
    below, above, turning = unlimited(robot)
    joints = np.array([name in robot.joint_names for name in robot.configuration_names], dtype=np.int64)
    fastest = np.where(np.isnan(robot.velocity), np.inf, robot.velocity)
    starts = [quaternion.start for quaternion in robot._quaternions.values()]
    arrays = {
        **tree._asdict(),
        "limits": np.stack([robot.lower, robot.upper, robot.hard_lower, robot.hard_upper, fastest]),
        "joints": joints + 2 * below + 4 * above + 8 * turning,
        "quaternions": np.array(starts, dtype=np.int64),
        "link": ready.link,
        "pairs": ready.pairs,
        "margins": ready.margins,
        "order": ready.order,
        "margin": np.array([scene.margin]),
        "poses": ready.standing.poses,
        **_rules(scene, ready),
    }
    names = ready.names, robot.link_names, robot.configuration_names
    packs = [whole] if ready.cut is None else [whole, ready.cut.packed, ready.in_open_parts.packed]
    native_files.write(path, names, arrays, packs, (robot.dof, len(robot.link_names), len(ready.link)))


def _rules(scene: Scene, ready: Problem) -> dict[str, Any]:
    """Return margins of single bodies, and rules for two static bodies, which apply as soon as one of them moves."""
    margins, place = scene.margins, {name: k for k, name in enumerate(ready.names) if k >= len(ready.link)}
    rules: dict[tuple[int, ...], list[float]] = {}
    for a, b in scene.allowed - scene.leaving - scene.reaching:
        if a in place and b in place:
            rules[tuple(sorted((place[a], place[b])))] = [1.0, -1.0]
    for key in margins:
        names = [name for name in key if name is not None and name in place]
        if len(names) == 2:
            pair = tuple(sorted(place[name] for name in names))
            rules.setdefault(pair, [0.0, -1.0])[1] = scene.margin_of(*names)
    allowed, kept = np.array(list(rules.values())).reshape(-1, 2).T
    pairs = np.array(list(rules), dtype=np.int64).reshape(-1, 2)
    return {
        "own": np.array([margins.get((name,), 0.0) for name in ready.names]),
        "lowered": np.array([(name,) in scene.lowered for name in ready.names], dtype=np.int64),
        "rules": np.column_stack([pairs, allowed.astype(np.int64)]),
        "rule_margins": np.ascontiguousarray(kept),
    }
