"""Improved paths: cheaper with every round, proven like all others, and reproducible."""

import itertools
import math
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from gantry import IN_WALL, LEFT, RADIUS, RIGHT, UP, clearance, wall
from loewner import CollisionChecker, InputError, PlanningError, Scene, Verdict, planners
from loewner.planners import compiled, improving
from loewner.planners.clearing import Clearing
from loewner.planners.judge import Judge
from sampling import quick

# The shortest way of the ball about the end of the wall: tangents, arcs about both edges, and the wall's thickness.
REACH = math.hypot(0.45, 1.0)
TURN = math.pi / 2 - (math.atan2(0.45, 1.0) - math.asin(RADIUS / REACH))
SHORTEST = 2 * (math.sqrt(REACH**2 - RADIUS**2) + RADIUS * TURN) + 0.1


def proven(checker, path):
    return bool(np.all(checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE))


# -- laws ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_cost_never_rises_with_iterations(checker, seed):
    """More rounds never cost more; no round is the plan as it always was; every path is proven, by geometry as well."""
    found = [
        planners.plan(checker, LEFT, RIGHT, joints="slide", seed=seed, improve_iterations=n, full=True)
        for n in range(8)
    ]
    np.testing.assert_array_equal(found[0].path, planners.plan(checker, LEFT, RIGHT, joints="slide", seed=seed))
    assert all(more.cost <= less.cost for less, more in itertools.pairwise(found))
    assert [plan.iterations for plan in found] == list(range(8))
    for plan in found:
        np.testing.assert_array_equal(plan.path[[0, -1]], [LEFT, RIGHT])
        assert proven(checker, plan.path)
        assert clearance(plan.path) >= 0
        assert plan.bound <= SHORTEST <= plan.cost
        assert plan.gap == pytest.approx(plan.cost - 1)  # the straight way is 1 long


def test_many_rounds_come_near_the_shortest_path(checker):
    """The shortest path is known; improvement comes within a percent of it, and never below."""
    plan = planners.plan(checker, LEFT, RIGHT, joints="slide", improve_iterations=40, full=True)
    assert SHORTEST <= plan.cost < 1.01 * SHORTEST


def test_equal_seeds_and_iterations_give_equal_paths(checker, monkeypatch):
    """Rounds are reproducible, and the portions in which the clock is read do not matter."""
    options = {"seed": 3, "improve_iterations": 4}
    first = planners.plan(checker, LEFT, RIGHT, **options)
    np.testing.assert_array_equal(planners.plan(checker, LEFT, RIGHT, improve_for=1e6, **options), first)
    monkeypatch.setattr(compiled, "A_WHILE", 0.0)  # single iterations, at last
    np.testing.assert_array_equal(planners.plan(checker, LEFT, RIGHT, **options), first)


@pytest.mark.parametrize("scale", [0.25, 1024.0])
def test_costs_scale_with_weights(checker, scale):
    """Weights that are all larger by a power of two give the same path, and a cost larger by this power."""
    weights = np.array([1.0, 2.0, 0.5])
    one, other = (
        planners.plan(checker, LEFT, RIGHT, improve_iterations=5, weights=w, full=True)
        for w in (weights, scale * weights)
    )
    np.testing.assert_array_equal(one.path, other.path)
    assert other.cost == scale * one.cost
    assert other.bound == scale * one.bound
    ways = weights * np.diff(one.path, axis=0)
    assert one.cost == pytest.approx(np.linalg.norm(ways, axis=1).sum(), rel=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_joints_that_need_not_move_stay(checker, seed):
    """The rod need not turn for the ball to pass the wall, and with a large weight it does not."""
    free = planners.plan(checker, LEFT, RIGHT, seed=seed)
    path = planners.plan(checker, LEFT, RIGHT, seed=seed, improve_iterations=10, weights=[1.0, 1.0, 1e3])
    assert np.ptp(free[:, 2]) > 0.01
    assert np.ptp(path[:, 2]) == 0
    assert proven(checker, path)


def test_a_heavy_joint_turns_no_further_than_it_must(checker):
    """A joint that has to turn takes the shorter way around, and does not go back and forth."""
    goal = [*RIGHT[:2], UP + 2 * np.pi - 1.0]
    plan = planners.plan(checker, LEFT, goal, improve_iterations=20, weights=[1.0, 1.0, 1e3], full=True)
    assert plan.path[-1, 2] == pytest.approx(UP - 1.0)
    assert np.abs(np.diff(plan.path[:, 2])).sum() < 1.001
    assert plan.bound == pytest.approx(math.hypot(1.0, 1e3))
    assert plan.gap < 1e-3


def test_a_free_straight_motion_is_returned_at_once(checker):
    """Nothing is cheaper than the straight way, so no round is run."""
    goal = [-0.5, 0.5, UP]
    plan = planners.plan(checker, LEFT, goal, improve_for=1e6, full=True)
    np.testing.assert_array_equal(plan.path, [LEFT, goal])
    assert (plan.cost, plan.iterations) == (1.0, 0)
    assert plan.bound <= 1.0
    assert plan.gap < 1e-12
    still = planners.plan(checker, LEFT, LEFT, improve_iterations=5, full=True)
    assert (still.cost, still.bound, still.gap, still.iterations) == (0.0, 0.0, 0.0, 0)


def test_the_bound_counts_usable_goals_only(checker):
    """A goal in the wall is near but unusable; the bound is the distance of the nearest goal that is free."""
    plan = planners.plan(
        checker, LEFT, [RIGHT, IN_WALL, [0.5, 0.9, UP]], joints="slide", improve_iterations=9, full=True
    )
    assert plan.bound == pytest.approx(1.0)
    assert plan.path[-1, 1] == 0.9  # around the wall it is the nearer one
    assert proven(checker, plan.path)


# -- other judges -------------------------------------------------------------------------------


def test_motions_may_be_sampled(checker):
    """Sampled plans improve as well."""
    options = {"joints": "slide", "certified": False, "resolution": 0.01, "seed": 1, "full": True}
    plan, better = (planners.plan(checker, LEFT, RIGHT, improve_iterations=n, **options) for n in (0, 10))
    assert better.cost < plan.cost
    assert checker.valid_edges(better.path[:-1], better.path[1:], 0.01).all()


def test_joint_errors_are_kept(checker):
    """All motions of an improved path are proven within the joint error."""
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", joint_error=0.02, improve_iterations=10)
    assert np.all(checker.certify_edges(path[:-1], path[1:], joint_error=0.02).verdict == Verdict.FREE)
    assert clearance(path) >= 0.02


def test_contacts_at_the_ends_stay_as_they_are(robot):
    """Only the part of the path between the motions out of contact and into contact is improved."""
    scene = wall()
    scene.leave("ball", "wall")
    checker = CollisionChecker(robot, scene)
    start = np.array([-0.15 + 1e-4, -0.5, UP])
    plan = planners.plan(checker, start, RIGHT, joints="slide", improve_iterations=10, full=True)
    np.testing.assert_array_equal(plan.path[[0, -1]], [start, RIGHT])
    assert proven(checker, plan.path[1:])
    assert plan.bound == pytest.approx(RIGHT[0] - start[0])
    assert plan.cost >= plan.bound


# -- time ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("options", "most"), [({"improve_for": 20.5}, 21), ({"timeout": 9.5}, 10)])
def test_the_time_is_kept(checker, monkeypatch, options, most):
    """Improvement ends when the clock says so, in the middle of a round; its last round is dropped as a whole."""
    clock = itertools.count()
    monkeypatch.setattr(improving, "time", SimpleNamespace(monotonic=lambda: float(next(clock))))
    plan = planners.plan(checker, LEFT, RIGHT, improve_iterations=10**6, full=True, **options)
    assert next(clock) <= most + 4
    whole = planners.plan(checker, LEFT, RIGHT, improve_iterations=plan.iterations, full=True, timeout=1e6)
    assert plan.cost <= whole.cost


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer that interrupts")
def test_an_interrupt_ends_it(checker):
    """Ctrl+C ends the improvement, and later calls give the same result as before."""
    expected = planners.plan(checker, LEFT, RIGHT, improve_iterations=3)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for delay in (0.03, 0.07):
            with pytest.raises(KeyboardInterrupt):  # noqa: PT012  # the timer may go off at once
                signal.setitimer(signal.ITIMER_REAL, delay)
                planners.plan(checker, LEFT, RIGHT, improve_for=1e6)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    np.testing.assert_array_equal(planners.plan(checker, LEFT, RIGHT, improve_iterations=3), expected)


# -- clearance ----------------------------------------------------------------------------------


def least_distance(checker, path, count=200):
    """The least distance of the robot from the wall at samples of a path."""
    fractions = np.linspace(0, 1, count)[:, None]
    Q = np.concatenate([a + fractions * (b - a) for a, b in itertools.pairwise(path)])
    return checker.distance(Q, exact=True).distance.min()


@pytest.mark.parametrize("seed", quick(*range(3)))
def test_a_path_keeps_its_distance_where_it_can(checker, seed):
    """The shortest path grazes the wall; with a clearance it goes around at a distance, proven, for a little more."""
    given = {"joints": "slide", "seed": seed, "full": True}
    short = planners.plan(checker, LEFT, RIGHT, improve_iterations=20, **given)
    plan = planners.plan(checker, LEFT, RIGHT, improve_iterations=60, clearance=0.1, **given)
    np.testing.assert_array_equal(plan.path[[0, -1]], [LEFT, RIGHT])
    assert proven(checker, plan.path)
    assert least_distance(checker, short.path) < 0.01
    assert least_distance(checker, plan.path) > 0.05
    length = improving.cost_of(np.ones(3), plan.path)
    assert short.cost < length < 1.2 * short.cost
    assert plan.bound <= length <= plan.cost
    assert plan.clearance == pytest.approx(least_distance(checker, plan.path), abs=2e-3)
    assert short.clearance is None
    cost = Clearing.of(Judge.of(checker, 0.0), np.ones(3), 0.1).cost_of
    assert plan.cost == cost(plan.path) < 0.5 * cost(short.path)
    again = planners.plan(checker, LEFT, RIGHT, improve_iterations=60, clearance=0.1, **given)
    np.testing.assert_array_equal(again.path, plan.path)


def test_the_cost_near_a_wall_in_closed_form(checker):
    """Along the wall at half the clearance, a motion costs 1 + 9 / 4 times its length, and so does any division."""
    clearing = Clearing.of(Judge.of(checker, 0.0), np.array([1.0, 2.0, 1.0]), 0.2)
    x = -0.05 - RADIUS - 0.1  # the wall is 0.1 thick
    path = np.array([[x, 0.0, UP], [x, 0.2, UP], [x, 0.3, UP]])
    assert checker.distance(path, exact=True).distance == pytest.approx([0.1] * 3)
    assert clearing.cost_of(path) == pytest.approx(2.0 * 0.3 * (1 + 9 / 4))
    far = path - [1.0, 0.0, 0.0]
    assert clearing.cost_of(far) == pytest.approx(2.0 * 0.3)


def test_nothing_to_keep_away_from(robot):
    """Without a scene, and for a straight motion far from everything, a clearance changes nothing."""
    checker = CollisionChecker(robot, Scene())
    plan = planners.plan(checker, LEFT, RIGHT, improve_iterations=10, clearance=0.1, full=True)
    np.testing.assert_array_equal(plan.path, [LEFT, RIGHT])
    assert (plan.cost, plan.iterations, plan.clearance) == (1.0, 0, np.inf)
    assert "clearance inf m" in repr(plan)


@pytest.mark.parametrize("step", [1e-16, 3e-16, 1e-15, 1e-12])
def test_a_goal_that_is_almost_reached(checker, step):
    """A few last bits away and beside the wall, the path is the straight way, without a warning."""
    x = -0.05 - RADIUS - 0.01
    start, goal = np.array([x, -0.5, UP]), np.array([x, -0.5 + step, UP])
    plan = planners.plan(checker, start, goal, improve_iterations=20, clearance=0.1, full=True)
    np.testing.assert_array_equal(plan.path[[0, -1]], [start, goal])
    assert np.ptp(plan.path, axis=0).max() < 1e-6
    assert proven(checker, plan.path)


@pytest.mark.parametrize("wanted", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("count", quick(2, 5))
def test_never_worse_than_the_first_path(checker, wanted, count):
    """By the cost near obstacles, the result costs no more than the path that is not improved."""
    cost = Clearing.of(Judge.of(checker, 0.0), np.ones(3), wanted).cost_of
    for seed in range(count):
        first = planners.plan(checker, LEFT, RIGHT, seed=seed)
        for rounds in (1, 2, 5):
            plan = planners.plan(
                checker, LEFT, RIGHT, seed=seed, improve_iterations=rounds, clearance=wanted, full=True
            )
            assert plan.cost <= cost(first) * (1 + 1e-12)


def test_other_joints_stay_with_a_clearance(checker):
    """Joints that are not planned keep their values, and the time is over soon after it should be."""
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", improve_for=0.05, clearance=0.2)
    assert np.ptp(path[:, 2]) == 0
    assert proven(checker, path)


# -- results and bad input ----------------------------------------------------------------------


def test_a_plan_is_read_only_and_prints_itself(checker):
    """The full result holds the path that the call returns otherwise."""
    plan = planners.plan(checker, LEFT, RIGHT, full=True)
    assert isinstance(plan, planners.Plan)
    assert not plan.path.flags.writeable
    assert plan.seconds > 0
    assert repr(plan).startswith(f"Plan({len(plan.path)} configurations, cost ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"improve_for": -1.0}, "improve_for: expected a finite number >= 0"),
        ({"improve_for": np.nan}, "improve_for: expected"),
        ({"improve_iterations": -1}, "improve_iterations: expected an integer"),
        ({"improve_iterations": 1.5}, "improve_iterations: expected an integer"),
        ({"full": "yes"}, "full: expected"),
        ({"weights": [1, 1, 1]}, "weights: expected improve_for, improve_iterations or full=True"),
        ({"improve_for": 1, "weights": [1, 1]}, r"weights: expected shape \(3,\)"),
        ({"improve_for": 1, "weights": 1.0}, r"weights: expected shape \(3,\)"),
        ({"improve_for": 1, "weights": [1, 1, 0]}, "weights: expected numbers from 1e-09 to 1e\\+09, found 0 for turn"),
        ({"improve_for": 1, "weights": [1, -1, 1]}, "found -1 for y"),
        ({"improve_for": 1, "weights": [np.inf, 1, 1]}, "weights: "),
        ({"clearance": 0.1}, "clearance: expected improve_for or improve_iterations"),
        ({"improve_iterations": 0, "clearance": 0.1}, "clearance: expected improve_for or improve_iterations"),
        ({"improve_for": 1, "clearance": 0.0}, "clearance: expected a finite number > 0"),
        ({"improve_for": 1, "clearance": np.nan}, "clearance: expected"),
        ({"improve_for": 1, "clearance": 1e-10}, "clearance: expected at least 1e-09 m, found 1e-10"),
        ({"improve_for": 1, "planner": "RRTConnect"}, "planner: expected none with improve_for"),
    ],
)
def test_bad_options(checker, monkeypatch, options, message):
    """Every bad option is refused by its name."""
    monkeypatch.setattr("loewner.planners.searches.named", lambda name: name)
    with pytest.raises(InputError, match=message):
        planners.plan(checker, LEFT, RIGHT, **options)


def test_unknown_options_are_refused_as_python_does(checker):
    """A misspelt option is a TypeError that names it."""
    with pytest.raises(TypeError, match=r"plan\(\) got an unexpected keyword argument 'improve_four'"):
        planners.plan(checker, LEFT, RIGHT, improve_four=1)


def test_records_and_options_are_the_same(checker):
    """What two records say, the options say one by one; an option replaces the field of a record."""
    options = {"max_iterations": 900, "simplify": False, "improve_iterations": 4, "weights": [1.0, 1.0, 9.0]}
    search = planners.Search(max_iterations=900, simplify=False)
    improve = planners.Improve(iterations=4, weights=[1.0, 1.0, 9.0])
    ways = [
        planners.plan(checker, LEFT, RIGHT, seed=2, full=True, **options),
        planners.plan(checker, LEFT, RIGHT, seed=2, full=True, search=planners.Search(simplify=False), **options),
        planners.plan_full(checker, LEFT, RIGHT, improve, search=search, seed=2),
    ]
    assert len({plan.path.tobytes() for plan in ways}) == 1
    assert len({(plan.cost, plan.bound, plan.iterations) for plan in ways}) == 1
    with pytest.raises(PlanningError, match="within 1 iterations"):
        planners.plan(checker, LEFT, RIGHT, search=search, max_iterations=1)
    for given, message in (({"search": 5}, "search: expected planners.Search, found int"), ({"improve": 5}, "improve")):
        with pytest.raises(InputError, match=message):
            planners.plan_full(checker, LEFT, RIGHT, **given)


def test_no_path_is_an_error_as_before(robot):
    """Improvement does not begin without a path."""
    closed = CollisionChecker(robot, Scene())
    with pytest.raises(PlanningError, match="goal: "):
        planners.plan(closed, LEFT, [5.0, 0.0, UP], improve_for=1.0)
