"""Find the largest tracking error of each joint for which motions are proven free."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._validate import Bools, Floats
from loewner._kernels import codes
from loewner.errors import InputError
from loewner.queries.pairs import Verdict
from loewner.robots.checking import edges
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs.curves import joint_errors
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules

# The search ends when an unproven error is at most NEAR times the result.
NEAR = 1.02

# The first error that is tried, in radians or metres, and the factor to the next one. Large errors take longest.
FIRST, STEP = 1e-6, 8.0


def largest(ready: Problem, a: Floats, b: Floats, weights: Floats, most: float, tolerance: float) -> float:
    """Compute the largest e <= most for which all motions are proven free within the joint errors e * weights.

    The motions are between configurations a and b, shape (N, dof) each. The result may be too small by a factor of up
    to `NEAR`; it is 0.0 if the motions are not proven free within the error `FIRST`.
    """

    def unproven(a: Floats, b: Floats, e: float) -> Bools:
        return np.asarray(prove_by_rules(ready, a, b, ProofOptions(tolerance, e * weights)).verdicts != codes.FREE)

    starts, ends = a, b
    low, high, e = 0.0, math.inf, min(FIRST, most)
    while low < most and high > NEAR * low:
        left = unproven(a, b, e)
        if left.any():
            a, b, high = a[left], b[left], e
            if low == 0.0:
                return low
        else:
            low = e
        e = min(STEP * low, most) if high == math.inf else math.sqrt(low) * math.sqrt(high)
    # Motions that are proven for a larger error may be unproven for this error, since the intervals differ.
    while low > 0.0 and unproven(starts, ends, low).any():
        low = low / NEAR if low > FIRST else 0.0
    return low


def joint_error(
    self: Any, path: ArrayLike, *, weights: ArrayLike = 1.0, most: float = 0.1, tolerance: float = 1e-5
) -> float:
    """Compute, to within 2 %, the largest joint error within which a whole path is proven free.

    Parameters
    ----------
    path : array_like, shape (k, dof) or (dof,)
        Configurations, with motions between them as in `certify_edges`; a single configuration represents a robot at
        rest.
    weights : float or array_like, shape (dof,)
        Each value may deviate by the error times its weight. By default, all weights are 1, for radians and metres
        alike.
    most : float
        The largest error to try.
    tolerance : float
        Metres, as for `certify_edges`.

    Returns
    -------
    float
        An error e up to `most` for which `certify_edges` proves every motion with ``joint_error=e * weights``; 1.02 e
        is not proven, unless e is `most`. The result is 0.0 if not even 1e-6 is proven.

    Raises
    ------
    InputError
        If the path itself is not proven free (the message names the motion and the pair), if an argument has the wrong
        shape or value, or as for `certify_edges`.
    UnknownNameError
        As for `collide`.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> error = checker.joint_error([[0.0, 1.57], [0.5, 1.57]])
    >>> checker.certify_edges([0.0, 1.57], [0.5, 1.57], joint_error=error).verdict
    <Verdict.FREE: 0>
    """
    most, tolerance = _validate.positive_scalar(most, "most"), _validate.positive_scalar(tolerance, "tolerance")
    rows = self.robot.checked(path, "path")
    still = rows.shape[:-1] in ((), (1,))
    rows = edges.checked_path(self.robot, np.tile(rows, (2, 1)) if still else rows)
    shares = joint_errors(self.robot, weights, "weights")
    if not shares.any():
        raise InputError("weights: expected one or more above 0, found none")
    ready: Problem = self._ready()
    a, b = rows[:-1].copy(), rows[1:].copy()
    answers = prove_by_rules(ready, a, b, ProofOptions(tolerance))
    answers.expect_short(a, b)
    for k in np.flatnonzero(answers.verdicts != codes.FREE)[:1]:
        one, other = (ready.names[n] for n in ready.pairs[answers.pairs[k]])
        where = f" at the fraction {answers.fractions[k]:.6g} of the motion from row {k} to row {k + 1}"
        raise InputError(
            f"path: expected {'a configuration that is' if still else 'motions that are'} proven free, found {one} "
            f"and {other} {Verdict(int(answers.verdicts[k])).name}{'' if still else where}"
        )
    return largest(ready, a, b, shares, most, tolerance)
