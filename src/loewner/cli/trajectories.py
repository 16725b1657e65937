"""Read trajectories from files of any program, and let links carry bodies of the scene along these trajectories."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

import loewner
from loewner import planners
from loewner._base import _validate
from loewner._base._matrices import in_frame, product
from loewner._base._validate import Floats
from loewner.cli import configurations, inputs
from loewner.errors import InputError, LoewnerError
from loewner.planners.controller_points import executed
from loewner.planners.controllers import TIMES
from loewner.robots.proofs import curves

CONTROLLERS = ("linear", "cubic", "quintic")

# Configurations that differ by less are equal: files round their numbers.
ROUNDED = 1e-9

# Points with times, or a path without times, of shape (two or more, dof).
Part = planners.ControllerPoints | Floats


def add_input(command: argparse.ArgumentParser) -> None:
    """Add the argument for a trajectory, the joint error, and the options for reading the trajectory."""
    _, file, length, _ = inputs.adders(command)
    file("trajectory", help="points with times, or a path (.csv, .json, .yaml)")
    add_options(command)
    length("--joint-error", default=0.0, metavar="E", help="largest deviation of every value [rad or m] (0)")


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of commands that read a trajectory."""
    option = command.add_argument
    option("--controller", choices=CONTROLLERS, help="interpolation between points (from the contents of the file)")
    others = "values of joints that are not in the file: a state, a file, or numbers (the message's start state, or 0)"
    option("--others", metavar="Q", help=others)
    attach = "let a link carry a body of the scene, in all parts of a message or in one (may be repeated)"
    option("--attach", action="append", default=[], metavar="[PART:]BODY=LINK", help=attach)
    start = "when the trajectory starts, on the clock of bodies that move (what the file says, or 0)"
    option("--start-time", type=float, metavar="T", help=start)


def read(
    options: argparse.Namespace, scene: loewner.Scene, robot: loewner.Robot, present: Floats | None = None
) -> list[tuple[Part, dict[str, str]]]:
    """Read the successive parts of a file, each with a dict that maps the carried bodies to their links.

    Joints that the file does not name have the values from --others, or from the robot's present state.

    Raises
    ------
    InputError
        If an option does not fit the file, or the robot carries bodies that neither the scene nor --attach assigns to
        it.
    """
    others = configurations.one(options.others, "--others", options, robot)
    parts = _parts(options.trajectory, robot, present if others is None else others)
    carrying = _carrying(options.attach, scene, robot, len(parts))
    if options.attach and getattr(options, "joint_error", 0.0) > 0:
        raise InputError(
            f"--joint-error {options.joint_error:g}: expected 0 with --attach, since errors at the time of the grasp "
            "also shift the body in the hand; attach the body in the scene file if its pose in the hand is exact"
        )
    clock = None if options.start_time is None else _validate.real(options.start_time, "--start-time")
    for number, (part, held) in enumerate(zip(parts, carrying, strict=True)):
        if isinstance(part, planners.ControllerPoints):
            parts[number] = points = _executed(part, options.controller)
            # The robot may carry only bodies that the scene or --attach assigns to it.
            attached = {body: each.link for body, each in scene.attachments.items()} | held
            curves.expect_carried(attached, [*points.carried.items(), *((body, "") for body in points.origin.free)])
            # Each part begins when the previous part ends.
            points.start_time = points.start_time if clock is None else clock
            clock = points.start_time + float(points.times[-1])
        elif options.start_time is not None:
            raise InputError(f"--start-time {options.start_time:g}: expected points with times, found a path without")
        elif options.controller not in (None, "linear"):
            raise InputError(f"--controller {options.controller}: expected points with times, found a path without")
    return list(zip(parts, carrying, strict=True))


def carried(
    parts: Sequence[tuple[Part, dict[str, str]]],
    scene: loewner.Scene,
    robot: loewner.Robot,
    arrive: Callable[[int], None] = lambda number: None,
) -> Iterator[Part]:
    """Yield each part while links carry its bodies.

    A body that the same link carries in the next part keeps its pose in the link, even if the next part begins
    elsewhere. All other bodies stay at the poses that they have reached. Before links take the bodies of a part,
    `arrive` is called with the number of the part.
    """
    held = dict[str, Floats]()
    following = [*(carrying for _, carrying in parts[1:]), dict[str, str]()]
    for number, ((part, carrying), after) in enumerate(zip(parts, following, strict=True)):
        arrive(number)
        if number:
            expect_grasps_in_place(robot, end(robot, parts[number - 1][0], -1), part, carrying.keys() - held)
        _carry(scene, robot, part, carrying, held)
        yield part
        poses = {body: scene.attachments[body].T_link_body for body in carrying}
        held = {body: T for body, T in poses.items() if after.get(body) == carrying[body]}
        for body in poses.keys() - held:
            scene.detach(body, product(_link_pose(robot, part, -1, carrying[body]), poses[body]))


def expect_grasps_in_place(robot: loewner.Robot, here: Floats, part: Part, bodies: Iterable[str]) -> None:
    """Refuse bodies that a message attaches to links when a part begins, unless the part begins where the robot is.

    If a part begins elsewhere, the link carries the body on the way to the first point, but the pose of the body in the
    link is unknown.
    """
    gap = float(np.abs(end(robot, part, 0) - here).max())
    for body in bodies:
        if gap > ROUNDED and isinstance(part, planners.ControllerPoints) and body in part.carried:
            raise InputError(
                f"--attach {body}: expected a part that begins where the robot is when the message attaches the body, "
                f"found a gap of {gap:.3g}, so the pose of the body in the link is unknown"
            )


def _carry(
    scene: loewner.Scene, robot: loewner.Robot, part: Part, carrying: dict[str, str], held: dict[str, Floats]
) -> None:
    """Let links carry bodies from the beginning of a part. `held` has the poses in the link of bodies that stay there.

    Other bodies are at their present poses when the part begins.
    """
    touching = part.origin.touching if isinstance(part, planners.ControllerPoints) else {}
    for body, link in carrying.items():
        begin = _link_pose(robot, part, 0, link)
        if body in held:
            scene.detach(body, product(begin, held[body]))  # The links that it may touch can differ.
        elif body in scene.attachments or body in scene.following:
            raise InputError(f"--attach {body}={link}: expected a static body of the scene, found one that moves")
        if body in scene.bounds:
            raise InputError(f"--attach {body}={link}: expected a body at a known pose, found an error of its pose")
        T_link_body = held.get(body, in_frame(begin, scene.pose(body)))
        leave, reach = (
            [other for pair in rules if body in pair for other in pair if other != body]
            for rules in (scene.leaving, scene.reaching)
        )
        scene.attach(body, link, T_link_body, touch_links=touching.get(body, ()), leave=leave, reach=reach)


def controller_of(part: Part) -> str | None:
    """Return the name of the controller that follows points with their derivatives; None for a path without times."""
    return CONTROLLERS[_derivatives(part)] if isinstance(part, planners.ControllerPoints) else None


def assumed(part: Part) -> dict[str, float]:
    """Return the values that are not in the file and keep the robot's defaults."""
    if not isinstance(part, planners.ControllerPoints):
        return {}
    values = dict(zip(part.names or (), part.positions[0].tolist(), strict=False))
    return {column: values[column] for column in part.origin.assumed}


def end(robot: loewner.Robot, part: Part, row: int) -> Floats:
    """Return one configuration of a part, in the robot's order of columns."""
    if isinstance(part, planners.ControllerPoints):
        return robot.configuration(dict(zip(part.names or (), part.positions[row], strict=True)))
    return np.asarray(part[row])


def _link_pose(robot: loewner.Robot, part: Part, row: int, link: str) -> Floats:
    """Return the pose of a link at one configuration of a part."""
    return np.asarray(robot.forward_kinematics(end(robot, part, row))[robot.link_names.index(link)])


def _parts(path: Path, robot: loewner.Robot, others: Floats | None) -> list[Part]:
    """Read points with times, or a path without times, as `loewner plan` writes it, of shape (two or more, dof)."""
    try:
        return list(planners.ControllerPoints.load_all(path, robot=robot, others=others))
    except LoewnerError:
        if not configurations.is_path(path, TIMES):
            raise
    return [configurations.path_of(path, robot)]


def _carrying(given: list[str], scene: loewner.Scene, robot: loewner.Robot, count: int) -> list[dict[str, str]]:
    """Return, for each part, a dict from --attach that maps the carried bodies to their links."""
    carrying: list[dict[str, str]] = [{} for _ in range(count)]
    for text in given:
        where, _, what = text.rpartition(":")
        body, equals, link = what.partition("=")
        whole = where.isascii() and where.isdigit() and 1 <= int(where) <= count
        if not (equals and body and link) or (where and not whole):
            parts = f", with a PART from 1 to {count}" if where else ""
            raise InputError(f"--attach {text}: expected [PART:]BODY=LINK{parts}")
        if body not in scene:
            raise _validate.unknown_name(f"--attach {text}: body", body, scene.names)
        _validate.known(link, f"--attach {text}: link", robot.link_names)
        for part in carrying if not where else [carrying[int(where) - 1]]:
            if part.setdefault(body, link) != link:
                raise InputError(f"--attach {text}: expected one link for {body}, found {part[body]} as well")
    return carrying


def _derivatives(points: planners.ControllerPoints) -> int:
    """Return the number of derivatives that the points have: 1 for velocities, 2 for accelerations as well."""
    return sum(one is not None for one in (points.velocities, points.accelerations))


def _executed(points: planners.ControllerPoints, controller: str | None) -> planners.ControllerPoints:
    """Return the points with only the derivatives that a controller uses."""
    held = [points.velocities, points.accelerations]
    used = _derivatives(points) if controller is None else CONTROLLERS.index(controller)
    if any(one is None for one in held[:used]):
        wanted = ("velocities", "accelerations")[_derivatives(points)]
        raise InputError(f"--controller {controller}: expected points with {wanted}, found none in the file")
    return executed(points, used)
