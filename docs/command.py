"""The page of the command line: what `loewner --help` and its like print."""

import contextlib
import io
import os
import re
from pathlib import Path

from loewner import cli


def write(target: Path) -> None:
    """Write the page, unless it says the same already: Sphinx rebuilds what is new."""
    text = page()
    if not target.exists() or target.read_text() != text:
        target.write_text(text)


def page() -> str:
    """Help of the program and of each of its commands."""
    top = _help()
    parts = ["# Command line", "`loewner`, or `python -m loewner`.", f"```text\n{top}```"]
    for command in re.findall(r"^    (\w+)  ", top, flags=re.M):
        parts += [f"## loewner {command}", f"```text\n{_help(command)}```"]
    return "\n\n".join(parts) + "\n"


def _help(*command: str) -> str:
    os.environ["COLUMNS"] = "110"
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        cli.main([*command, "--help"])
    return out.getvalue()
