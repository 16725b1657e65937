"""The compiled planner: paths whose every motion is proven free, or an error that says why there is none."""

import re
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from families import translation
from gantry import IN_WALL, LEFT, RADIUS, RIGHT, UP, clearance, gantry_robot, wall
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    Joint,
    PlanningError,
    Robot,
    Scene,
    UnknownNameError,
    Verdict,
    planners,
)
from loewner.planners import compiled
from loewner.robots.checking import verdicts
from sampling import examples

RESOLUTION = 0.02

FLOATING = """<robot name="f"><link name="world"/>
<link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="arm"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="fly" type="floating"><parent link="world"/><child link="ball"/></joint>
<joint name="bend" type="revolute"><parent link="ball"/><child link="arm"/><origin xyz="1 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>"""


# Two wheels on one value: the second turns half as far, so that only two turns bring both back.
GEARED = """<robot name="g"><link name="world"/>
<link name="wheel"><collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="slow"><collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="world"/><child link="wheel"/><axis xyz="0 0 1"/></joint>
<joint name="half" type="continuous"><parent link="world"/><child link="slow"/><origin xyz="0 0 1"/>
  <axis xyz="0 0 1"/><mimic joint="turn" multiplier="0.5"/></joint></robot>"""


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def proven(checker, path):
    return bool(np.all(checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE))


# -- paths --------------------------------------------------------------------------------------


@pytest.mark.parametrize("simplify", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_around_the_wall(checker, simplify, seed):
    """Paths start and end where they should, stay within the limits, and never touch the wall, by plane geometry."""
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", simplify=simplify, seed=seed)
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
    np.testing.assert_array_equal(path[:, 2], UP)
    assert (np.abs(path[:, :2]) <= 1).all()
    assert path[:, 1].max() > 0.5
    assert clearance(path) > 0
    assert proven(checker, path)


def test_motions_may_be_looked_at_instead(checker):
    """Between two configurations that are looked at the ball may cut the wall's corner by less than half a step."""
    for seed in range(20):
        path = planners.plan(
            checker, LEFT, RIGHT, joints="slide", certified=False, resolution=RESOLUTION, seed=seed
        )  # fmt: skip
        assert clearance(path) > -RESOLUTION / 2
        assert checker.valid_edges(path[:-1], path[1:], RESOLUTION).all()


def test_a_thin_wall_is_jumped_only_without_proof(robot):
    """A wall that steps of half a metre jump over stops every proven path."""
    scene = Scene()
    scene.add("wall", Body.box([0.001, 4.0, 1.0]))
    checker = CollisionChecker(robot, scene)
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", certified=False, resolution=0.3)
    assert not proven(checker, path)
    with pytest.raises(PlanningError, match="none within 2000 iterations"):
        planners.plan(checker, LEFT, RIGHT, joints="slide", max_iterations=2000)


def test_simplified_paths_are_shorter(checker):
    """Simplifying shortens a path, but never below the shortest way around the wall."""
    long, short = (planners.plan(checker, LEFT, RIGHT, joints="slide", simplify=s) for s in (False, True))
    assert length(short) < length(long)
    # The ball has to pass above the wall's end, at (0, 0.5 + RADIUS).
    assert 2 * np.hypot(0.5, 1.0 + RADIUS) - 0.11 <= length(short) < 2.7


def test_equal_seeds_give_equal_paths(checker):
    """One after the other with another between, and in two threads at once."""

    def ask(seed):
        return planners.plan(checker, LEFT, RIGHT, joints="slide", seed=seed)

    first, other, second = ask(5), ask(6), ask(5)
    np.testing.assert_array_equal(first, second)
    assert first.shape != other.shape or (first != other).any()
    with ThreadPoolExecutor(2) as pool:
        for path in pool.map(ask, [5] * 8):
            np.testing.assert_array_equal(path, first)


@pytest.mark.parametrize(("name", "value"), [("AT_A_TIME", 1), ("CAPACITY", 66)])
def test_portions_and_memory_do_not_decide(checker, monkeypatch, name, value):
    """A search that is looked after more often, or has to ask for more memory, finds the same."""
    whole = planners.plan(checker, LEFT, RIGHT, simplify=False, seed=3)
    assert len(whole) > 3
    monkeypatch.setattr(compiled, name, value)
    np.testing.assert_array_equal(planners.plan(checker, LEFT, RIGHT, simplify=False, seed=3), whole)


def test_trees_outgrow_their_memory(checker, monkeypatch):
    """Where there is no way, trees grow through several sizes, and come out as those that had room at once."""
    far = np.array([0.0, -0.5, UP]) + [0.9, 0.0, 0.0]
    closed = Scene()
    closed.add("wall", Body.box([0.1, 4.0, 1.0]))
    checker = CollisionChecker(checker.robot, closed)
    said = []
    for capacity in (2048, 66):
        monkeypatch.setattr(compiled, "CAPACITY", capacity)
        with pytest.raises(PlanningError) as found:
            planners.plan(checker, LEFT, far, max_iterations=3000)
        said.append(str(found.value))
    assert said[0] == said[1]


@given(st.integers(0, 2**31), st.integers(1, 5))
@examples(10, 25)
def test_no_path_of_a_random_world_collides(tmp_path_factory, seed, count):
    """Among boxes at random: a path has no configuration that collides, looked at in steps of a millimetre."""
    rng = np.random.default_rng(seed)
    scene = Scene()
    for k in range(count):
        scene.add(f"box {k}", Body.box(rng.uniform(0.01, 0.6, 3)), translation(*rng.uniform(-0.9, 0.9, 2)))
    checker = CollisionChecker(gantry_robot(tmp_path_factory.mktemp("g")), scene)
    Q = checker.robot.random_configurations(20, seed)
    Q = Q[~checker.collide(Q)]
    if len(Q) < 2:
        return
    try:
        path = planners.plan(checker, Q[0], Q[1:], seed=seed, max_iterations=5000)
    except PlanningError:
        return
    for a, b in zip(path[:-1], path[1:], strict=True):
        steps = int(np.linalg.norm(b - a) / 1e-3) + 2
        assert not checker.collide(checker.robot.between(a, b, np.linspace(0, 1, steps))).any()


# -- what moves ---------------------------------------------------------------------------------


def test_joints_without_limits_go_the_shorter_way_around(checker):
    """From 3 rad to -3 rad over half a turn; the path ends a turn from the goal's value."""
    start, goal = np.array([-0.5, -0.5, 3.0]), np.array([-0.5, -0.4, -3.0])
    path = planners.plan(checker, start, goal)
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_allclose(path[-1], goal + [0, 0, 2 * np.pi], rtol=0, atol=1e-15)
    assert length(path) < 0.4


def test_turns_add_up_along_a_path(checker):
    """Around the wall while the rod turns over half a turn: what comes out is proven as it stands."""
    start, goal = np.array([-0.5, -0.5, 3.0]), np.array([0.5, -0.5, -3.0 + 6 * np.pi])
    for seed in range(10):
        path = planners.plan(checker, start, goal, seed=seed)
        turns = (path[-1, 2] - goal[2]) / (2 * np.pi)
        assert abs(turns - round(turns)) < 1e-12
        np.testing.assert_array_equal(path[-1, :2], goal[:2])
        assert proven(checker, path)


def test_geared_wheels_do_not_wrap(tmp_path):
    """A joint that another follows at half its rate is elsewhere after a whole turn."""
    (tmp_path / "g.urdf").write_text(GEARED)
    checker = CollisionChecker(Robot.from_urdf(tmp_path / "g.urdf"))
    np.testing.assert_array_equal(planners.plan(checker, [3.0], [-3.0])[-1], [-3.0])


def test_names_of_joints_and_of_one_joint(checker):
    """Joints by name; what is not named keeps the start's value."""
    turned = np.array([-0.5, -0.5, 2.0])
    for joints in ("turn", ["turn"]):
        path = planners.plan(checker, LEFT, turned, joints=joints)
        np.testing.assert_array_equal(path[:, :2], LEFT[:2] + np.zeros((len(path), 2)))


def test_any_of_several_goals_will_do(checker):
    """Goals in the wall or outside the limits are passed over."""
    outside = np.array([1.5, 0.0, UP])
    path = planners.plan(checker, LEFT, [IN_WALL, outside, RIGHT], joints="slide")
    np.testing.assert_array_equal(path[-1], RIGHT)


def test_start_is_the_goal(checker):
    """From a configuration to itself the path stays there, and has two rows at least."""
    path = planners.plan(checker, LEFT, LEFT, joints="slide")
    np.testing.assert_array_equal(path, [LEFT] * len(path))
    assert len(path) >= 2


def test_what_is_attached_goes_along(robot):
    """A plate held ahead of the ball keeps the path from where the ball alone would fit."""
    scene = wall()
    scene.add("plate", Body.box([0.02, 0.02, 0.7]))
    scene.attach("plate", "ball", T_link_body=translation(y=-0.25), touch_links=["ball", "rod"])
    checker = CollisionChecker(robot, scene)
    path = planners.plan(checker, LEFT, RIGHT, joints="slide")
    # Its end, 0.26 m below the ball's centre, has to pass above the wall's.
    assert path[:, 1].max() > 0.5 + 0.26
    assert proven(checker, path)


# -- a scene that changes -----------------------------------------------------------------------


def posts(first, second):
    """Two walls across the straight way from (-0.9, -0.5) to (0.9, -0.5), each of which is there or far off."""
    scene = Scene()
    for name, x, there in (("first", -0.45, first), ("second", 0.45, second)):
        scene.add(name, Body.box([0.1, 0.6, 1.0]), translation(x, -0.5 if there else 9.0))
    return scene


def swapped(scene):
    """Take the first wall away and put the second one up, in one place after the other."""
    scene.move("first", translation(-0.45, 9.0))
    scene.move("second", translation(0.45, -0.5))


AROUND_FIRST = np.array([
    [-0.9, -0.5, UP], [-0.9, 0.2, UP], [0.0, 0.2, UP], [0.0, -0.5, UP], [0.9, -0.5, UP]])  # fmt: skip


@pytest.mark.parametrize("certified", [True, False])
def test_a_change_before_shortening_is_not_seen(robot, monkeypatch, certified):
    """A path around one wall is not cut through it, because it is gone by then, while it leads through a new one."""
    options = {"certified": certified, "resolution": RESOLUTION}
    as_it_was = CollisionChecker(robot, posts(True, False))
    expected = planners.shorten(as_it_was, AROUND_FIRST, **options)
    found = planners.plan(as_it_was, AROUND_FIRST[0], AROUND_FIRST[-1], joints="slide", seed=1, **options)
    shortened = compiled.shortened

    def late(*arguments, **keywords):
        swapped(scene)
        return shortened(*arguments, **keywords)

    monkeypatch.setattr(compiled, "shortened", late)
    scene = posts(True, False)
    np.testing.assert_array_equal(planners.shorten(CollisionChecker(robot, scene), AROUND_FIRST, **options), expected)
    scene = posts(True, False)
    path = planners.plan(
        CollisionChecker(robot, scene), AROUND_FIRST[0], AROUND_FIRST[-1], joints="slide", seed=1, **options
    )
    np.testing.assert_array_equal(path, found)


def test_of_thousands_of_goals_few_are_explained(checker, monkeypatch):
    """Pairs and depths are looked up for goals that the message names, and for none if one can be reached."""
    looked, contacts = [], verdicts.contacts
    monkeypatch.setattr(verdicts, "contacts", lambda ready, q: looked.append(q) or contacts(ready, q))
    goals = np.tile(IN_WALL, (1000, 1))
    with pytest.raises(PlanningError, match=r"goal\[4\]: a collision .*; and 995 more"):
        planners.plan(checker, LEFT, goals)
    assert len(looked) == 5
    planners.plan(checker, LEFT, [*goals, RIGHT])
    assert len(looked) == 5


def test_slow_motions_keep_the_timeout(robot):
    """Where each motion takes long the clock is looked at more often than between 512 of them."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    checker = CollisionChecker(robot, scene)
    with pytest.raises(PlanningError, match="within 0.1 s") as caught:
        planners.plan(checker, LEFT, RIGHT, certified=False, resolution=1e-5, timeout=0.1)
    assert int(re.search(r"\((\d+) iterations\)", str(caught.value))[1]) < 256  # of milliseconds each


# -- shortening ---------------------------------------------------------------------------------


def test_shortened_paths(checker):
    """Same ends, no longer, proven, reproducible; more cuts are no worse than few by much."""
    long = planners.plan(checker, LEFT, RIGHT, simplify=False, seed=4)
    few, many = (planners.shorten(checker, long, max_iterations=n) for n in (0, 300))
    for path in (few, many):
        np.testing.assert_array_equal(path[[0, -1]], long[[0, -1]])
        assert length(path) <= length(long)
        assert proven(checker, path)
    assert length(many) < length(few)
    np.testing.assert_array_equal(planners.shorten(checker, long, max_iterations=300), many)
    assert checker.valid_edges(*(lambda p: (p[:-1], p[1:]))(
        planners.shorten(checker, long, certified=False, resolution=RESOLUTION)), RESOLUTION).all()  # fmt: skip


def test_two_rows_stay(checker):
    """There is nothing to leave out; what comes back is a copy."""
    path = np.array([LEFT, LEFT + [0.1, 0.1, 0]])
    found = planners.shorten(checker, path)
    np.testing.assert_array_equal(found, path)
    found[0] = 0
    np.testing.assert_array_equal(path[0], LEFT)


def test_orientations_are_shortened_too(tmp_path):
    """A ball that flies on an arc with its arm, and quaternions of either sign."""
    (tmp_path / "f.urdf").write_text(FLOATING)
    robot = Robot.from_urdf(tmp_path / "f.urdf")
    scene = Scene()
    scene.add("post", Body.sphere(0.3))
    checker = CollisionChecker(robot, scene)
    angles = np.linspace(0, np.pi, 12)
    path = np.stack([robot.configuration() for _ in angles])
    path[:, 0], path[:, 1] = -3 * np.cos(angles), 3 * np.sin(angles)
    path[:, 3], path[:, 6] = np.cos(angles / 2), np.sin(angles / 2)
    path[::2, 3:7] *= -1
    short = planners.shorten(checker, path)
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])
    assert np.sum(robot.distances(short[:-1], short[1:])) < 0.9 * np.sum(robot.distances(path[:-1], path[1:]))
    assert proven(checker, short)


def test_a_path_that_collides_is_not_shortened(checker):
    """The message names the motion and the pair."""
    path = [LEFT, LEFT + [0.1, 0, 0], RIGHT, RIGHT + [0.1, 0, 0]]
    for certified in (True, False):
        with pytest.raises(PlanningError, match="path: .* from row 1 to row 2, on which (ball|rod) and wall collide"):
            planners.shorten(checker, path, certified=certified)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([LEFT], r"path: expected shape \(k, 3\) with k >= 2, found \(1, 3\)"),
        (LEFT, r"path: expected shape \(k, 3\) with k >= 2, found \(3,\)"),
        ([[0, 0], [1, 1]], r"path: expected shape \(\.\.\., 3\)"),
        ([LEFT, [np.nan, 0, 0]], r"path\[1\]: expected finite numbers, found nan for x"),
    ],
)
def test_bad_paths(checker, path, message):
    """What is no path is refused by its shape or value."""
    with pytest.raises(InputError, match=message):
        planners.shorten(checker, path)


# -- no path ------------------------------------------------------------------------------------


def test_colliding_start_and_goal_name_the_pairs(checker):
    """A start or goal in collision is refused with the pairs that meet, and a start with a way to allow it."""
    cure = r"deep\); if they may touch: scene.allow\('ball', 'wall'\), or allow in a scene file$"
    with pytest.raises(PlanningError, match=rf"start: .* of ball and wall \(30 mm deep\), rod and wall \(.* {cure}"):
        planners.plan(checker, [-0.12, -0.5, 0.0], RIGHT)
    with pytest.raises(PlanningError, match=r"goal: .* of ball and wall \(150 mm deep\), rod and wall \([^;]*$"):
        planners.plan(checker, LEFT, IN_WALL, joints="slide")
    with pytest.raises(PlanningError, match=r"goal: .* found none: goal\[0\]: .*wall.*; goal\[1\]: x = 2 outside -1"):
        planners.plan(checker, LEFT, [IN_WALL, [2, 0, UP]], joints="slide")


def test_margins_are_told_from_depths(robot):
    """A start that only comes too near says how near, and how to allow it if that is meant."""
    scene = Scene(margin=0.05)
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    start = [-0.17, -0.5, UP]
    cure = r"margin 50 mm; if they may touch: scene.allow\('ball', 'wall'\)"
    with pytest.raises(PlanningError, match=r"ball and wall \(within their margin, 20 mm apart\); " + cure):
        planners.plan(CollisionChecker(robot, scene), start, RIGHT)


def test_outside_the_limits(checker):
    """A start or goal outside the joint limits is refused with joint, value and limits."""
    with pytest.raises(PlanningError, match=r"start: .* x = -1\.5 outside -1 \.\. 1, y = 2 outside"):
        planners.plan(checker, [-1.5, 2.0, 0.0], RIGHT)
    with pytest.raises(PlanningError, match=r"goal: .* y = 7 outside -1 \.\. 1"):
        planners.plan(checker, LEFT, [0.5, 7.0, UP])


def test_values_off_by_rounding_are_told_apart(checker):
    """Numbers that look alike are said to differ, by how much, and what to do."""
    with pytest.raises(PlanningError, match=r"x = -1 outside -1 \.\. 1 \(by 1e-09: clip or copy it\)"):
        planners.plan(checker, [-1 - 1e-9, -0.5, UP], RIGHT)
    with pytest.raises(InputError, match=r"found 1\.5708 \(by 1e-09: clip or copy it\)"):
        planners.plan(checker, LEFT, RIGHT + [0, 0, 1e-9], joints="slide")


def test_limits_are_looked_at_before_all_else(checker):
    """To start and goal in degrees, what the joints that stay differ by is not to the point."""
    start, goal = np.degrees([0.1, 0.2, UP]), np.degrees([0.3, 0.2, -UP])
    with (
        pytest.warns(UserWarning, match="in millimetres|in degrees"),
        pytest.raises(PlanningError, match=r"start: .* x = 5\.7.* outside -1 \.\. 1"),
    ):
        planners.plan(checker, start, goal, joints="slide")
    with pytest.raises(PlanningError, match=r"goal: .* x = 17.* outside -1 \.\. 1"):
        planners.plan(checker, LEFT, goal, joints="slide")
    with pytest.raises(InputError, match="expected the start's value"):
        planners.plan(checker, LEFT, [0.5, -0.5, 0.0], joints="slide")


def test_no_path_says_how_far_the_search_came(robot):
    """Where the wall leaves no gap: iterations, motions, and how near the trees came to each other."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    checker = CollisionChecker(robot, scene)
    with pytest.raises(PlanningError, match=r"none within 1000 iterations: of \d+ motions tried.* came within 0\.3\d"):
        planners.plan(checker, LEFT, RIGHT, joints="slide", max_iterations=1000)
    with pytest.raises(
        PlanningError, match=r"\d+ motions between the trees, \d+ are COLLIDING, mostly since \w+ and wall"
    ):
        planners.plan(checker, LEFT, RIGHT, joints="slide", max_iterations=1000)
    # By default the search ends by time alone.
    with pytest.raises(PlanningError, match=r"none within 0\.3 s \(\d+ iterations\)"):
        planners.plan(checker, LEFT, RIGHT, joints=["x"], timeout=0.3)
    with pytest.raises(PlanningError, match=r"none within 0\.05 s \(\d+ iterations\)"):
        planners.plan(checker, LEFT, RIGHT, joints="slide", timeout=0.05, max_iterations=10**9)


def test_a_gap_too_narrow_to_prove_is_none(robot):
    """A slit wider than the ball by less than the tolerance: configurations in it are free, no path goes through."""
    scene = Scene()
    half = RADIUS + 2e-6
    for k, side in enumerate((-1, 1)):
        scene.add(f"half {k}", Body.box([0.1, 2.0, 1.0]), translation(y=side * (1.0 + half)))
    checker = CollisionChecker(robot, scene, allowed=[])
    inside = np.array([0.0, 0.0, 0.0])
    scene.allow("rod", "half 0")
    scene.allow("rod", "half 1")
    assert not checker.collide(inside)
    with pytest.raises(PlanningError, match="none within 300 iterations"):
        planners.plan(checker, LEFT, RIGHT, joints="slide", max_iterations=300)
    # A straight way between them is proven, unless rounding prevents it.
    for k, side in enumerate((-1, 1)):
        scene.move(f"half {k}", translation(y=side * (1.0 + RADIUS + 1e-12)))
    ends = np.array([LEFT, RIGHT]) * [1, 0, 1]
    with pytest.raises(
        PlanningError,
        match=r"motions between the trees, \d+ are AMBIGUOUS, mostly since ball and half \d come within 1e-05",
    ):
        planners.plan(checker, *ends, joints=["x"], max_iterations=300)


def test_what_cannot_be_settled_is_not_free(checker, undecided):
    """A start without a proof is refused, with the reason."""
    undecided(checker)
    with pytest.raises(PlanningError, match="start: .*cannot be proven free: .* could not be settled"):
        planners.plan(checker, LEFT, RIGHT)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer that interrupts")
def test_an_interrupt_leaves_nothing_broken(robot, checker):
    """Ctrl+C ends a search that would take hours, and the next one finds what it always does."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    endless = CollisionChecker(robot, scene)
    expected = planners.plan(checker, LEFT, RIGHT, seed=1)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for delay in (0.05, 0.11, 0.17):
            with pytest.raises(KeyboardInterrupt):  # noqa: PT012  # the timer may go off at once
                signal.setitimer(signal.ITIMER_REAL, delay)
                planners.plan(endless, LEFT, RIGHT, joints="slide", timeout=1e6, max_iterations=10**12)
            np.testing.assert_array_equal(planners.plan(checker, LEFT, RIGHT, seed=1), expected)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


# -- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"joints": "slid"}, UnknownNameError, "did you mean 'slide'"),
        ({"joints": ["x", "z"]}, UnknownNameError, "joints: expected one of x, y, turn; found 'z'"),
        ({"joints": []}, InputError, "joints: expected one or more, found none"),
        ({"joints": "nothing"}, InputError, "found none in group 'nothing'"),
        ({"joints": "y"}, InputError, r"goal: .*-0\.5, of x, .*found 0\.5"),
        ({"max_iterations": 0}, InputError, "max_iterations: expected an integer"),
        ({"certified": "yes"}, InputError, "certified: expected"),
        ({"certified": False, "resolution": 1e-9}, InputError, "resolution: expected at most 16777216 steps"),
        ({"timeout": 0}, InputError, "timeout: expected a finite number > 0"),
        ({"resolution": -1.0}, InputError, "resolution: expected a finite number > 0"),
        ({"seed": -1}, InputError, "seed: expected an integer"),
        ({"seed": 0.5}, InputError, "seed: expected an integer"),
    ],
)
def test_bad_options(checker, options, error, message):
    """Every bad option is refused by its name, with what was expected."""
    with pytest.raises(error, match=message):
        planners.plan(checker, LEFT, RIGHT, **options)


def test_bad_configurations(checker, robot):
    """Start and goals of wrong shapes, and what is no checker, are refused by name."""
    with pytest.raises(InputError, match=r"start: expected one configuration, shape \(3,\)"):
        planners.plan(checker, [LEFT], RIGHT)
    for named in ({"x": 0.7}, "home"):
        with pytest.raises(InputError, match=r"goal: expected numbers, found .*; robot\.configuration\(\.\.\.\) makes"):
            planners.plan(checker, LEFT, named)
    with pytest.raises(InputError, match=r"goal: expected shape \(\.\.\., 3\)"):
        planners.plan(checker, LEFT, RIGHT[:2])
    with pytest.raises(InputError, match=r"goal: expected shape \(3,\) or \(goals, 3\), found \(0, 3\)"):
        planners.plan(checker, LEFT, np.zeros((0, 3)))
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker, found Robot"):
        planners.plan(robot, LEFT, RIGHT)


def test_floating_joints_have_no_limits_to_search_within(tmp_path):
    """They can stand still, but not be planned over."""
    (tmp_path / "f.urdf").write_text(FLOATING)
    robot = Robot.from_urdf(tmp_path / "f.urdf")
    checker = CollisionChecker(robot)
    q, goal = robot.configuration(), robot.configuration({"bend": 0.5})
    with pytest.raises(InputError, match="found 'fly', which is planar or floating"):
        planners.plan(checker, q, goal)
    np.testing.assert_array_equal(planners.plan(checker, q, goal, joints="bend")[-1], goal)


@pytest.mark.parametrize("far", [1e154, 1e170, 1e200])
def test_differences_whose_squares_overflow_are_no_proof(far):
    """A straight motion through a wall is not taken for free because its length is not a number."""
    slide = Joint("x", "prismatic", "base", "cart", axis=[1, 0, 0], lower=-10 * far, upper=10 * far)
    robot = Robot.from_links({"base": None, "cart": Body.box([1, 1, 1])}, [slide])
    scene = Scene()
    scene.add("wall", Body.box([1, 1, 1]))
    with pytest.raises(PlanningError):
        planners.plan(CollisionChecker(robot, scene), [-far], [far], max_iterations=20)
