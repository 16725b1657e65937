"""Decide for planners whether motions are free, by proofs or by samples.

A single `Judge` is used for a path from its first motion to its last shortening, and refers to a single state of the
scene. The scene may change meanwhile, and motions that are free at different times may form a path that is never free
as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints, fits_memory
from loewner._base._workspaces import workspace
from loewner._kernels import codes
from loewner._native import entries
from loewner.errors import InputError, PlanningError
from loewner.planners.kept_axes import KeptAxis
from loewner.queries.pairs import Verdict
from loewner.robots import CertifiedMotions, CollisionChecker
from loewner.robots.checker import prepared_of
from loewner.robots.checking import verdicts
from loewner.robots.checking.edges import steps
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs.contacts import deeper_than_ends
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.curves import joint_errors
from loewner.robots.proofs.proofs import ProofOptions, deviations, prove, prove_by_rules

# Motions that come closer to a collision than TOLERANCE [m] may count as not free.
TOLERANCE = 1e-5


def checked_checker(checker: Any) -> CollisionChecker:
    """Check that an argument is a collision checker."""
    return _validate.instance(checker, "checker", CollisionChecker)


@dataclass(frozen=True, eq=False)
class Judge:
    """Judge motions for a planner: prove them, or sample them in steps.

    Attributes
    ----------
    checker : CollisionChecker
    ready : Problem
        The pairs in one consistent state of the scene. All motions are judged with these pairs.
    resolution : float
        Largest step between samples; 0 if motions are proven.
    samples : int
        Number of samples that the longest motion needs.
    joint_error : ndarray, shape (dof,), or None
        How far values may deviate from proven motions; None if they do not deviate.
    kept : KeptAxis or None
        An axis that every motion must keep within an angle of a direction.
    """

    checker: CollisionChecker
    ready: Problem
    resolution: float
    samples: int
    joint_error: Floats | None
    kept: KeptAxis | None = None

    @classmethod
    def of(
        cls, checker: CollisionChecker, resolution: float, joint_error: ArrayLike = 0.0, kept: KeptAxis | None = None
    ) -> Judge:
        """Make a judge for the scene's current state.

        Raises
        ------
        InputError
            If the joint error has the wrong shape or is negative, or if it is given for sampled motions.
        """
        errors = joint_errors(checker.robot, joint_error)
        if resolution and errors.any():
            raise InputError("joint_error: expected certified=True with it, since samples do not cover deviations")
        return cls(checker, prepared_of(checker), resolution, 1, errors if errors.any() else None, kept)

    def now(self) -> Judge:
        """Return a judge with the same settings for the scene's current state."""
        return replace(self, ready=prepared_of(self.checker))

    def up_to(self, longest: float) -> Judge:
        """Return a judge that refers to the same state, and can sample motions up to a given length.

        Raises
        ------
        InputError
            If sampling would take too many steps.
        """
        size = int(steps(np.array(longest), self.resolution)) + 3 if self.resolution else 1
        fits_memory(9 * size, f"{size} steps of a motion")
        return replace(self, samples=size)

    @property
    def errors(self) -> Floats:
        """The joint error, shape (dof,); zeros if no value deviates."""
        return np.zeros(self.checker.robot.dof) if self.joint_error is None else self.joint_error

    def asked(self) -> tuple[Ints, Floats]:
        """Return the handles and lengths for `_kernels.robots.free_motions.judge_of`, for calls from this thread."""
        ready = self.ready if self.resolution else self.ready.in_parts
        memory = workspace(max(map(ready.memory, (entries.motion_memory, entries.memory_size))))
        error = 0 if self.joint_error is None else self.joint_error.ctypes.data
        kept = 0 if self.kept is None else self.kept.handle
        handles = [ready.packed.handle, ready.handle, ready.handle_of_motions, memory, self.samples, error, kept]
        return np.array(handles, dtype=np.int64), np.array([TOLERANCE, self.resolution])

    def free(self, Q0: Floats, Q1: Floats) -> Bools:
        """Return which motions of a batch are free and keep the axis. An unsettled motion counts as not free."""
        if not self.resolution:
            courses = straight(self.ready.robot, Q0, Q1)
            free = self.proven(courses, deviations(courses, self.joint_error))
        else:
            motion_verdicts, _ = verdicts.sampled(self.ready, Q0, Q1, self.resolution)
            free = np.asarray(motion_verdicts == codes.FREE)
        return free if self.kept is None else free & self.kept.on(Q0, Q1)

    def certified(self, a: Floats, b: Floats) -> CertifiedMotions:
        """Prove one motion between configurations under the scene's contact rules, even if the judge samples motions.

        Raises
        ------
        InputError
            If the proof would take too many intervals.
        """
        answers = prove_by_rules(self.ready, a[None], b[None], ProofOptions(TOLERANCE, self.joint_error))
        answers.expect_short(a[None], b[None])
        return answers.of_shape((), self.ready)

    def proven(self, courses: Floats, off: Floats | None = None) -> Bools:
        """Return which courses of a batch are proven free, including all deviations of up to `off`."""
        return np.asarray(prove(self.ready, courses, TOLERANCE, off).verdicts == codes.FREE)


def free_now(judge: Judge, a: Floats, b: Floats) -> bool:
    """Return whether a motion is free in the scene's current state. An unsettled motion counts as not free."""
    if judge.resolution:
        return verdicts.is_sampled_free(prepared_of(judge.checker), a, b, judge.resolution)
    return bool(judge.now().free(a[None], b[None])[0])


def refuse_unfree(judge: Judge, path: Floats, name: str) -> None:
    """Raise an error unless every motion of a path is free.

    Parameters
    ----------
    judge : Judge
    path : ndarray, shape (k, dof)
    name : str
        Name of the path in messages.

    Raises
    ------
    PlanningError
        If a motion is not free. The message names the motion and the pair of bodies.
    """
    free = judge.free(path[:-1], path[1:])
    if not free.all() and len(judge.ready.ruled) and judge.joint_error is None:
        touching = np.flatnonzero(~free)  # in the order of the path, since contact rules depend on the order
        receding = prove_by_rules(judge.ready, path[touching], path[touching + 1], ProofOptions(TOLERANCE))
        free[touching] = receding.verdicts == codes.FREE
        if free.all() and (deeper := deeper_than_ends(judge.ready, path, touching, TOLERANCE)) is not None:
            row, a, b = deeper
            raise PlanningError(
                f"{name}: expected contacts that get no deeper along the path than at its ends, found {a} and {b} "
                f"deeper at row {row}"
            )
    if free.all():
        return
    k = int(free.argmin())
    answer = judge.certified(path[k], path[k + 1])
    if answer.verdict == Verdict.FREE:
        told = f"which is not free when it is sampled in steps of {judge.resolution:g}"
    else:
        how = f"come within {TOLERANCE:g} m of their margin"
        how += " for deviating values" if judge.joint_error is not None else ""
        if answer.verdict == Verdict.COLLIDING:
            how = "collide or come within their margin"
        told = f"on which {answer.names[0]} and {answer.names[1]} {how} at the fraction {answer.fraction:.6g}"
    raise PlanningError(f"{name}: expected free motions, found the one from row {k} to row {k + 1}, {told}")
