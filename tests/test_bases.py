"""Mobile bases: ways of cars are shortest ways, courses hold the arcs, and drives are proven free as driven."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loewner import Body, CollisionChecker, InputError, LoewnerError, PlanningError, Robot, Scene, Verdict, planners
from loewner.planners import steering
from loewner.planners.drives import base_columns
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import form_of

BOX = [[0.4, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.4, -0.2]]
BOUNDS = [[-2.5, 2.5], [-2.0, 2.0]]
WORDS = ("LRL", "LSL", "LSR", "LRLR", "LRSL", "LRSR", "LSRL", "RSRL", "LRSLR")  # and their mirror images
PLANAR = """<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='planar'><parent link='a'/>
<child link='b'/><axis xyz='0 0 1'/></joint></robot>"""


def at(x, y):
    T = np.eye(4)
    T[:2, 3] = x, y
    return T


def base(bounds=BOUNDS):
    return Robot.footprint(BOX, height=0.5, bounds=bounds)


def room():
    """Two walls in a room of 5 m x 4 m, with a gap of 1 m on alternate sides."""
    scene = Scene()
    scene.add("one", Body.box([0.1, 3.0, 1.0]), at(-0.8, -0.5))
    scene.add("other", Body.box([0.1, 3.0, 1.0]), at(0.8, 0.5))
    return CollisionChecker(base(), scene)


def random_poses(n, seed=0):
    return np.random.default_rng(seed).uniform([-4, -4, -7], [4, 4, 7], (n, 3))


def off_goal(ends, goals):
    """Distances in position and heading."""
    gaps = np.abs(ends - goals)
    gaps[..., 2] = np.abs(np.remainder((ends - goals)[..., 2] + np.pi, 2 * np.pi) - np.pi)
    return gaps.max(axis=-1)


def shortest(a, b, radius, reverse=True):
    return steering.car(a, b, radius, reverse).costs.min(axis=1)


# -- ways ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["Reeds-Shepp", "Dubins", "differential", "forwards"])
def test_ways_end_at_the_goal(kind):
    """Each way that exists ends at the goal, and forward ones have no length below 0."""
    a, b = random_poses(300), random_poses(300, 1)
    ways = {
        "Reeds-Shepp": lambda: steering.car(a, b, 0.7),
        "Dubins": lambda: steering.car(a, b, 0.7, False),
        "differential": lambda: steering.differential(a, b),
        "forwards": lambda: steering.differential(a, b, False),
    }[kind]()
    exist = np.isfinite(ways.costs)
    assert exist.any(axis=1).all()
    ends = steering.driven(np.repeat(a[:, None], exist.shape[1], axis=1), *ways)[..., -1, :]
    assert off_goal(ends, b[:, None])[exist].max() < 1e-9
    if kind in ("Dubins", "forwards"):
        assert ways.lengths[exist].min() >= 0.0
    if kind in ("Reeds-Shepp", "Dubins"):
        turned, length = np.abs(ways.turns[exist]), np.abs(ways.lengths[exist])
        assert (np.abs(turned - length / 0.7) < 1e-12)[turned > 0].all()


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(WORDS), st.booleans(),
    st.lists(st.floats(-3.2, 3.2, allow_subnormal=False), min_size=5, max_size=5), st.floats(-7, 7),
)  # fmt: skip
def test_no_drive_of_a_word_is_shorter(word, mirrored, lengths, heading):
    """Whatever is driven on arcs of the radius and lines, the shortest way to where it ends is no longer."""
    lengths = np.array(lengths[: len(word)])
    turns = lengths * ["RSL".index(letter) - 1.0 for letter in word] * (-1.0 if mirrored else 1.0)
    start = np.array([0.5, -0.25, heading])
    goal = steering.driven(start, lengths, turns)[-1]
    assert shortest(start[None], goal[None], 1.0)[0] <= np.abs(lengths).sum() + 1e-7
    ahead = np.abs(lengths[:3]) + 0.01  # shorter arcs may become whole circles by rounding
    forward = steering.driven(start, ahead, np.copysign(ahead, turns[:3] * lengths[:3]) * (turns[:3] != 0.0))[-1]
    assert shortest(start[None], forward[None], 1.0, False)[0] <= ahead.sum() + 1e-7 or word not in WORDS[:3]


def test_lengths_are_a_distance():
    """As long back as forth, and no longer than by way of a third pose; Dubins's are no shorter."""
    a, b, c = (random_poses(400, seed) for seed in range(3))
    there = shortest(a, b, 1.3)
    assert np.abs(there - shortest(b, a, 1.3)).max() < 1e-9
    assert (there <= shortest(a, c, 1.3) + shortest(c, b, 1.3) + 1e-9).all()
    assert (there <= shortest(a, b, 1.3, False) + 1e-9).all()
    assert (there >= np.linalg.norm((b - a)[:, :2], axis=1) - 1e-9).all()


def test_ways_turn_by_half_a_turn_at_most():
    """No motion of any way turns farther, except for those of cars that may not reverse."""
    a, b = random_poses(1000), random_poses(1000, 1)
    for ways in (steering.car(a, b, 1.0), steering.differential(a, b), steering.differential(a, b, False)):
        assert np.nanmax(np.abs(ways.turns)) <= math.pi


def test_farther_turns_are_shortest_ways():
    """Where nothing stands, a car that may not reverse turns by more than half a turn only if its shortest way does."""
    checker, poses = CollisionChecker(base([[-9, 9], [-9, 9]]), Scene()), random_poses(16, 3)
    farthest = 0.0
    for a, b in zip(poses[:8], poses[8:], strict=True):
        drive = planners.plan(checker, a, b, base="car", radius=1.0, reverse=False)
        assert drive.length <= shortest(a[None], b[None], 1.0, False)[0] + 1e-9
        farthest = max(farthest, np.abs(drive.motions[:, 1]).max())
    assert farthest > math.pi


@pytest.mark.parametrize("space", ["ReedsSheppStateSpace", "DubinsStateSpace"])
def test_lengths_agree_with_ompl(space):
    """The lengths are those of another program."""
    bases = pytest.importorskip("ompl.base")
    theirs, a, b = getattr(bases, space)(0.8), random_poses(200), random_poses(200, 1)
    bounds = bases.RealVectorBounds(2)
    bounds.setLow(-10)
    bounds.setHigh(10)
    theirs.setBounds(bounds)

    def state(pose):
        made = theirs.allocState()
        made.setX(pose[0])
        made.setY(pose[1])
        made.setYaw(math.remainder(pose[2], 2 * math.pi))
        return made

    lengths = [theirs.distance(state(p), state(q)) for p, q in zip(a, b, strict=True)]
    assert np.abs(shortest(a, b, 0.8, space == "ReedsSheppStateSpace") - lengths).max() < 1e-9


# -- courses ------------------------------------------------------------------------------------


def long_arcs(drive, curve, fraction):
    """Poses on the arcs in extended precision, at a fraction of each course."""
    count = np.round(np.interp(curve.times, drive.times, np.arange(len(drive.times))) * 1e6) / 1e6
    k = np.floor(count[:-1] + 1e-9).astype(int)
    steps = np.bincount(k)
    place = np.arange(len(k)) - np.repeat(np.cumsum(steps) - steps, steps)
    share = (place + np.longdouble(fraction)) / steps[k]
    length, turn = (drive.motions[k, n].astype(np.longdouble) * share for n in (0, 1))
    x, y, heading = drive.path[k].T.astype(np.longdouble)
    half = turn / 2
    chord = length * np.where(half == 0, 1, np.sin(half) / np.where(half == 0, 1, half))
    return np.stack([x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + turn], axis=1)


def random_drive(n, seed=0):
    rng = np.random.default_rng(seed)
    motions = np.stack([rng.uniform(-6, 6, n), rng.uniform(-5, 5, n)], axis=1)
    motions[::5, 1], motions[1::5, 0] = 0.0, 0.0
    return planners.Drive.of(base(), [1.0, -2.0, 3.0], motions)


def test_courses_hold_the_arcs():
    """Every point of an arc deviates from its course by less than what the proof covers, which is 1e-6 m at most."""
    drive = random_drive(200)
    curve = form_of(drive, "drive")
    assert curve.off[:, :2].max() <= 1e-6 + 1e-9
    nearest = np.zeros(len(curve.courses))
    for fraction in np.linspace(0.0, 1.0, 17):
        polynomial = configurations(base(), curve.courses, np.full(len(curve.courses), fraction))
        gaps = np.abs(polynomial - long_arcs(drive, curve, fraction)).astype(float)
        assert (gaps <= curve.off).all()
        nearest = np.maximum(nearest, gaps[:, :2].max(axis=1) / curve.off[:, 0])
    assert nearest.max() > 0.5  # the bound is not a loose one


def test_positions_are_on_the_arcs():
    """A quarter of a circle, a turn in place and a line, as geometry has them."""
    drive = planners.Drive.of(base(), [0, 0, 0], [[math.pi / 2, math.pi / 2], [0, -math.pi / 2], [-1.0, 0]])
    assert np.allclose(drive.path, [[0, 0, 0], [1, 1, math.pi / 2], [1, 1, 0], [0, 1, 0]], atol=1e-12)
    half = drive.positions(math.pi / 4)
    assert np.allclose(half, [math.sin(math.pi / 4), 1 - math.cos(math.pi / 4), math.pi / 4])
    assert (drive.positions(drive.times) == drive.path).all()
    assert (drive.length, drive.turn, drive.reversals) == (math.pi / 2 + 1, math.pi, 1)


def test_an_arc_that_grazes_is_judged_as_an_arc():
    """A post on the chord of an arc is no obstacle, and one on the arc is, though both ends are free."""
    motion = [[math.pi, math.pi]]  # half a circle of radius 1 from (0, -1) to (0, 1)
    for place, verdict in (((0.0, 0.0), Verdict.FREE), ((1.0, 0.0), Verdict.COLLIDING)):
        scene = Scene()
        scene.add("post", Body.box([0.1, 0.1, 1.0]), at(*place))
        checker = CollisionChecker(base(), scene)
        drive = planners.Drive.of(base(), [0.0, -1.0, 0.0], motion)
        assert checker.certify_trajectory(drive).verdict == verdict


# -- plans --------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [
    {"base": "car", "radius": 0.6}, {"base": "car", "radius": 0.6, "reverse": False}, {"base": "differential"},
    {"base": "differential", "reverse": False, "simplify": False},
])  # fmt: skip
def test_a_drive_is_what_its_base_can_drive(options):
    """Proven, within the radius, from the start to the goal, and without motions backwards if there may be none."""
    checker = room()
    start, goal = [-1.7, -1.0, 1.0], [1.7, 0.5, -1.5]
    drive = planners.plan(checker, start, goal, **options)
    assert (drive.path[0] == start).all()
    assert off_goal(drive.path[-1], np.array(goal)) < 1e-12
    assert checker.certify_trajectory(drive).verdict == Verdict.FREE
    assert not checker.collide(drive.positions(np.linspace(0, drive.times[-1], 2000))).any()
    ends = steering.moved(drive.path[:-1], *drive.motions.T)
    assert np.abs(ends - drive.path[1:]).max() < 1e-9
    if options["base"] == "car":
        assert (np.abs(drive.motions[:, 0]) >= 0.6 * np.abs(drive.motions[:, 1]) - 1e-9).all()
    if not options.get("reverse", True):
        assert drive.motions[:, 0].min() >= 0.0
    again = planners.plan(checker, start, goal, **options, seed=7)
    assert (again.path == drive.path).all()
    assert (again.motions == drive.motions).all()


def test_a_proof_is_written_and_verified():
    """Another program verifies it, and it is about the courses of the drive."""
    checker = room()
    drive = planners.plan(checker, [-1.7, -1.0, 1.0], [-1.7, 1.0, 1.0], base="car", radius=0.6, proof=True)
    drive.proof.verify()
    assert drive.proof.differences(checker) == []
    assert len(drive.proof.motions) == len(form_of(drive, "drive").courses)


def test_a_joint_error_is_kept():
    """The drive is proven for all deviations up to the error."""
    checker, error = room(), [0.05, 0.05, 0.02]
    drive = planners.plan(checker, [-1.7, -1.0, 1.0], [1.7, 0.5, -1.5], base="differential", joint_error=error)
    assert checker.certify_trajectory(drive, joint_error=error).verdict == Verdict.FREE


def test_an_arm_keeps_its_joints():
    """The base of a robot moves, and its arm stays; a goal that moves the arm is refused."""
    arm = Robot.from_links(
        {"cart": Body.box([0.6, 0.4, 0.2]), "boom": Body.box([0.5, 0.1, 0.1])},
        [planners_joint()],
    ).add_base("planar", BOUNDS, name="b")
    assert base_columns(arm) == (0, 1, 2)
    checker = CollisionChecker(arm, Scene())
    drive = planners.plan(checker, [-1, 0, 0, 0.5], [1, 0.5, 3, 0.5], base="car", radius=0.5)
    assert (drive.path[:, 3] == 0.5).all()
    other = drive.path.copy()
    other[-1, 3] = 0.25
    with pytest.raises(InputError, match="keep their values"):
        checker.certify_trajectory(replace(drive, path=other))
    with pytest.raises(InputError, match="turn, which is not among"):
        planners.plan(checker, [-1, 0, 0, 0.5], [1, 0.5, 3, 0.25], base="car", radius=0.5)


def planners_joint():
    from loewner import Joint

    return Joint("turn", "continuous", "cart", "boom", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]])


def test_a_planar_joint_is_a_base():
    """A URDF's planar joint has the three values, and a fixed robot has none."""
    robot = Robot.from_urdf(text=PLANAR)
    assert base_columns(robot) == (0, 1, 2)
    assert planners.Drive.of(robot, [0, 0, 0], [[1.0, 0.0]]).path.tolist() == [[0, 0, 0], [1, 0, 0]]
    fixed = Robot.from_urdf(text="<robot name='r'><link name='a'/></robot>").with_body("b", Body.box([1, 1, 1]))
    with pytest.raises(InputError, match="slides along x and y and turns"):
        planners.Drive.of(fixed, fixed.configuration(), [[1.0, 0.0]])


@pytest.mark.parametrize(("options", "found"), [
    ({"base": "car"}, "least radius"), ({"base": "car", "radius": 0.0}, "radius"),
    ({"base": "car", "radius": float("nan")}, "radius"), ({"base": "car", "radius": 1e9}, "radius"),
    ({"base": "ship"}, "differential, car"), ({"radius": 1.0}, "base"),
    ({"base": "differential", "radius": 1.0}, "turns in place"), ({"base": "differential", "full": True}, "full"),
    ({"base": "differential", "joints": "base/x"}, "joints"), ({"base": "differential", "start_time": 0.0}, "base"),
    ({"base": "differential", "goal": [1.0, 0.0, 0.0], "start": [0.8, 0.5, 0.0]}, "collision"),
    ({"base": "differential", "goal": [9.0, 0.0, 0.0]}, "outside"),
    ({"base": "differential", "goal": [-1.7, -1.0, 1.0]}, "differs from the start"),
    ({"base": "differential", "goal": [[1.7, 0.5, 1.0], [1.7, 0.6, 1.0]]}, "one configuration"),
    ({"base": "car", "radius": 0.6, "max_iterations": 1}, "found none"),
])  # fmt: skip
def test_what_is_refused(options, found):
    """Errors name the argument, or what is wrong with an end."""
    given = {"start": [-1.7, -1.0, 1.0], "goal": [1.7, 0.5, -1.5], **options}
    with pytest.raises(LoewnerError, match=found):
        planners.plan(room(), given.pop("start"), given.pop("goal"), **given)


def walls(x, y, a, b):
    """Four walls around a rectangle of a x b."""
    sides = [(a + 0.2, 0.1, 0.0, b / 2 + 0.05), (0.1, b, a / 2 + 0.05, 0.0)]
    return [(Body.box([w, h, 1.0]), at(x + s * dx, y + s * dy)) for w, h, dx, dy in sides for s in (-1, 1)]


# Bodies around a base of 0.6 m x 0.4 m in a room of 5 m x 4 m, its two ends, and how far the search comes.
NO_WAYS = {
    "start in a box": (walls(-1, 0, 1.2, 1.0), [-1, 0, 0], [1.2, 0, 0], "from the start, .* m and .* of the goal"),
    "goal in a box": (walls(1, 0, 1.2, 1.0), [-1.2, 0, 0], [1, 0, 0], "from the goal, .* m and .* of the start"),
    "a narrow corridor": (
        walls(0, 0, 4.8, 0.6),
        [-1, 0, 0],
        [1, 0, math.pi],
        "within .* m and 1[5-8].* degrees of the",
    ),
}


@pytest.mark.parametrize("case", NO_WAYS)
@pytest.mark.parametrize("options", [{"base": "car", "radius": 1.0}, {"base": "differential"}], ids=lambda o: o["base"])
@pytest.mark.parametrize("limit", [{"max_iterations": 200}, {"timeout": 0.05}], ids=lambda o: next(iter(o)))
def test_where_there_is_no_way_the_search_ends(case, options, limit):
    """It ends at its limit, and the error says how near to the other end it came."""
    bodies, start, goal, found = NO_WAYS[case]
    scene = Scene()
    for k, (body, T) in enumerate(bodies):
        scene.add(f"wall {k}", body, T)
    message = f"from 2[0-9][0-9] poses; .*{found}" if "max_iterations" in limit else "in time; from the "
    with pytest.raises(PlanningError, match=message):
        planners.plan(CollisionChecker(base(), scene), start, goal, **options, **limit)


def test_a_base_that_cannot_move_has_tried_all():
    """Where even the finest motions collide, the search ends by itself."""
    scene = Scene()
    for k, (body, T) in enumerate(walls(0.1, 0, 0.62, 0.42)):
        scene.add(f"wall {k}", body, T)
    with pytest.raises(PlanningError, match="from .* poses, which are all; from the start, the search came within 1"):
        planners.plan(CollisionChecker(base(), scene), [0, 0, 0], [1.5, 0, 0], base="car", radius=0.5)


def test_no_way_and_no_bounds_are_said():
    """A wall from side to side ends the search when it has taken enough; without bounds there is none."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 9.0, 1.0]), at(0, 0))
    checker = CollisionChecker(base([[-1.2, 1.2], [-0.6, 0.6]]), scene)
    with pytest.raises(LoewnerError, match="found none from 3"):
        planners.plan(checker, [-0.6, 0, 0], [0.6, 0, 0], base="differential", max_iterations=300)
    with pytest.raises(InputError, match="limits of x and y"):
        planners.plan(CollisionChecker(base(None), scene), [-0.6, 0, 0], [0.6, 0, 0], base="differential")
    for motions in ([], [[0.0, 0.0]], [[1e308, 0.0]] * 2):
        with pytest.raises(InputError, match="motions"):
            planners.Drive.of(base(), [0, 0, 0], motions)
    with pytest.raises(InputError, match="times from 0 to 1"):
        planners.Drive.of(base(), [0, 0, 0], [[1.0, 0.0]]).positions(1.5)


@pytest.mark.parametrize("error", [1e308, [1e308, 0.0, 1e-3]])
def test_errors_beyond_number_are_refused(error):
    """Also where nothing is near: the search for the largest error that is proven ends."""
    checker = CollisionChecker(base([[-2.0, 2.0], [-2.0, 2.0]]))
    with pytest.raises(PlanningError, match=r"start: .* proven free within joint errors of 1e\+09, but not of 1e\+308"):
        planners.plan_drive(checker, np.zeros(3), [1.0, 0.0, 0.0], "car", radius=0.5, joint_error=error)


@pytest.mark.parametrize("motion", [[1.0, 1e9], [1e300, 1e300], [0.0, 1e300]])
def test_turns_beyond_number_are_refused(motion):
    """A drive of more pieces than anybody can mean is named, and takes no memory."""
    with pytest.raises(InputError, match="motions: expected"):
        CollisionChecker(base()).certify_trajectory(planners.Drive.of(base(), np.zeros(3), [motion]))
