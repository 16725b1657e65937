"""Prove motions: run the kernel, confirm collisions, check for starts inside solids, and apply contact rules."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner._kernels import codes
from loewner.robots.checking import verdicts
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import contacts, motions
from loewner.robots.proofs.courses import configurations, straight
from loewner.robots.proofs.motions import STEPS, Found, Limit


class ProofOptions(NamedTuple):
    """Options of the proof of a motion or a curve.

    Attributes
    ----------
    tolerance : float
        Distance in metres, as for `CollisionChecker.certify_edges`.
    joint_error : ndarray, shape (dof,), optional
        How far values may deviate; FREE covers all such deviations.
    steps : int, optional
        Maximum number of steps spent on each motion or curve. Default: no limit.
    """

    tolerance: float
    joint_error: Floats | None = None
    steps: int | None = None

    def limit(self, first: Ints) -> Limit | None:
        """Return the limit on groups of motions; `first` is as in `Limit`."""
        return None if self.steps is None else Limit(self.steps, first)


def prove(
    ready: Problem, courses: Floats, tolerance: float, off: Floats | None = None, limit: Limit | None = None
) -> Found:
    """Prove which courses are free; contact is never allowed.

    Parameters
    ----------
    ready : Problem
    courses : ndarray, shape (N, degree + 1, dof)
        As in the module `courses`; the array is in C order and writeable.
    tolerance : float
        In metres.
    off : ndarray, shape (N, dof), optional
        How far joint values may deviate from the course at any fraction; FREE covers all such deviations.
    limit : Limit, optional

    Returns
    -------
    Found
        Results whose verdict is TOO_LONG for motions that would take too many intervals.
    """
    answers = motions.settle(ready, courses, tolerance, off, limit=limit, as_given=True)
    _confirm(ready.as_given, courses, answers)
    refuse_starts(ready.as_given, courses[:, 0], answers)
    return answers


def prove_by_rules(ready: Problem, a: Floats, b: Floats, options: ProofOptions) -> Found:
    """Prove which straight motions between configurations a and b, shape (N, dof) each, are free.

    Pairs named by `Scene.leave` and `Scene.reach` may be in contact at the ends, unless there is a joint error.
    """
    courses = straight(ready.robot, a, b)
    off = deviations(courses, options.joint_error)
    first = np.arange(len(courses) + 1)
    answers = prove(ready, courses, options.tolerance, off, options.limit(first))
    if off is None:
        apply_rules(ready, courses, np.zeros_like(courses[:, 0]), first, answers, options)
    return answers


def apply_rules(ready: Problem, courses: Floats, off: Floats, first: Ints, found: Found, options: ProofOptions) -> None:
    """Prove the remaining curves, with the contact at their ends that `Scene.leave` and `Scene.reach` allow.

    Parameters
    ----------
    ready : Problem
    courses : ndarray, shape (N, degree + 1, dof)
        The segments of all curves.
    off : ndarray, shape (N, dof)
        How far values may deviate from the courses.
    first : ndarray of int, shape (curves + 1,)
        Index of the first segment of each curve, followed by N.
    found : Found
        The results of `prove`, which are modified.
    options : ProofOptions
        Without a joint error. The limit on the work for each curve includes the work that `found` took.
    """
    tolerance, _, steps = options
    at = np.flatnonzero(found.verdicts != codes.FREE) if len(ready.ruled) else ready.ruled[:0]
    if len(at) == 0:
        return
    limit = None
    if steps is not None:
        limit = Limit(steps - np.add.reduceat(found.work[:, STEPS], first[:-1]), np.searchsorted(at, first))
    rest = prove(ready.unruled, courses[at], tolerance, off[at] if off.any() else None, limit)
    numbers = np.append(np.setdiff1d(np.arange(len(ready.pairs)), ready.ruled), -1)
    found.verdicts[at], found.fractions[at], found.pairs[at] = rest.verdicts, rest.fractions, numbers[rest.pairs]
    found.work[at] += rest.work
    for curve in np.unique(np.searchsorted(first, at[rest.verdicts == codes.FREE], side="right") - 1).tolist():
        own = slice(first[curve], first[curve + 1])
        verdicts, fractions, pairs = (array[own] for array in (found.verdicts, found.fractions, found.pairs))
        for pair in ready.ruled.tolist():
            work = contacts.Work(None if steps is None else steps - int(found.work[own, STEPS].sum()))
            settled = contacts.settle(ready, pair, courses[own], off[own, : courses.shape[2]], tolerance, work)
            found.work[own.start, STEPS] += work.taken
            if work.most is not None and work.taken > work.most:
                settled.verdicts[settled.verdicts == codes.COLLIDING] = codes.AMBIGUOUS
            worse = (settled.verdicts != codes.FREE) & np.isin(verdicts, (codes.FREE, codes.AMBIGUOUS))
            verdicts[worse], fractions[worse], pairs[worse] = settled.verdicts[worse], settled.fractions[worse], pair
            if (verdicts == codes.COLLIDING).any():
                break


def deviations(courses: Floats, joint_error: Floats | None) -> Floats | None:
    """Add to a joint error the rounding of configurations that users compute from courses; None without an error.

    Returns
    -------
    ndarray, shape (N, dof), or None
    """
    if joint_error is None or not joint_error.any():
        return None
    off: Floats = joint_error + contacts.OFF * np.abs(courses).max(axis=1)
    return off


def _confirm(ready: Problem, courses: Floats, found: Found) -> None:
    """Keep COLLIDING only for motions that collide at the configuration that a user computes from the fraction.

    Values that change linearly agree bit for bit with the kernel's values. Polynomials may differ in the last place,
    and so may orientations, since NumPy's sines differ from the kernel's.
    """
    doubtful = found.verdicts == codes.BY_CARE
    if not (ready.robot.runs_straight and courses.shape[1] == 2):
        doubtful |= found.verdicts == codes.COLLIDING
    at = doubtful.nonzero()[0]
    if len(at):
        Q = configurations(ready.robot, courses[at], found.fractions[at])
        hit = verdicts.classified(ready, codes.EXACT, Q).verdicts == codes.COLLIDING
        found.verdicts[at] = np.where(hit, codes.COLLIDING, codes.AMBIGUOUS)


def refuse_starts(ready: Problem, a: Floats, found: Found) -> None:
    """Keep FREE only for motions whose starts are free, if the result of `motions.settle` presupposes free starts."""
    free = np.flatnonzero(found.verdicts == codes.FREE) if ready.starts_matter else ready.ruled[:0]
    if len(free) == 0:
        return
    for k in free[~verdicts.free(ready, a[free])]:
        of_pairs = verdicts.verdicts_at(ready, a[k])
        verdict = codes.COLLIDING if (of_pairs == codes.COLLIDING).any() else codes.AMBIGUOUS
        found.verdicts[k], found.fractions[k], found.pairs[k] = verdict, 0.0, (of_pairs == verdict).argmax()
