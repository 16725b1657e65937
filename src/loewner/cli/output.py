"""What commands give back: an exit status, tables on standard output, progress on standard error."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

import loewner
from loewner.errors import MissingExtraError, installing

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.table import Table

# Exit status: done, or free; one or more colliding; an error; the ellipsoids cannot tell.
FREE, COLLIDING, ERROR, AMBIGUOUS = 0, 1, 2, 3


def progress_bar() -> Progress:
    """Progress on standard error, so that standard output stays the answer."""
    expect_rich()
    from rich.console import Console
    from rich.progress import Progress

    return Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def new_table(*columns: str, title: str | None = None) -> Table:
    """Make a table without rows, to fill before it is printed."""
    expect_rich()
    from rich.table import Table

    return Table(*columns, title=title)


def expect_rich() -> None:
    """Raise unless Rich is there. Every command that needs it finds out before its work."""
    try:
        import rich  # noqa: F401
    except ImportError:
        raise MissingExtraError(f"tables and progress need Rich: {installing('cli')}") from None


def print_table(table: Table) -> None:
    """Print a table."""
    from rich.console import Console

    console = Console()
    # A pipe has no width; there a table is not cut to 80 columns.
    Console(width=None if console.is_terminal else 200).print(table)


def covering_text(covering: loewner.Covering | None) -> str:
    """What the pieces of a mesh hold of it, in a few words."""
    if covering is None:
        return "-"
    percent = round(100 * covering.excess_volume, 1) + 0.0  # no minus zero
    excess = f", {percent:+.1f} % volume"
    if np.isnan(covering.excess_volume):
        excess = ", volume of the mesh unknown"
    if covering.exact:
        return f"{covering.kind}, holds the mesh{excess}"
    return f"{covering.kind}, leaves up to {1e3 * covering.max_uncovered:.3g} mm uncovered{excess}"
