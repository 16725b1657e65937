"""The page of the command line: what `loewner --help` and its like print."""

import contextlib
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path

from loewner import cli


def write(target: Path) -> None:
    """Write the page, unless it says the same already: Sphinx rebuilds what is new."""
    text = page()
    if not target.exists() or target.read_text() != text:
        target.write_text(text)


def page() -> str:
    """Help of the program, of each of its commands, and of theirs."""
    parts = ["# Command line", "`loewner`, or `python -m loewner`.", *_sections()]
    return "\n\n".join(parts) + "\n"


def _sections(*command: str) -> Iterator[str]:
    text = _help(*command)
    if command:
        yield f"## loewner {' '.join(command)}"
    yield f"```text\n{text}```"
    commands = re.search(r"^  COMMAND\n((?:    .*\n)+)", text, flags=re.M)
    for name in re.findall(r"^    (\w+)", commands[1], flags=re.M) if commands else ():
        yield from _sections(*command, name)


def _help(*command: str) -> str:
    os.environ["COLUMNS"] = "110"
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        cli.main([*command, "--help"])
    return out.getvalue()
