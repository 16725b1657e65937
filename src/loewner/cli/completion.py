"""Completion of the command line in shells: scripts that shtab generates from the parser."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, NoReturn

from loewner.errors import imported

SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")


class PrintCompletion(argparse.Action):
    """An option that prints the completion script for a shell and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, _: argparse.Namespace, shell: Any, __: Any = None) -> NoReturn:
        """Print the script for the parser that has this option.

        Raises
        ------
        MissingExtraError
            If shtab is not installed.
        """
        shtab = imported("shtab", "--print-completion needs shtab", "cli")
        for action in _actions(parser):
            if action.choices is None and action.nargs != 0:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        # For arguments of any number, shtab writes a pattern of zsh that offers files for the first one only.
        print(shtab.complete(parser, shell).replace('"(*)::', '"*:').replace('"(*):', '"*:'))
        parser.exit()


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options and arguments of a parser and of its commands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
