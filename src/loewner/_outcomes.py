"""What becomes of each of many mesh files: done, or failed and why; shared by the command line and by clusters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from loewner._files import shown
from loewner._plausible import told_to
from loewner.errors import LoewnerError

# A small body to try options on: what they are refused for need not be told of each of a thousand files.
TETRAHEDRON = (
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


class Outcome(NamedTuple):
    """What became of a mesh: done, skipped or failed; why, if it failed; and what there was to warn of."""

    status: str
    message: str = ""
    warnings: tuple[str, ...] = ()


def outcome_of(mesh: Path, fit: Callable[[], Outcome]) -> Outcome:
    """What `fit` returns, with what it warns of; the errors of a file are its outcome, and begin with its name."""
    warnings: list[str] = []
    try:
        with told_to(warnings):
            found = fit()
        return found._replace(warnings=(*found.warnings, *warnings))
    except LoewnerError as error:
        text = str(error)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
    name = f"{shown(mesh)}: "
    return Outcome("failed", text if text.startswith(name) else name + text)
