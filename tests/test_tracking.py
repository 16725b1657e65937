"""Paths that are proven for every configuration within a joint error, and the largest error that is proven."""

import re

import numpy as np
import pytest

from families import translation
from gantry import LEFT, RADIUS, RIGHT, UP, clearance, gantry_robot, wall
from loewner import Body, CollisionChecker, InputError, PlanningError, Robot, Scene, Verdict, planners
from loewner._kernels import codes
from loewner.robots.proofs import tracking
from loewner.robots.proofs.proofs import prove_by_rules
from loewner.robots.proofs.tracking import NEAR

# A ball that slides along x, and one at the end of an arm of 1 m that turns about z.
SLIDER = """<robot name="s"><link name="base"/>
<link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="ball"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1"/></joint></robot>"""
ARM = """<robot name="a"><link name="base"/>
<link name="ball"><collision><origin xyz="1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="ball"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1"/></joint></robot>"""
GAP = 0.01
SLIDE = np.array([1.0, 1.0, 0.0])  # the gantry's sliding joints


def proven(checker, path, error=0.0):
    return bool((checker.certify_edges(path[:-1], path[1:], joint_error=error).verdict == Verdict.FREE).all())


def within(rng, path, error, count=2000):
    """Configurations at random places of a path, off by the error in every value."""
    k, t = rng.integers(0, len(path) - 1, count), rng.random((count, 1))
    return path[k] + t * (path[k + 1] - path[k]) + error * rng.choice([-1.0, 1.0], (count, path.shape[1]))


# -- the largest error --------------------------------------------------------------------------


def test_one_sliding_joint_before_a_wall():
    """The ball ends GAP before the wall: the largest error is the gap, and with a weight the gap divided by it."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 2.0, 2.0]), translation(0.5 + 0.1 + GAP + 0.1))
    checker = CollisionChecker(Robot.from_urdf(text=SLIDER), scene)
    for weight, way in ((1.0, [-0.5, 0.5]), (4.0, [0.5, -0.5]), (0.5, [0.2, 0.5, 0.1])):
        found = checker.joint_error(np.array(way)[:, None], weights=weight)
        assert GAP / weight / NEAR - 2e-5 / weight <= found <= GAP / weight
    assert checker.joint_error([[0.0], [0.5]], most=GAP / 2) == GAP / 2
    assert 8e-5 / NEAR <= checker.joint_error([[-0.5], [0.5 + GAP - 1e-4]], most=1e9) <= 1e-4
    assert checker.joint_error([[-0.5], [0.5 + GAP - 5e-7]]) == 0.0


def test_the_error_is_proven_for_all_motions_at_once(monkeypatch):
    """A proof is not monotone in the error, since its intervals are other ones: motions are proven for the result."""
    checker = CollisionChecker(Robot.from_urdf(text=SLIDER), wall())
    path, asked = np.zeros((3, 1)), []

    def proven_up_to(ready, a, b, options):
        e = 0.0 if options.joint_error is None else float(options.joint_error[0])
        asked.append((len(a), e))
        # The first motion is proven up to 0.02, except within 1 % of the limit of the second one, which is 0.01.
        free = [e <= 0.02 and not 0.0099 < e <= 0.01, e <= 0.01]
        found = prove_by_rules(ready, a, b, options._replace(joint_error=None))
        found.verdicts[:] = np.where(free[-len(a) :], codes.FREE, codes.AMBIGUOUS)
        return found

    monkeypatch.setattr(tracking, "prove_by_rules", proven_up_to)
    found = checker.joint_error(path)
    assert 0.0099 / NEAR <= found <= 0.0099
    assert asked[-1] == (2, found)


def test_one_turning_joint_before_a_wall():
    """The ball ends GAP before a wall across its arc: the error is at most asin(GAP), at least GAP over the reach."""
    scene = Scene()
    scene.add("wall", Body.box([4.0, 0.2, 2.0]), translation(0.0, 0.1 + RADIUS + GAP))
    checker = CollisionChecker(Robot.from_urdf(text=ARM), scene)
    found = checker.joint_error([[-0.5], [0.0]])
    assert (GAP - 2e-5) / 1.1 / NEAR <= found <= np.arcsin(GAP)
    assert checker.collide([1.01 * np.arcsin(GAP)])


def test_the_largest_error_is_proven(checker, rng):
    """It is proven, half of it too, slightly more is not; no configuration within it collides, by plane geometry."""
    path = np.array([LEFT, [-0.3, 0.7, UP], [0.3, 0.68, UP], RIGHT])
    for weights in (np.ones(3), SLIDE, np.array([0.0, 1.0, 2.0])):
        found = checker.joint_error(path, weights=weights)
        assert 0 < found < 0.1
        assert proven(checker, path, found * weights)
        assert proven(checker, path, found * weights / 2)
        assert not proven(checker, path, NEAR * 1.001 * found * weights)
        assert not checker.collide(within(rng, path, found * weights)).any()
    # The ball may be off by e along x and by e along y, which brings it nearer by e at least.
    assert checker.joint_error(path, weights=SLIDE) <= clearance(path)


def test_paths_without_a_largest_error(checker):
    """A path that is not free is an error; so are arguments of the wrong shape or value."""
    with pytest.raises(InputError, match="found ball and wall COLLIDING at the fraction .* from row 1 to row 2"):
        checker.joint_error([LEFT - [0.1, 0, 0], LEFT, RIGHT])
    for bad, message in (
        ({"weights": [1.0, 1.0]}, "weights: expected one number >= 0 or 3"),
        ({"weights": -1.0}, "weights: expected one number >= 0"),
        ({"weights": 0.0}, "weights: expected one or more above 0"),
        ({"most": 0.0}, "most"),
        ({"tolerance": -1.0}, "tolerance"),
    ):
        with pytest.raises(InputError, match=message):
            checker.joint_error([LEFT, LEFT], **bad)
    for bad in ([[LEFT]], LEFT[:2], np.empty((0, 3)), [LEFT[:2]] * 2):
        with pytest.raises(InputError, match="path|expected"):
            checker.joint_error(bad)


def test_a_single_configuration(checker):
    """It counts as a path that stays there; one that collides is named without a motion."""
    near = np.array([-0.05 - RADIUS - GAP, -0.5, UP])
    found = checker.joint_error(near, weights=SLIDE)
    assert (GAP - 2e-5) / 2 / NEAR <= found <= GAP  # off by as much along both axes
    assert checker.joint_error([near], weights=SLIDE) == checker.joint_error([near, near], weights=SLIDE) == found
    with pytest.raises(InputError, match="path: expected a configuration that is .* and wall COLLIDING$"):
        checker.joint_error(near + [0.1, 0, 0])


def test_contact_by_a_rule_leaves_no_error():
    """A ball that may start in contact is proven without an error, and not with one; plans say so."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 2.0, 2.0]), translation(0.2))
    scene.leave("ball", "wall")
    checker = CollisionChecker(Robot.from_urdf(text=SLIDER), scene)
    assert proven(checker, np.array([[0.0], [-0.5]]))
    assert checker.joint_error([[0.0], [-0.5]]) == 0.0
    assert len(planners.plan(checker, [0.0], [-0.5])) >= 2
    with pytest.raises(PlanningError, match=r"start: .*ball and wall .*; with a joint error, contact .* not allowed"):
        planners.plan(checker, [0.0], [-0.5], joint_error=1e-4)
    with pytest.raises(PlanningError, match="ball and wall come within .* of their margin for deviating values"):
        planners.shorten(checker, [[-0.0005], [-0.5]], joint_error=1e-3)


# -- plans --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_plans_keep_the_error(checker, rng, seed):
    """Every motion is proven with the error, the ball keeps its distance, and no configuration within it collides."""
    for error in (0.02, np.array([0.03, 0.01, 0.002])):
        path = planners.plan(checker, LEFT, RIGHT, joints="slide", joint_error=error, seed=seed)
        np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
        assert proven(checker, path, error)
        assert not checker.collide(within(rng, path, error)).any()
        assert clearance(path) > np.broadcast_to(error, 3)[:2].min()
        assert checker.joint_error(path, weights=error, most=1.0) == 1.0
        cut = planners.shorten(checker, path, joint_error=error, seed=seed)
        assert proven(checker, cut, error)


def test_no_error_changes_nothing(checker):
    """A joint error of 0 gives the paths that plans without one give, to the last bit; a real one gives others."""
    for seed in range(3):
        for simplify in (False, True):
            plain, zero, real = (
                planners.plan(checker, LEFT, RIGHT, simplify=simplify, seed=seed, **given)
                for given in ({}, {"joint_error": np.zeros(3)}, {"joint_error": 0.02})
            )
            np.testing.assert_array_equal(plain, zero)
        assert plain.shape != real.shape or (plain != real).any()
        np.testing.assert_array_equal(
            planners.shorten(checker, plain, seed=seed), planners.shorten(checker, plain, joint_error=0.0, seed=seed)
        )


def test_a_gap_is_wide_enough_up_to_an_error(tmp_path):
    """The ball of 0.2 m goes through a gap of 0.3 m if it may be off by less than 0.05 m across, and not by more."""
    scene = Scene()
    for side in (-1, 1):
        scene.add(f"post {side}", Body.box([0.1, 2.0, 1.0]), translation(y=1.15 * side))
    checker = CollisionChecker(gantry_robot(tmp_path), scene)
    ends = [-0.8, 0.0, 0.0], [0.8, 0.0, 0.0]  # the rod ahead of the ball
    across = np.array([0.0, 1.0, 0.0])
    path = planners.plan(checker, *ends, joints="slide", joint_error=0.048 * across)
    assert proven(checker, path, 0.048 * across)
    with pytest.raises(PlanningError, match="none within 200 iterations"):
        planners.plan(checker, *ends, joints="slide", joint_error=0.052 * across, max_iterations=200)


def test_starts_and_goals_that_cannot_keep_it(checker):
    """The message states the largest error, which is proven, and the pair with its distance; other goals are used."""
    near = np.array([-0.05 - RADIUS - GAP, -0.5, UP])
    with pytest.raises(
        PlanningError, match=r"start: .* within joint errors of .*: ball and wall are 10 mm apart"
    ) as why:
        planners.plan(checker, near, RIGHT, joint_error=0.012)
    stated = float(re.search(r"joint errors of ([0-9.]+):", str(why.value))[1])
    assert 0.3 * GAP < stated < GAP
    assert proven(checker, np.array([near, near]), 0.99 * stated)
    planners.plan(checker, near, RIGHT, joint_error=stated)
    for other in (1.001 * stated * NEAR, 0.02, 0.5):  # the start alone determines the message
        with pytest.raises(PlanningError) as again:
            planners.plan(checker, near, RIGHT, joint_error=other)
        assert str(again.value) == str(why.value)
    with pytest.raises(PlanningError, match=r"goal: .* of 0\.\d+ times the given ones: ball and wall are 10 mm apart"):
        planners.plan(checker, LEFT, near, joint_error=0.02 * SLIDE)
    path = planners.plan(checker, LEFT, [near, RIGHT], joint_error=0.02 * SLIDE)
    np.testing.assert_array_equal(path[-1, :2], RIGHT[:2])


def test_errors_need_proofs(checker):
    """Samples cannot cover an error; shapes and signs are checked; a path that does not keep it names its motion."""
    for call in (planners.plan, planners.shorten):
        given = (LEFT, RIGHT) if call is planners.plan else (np.array([LEFT, LEFT]),)
        with pytest.raises(InputError, match="joint_error: expected certified=True"):
            call(checker, *given, certified=False, joint_error=1e-3)
        for bad in (-1e-3, [1e-3, 1e-3], np.nan, "wide"):
            with pytest.raises(InputError, match="joint_error"):
                call(checker, *given, joint_error=bad)
    beside = np.array([[-0.5, 0.9, UP], [0.0, 0.5 + RADIUS + GAP, UP], [0.5, 0.9, UP]])
    assert proven(checker, beside)
    with pytest.raises(PlanningError, match="from row 0 to row 1, on which ball and wall come within .* deviating"):
        planners.shorten(checker, beside, joint_error=2 * GAP)


def test_a_roadmap_keeps_an_error_too(checker):
    """Its motions are proven within the error when a path needs them; others without are not changed."""
    made = planners.roadmap(checker, 300, joints="slide", fixed=LEFT)
    plain = made.path(LEFT, RIGHT)
    path = made.path(LEFT, RIGHT, joint_error=0.03)
    assert proven(checker, path, 0.03)
    assert not proven(checker, plain, 0.03)
    np.testing.assert_array_equal(made.path(LEFT, RIGHT), plain)
    with pytest.raises(PlanningError, match="start: .* within joint errors of"):
        made.path([-0.16, -0.5, UP], RIGHT, joint_error=0.03)


def test_planners_of_ompl_keep_an_error_too(checker):
    """OMPL's motions, and the path as a whole, are proven within the error."""
    pytest.importorskip("ompl")
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", planner="RRTConnect", joint_error=0.02)
    assert proven(checker, path, 0.02)
