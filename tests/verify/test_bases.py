"""A million samples of drives: each is within the deviation that the proof of its course covers, and none collides."""

import numpy as np
import pytest

from loewner import Verdict, planners
from loewner.planners import steering
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import form_of
from test_bases import base, long_arcs, off_goal, random_drive, random_poses, room

pytestmark = pytest.mark.verify


def test_samples_of_courses():
    """Of arcs with radii from 0 to metres and turns of up to 5 rad, in extended precision."""
    samples = 0
    for seed in range(40):
        drive = random_drive(300, seed)
        curve = form_of(drive, "drive")
        for fraction in np.random.default_rng(seed).uniform(0.0, 1.0, 48):
            polynomial = configurations(base(), curve.courses, np.full(len(curve.courses), fraction))
            gaps = np.abs(polynomial - long_arcs(drive, curve, fraction)).astype(float)
            assert (gaps <= curve.off).all()
            samples += len(gaps)
    assert samples > 1_000_000


def test_samples_of_plans():
    """A million configurations of 100 proven drives: all of them are free."""
    checker, rng = room(), np.random.default_rng(0)
    poses = rng.uniform([-2.5, -2.0, -4.0], [2.5, 2.0, 4.0], (2000, 3))
    poses = poses[~checker.collide(poses)]
    drives = 0
    for k in range(100):
        options = ({"base": "car", "radius": 0.6}, {"base": "differential"})[k % 2]
        try:
            drive = planners.plan(checker, poses[2 * k], poses[2 * k + 1], **options, timeout=60.0)
        except planners.planning.PlanningError:
            continue  # poses in corners that have no way out
        assert checker.certify_trajectory(drive).verdict == Verdict.FREE
        assert not checker.collide(drive.positions(rng.uniform(0, drive.times[-1], 10_000))).any()
        drives += 1
    assert drives >= 80


def test_many_ways():
    """Each of 44 words ends at the goal, and none is shorter than the shortest back."""
    a, b = random_poses(20_000), random_poses(20_000, 1)
    ways = steering.car(a, b, 1.0)
    ends = steering.driven(np.repeat(a[:, None], 44, axis=1), *ways)[..., -1, :]
    assert off_goal(ends, b[:, None])[np.isfinite(ways.costs)].max() < 1e-6
    assert np.abs(ways.costs.min(axis=1) - steering.car(b, a, 1.0).costs.min(axis=1)).max() < 1e-6
