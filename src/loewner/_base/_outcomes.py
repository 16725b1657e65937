"""The outcome of the work on each of many mesh files, for the command line and for clusters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from loewner._base._files import shown
from loewner._base._plausible import told_to
from loewner.errors import LoewnerError

# A small body on which options are tried, so that a bad option is reported once instead of for each of a thousand
# files.
TETRAHEDRON = (
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


class Outcome(NamedTuple):
    """The outcome for a mesh: done, skipped or failed, with the reason for a failure and any warnings."""

    status: str
    message: str = ""
    warnings: tuple[str, ...] = ()


def outcome_of(mesh: Path, fit: Callable[[], Outcome]) -> Outcome:
    """Return the outcome of `fit` with any warnings; the message of a failure begins with the file's name."""
    warnings: list[str] = []
    try:
        with told_to(warnings):
            outcome = fit()
        return outcome._replace(warnings=(*outcome.warnings, *warnings))
    except LoewnerError as error:
        text = str(error)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
    name = f"{shown(mesh)}: "
    return Outcome("failed", text if text.startswith(name) else name + text)
