"""Choose columns for controllers, name them as the controllers do, and read the files that list controllers."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loewner._base import _validate
from loewner._base._files import read_regular, write_atomically
from loewner._base._nodes import Node, read_yaml, some
from loewner._base._plausible import warn
from loewner.errors import InputError

MOST_BYTES = 2**24

# Names of columns in tables.
TIMES = ("time", "time_from_start")
VELOCITY, ACCELERATION, BLEND = " velocity", " acceleration", "blend"

# Controllers that accept trajectories: ends of their types in ros2_control and ROS 1, and MoveIt's type.
TRAJECTORY = ("JointTrajectoryController", "FollowJointTrajectory")

# Keys above controllers that are not part of the controllers' names.
AROUND = ("", "**", "ros__parameters", "controller_manager", "moveit_simple_controller_manager")

# Keys of a controller that accepts trajectories: keys that are used here, and keys that have no effect on the points.
USED = ("joints", "type", "allow_partial_joints_goal", "interpolation_method", "name")
HARMLESS = (
    *("action_ns", "default", "ros__parameters", "command_joints", "command_interfaces", "state_interfaces"),
    *("state_publish_rate", "action_monitor_rate", "update_rate", "use_sim_time", "is_async", "params_file"),
    *("constraints", "gains", "open_loop_control", "interpolate_from_desired_state", "velocity_ff", "stop_trajectory"),
    *("allow_nonzero_velocity_at_trajectory_end", "allow_integration_in_goal_trajectories", "cmd_timeout"),
    *("set_last_command_interface_value_as_state_on_activation", "stop_trajectory_duration", "hardware_interface"),
    *("speed_scaling", "speed_scaling_interface_name", "scaling_factor_initial_default"),
)


@dataclass(eq=False)
class Controller:
    """A controller in a file: its type ("" if the file does not state a type), its joints, and other keys."""

    type: str = ""
    joints: tuple[str, ...] = ()
    keys: dict[str, Node] = field(default_factory=dict)


def columns_of(
    held: tuple[str, ...] | None, count: int, joints: Any, names: Any
) -> tuple[list[int], tuple[str, ...] | None]:
    """Return the columns that a method `save` writes to a file, and their names in the file.

    Parameters
    ----------
    held : tuple of str or None
        Names of all `count` columns; None if they have no names.
    joints : sequence of str or None
    names : mapping or sequence of str, or None
    """
    chosen = held
    if joints is not None:
        if held is None:
            raise InputError("joints: expected points with names, found none")
        chosen = tuple(_validate.listed(joints, "joints", wanted="a list of names"))
        for name in chosen:
            _validate.known(name, "joints", held)
        _expect_once("joints", chosen)
    columns = list(range(count)) if held is None or chosen is None else [held.index(name) for name in chosen]
    if names is None:
        return columns, chosen
    if isinstance(names, Mapping):
        for name in names:
            _validate.known(name, "names", held or ())
        new_names = tuple(names.get(name, name) for name in chosen or ())
    else:
        new_names = tuple(_validate.listed(names, "names", wanted="a mapping or a list of names"))
    if len(new_names) != len(columns):
        raise InputError(f"names: expected {len(columns)}, one for each column, found {len(new_names)}")
    for name in new_names:
        if not isinstance(name, str) or not name.strip() or name != name.strip() or not name.isprintable():
            raise InputError(f"names: expected printable names without outer spaces, found {_validate.short(name)}")
    _expect_once("names", new_names)
    return columns, new_names


def expect_in_table(names: Sequence[str]) -> None:
    """Raise an InputError for names that a table would interpret as columns of another kind."""
    for name in names:
        if name in (*TIMES, BLEND) or name.endswith((VELOCITY, ACCELERATION)) or name != name.strip():
            raise InputError(
                f"names: expected names that a .csv file reads as joints, found {name!r}; rename it by names=, or "
                "write a message"
            )


def write(
    target: Path,
    names: Sequence[str] | None,
    moves: Sequence[bool],
    listing: str | os.PathLike[str] | None,
    text: Callable[[list[int], Sequence[str]], str],
) -> None:
    """Write all columns to one file, or the columns of each listed controller to a separate file.

    Parameters
    ----------
    target, names, moves, listing
        As for `files_of`.
    text : callable
        Function that returns the contents of a file for columns and their names.
    """
    if names is None:
        raise InputError("names: expected the names of the columns, which the points do not have, found none")
    _expect_once("names", names)
    files = {target: list(range(len(names)))} if listing is None else files_of(listing, target, names, moves)
    texts = {file: text(columns, [names[k] for k in columns]) for file, columns in files.items()}
    for file, contents in texts.items():
        write_atomically(file, contents.encode())


def files_of(listing: Any, target: Path, names: Sequence[str], moves: Sequence[bool]) -> dict[Path, list[int]]:
    """For each listed controller that accepts trajectories, return the file to write and its columns of the trajectory.

    Parameters
    ----------
    listing : path
        A file of ros2_control or MoveIt.
    target : path
        The name of the file without the name of the controller: ``moved.yaml`` becomes ``moved.arm_controller.yaml``.
    names, moves : sequence
        Names of columns, and whether their values change; only columns that change need a controller.
    """
    controllers = _read(_validate.path(listing, "controllers"))
    taking = {name: one for name, one in controllers.items() if not one.type or one.type.endswith(TRAJECTORY)}
    served = {name: one for name, one in taking.items() if set(one.joints) & set(names)}
    left = [name for name, moving in zip(names, moves, strict=True) if moving]
    left = [name for name in left if not any(name in one.joints for one in served.values())]
    if left or not served:
        shown = "; ".join(
            f"{name} ({one.type or 'no type'}): {', '.join(one.joints)}" for name, one in sorted(controllers.items())
        )
        raise InputError(
            f"controllers: expected controllers that take a trajectory of {some(left or names)}, found none in "
            f"{listing} ({shown}); joints= leaves columns out, and names= gives them the names of the file"
        )
    files: dict[Path, list[int]] = {}
    for name, one in served.items():
        lacking = [joint for joint in one.joints if joint not in names]
        if lacking and not ("allow_partial_joints_goal" in one.keys and one.keys["allow_partial_joints_goal"].flag()):
            raise InputError(
                f"controllers: expected columns for all joints of {name} ({', '.join(one.joints)}), found none for "
                f"{some(lacking)} among {some(names)}"
            )
        label = re.sub(r"[^\w.-]", "_", name)
        file = target.with_name(f"{target.stem}.{label}{target.suffix}")
        if file in files:
            raise InputError(f"controllers: expected controllers whose files have different names, found {file} twice")
        files[file] = [names.index(joint) for joint in one.joints if joint in names]
        _warn(listing, name, one)
    return files


def _read(path: Path) -> dict[str, Controller]:
    """Read the controllers of a file, keyed by name; a controller's entries in several places are combined."""
    what = "a list of controllers"
    root = read_yaml(read_regular(path, what, MOST_BYTES), path, what, merges=True)
    controllers: dict[str, Controller] = {}
    waiting: list[tuple[tuple[str, ...], Node, tuple[int, ...]]] = [((), root, ())]
    while waiting:
        above, node, around = waiting.pop(0)
        if node.kind != "mapping":
            continue
        if id(node.raw) in around:
            raise node.error("expected no alias within itself, found one")
        keys, around = node.mapping(None), (*around, id(node.raw))
        if above and ("joints" in keys or ("type" in keys and keys["type"].kind == "scalar")):
            _add(controllers.setdefault("/".join(above), Controller()), node, keys)
        inside = {key: held for key, held in keys.items() if held.kind == "mapping"}
        if "controller_names" in keys:  # MoveIt uses only the listed controllers
            listed = {each.text(): each for each in keys["controller_names"].items()}
            for name, each in listed.items():
                if name not in inside:
                    raise each.error(f"expected a controller of the file, found no entry {name}")
            inside = {name: inside[name] for name in listed}
        elif "controller_list" in keys:
            entries = keys["controller_list"].items()
            inside |= {each.mapping(None, ("name",))["name"].text(): each for each in entries}
        for key, held in inside.items():
            waiting.append(((*above, *(part for part in key.split("/") if part not in AROUND)), held, around))
    controllers = {name: one for name, one in controllers.items() if one.joints or one.type.endswith(TRAJECTORY)}
    for name, one in controllers.items():
        if not one.joints:
            raise root.error(f"expected the joints of {name}, found none")
    if not controllers:
        raise root.error("expected controllers with joints, found none")
    return controllers


def _add(one: Controller, node: Node, keys: dict[str, Node]) -> None:
    """Add the keys of one place to a controller."""
    same = {"type"} if "type" in keys and keys["type"].text() == one.type else set()
    for key in (keys.keys() & one.keys.keys()) - same:
        raise node.error(f"expected {key} of this controller once, found it again in line {one.keys[key].line}")
    one.keys.update(keys)
    if "type" in keys:
        one.type = keys["type"].text()
    if "joints" in keys:
        one.joints = tuple(joint.text() for joint in keys["joints"].items())
        with keys["joints"].blamed():
            _expect_once("joints", one.joints)
        for joint in keys["joints"].items():
            if "$(" in joint.text():
                raise joint.error(
                    f"expected names of joints, found {joint.text()}; replace what a launch file fills in"
                )


def _warn(listing: Any, name: str, one: Controller) -> None:
    """Warn about settings with which a controller may leave the curve between points."""
    unknown = sorted(one.keys.keys() - {*USED, *HARMLESS})
    if unknown:
        warn(f"{listing}: not read, since they are no known settings of {name}: {some(unknown)}")
    if "interpolation_method" in one.keys and one.keys["interpolation_method"].text().lower() == "none":
        warn(f"{listing}: {name} has interpolation_method: none; it jumps from point to point, which is not proven")


def _expect_once(what: str, names: Sequence[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not names:
        raise InputError(f"{what}: expected different names, found {f'{some(twice)} again' if twice else 'none'}")
