"""Messages with several trajectories, states, carried bodies and bases: all of it is used, told or refused."""

import copy
import json
import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import translation
from loewner import Body, CollisionChecker, FileError, InputError, Robot, Scene, Verdict, planners
from loewner.cli.main import main

ControllerPoints = planners.ControllerPoints
pytestmark = pytest.mark.filterwarnings("ignore:.*shapes and poses of bodies that the message attaches:UserWarning")

# A lift, on which a slide carries a cart.
CART = """<robot name="r"><link name="base"/>
<link name="mast"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="cart"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="mast"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="mast"/><child link="cart"/><origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="3" velocity="1"/></joint></robot>"""


def moved(*rows, names=("slide",), **more):
    """A JointTrajectory with rows of a time and positions."""
    points = [{"positions": list(row[1:]), "time_from_start": {"sec": row[0], "nanosec": 0}} for row in rows]
    return {"joint_names": list(names), "points": points, **more}


def of_joints(*rows, **more):
    return {"joint_trajectory": moved(*rows, **more)}


def driven(*rows, name="drive"):
    """A MultiDOFJointTrajectory with rows of a time, x, y and a heading."""
    return {
        "joint_names": [name],
        "points": [
            {
                "transforms": [
                    {
                        "translation": {"x": x, "y": y, "z": 0.0},
                        "rotation": {"x": 0.0, "y": 0.0, "z": math.sin(turn / 2), "w": math.cos(turn / 2)},
                    }
                ],
                "time_from_start": {"sec": time, "nanosec": 0},
            }
            for time, x, y, turn in rows
        ],
    }


def carries(name, operation=0, **more):
    return {"link_name": "cart", "object": {"id": name, "operation": operation}, **more}


SOLUTION = {
    "task_id": "pick",
    "start_scene": {"robot_state": {"joint_state": {"name": ["lift", "slide"], "position": [0.8, 0.0]}}},
    "sub_solution": [{"info": {"id": 1}}],
    "sub_trajectory": [
        {"info": {}, "trajectory": of_joints((0, 0.0), (1, 1.0))},
        {
            "trajectory": of_joints((0, 1.0), (1, 1.0)),
            "scene_diff": {
                "is_diff": True,
                "robot_state": {"is_diff": True, "attached_collision_objects": [carries("can", touch_links=["mast"])]},
            },
        },
        {"trajectory": of_joints((0, 0.8), (1, 0.2), names=["lift"])},
        {
            "scene_diff": {
                "robot_state": {"is_diff": True, "attached_collision_objects": [carries("can", operation=1)]},
            },
        },
        {"trajectory": of_joints((0, 0.2), (1, 0.8), names=["lift"])},
    ],
}


@pytest.fixture
def cart():
    return Robot.from_urdf(text=CART)


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("r.urdf").write_text(CART)

    def write(message, name="m.json"):
        Path(name).write_text(message if isinstance(message, str) else json.dumps(message))
        return name

    return write


def audit(capsys, *words):
    status = main(["audit", "r.urdf", *words])
    return status, *capsys.readouterr()


def placed(x, y=0.0, z=0.0):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


# -- parts and states -------------------------------------------------------------------------------


def test_parts_follow_each_other_in_their_own_states(cart, written):
    """A joint that a part does not name stands where the part before, or the message's start state, has left it."""
    for name in ("m.json", "m.yaml"):
        parts = ControllerPoints.load_all(written(SOLUTION, name), robot=cart)
        found = [part.positions[:, [part.names.index(n) for n in ("lift", "slide")]].tolist() for part in parts]
        assert found == [[[0.8, 0], [0.8, 1]], [[0.8, 1], [0.8, 1]], [[0.8, 1], [0.2, 1]], [[0.2, 1], [0.8, 1]]]
        assert [part.carried for part in parts] == [{}, {}, {"can": "cart"}, {}]
    with pytest.raises(FileError, match=r"expected one trajectory, found 4 with points .*sub_trajectory\[2\]"):
        ControllerPoints.load("m.json", robot=cart)


def test_given_values_come_before_those_of_the_message(cart, written):
    """An explicit configuration replaces the start state."""
    for part in ControllerPoints.load_all(written(SOLUTION), robot=cart, others=[0.5, 3.0])[:2]:
        assert part.positions[:, part.names.index("lift")].tolist() == [0.5, 0.5]


def test_a_state_that_is_no_difference_replaces_what_is_carried(cart, written):
    """A whole state has all bodies that the robot carries."""
    held = {"attached_collision_objects": [carries("can")], "is_diff": True}
    message = copy.deepcopy(SOLUTION)
    message["start_scene"]["robot_state"] |= held
    message["sub_trajectory"][0]["scene_diff"] = {
        "robot_state": {"joint_state": {"name": ["slide"], "position": [1.0]}, "attached_collision_objects": []}
    }
    parts = ControllerPoints.load_all(written(message), robot=cart)
    assert [part.carried for part in parts[:2]] == [{"can": "cart"}, {}]


def test_points_that_carry_a_body_need_a_scene_that_does(cart, written):
    """Proofs are about the robot with the body; a scene with it on another link, or without it, is refused."""
    part = ControllerPoints.load_all(written(SOLUTION), robot=cart)[2]
    scene = Scene()
    scene.add("can", Body.sphere(0.05), placed(1.3, 0, 0.86))
    checker = CollisionChecker(cart, scene)
    for query in (checker.certify_trajectory, checker.first_contact):
        with pytest.raises(InputError, match="body 'can' attached to the link 'cart', .*found none"):
            query(part)
        scene.attach("can", "mast", placed(0, 0, 0.1))
        with pytest.raises(InputError, match="found it on 'mast'"):
            query(part)
        scene.detach("can", placed(1.3, 0, 0.86))
    scene.attach("can", "cart", placed(0, 0, 0.2))
    assert checker.certify_trajectory(part).verdict == Verdict.FREE


def test_bodies_carried_in_other_parts_only_must_not_be_held(cart, written):
    """A scene that still holds what the message has put down is refused; the proof would be about another robot."""
    parts = ControllerPoints.load_all(written(SOLUTION), robot=cart)
    scene = Scene()
    scene.add("can", Body.sphere(0.05))
    scene.attach("can", "cart", placed(0, 0, 0.2))
    checker = CollisionChecker(cart, scene)
    for part in (parts[0], parts[3]):
        with pytest.raises(InputError, match="expected 'can' attached to no link .* found it on 'cart'"):
            checker.certify_trajectory(part)


def test_states_in_which_nothing_is_set_change_nothing(cart, written):
    """A state that a program has made and not filled does not put down what the robot carries."""
    message = copy.deepcopy(SOLUTION)
    empty = {
        "joint_state": {"name": [], "position": []},
        "multi_dof_joint_state": {"joint_names": [], "transforms": []},
        "attached_collision_objects": [],
        "is_diff": False,
    }
    message["sub_trajectory"][2]["scene_diff"] = {"robot_state": empty}
    message["sub_trajectory"].pop(3)
    parts = ControllerPoints.load_all(written(message), robot=cart)
    assert [part.carried for part in parts[2:4]] == [{"can": "cart"}] * 2


@pytest.mark.parametrize("operation", [1, "\x01"])
def test_a_removal_without_a_name_is_of_one_link(cart, written, operation):
    """It takes away the bodies of its link; a byte may be written as a character."""
    state = {"attached_collision_objects": [
        carries("can"), {**carries("cup"), "link_name": "mast"}, {**carries("", operation), "link_name": "mast"},
    ]}  # fmt: skip
    message = {"trajectory_start": state, "trajectory": [of_joints((0, 0.0), (1, 1.0))]}
    (part,) = ControllerPoints.load_all(written(message), robot=cart)
    assert (part.carried, part.origin.free) == ({"can": "cart"}, ("cup",))


@pytest.mark.filterwarnings("default:.*shapes and poses")
def test_shapes_of_attached_bodies_are_not_read(cart, written):
    """The scene's bodies count; a warning names those whose shapes the message has."""
    with pytest.warns(UserWarning, match=r"shapes and poses of bodies that the message attaches \(can\) are not read"):
        ControllerPoints.load_all(written(SOLUTION), robot=cart)


@pytest.mark.parametrize("rates", [0, False, "fast", [0.5, 0.5]])
def test_rates_that_are_none_are_refused(written, rates):
    """Points without velocities would be another curve."""
    message = moved((0, 0.0), (1, 1.0))
    for point in message["points"]:
        point["velocities"] = rates
    with pytest.raises(FileError, match=r"points\[0\]/velocities: expected a sequence"):
        ControllerPoints.load(written(message))


def test_only_the_last_stage_of_a_plan_is_read(cart, written):
    """The stages of a detailed response are the same plan, not motions one after another."""
    stages = [of_joints((0, 0.0), (3, 0.1)), of_joints((0, 0.0), (1, 2.0))]
    with pytest.warns(UserWarning, match="has 2 stages of one plan; the last one is read"):
        (part,) = ControllerPoints.load_all(
            written({"trajectory": stages, "description": ["plan", "simplify"]}), robot=cart
        )
    assert part.positions[:, part.names.index("slide")].tolist() == [0, 2]


def test_a_joint_that_mimics_needs_the_one_it_mimics(written):
    """A state with the mimic alone would leave both at 0."""
    more = '<link name="f"/><joint name="m" type="prismatic"><parent link="base"/><child link="f"/><limit upper="9"/>'
    robot = Robot.from_urdf(text=CART.replace("</robot>", more + '<mimic joint="lift"/></joint></robot>'))
    state = {"joint_state": {"name": ["m"], "position": [0.5]}}
    message = written({"trajectory_start": state, "trajectory": [of_joints((0, 0.0), (1, 1.0))]})
    with pytest.raises(FileError, match="found m, which mimics lift; add the value of the joint that is mimicked"):
        ControllerPoints.load(message, robot=robot)


def test_a_way_of_the_base_that_is_not_in_the_message_is_told(cart, written):
    """As for joints: the base does not begin where the message has left it."""
    robot = cart.add_base("planar", name="drive")
    parts = [{"multi_dof_joint_trajectory": driven((0, x, 0, 0), (1, x + 1, 0, 0))} for x in (0, 3)]
    with pytest.warns(UserWarning, match="does not begin where the message has left drive"):
        ControllerPoints.load_all(written({"trajectory": parts}), robot=robot)


@pytest.mark.parametrize("axis", ["1 0 0", "0 0 -1"])
def test_a_planar_joint_with_another_axis_is_refused(written, axis):
    """A message gives the position and heading about z; the joint moves in another plane."""
    text = """<robot name="r"><link name="w"/><link name="b"><collision><geometry>
    <sphere radius="0.1"/></geometry></collision></link><joint name="drive" type="planar"><parent link="w"/>
    <child link="b"/><axis xyz="{}"/></joint></robot>"""
    message = written(driven((0, 0, 0, 0), (1, 1, 0, 0)))
    with pytest.raises(FileError, match="expected the axis 0 0 1 of the planar joint drive"):
        ControllerPoints.load(message, robot=Robot.from_urdf(text=text.format(axis)))
    upright = Robot.from_urdf(text=text.format("0 0 1"))
    assert ControllerPoints.load(message, robot=upright).positions[:, 0].tolist() == [0, 1]


# -- the command --------------------------------------------------------------------------------


CAN = """bodies:\n  can: {sphere: {radius: 0.05}, position: [1.3, 0, 0.92]}
  post: {box: [1, 1, 1], position: [9, 9, 9]}"""


def test_every_part_is_proven_with_what_it_carries(written, capsys):
    """The can is carried from where it stands, and stays where it is put down: the cart hits it on its way back up."""
    written(CAN, "s.yaml")
    name = written(SOLUTION)
    status, out, err = audit(capsys, name, "--scene", "s.yaml")
    assert (status, out) == (2, "")
    assert "body 'can' attached to the link 'cart'" in err
    status, out, _ = audit(capsys, name, "--scene", "s.yaml", "--attach", "3:can=cart")
    assert status == 1
    assert "part      3 of 4, sub_trajectory[2]/trajectory" in out
    assert "state     lift = 0.8, from start_scene/robot_state/joint_state;" in out
    assert out.splitlines()[-1] == "COLLIDING  3 of 4 parts proven free"
    answer = json.loads(audit(capsys, name, "--scene", "s.yaml", "--attach", "3:can=cart", "--json")[1])
    assert [part["verdict"] for part in answer["parts"]] == ["FREE", "FREE", "FREE", "COLLIDING"]
    assert answer["parts"][3]["pair"] == ["cart", "can"]
    assert answer["parts"][2]["carried"] == {"can": "cart"}


def test_values_that_nothing_gives_and_values_beyond_limits_are_told(written, capsys):
    """The lift keeps 0, as neither the points nor a state names it; the slide leaves its limits."""
    written(CAN, "s.yaml")
    name = written(moved((0, 0.0), (1, 3.5)))
    status, out, _ = audit(capsys, name, "--scene", "s.yaml")
    assert status == 4
    assert out.startswith("FREE  ")
    assert "assumed   lift = 0: the file has no values of these" in out
    assert "limits    slide is 0 .. 3.5, outside its limits 0 .. 3\n" in out
    answer = json.loads(audit(capsys, name, "--scene", "s.yaml", "--json")[1])
    assert answer["assumed"] == {"lift": 0.0}
    assert answer["beyond_limits"] == [{"value": "slide", "range": [0.0, 3.5], "limits": [0.0, 3.0], "hard": True}]
    answer = json.loads(audit(capsys, name, "--scene", "s.yaml", "--others", "0.5,0", "--json")[1])
    assert "assumed" not in answer


def test_values_between_soft_and_hard_limits_are_told(written, capsys):
    """They are outside the limits for planning alone."""
    written(CAN, "s.yaml")
    name = written(moved((0, 0.0, 0.0), (1, 2.5, 0.0), names=("slide", "lift")))
    soft = '<safety_controller soft_lower_limit="0" soft_upper_limit="2" k_velocity="1"/></joint></robot>'
    Path("r.urdf").write_text(CART.replace("</joint></robot>", soft))
    out = audit(capsys, name, "--scene", "s.yaml")[1]
    assert "limits    slide is 0 .. 2.5, outside its limits for planning 0 .. 2\n" in out


@pytest.mark.parametrize(("second", "told"), [(-1.5, False), (0.5, True)])
def test_a_state_that_contradicts_a_mimic_is_told(second, told, written):
    """The value of the joint that mimics is not used, and follows from the other one."""
    flap = """<link name="flap"/><joint name="tilt" type="revolute"><parent link="cart"/><child link="flap"/>
    <limit lower="-9" upper="9"/><mimic joint="lift" multiplier="-2" offset="-0.5"/></joint></robot>"""
    text = CART.replace("</robot>", flap)
    state = {"joint_state": {"name": ["lift", "tilt"], "position": [0.5, second]}}
    moving = of_joints((0, 0.0), (1, 1.0))
    name = written({"trajectory_start": state, "trajectory": moving})
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        ControllerPoints.load(name, robot=Robot.from_urdf(text=text))
    assert len(found) == told
    assert all("expected tilt = -1.5, since it mimics lift = 0.5, found 0.5" in str(one.message) for one in found)


def test_a_second_trajectory_is_not_dropped(written, capsys):
    """Each trajectory has a verdict, and a proof of its own if it is free."""
    written("bodies: {post: {box: [0.2, 0.2, 0.2], position: [2.3, 0, 0]}}", "s.yaml")
    message = {"model_id": "r", "trajectory": [of_joints((0, 0.0), (1, 1.0)), of_joints((0, 1.0), (1, 3.0))]}
    status, out, _ = audit(capsys, written(message), "--scene", "s.yaml", "--json", "--proof", "a.proof")
    answer = json.loads(out)
    assert (status, answer["verdict"]) == (1, "COLLIDING")
    assert [part["verdict"] for part in answer["parts"]] == ["FREE", "COLLIDING"]
    assert [part["proof"] for part in answer["parts"]] == ["a-1.proof", None]
    assert [part["begins"] for part in answer["parts"]] == [0.0, 1.0]
    assert main(["verify", "a-1.proof"]) == 0
    capsys.readouterr()


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("can", r"expected \[PART:\]BODY=LINK"),
        ("5:can=cart", "with a PART from 1 to 4"),
        ("x:can=cart", "with a PART from 1 to 4"),
        ("pan=cart", "body: expected one of can, post; found 'pan'"),
        ("can=card", "link: .*did you mean 'cart'"),
        ("can=", r"expected \[PART:\]BODY=LINK"),
    ],
)
def test_bodies_that_cannot_be_attached(written, capsys, option, told):
    """A malformed option, and a name that does not exist, is refused."""
    written(CAN, "s.yaml")
    status, _, err = audit(capsys, written(SOLUTION), "--scene", "s.yaml", "--attach", option)
    assert status == 2
    assert re.search(told, err), err


def test_a_body_with_an_error_of_its_pose_is_not_attached(written, capsys):
    """Its error would be lost, and the answer would be about the given pose alone."""
    written(CAN.replace("can: {", "can: {error: [0.3, 0], "), "s.yaml")
    status, _, err = audit(capsys, written(SOLUTION), "--scene", "s.yaml", "--attach", "3:can=cart")
    assert status == 2
    assert "--attach can=cart: expected a body at a known pose, found an error of its pose" in err


@pytest.mark.parametrize("command", [["audit"], ["swept", "-o", "o.stl"]])
def test_errors_of_joints_are_not_lost_in_a_grasp(written, capsys, command):
    """A joint that is off when the hand takes the can puts the can off in the hand: the can would hit what is FREE."""
    written(CAN, "s.yaml")
    words = ["r.urdf", written(SOLUTION), "--scene", "s.yaml", "--attach", "3:can=cart", "--joint-error", "0.02"]
    assert main([*command, *words]) == 2
    assert (
        "--joint-error 0.02: expected 0 with --attach, since errors at the time of the grasp" in capsys.readouterr().err
    )


def test_a_way_between_parts_is_proven(written, capsys):
    """A message whose second part begins elsewhere does not contain the way there, which leads through the post."""
    message = written(
        {"trajectory": [of_joints((0, x, 0.0), (1, x, 0.1), names=["slide", "lift"]) for x in (0.0, 2.0)]}
    )
    for place, verdict, status in (([9, 9, 9], "FREE", 0), ([1.3, 0, 0], "COLLIDING", 1)):
        written(f"bodies:\n  post: {{box: [0.1, 0.1, 1], position: {place}}}", "s.yaml")
        end, out, err = audit(capsys, message, "--scene", "s.yaml")
        assert "does not contain the way" in err
        assert end == status
        assert f"before    the straight way from the end of part 1 to the first point is {verdict}" in out
        assert out.splitlines()[-1] == f"{verdict}  2 of 2 parts proven free"
    assert main(["swept", "r.urdf", message, "-o", "o.stl"]) == 2
    assert "expected parts that begin where the part before them ends, found a gap" in capsys.readouterr().err
    assert not Path("o.stl").exists()


def test_a_small_gap_between_parts_is_proven_too(written, capsys):
    """A controller accepts a start that is slightly off, but the way to it is in neither part."""
    written(CAN, "s.yaml")
    parts = [of_joints((0, x, z), (1, x, z + 0.1), names=["slide", "lift"]) for x, z in ((0.0, 0.0), (0.008, 0.1))]
    status, out, _ = audit(capsys, written({"trajectory": parts}), "--scene", "s.yaml")
    assert status == 0
    way = "the straight way from the end of part 1 to the first point is FREE; the robot is within 0.008 of the point"
    assert f"before    {way}" in out
    parts[1] = of_joints((0, 0.0, 0.1), (1, 0.0, 0.2), names=["slide", "lift"])
    assert "before" not in audit(capsys, written({"trajectory": parts}), "--scene", "s.yaml")[1]


def test_a_body_contains_the_way_across_a_small_gap_between_parts(written):
    """Between the parts, a corner of the cart is where it is in neither of them."""
    starts = (0.0, 0.0), (0.009, 0.109)
    parts = [of_joints((0, x, z), (1, x, z + 0.1), names=["slide", "lift"]) for x, z in starts]
    assert main(["swept", "r.urdf", written({"trajectory": parts}), "--tolerance", "0.001", "-o", "o.npz"]) == 0
    corner = translation(0.3 + 0.0045 - 0.0499, 0.0, 0.1045 + 0.0499)
    assert loewner.collide(Body.load("o.npz"), np.eye(4), Body.sphere(1e-6), corner)


def test_a_body_stays_in_the_hold_of_a_link_between_parts(written, capsys):
    """The second part begins 8 mm beyond the end of the first, and the can comes there with the cart."""
    parts = [of_joints((0, begin), (1, end), names=["slide"]) for begin, end in ((0, 0.2), (0.208, 1))]
    message = written({"trajectory": parts})
    bodies = "bodies:\n  can: {box: [0.1, 0.1, 0.1], position: [0.3, 0.11, 0]}\n"
    for near, status in ((0.005, 1), (0.009, 0)):
        post = f"  post: {{box: [0.1, 0.1, 0.1], position: [{1.4 - 0.008 + near}, 0.11, 0]}}"
        written(bodies + post, "s.yaml")
        words = "--scene", "s.yaml", "--attach", "can=cart", "--json"
        ended, out, _ = audit(capsys, message, *words)
        assert (ended, json.loads(out)["parts"][1]["verdict"]) == (status, ("FREE", "COLLIDING")[status])
    assert main(["swept", "r.urdf", message, *words[:-1], "--tolerance", "0.001", "-o", "o.npz"]) == 0
    corner = translation(1.3 + 0.0499, 0.11, 0.0)
    assert loewner.collide(Body.load("o.npz"), np.eye(4), Body.sphere(1e-6), corner)


@pytest.mark.parametrize("option", ["--from", "--others"])
def test_where_an_earlier_part_ended_comes_before_options(written, capsys, option):
    """The second part moves the slide alone, and the lift stays up, whatever the robot's state was at first."""
    written("bodies:\n  post: {box: [0.1, 0.1, 0.1], position: [1.3, 0, 0.3]}", "s.yaml")
    parts = [of_joints((0, 0.0), (1, 0.3), names=["lift"]), of_joints((0, 0.0), (1, 2.0), names=["slide"])]
    status, out, _ = audit(capsys, written({"trajectory": parts}), "--scene", "s.yaml", option, "0,0")
    assert status == 1
    assert "lift = 0.3, from the end of trajectory[0]" in out


def test_a_wait_between_parts_is_proven_among_moving_bodies(written, capsys):
    """The second part begins where the first one ends, but two seconds later; meanwhile, a post passes."""
    way = [{"time": t, "position": [0.3, y, 0]} for t, y in ((1.0, -3.0), (3.0, 3.0))]
    written(f"bodies:\n  post: {{box: [0.1, 0.1, 0.1], follow: {{poses: {json.dumps(way)}}}}}", "s.yaml")
    parts = [of_joints((0, 0.0), (1, 0.0), names=["slide"]), of_joints((2, 0.0), (3, 0.0), names=["slide"])]
    status, out, _ = audit(capsys, written({"trajectory": parts}), "--scene", "s.yaml", "--start-time", "0")
    assert status == 1
    assert "the straight way from the end of part 1 to the first point is COLLIDING" in out


def test_a_body_that_a_message_attaches_is_not_grasped_across_a_gap(written, capsys):
    """The link has the can before the way to the first point, so its pose in the link is not the one at this point."""
    written(CAN, "s.yaml")
    message = copy.deepcopy(SOLUTION)
    names = ["r.urdf", written(message), "--scene", "s.yaml", "--attach", "3:can=cart"]
    assert main(["audit", *names]) in (0, 1)
    capsys.readouterr()
    message["sub_trajectory"][2]["trajectory"]["joint_trajectory"]["points"][0]["positions"] = [0.805]
    written(message)
    assert main(["audit", *names]) == 2
    assert "found a gap of 0.005, so the pose of the body in the link is unknown" in capsys.readouterr().err


@pytest.mark.parametrize(("off", "held", "warns"), [(0.008, True, 1), (0.008, False, 0), (0.0, True, 0)])
def test_a_start_state_that_is_off_is_reported_if_the_robot_holds_a_body(written, capsys, off, held, warns):
    """A few millimetres shift the body in the link by as much; without a body, controllers accept them."""
    written(CAN, "s.yaml")
    state = {"joint_state": {"name": ["slide"], "position": [0.0]}}
    if held:
        state["attached_collision_objects"] = [carries("can")]
    message = {"trajectory_start": state, "trajectory": [of_joints((0, off), (1, 0.1), names=["slide"])]}
    words = ["--attach", "can=cart"] if held else []
    _, _, err = audit(capsys, written(message), "--scene", "s.yaml", *words)
    assert err.count("and the first point slide = 0.008") == warns
    assert err.count("on which the robot holds can as in the start state") == warns


def test_a_state_that_names_some_joints_is_reported(written, capsys):
    """The others are taken as 0, which may not be where they are."""
    written(
        """<robot name="r"><group name="g"><joint name="slide"/></group>
<group_state name="home" group="g"><joint name="slide" value="0"/></group_state></robot>""",
        "r.srdf",
    )
    message = written({"trajectory": of_joints((0, 0.0), (1, 1.0), names=["slide"])})
    written(CAN, "s.yaml")
    _, _, err = audit(capsys, message, "--srdf", "r.srdf", "--scene", "s.yaml", "--from", "home")
    assert "--from home: expected values of all joints, found none of lift, so 0 is assumed" in err


def test_contact_on_the_way_from_the_present_state_may_not_be_deep(written, capsys):
    """The same state as the file's first row has the same status: `leave` allows contact, not a wrong pose."""
    written("bodies:\n  post: {box: [0.1, 0.1, 0.1], position: [0.33, 0, 0]}\nleave: [[post, cart]]", "s.yaml")
    name = written(moved((0, 0.0, 0.3), (1, 0.0, 0.4), names=["slide", "lift"]))
    status, out, _ = audit(capsys, name, "--scene", "s.yaml", "--from", "0 0")
    assert status == 1
    assert out.startswith("FREE  ")
    assert re.search("deep      .*post.* overlap by 70.000 mm before the first point, and --overlap allows 1 mm", out)
    assert audit(capsys, name, "--scene", "s.yaml", "--from", "0 0", "--overlap", "0.08")[0] == 0


def test_positions_are_compared_with_the_limits_of_the_file(written, capsys):
    """Limits of --limits replace those of the URDF, in the text as in the status."""
    written(CAN, "s.yaml")
    name = written(moved((0, 0.0, 0.0), (1, 1.0, 0.0), names=["slide", "lift"]))
    for least, most, status in ((-0.5, 0.5, 4), (-9, 9, 0)):
        limits = f"{{has_position_limits: true, min_position: {least}, max_position: {most}}}"
        written(f"joint_limits:\n  slide: {limits}", "l.yaml")
        end, out, _ = audit(capsys, name, "--scene", "s.yaml", "--limits", "l.yaml")
        assert end == status
        assert ("limits    slide is 0 .. 1, outside its limits -0.5 .. 0.5\n" in out) == bool(status)


def test_the_way_to_a_later_first_point_is_told(written, capsys):
    """What happens before the first point is not in the file."""
    written(CAN, "s.yaml")
    status, out, _ = audit(capsys, written(of_joints((1, 1.0), (2, 1.2))), "--scene", "s.yaml")
    assert status == 0
    assert "before    the first point is due at 1 s; the way there" in out


# -- bases --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("curved", [False, True])
def test_a_base_is_driven_beside_the_joints(cart, written, kind, curved):
    """The base moves straight between its points, whatever the joints do; a collision on its way is found."""
    robot = cart.add_base(kind, name="drive")
    arm = moved((0, 0.0), (4, 1.0))
    if curved:
        for point, velocity in zip(arm["points"], (0.5, -0.5), strict=True):
            point["velocities"] = [velocity]
    message = {"joint_trajectory": arm, "multi_dof_joint_trajectory": driven((0, 0, 0, 0), (4, 4, 2, 0))}
    part = ControllerPoints.load(written(message), robot=robot)
    scene = Scene()
    scene.add("post", Body.sphere(0.01), placed(2, 1))  # where the mast is after two seconds
    checker = CollisionChecker(robot, scene)
    found = checker.certify_trajectory(part)
    assert (found.verdict, found.names) == (Verdict.COLLIDING, ("mast", "post"))
    assert checker.first_contact(part).touching_at == pytest.approx(2 - (0.05 + 0.01) / math.hypot(1, 0.5), abs=0.02)
    scene.move("post", placed(2, 1.3))
    assert checker.certify_trajectory(part).verdict == Verdict.FREE


def test_a_base_turns(cart, written):
    """A planar base has the headings of its points, without jumps of a turn; so has a floating one on straight ways."""
    turns = driven((0, 0, 0, 3.0), (4, 0, 0, 3.4))
    arm = moved((0, 0.0), (4, 0.0))
    message = written({"joint_trajectory": arm, "multi_dof_joint_trajectory": turns})
    part = ControllerPoints.load(message, robot=cart.add_base("planar", name="drive"))
    np.testing.assert_allclose(part.positions[:, part.names.index("drive/theta")], [3.0, 3.4])
    on_float = cart.add_base("floating", name="drive")
    part = ControllerPoints.load(message, robot=on_float)
    w, z = (part.positions[:, part.names.index(f"drive/q{axis}")] for axis in "wz")
    np.testing.assert_allclose(2 * np.unwrap(np.arctan2(z, w)), [3.0, 3.4])
    for point in arm["points"]:
        point["velocities"] = [0.0]
    message = written({"joint_trajectory": arm, "multi_dof_joint_trajectory": turns})
    with pytest.raises(FileError, match=r"expected a base that does not turn, as the joints have velocities"):
        ControllerPoints.load(message, robot=on_float)
    alone = ControllerPoints.load(written(turns), robot=on_float)
    assert alone.positions.shape == (2, 9)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda m: m["points"][1]["time_from_start"].update(sec=5),
            "expected the same times for the joints and for drive",
        ),
        (lambda m: m["points"].pop(), "expected the same times"),
        (lambda m: m["joint_names"].append("b"), "expected a sequence of 2"),
        (lambda m: m.update(joint_names=["wheel"]), "moves 'wheel'; Robot.add_base"),
        (lambda m: m["points"][1]["transforms"][0]["translation"].update(z=0.1), "planar joint drive in its plane"),
        (lambda m: m["points"][1]["transforms"][0]["rotation"].update(w=0.5), "quaternions of norm 1 for drive"),
        (lambda m: m["points"][1].update(velocities=[{"linear": {"x": 1.0}}]), "between which a base moves straight"),
    ],
)
def test_bases_that_cannot_be_read(cart, written, change, told):
    """A motion of a base that has no place among the robot's values is refused."""
    base = driven((0, 0, 0, 0), (4, 4, 0, 0))
    change(base)
    message = written({"joint_trajectory": moved((0, 0.0), (4, 1.0)), "multi_dof_joint_trajectory": base})
    with pytest.raises(FileError, match=told):
        ControllerPoints.load(message, robot=cart.add_base("planar", name="drive"))


# -- what is told, and what is refused --------------------------------------------------------------


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (
            {"model_id": "panda", "trajectory": [of_joints((0, 0.0), (1, 1.0))]},
            "for the robot 'panda', and is read for",
        ),
        (
            {"trajectory": moved((0, 0.0), (1, 1.0)), "path_tolerance": [{"name": "slide", "position": 0.5}]},
            "lets slide deviate by 0.5 on the way",
        ),
        (
            {"trajectory": moved((0, 0.0), (1, 1.0)), "path_tolerance": [{"name": "slide", "position": -1}]},
            "lets slide deviate without a limit",
        ),
        (
            {
                "start_scene": {"link_padding": [{"link_name": "cart", "padding": 0.1}]},
                "sub_trajectory": [{"trajectory": of_joints((0, 0.0), (1, 1.0))}],
            },
            "start_scene/link_padding is not read",
        ),
    ],
)
def test_what_is_not_read_is_told(cart, written, message, told):
    """Parts of a message without an effect here cause a warning."""
    with pytest.warns(UserWarning, match=told):
        ControllerPoints.load(written(message), robot=cart)


@pytest.mark.parametrize(
    ("time", "told"),
    [
        (True, "expected a number"),
        ({"sec": 1, "secs": 5}, "expected sec and nanosec, or secs and nsecs, found sec, secs"),
        ({"sec": 1}, "expected sec and nanosec"),
        ({"sec": 1, "nanosec": 0, "msec": 500}, "found 'msec'"),
        (1_000_000_000, "is it in nanoseconds"),
        ("1_0", "expected"),
    ],
)
def test_times_that_are_none(written, time, told):
    """A duration has seconds and nanoseconds of one spelling, or is a number."""
    message = moved((0, 0.0), (1, 1.0))
    message["points"][1]["time_from_start"] = time
    with pytest.raises(FileError, match=rf"time_from_start: .*{told}"):
        ControllerPoints.load(written(message))


@pytest.mark.parametrize("text", ["1e-05", "1.0e-5", "0.00001"])
def test_numbers_as_other_programs_write_them(written, text):
    """PyYAML reads an exponent without a point as text; other readers do not."""
    point = "{{positions: [{}], time_from_start: {{secs: {}, nsecs:         0}}}}"
    points = ", ".join(point.format(x, t) for t, x in enumerate((text, "1")))
    found = ControllerPoints.load(written(f"joint_names: [slide]\npoints: [{points}]\n---\n", "m.yaml"))
    assert found.positions[:, 0].tolist() == [1e-5, 1.0]


@pytest.mark.parametrize("text", ["050000000", "010", "1:30", "1_5", "0x10", ".inf", "'1'"])
def test_numbers_that_versions_of_yaml_read_differently(written, text):
    """Such a number is refused, with its line."""
    points = "{positions: [0], time_from_start: {secs: 0, nsecs: 0}}"
    points += f", {{positions: [1], time_from_start: {{secs: 1, nsecs: {text}}}}}"
    with pytest.raises(FileError, match=r"line 2: points\[1\]/time_from_start/nsecs: expected a"):
        ControllerPoints.load(written(f"joint_names: [slide]\npoints: [{points}]\n", "m.yaml"))
