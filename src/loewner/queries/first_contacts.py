"""Compute when two bodies that move and turn first touch, with a proof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._threads import in_shares
from loewner._base._validate import FloatOrFloats, Floats
from loewner._base._workspaces import workspace
from loewner._native import entries
from loewner.bodies import Bodies, Body, packed_of
from loewner.errors import PoseError
from loewner.queries.pairs import VerdictOrVerdicts, expect_bodies, plan_of

# The smallest number of pairs that is worth a thread of its own.
CHUNK = 512

BYTES = 17  # per pair: two times and a verdict

# The two poses at the beginning and at the end of a motion; or one pose, for a body at rest.
Motion = tuple[ArrayLike | None, ArrayLike | None] | ArrayLike | None


@dataclass(frozen=True, eq=False, repr=False)
class FirstContact(_validate.Brief):
    """When two moving bodies first touch.

    Each field has the batch's shape. Times are fractions of the motion.

    Attributes
    ----------
    verdict : Verdict, or ndarray of int8
        FREE: it is proven that the bodies neither touch nor come within the margin at any time from 0 to 1. COLLIDING:
        the bodies touch at `touching_at` according to the exact test of `collide`; for pieces with curved faces, this
        holds up to about 1e-9 m. AMBIGUOUS: the bodies graze each other, or the search did not converge; only
        `free_until` is proven.
    free_until : float or ndarray
        At every real time t with 0 <= t < free_until, the bodies are proven to be farther apart than the margin; inf if
        FREE.
    touching_at : float or ndarray
        COLLIDING: the time at which the bodies touch or come within the margin; from `free_until` to this time, the
        distance of the bodies changes by no more than the tolerance. AMBIGUOUS: a time, not before `free_until`, at
        which the bodies touch or are within the tolerance of touching; inf if no such time is known. FREE: inf.

    Examples
    --------
    >>> from loewner import Body, first_contact
    >>> T = np.eye(4)
    >>> T[0, 3] = 5.0
    >>> first_contact(Body.sphere(1.0), (None, T), Body.sphere(1.0), T).verdict
    <Verdict.COLLIDING: 1>
    """

    verdict: VerdictOrVerdicts
    free_until: FloatOrFloats
    touching_at: FloatOrFloats


@guarded
def first_contact(
    a: Body | Bodies,
    motion_a: Motion,
    b: Body | Bodies,
    motion_b: Motion,
    *,
    tolerance: float = 1e-6,
    margin: float = 0.0,
) -> FirstContact:
    """Compute when two moving and turning bodies first touch, and prove that they do not touch earlier.

    The origin of a body moves along a straight line between its two poses, at a constant speed. At the same time, the
    body turns the shorter way, also at a constant rate, about an axis through its origin.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of length n broadcasts with the last batch axis of the poses.
    motion_a, motion_b : tuple of two array_like, shape (..., 4, 4), or array_like, or None
        The poses (T0, T1) of a body at the beginning and at the end of its motion, broadcast together; or a single
        pose, for a body at rest. None is the identity.
    tolerance : float
        Distance in metres by which the bodies may approach each other between `free_until` and `touching_at`. Choose at
        least about 1e-11 times the lengths involved, or 1e-8 times these lengths for ellipsoids, cylinders and cones;
        with a smaller tolerance, pairs are AMBIGUOUS.
    margin : float
        Distance in metres that the bodies have to keep.

    Returns
    -------
    FirstContact
        It is proven, including all rounding, that the pair is free before `free_until` (docs/certified.md, "First
        contact"). If the bodies touch at the beginning, both times are 0.

    Raises
    ------
    PoseError
        If a pose does not have the shape (..., 4, 4) or is not a rigid motion; if batches do not broadcast; or if a
        body makes half a turn, for which neither direction is shorter (divide such a motion into two).
    InputError
        If an operand is not a body, the margin is negative or not finite, or the tolerance is not positive.

    Notes
    -----
    A pair of convex pieces takes a handful of searches, because the steps towards the contact converge quadratically.
    For surfaces, the steps converge linearly, and a pair takes dozens of distance computations.

    References
    ----------
    Mirtich (1996), conservative advancement; Zhang, Lee and Kim (2006), doi:10.1145/1128888.1128908.
    docs/certified.md derives the bound for a step between two planes.

    Examples
    --------
    A ball drops onto a plate from a height of 2 m:

    >>> from loewner import Body, first_contact
    >>> start, end = np.eye(4), np.eye(4)
    >>> start[2, 3] = 2.0
    >>> found = first_contact(Body.sphere(0.5), (start, end), Body.box([2, 2, 0.2]), None)
    >>> round(found.free_until, 6), found.touching_at - found.free_until < 1e-6
    (0.7, True)
    """
    within = _validate.positive_scalar(tolerance, "tolerance")
    keep = _validate.positive_scalar(margin, "margin", zero=True)
    expect_bodies(a, b)
    Ta, Tb = _ends(motion_a, "motion_a"), _ends(motion_b, "motion_b")
    plan = plan_of(a, Ta[0].shape, b, Tb[0].shape, each=BYTES)
    pack_a, pack_b = packed_of(a), packed_of(b)
    (Ta0, Ta1), (Tb0, Tb1) = ([T.reshape(-1, 4, 4) for T in pair] for pair in (Ta, Tb))
    times, verdicts = np.empty((2, plan.total)), np.empty(plan.total, dtype=np.int8)

    def run(first: int, last: int) -> None:
        memory = workspace(entries.memory_of_first_contacts())
        fault, _ = entries.first_contacts(
            first, last, plan.steps, pack_a.handle, Ta0, Ta1, pack_b.handle, Tb0, Tb1, keep, within, memory,
            times, verdicts,
        )  # fmt: skip
        if fault >= 0:
            raise PoseError(
                f"motion_{'ab'[fault % 2]}: expected turns of less than half a turn, found one of half a turn in pair "
                f"{fault // 2}, which could go either way; divide the motion into two"
            )

    in_shares(run, plan.total, CHUNK)
    return FirstContact(plan.verdicts(verdicts), *map(plan.shaped, times))


def _ends(motion: Any, name: str) -> tuple[Floats, Floats]:
    """Check the poses at both ends of a motion, and broadcast them."""
    if isinstance(motion, list) and len(motion) == 2:
        raise PoseError(f"{name}: expected a tuple (T0, T1), one pose or None, found a list of two")
    if isinstance(motion, tuple) and len(motion) != 2 and any(np.ndim(T) == 2 for T in motion):
        raise PoseError(f"{name}: expected a tuple (T0, T1), one pose or None, found a tuple of {len(motion)} poses")
    if not isinstance(motion, tuple) or len(motion) != 2:
        T = _validate.poses(motion, name)
        return T, T
    first, last = (_validate.poses(T, f"{name}[{end}]") for end, T in enumerate(motion))
    if first.shape != last.shape:
        shape = _validate.broadcast({f"{name}[0]": first.shape[:-2], f"{name}[1]": last.shape[:-2]}, PoseError)
        first, last = (np.broadcast_to(T, (*shape, 4, 4)).copy() for T in (first, last))
    return first, last
