"""Call the kernel that proves motions, and represent the results of `CollisionChecker.certify_edges`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._pictures import pictured, verdicts
from loewner._base._threads import in_shares
from loewner._base._validate import Floats, Ints
from loewner._base._workspaces import workspace
from loewner._kernels import codes
from loewner._native import entries
from loewner.errors import InputError
from loewner.queries.pairs import Verdict
from loewner.robots.checking.problem import Problem

# Smallest number of motions that a thread takes at a time: about 0.3 ms of work.
LEAST_SHARE = 16

# Column of `Found.work` that contains the number of steps.
STEPS = 2

NO_STRAYS = np.empty((0, 0))
NO_CLEARANCES = np.empty(0)


@dataclass(frozen=True, eq=False, repr=False)
class CertifiedMotions(_validate.Brief):
    """Whether motions are free of collisions along their whole length.

    Attributes
    ----------
    verdict : Verdict, or ndarray of int8
        FREE: every pair is proven to be farther apart than its margin at every real fraction from 0 to 1, except for
        contact at the ends that `Scene.leave` or `Scene.reach` allows. COLLIDING: the configuration at `fraction`
        collides. AMBIGUOUS: at `fraction` a pair comes within the tolerance of its margin, or arithmetic could not
        settle the pair; treat the motion as not free.
    fraction : float or ndarray
        Fraction of the motion, as in `Robot.between`; NaN if FREE. If COLLIDING, the configuration at this fraction
        collides, but earlier configurations may collide as well.
    names : tuple of str, or ndarray of str, shape (..., 2)
        The pair that is COLLIDING or AMBIGUOUS at this fraction; empty strings if FREE.
    poses, searches : int or ndarray of int64
        Work of the proof: the number of configurations at which the robot was placed, and the number of searches on
        pairs of pieces.
    steps : int or ndarray of int64
        The total work, in steps, which `CollisionChecker.certify_edges` can limit. An AMBIGUOUS motion that took more
        steps than allowed was given up at `fraction`, and nothing more is known about the motion. If the proof of a
        motion had not begun, its `names` are empty.
    proof : Proof or None
        A proof that all motions are free, if a proof was requested and all motions are free.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> found = checker.certify_edges([0.0, 1.57], [0.5, 1.57])
    >>> print(found.verdict, found.fraction, found.names)
    FREE nan ('', '')
    """

    verdict: Any
    fraction: Any
    names: Any
    poses: Any
    searches: Any
    steps: Any
    proof: Any = None

    @pictured
    def _repr_html_(self) -> str:
        flat_verdicts = np.ravel(self.verdict)
        return verdicts(flat_verdicts, np.arange(len(flat_verdicts) + 1.0), "number of the motion")


class Limit(NamedTuple):
    """Limits on the work of proofs; groups of successive motions share a limit.

    Attributes
    ----------
    steps : int or ndarray of int64, shape (groups,)
    first : ndarray of int, shape (groups + 1,)
        Index of the first motion of each group, followed by the number of motions.
    """

    steps: int | Ints
    first: Ints


class Found(NamedTuple):
    """The kernel's results for N motions.

    Attributes
    ----------
    verdicts : ndarray of int8, shape (N,)
        As for `CertifiedMotions`, or TOO_LONG. `settle` also returns BY_CARE, which means COLLIDING if `collide`
        confirms it.
    fractions : ndarray, shape (N,)
    pairs : ndarray of int64, shape (N,)
        Indices of the pairs; -1 if there is no pair.
    work : ndarray of int64, shape (N, 3)
        Numbers of poses, of searches, and of steps.
    """

    verdicts: NDArray[np.int8]
    fractions: Floats
    pairs: Ints
    work: Ints

    def expect_short(self, a: Floats, b: Floats) -> None:
        """Refuse motions between a and b, shape (N, dof) each, that would take too many intervals.

        Raises
        ------
        InputError
            If there is such a motion. The message gives the index of the first such motion.
        """
        for k in (self.verdicts == codes.TOO_LONG).nonzero()[0][:1]:
            raise InputError(
                f"expected motions short enough to be proven in {codes.MOST_INTERVALS} intervals, found number {k}, "
                f"which goes {np.abs(b[k] - a[k]).max():g} rad or m in one joint; divide it"
            )

    def of_shape(self, shape: tuple[int, ...], ready: Problem) -> CertifiedMotions:
        """Convert to the result for users: arrays of the given shape, or single values if the shape is ()."""
        if not shape:
            pair = int(self.pairs[0])
            names = ("", "") if pair < 0 else tuple(ready.names[k] for k in ready.pairs[pair].tolist())
            verdict, fraction = Verdict(int(self.verdicts[0])), float(self.fractions[0])
            return CertifiedMotions(verdict, fraction, names, *self.work[0].tolist())
        return CertifiedMotions(
            self.verdicts.reshape(shape), self.fractions.reshape(shape),
            ready.names_of_pairs[self.pairs].reshape(*shape, 2), *self.work.T.reshape(3, *shape),
        )  # fmt: skip


def settle(
    ready: Problem,
    courses: Floats,
    tolerance: float,
    off: Floats | None = None,
    clear: Floats = NO_CLEARANCES,
    limit: Limit | None = None,
    as_given: bool = False,
) -> Found:
    """Let the kernel settle motions along courses.

    Parameters
    ----------
    ready : Problem
    courses : ndarray, shape (N, degree + 1, dof)
        See `courses`; in C order and writeable.
    tolerance : float
        Distance in metres, as for `CollisionChecker.certify_edges`.
    off : ndarray, shape (N, dof + 3 growing), optional
        How far each value may deviate from the course at any fraction; FREE covers all such deviations. The last
        columns bound how far points of bodies may deviate, in the form that the kernel takes. For COLLIDING, these
        bounds count as a margin, unless `as_given` is true.
    clear : ndarray, shape (N,), optional
        Distances in metres that all pairs must keep on a motion in addition to their margins; COLLIDING then refers to
        these distances, too.
    limit : Limit, optional
    as_given : bool
        Whether COLLIDING refers to bodies at their given poses, without pose errors.

    Notes
    -----
    If `ready.starts_matter`, FREE is valid only if the motion is free at its start.
    """
    total = len(courses)
    if as_given and ready.off is not None:
        off = np.zeros((total, courses.shape[2])) if off is None else off
        off = np.concatenate([off, np.tile(ready.off, (total, 1))], axis=1)
        ready = ready.as_given
    ready = ready.in_parts
    answers = Found(
        np.full(total, as_given, dtype=np.int8), np.empty(total), np.empty(total, dtype=np.int64),
        np.full((total, 3), codes.NO_LIMIT if limit is None else -1, dtype=np.int64),
    )  # fmt: skip
    first = np.arange(total + 1) if limit is None else limit.first
    if limit is not None:
        full = first[:-1] < first[1:]
        answers.work[first[:-1][full], STEPS] = np.maximum(np.broadcast_to(limit.steps, full.shape), 0)[full]
    strays = NO_STRAYS if off is None else off

    def share(begin: int, end: int) -> None:
        entries.certify_motions(
            first[begin], first[end], courses, strays, clear, tolerance, ready.packed.handle, ready.handle,
            ready.handle_of_motions, *answers, workspace(ready.memory(entries.motion_memory)),
        )  # fmt: skip

    in_shares(share, len(first) - 1, LEAST_SHARE)
    return answers
