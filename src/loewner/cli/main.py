"""Run the command line: parse arguments, call the public API, and print.

The exit statuses are:

- 0: done, or free.
- 1: no path, or colliding (at least one of many pairs or configurations).
- 2: an error, or at least one of many meshes failed.
- 3: ambiguous (only for ``loewner check --method certified``, ``plan``, ``clash``, ``cover``, ``judge`` and ``audit``).
- 4: free, but beyond a limit of the robot (only for ``audit``).

For ``loewner report rerun``, 1 means that answers differ. The status does not change if the program that reads the
output ends early (``| head``).
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

import loewner
from loewner._base import _validate
from loewner._base._files import folder_exists, shown
from loewner.cli import (
    audit,
    check,
    clash,
    clearance,
    compile,
    cover,
    fit,
    info,
    judge,
    paper,
    plan,
    report,
    robot,
    swept,
    verify,
    view,
)
from loewner.cli.completion import SHELLS, PrintCompletion
from loewner.cli.output import ERROR, PrintPath, standard_output
from loewner.errors import FileError, InputError, LoewnerError
from loewner.scenes.files.schema import SCHEMA_FILE

# Options that name files to write. The options in UPDATED may name the same file, to which `clash` adds pairs.
OUTPUTS = {"out", "proof", "csv", "json", "picture", "program", "screenshot", "write_srdf"}
UPDATED = {"write_srdf", "srdf"}

# Options whose names differ from the names of the Python arguments that receive their values.
OPTION_OF = {
    "T_world_a": "pose-a", "T_world_b": "pose-b", "about": "at", "client": "scheduler", "format": "for",
    "joints": "largest", "link": "goal-pose", "pairs": "between", "poses": "motion", "path": "screenshot", "t": "at",
}  # fmt: skip

# The error of argparse if the numbers of a configuration are not in quotes.
STRAY_NUMBER = re.compile(r"unrecognized arguments: -?\.?\d")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line of ``loewner``.

    Parameters
    ----------
    arguments : sequence of str, optional
        The arguments after ``loewner``; by default, the arguments of the process.

    Returns
    -------
    int
        The exit status: 0 for free or done, 1 for colliding or no path, 2 for an error, 3 for ambiguous, 4 for free,
        but beyond a limit of the robot (``audit``).

    Examples
    --------
    >>> from loewner import Body, cli
    >>> Body.box([1, 1, 1]).save("box.npz")
    >>> cli.main(["check", "box.npz", "box.npz", "--pose-b", "3 0 0"])  # doctest: +ELLIPSIS
    FREE...
    0
    """
    words = sys.argv[1:]
    try:
        with standard_output(), _warnings_as_lines():
            words = words if arguments is None else _words(arguments)
            options = _parser(words[:1]).parse_args(words)
            _expect_separate_files(options)
            return int(options.run(options))
    except LoewnerError as error:
        print(f"loewner: error: {_with_option(str(error), words)}", file=sys.stderr)
    except BrokenPipeError:
        pass  # standard error has no reader
    except KeyboardInterrupt:
        print("loewner: interrupted", file=sys.stderr)
    except Exception:
        # Python's own status for a crash is 1, which here means "colliding".
        traceback.print_exc()
    return ERROR


def _with_option(text: str, words: Sequence[str]) -> str:
    """Let an error about a Python argument begin with the command-line option that was given for this argument."""
    name, colon, rest = text.partition(": ")
    used = {word.partition("=")[0] for word in words}
    option = next((one for one in (_flag(name), _flag(OPTION_OF.get(name, name))) if one in used), "")
    return f"{option}: {rest}" if colon and option else text


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _expect_separate_files(options: argparse.Namespace) -> None:
    """Refuse an output file that another option names as well, or whose folder is missing, before the work begins.

    Raises
    ------
    InputError, FileError
    """
    listed = ((name, value if isinstance(value, list) else [value]) for name, value in vars(options).items())
    paths = [(name, path) for name, values in listed for path in values if isinstance(path, Path)]
    for name, path in paths:
        if name not in OUTPUTS or folder_exists(path):
            continue
        if not folder_exists(path.parent) and not options.makes_folder:
            raise FileError(f"{_flag(name)}: expected a file in a folder that exists, found {shown(path)}")
        for other, its in paths:
            if other != name and {name, other} != UPDATED and _is_same(path, its):
                raise InputError(
                    f"{_flag(name)}: expected a file of its own, found {shown(path)}, also given as {other}"
                )


def _is_same(path: Path, other: Path) -> bool:
    """Return whether two paths lead to the same place. The result is False for names that no file system accepts."""
    try:
        return os.path.realpath(path) == os.path.realpath(other)
    except (OSError, ValueError):
        return False


def _words(arguments: Any) -> list[str]:
    words = _validate.listed(arguments, "arguments")
    for word in words:
        if not isinstance(word, str):
            raise InputError(f"arguments: expected text only, found {_validate.short(word)}")
    return words


class _Parser(argparse.ArgumentParser):
    """A parser, also for subcommands, that accepts arguments which begin like negative numbers.

    Before Python 3.14, argparse recognises "-0.5" as a number, but treats "-0.5,0.3" and "-5e-1" as unknown options. An
    error about numbers without quotes includes a hint.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Report unknown options here, with the usage of the command that received them."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown and self.get_default("run"):
            near = get_close_matches(unknown[0], re.findall(r"--[\w-]+", self.format_usage()), 1, 0.75)
            self.error(f"unrecognized arguments: {' '.join(unknown)}{f'; did you mean {near[0]}?' if near else ''}")
        return options, unknown

    def error(self, message: str) -> NoReturn:
        hint = "; write numbers that belong together in quotes" if STRAY_NUMBER.match(message) else ""
        super().error(message + hint)


def _parser(words: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Make the parser: with all commands, which takes 5 ms, or only with the command that is among some words."""
    parser = _Parser(prog="loewner", description=loewner.__doc__)
    parser.add_argument("--version", action="version", version=f"loewner {loewner.__version__}")
    package = Path(loewner.__file__).parent
    for option, folder, what in (
        ("--include", package / "include", "headers for C and C++"),
        ("--cmake-dir", package / "share" / "cmake", "files for CMake's find_package"),
        ("--pkg-config-dir", package / "share" / "pkgconfig", "files for pkg-config"),
    ):
        parser.add_argument(option, action=PrintPath, path=folder, help=f"print the folder of {what}")
    parser.add_argument(
        "--scene-schema", action=PrintPath, path=SCHEMA_FILE, help="print the path of scene files' JSON Schema"
    )
    parser.add_argument(
        "--print-completion", action=PrintCompletion, choices=SHELLS, help="print the completion script of a shell"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    of_bodies, of_robots = (fit, check, clearance, judge), (robot, clash, cover, plan, verify, audit, swept)
    every = (*of_bodies, *of_robots, report, view, compile, info, paper)
    for command in [one for one in every if one.__name__.rpartition(".")[2] in words] or every:
        command.add(commands)
    return parser


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print each warning immediately, on a separate line, since the work that causes it may take minutes."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"loewner: warning: {message}", file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
