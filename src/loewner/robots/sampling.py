"""Find pairs of links that need not be checked, by sampling configurations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Pair
from loewner.errors import InputError
from loewner.robots.checker import CollisionChecker
from loewner.robots.description.robot import Robot


@guarded
def pairs_by_sampling(
    robot: Robot,
    samples: int = 10_000,
    seed: int = 0,
    *,
    known_free: ArrayLike | None = None,
    always: float = 0.95,
) -> dict[Pair, str]:
    """Find pairs of links that need not be checked, as MoveIt's setup assistant does, for robots without an SRDF.

    Parameters
    ----------
    robot : Robot
        Its `disabled_pairs` have no effect: these pairs are tested like all others.
    samples : int
        Number of random configurations within the limits; see `Robot.random_configurations`.
    seed : int
    known_free : array_like, shape (..., dof), optional
        Configurations at which the real robot is known to be free, for instance its current one. If a pair of links
        collides at such a configuration, the only reason is that the bodies are larger than the real links.
    always : float
        Fraction of the samples, above 0 and at most 1, at which two links have to collide to count as always colliding.

    Returns
    -------
    dict
        Maps sorted pairs of links to a reason: "adjacent" if a joint connects the links; "default" if they collide at
        `known_free`; "always" if they collide at the fraction `always` of the samples or more; "never" if they
        collide at no sample. Rigidly joined links are never checked and are not listed.

    Raises
    ------
    InputError
        If the robot has no collision geometry, or an argument has the wrong type or value.

    Notes
    -----
    "never" is not a proof: ten thousand samples are likely to miss a pair that meets in one configuration in a million.
    Pass all pairs, or only the pairs with certain reasons, to `Robot.disabling`.

    Examples
    --------
    >>> from loewner import pairs_by_sampling
    >>> pairs_by_sampling(Robot.from_urdf("arm.urdf"), 100)
    {('cart', 'forearm'): 'adjacent', ('cart', 'rail'): 'adjacent', ('forearm', 'rail'): 'never'}
    """
    samples = _validate.whole_number(samples, "samples", 1)
    if not 0 < _validate.positive_scalar(always, "always") <= 1:
        raise InputError(f"always: expected a share above 0 and up to 1, found {always:g}")
    _validate.instance(robot, "robot", Robot)
    checker = CollisionChecker(replace(robot, disabled_pairs=frozenset()), skip_adjacent=False)
    counts = checker.collide_by_pair(robot.random_configurations(samples, seed)).sum(axis=0)
    free_Q = robot.checked(np.empty((0, robot.dof)) if known_free is None else known_free, "known_free")
    overlapping = checker.collide_by_pair(free_Q).sum(axis=tuple(range(free_Q.ndim - 1))).tolist()
    reasons = {}
    for (a, b), count, overlaps in zip(checker.checked_pairs, counts.tolist(), overlapping, strict=True):
        pair = (min(a, b), max(a, b))
        if pair in robot.adjacent_pairs:
            reasons[pair] = "adjacent"
        elif overlaps:
            reasons[pair] = "default"
        elif count >= always * samples:
            reasons[pair] = "always"
        elif count == 0:
            reasons[pair] = "never"
    return dict(sorted(reasons.items()))
