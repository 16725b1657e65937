"""Several robots on paths that are given: they wait for each other, and never meet."""

import numpy as np
import pytest

from families import translation
from gantry import gantry_robot
from loewner import CollisionChecker, InputError, PlanningError, Robot, Scene, UnknownNameError, Verdict, planners
from motion_oracle import example


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two balls of radius 0.1 in one plane, each with a rod to its side."""
    one = gantry_robot(tmp_path_factory.mktemp("gantry"))
    return CollisionChecker(Robot.join({"a": one, "b": one}))


def follows(rows, path):
    """Whether every row is on a path, and none goes back."""
    place = []
    for row in rows:
        best = (np.inf, 0.0)
        for k, (a, b) in enumerate(zip(path[:-1], path[1:], strict=True)):
            way = b - a
            share = np.clip((row - a) @ way / max(way @ way, 1e-300), 0.0, 1.0)
            best = min(best, (float(np.abs(a + share * way - row).max()), k + share))
        assert best[0] < 1e-9
        place.append(best[1])
    return bool((np.diff(place) > -1e-9).all())


def test_two_robots_cross_one_after_the_other(two):
    """Both would be at the origin at the same time; either one waits."""
    up = np.pi / 2
    a = np.array([[-0.8, 0.0, np.pi], [0.8, 0.0, np.pi]])
    b = np.array([[0.0, -0.8, -up], [0.0, 0.8, -up]])
    straight = np.concatenate([a, b], axis=1)
    assert two.certify_edges(*straight).verdict == Verdict.COLLIDING
    path = planners.coordinate(two, {"a": a, "b": b})
    assert (two.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    assert follows(path[:, :3], a)
    assert follows(path[:, 3:], b)
    np.testing.assert_array_equal(path[[0, -1]], straight)
    took = np.abs(np.diff(path, axis=0)).max(axis=1).sum()
    assert 1.6 < took < 2.4  # one waits until the other has gone by, and no longer


def test_paths_that_do_not_meet_take_one_motion(two):
    """Where nobody has to wait, the path is the two straight motions at once."""
    a = np.array([[-0.8, -0.8, 0.0], [0.8, -0.8, 0.0]])
    b = np.array([[-0.8, 0.8, 0.0], [0.8, 0.8, 0.0]])
    np.testing.assert_array_equal(planners.coordinate(two, {"a": a, "b": b}), np.concatenate([a, b], axis=1))
    waits = planners.coordinate(two, {"a": a, "b": b[0]})
    np.testing.assert_array_equal(waits, np.concatenate([a, b[[0, 0]]], axis=1))


def test_robots_that_block_each_other_are_an_error(two):
    """Head on, no waiting helps; the message names the two bodies."""
    a = np.array([[-0.8, 0.0, np.pi], [0.8, 0.0, np.pi]])
    b = np.array([[0.8, 0.0, 0.0], [-0.8, 0.0, 0.0]])
    with pytest.raises(PlanningError, match=r"beyond .*%, .*% of the paths: there [ab]/ball and [ab]/ball meet"):
        planners.coordinate(two, {"a": a, "b": b})


def test_bad_paths_are_refused(two):
    """Each with what was expected."""
    a = np.array([[-0.8, 0.0, np.pi], [0.8, 0.0, np.pi]])
    for paths, message in (
        ({"a": a}, "one for each part, found none for b"),
        ({}, "mapping from names"),
        ([a, a], "mapping from names"),
        ({"a": a[:, :2], "b": a}, "path of 'a'"),
        ({"a": a[0], "b": a[0]}, "a robot that moves"),
        ({"a": a * np.nan, "b": a}, "path of 'a'"),
    ):
        with pytest.raises(InputError, match=message):
            planners.coordinate(two, paths)
    with pytest.raises(UnknownNameError):
        planners.coordinate(two, {"a": a, "c": a})
    for steps in (2000, 10**9):
        with pytest.raises(InputError, match="at most 1048576 states"):
            planners.coordinate(two, {"a": a, "b": a + 0.1}, steps=steps)
    with pytest.raises(InputError, match="steps"):
        planners.coordinate(two, {"a": a, "b": a + 0.1}, steps=0)


def test_two_arms_swap_places():
    """Two Pandas that stand opposite each other, on paths that each has planned for itself."""
    panda = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    facing = translation(x=0.8)
    facing[:2, :2] = [[-1, 0], [0, -1]]
    both = CollisionChecker(Robot.join({"left": panda, "right": panda}, {"right": facing}), Scene())
    alone, solved, met = CollisionChecker(panda), 0, 0
    rng = np.random.default_rng(3)
    while solved < 4:
        Q = panda.random_configurations(60, seed=int(rng.integers(1 << 30)))
        Q = Q[~alone.collide(Q)][:4]
        paths = {"left": planners.plan(alone, Q[0], Q[1]), "right": planners.plan(alone, Q[2], Q[3])}
        try:
            path = planners.coordinate(both, paths)
        except PlanningError:
            met += 1
            assert met < 20
            continue
        assert (both.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
        for name, way in paths.items():
            assert follows(path[:, both.robot.part(name).columns], way)
        solved += 1
