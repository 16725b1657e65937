"""Contact that has to end, or that a motion ends in: `Scene.leave` and `Scene.reach`."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import translation
from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, Verdict, planners
from sampling import quick

# A hand that slides along x and z and turns about y, in the plane of both; the can's bottom is at its origin.
HAND = """<robot name="hand">
<link name="base"/><link name="rail"/><link name="lift"/>
<link name="hand"><collision><origin xyz="0 0 0.35"/><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="rail"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="z" type="prismatic"><parent link="rail"/><child link="lift"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="lift"/><child link="hand"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>"""
START = np.zeros(3)
HALF = 0.03  # of the can's edges along x and y, metres
TOLERANCE = 1e-5


def can_on_table(margin=0.0, sunk=0.0, **rules):
    """A checker of the hand with a can in it that stands on a table, `sunk` metres deep; the table's top is z = 0."""
    scene = Scene(margin=margin)
    scene.add("table", Body.box([6.0, 1.0, 0.1]), translation(z=-0.05))
    scene.add("can", Body.box([2 * HALF, 2 * HALF, 0.2]))
    scene.attach("can", "hand", translation(z=0.1 - sunk), **rules)
    return CollisionChecker(Robot.from_urdf(text=HAND), scene)


def height(q, sunk=0.0):
    """Signed distance of the can to the table: the height of its lowest corner, by plane geometry."""
    x = np.array([HALF, -HALF, HALF, -HALF])
    z = np.array([0.0, 0.0, 0.2, 0.2]) - sunk
    q = np.asarray(q)[..., None, :]
    return (q[..., 1] - np.sin(q[..., 2]) * x + np.cos(q[..., 2]) * z).min(axis=-1)


def on_the_way(a, b, count=401):
    """Configurations on a straight motion."""
    return a + np.linspace(0, 1, count)[:, None] * (b - a)


def test_an_allowed_pair_of_an_attached_body_is_named_in_a_warning():
    """What stays allowed while it is carried would be in no proof, however deep: attach says so, and leave ends it."""
    scene = Scene()
    scene.add("table", Body.box([1.0, 1.0, 0.1]), translation(z=-0.05))
    scene.add("can", Body.box([0.06, 0.06, 0.2]), translation(z=0.1))
    scene.allow("can", "table")
    with pytest.warns(UserWarning, match=r"attach of 'can': \(can, table\) stay allowed"):
        scene.attach("can", "hand", translation(z=0.1))
    checker = CollisionChecker(Robot.from_urdf(text=HAND), scene)
    deep = [0.0, -0.053, 0.0]
    assert checker.certify_edges(START, deep).verdict == Verdict.FREE  # what the warning is about
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.attach("can", "hand", translation(z=0.1), leave=["table"])
    found = checker.certify_edges(START, deep)
    assert found.verdict == Verdict.COLLIDING
    assert set(found.names) == {"can", "table"}
    scene.detach("can", translation(z=0.1))
    assert scene.allowed == {("can", "table")}
    assert not scene.leaving
    assert not scene.collide()


@pytest.mark.parametrize("margin", [0.004, pytest.param(0.0, marks=pytest.mark.verify)])
@pytest.mark.parametrize("sunk", [0.0, 1e-17, 0.002, -0.003])
@pytest.mark.parametrize("count", quick(16, 60))
def test_free_and_colliding_are_as_plane_geometry_says(margin, sunk, count):
    """FREE: no deeper than at the start, or nearer within the margin, until apart; then apart. COLLIDING: nearer."""
    checker = can_on_table(margin, sunk, leave=["table"])
    rng = np.random.default_rng(7)
    ends = rng.uniform([-0.4, -0.1, -0.2], [0.4, 0.1, 0.2], size=(count, 3)) * 10.0 ** rng.uniform(
        -3, 0, size=(count, 1)
    )
    found = checker.certify_edges(START, ends, tolerance=TOLERANCE)
    for verdict, fraction, end in zip(found.verdict, found.fraction, ends, strict=True):
        distances = height(on_the_way(START, end), sunk)
        least = min(distances[0], margin)
        if verdict == Verdict.FREE:
            assert distances.min() >= least - 1.01 * TOLERANCE
            near = np.flatnonzero(distances > margin)
            if distances[-1] > margin:  # it has parted, and does not come back
                last = np.flatnonzero(distances <= margin).max(initial=-1)
                assert last < 0 or (np.diff(distances[: last + 1]) >= -TOLERANCE).all() or len(near) == 0
        else:
            assert distances.min() <= least + TOLERANCE
        if verdict == Verdict.COLLIDING:
            assert height(fraction * end, sunk) <= least - TOLERANCE + 1e-12
    counts = np.bincount(found.verdict, minlength=3)
    assert counts[Verdict.FREE] >= count // 6
    assert counts[Verdict.COLLIDING] >= count // 6
    assert counts[Verdict.AMBIGUOUS] <= count // 5


def test_straight_up_is_free_and_down_is_not():
    """A lift is proven from the table on, however long; the same motion downwards collides where it ends."""
    checker = can_on_table(leave=["table"])
    for rise in (1e-3, 0.01, 0.1, 0.9):
        assert checker.certify_edges(START, [0.0, rise, 0.0]).verdict == Verdict.FREE
    for depth in (2e-5, 1e-3, 0.05):
        found = checker.certify_edges(START, [0.0, -depth, 0.0])
        assert found.verdict == Verdict.COLLIDING
        assert found.names == ("can", "table")


def test_a_millimetre_deeper_is_refused_at_every_row_of_a_path():
    """Neither at the start of a lift nor anywhere on its way may the can be pushed into what it leaves."""
    checker = can_on_table(leave=["table"])
    path = np.array([START, [0.0, 0.0, 0.0], [0.0, 0.02, 0.0], [0.1, 0.05, 0.05], [0.2, 0.1, 0.0]])
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    planners.shorten(checker, path, max_iterations=0)
    for row in range(1, len(path)):
        pushed = path.copy()
        pushed[row, 1] -= height(pushed[row]) + 1e-3
        verdicts = checker.certify_edges(pushed[:-1], pushed[1:]).verdict
        assert verdicts[row - 1] != Verdict.FREE
        with pytest.raises(PlanningError, match="can and table"):
            planners.shorten(checker, pushed)


def test_contact_does_not_come_back():
    """A motion that starts free has no contact to end: one that comes down again collides."""
    checker = can_on_table(leave=["table"])
    lifted = np.array([0.0, 0.05, 0.0])
    for end in ([0.0, 0.0, 0.0], [0.2, -1e-3, 0.0]):
        assert checker.certify_edges(lifted, end).verdict != Verdict.FREE
    # Up and down again in one motion of a turning joint: the corner on the right goes down while the can rises.
    there = np.array([0.0, 0.02, 1.2])
    assert height(on_the_way(START, there)).min() < -TOLERANCE
    assert checker.certify_edges(START, there).verdict != Verdict.FREE


@pytest.mark.parametrize("count", quick(15, 40))
def test_reach_is_the_mirror_image(count):
    """A motion is free by `reach` where the way back is by `leave`, unless its end is deeper than the tolerance."""
    leaves, reaches = can_on_table(leave=["table"]), can_on_table(reach=["table"])
    rng = np.random.default_rng(11)
    ends = rng.uniform([-0.4, -0.02, -0.2], [0.4, 0.1, 0.2], size=(count, 3))
    ends *= 10.0 ** rng.uniform(-3, 0, size=(count, 1))
    away, back = leaves.certify_edges(START, ends).verdict, reaches.certify_edges(ends, START).verdict
    np.testing.assert_array_equal(away == Verdict.FREE, back == Verdict.FREE)
    assert reaches.certify_edges(START, [0.0, 0.1, 0.0]).verdict != Verdict.FREE
    assert leaves.certify_edges([0.0, 0.1, 0.0], START).verdict != Verdict.FREE
    found = reaches.certify_edges([0.0, 0.1, 0.0], [0.0, -1e-3, 0.0])
    assert found.verdict == Verdict.COLLIDING
    assert found.fraction == 1.0


def test_the_other_pairs_are_not_excused():
    """A rule about one pair leaves all others as they are, on the same motion."""
    checker = can_on_table(leave=["table"])
    checker.scene.add("wall", Body.box([0.1, 1.0, 1.0]), translation(x=0.5, z=0.5))
    free, hit = checker.certify_edges(START, [[0.2, 0.1, 0.0], [0.5, 0.1, 0.0]]).verdict
    assert (free, hit) == (Verdict.FREE, Verdict.COLLIDING)
    found = checker.certify_edges(START, [0.5, 0.1, 0.0])
    assert "wall" in found.names
    assert checker.collide(checker.robot.between(START, [0.5, 0.1, 0.0], found.fraction))


def test_a_configuration_in_contact_collides():
    """The rules are about motions: `collide`, `pairs` and sampled motions see the contact as what it is."""
    checker = can_on_table(leave=["table"], reach=["table"])
    assert checker.collide(START)
    assert [set(c[:2]) for c in map(_names, checker.pairs(START))] == [{"can", "table"}]
    assert not checker.valid_edges(START, [0.0, 0.1, 0.0], resolution=0.01)


def _names(contact):
    return contact.name_a, contact.name_b


def test_pieces_that_do_not_touch_keep_their_margin():
    """Of a union every pair of pieces counts: one that hangs beside the foot is not excused by the foot's contact."""
    scene = Scene()
    # A beam lies beside the can.
    table = Body.boxes([[0, 0, -0.05], [0.3, 0, 0.15]], [[1.0, 1.0, 0.1], [0.1, 1.0, 0.1]])
    scene.add("table", table)
    scene.add("can", Body.boxes([[0, 0, 0.1], [0.1, 0, 0.15]], [[0.06, 0.06, 0.2], [0.16, 0.02, 0.02]]))
    scene.attach("can", "hand", leave=["table"])
    checker = CollisionChecker(Robot.from_urdf(text=HAND), scene)
    up, over, under = checker.certify_edges(START, [[0.0, 0.5, 0.0], [0.3, 0.05, 0.0], [0.08, 0.0, 0.0]]).verdict
    assert (up, over, under) == (Verdict.FREE, Verdict.COLLIDING, Verdict.COLLIDING)


def test_both_bodies_may_move():
    """What is left may be a link of the robot: the plane moves with it, wherever that is."""
    tray = HAND.replace(
        '<link name="base"/>',
        '<link name="base"/><link name="tray"><collision><origin xyz="0 0 -0.05"/><geometry><box size="6 1 0.1"/>'
        '</geometry></collision></link><joint name="tilt" type="revolute"><parent link="base"/><child link="tray"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>',
    )
    scene = Scene()
    scene.add("can", Body.cylinder(HALF, 0.2))
    scene.attach("can", "hand", translation(z=0.1), leave=["tray"])
    robot = Robot.from_urdf(text=tray)
    checker = CollisionChecker(robot, scene, allowed=[("hand", "tray")])
    start = robot.configuration({})
    ends = {"up": {"z": 0.1}, "tray down": {"tilt": 0.0, "z": 0.02}, "tilted": {"tilt": 0.3}, "with it": {"z": -0.1}}
    found = {name: checker.certify_edges(start, robot.configuration(end)).verdict for name, end in ends.items()}
    assert found["up"] == found["tray down"] == Verdict.FREE
    assert found["tilted"] != Verdict.FREE
    assert found["with it"] == Verdict.COLLIDING


def test_plans_begin_and_end_in_contact():
    """From the table to the table: a lift, the way, a descent, each proven; the ends are the user's to the bit."""
    checker = can_on_table(margin=0.003, leave=["table"], reach=["table"])
    checker.scene.add("wall", Body.box([0.05, 1.0, 0.6]), translation(x=0.4, z=0.3))
    goal = np.array([0.8, 0.0, 0.0])
    path = planners.plan(checker, START, goal)
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    np.testing.assert_array_equal(path[[0, -1]], [START, goal])
    short = planners.shorten(checker, path)
    assert (checker.certify_edges(short[:-1], short[1:]).verdict == Verdict.FREE).all()
    trajectory = planners.trajectory(checker.robot, short, acceleration=1.0, checker=checker)
    at = trajectory.positions(np.linspace(0, trajectory.duration, 3000))
    assert height(at).min() >= -TOLERANCE
    with pytest.raises(PlanningError, match="start: expected a free configuration"):
        planners.plan(can_on_table(reach=["table"]), START, goal)
    with pytest.raises(PlanningError, match="goal: expected a free configuration"):
        planners.plan(can_on_table(leave=["table"]), START, goal)


def test_a_contact_that_cannot_end_is_named():
    """Under a lid no motion along the normal is free: the message names the pair and says what to do."""
    checker = can_on_table(leave=["table"])
    checker.scene.add("lid", Body.box([1.0, 1.0, 0.1]), translation(z=0.4 + 0.05 + 0.001))
    with pytest.raises(PlanningError, match="start: expected a contact of can and table that"):
        planners.plan(checker, START, [0.0, 0.0005, 0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.attach("can", "hand", leave="table"), "leave: expected several names, found one text"),
        (lambda s: s.attach("can", "hand", reach=[""]), "reach: expected a name, found"),
        (lambda s: s.attach("can", "hand", leave=["can"]), "expected two names, found 'can' twice"),
        (lambda s: s.leave("can", "can"), "expected two names, found 'can' twice"),
        (lambda s: s.reach("can", None), "b: expected a name"),
    ],
)
def test_bad_rules_are_refused_and_change_nothing(change, message):
    """What was found and what was expected; the scene stays as it was."""
    scene = Scene()
    scene.add("can", Body.sphere(0.1))
    version = scene.version
    with pytest.raises(loewner.InputError, match=message):
        change(scene)
    assert scene.version == version
    assert not scene.attachments
    assert not scene.leaving
    assert not scene.reaching


def test_unknown_names_and_surfaces_are_refused():
    """A rule that no pair obeys would go unnoticed; the depth of a surface is not that of convex pieces."""
    checker = can_on_table(leave=["tabel"])
    with pytest.raises(loewner.UnknownNameError, match=r"a pair of leave.*'tabel'.*'table'"):
        checker.certify_edges(START, [0.0, 0.1, 0.0])
    checker = can_on_table(leave=["camera"])
    checker.scene.add("camera", Body.from_cloud(np.zeros((1, 3)), radius=0.01))
    with pytest.raises(loewner.InputError, match="leave or reach of can and camera: expected bodies of convex pieces"):
        checker.certify_edges(START, [0.0, 0.1, 0.0])


def test_rules_end_with_what_they_are_about():
    """Attaching anew, detaching and removing forget them; copies and pickles have them; versions grow."""
    scene = can_on_table(leave=["table"], reach=["shelf"]).scene
    scene.leave("can", "finger")
    assert scene.leaving == {("can", "table"), ("can", "finger")}
    assert scene.copy().leaving == scene.leaving
    version = scene.structure_version
    scene.attach("can", "hand", translation(z=0.1))
    assert not scene.leaving
    assert not scene.reaching
    assert scene.structure_version > version
    scene.leave("can", "finger")
    scene.detach("can", None)
    assert not scene.leaving
    scene.reach("can", "finger")
    scene.remove("can")
    assert not scene.reaching


def test_scene_files_keep_rules(tmp_path: Path):
    """They are written and read back, at the body or as a list of pairs."""
    scene = can_on_table(leave=["table"], reach=["shelf"]).scene
    scene.leave("can", "finger")
    loewner.save_scene(scene, tmp_path / "scene.yaml")
    again = loewner.load_scene(tmp_path / "scene.yaml")
    assert (again.leaving, again.reaching) == (scene.leaving, scene.reaching)
    (tmp_path / "short.yaml").write_text(
        "bodies: {can: {sphere: {radius: 0.1}, attach: {link: hand, leave: [table], reach: [shelf]}}}\n"
        "leave: [[can, finger]]\n"
    )
    again = loewner.load_scene(tmp_path / "short.yaml")
    assert again.leaving == {("can", "table"), ("can", "finger")}
    assert again.reaching == {("can", "shelf")}


def test_the_command_line_has_them(tmp_path: Path, capsys):
    """`loewner plan --leave A B`: without it the start is refused; with it every motion is proven."""
    from loewner.cli.main import main

    scene = can_on_table().scene
    loewner.save_scene(scene, tmp_path / "scene.yaml")
    (tmp_path / "hand.urdf").write_text(HAND)
    arguments = ["plan", str(tmp_path / "hand.urdf"), "--scene", str(tmp_path / "scene.yaml")]
    arguments += ["--start", "0 0 0", "--goal", "0.3 0.2 0"]
    assert main(arguments) != 0
    assert "can and table" in capsys.readouterr().err
    assert main([*arguments, "--leave", "can", "table"]) == 0
    assert "proven free at every configuration" in capsys.readouterr().out


@pytest.mark.parametrize("margin", [0.0, 0.01])
@pytest.mark.parametrize(("gap", "tolerance"), [(5e-6, 1e-5), (1e-6, 1e-5), (1e-7, 1e-5), (5e-4, 1e-3)])
def test_a_contact_that_does_not_exist_yet_may_not_begin(margin, gap, tolerance):
    """A motion that starts free, however near, has no contact to end: it is not FREE if it ends in one."""
    checker = can_on_table(margin, -gap - margin, leave=["table"])
    back = can_on_table(margin, -gap - margin, reach=["table"])
    for x in (0.0, 0.3):
        end = np.array([x, -gap - 0.6 * tolerance, 0.0])
        assert not checker.collide(START)
        assert checker.collide(end)
        assert checker.certify_edges(START, end, tolerance=tolerance).verdict != Verdict.FREE
        assert back.certify_edges(end, START, tolerance=tolerance).verdict != Verdict.FREE
        assert checker.certify_edges(START, [x, gap, 0.0], tolerance=tolerance).verdict == Verdict.FREE


@pytest.mark.parametrize("count", quick(12, 50))
def test_a_path_does_not_sink_by_many_motions(count):
    """Each motion may get deeper by the tolerance, all of them together not more than that."""
    checker = can_on_table(leave=["table"])
    path = np.zeros((count, 3))
    path[:-1, 1] = -0.65 * TOLERANCE * np.arange(count - 1)
    path[-1, 1] = 0.3
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    with pytest.raises(PlanningError, match="can and table deeper at row 2"):
        planners.shorten(checker, path)


@pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")
def test_a_path_too_long_to_prove_is_refused():
    """With the reason that `certify_edges` gives, whether there are rules or not."""
    far = np.array([[0.0, 0.3, 0.0], [0.0, 0.3, 1e12]])
    for rules in ({}, {"leave": ["table"]}):
        checker = can_on_table(**rules)
        with pytest.raises(loewner.InputError, match="short enough to be proven"):
            planners.shorten(checker, far)
        with pytest.raises(loewner.InputError, match="short enough to be proven"):
            checker.certify_edges(*far)
