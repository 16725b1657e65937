"""Save a robot in a scene, with all pairs that are checked, for programs in C and C++: see `loewner.h`."""

from __future__ import annotations

import os

import numpy as np

from loewner.bodies import native_files
from loewner.errors import InputError
from loewner.robots.problem import Problem
from loewner.robots.robot import Robot, unlimited


def save(path: str | os.PathLike[str], robot: Robot, ready: Problem, margin: float) -> None:
    """Write a cell file.

    Parameters
    ----------
    path : path
    robot : Robot
    ready : Problem
    margin : float
        For pairs with bodies that are added later, in metres.

    Raises
    ------
    InputError
        If bodies of the scene follow motions, since these programs have no time.
    """
    if ready.paths is not None:
        raise InputError("expected a scene without bodies that follow motions, found some: only Python has them")
    tree, whole = robot.tree, ready.packed
    below, above, turning = unlimited(robot)
    joints = np.array([name in robot.joint_names for name in robot.configuration_names], dtype=np.int64)
    starts = [quaternion.start for quaternion in robot._quaternions.values()]
    arrays = {
        **tree._asdict(),
        "limits": np.stack([robot.lower, robot.upper]),
        "joints": joints + 2 * below + 4 * above + 8 * turning,
        "quaternions": np.array(starts, dtype=np.int64),
        "link": ready.link,
        "pairs": ready.pairs,
        "margins": ready.margins,
        "order": ready.order,
        "margin": np.array([margin]),
        "poses": ready.standing.poses,
    }
    names = ready.names, robot.link_names, robot.configuration_names
    packs = [whole] if ready.cut is None else [whole, ready.cut.packed]
    native_files.write(path, names, arrays, packs, (robot.dof, len(robot.link_names), len(ready.link)))
