"""Descriptions of any size and shape: read in a time that grows with the file, or refused with a reason."""

import json
import math
import os
import pickle
import re
import threading
import time
import warnings

import numpy as np
import pytest
import trimesh

from gantry import gantry_robot
from loewner import (
    Body,
    CollisionChecker,
    FileError,
    InputError,
    LoewnerError,
    Robot,
    Scene,
    load_scene,
    read_motion_bench_maker,
)
from loewner.robots.checking import checked_pairs
from loewner.robots.description import srdf as rules
from loewner.robots.description import tree, xml_elements
from loewner.robots.description.watch import Watch
from sampling import quick

BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
LIMIT = '<limit lower="-2" upper="2"/>'


def links(names, inside=""):
    return "".join(f'<link name="{name}">{inside}</link>' for name in names)


def joint(name, parent, child, inside=LIMIT, kind="revolute"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>{inside}</joint>'
    )


def chain(count, inside=lambda k: LIMIT, kind="revolute", body=""):
    """A robot of `count` links, one after the other."""
    text = links((f"l{k}" for k in range(count)), body)
    return text + "".join(joint(f"j{k}", f"l{k}", f"l{k + 1}", inside(k), kind) for k in range(count - 1))


def written(folder, inside, name="robot.urdf"):
    path = folder / name
    path.write_text(f'<robot name="r">\n{inside}\n</robot>')
    return path


def read(folder, inside, srdf=None, **options):
    path = written(folder, inside)
    return Robot.from_urdf(path, srdf=None if srdf is None else written(folder, srdf, "robot.srdf"), **options)


@pytest.fixture
def arm(tmp_path):
    return read(tmp_path, chain(3, body=BALL))


# -- long chains --------------------------------------------------------------------------------

LONG = 4_000  # far more than Python has calls inside each other


def seconds(task):
    started = time.process_time()
    task()
    return time.process_time() - started


@pytest.mark.parametrize("forward", [False, pytest.param(True, marks=pytest.mark.verify)])
@pytest.mark.parametrize("count", quick(1_500, LONG))
def test_long_chains_of_mimics_are_resolved(forward, count, tmp_path):
    """Each moves with the end of its chain, in whichever order the file has them."""

    def mimic(k):
        if k == (0 if forward else count - 2):
            return LIMIT
        return f'{LIMIT}<mimic joint="j{k - 1 if forward else k + 1}" multiplier="-1" offset="0.5"/>'

    robot = read(tmp_path, chain(count, mimic))
    assert robot.joint_names == ("j0" if forward else f"j{count - 2}",)
    T = robot.forward_kinematics([0.2])
    turns = [0.2 if k % 2 == 0 else 0.3 for k in range(count - 1)]  # -0.2 + 0.5, then back
    if not forward:
        turns.reverse()
    total = math.fsum(turns)
    np.testing.assert_allclose(T[-1, :2, 0], [math.cos(total), math.sin(total)], atol=1e-9)


@pytest.mark.parametrize("count", quick(1_500, LONG))
def test_long_chains_of_links_stand_where_they_should(tmp_path, count):
    """More links of half a metre, straight, than Python has calls inside each other."""
    robot = read(tmp_path, chain(count))
    T = robot.forward_kinematics(np.zeros(robot.dof))
    np.testing.assert_array_equal(T[:, 0, 3], 0.5 * np.arange(count))


def test_long_chains_of_groups_are_resolved(tmp_path):
    """Each has the joint of the innermost one; the time is that of the file's length."""
    groups = "".join(f'<group name="g{k}"><group name="g{k + 1}"/></group>' for k in range(LONG))
    robot = read(tmp_path, chain(3), groups + f'<group name="g{LONG}"><joint name="j1"/></group>')
    assert set(robot.groups.values()) == {("j1",)}


def test_groups_that_name_the_next_one_twice_are_resolved_once(tmp_path):
    """Two to the fortieth otherwise."""
    groups = "".join(f'<group name="g{k}"><group name="g{k + 1}"/><group name="g{k + 1}"/></group>' for k in range(40))
    robot = read(tmp_path, chain(3), groups + '<group name="g40"><chain base_link="l0" tip_link="l2"/></group>')
    assert robot.groups["g0"] == ("j0", "j1")


def test_long_rings_are_named_in_few_words(tmp_path):
    """Of groups and of mimics."""
    groups = "".join(f'<group name="g{k}"><group name="g{(k + 1) % LONG}"/></group>' for k in range(LONG))
    with pytest.raises(InputError, match=r"line 2: .*contain themselves, found g0 in g1 in .* more") as caught:
        read(tmp_path, chain(3), groups)
    assert len(str(caught.value)) < 1000
    ring = chain(LONG, lambda k: f'{LIMIT}<mimic joint="j{(k + 1) % (LONG - 1)}"/>')
    with pytest.raises(InputError, match=r"found a ring: j0, j1, .* more") as caught:
        read(tmp_path, ring)
    assert len(str(caught.value)) < 1000


@pytest.mark.verify
def test_reading_takes_time_in_proportion(tmp_path):
    """Eight times the links and mimics take far less than the 64 or 512 times as long of square or cube."""

    def task(count):
        text = chain(count, lambda k: LIMIT + (f'<mimic joint="j{k - 1}"/>' if k else ""))
        return lambda: read(tmp_path, text)

    task(100)()
    short, long = (min(seconds(task(count)) for _ in range(2)) for count in (500, 4000))
    assert long < 30 * short


@pytest.mark.parametrize("count", [300, pytest.param(6000, marks=pytest.mark.verify)])
def test_more_pairs_than_can_be_checked_are_refused(count, tmp_path, monkeypatch):
    """At once, and with what to do about it."""
    if count < 6000:
        monkeypatch.setattr(checked_pairs, "MOST_PAIRS", 2**15)
    most, found = checked_pairs.MOST_PAIRS, count * (count - 1) // 2
    checker = CollisionChecker(read(tmp_path, chain(count, body=BALL)))
    with pytest.raises(InputError, match=f"expected at most {most} pairs to check, found {found}"):
        checker.collide(np.zeros(count - 1))


def star(count):
    """Links around one without a body."""
    around = "".join(joint(f"j{k}", "hub", f"l{k}", kind="fixed") for k in range(count))
    return links(["hub"]) + links((f"l{k}" for k in range(count)), BALL) + around, None


def chain_apart(count):
    """A chain, and a rule about each link and all others."""
    return chain(count), "".join(f'<disable_default_collisions link="l{k}"/>' for k in range(count))


def chain_in_groups(count):
    """A chain, and many groups of all its joints."""
    group = f'<chain base_link="l0" tip_link="l{count - 1}"/></group>'
    return chain(count), "".join(f'<group name="g{k}">{group}' for k in range(count))


@pytest.mark.parametrize("count", [300, pytest.param(3000, marks=pytest.mark.verify)])
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (star, "joined through links without bodies"),
        (chain_apart, "at most .* pairs"),
        (chain_in_groups, "groups of at most .* joints"),
    ],
)
def test_rules_that_make_millions_are_refused(make, words, count, tmp_path, monkeypatch):
    """A file of some hundred kilobytes must not fill the memory."""
    if count < 3000:
        for module, name in ((tree, "MOST_PAIRS"), (rules, "MOST_PAIRS"), (rules, "MOST_MEMBERS")):
            monkeypatch.setattr(module, name, 2**14)
    with pytest.raises(InputError, match=words):
        read(tmp_path, *make(count))


# -- XML that is none ----------------------------------------------------------------------------

LAUGHS = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot name="r"><link name="&b;"/></robot>'
OUTSIDE = '<!DOCTYPE robot [<!ENTITY a SYSTEM "/etc/passwd">]><robot name="r"><link name="a">&a;</link></robot>'


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda **_: LAUGHS, "the declaration of an entity, 'a'"),
        (lambda **_: OUTSIDE, "the declaration of an entity, 'a'"),
        (
            lambda **_: '<robot name="r">' + "<a>" * 10_000 + "</a>" * 10_000 + "</robot>",
            "100 elements inside each other",
        ),
        (
            lambda elements, **_: '<robot name="r">' + "<a/>" * (elements + 1) + "</robot>",
            "more than {elements} elements",
        ),
        (lambda size, **_: " " * (size + 1), "at most {size} bytes"),
    ],
    ids=["laughs", "outside", "deep", "elements", "bytes"],
)
@pytest.mark.parametrize("share", quick(16, 1))
def test_files_that_would_grow_are_refused(make, words, share, tmp_path, monkeypatch):
    """Robot files with entities, too deep a nesting, too many elements or too many bytes are refused."""
    assert (xml_elements.MOST_ELEMENTS, xml_elements.MOST_BYTES) == (250_000, 2**25)
    limits = {"elements": 250_000 // share, "size": 2**25 // share}
    monkeypatch.setattr(xml_elements, "MOST_ELEMENTS", limits["elements"])
    monkeypatch.setattr(xml_elements, "MOST_BYTES", limits["size"])
    (tmp_path / "robot.urdf").write_text(make(**limits))
    words = words.format(**limits)
    for path, srdf in ((tmp_path / "robot.urdf", None), (written(tmp_path, chain(2), "good"), tmp_path / "robot.urdf")):
        with pytest.raises(FileError, match=words):
            Robot.from_urdf(path, srdf=srdf)


READERS = [Robot.from_urdf, load_scene, read_motion_bench_maker]


@pytest.mark.parametrize("reader", READERS)
def test_only_regular_files_are_read(reader, tmp_path):
    """A pipe would block, a device need not end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero", tmp_path):
        with pytest.raises(FileError, match="no regular file"):
            reader(path)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("path", ["a\0b", "\ud800", "n" * 300, "", b"robot", 3, None])
def test_names_that_no_file_can_have(reader, path):
    """A path that cannot name a file is a FileError or an InputError in every reader."""
    with pytest.raises((FileError, InputError)):
        reader(path)


@pytest.mark.parametrize("name", ["n" * 300 + ".stl", "package://p/" + "n" * 300 + ".stl", "."])
def test_meshes_that_no_file_can_be(name, tmp_path):
    """The error names link and line."""
    with pytest.raises(FileError, match=r"robot.urdf, line 2: expected the mesh .* of link 'a'"):
        read(tmp_path, links("a", f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'))


@pytest.mark.parametrize("cache", [True, False])
def test_meshes_that_cannot_be_read_name_their_link(cache, tmp_path, monkeypatch):
    """A file that is there and gives an error when it is read."""
    if not os.path.exists("/proc/self/mem"):
        pytest.skip("no such file here")
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "mem.stl").symlink_to("/proc/self/mem")
    mesh = '<collision><geometry><mesh filename="mem.stl"/></geometry></collision>'
    with pytest.raises(FileError, match="robot.urdf, line 2, link 'a': .*mem.stl"):
        read(tmp_path, links("a", mesh), cache=cache)


def test_an_axis_without_numbers_is_none(tmp_path):
    """Not x, as where there is no <axis> at all: other readers take it for 0 0 0."""
    with pytest.raises(InputError, match="'xyz' of <axis>"):
        read(tmp_path, chain(2).replace('<axis xyz="0 0 1"/>', "<axis/>"))


def test_shapes_that_make_no_body_name_their_link(tmp_path):
    """A shape that makes no body is refused with file, line and link."""
    shape = '<collision><geometry><box size="1e-300 1 1"/></geometry></collision>'
    with pytest.raises(InputError, match="robot.urdf, line 2, link 'a': "):
        read(tmp_path, links("a", shape))


@pytest.mark.parametrize("number", ["1_0", "1e400", "1e13", "nan", "٣"])
def test_numbers_that_are_none(number, tmp_path):
    """Python takes an underscore for nothing; beyond 1e12 m no length means anything."""
    with pytest.raises(InputError, match=r"line 2: expected .*number"):
        read(tmp_path, links("a", f'<collision><geometry><sphere radius="{number}"/></geometry></collision>'))


# -- limits and factors ----------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [("inf", "inf"), ("-inf", "-inf"), ("1e300", "1e308"), ("-1e308", "-1e7")])
def test_limits_that_leave_no_value_are_refused(limits, tmp_path):
    """Joint limits between which no usable value lies are refused, with line and joint."""
    limit = '<limit lower="{}" upper="{}"/>'.format(*limits)
    with pytest.raises(InputError, match=r"line 2: expected limits that leave joint 'j0' values"):
        read(tmp_path, chain(2, lambda k: limit))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_limits_without_ends_are_told(kind, tmp_path):
    """By URDF's defaults, such a joint cannot move, which hardly anybody means."""
    with pytest.warns(UserWarning, match=r"line 2: joint 'j0' cannot move: expected 'lower' and 'upper'"):
        robot = read(tmp_path, chain(2, lambda k: '<limit effort="1" velocity="1"/>', kind))
    assert robot.lower[0] == robot.upper[0] == 0.0


@pytest.mark.parametrize(
    ("limits", "within"),
    [
        (("-1e308", "1e308"), (-np.pi, np.pi)),
        (("-inf", "inf"), (-np.pi, np.pi)),
        (("-1e16", "1"), (1 - 2 * np.pi, 1)),
        (("-inf", "-4"), (-4 - 2 * np.pi, -4)),
        (("2", "inf"), (2, 2 + 2 * np.pi)),
        (("5", "1e308"), (5, 5 + 2 * np.pi)),
        (("5e5", "5e5"), (5e5, 5e5)),
        (("-3", "4"), (-3, 4)),
    ],
)
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_samples_lie_within_any_limits(limits, within, kind, tmp_path):
    """And fill what is said to be sampled where a limit is infinite or absurd; poses there are numbers."""
    robot = read(tmp_path, chain(2, lambda k: '<limit lower="{}" upper="{}"/>'.format(*limits), kind))
    Q = robot.random_configurations(2000)
    assert (robot.lower <= Q).all()
    assert (robot.upper >= Q).all()
    np.testing.assert_allclose([Q.min(), Q.max()], within, atol=0.02 * (within[1] - within[0]) + 1e-12)
    assert np.isfinite(robot.forward_kinematics(Q)).all()


def test_samples_within_plain_limits_are_what_they_were(arm):
    """Seeds keep their meaning."""
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(arm.random_configurations(50, 3), rng.uniform(-2.0, 2.0, (50, 2)))


def test_factors_that_leave_the_numbers_are_refused(tmp_path):
    """The message names the joints."""
    mimics = ["", '<mimic joint="j0" multiplier="1e9"/>', '<mimic joint="j1" multiplier="1e9"/>']
    with pytest.raises(InputError, match="'j2', which mimics 'j1', which mimics 'j0', to move by a finite multiple"):
        read(tmp_path, chain(4, lambda k: LIMIT + mimics[k]))


@pytest.mark.parametrize("value", [1e201, -1e308, np.nan, np.inf])
def test_values_whose_poses_would_be_no_numbers_are_refused(value, arm):
    """Joint values that would make poses infinite or NaN are refused, with the joint's name."""
    for q in (np.array([0.0, value]), [0.0, value], [[0.0, 0.0], [0.0, value]]):
        with pytest.raises(InputError, match="numbers.* for j1"):
            arm.forward_kinematics(q)


def test_the_largest_values_have_poses(tmp_path):
    """Along a chain of slides that each multiply by the largest factor."""
    far = '<limit lower="-1e300" upper="1e300"/>'
    robot = read(
        tmp_path,
        chain(200, lambda k: far + '<mimic joint="j0" multiplier="1e12"/>' if k else LIMIT, "prismatic")
        + links("z") + joint("turn", "l199", "z", "", "continuous"),
    )  # fmt: skip
    with pytest.warns(UserWarning, match="j0"):
        assert np.isfinite(robot.forward_kinematics([[1e200, 1.0], [-1e200, 1e200]])).all()


# -- degrees and millimetres ---------------------------------------------------------------------


ASK = {
    "collide": lambda robot, q: CollisionChecker(robot).collide(q),
    "a batch": lambda robot, q: CollisionChecker(robot).collide([q, q]),
    "classify": lambda robot, q: CollisionChecker(robot).classify(q),
    "distance": lambda robot, q: CollisionChecker(robot).distance(q),
    "pairs": lambda robot, q: CollisionChecker(robot).pairs(q),
    "valid_edges": lambda robot, q: CollisionChecker(robot).valid_edges(q, q, 0.1),
    "forward_kinematics": lambda robot, q: robot.forward_kinematics(q),
    "configuration": lambda robot, q: robot.configuration(dict(zip(robot.joint_names, q, strict=True))),
}


@pytest.mark.parametrize("ask", ASK.values(), ids=ASK)
def test_degrees_are_told_once_a_robot(ask, tmp_path):
    """With joint, value, limits and the question, at the line of the caller, who is answered all the same."""
    robot = read(tmp_path, chain(4, body=BALL))
    q = np.array([10.0, 1.0, -135.0])[: robot.dof]
    with pytest.warns(UserWarning, match=r"j0 = 10 rad with the limits -2 \.\. 2; is it in degrees\?") as told:
        ask(robot, q)
    assert len(told) == 1
    assert told[0].filename == __file__
    ask(robot, q)  # a warning is an error here
    ask(robot.placed(np.eye(4)), q)
    ask(pickle.loads(pickle.dumps(robot)), q)


@pytest.mark.parametrize(
    ("kind", "inside", "fine", "told"),
    [
        ("revolute", LIMIT, 8.2, 8.4),
        ("revolute", LIMIT, -8.2, -8.4),
        ("continuous", "", 49.0, 51.0),
        ("continuous", "", -49.0, -51.0),
        ("prismatic", '<limit lower="0" upper="0.04"/>', 1.4, 1.5),
        ("prismatic", '<limit lower="-1e308" upper="1e308"/>', 1e9, None),
        ("revolute", '<limit lower="-1e308" upper="100"/>', 100.0, 107.0),
        ("revolute", '<limit lower="100" upper="inf"/>', 120.0, 93.0),
        ("planar", "", 1e7, None),
    ],
)
def test_what_counts_as_far_outside(kind, inside, fine, told, tmp_path):
    """A turn for angles, a metre and ten ways for lengths, eight turns where there is no limit."""
    robot = read(tmp_path, chain(2, lambda k: inside, kind))
    q = np.zeros((3, robot.dof))
    q[1, 0] = fine
    q[[0, 2], 0] = np.clip(0.0, robot.lower[0], robot.upper[0])
    robot.forward_kinematics(q)
    robot.forward_kinematics(q[1])
    if told is not None:
        q[1, 0] = told
        with pytest.warns(UserWarning, match=rf"Q\[1\]: .*j0 = {told:g} "):
            robot.forward_kinematics(q)


def test_a_watch_says_of_one_what_it_says_of_many(rng):
    """With limits of all kinds, and values beside them."""
    ends = np.array([-np.inf, -1e308, -1e7, -3.0, 0.0, 3.0, 1e7, 1e308, np.inf])
    pairs = [(a, b) for a in ends for b in ends if a <= b]
    lower, upper = np.array(pairs).T
    n = len(pairs)
    watch = Watch("r", [f"j{k}" for k in range(n)], lower, upper, rng.random(n) < 0.5, rng.random(n) < 0.2)
    least, most = watch.range
    Q = rng.choice([-1e308, -1e9, -60.0, -9.0, 0.0, 9.0, 60.0, 1e9, 1e308, np.nan, np.inf], (500, n))
    for q in (*Q, np.clip(0.0, least, most)):
        assert watch.passes_one(q.tolist()) == watch.passes(q)
    assert watch.passes(np.clip(0.0, least, most))


def test_a_scene_in_millimetres_is_told_once():
    """Kilometres large or away, or far smaller than a millimetre; a hall and a screw are neither."""
    scene, T = Scene(), np.eye(4)
    T[0, 3] = 1500.0
    scene.add("hall", Body.box([100.0, 60.0, 20.0]), T)
    scene.add("grain", Body.sphere(1e-4))
    with pytest.warns(UserWarning, match="body 'table': expected lengths in metres, found a body .* millimetres"):
        scene.add("table", Body.box([2400.0, 1200.0, 40.0]))
    scene.add("chair", Body.box([2400.0, 1200.0, 40.0]))
    T[0, 3] = 2500.0
    with pytest.warns(UserWarning, match="'far': .*found a place 2500 m away; is it in millimetres"):
        Scene().add("far", Body.sphere(0.1), T)
    with pytest.warns(UserWarning, match="'dust': .*was it scaled twice"):
        Scene().add("dust", Body.sphere(1e-6))


def test_a_scene_far_beyond_the_robot_is_told_once(tmp_path):
    """Small bodies hundreds of metres away are FREE, and probably in millimetres; one body nearby suffices."""
    robot, q, scene, T = gantry_robot(tmp_path), np.zeros(3), Scene(), np.eye(4)
    T[0, 3] = 500.0
    scene.add("part", Body.box([300.0, 200.0, 100.0]), T)
    checker = CollisionChecker(robot, scene)
    with pytest.warns(UserWarning, match="found no body within .* of gantry, .*; is it in millimetres"):
        assert not checker.collide(q)
    scene.add("other", Body.sphere(1.0), T)
    assert not checker.collide(q)
    T[0, 3] = 3.0
    scene.add("shelf", Body.box([1.0, 1.0, 1.0]), T)
    assert not CollisionChecker(robot, scene).collide(q)


def test_a_robot_in_millimetres_is_told_once(tmp_path):
    """A robot whose lengths look like millimetres is warned about once, not for every link."""
    ball = '<collision><geometry><sphere radius="1100"/></geometry></collision>'
    with pytest.warns(UserWarning, match="link 'l0': expected lengths in metres") as told:
        read(tmp_path, chain(3, body=ball))
    assert len(told) == 1


def test_a_mesh_in_millimetres_is_told_once(tmp_path):
    """A mesh without a scale that is wider than any link, one that its hull does not fit; a wide box is no mesh."""
    part = trimesh.util.concatenate([trimesh.creation.box((120, 10, 10)), trimesh.creation.box((10, 120, 10))])
    part.export(tmp_path / "part.stl")
    wide = '<collision><geometry><box size="200 200 1"/></geometry></collision>'
    mesh = '<collision><geometry><mesh filename="part.stl"{}/></geometry></collision>'
    with pytest.warns(UserWarning, match="'l0': expected lengths in metres, found .* is it in millimetres") as told:
        read(tmp_path, chain(2, body=mesh.format("")), cache=False)
    assert len(told) == 1
    read(tmp_path, chain(1, body=wide + mesh.format(' scale="0.001 0.001 0.001"')), cache=False)


def test_origins_in_degrees_are_told_once(tmp_path):
    """In a URDF, and in a scene."""
    text = chain(3).replace('<origin xyz="0.5 0 0"/>', '<origin rpy="0 0 90"/>')
    with pytest.warns(UserWarning, match="line 2: expected roll, pitch and yaw in radians, found 90") as told:
        read(tmp_path, text)
    assert [warning.filename for warning in told] == [read.__code__.co_filename]  # the caller's line
    (tmp_path / "s.yaml").write_text("bodies:\n  a:\n    sphere: {radius: 1}\n    rpy: [0, 0, 90]\n")
    with pytest.warns(UserWarning, match="s.yaml, line 4: expected roll, pitch and yaw in radians, found 90"):
        load_scene(tmp_path / "s.yaml")


@pytest.mark.parametrize("limits", ["-180 .. 180", "0 .. 45", "-720 .. 0"])
def test_limits_in_degrees_are_told_once(tmp_path, limits):
    """Limits of revolute joints that are probably in degrees cause one warning, and those of slides none."""
    lower, upper = limits.split(" .. ")
    text = chain(4, lambda k: f'<limit lower="{lower}" upper="{upper}"/>')
    expected = f"line 2: joint 'j0': expected limits in radians, found {limits}; are they in degrees? (2 more like it)"
    with pytest.warns(UserWarning, match=re.escape(expected)) as told:
        read(tmp_path, text)
    assert len(told) == 1
    read(tmp_path, text.replace("revolute", "prismatic"))


@pytest.mark.parametrize("limit", [12.5, 1000, 1e16])
def test_limits_of_two_turns_and_no_limits_are_plausible(tmp_path, limit):
    """A warning is an error here."""
    read(tmp_path, chain(3, lambda k: f'<limit lower="{-limit}" upper="{limit}"/>'))


def test_the_order_of_quaternions_is_said(tmp_path):
    """It cannot be told from the numbers."""
    assert "quaternions wxyz" in repr(read(tmp_path, chain(2, lambda k: "", "floating")))
    assert "quaternions" not in repr(read(tmp_path, chain(2)))


# -- scenes and problems in files ----------------------------------------------------------------


def bomb(levels, width):
    """Lists of lists of lists, each naming the one before `width` times."""
    text = "bodies: {}\nallow:\n- &a0 [x, y]\n"
    return text + "".join(f"- &a{k + 1} [{', '.join([f'*a{k}'] * width)}]\n" for k in range(levels))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (bomb(40, 10), r"line \d+: .*more than 2000000 entries"),
        ("bodies: " + "[" * 60 + "]" * 60, "more than 50 entries inside each other"),
        ("bodies: " + "{a: " * 5000, "more than 50 entries inside each other"),
        ("#" * (2**24 + 1), "at most 16777216 bytes"),
        ("bodies: {a: {sphere: {radius: 1_0}}}", "expected a finite number, found '1_0'"),
        (f"bodies: {{a: {{{'x' * 1000}: 1}}}}", "expected one shape"),
    ],
)
def test_scenes_that_would_grow_are_refused(text, words, tmp_path):
    """Scene files that expand, nest too deep or are too large are refused in a short message."""
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        load_scene(tmp_path / "s.yaml")
    assert len(str(caught.value)) < 2000


@pytest.mark.verify
def test_a_body_that_many_aliases_name_is_counted_each_time(tmp_path):
    """Ten thousand points under a thousand names would be walked through ten million times."""
    points = ", ".join(f"[{x}, {x * x % 7}, {x * x % 11}]" for x in range(10_000))
    others = "".join(f"  b{k}: *a\n" for k in range(1000))
    (tmp_path / "s.yaml").write_text(f"bodies:\n  a: &a {{points: [{points}]}}\n{others}")
    with pytest.raises(FileError, match="aliases counted each time"):
        load_scene(tmp_path / "s.yaml")


def test_aliases_that_stay_small_are_read(tmp_path):
    """YAML aliases are read where they do not make a file grow."""
    (tmp_path / "s.yaml").write_text(
        "bodies:\n  a: {sphere: &s {radius: 0.5}}\n  b: {sphere: *s, position: &p [3, 0, 0]}\n"
    )
    scene = load_scene(tmp_path / "s.yaml")
    assert scene.names == ("a", "b")
    assert not scene.collide()


@pytest.mark.parametrize("name", ['"a\\0b.stl"', '"\\ud800.stl"', "n" * 300 + ".stl", "."])
@pytest.mark.parametrize("key", ["mesh", "saved"])
def test_scenes_that_name_no_file(key, name, tmp_path):
    """A scene entry whose path cannot name a file is refused with line and body."""
    (tmp_path / "s.yaml").write_text(f"bodies:\n  a: {{{key}: {name}}}\n")
    with pytest.raises(FileError, match="s.yaml, line 2: bodies/a/"):
        load_scene(tmp_path / "s.yaml")


PROBLEM = {"index": 1, "problem": "p", "start": [0.0], "goals": [[1.0]], "sphere": []}


def problems(**change):
    return {"robot": "r", "joints": ["a"], "problems": {"p": [dict(PROBLEM)]}, **change}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 200_000, "too many entries inside each other"),
        (json.dumps(problems(robot=eval("[" * 60 + "]" * 60))), "robot: expected a name, found a sequence of 1"),
        (json.dumps(problems(joints=["a", "a"])), "expected each joint once, found 'a' again"),
        (json.dumps(problems(robot=["x" * 10_000])), "robot: expected a name"),
        ('{"' + '": 1, "'.join(f"k{k}" for k in range(50_000)) + '": 1, "k7": 2}', "found 'k7' again"),
        (
            json.dumps(problems()).replace("1.0", "1" + "0" * 5000),
            "in JSON, found something else|finite number",
        ),
    ],
)
def test_problems_that_would_grow_are_refused(text, words, tmp_path):
    """Planning problems that nest too deep or repeat keys are refused in a short message."""
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        read_motion_bench_maker(tmp_path / "p.json")
    assert len(str(caught.value)) < 2000


def test_problems_in_other_encodings_are_read(tmp_path):
    """Those that JSON allows, with and without a mark."""
    text = json.dumps(problems())
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-32"):
        (tmp_path / "p.json").write_bytes(text.encode(encoding))
        (problem,) = read_motion_bench_maker(tmp_path / "p.json")
        assert problem.robot == "r"
    (tmp_path / "p.json").write_bytes(b'\xff\xfe"')
    with pytest.raises(FileError):
        read_motion_bench_maker(tmp_path / "p.json")


# -- other threads -------------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", quick(0.4, 1.5))
def test_a_scene_may_change_while_others_ask(arm, seconds):
    """Each answer is that of some moment: all or none of what a change moves, and no errors but documented ones."""
    scene = Scene()
    for k in range(30):
        scene.add(f"s{k}", Body.sphere(0.01), [[1, 0, 0, 50 + k], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    checker = CollisionChecker(arm, scene)
    q, far, near = np.zeros(2), np.eye(4), np.eye(4)
    far[2, 3] = 30.0
    unexpected, stop = [], threading.Event()

    def change(seed):
        rng = np.random.default_rng(seed)
        while not stop.is_set():
            name = f"x{seed}-{rng.integers(5)}"
            try:
                if name in scene:
                    scene.remove(name)
                else:
                    scene.add(name, Body.sphere(0.01), far)
                    scene.allow(name, "s0")
                    scene.attach(name, "l2")
                    scene.detach(name, far)
                    scene.set_margin(0.01, name)
                scene.move({"s1": far, "s2": far})
            except Exception as error:
                unexpected.append(error)

    def ask():
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            try:
                checker.collide(q)
                checker.distance(q)
                scene.collide()
                scene.pairs()
                pickle.dumps(scene)
                scene.copy()
                _ = scene.margins, scene.allowed, scene.attachments, scene.static_poses, list(scene.names)
            except Exception as error:
                unexpected.append(error)

    changing = [threading.Thread(target=change, args=(k,)) for k in range(2)]
    asking = [threading.Thread(target=ask) for _ in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for thread in (*changing, *asking):
            thread.start()
        for thread in asking:
            thread.join()
        stop.set()
        for thread in changing:
            thread.join()
    assert not [error for error in unexpected if not isinstance(error, LoewnerError)]
    assert not unexpected
    fresh = CollisionChecker(arm, scene)
    assert checker.checked_pairs == fresh.checked_pairs
    scene.move("s0", near)
    assert checker.collide(q)


# -- texts ---------------------------------------------------------------------------------------------


def test_a_text_is_what_a_file_of_it_would_be(tmp_path, monkeypatch):
    """A robot of a text is that of a file with the text; its meshes are sought from the working directory."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.1, 0.2, 0.3)).export("part.stl")
    inside = chain(3) + (
        '<link name="tööl"><collision><geometry><mesh filename="part.stl"/></geometry></collision></link>'
        + joint("grip", "l0", "tööl")
    )
    there = read(tmp_path, inside)
    for declared in ("", '<?xml version="1.0" encoding="latin-1"?>'):  # of the file that the text may have been in
        here = Robot.from_urdf(text=f'{declared}<robot name="r">{inside}</robot>')
        assert here.link_names == there.link_names
        assert here.configuration_names == there.configuration_names
        assert here.bodies.keys() == there.bodies.keys()
        assert np.array_equal(here.bodies["tööl"].pieces[0].vertices, there.bodies["tööl"].pieces[0].vertices)


@pytest.mark.parametrize(
    ("given", "kind", "words"),
    [
        ({}, InputError, "found None, and no text"),
        ({"path": "robot.urdf", "text": "<robot/>"}, InputError, "found both"),
        ({"text": 3}, InputError, "text: expected the text of a URDF, found 3"),
        ({"text": "robot.urdf"}, FileError, "URDF text, line 1: expected a URDF, found broken XML"),
        ({"text": "<robot>\ud800</robot>"}, InputError, "a character that no file can have"),
        ({"text": "x" * (2**25 + 1)}, InputError, "at most 33554432 bytes"),
        ({"path": " <robot/>"}, InputError, "found XML text; pass it as text="),
    ],
)
def test_bad_texts_are_refused(given, kind, words):
    """Neither or both of path and text, and what is no text of a robot."""
    with pytest.raises(kind, match=words):
        Robot.from_urdf(**given)
