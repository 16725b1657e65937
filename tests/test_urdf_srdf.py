"""URDF and SRDF: each part is used, known to be harmless, or told; limits of joints, versions, encodings, links."""

import copy
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

from loewner import Body, CollisionChecker, FileError, InputError, PlanningError, Robot, collide, planners, verify
from loewner.robots.description.robot import sources_of
from loewner.robots.description.srdf import read_srdf
from loewner.robots.description.urdf import read_urdf
from robot_oracle import robots_folder

HARD = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
SOFT = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.25" k_position="10" k_velocity="10"/>'
BOX = '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>'


def text(link="", joint="", top="", attributes="", limit=HARD, kind="revolute"):
    """Two links and a joint about z between them, each with more inside."""
    return (
        f'<robot name="r" {attributes}>\n{top}<link name="a">{BOX}</link>\n<link name="b">{BOX}{link}</link>\n'
        f'<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{joint}'
        f'<axis xyz="0 0 1"/>{limit}</joint></robot>'
    )


def read(**parts):
    return Robot.from_urdf(text=text(**parts))


def told(read):
    """The texts of all warnings, which are one for each file and kind, and what was read."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = read()
    return made, [str(one.message) for one in caught]


def at(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


# -- parts that URDF does not have ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "name"),
    [
        ({"link": f"<Collision>{BOX}</Collision>"}, r"<Collision> in <link> \(line 3\)"),
        ({"link": "<colision/><colision/>"}, r"<colision> in <link> \(line 3, and 1 more times\)"),
        ({"link": f"<group>{BOX}</group>"}, "<group> in <link>"),
        ({"link": f"<inertial>{BOX}</inertial>"}, "<collision> in <inertial>"),
        ({"link": '<origin xyz="2 0 0"/>'}, "<origin> in <link>"),
        ({"link": BOX.replace("/></geom", '><origin xyz="2 0 0"/></box></geom')}, "<origin> in <box>"),
        ({"link": BOX.replace("<box", '<box scale="2 2 2"')}, "<box scale>"),
        ({"joint": "<pose>1 0 0 0 0 0</pose>"}, "<pose> in <joint>"),
        ({"joint": '<Origin xyz="1 0 0"/>'}, "<Origin> in <joint>"),
        ({"limit": '<limit lower="-9" upper="9" min="-1" max="1"/>'}, r"<limit min> \(line 4\), <limit max>"),
        ({"limit": '<limit lower="-9" upper="9" unit="deg"/>'}, "<limit unit>"),
        ({"limit": HARD.replace("effort", 'acceleration="2" jerk="3" effort')}, "<limit acceleration>.*, <limit jerk>"),
        ({"limit": HARD.replace('velocity="1"', 'velocity="-1"')}, "<limit velocity>"),
        ({"kind": "continuous"}, "<limit lower>.*, <limit upper>"),
        ({"kind": "continuous", "limit": SOFT}, "<safety_controller soft_lower_limit>"),
        ({"limit": HARD + SOFT.replace("-0.5", "2")}, "<safety_controller soft_lower_limit>"),
        ({"top": '<loop_joint name="l"><link1 link="a"/></loop_joint>'}, r"<loop_joint> in <robot> \(line 2\)"),
        ({"link": '<collision_checking><capsule name="c"/></collision_checking>'}, "<collision_checking> in <link>"),
        ({"top": '<jiont name="k" type="fixed"><parent link="a"/></jiont>'}, "<jiont> in <robot>"),
        ({"top": f'<gazebo><link name="x">{BOX}</link></gazebo>'}, "<link> in <gazebo>"),
        ({"top": '<gazebo><model><joint name="x"><parent>a</parent></joint></model></gazebo>'}, "<joint> in <gazebo>"),
    ],
)
def test_parts_that_are_not_read_are_told_once(parts, name):
    """One warning for the file, with the names of the parts and their lines."""
    _, words = told(lambda: read(**parts))
    assert len(words) == 1
    assert words[0].startswith("URDF text: some parts are ignored, since URDF does not define them")
    with pytest.warns(UserWarning, match=name):
        read(**parts)


def test_many_unread_parts_make_a_short_message():
    """The first eight are named, and the rest are counted."""
    _, (words,) = told(lambda: read(link="".join(f"<part{k}/>" for k in range(20))))
    assert "<part7> in <link> (line 3), and 12 more" in words
    assert "part8" not in words


@pytest.mark.parametrize(
    "parts",
    [
        {"top": '<material name="m"/><transmission name="t"><joint name="j"><x/></joint></transmission>'},
        {"top": "<gazebo><plugin><joint>j</joint></plugin><contact><collision>c</collision></contact></gazebo>"},
        {"link": '<inertial><mass value="1"/></inertial><visual><geometry><box size="9 9 9"/></geometry></visual>'},
        {"link": '<origin xyz="0 0 0" rpy="0 0 0"/><contact><x/></contact><self_filter/><gravity/>'},
        {"joint": '<dynamics damping="1"/><calibration rising="1"/>'},
        {"kind": "continuous", "limit": '<limit lower="0" upper="0" effort="1" velocity="1"/>'},
        {"kind": "continuous", "limit": '<safety_controller soft_lower_limit="0" soft_upper_limit="0"/>'},
        {"kind": "fixed", "limit": HARD + SOFT + '<mimic joint="x"/>'},
        {"attributes": 'version="1.0" xmlns:xacro="http://www.ros.org/wiki/xacro"'},
    ],
)  # fmt: skip
def test_harmless_parts_are_quiet(parts):
    """Colours, plugins, dynamics and the like: warnings are errors here."""
    read(**parts)


def test_values_of_joints_have_names_of_their_own():
    """A planar joint j has a value j/x, so that no other joint can have this name."""
    top = """<link name="e"/><joint name="k" type="planar"><parent link="a"/><child link="e"/></joint>
    <link name="f"/><joint name="k/x" type="prismatic"><parent link="a"/><child link="f"/>
    <limit lower="0" upper="1" velocity="1"/></joint>"""
    with pytest.raises(InputError, match="expected values with different names, found two of 'k/x'"):
        read(top=top)


@pytest.mark.parametrize(
    ("parts", "tag"),
    [
        ({"link": BOX.replace("</coll", '<geometry><box size="4 4 4"/></geometry></coll')}, "geometry"),
        ({"limit": HARD + HARD}, "limit"),
        ({"limit": HARD + SOFT + SOFT}, "safety_controller"),
        ({"limit": HARD + '<axis xyz="1 0 0"/>'}, "axis"),
        ({"joint": '<origin xyz="1 0 0"/><origin xyz="0 5 0"/>'}, "origin"),
        ({"joint": '<child link="a"/>'}, "child"),
        ({"joint": '<parent link="a"/>'}, "parent"),
        ({"limit": HARD + '<mimic joint="j"/><mimic joint="j"/>'}, "mimic"),
    ],
)
def test_the_second_of_one_is_refused(parts, tag):
    """With its line, and that of the first."""
    with pytest.raises(InputError, match=rf"line \d: expected one <{tag}> in <.*>, found another one in line \d"):
        read(**parts)


CONTROL = (
    '<ros2_control name="s" type="system"><joint name="j"><command_interface name="{}"><param name="min">{}</param>'
    '<param name="max">{}</param></command_interface>{}</joint></ros2_control>'
)


@pytest.mark.parametrize(
    ("top", "words"),
    [
        (CONTROL.format("position", -0.1, 0.1, ""), r"position of 'j' in <ros2_control> \(line 2\)"),
        (CONTROL.format("velocity", -0.1, 0.1, ""), "velocity of 'j'"),
        (CONTROL.format("position", -1, 1, '<param name="mimic">k</param>'), "mimic of 'j' in <ros2_control>"),
        ("<gazebo><plugin><mimicJoint> j </mimicJoint></plugin></gazebo>", "mimic of 'j' in <gazebo>"),
        (CONTROL.format("position", -0.999, 1, ""), None),  # rounded
        (CONTROL.format("effort", -0.1, 0.1, ""), None),
        (CONTROL.format("position", "{lower}", 1, ""), None),
        ("<gazebo><plugin><mimicJoint>k</mimicJoint></plugin></gazebo>", None),
    ],
)
def test_limits_and_mimics_in_extensions_are_told(top, words):
    """Unless the joint has them as well; joints that the robot lacks are none of its business."""
    _, found = told(lambda: read(top=top))
    assert len(found) == (words is not None)
    if words is not None:
        with pytest.warns(UserWarning, match=f"limits and mimics in extensions are ignored, .*{words}"):
            read(top=top)


# -- limits ---------------------------------------------------------------------------------------


def ends(robot):
    return [array.tolist() for array in (robot.lower, robot.upper, robot.hard_lower, robot.hard_upper)]


def test_soft_limits_narrow_what_is_sampled_planned_and_reached():
    """The hard limits stay as in the file, and follow the robot wherever it goes."""
    robot = read(limit=HARD + SOFT)
    assert ends(robot) == [[-0.5], [0.25], [-1.0], [1.0]]
    Q = robot.random_configurations(1000)
    assert -0.5 <= Q.min() < -0.49
    assert 0.24 < Q.max() <= 0.25
    beyond = robot.forward_kinematics([0.5])[1]
    assert not robot.reach("b", beyond).reached
    assert robot.reach("b", robot.forward_kinematics([0.2])[1]).reached
    for other in (pickle.loads(pickle.dumps(robot)), copy.deepcopy(robot), robot.placed(at(1, 2, 3))):
        assert ends(other) == ends(robot)
        assert not other.hard_lower.flags.writeable
    both = Robot.join({"one": robot, "two": read()}).add_base("planar", [[-3, 3], [-2, 2]])
    both = both.with_body("door", Body.sphere(0.1), joint="prismatic", limits=(0, 2))
    inf = np.inf
    assert ends(both) == [
        [-3, -2, -inf, -0.5, -1, 0], [3, 2, inf, 0.25, 1, 2], [-3, -2, -inf, -1, -1, 0], [3, 2, inf, 1, 1, 2],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("soft", "expected"),
    [
        ('soft_lower_limit="-0.5"', (-0.5, 1)),
        ('soft_upper_limit="0.5"', (-1, 0.5)),
        ('soft_lower_limit="-9" soft_upper_limit="9"', (-1, 1)),
        ('k_velocity="5"', (-1, 1)),
    ],
)
def test_soft_limits_of_one_side_or_none(soft, expected):
    """A limit that is not written, or lies outside the hard ones, narrows nothing."""
    robot = read(limit=f"{HARD}<safety_controller {soft}/>")
    assert (robot.lower[0], robot.upper[0]) == expected


ARM = text(limit=HARD + SOFT).replace('"r" ', '"arm" ').replace("<axis", '<origin xyz="1 0 0"/><axis')


def test_a_plan_may_start_between_the_soft_and_the_hard_limit():
    """With a warning that names the joint, by all planners; its goals are within the range from the start on."""
    robot = Robot.from_urdf(text=ARM)
    checker = CollisionChecker(robot)
    beside = r"start: expected a configuration within the soft limits, found j = 0.9 outside -0.5 .. 0.25"
    made = planners.roadmap(checker, 100)
    for ask in (
        lambda: planners.plan(checker, [0.9], [0.0]),
        lambda: planners.plan(checker, [0.9], [0.0], start_time=0.0).positions([0.0, 0.9]),
        lambda: made.path([0.9], [0.0]),
    ):
        with pytest.warns(UserWarning, match=beside):
            path = np.asarray(ask()).reshape(-1)
        assert (path[0], path[-1]) == pytest.approx((0.9, 0.0), abs=1e-8)
    with pytest.raises(PlanningError, match=r"start: .* found j = 1.1 outside -0.5 .. 0.25"):
        planners.plan(checker, [1.1], [0.0])
    with pytest.raises(PlanningError, match=r"goal: .* found j = 0.9 outside -0.5 .. 0.25"):
        planners.plan(checker, [0.0], [0.9])
    assert planners.plan(checker, [0.0], [0.2]).tolist() == [[0.0], [0.2]]


def test_a_line_may_start_between_the_soft_and_the_hard_limit():
    """It leads back into the range, and no further out."""
    robot = Robot.from_urdf(text=ARM.replace('type="revolute"', 'type="prismatic"'))
    checker, inwards, outwards = CollisionChecker(robot), *robot.forward_kinematics([[0.2], [0.95]])[:, 1]
    with pytest.warns(UserWarning, match="j = 0.9 outside"):
        assert planners.straight(checker, [0.9], "b", inwards)[-1] == pytest.approx(0.2)
    with pytest.warns(UserWarning, match="j = 0.9 outside"), pytest.raises(PlanningError, match="cannot go on"):
        planners.straight(checker, [0.9], "b", outwards)


def test_proofs_and_limit_files_have_the_hard_limits(tmp_path):
    """A path that starts outside the soft limits is within limits all the same."""
    robot = Robot.from_urdf(text=ARM)
    with pytest.warns(UserWarning, match="soft limits"):
        plan = planners.plan(CollisionChecker(robot), [0.9], [0.0], full=True, proof=True)
    plan.proof.save(tmp_path / "proof")
    assert "NOT within limits" not in str(verify.verify((tmp_path / "proof").read_bytes()))
    (tmp_path / "limits.yaml").write_text("joint_limits: {j: {max_velocity: 0.5}}")
    limits = planners.JointLimits.load(tmp_path / "limits.yaml", robot)
    assert planners.trajectory(robot, plan.path, limits=limits).duration > 0


def follower(lower, upper, rest=""):
    return (
        '<link name="c"/><joint name="k" type="revolute"><parent link="b"/><child link="c"/>'
        f'<limit lower="{lower}" upper="{upper}"/><mimic joint="j" {rest}/></joint>'
    )


@pytest.mark.parametrize(
    ("top", "expected"),
    [
        (follower(0, 1, 'multiplier="0.5"'), (0, 1)),
        (follower(-1, 0, 'multiplier="-2"'), (0, 0.5)),
        (follower(0, 1, 'multiplier="2" offset="1"'), (-0.5, 0)),
        (follower(-9, 9), (-1, 1)),
        (follower(-1 + 1e-12, 1), (-1, 1)),  # rounding
        (follower(0, 1, 'multiplier="0" offset="0.5"'), (-1, 1)),
    ],
)
def test_limits_of_mimics_narrow_the_joint_that_they_follow(top, expected):
    """Each follower is within its own limits at all values within the range of its leader."""
    robot = read(top=top)
    assert (robot.lower[0], robot.upper[0]) == pytest.approx(expected)
    assert (robot.hard_lower[0], robot.hard_upper[0]) == (-1, 1)


def test_limits_of_mimics_that_leave_hardly_anything_are_told():
    """They were never used, as in the grippers of the PR2."""
    with pytest.warns(UserWarning, match=r"line 2: expected limits of 'k' that leave 'j', which it mimics, a range"):
        robot = read(top=follower(0.95, 2))
    assert (robot.lower[0], robot.upper[0]) == (-1, 1)


def test_limits_of_urdf_1_2():
    """Accelerations and jerk are read from version 1.2 on, the smaller of acceleration and deceleration, for mimics."""
    limit = HARD.replace("effort", 'acceleration="0.2" deceleration="0.1" jerk="0.5" effort')
    robot = read(attributes='version="1.2"', limit=limit)
    assert (robot.velocity.tolist(), robot.acceleration.tolist(), robot.jerk.tolist()) == ([1.0], [0.1], [0.5])
    fast = limit.replace("<limit", "<limit ").replace('lower="-1" upper="1"', 'lower="-9" upper="9"')
    slower = follower(0, 0).replace('<limit lower="0" upper="0"/>', fast).replace("<mimic ", '<mimic multiplier="2" ')
    assert read(attributes='version="1.2"', top=slower).acceleration.tolist() == [0.05]
    moved = planners.trajectory(robot, [[-1.0], [1.0]])
    t = np.linspace(0, moved.duration, 2001)
    assert np.abs(moved.accelerations(t)).max() <= 0.1 * (1 + 1e-9)
    swift = planners.trajectory(robot, [[-1.0], [1.0]], acceleration=2.0, jerk=100.0)
    assert swift.duration < moved.duration
    old = read()
    assert np.isnan([*old.acceleration, *old.jerk]).all()


# -- versions, rotations, encodings, links ----------------------------------------------------------


@pytest.mark.parametrize("version", ["2.0", "0.9", "banana", "1.1.1", ""])
def test_versions_that_do_not_exist_are_refused(version):
    """Only versions of URDF that exist are read."""
    with pytest.raises(
        InputError, match=f"line 1: expected URDF of version 1.0, 1.1 or 1.2, found version '{version}'"
    ):
        read(attributes=f'version="{version}"')


def test_newer_versions_are_told():
    """Their additions are not known, but the rest is read."""
    with pytest.warns(UserWarning, match="expected URDF up to version 1.2, found 1.3"):
        read(attributes='version="1.3"')
    for version in ("1", "1.0", "1.1", "1.2"):
        read(attributes=f'version="{version}"')


H = repr(0.5**0.5)


def test_quaternions_of_urdf_1_1():
    """A quarter turn about z: a bar along y, and a slide along y."""
    origin = f'<origin xyz="0 0 0" quat_xyzw="0 0 {H} {H}"/>'
    bar = f'<collision>{origin}<geometry><box size="2 0.1 0.1"/></geometry></collision>'
    robot = read(link=bar, joint=origin, kind="prismatic", attributes='version="1.1"')
    for point, meets in ((at(0, 0.9, 0), True), (at(0.9, 0, 0), False)):
        assert bool(collide(robot.bodies["b"], None, Body.sphere(0.05), point)) == meets
    slid = read(joint=origin, kind="continuous", limit="", attributes='version="1.1"').forward_kinematics([0.0])[1]
    np.testing.assert_allclose(slid[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize(
    ("origin", "version", "words"),
    [
        (f'quat_xyzw="0 0 {H} {H}"', "1.0", "only xyz and rpy as attributes of <origin>, found 'quat_xyzw'; .*version"),
        (f'rpy="0 0 1" quat_xyzw="0 0 {H} {H}"', "1.1", "one rotation of an <origin>, found two"),
        ('quat_xyzw="0 0 1 1"', "1.1", "a unit quaternion as 'quat_xyzw' of <origin>, found one of length 1.414"),
        ('quat_xyzw="0 0 1"', "1.1", "4 numbers as 'quat_xyzw'"),
        ('wxyz="1 0 0 0"', "1.1", "only xyz, rpy and quat_xyzw as attributes of <origin>, found 'wxyz'"),
    ],
)
def test_rotations_that_are_none_are_refused(origin, version, words):
    """A quaternion has norm 1, and stands alone."""
    with pytest.raises(InputError, match=f"line 4: expected {words}"):
        read(joint=f"<origin {origin}/>", attributes=f'version="{version}"')


@pytest.mark.parametrize("codec", ["UTF-8", "ISO-8859-1", "GB2312", "Shift_JIS"])
def test_encodings_of_a_urdf(codec, tmp_path):
    """The declared one counts, whether expat has it or not."""
    name = "é" if codec == "ISO-8859-1" else "山本"
    written = f'<?xml version="1.0" encoding="{codec}"?>\n' + text().replace('name="b"', f'name="{name}"').replace(
        'link="b"', f'link="{name}"'
    )
    (tmp_path / "r.urdf").write_bytes(written.encode(codec))
    assert Robot.from_urdf(tmp_path / "r.urdf").link_names == ("a", name)


def cube(path: Path, size: float):
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x in (0, size) for y in (0, size) for z in (0, size))
        + "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    )


def test_meshes_of_a_urdf_that_is_a_symbolic_link(tmp_path):
    """They are beside the link, as scenes', or beside its target; two that differ are refused."""
    linked, target = tmp_path / "link" / "r.urdf", tmp_path / "target" / "r.urdf"
    cube(tmp_path / "target" / "p.obj", 1)
    (tmp_path / "link").mkdir()
    mesh = '<collision><geometry><mesh filename="p.obj"/></geometry></collision>'
    target.write_text(f'<robot name="r"><link name="p">{mesh}</link></robot>')
    linked.symlink_to("../target/r.urdf")
    corner = at(4, 4, 4)
    assert not collide(Robot.from_urdf(linked).bodies["p"], None, Body.sphere(0.1), corner)
    cube(tmp_path / "link" / "p.obj", 1)
    Robot.from_urdf(linked)  # two copies of one file
    cube(tmp_path / "link" / "p.obj", 5)
    with pytest.raises(FileError, match="line 1: expected one mesh 'p.obj' of link 'p', found two that differ"):
        Robot.from_urdf(linked)
    (tmp_path / "target" / "p.obj").unlink()
    assert collide(Robot.from_urdf(linked).bodies["p"], None, Body.sphere(0.1), corner)
    assert sources_of(Robot.from_urdf(linked))[0].path == linked


# -- SRDF -------------------------------------------------------------------------------------------

TREE = (
    '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
    f'<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{HARD}</joint>'
    '<joint name="k" type="planar"><parent link="b"/><child link="c"/></joint></robot>'
)
GROUP = '<group name="arm"><joint name="j"/><joint name="k"/></group>'
HOME = '<group_state name="home" group="arm"><joint name="j" value="0.5"/></group_state>'
PAIR = '<disable_collisions link1="a" link2="b" reason="Adjacent"/>'


def with_srdf(folder, inside):
    (folder / "r.urdf").write_text(TREE)
    (folder / "r.srdf").write_text(f'<robot name="r">\n{inside}{PAIR}</robot>')
    return Robot.from_urdf(folder / "r.urdf", srdf=folder / "r.srdf")


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<group name="arm"><joints name="j"/><joint name="k"/></group>', "<joints> in <group> .line 2"),
        (GROUP + HOME.replace("<joint", "<Joint"), "<Joint> in <group_state>"),
        (GROUP + HOME.replace("value", 'unit="deg" value'), "<joint unit>"),
        (GROUP + HOME.replace("group=", "grp="), "<group_state grp>"),
        (GROUP + HOME.replace("</group_state>", "<x/></group_state>"), "<x> in <group_state>"),
        ("<collision_margins/>", "<collision_margins> in <robot>"),
        ('<disable_collisions link1="a" link2="c" why="x"/>', "<disable_collisions why>"),
        ('<group name="arm"><joint name="j"/></group>' + HOME.replace('"j"', '"k"').replace("0.5", "1 0 0"),
         r"joints of a state's group, found others, which are used: 'k' in 'home' \(line 2\)"),
        ('<virtual_joint name="v" type="fixed" parent_frame="w" child_link="c"/>', "'a', the root, below .* found 'c'"),
        ('<virtual_joint name="v" type="planar" parent_frame="w" child_link="a"/>'
         + GROUP + HOME.replace("</group_state>", '<joint name="v" value="1 0 0"/></group_state>'),
         r"states that place the base leave it where it is .*: 'home' \(line 2\)"),
        ('<joint_property joint_name="k" property_name="motion_model" value="diff_drive"/>',
         "line 2: the motion model 'diff_drive' of 'k' is not used: motions are straight lines"),
    ],
)  # fmt: skip
def test_parts_of_an_srdf_that_have_no_effect_are_told(inside, words, tmp_path):
    """One warning names them with their lines."""
    with pytest.warns(UserWarning, match=words):
        with_srdf(tmp_path, inside)


def test_harmless_parts_of_an_srdf_are_quiet(tmp_path):
    """Warnings are errors here; a base that a state puts where it is anyway is one of them."""
    robot = with_srdf(
        tmp_path,
        GROUP
        + '<end_effector name="e" parent_link="b" group="arm"/><gripper name="g"><link name="b"/></gripper>'
        + '<virtual_joint name="v" type="floating" parent_frame="w" child_link="a"/>'
        + '<joint_property joint_name="j" property_name="weight" value="3"/>'
        + '<joint_property joint_name="v" property_name="motion_model" value="holonomic"/>'
        + HOME.replace("</group_state>", '<joint name="v" value="0 0 0 0 0 0 1"/></group_state>'),
    )
    assert robot.groups == {"arm": ("j", "k")}
    assert robot.states == {"home": ("arm", {"j": 0.5})}


def test_passive_joints_are_in_no_group(tmp_path):
    """They have no motor; their values in states are kept, since they are where the joints rest."""
    with pytest.warns(UserWarning, match=r"passive joints are left out of groups, .*: 'j' \(line 2\)"):
        robot = with_srdf(tmp_path, GROUP + HOME + '<passive_joint name="j"/>')
    assert robot.groups == {"arm": ("k",)}
    assert robot.states["home"] == ("arm", {"j": 0.5})


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        (GROUP + HOME + "\n" + HOME, "line 3: expected each state of a group once, found 'home' again"),
        (GROUP + HOME.replace("</group_state>", '\n<joint name="j" value="1"/></group_state>'),
         "line 3: expected each name of a joint once"),
    ],
)  # fmt: skip
def test_a_state_or_a_joint_of_it_twice_is_refused(inside, words, tmp_path):
    """Only one of two values could count."""
    with pytest.raises(InputError, match=words):
        with_srdf(tmp_path, inside)


def test_known_srdf_files_have_no_unknown_parts():
    """Of example-robot-data, none has an element or attribute that is neither read nor listed."""
    robot = read_urdf(robots_folder() / "panda_description/urdf/panda.urdf")
    for path in sorted(robots_folder().rglob("*.srdf")):
        try:
            _, words = told(lambda path=path: read_srdf(path, robot))
        except Exception:  # for another robot
            continue
        assert not any("does not define them" in one for one in words), (path, words)


# -- rules on pairs -------------------------------------------------------------------------------

BALL = '<collision><geometry><sphere radius="1"/></geometry></collision>'
THREE = f"""<robot name="r"><link name="a">{BALL}</link><link name="b">{BALL}</link><link name="c">{BALL}</link>
<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>
<joint name="k" type="continuous"><parent link="b"/><child link="c"/></joint></robot>"""


@pytest.mark.parametrize(
    ("rules", "pairs"),
    [
        ("", ["ac"]),
        ('<enable_collisions link1="a" link2="b"/>', ["ab", "ac", "bc"]),
        ('<disable_default_collisions link="a"/><enable_collisions link1="a" link2="b"/>'
         '<enable_collisions link1="a" link2="c"/>', ["ab", "ac", "bc"]),
        ('<disable_collisions link1="a" link2="c"/>', ["ab", "bc"]),
        ('<disable_collisions link1="a" link2="camera"/>', ["ab", "ac", "bc"]),
        ('<disable_collisions link1="a" link2="a"/>', ["ab", "ac", "bc"]),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.* entries are left out:UserWarning")
def test_adjacent_links_are_checked_where_there_are_rules(rules, pairs, tmp_path):
    """A rule that disables nothing, or names a link that the robot lacks, exempts no other pair."""
    (tmp_path / "r.srdf").write_text(
        f'<robot name="r"><group name="g"><joint name="j"/></group>{rules}</robot>', encoding="utf-8"
    )
    robot = Robot.from_urdf(text=THREE, srdf=tmp_path / "r.srdf")
    for one in (robot, robot.placed(np.eye(4)), robot.disabling([]), pickle.loads(pickle.dumps(robot))):
        assert sorted("".join(sorted(pair)) for pair in CollisionChecker(one).checked_pairs) == pairs
    two = Robot.join({"x": robot, "y": Robot.from_urdf(text=THREE)})
    within = [pair for pair in CollisionChecker(two).checked_pairs if pair[0][0] == pair[1][0] == "x"]
    assert sorted("".join(sorted(name[-1] for name in pair)) for pair in within) == pairs


def test_states_that_would_overwrite_each_other_are_refused(tmp_path):
    """The name of a state is unique in its group; "g/s" stands for the second state "s"."""
    joint = '<joint name="j" value="{}"/>'
    states = [("g/s", "h", 1), ("s", "h", 2), ("s", "g", 3)]
    (tmp_path / "r.srdf").write_text(
        '<robot name="r"><group name="g"><joint name="j"/></group><group name="h"><joint name="j"/></group>'
        + "".join(f'<group_state name="{n}" group="{g}">{joint.format(v)}</group_state>' for n, g, v in states)
        + "</robot>"
    )
    with pytest.raises(InputError, match="states whose names differ, found 'g/s' twice"):
        Robot.from_urdf(text=THREE, srdf=tmp_path / "r.srdf")


@pytest.mark.parametrize("tilt", [0.0, 1e-14, 1e-12, 1e-9, 8.742278e-08, 1e-7, 1e-6, 1e-3, 1.0])
def test_planar_joints_whose_axis_is_nearly_downwards(tilt):
    """They slide along perpendicular unit vectors, perpendicular to the axis."""
    text = f"""<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="planar"><parent link="a"/>
    <child link="b"/><axis xyz="{tilt} {0.3 * tilt} -1"/></joint></robot>"""
    robot = Robot.from_urdf(text=text)
    origin, x, y = robot.forward_kinematics([[0, 0, 0], [1, 0, 0], [0, 1, 0]])[:, 1, :3, 3]
    axis = np.array([tilt, 0.3 * tilt, -1.0]) / np.linalg.norm([tilt, 0.3 * tilt, -1.0])
    frame = np.array([x - origin, y - origin, axis])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=2e-15 if tilt > 1e-12 else 1e-12)


@pytest.mark.parametrize(
    ("state", "is_told"),
    [
        ('<joint name="k" value="0.5"/>', True),
        ('<joint name="j" value="0.5"/><joint name="k" value="0.5"/>', True),
        ('<joint name="k" value="1.1"/><joint name="j" value="0.5"/>', False),
        ('<joint name="j" value="0.5"/>', False),
    ],
)
def test_values_of_mimicking_joints_in_states_are_told_if_they_are_lost(tmp_path, state, is_told):
    """Here k is 2 j + 0.1; a state that gives only k does not move j."""
    mimic = '<mimic joint="j" multiplier="2" offset="0.1"/>'
    text = THREE.replace('<child link="c"/>', f'<child link="c"/>{mimic}')
    group = '<group name="g"><joint name="j"/></group>'
    state = f'<group_state name="s" group="g">{state}</group_state>'
    (tmp_path / "r.srdf").write_text(f'<robot name="r">{group}{state}</robot>')
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        Robot.from_urdf(text=text, srdf=tmp_path / "r.srdf")
    lost = [one for one in told if "values of joints that follow others are not used" in str(one.message)]
    assert bool(lost) == is_told
