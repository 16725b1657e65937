"""Robots that are written as URDF and SRDF are read back as the same robots, or are refused by name."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from checker_oracle import pose, random_robot, simple_bodies
from loewner import Body, CollisionChecker, InputError, Robot
from robot_oracle import PAIRS, robots_folder
from sampling import quick_of

LIMITS = ("lower", "upper", "hard_lower", "hard_upper", "velocity", "acceleration", "jerk")
QUICK = ("panda", "ur5_gripper")

SLED = """<robot name="sled" version="1.2"><link name="base"/>
<link name="sled"><collision><geometry><box size="1 1 0.1"/></geometry></collision></link>
<link name="mast"><collision><geometry><cylinder radius="0.05" length="1"/></geometry></collision></link>
<link name="plate"><collision><origin xyz="0 0 0.5"/><geometry><sphere radius="0.1"/></geometry></collision>
</link>
<link name="flag"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="kite"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="snow" type="planar"><parent link="base"/><child link="sled"/><axis xyz="1 2 2"/></joint>
<joint name="lift" type="prismatic"><parent link="sled"/><child link="mast"/><axis xyz="0 1 1"/>
<origin xyz="0.1 0.2 0.3" rpy="1 2 3"/>
<limit lower="-1" upper="2" velocity="3" effort="0" acceleration="4" jerk="5"/>
<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5" k_velocity="1"/></joint>
<joint name="bolted" type="fixed"><parent link="mast"/><child link="plate"/><origin xyz="1 0 2" rpy="0.3 0.2 0.1"/>
</joint>
<joint name="turn" type="revolute"><parent link="plate"/><child link="flag"/><axis xyz="1 -1 0.5"/>
<origin xyz="0 0 3" rpy="-1 0.5 2"/><limit lower="-9" upper="9" velocity="1" effort="0"/>
<mimic joint="lift" multiplier="-2" offset="0.25"/></joint>
<joint name="wind" type="floating"><parent link="flag"/><child link="kite"/><origin xyz="0 2 0" rpy="0 0 1"/></joint>
</robot>"""
SLED_STATES = """<robot name="sled"><group name="all"><joint name="snow"/>
<joint name="lift"/><joint name="wind"/></group>
<group name="up"><joint name="lift"/></group>
<group_state name="home" group="all"><joint name="snow" value="1 2 3"/><joint name="lift" value="0.5"/>
<joint name="wind" value="1 2 3 0.5 0.5 0.1 0.7"/></group_state>
<group_state name="home" group="up"><joint name="lift" value="1"/></group_state>
<disable_collisions link1="mast" link2="kite"/></robot>"""


def expect_same_back(robot, folder):
    """Write a robot, read it without a warning, and compare everything that is promised."""
    path = folder / "written.urdf"
    robot.to_urdf(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*expected values of the joints of a state's group, found others, which are")
        back = Robot.from_urdf(path, srdf=path.with_suffix(".srdf"))
    assert back.name == robot.name
    assert back.configuration_names == robot.configuration_names
    assert set(back.link_names) - set(robot.link_names) <= {"world"}
    for name in LIMITS:
        np.testing.assert_array_equal(getattr(back, name), getattr(robot, name), err_msg=name)
    Q = robot.random_configurations(40, seed=2)
    links = [back.link_names.index(name) for name in robot.link_names]
    expected = robot.forward_kinematics(Q)
    np.testing.assert_allclose(
        back.forward_kinematics(Q)[:, links], expected, rtol=0, atol=1e-14 * (1 + np.abs(expected).max())
    )
    assert (back.groups, back.states, back.mimics.keys()) == (robot.groups, robot.states, robot.mimics.keys())
    assert back.bodies.keys() == robot.bodies.keys()
    for name, body in robot.bodies.items():
        found, expected = (one.to_trimesh().bounds for one in (back.bodies[name], body))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * (1 + np.abs(expected).max()))
    if robot.bodies:
        checkers = [CollisionChecker(one) for one in (robot, back)]
        pairs = [{frozenset(pair) for pair in checker.checked_pairs} for checker in checkers]
        assert pairs[0] == pairs[1]
        if len(back.link_names) == len(robot.link_names):  # no link "world", through which others are adjacent
            for skip in (True, False):
                of = [CollisionChecker(one, skip_adjacent=skip).checked_pairs for one in (robot, back)]
                assert {frozenset(pair) for pair in of[0]} >= {frozenset(pair) for pair in of[1]}
                assert skip or not robot._lists_pairs or {*map(frozenset, of[0])} == {*map(frozenset, of[1])}
        np.testing.assert_array_equal(*(checker.collide(Q) for checker in checkers))
    return back


def known(urdf, srdf):
    """A robot of example-robot-data with its SRDF, without its warnings."""
    home = robots_folder()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Robot.from_urdf(home / urdf, srdf=home / urdf.split("/")[0] / "srdf" / f"{srdf}.srdf")


@pytest.mark.parametrize(
    ("urdf", "srdf"),
    [
        pytest.param(*pair, marks=() if Path(pair[0]).stem in QUICK else pytest.mark.verify, id=pair[0])
        for pair in PAIRS
    ],
)
def test_known_robots_are_read_back(urdf, srdf, tmp_path):
    """With their meshes, mimics, groups and states; values of joints outside a state's group warn again."""
    expect_same_back(known(urdf, srdf), tmp_path)


@pytest.mark.parametrize("seed", quick_of(range(8), range(2)))
def test_random_robots_are_read_back(seed, tmp_path):
    """Alone, and joined, placed, on a base and with a door in the world and one on a link."""
    rng = np.random.default_rng(seed)
    robots = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        robots.append(random_robot(rng, tmp_path / name, 5, primitives(rng)))
    expect_same_back(robots[0], tmp_path)
    expect_same_back(robots[0].placed(pose(rng, 3.0)), tmp_path)
    joined = Robot.join({"a": robots[0], "b": robots[1]}, {"b": pose(rng, 5.0)})
    expect_same_back(joined, tmp_path)
    based = joined.add_base("planar", [[-2, 2], [-1, 1]])
    expect_same_back(based, tmp_path)
    ball = Body.sphere(0.2)
    doors = based.with_body("door", ball, pose(rng, 2.0), joint="revolute", axis=[1, 2, 3], limits=(0.5, 1.5))
    on = robots[1].link_names[-1]
    doors = doors.with_body("lid", ball, pose(rng, 1.0), joint="planar", axis=[0, 1, 1], parent=f"b/{on}")
    expect_same_back(doors.with_body("leaf", ball, pose(rng, 1.0), parent="lid"), tmp_path)


def primitives(rng):
    """Shapes of random links: URDF has those of them that are no cones and no ellipsoids."""
    return [body for body in simple_bodies(rng) if "cone" not in repr(body) and "ellipsoid" not in repr(body)]


def test_limits_mimics_and_states_of_joints_of_all_kinds_are_read_back(tmp_path):
    """Soft limits, accelerations, a mimic with an offset, and states of joints with several values."""
    (tmp_path / "sled.srdf").write_text(SLED_STATES)
    robot = Robot.from_urdf(text=SLED, srdf=tmp_path / "sled.srdf")
    back = expect_same_back(robot, tmp_path)
    assert back.mimics == {"turn": ("lift", -2.0)}
    assert back.disabled_pairs == {("kite", "mast")}
    assert back.states["up/home"] == ("up", {"lift": 1.0})
    expect_same_back(Robot.join({"a": robot, "b": robot}, {"b": np.diag([-1.0, -1.0, 1.0, 1.0])}), tmp_path)


def test_references_of_mjcf_become_poses_of_joints(tmp_path):
    """A joint whose body is at its origin at another value than 0, and several joints of one body."""
    pytest.importorskip("mujoco")
    (tmp_path / "crane.xml").write_text(
        """<mujoco model="crane"><worldbody>
    <geom name="floor" type="plane" size="1 1 1" pos="0 0 -2"/>
    <body name="crane" pos="0 0 1" euler="10 20 30"><joint name="slew" axis="1 2 3" pos="0.1 0 0" ref="30"/>
      <joint name="luff" type="slide" axis="0 1 1" ref="0.25" range="-1 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.05"/>
      <body name="hook" pos="0 0 -0.5"><freejoint/><geom type="box" size="0.1 0.1 0.2"/></body></body>
    </worldbody></mujoco>""".replace("<freejoint/>", '<joint name="swing" axis="0 1 0"/>')
    )
    robot = Robot.from_mjcf(tmp_path / "crane.xml")
    smaller = [name for name in robot.bodies if name != "floor"]
    assert smaller == ["crane", "hook"]
    expect_same_back(robot, tmp_path)


def test_links_that_are_checked_stay_checked_without_an_exempt_pair(tmp_path):
    """A door that hangs in the world beside a post: read back without a rule, the two would be adjacent, and exempt."""
    post = Robot.from_urdf(
        text="""<robot name="post"><link name="post"><collision><geometry><box size="0.1 0.1 2"/></geometry></collision>
        </link></robot>"""
    )
    hinge = np.eye(4)
    hinge[0, 3] = 0.5
    robot = post.with_body("door", Body.box([1, 0.1, 1]), hinge, joint="revolute", limits=(-1, 1))
    assert CollisionChecker(robot).checked_pairs == (("post", "door"),)
    back = expect_same_back(robot, tmp_path)
    assert back.link_names == ("world", "post", "door")
    assert CollisionChecker(back).collide([0.0])


def test_a_robot_without_pairs_has_an_srdf_that_is_read_without_a_word(tmp_path):
    """One link, no groups: an SRDF that names nothing would cause a warning."""
    robot = Robot.from_urdf(text='<robot name="dot"><link name="dot"/></robot>')
    expect_same_back(robot, tmp_path)
    expect_same_back(on_a_link(Body.sphere(0.1)), tmp_path)


def on_a_link(body):
    """A robot of one link with a body on it."""
    return Robot.from_urdf(text='<robot name="dot"><link name="dot"/></robot>').with_body("lump", body, parent="dot")


def bar(depth):
    """A mesh of a bar with a groove around it."""
    profile = [(0, 0), (1, 0), (1, 0.4), (1 - depth, 0.5), (1, 0.6), (1, 1), (0, 1)]
    return trimesh.creation.revolve(profile, sections=9)


@pytest.mark.parametrize("body", [Body.from_surface(bar(0.3)), Body.height_field(np.eye(3), [0.1, 0.1])])
def test_solids_are_read_back(body, tmp_path):
    """Their triangles are written, and become the same solid."""
    back = expect_same_back(on_a_link(body), tmp_path)
    (piece,) = back.bodies["lump"].pieces
    assert piece.kind == "solid"
    corners = [piece.vertices[piece.triangles] for piece in (piece, body.pieces[0])]
    np.testing.assert_array_equal(*(np.unique(np.sort(each.reshape(-1, 9)), axis=0) for each in corners))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: on_a_link(Body.cone(0.1, 0.2)), "link 'lump': .*kind 'cone'"),
        (lambda: on_a_link(Body.ellipsoid([0.1, 0.2, 0.3])), "link 'lump': .*kind 'ellipsoid'"),
        (lambda: on_a_link(Body.from_cloud(np.eye(3), radius=0.1)), "link 'lump': expected convex pieces"),
        (lambda: on_a_link(Body.from_surface((np.eye(3), [[0, 1, 2]]))), "link 'lump': expected convex pieces"),
        (lambda: on_a_link(Body.from_surface(bar(0.3), radius=0.1)), "link 'lump': expected convex pieces"),
        (lambda: on_a_link(Body.from_surface(bar(1e-4))), "link 'lump': expected convex pieces"),
        (lambda: Robot.from_urdf(text=SLED).add_base("floating", [[-1, 1]] * 3, name="boat"), "bounds of 'boat'"),
        (lambda: Robot.join({"a\nb": on_a_link(Body.sphere(1.0))}), "names that can be printed"),
    ],
)
def test_what_urdf_cannot_express_is_refused_by_name(make, words, tmp_path):
    """Nothing is written then."""
    with pytest.raises(InputError, match=words):
        make().to_urdf(tmp_path / "robot.urdf")
    assert not list(tmp_path.iterdir())


def test_ball_joints_and_paths_of_srdf_are_refused(tmp_path):
    """A ball joint by its name; a path on which the SRDF would replace the URDF."""
    with pytest.raises(InputError, match="expected the path of a URDF"):
        on_a_link(Body.sphere(0.1)).to_urdf(tmp_path / "robot.srdf")
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text("""<mujoco model="arm"><worldbody><body name="arm"><joint name="hip" type="ball"/>
      <geom type="sphere" size="0.1"/></body></worldbody></mujoco>""")
    with pytest.raises(InputError, match="the ball joint 'hip'"):
        Robot.from_mjcf(tmp_path / "arm.xml").to_urdf(tmp_path / "robot.urdf")


def test_meshes_keep_their_names_in_a_package(tmp_path):
    """Names of mesh files get the prefix, and no file of another content is replaced."""
    corners = np.random.default_rng(0).normal(size=(20, 3))
    robot = on_a_link(Body.from_points(corners))
    robot.to_urdf(tmp_path / "robot.urdf", mesh_prefix="package://my_robot/")
    (mesh,) = tmp_path.glob("*.obj")
    assert f'filename="package://my_robot/{mesh.name}"' in (tmp_path / "robot.urdf").read_text()
    (tmp_path / "my_robot").mkdir()
    mesh.rename(tmp_path / "my_robot" / mesh.name)
    back = Robot.from_urdf(tmp_path / "robot.urdf", srdf=tmp_path / "robot.srdf", package_dirs=tmp_path)
    found, expected = (np.unique(one.bodies["lump"].pieces[0].vertices, axis=0) for one in (back, robot))
    np.testing.assert_array_equal(found, expected)


def test_names_of_fixed_joints_give_way_to_moving_ones(tmp_path):
    """A flange on a fixed joint of that name that is followed by a door called so, and the like."""
    text = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
    <joint name="flange" type="fixed"><parent link="a"/><child link="b"/><origin xyz="1 2 3"/></joint>
    <joint name="j" type="continuous"><parent link="b"/><child link="c"/></joint></robot>"""
    robot = Robot.from_urdf(text=text)
    ball = Body.sphere(0.1)
    expect_same_back(robot.with_body("flange", ball, joint="revolute", limits=(0, 1), parent="c"), tmp_path)
    expect_same_back(robot.with_body("j", ball, joint="fixed", parent="c"), tmp_path)
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text("""<mujoco model="arm"><worldbody><geom name="arm" type="box" size="1 1 1"/>
      <body name="hand"><joint name="hand" pos="0.1 0 0"/><geom size="0.1"/></body></worldbody></mujoco>""")
    expect_same_back(Robot.from_mjcf(tmp_path / "arm.xml"), tmp_path)


@pytest.mark.parametrize(
    ("mimic", "limits"),
    [
        ('multiplier="1e-6" offset="1e5"', (-1, 2)),
        ('multiplier="1e-12" offset="1"', (-1, 2)),
        ('multiplier="1" offset="1e7"', (-1, 2)),
        ('multiplier="0" offset="0.5"', (-1, 2)),
        ('multiplier="-3" offset="0.5"', (0.1, 0.7)),
    ],
)
def test_limits_of_mimicking_joints_leave_the_others_alone(mimic, limits, tmp_path):
    """Their limits are not kept, and what is written instead narrows nothing by rounding."""
    text = f"""<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/>
    <limit lower="{limits[0]}" upper="{limits[1]}"/></joint>
    <joint name="k" type="continuous"><parent link="b"/><child link="c"/><mimic joint="j" {mimic}/></joint></robot>"""
    robot = Robot.from_urdf(text=text)
    assert (robot.lower[0], robot.upper[0]) == limits
    expect_same_back(robot, tmp_path)


@pytest.mark.parametrize("name", [" d", "d ", "${1+1}", "$(find d)"])
def test_names_that_readers_change_are_refused(name, tmp_path):
    """Spaces at the ends, which readers strip, and expressions of xacro."""
    with pytest.raises(InputError, match="without '\\$' and without spaces"):
        on_a_link(Body.sphere(0.1)).with_body(name, Body.sphere(0.1), parent="dot").to_urdf(tmp_path / "robot.urdf")
    with pytest.raises(InputError, match="expected the path of a URDF"):
        on_a_link(Body.sphere(0.1)).to_urdf(tmp_path / "robot.urdf.xacro")
    assert not list(tmp_path.iterdir())


def test_a_file_that_could_not_be_read_is_not_written(tmp_path):
    """Limits of MJCF beyond the ones that URDF files may have."""
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text("""<mujoco model="arm"><worldbody><body name="arm">
      <joint name="lift" type="slide" range="2e6 3e6"/><geom size="0.1"/></body></worldbody></mujoco>""")
    with pytest.raises(InputError, match="express, found one that is refused: .*lift"):
        Robot.from_mjcf(tmp_path / "arm.xml").to_urdf(tmp_path / "robot.urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]
