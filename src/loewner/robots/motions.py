"""Motions that are proven: what `CollisionChecker.certify_edges` returns, and the calls of its kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner import _validate
from loewner._native import entries
from loewner._threads import in_shares
from loewner._validate import Floats
from loewner._workspaces import workspace
from loewner.errors import InputError
from loewner.robots.checked_pairs import CheckedPairs

# Motions a thread takes at a time, at least: some 0.3 ms of work.
LEAST_SHARE = 16

# Further verdicts, as `robots.motions` of the kernels calls them.
TOO_LONG, BY_CARE = 3, 4


@dataclass(frozen=True, eq=False)
class CertifiedMotions:
    """Whether motions are free at every one of their configurations.

    Attributes
    ----------
    verdict : Verdict, or ndarray of int8
        FREE: every pair is farther apart than its margin at every real fraction from 0 to 1, proven. COLLIDING: the
        configuration at `fraction` collides. AMBIGUOUS: at `fraction` a pair comes within its margin and the tolerance,
        or arithmetic could not settle it; to be treated as not free.
    fraction : float or ndarray
        Of the way, as `Robot.between` takes it; NaN where FREE.
    names : tuple of str, or ndarray of str, shape (..., 2)
        The pair that collides or is ambiguous there; empty where FREE.
    poses, searches : int or ndarray of int64
        Work done: configurations that the robot was placed at, and searches on single pairs of pieces.
    """

    verdict: Any
    fraction: Any
    names: Any
    poses: Any
    searches: Any

    def __repr__(self) -> str:
        return _validate.brief(self)


def certify(ready: CheckedPairs, a: Floats, b: Floats, tolerance: float) -> tuple[Any, ...]:
    """Verdicts, fractions, pairs (-1: none) and work, shape (N, 2), of N motions between configurations a and b.

    A verdict may be BY_CARE: COLLIDING if `collide` says so.

    Raises
    ------
    InputError
        If a motion is too long to be cut into intervals.
    """
    total = len(a)
    verdicts, fractions = np.empty(total, dtype=np.int8), np.empty(total)
    pairs, work = np.empty(total, dtype=np.int64), np.empty((total, 2), dtype=np.int64)
    motions = ready.motions

    def share(first: int, last: int) -> None:
        entries.certify_motions(
            first, last, a, b, tolerance, ready.bodies._packed.handle, ready.handle, motions.handle, verdicts,
            fractions, pairs, work, workspace(motions.memory),
        )  # fmt: skip

    in_shares(share, total, LEAST_SHARE)
    if (verdicts == TOO_LONG).any():
        k = int(np.argmax(verdicts == TOO_LONG))
        raise InputError(
            f"expected motions short enough to be proven in 458752 intervals, found number {k}, which goes "
            f"{np.abs(b[k] - a[k]).max():g} rad or m in one joint; divide it"
        )
    return verdicts, fractions, pairs, work
