"""Which pairs can ever collide: closed forms, searches that try to refute proofs, rules on ranges, bad input."""

import itertools
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loewner
import mechanisms
from families import translation
from loewner import Body, CollisionChecker, InputError, Robot, Scene, UnknownNameError, cli
from loewner.errors import FileError
from loewner.robots.checking import distances, pair_cache
from loewner.robots.description.pair_verdicts import PairVerdict
from loewner.robots.proofs import pair_ranges
from mechanisms import ARM, BALL, HINGE_TOUCHES, ball, box, joint, link
from robot_oracle import robots_folder
from sampling import quick, quick_of

FINE = 1e-9

FILES = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
    "talos": ("talos_data/robots/talos_reduced.urdf", "talos_data/srdf/talos.srdf"),
}


def example_robot(name, **options):
    """A robot of example-robot-data."""
    folder = robots_folder()
    urdf, srdf = (folder / file for file in FILES[name])
    return Robot.from_urdf(urdf, srdf=srdf, package_dirs=[folder, folder.parent, folder.parents[1]], **options)


def signed(robot, row, values):
    """Signed distances of a pair at values between its bodies; NaN where arithmetic cannot settle one."""
    Q = np.tile(robot.configuration(), (len(values), 1)).astype(float)
    Q[:, [robot.configuration_names.index(name) for name in row.columns]] = values
    poses = robot.forward_kinematics(Q)
    a, b = (poses[:, robot.link_names.index(name)] for name in row.names)
    one, other = (robot.bodies[name] for name in row.names)
    try:
        return loewner.distance(one, a, other, b, exact=True).distance
    except loewner.ConvergenceError as error:
        return error.partial.distance


def refuted(robot, row, starts, seed=0):
    """The least margin by which a search contradicts a proof; it is positive if the proof is wrong."""
    rng, count = np.random.default_rng(seed), len(row.columns)
    sign = 1.0 if row.verdict == "NEVER" else -1.0
    values = row.lower + (row.upper - row.lower) * rng.random((starts, count))
    corners = np.where(rng.random((min(starts, 64), count)) < 0.5, row.lower, row.upper)
    values[: len(corners)] = corners
    found = sign * signed(robot, row, values)
    step = np.tile((row.upper - row.lower) / 6, (starts, 1))
    for turn in range(40):
        way = rng.normal(size=values.shape)
        if turn % 3 == 0:
            way = np.sign(way) * (rng.random(values.shape) < 1 / count)
        else:
            way /= np.linalg.norm(way, axis=1)[:, None]
        tried = np.clip(values + way * step, row.lower, row.upper)
        of_tried = sign * signed(robot, row, tried)
        better = of_tried < found
        values[better], found[better] = tried[better], of_tried[better]
        step[~better] *= 0.7
    return sign * row.margin - np.nanmin(found)


def expect_true(robot, row, starts):
    """A proof is not refuted by a search, and configurations are what they are said to be."""
    a, b = (robot.link_names.index(name) for name in row.names)
    for q, collides in ((row.colliding, True), (row.free, False)):
        if q is not None:
            T = robot.forward_kinematics(q)
            bodies = [robot.bodies[name] for name in row.names]
            assert loewner.collide(bodies[0], T[a], bodies[1], T[b], margin=row.margin) == collides
    if row.verdict in ("NEVER", "ALWAYS") and starts:
        assert refuted(robot, row, starts) < 0, row
    assert (row.verdict == "SOMETIMES") == (row.colliding is not None and row.free is not None)


def only(robot, a, b, **options):
    (row,) = robot.prove_pairs([(a, b)], cache=False, **options)
    return row


# -- closed forms -------------------------------------------------------------------------------


def test_a_hinge_is_free_up_to_contact():
    """The proven range ends less than a nanoradian before the balls touch."""
    ends = mechanisms.hinge().free_range("hinge", pairs=[("frame", "crank")])["hinge"]
    assert np.allclose(ends, (-HINGE_TOUCHES, HINGE_TOUCHES), rtol=0, atol=FINE)
    assert ends[0] > -HINGE_TOUCHES
    assert ends[1] < HINGE_TOUCHES


def test_a_hinge_collides_sometimes_and_never_within_its_free_range():
    """A range that ends a nanoradian before contact is NEVER, one that ends as much after it SOMETIMES."""
    robot = mechanisms.hinge()
    row = only(robot, "crank", "frame")
    expect_true(robot, row, 0)
    assert row.verdict == "SOMETIMES"
    assert row.columns == ("hinge",)
    assert row.complete
    assert row.distance == pytest.approx(2 * ARM * math.sin((math.pi - 3.1) / 2) - 2 * BALL, abs=1e-6)
    end = HINGE_TOUCHES - FINE
    assert only(robot, "crank", "frame", limits={"hinge": (-end, end)}).verdict == "NEVER"
    row = only(robot, "crank", "frame", limits={"hinge": (-end, HINGE_TOUCHES + FINE)})
    assert row.verdict == "SOMETIMES"
    assert not row.complete


@pytest.mark.parametrize("gap", [1e-6, -1e-6])
def test_two_balls_that_miss_by_a_micrometre(gap):
    """They are nearest opposite to where the hinge begins."""
    row = only(mechanisms.hinge("continuous", None, 2 * BALL + gap), "frame", "crank")
    assert row.verdict == ("NEVER" if gap > 0 else "SOMETIMES")
    assert row.lower <= -math.pi
    assert row.upper >= math.pi


@pytest.mark.parametrize("near", [-FINE, FINE])
def test_the_margin_counts(near):
    """The balls of a hinge with a gap of 5 mm are NEVER within less, and SOMETIMES within more."""
    row = only(mechanisms.hinge("continuous", None, 2 * BALL + 0.005), "frame", "crank", margin=0.005 + near)
    assert row.verdict == ("NEVER" if near < 0 else "SOMETIMES")
    assert row.margin == 0.005 + near


@pytest.mark.filterwarnings("ignore:.*expected lengths in metres:UserWarning")
def test_a_range_far_from_zero_ends():
    """At 3e6 m, neighbouring numbers are farther apart than the ranges' accuracy: the search stops between them."""
    far = 3e6
    robot = mechanisms.robot(
        link("frame", ball(BALL, (far, 0.0, 0.0))), link("slide", ball(BALL)),
        joint("slide", "prismatic", "frame", "slide", axis=(1, 0, 0), limits=(0.0, 2 * far)),
    )  # fmt: skip
    pairs, limits = [("frame", "slide")], {"slide": (0.0, 2 * far)}
    _, upper = robot.free_range("slide", [far - 1.0], pairs=pairs, limits=limits)["slide"]
    assert far - 0.3 < upper < far - 2 * BALL


def test_a_rack_is_free_up_to_contact():
    """The proven range of the pinion ends where the rack touches, or at the limit."""
    lower, upper = mechanisms.rack_and_pinion().free_range("pinion", pairs=[("frame", "rack")])["pinion"]
    assert lower == -3.0
    assert 10.0 - FINE < upper < 10.0


@pytest.mark.parametrize(("ratio", "turns"), [(-2.0, 1), (-1.5, 2), (0.25, 4)])
def test_gears_are_proven_over_their_common_period(ratio, turns):
    """A tooth that meets the other one at the start of a period meets it; the range ends where both are back."""
    row = only(mechanisms.gears(ratio, 0.0), "first", "second")
    assert row.verdict == "SOMETIMES"
    assert row.upper == pytest.approx(turns * math.pi)
    assert row.upper >= turns * math.pi
    assert row.lower == -row.upper


def test_gears_that_miss_each_other():
    """With equal angles in opposite directions and an offset of half a turn, a tooth is there when the other is not."""
    robot = mechanisms.gears(-1.0, math.pi)
    row = only(robot, "first", "second")
    expect_true(robot, row, 100)
    assert row.verdict == "NEVER"


def test_a_factor_without_a_common_period_is_open():
    """The two gears never come back to where they began."""
    row = only(mechanisms.gears(math.sqrt(2), 0.0), "first", "second")
    assert row.verdict == "OPEN"
    assert "no common period" in row.reason


@pytest.mark.parametrize("near", [-FINE, FINE])
def test_a_parallelogram(near):
    """The coupler does not turn, and its ball comes within 0.15 m of the frame's."""
    row = only(mechanisms.parallelogram(), "frame", "coupler", margin=0.15 + near)
    assert row.verdict == ("NEVER" if near < 0 else "SOMETIMES")


def test_joints_of_one_column_add_up():
    """Two links of 1 m, the second one turned by as much as the first: both bends, and twice their product, count."""
    far = 1.0 + 1.0
    robot = mechanisms.robot(
        link("frame", box((1.0, 4.0, 1.0), (far + 0.5 + 1e-6, 0.0, 0.0))), link("upper"),
        link("lower", ball(0.1, (0.9, 0.0, 0.0))),
        joint("one", "revolute", "frame", "upper", limits=(-0.2, 0.2)),
        joint("two", "revolute", "upper", "lower", place=(1.0, 0.0, 0.0), limits=(-0.4, 0.4), mimic=("one", 1.0, 0.0)),
    )  # fmt: skip
    assert only(robot, "frame", "lower").verdict == "NEVER"
    assert only(robot, "frame", "lower", margin=1e-6).verdict == "SOMETIMES"


# Pairs that collide only since a joint moves as it does: each is NEVER if that is left out.
NEEDED = {
    "a multiplier": lambda factor=3.0: mechanisms.robot(
        link("frame", ball(BALL, (-ARM, 0.0, 0.0))), link("knob"), link("crank", ball(BALL, (ARM, 0.0, 0.0))),
        joint("knob", "revolute", "frame", "knob", limits=(0.0, 1.0)),
        joint("crank", "revolute", "frame", "crank", limits=(0.0, 3.0), mimic=("knob", factor, 0.0)),
    ),
    "travel": lambda far=1.0: mechanisms.robot(
        link("frame", ball(BALL, (0.0, 1.0 + ARM, 0.0))), link("crank"), link("slide", ball(BALL, (ARM, 0.0, 0.0))),
        joint("crank", "revolute", "frame", "crank", limits=(0.0, 3.0)),
        joint("slide", "prismatic", "crank", "slide", axis=(1, 0, 0), limits=(0.0, far)),
    ),
    "the other branch": lambda far=1.5: mechanisms.robot(
        link("frame"), link("left", ball(BALL, (0.0, ARM, 0.0))), link("right", ball(BALL, (ARM, 0.0, 0.0))),
        joint("left", "revolute", "frame", "left", limits=(-0.1, 0.1)),
        joint("right", "revolute", "frame", "right", limits=(0.0, far)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", NEEDED)
def test_every_joint_between_two_bodies_counts(what):
    """The pair collides, and with a shorter way it never does."""
    make = NEEDED[what]
    names = ("left", "right") if what == "the other branch" else ("frame", "slide" if what == "travel" else "crank")
    assert only(make(), *names).verdict == "SOMETIMES"
    assert only(make(0.5), *names).verdict == "NEVER"


def test_neighbours_that_always_overlap():
    """A ball that turns about a point of another one; and one that leaves it at the end of its range."""
    robot = mechanisms.robot(
        link("frame", ball(0.2)), link("crank", ball(0.2, (0.1, 0.0, 0.0))),
        joint("hinge", "continuous", "frame", "crank"),
    )  # fmt: skip
    row = only(robot, "frame", "crank")
    expect_true(robot, row, 100)
    assert row.verdict == "ALWAYS"
    assert row.distance == pytest.approx(-0.3)
    assert row.free is None
    slides = mechanisms.robot(
        link("frame", ball(0.2)), link("slide", ball(0.2)),
        joint("slide", "prismatic", "frame", "slide", limits=(0.0, 0.4 + 1e-9)),
    )  # fmt: skip
    assert only(slides, "frame", "slide").verdict == "SOMETIMES"
    assert only(slides, "frame", "slide", limits={"slide": (0.0, 0.4 - 1e-9)}).verdict == "ALWAYS"


@pytest.mark.parametrize("count", quick(20, 60))
def test_depths_of_round_pieces_are_within_their_allowance(count):
    """Where two cylinders have a common axis, the search may stop beside the best direction; closed forms."""
    rng, worst = np.random.default_rng(5), 0.0
    for _ in range(count):
        (r, s), (h, k) = rng.uniform(0.05, 0.5, 2).tolist(), rng.uniform(0.1, 0.6, 2).tolist()
        robot = mechanisms.robot(
            link("frame", (f'<cylinder radius="{r!r}" length="{h!r}"/>', (0.0, 0.0, 0.0))),
            link("slide", (f'<cylinder radius="{s!r}" length="{k!r}"/>', (0.0, 0.0, 0.0))),
            joint("slide", "prismatic", "frame", "slide", limits=(-1.0, 1.0)),
        )  # fmt: skip
        way = rng.uniform(-0.4, 0.4, (50, 1)) * (h + k)
        ready = CollisionChecker(robot, skip_adjacent=False)._ready()
        found = distances.nearest_columns(ready, way, True, care=False)[2]
        depth = np.minimum(r + s, (h + k) / 2 - np.abs(way[:, 0]))
        worst = max(worst, float(np.abs(found + depth).max()) / max(np.hypot(r, h / 2), np.hypot(s, k / 2)))
    assert worst < pair_ranges.OF_CURVED / 5


@pytest.mark.parametrize("model", ["hull", "surface"])
@pytest.mark.parametrize("starts", quick(6, 20))
def test_models_of_meshes(model, starts):
    """Hulls and surfaces are proven, with links that move."""
    robot = example_robot("ur5", meshes=model)
    for row in robot.prove_pairs([("base_link", "shoulder_link"), ("wrist_1_link", "wrist_2_link")], cache=False):
        expect_true(robot, row, starts)
        assert row.verdict == "NEVER", (model, row)


# -- searches -----------------------------------------------------------------------------------


def settle_tree(seed, starts, boxes=10_000):
    robot = mechanisms.random_tree(seed)
    margin = (0.0, 0.0, 0.02)[seed % 3]
    found = robot.prove_pairs(itertools.combinations(robot.bodies, 2), margin=margin, boxes=boxes, cache=False)
    for row in found:
        expect_true(robot, row, starts if np.isfinite(row.lower).all() else 0)
    return found


@pytest.mark.parametrize("seed", quick_of(range(8), range(2)))
def test_no_search_refutes_a_proof(seed):
    """Twenty searches for each proof, in eight trees."""
    settle_tree(seed, 20, 2000)


@pytest.mark.verify
@pytest.mark.parametrize("seed", range(100, 200))
def test_no_thorough_search_refutes_a_proof(seed):
    """A thousand searches for each proof, in a hundred trees."""
    settle_tree(seed, 1000)


@pytest.mark.verify
@pytest.mark.parametrize(
    ("name", "meshes", "samples", "expected"),
    [
        ("panda", "hull", 10**6, (25, 6, 3, 0, 0)),
        ("ur5", "hull", 10**6, (4, 3, 3, 0, 0)),
        ("ur5", "auto", 10**3, (4, 1, 3, 2, 0)),
    ],
)
def test_no_sample_refutes_a_proof_of_a_robot(name, meshes, samples, expected):
    """Ten million samples of a robot of hulls, ten thousand of one of solids, and the figures of the page."""
    robot = example_robot(name, meshes=meshes)
    found = robot.prove_pairs(cache=False)
    counts = {kind: len(found.with_verdict(kind)) for kind in PairVerdict}
    assert tuple(counts.values()) == expected
    proven = found.with_verdict("NEVER", "ALWAYS")
    rng = np.random.default_rng(0)
    for row in proven:
        for _ in range(10):
            values = row.lower + (row.upper - row.lower) * rng.random((samples // len(proven), len(row.columns)))
            far = signed(robot, row, values)
            assert np.nanmin(far) > 0 if row.verdict == "NEVER" else np.nanmax(far) <= 0


@pytest.mark.verify
@pytest.mark.filterwarnings("ignore:.*states that place the base:UserWarning")
def test_pairs_of_talos():
    """At most one pair in twenty is open, of those with up to five values between its bodies."""
    few = [row for row in example_robot("talos").prove_pairs(cache=False) if len(row.columns) <= 5]
    assert sum(row.verdict == "OPEN" for row in few) <= len(few) / 20
    assert len(few) > 200


# -- ranges and reasons -------------------------------------------------------------------------


def test_pairs_without_a_range_are_open():
    """A slide with one limit, or none; bounded planar joints are proven, and others are not."""
    for limits in ((0.0, math.inf), (-math.inf, math.inf)):
        row = only(mechanisms.robot(
            link("frame", ball(0.1)), link("slide", ball(0.1, (1.0, 0.0, 0.0))),
            joint("slide", "prismatic", "frame", "slide", limits=tuple(min(max(end, -1e300), 1e300) for end in limits)),
        ), "frame", "slide")  # fmt: skip
        assert row.verdict == "OPEN"
        assert "slide" in row.reason
    robot = mechanisms.hinge().add_base("floating")
    scene = Scene()
    scene.add("post", Body.box([0.1, 0.1, 1.0]), [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    row = only(robot, "frame", "post", scene=scene)
    assert row.verdict == "OPEN"
    assert "any axis" in row.reason


def test_a_box_of_values_needs_ranges():
    """With a floating joint between a pair, a box of several values cannot be proven, and is not told to be empty."""
    robot = mechanisms.robot(
        link("frame", ball(0.1)), link("one"), link("two", ball(0.1, (0.5, 0.0, 0.0))),
        joint("a", "revolute", "frame", "one", limits=(0.0, 1.0)),
        joint("b", "revolute", "one", "two", limits=(0.0, 1.0)),
    ).add_base("floating")  # fmt: skip
    scene = Scene()
    scene.add("post", Body.sphere(0.1), [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    with pytest.raises(InputError, match="post and two: the joint above .* any axis"):
        robot.free_range(["a", "b"], pairs=[("two", "post")], scene=scene)


def test_a_robot_without_bodies_has_no_pairs():
    """It is read, and questions about it are refused, as by a checker."""
    robot = mechanisms.robot(
        link("frame"), link("crank"), joint("hinge", "continuous", "frame", "crank"), pairs="proven"
    )  # fmt: skip
    for question in (robot.prove_pairs, lambda: robot.free_range("hinge")):
        with pytest.raises(InputError, match="collision geometry"):
            question()


def test_a_base_on_a_floor():
    """A planar base needs ranges for its position; with them it misses the post or not."""
    robot = mechanisms.hinge().add_base("planar")
    scene = Scene()
    scene.add("post", Body.box([0.1, 0.1, 1.0]), [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    x, y, _ = (name for name in robot.configuration_names if "/" in name)
    assert only(robot, "frame", "post", scene=scene).verdict == "OPEN"
    near = {x: (-1.0, 1.0), y: (-1.0, 1.0)}
    assert only(robot, "frame", "post", scene=scene, limits=near).verdict == "NEVER"
    assert only(robot, "frame", "post", scene=scene, limits=near | {x: (-1.0, 3.0)}).verdict == "SOMETIMES"


def test_links_and_bodies_of_a_scene():
    """A link against a table, a body in the hand against a link, and margins of the scene."""
    scene = Scene()
    scene.add("post", Body.sphere(0.1), [[1, 0, 0, 0], [0, 1, 0, 1.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    scene.add("tool", Body.sphere(0.1))
    scene.attach("tool", "crank", [[1, 0, 0, 0], [0, 1, 0, -1.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    robot = mechanisms.hinge()
    assert only(robot, "crank", "post", scene=scene).verdict == "NEVER"
    assert only(robot, "tool", "post", scene=scene).verdict == "SOMETIMES"
    assert only(robot, "tool", "frame", scene=scene).verdict == "NEVER"
    scene.set_margin(0.31, "tool", "frame")
    row = only(robot, "tool", "frame", scene=scene)
    assert row.verdict == "SOMETIMES"
    assert row.margin == 0.31


def test_two_robots_as_one():
    """Two cranks that meet, and that miss each other by a micrometre at full reach."""
    pose = np.eye(4)
    pose[0, 3] = 2 * ARM
    both = Robot.join({"left": mechanisms.hinge(), "right": mechanisms.hinge()}, {"right": pose})
    assert only(both, "left/crank", "right/crank").verdict == "SOMETIMES"
    pose[0, 3] = 2 * (ARM + BALL) + 1e-6
    both = Robot.join({"left": mechanisms.hinge(), "right": mechanisms.hinge()}, {"right": pose})
    row = only(both, "left/crank", "right/crank")
    assert row.verdict == "NEVER"
    assert row.columns == ("left/hinge", "right/hinge")


def test_the_largest_box_of_several_joints():
    """All ends are the same share of the way to their limits, and the next larger box collides."""
    robot = NEEDED["the other branch"](3.0)
    ranges = robot.free_range(["left", "right"], pairs=[("left", "right")])
    share = ranges["right"][1] / 3.0
    assert ranges["left"] == pytest.approx((-0.1 * share, 0.1 * share))
    assert ranges["right"][0] == 0.0
    assert only(robot, "left", "right", limits=ranges).verdict == "NEVER"
    wider = {name: (low, high + 0.01) for name, (low, high) in ranges.items()}
    assert only(robot, "left", "right", limits=wider).verdict == "SOMETIMES"


def test_pairs_on_one_rigid_part_are_listed_apart():
    """No joint is between the two bodies."""
    robot = mechanisms.robot(
        link("frame", ball(0.1)), link("plate", ball(0.1)), joint("screw", "fixed", "frame", "plate")
    )  # fmt: skip
    found = robot.prove_pairs(cache=False)
    assert len(found) == 0
    assert found.rigid == (("frame", "plate"),)


def test_a_body_of_the_scene_and_a_link_without_a_joint_are_judged():
    """A checker checks such a pair, so the answer is not left out; it exempts no pair from checking."""
    robot = mechanisms.robot(
        link("frame", ball(0.1)), link("arm", ball(0.1)), joint("turn", "revolute", "frame", "arm", limits=(0, 1))
    )  # fmt: skip
    for height, verdict, distance in ((0.05, "ALWAYS", -0.15), (1.0, "NEVER", 0.8)):
        scene = Scene()
        scene.add("ball", Body.sphere(0.1), translation(0, 0, height))
        found = robot.prove_pairs([("frame", "ball")], scene=scene)
        (row,) = found
        assert (row.verdict, row.columns, found.rigid, found.exempt) == (verdict, (), (), frozenset())
        assert row.distance == pytest.approx(distance)
        assert (row.colliding is None) == (verdict == "NEVER")


def test_limits_in_degrees_are_doubted():
    """Nobody turns a joint by fourteen turns; a slide of ninety metres is none of our business."""
    robot = mechanisms.robot(
        link("frame", ball(0.1)), link("arm", ball(0.1)), link("slide", ball(0.1)),
        joint("turn", "revolute", "frame", "arm", place=(1, 0, 0), limits=(-1, 1)),
        joint("rail", "prismatic", "frame", "slide", limits=(-1, 1)),
    )  # fmt: skip
    with pytest.warns(UserWarning, match="limits of turn: expected limits in radians, found -90 .. 90; are they in"):
        robot.prove_pairs([("frame", "arm")], limits={"turn": (-90, 90)})
    robot.prove_pairs([("frame", "slide")], limits={"rail": (-90, 90)})


def test_default_pairs():
    """Without rules all pairs of bodies, with rules the exempt ones."""
    robot = NEEDED["the other branch"]()
    assert [row.names for row in robot.prove_pairs(cache=False)] == [("left", "right")]
    panda = example_robot("panda")
    assert {row.names for row in panda.prove_pairs(boxes=10, cache=False)} <= panda.disabled_pairs


@pytest.mark.parametrize("boxes", quick(2000, 20000))
def test_threads_and_progress(monkeypatch, boxes):
    """The same rows for one thread and for several; the share that is told never falls, and ends with all."""
    told, robot = [], example_robot("panda")
    one = robot.prove_pairs(boxes=boxes, cache=False, progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1] == (len(one), len(one))
    threads = loewner.get_num_threads()
    try:
        loewner.set_num_threads(1 if threads > 1 else 2)
        other = robot.prove_pairs(boxes=boxes, cache=False)
    finally:
        loewner.set_num_threads(threads)
    assert [(row.verdict, row.boxes, row.share) for row in one] == [
        (row.verdict, row.boxes, row.share) for row in other
    ]


def test_the_budget_is_kept():
    """No more boxes are examined than are allowed, and open pairs have a reason."""
    found = example_robot("panda").prove_pairs(boxes=3000, cache=False)
    assert sum(row.boxes for row in found) <= 3000
    assert all(row.reason for row in found.with_verdict("OPEN", "CAN"))


# -- what becomes of the answers ------------------------------------------------------------------


def test_proven_pairs_in_an_srdf(tmp_path):
    """They are read again as exempt; what the file has already stays as it is."""
    robot = mechanisms.gears(-1.0, math.pi)
    urdf, path = tmp_path / "gears.urdf", tmp_path / "gears.srdf"
    robot.to_urdf(urdf)  # and an SRDF
    found = robot.prove_pairs([("first", "second")], cache=False)
    assert found.to_srdf(path) == (("first", "second"),)
    text = path.read_text()
    assert 'reason="Never"' in text
    assert "proven: first -3.14159 .. 3.14159" in text
    assert ("first", "second") in Robot.from_urdf(urdf, srdf=path).disabled_pairs
    assert found.to_srdf(path) == ()
    assert path.read_text() == text
    rule = '<disable_collisions link1="second" link2="first" reason="User"/>'
    mine = f'<robot name="mechanism">\n <!-- </robot> mine -->\n {rule}\n</robot>'
    path.write_text(mine)
    assert found.to_srdf(path) == ()
    assert path.read_text() == mine
    mine = mine.replace("disable", "enable")  # a pair that somebody wants checked
    path.write_text(mine)
    assert found.to_srdf(path) == ()
    mine = '\ufeff<?xml version="1.0"?>\r\n<robot name="mechanism">\r\n</robot >\r\n<!-- </robot> -->\r\n'
    path.write_bytes(mine.encode())
    assert found.to_srdf(path) == (("first", "second"),)
    text = path.read_bytes().decode()
    assert text.startswith(mine[:50])
    assert text.endswith("</robot >\r\n<!-- </robot> -->\r\n")
    assert "\n" not in text.replace("\r\n", "")
    assert found.to_srdf(path) == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='another'></robot>", "mechanism"), ("<robot", "broken XML"),
        ("<robot name='mechanism'/>", "</robot>"),
    ],
)  # fmt: skip
def test_srdfs_that_are_refused(tmp_path, text, words):
    """Another robot, broken text, and a file without an end to insert before; the file stays as it is."""
    (tmp_path / "a.srdf").write_text(text)
    with pytest.raises(FileError, match=words):
        mechanisms.gears(-1.0, math.pi).prove_pairs(cache=False).to_srdf(tmp_path / "a.srdf")
    assert (tmp_path / "a.srdf").read_text() == text


def test_narrow_ranges_are_not_written_unless_asked(tmp_path):
    """A proof over a part of the range exempts no pair by itself."""
    found = mechanisms.hinge().prove_pairs(limits={"hinge": (-1.0, 1.0)}, cache=False)
    with pytest.raises(InputError, match=r"hinge -1 \.\. 1; narrower=True"):
        found.to_srdf(tmp_path / "a.srdf")
    assert not (tmp_path / "a.srdf").exists()
    assert found.to_srdf(tmp_path / "a.srdf", narrower=True) == (("crank", "frame"),)


def test_always_within_a_margin_is_no_contact(tmp_path):
    """Two bodies that are always near each other may not be exempt."""
    robot = mechanisms.hinge("continuous", None, 2 * BALL + 0.01)
    found = robot.prove_pairs(margin=3.0, cache=False)
    assert found[0].verdict == "ALWAYS"
    with pytest.raises(InputError, match="within 3 m, which is no contact"):
        found.to_srdf(tmp_path / "a.srdf")


def test_rows_by_number_and_by_names():
    """The names of a pair have no order."""
    found = NEEDED["the other branch"]().prove_pairs(cache=False)
    assert found["right", "left"] is found[0]
    assert "1 SOMETIMES" in repr(found)
    assert "SOMETIMES" in found._repr_html_()
    with pytest.raises(UnknownNameError, match="pair among the 1 rows"):
        found["left", "frame"]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty folder for answers."""
    monkeypatch.setattr(pair_cache, "FOLDER", tmp_path / "pairs")
    return tmp_path / "pairs"


def test_answers_are_kept(cache, monkeypatch):
    """They are read again instead of proven again, for the same numbers only."""
    robot = NEEDED["the other branch"]()
    first = robot.prove_pairs()
    with monkeypatch.context() as patched:
        patched.setattr(
            pair_ranges, "_settle", lambda questions, *_, **_more: questions and pytest.fail("proven again")
        )
        again = NEEDED["the other branch"]().prove_pairs()
    for one, other in zip(first, again, strict=True):
        assert repr(one) == repr(other)
    (file,) = cache.iterdir()
    NEEDED["the other branch"](1.4).prove_pairs()
    assert len(list(cache.iterdir())) == 2
    file.write_bytes(file.read_bytes()[:-1])
    assert [row.verdict for row in robot.prove_pairs()] == [row.verdict for row in first]


def test_open_pairs_are_tried_again_with_more_boxes(cache):
    """A kept answer that is open counts up to the number of boxes that it was allowed."""
    robot = mechanisms.hinge("continuous", None, 2 * BALL + 1e-6)
    assert robot.prove_pairs(boxes=1)[0].verdict == "OPEN"
    assert robot.prove_pairs(boxes=1)[0].boxes == 1
    assert robot.prove_pairs([("frame", "crank"), ("crank", "frame")], boxes=1)[0].boxes == 1
    assert robot.prove_pairs(boxes=1000)[0].verdict == "NEVER"
    assert robot.prove_pairs(boxes=1)[0].verdict == "NEVER"


def test_a_checker_warns_of_exempt_pairs_that_were_refuted(cache):
    """One warning, and none before the proof or without exempt pairs."""
    robot = NEEDED["the other branch"]().disabling([("left", "right")])
    bodies = replace(robot, bodies={**robot.bodies, "frame": Body.box([0.01, 0.01, 0.01])})
    CollisionChecker(bodies)
    bodies.prove_pairs()
    with pytest.warns(
        UserWarning, match=r"exempt from checking can collide: left and right of mechanism, .* mm deep"
    ) as told:
        CollisionChecker(bodies)
    assert len(told) == 1
    CollisionChecker(replace(bodies, disabled_pairs=frozenset()))


def test_without_a_folder_nothing_is_kept(monkeypatch):
    """Answers are the same where nothing can be written."""
    monkeypatch.setattr(pair_cache, "FOLDER", Path(os.devnull) / "pairs")
    robot = mechanisms.hinge()
    assert robot.prove_pairs()[0].verdict == robot.prove_pairs()[0].verdict == "SOMETIMES"


def test_a_robot_with_proven_pairs(cache):
    """Pairs that never or always collide, and adjacent ones, are not checked; verdicts stay the same."""
    text = "".join([
        link("frame", ball(0.1)), link("one", ball(0.05, (0.5, 0.0, 0.0))), link("two", ball(0.05, (0.9, 0.0, 0.0))),
        link("three", ball(0.05, (0.0, 0.5, 0.3))),
        joint("a", "revolute", "frame", "one", limits=(0.0, 1.0)),
        joint("b", "revolute", "one", "two", limits=(0.0, 1.0)),
        joint("c", "revolute", "two", "three", limits=(0.0, 3.0)),
    ])  # fmt: skip
    robot = mechanisms.robot(text, pairs="proven")
    usual = mechanisms.robot(text, pairs="adjacent")
    checked, before = CollisionChecker(robot).checked_pairs, CollisionChecker(usual).checked_pairs
    assert set(checked) < set(before)
    Q = usual.random_configurations(2000)
    assert (CollisionChecker(robot).collide(Q) == CollisionChecker(usual).collide(Q)).all()
    with pytest.raises(InputError, match="pairs: expected none with an SRDF"):
        mechanisms.robot(text, pairs="proven", srdf="a.srdf")
    with pytest.raises(UnknownNameError, match="adjacent, proven"):
        mechanisms.robot(text, pairs="all")


# -- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pairs", "kind", "words"),
    [
        ([("frame", "nobody")], UnknownNameError, "nobody"),
        ([("frame", "frame")], InputError, "two different names"),
        ([("frame",)], InputError, "two different names"),
        ([("frame", 3)], UnknownNameError, "3"),
        (3, InputError, "pairs of names"),
        ([("frame", "bare")], InputError, "'bare', which has none"),
    ],
)
def test_bad_pairs(pairs, kind, words):
    """Each message has the name that is wrong."""
    robot = mechanisms.robot(
        link("frame", ball(0.1)), link("crank", ball(0.1)), link("bare"), joint("a", "continuous", "frame", "crank"),
        joint("b", "continuous", "frame", "bare"),
    )  # fmt: skip
    with pytest.raises(kind, match=words):
        robot.prove_pairs(pairs)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"limits": {"hinge": (1.0, -1.0)}}, InputError, "1 above -1"),
        ({"limits": {"nothing": (0.0, 1.0)}}, UnknownNameError, "nothing"),
        ({"limits": {"hinge": (0.0, math.inf)}}, InputError, "limits of hinge"),
        ({"limits": {"hinge": 1.0}}, InputError, "limits of hinge"),
        ({"limits": 1}, InputError, "mapping"),
        ({"margin": -1.0}, InputError, "margin"),
        ({"boxes": 0}, InputError, "boxes"),
        ({"scene": 1}, InputError, "scene"),
        ({"cache": 1}, InputError, "cache"),
        ({"progress": 1}, InputError, "progress"),
    ],
)
def test_bad_options(options, kind, words):
    """Each message names the argument."""
    with pytest.raises(kind, match=words):
        mechanisms.hinge().prove_pairs(**options)


@pytest.mark.parametrize("question", ["limits", "joints"])
def test_a_joint_that_follows_another_one_has_no_range(question):
    """The message names the joint that it follows."""
    robot, pairs = mechanisms.rack_and_pinion(), [("frame", "rack")]
    joints, limits = ("rack", None) if question == "joints" else ("pinion", {"rack": (0.0, 1.0)})
    with pytest.raises(InputError, match=f"{question}: .* 'rack', which follows 'pinion'"):
        robot.free_range(joints, pairs=pairs, limits=limits)


def test_bodies_that_follow_motions_are_refused():
    """Their place depends on time."""
    scene, far = Scene(), np.eye(4)
    far[0, 3] = 5.0
    scene.add("belt", Body.sphere(0.1), far)
    scene.follow("belt", [0.0, 1.0], [far, far])
    with pytest.raises(InputError, match="'belt', which follows a motion"):
        mechanisms.hinge().prove_pairs(scene=scene)


def test_two_bodies_at_rest_are_refused():
    """Nothing moves between them."""
    scene = Scene()
    scene.add("one", Body.sphere(0.1))
    scene.add("two", Body.sphere(0.1))
    with pytest.raises(InputError, match="one body that moves with a link"):
        mechanisms.hinge().prove_pairs([("one", "two")], scene=scene)


@pytest.mark.parametrize(
    ("joints", "options", "words"),
    [
        ("nothing", {}, "nothing"),
        ([], {}, "one name or several"),
        (["hinge", "hinge"], {}, "one name or several"),
        ("hinge", {"about": [4.0]}, "between -3.1 and 3.1"),
        ("hinge", {"about": [3.1]}, "contact of frame and crank"),
        ("hinge", {"boxes": 0}, "boxes"),
        ("hinge", {"pairs": []}, "at least one"),
        ("hinge", {"pairs": None}, "at least one"),
    ],
)
def test_bad_questions_about_a_free_range(joints, options, words):
    """Names, places outside the limits, and a place with contact."""
    with pytest.raises((InputError, UnknownNameError), match=words):
        mechanisms.hinge().free_range(joints, **{"pairs": [("frame", "crank")]} | options)


# -- command line -------------------------------------------------------------------------------


@pytest.fixture
def urdf(tmp_path, monkeypatch, cache):
    monkeypatch.chdir(tmp_path)
    mechanisms.hinge().to_urdf(tmp_path / "hinge.urdf")
    return "hinge.urdf"


def clash(capsys, *words):
    status = cli.main(["clash", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.parametrize(("limits", "status"), [("hinge=-3.1,3.1", 1), ("hinge=-1,1", 0)])
def test_clash_says_what_collides(urdf, capsys, limits, status):
    """The verdict is in the table, in JSON and in the exit status."""
    found, out, _ = clash(capsys, urdf, "--all", "--limits", limits)
    assert found == status
    assert ("SOMETIMES" if status else "NEVER") in out
    found, out, _ = clash(capsys, urdf, "--between", "crank", "frame", "--limits", limits, "--json")
    (row,) = json.loads(out)["pairs"]
    assert found == status
    assert row["names"] == ["crank", "frame"]
    assert row["whole_range"] == (status == 1)


def test_clash_draws_a_witness_and_writes_rules(urdf, capsys, tmp_path):
    """The picture has the verdict; only proven pairs are written; the output names the files, and remains JSON."""
    status, out, _ = clash(capsys, urdf, "--all", "-o", "clash.svg")
    assert status == 1
    assert out.endswith("written   clash.svg\n")
    assert "SOMETIMES" in (tmp_path / "clash.svg").read_text()
    status, out, _ = clash(capsys, urdf, "--all", "--json", "--write-srdf", "json.srdf")
    assert json.loads(out)["pairs"]
    assert (tmp_path / "json.srdf").exists()
    status, out, _ = clash(capsys, urdf, "--all", "--margin", "0", "--write-srdf", "hinge.srdf")
    assert status == 1
    assert "0 pairs added" in out
    assert clash(capsys, urdf, "--all", "-o", "clash.pdf")[0] == 2


def test_clash_finds_the_largest_range(urdf, capsys):
    """From zero, and from a given configuration."""
    status, out, _ = clash(capsys, urdf, "--all", "--largest", "hinge", "--json")
    assert status == 0
    assert json.loads(out)["hinge"][1] == pytest.approx(HINGE_TOUCHES, abs=FINE)
    status, out, _ = clash(capsys, urdf, "--all", "--largest", "hinge", "--at", "1.0")
    assert status == 0
    assert out.startswith("FREE       hinge from -2.73887")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--limits", "hinge"], "JOINT=LOWER,UPPER"),
        (["--limits", "hinge=1"], "JOINT=LOWER,UPPER"),
        (["--limits", "hinge=1,0", "--all"], "1 above 0"),
        (["--limits", "hinge=0,1", "--limits", "hinge=0,2", "--all"], "each joint once"),
        (["--between", "crank", "nobody"], "nobody"),
        (["--at", "0"], "--largest"),
        (["--largest", "hinge", "-o", "a.svg"], "--out"),
        ([], "found none"),
    ],
)
def test_clash_refuses(urdf, capsys, words, told):
    """Bad words, with what was expected."""
    status, _, err = clash(capsys, urdf, *words)
    assert status == 2
    assert told in err


def test_info_marks_exempt_pairs(urdf, capsys):
    """Adjacent links are exempt, and marked."""
    assert cli.main(["robot", "info", urdf]) == 0
    out = capsys.readouterr().out
    assert "SOMETIMES  1 pair" in out
    assert "-79" in out.replace("-179", "-79")
