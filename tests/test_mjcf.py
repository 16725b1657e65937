"""MJCF: robots and scenes as MuJoCo has them; what cannot be read is refused."""

import os
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest

import loewner
from loewner import Body, CollisionChecker, FileError, GeometryError, InputError, Robot, Scene, load_scene
from mjcf_oracle import compare
from sampling import quick, quick_of

# Two geoms and a joint of each kind, by MuJoCo's names.
SHAPES = {"sphere": 1, "capsule": 2, "ellipsoid": 3, "cylinder": 2, "box": 3}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo logs what it warns of in the working directory."""
    monkeypatch.chdir(tmp_path)


def written(folder: Path, inside: str, outside: str = "") -> Path:
    """A model with this in its world."""
    path = folder / "model.xml"
    path.write_text(f'<mujoco model="model">{outside}<worldbody>{inside}</worldbody></mujoco>')
    return path


def numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, np.asarray(values, dtype=float).tolist()))


def random_geom(rng: np.random.Generator, mesh: bool) -> str:
    masks = f'contype="{rng.integers(4)}" conaffinity="{rng.integers(4)}"'
    pose = f'pos="{numbers(rng.normal(size=3) * 0.1)}" quat="{numbers(rng.normal(size=4))}"'
    if mesh:
        return f'<geom type="mesh" mesh="stone" {masks} {pose}/>'
    kind = rng.choice(list(SHAPES))
    return f'<geom type="{kind}" size="{numbers(rng.uniform(0.05, 0.2, SHAPES[kind]))}" {masks} {pose}/>'


def random_joint(rng: np.random.Generator, kinds: list[str]) -> str:
    kind = rng.choice(kinds)
    free = f'axis="{numbers(rng.normal(size=3))}" ref="{rng.normal()}"' if kind in ("hinge", "slide") else ""
    limits = f'range="{rng.uniform(-2, 0)} {rng.uniform(0, 2)}"' if free and rng.random() < 0.7 else ""
    return f'<joint type="{kind}" pos="{numbers(rng.normal(size=3) * 0.1)}" {free} {limits}/>'


def random_body(rng: np.random.Generator, depth: int) -> str:
    """A body with joints of all kinds and geoms of all shapes, and others in it."""
    if depth == 0 and rng.random() < 0.3:
        joints = "<freejoint/>"
    elif rng.random() < 0.3:
        joints = random_joint(rng, ["ball"]) + random_joint(rng, ["slide"]) * int(rng.integers(2))
    else:
        joints = "".join(random_joint(rng, ["hinge", "slide"]) for _ in range(rng.integers(4)))
    geoms = "".join(random_geom(rng, rng.random() < 0.15) for _ in range(1 + rng.integers(3)))
    inside = "".join(random_body(rng, depth + 1) for _ in range(rng.integers(3) if depth < 3 else 0))
    pose = f'pos="{numbers(rng.normal(size=3) * 0.3)}" quat="{numbers(rng.normal(size=4))}"'
    return f"<body {pose}>{joints}{geoms}{inside}</body>"


def random_model(rng: np.random.Generator, folder: Path) -> Path:
    """A model of some trees of bodies on a floor, with bodies that are excluded, geoms that are paired, and a mesh."""
    stone = f'<asset><mesh name="stone" vertex="{numbers(rng.normal(size=30) * 0.1)}"/></asset>'
    filters = '<option><flag filterparent="disable"/></option>' * int(rng.random() < 0.3)
    bodies = "".join(random_body(rng, 0) for _ in range(3))
    named = bodies.count("<body ")
    for number in range(named):
        bodies = bodies.replace("<body pos", f'<body name="b{number}" pos', 1)
    for number in range(bodies.count("<geom type")):
        bodies = bodies.replace("<geom type", f'<geom name="g{number}" type', 1)
    one, other = rng.choice(named, 2, replace=False)
    contact = f'<contact><exclude body1="b{one}" body2="b{other}"/><pair geom1="g0" geom2="floor"/></contact>'
    floor = '<geom name="floor" type="plane" size="1 1 1" pos="0 0 -0.5"/>' + random_geom(rng, False)
    return written(folder, floor + bodies, stone + filters + contact)


@pytest.mark.parametrize("seed", quick_of(range(30), range(2)))
def test_random_models_agree_with_mujoco(seed, tmp_path):
    """A configuration is MuJoCo's qpos: its bodies are where we have them, and the same pairs of geoms touch."""
    rng = np.random.default_rng(seed)
    path = random_model(rng, tmp_path)
    robot = Robot.from_mjcf(path)
    assert robot.dof == mujoco.MjModel.from_xml_path(str(path)).nq
    told = compare(robot, path, robot.random_configurations(40, seed=seed))
    assert told["off"] < 1e-13
    assert told["ours"] == told["theirs"] == 0


def test_random_models_do_touch(tmp_path):
    """The models of the test above have contacts for it to miss, and free pairs as well."""
    robot = Robot.from_mjcf(random_model(np.random.default_rng(3), tmp_path))
    hits = CollisionChecker(robot).collide_by_pair(robot.random_configurations(40))
    assert 0.01 < hits.mean() < 0.9


# -- what a model says ---------------------------------------------------------------------------------


def test_limits_references_and_keyframes(tmp_path):
    """Limits are those of qpos, whatever the reference; a keyframe is a state, by the names of the joints."""
    arm = (
        '<body name="arm"><joint name="turn" ref="90" range="-10 120" axis="0 0 1"/>'
        '<geom size="0.1"/><body name="ball"><joint name="wrist" type="ball"/><geom size="0.1"/></body></body>'
    )
    key = '<keyframe><key name="home" qpos="0.5 0 1 0 0"/><key qpos="1 1 0 0 0"/></keyframe>'
    robot = Robot.from_mjcf(written(tmp_path, arm, key))
    assert robot.configuration_names == ("turn", "wrist/qw", "wrist/qx", "wrist/qy", "wrist/qz")
    assert np.allclose(robot.lower, [np.deg2rad(-10), -1, -1, -1, -1])
    assert np.allclose(robot.upper, [np.deg2rad(120), 1, 1, 1, 1])
    assert robot.configuration("home").tolist() == [0.5, 0, 1, 0, 0]
    assert robot.configuration("key1").tolist() == [1, 1, 0, 0, 0]
    assert np.allclose(robot.forward_kinematics([np.pi / 2, 1, 0, 0, 0]), np.eye(4))


def test_names_are_made_where_there_are_none(tmp_path):
    """Bodies, joints and geoms without a name get their kind and number, with a mark where a file has that name."""
    bodies = '<body><joint/><geom size="1"/></body><body name="body1"><geom size="1"/></body>'
    robot = Robot.from_mjcf(written(tmp_path, '<geom size="0.1"/>' + bodies))
    assert robot.link_names == ("world", "geom0", "body1_", "body1")
    assert robot.joint_names == ("joint0",)


def test_visual_geoms_are_left_out(tmp_path):
    """A geom whose masks are 0 collides with nothing, and is not read; unless a <pair> names it."""
    looks = '<body name="a"><freejoint/><geom name="looks" size="1" contype="0" conaffinity="0"/></body>'
    geoms = looks + '<body name="b"><geom name="g" size="1"/></body>'
    assert set(Robot.from_mjcf(written(tmp_path, geoms)).bodies) == {"b"}
    paired = Robot.from_mjcf(written(tmp_path, geoms, '<contact><pair geom1="looks" geom2="g"/></contact>'))
    assert set(paired.bodies) == {"a", "b"}
    assert CollisionChecker(paired).collide(paired.configuration())


def test_meshes_are_the_hulls_that_mujoco_has(tmp_path):
    """A mesh that is not convex is its convex hull, placed where MuJoCo puts it."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)] + [[0.5, 0.5, 0.2]], dtype=float)
    asset = f'<asset><mesh name="m" vertex="{numbers(corners.ravel())}"/></asset>'
    inside = '<body name="a" pos="1 2 3"><geom type="mesh" mesh="m" pos="1 0 0"/></body>'
    robot = Robot.from_mjcf(written(tmp_path, inside, asset))
    vertices = robot.bodies["a"].pieces[0].vertices
    assert len(vertices) == 8
    assert np.allclose(np.sort(vertices, axis=0), np.sort(corners[:8] + [1, 0, 0], axis=0), atol=1e-6)


@pytest.mark.parametrize(
    ("inside", "outside", "kind", "message"),
    [
        (
            '<geom name="blob" type="sdf" mesh="m"/>',
            '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
            InputError,
            "geom 'blob': expected a sphere.*found a signed distance field.*from_surface",
        ),
        ('<geom type="spehre"/>', "", FileError, "MuJoCo refuses"),
        ("<body><freejoint/></body>", "", FileError, "mass and inertia"),
        ('<geom size="1e-40"/>', "", GeometryError, "geom 'geom0'"),
    ],
)
def test_what_cannot_be_read_is_refused(inside, outside, kind, message, tmp_path):
    """The error names the file, and the geom; MuJoCo's own words are passed on."""
    with pytest.raises(kind, match=message):
        Robot.from_mjcf(written(tmp_path, inside, outside))


def test_missing_files_are_refused(tmp_path):
    """A file that is not there, and what is no path."""
    with pytest.raises(FileError, match="none.xml"):
        Robot.from_mjcf(tmp_path / "none.xml")
    with pytest.raises(InputError, match="path to an MJCF file"):
        Robot.from_mjcf(3)


TWO = """<body name="a" pos="0 0 1"><joint name="j" type="slide" range="-1 1"/><geom name="g" size="0.1" {}/></body>
<body name="b" pos="1 0 1"><joint name="k" type="slide" range="-1 1"/><geom name="h" size="0.1"/></body>
<body name="m" mocap="true" pos="5 0 0"><geom size="0.1"/></body>{}"""
SERVO = '<actuator><position joint="j" ctrlrange="{}" ctrllimited="true"/></actuator>'
BALL = '<body pos="0 3 1"><joint type="ball" range="0 0.1" limited="true"/><geom size="0.1"/></body>'


@pytest.mark.parametrize(
    ("geom", "body", "more", "told"),
    [
        ("", "", '<equality><joint joint1="j" joint2="k"/></equality>', r"1 constraints \(equality\)"),
        (
            "",
            "",
            '<equality><weld body1="a" body2="b"/><connect body1="a" body2="b" anchor="0 0 0"/></equality>',
            "2 con",
        ),
        (
            "",
            "",
            '<tendon><fixed limited="true" range="-1 1"><joint joint="j" coef="1"/></fixed></tendon>',
            "1 limits of tendons",
        ),
        ("", BALL, "", "1 limits of ball joints"),
        ("", "", SERVO.format("-0.1 0.1"), "1 limits of position actuators"),
        ('margin="0.5"', "", "", "1 margins of geoms"),
        ("", "", '<contact><pair geom1="g" geom2="h" margin="0.1"/></contact>', "1 margins of pairs"),
        ("", "", '<keyframe><key mpos="1 0 0"/></keyframe>', "1 poses of mocap bodies in keyframes"),
    ],
)
def test_what_mujoco_computes_with_and_is_not_read_is_told(geom, body, more, told, tmp_path):
    """One warning counts the parts of each kind."""
    path = written(tmp_path, TWO.format(geom, body))
    path.write_text(path.read_text().replace("</mujoco>", f"{more}</mujoco>"))
    with pytest.warns(UserWarning, match=f"not read, although MuJoCo computes with it: {told}") as caught:
        Robot.from_mjcf(path)
    assert len(caught) == 1


def test_what_changes_nothing_is_not_told(tmp_path):
    """A range of a servo as wide as its joint's, a margin of 0, and a mocap body where the model has it."""
    path = written(tmp_path, TWO.format('margin="0"', ""))
    more = SERVO.format("-1 1") + '<keyframe><key mpos="5 0 0"/></keyframe>'
    path.write_text(path.read_text().replace("</mujoco>", f"{more}</mujoco>"))
    Robot.from_mjcf(path)


def test_unnamed_keyframes_keep_out_of_the_way(tmp_path):
    """A keyframe without a name gets one that no other has."""
    path = written(tmp_path, TWO.format("", ""))
    keys = '<key name="key1" qpos="0.5 0"/><key qpos="0.25 0"/>'
    path.write_text(path.read_text().replace("</mujoco>", f"<keyframe>{keys}</keyframe></mujoco>"))
    states = Robot.from_mjcf(path).states
    assert [states[name][1]["j"] for name in ("key1", "key1_")] == [0.5, 0.25]


def test_a_urdf_that_mujoco_reads_is_told(tmp_path):
    """MuJoCo makes a mimic joint a constraint, which is not read."""
    path = tmp_path / "r.urdf"
    path.write_text(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry><box size="1 1 1"/></geometry></collision></link><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    with pytest.warns(UserWarning, match="found a URDF, of which MuJoCo reads neither <mimic> nor"):
        Robot.from_mjcf(path)


def test_flexible_bodies_are_told(tmp_path):
    """What bends is left out, with a warning: nobody else says that it is not checked."""
    cloth = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" dim="2" radius="0.01"/>'
    with pytest.warns(UserWarning, match="1 flexible"):
        Robot.from_mjcf(written(tmp_path, cloth + '<geom size="1"/>'))


# -- ball joints ---------------------------------------------------------------------------------------


@pytest.fixture
def arm(tmp_path):
    """A checker of an arm with a ball joint and a hinge, beside a wall."""
    robot = Robot.from_mjcf(
        written(
            tmp_path,
            '<body name="upper" pos="0.1 0 0"><joint name="shoulder" type="ball" pos="0 0.05 0"/>'
            '<geom type="capsule" fromto="0.1 0 0 0.4 0 0" size="0.05"/><body name="lower" pos="0.5 0 0">'
            '<joint name="elbow" axis="0 1 0"/><geom type="box" size="0.2 0.02 0.02" pos="0.25 0 0"/></body></body>',
        )
    )
    scene = Scene()
    T = np.eye(4)
    T[0, 3] = 0.9
    scene.add("wall", Body.box([0.2, 2, 2]), T)
    return CollisionChecker(robot, scene)


def test_gradients_of_ball_joints(arm):
    """Jacobians and gradients of clearances are those of differences, across the sphere of unit quaternions."""
    robot, h = arm.robot, 1e-6
    for q in robot.random_configurations(20, seed=1):
        _, found = arm.clearance(q, gradient=True)
        J = robot.jacobian(q, "lower", [0.3, 0, 0])
        for step in np.random.default_rng(0).normal(size=(4, robot.dof)):
            step[:4] -= q[:4] * (q[:4] @ step[:4])
            ends = q + np.array([[-h], [h]]) * step
            ends[:, :4] /= np.linalg.norm(ends[:, :4], axis=1, keepdims=True)
            low, high = arm.clearance(ends)
            assert found @ step == pytest.approx((high - low) / (2 * h), abs=1e-5)
            T = robot.forward_kinematics(ends)[:, robot.link_names.index("lower")]
            moved = (T[1] - T[0]) @ [0.3, 0, 0, 1]
            assert np.allclose(J[:3] @ step, moved[:3] / (2 * h), atol=1e-6)


def test_motions_of_ball_joints(arm):
    """A motion proven free has no configuration that collides, and one said to collide does so where it says."""
    Q = arm.robot.random_configurations(400, seed=2)
    told = arm.certify_edges(Q[:-1], Q[1:])
    t = np.linspace(0, 1, 200)
    for q0, q1, verdict, fraction in zip(Q, Q[1:], told.verdict, told.fraction, strict=False):
        way = arm.robot.between(q0, q1, t)
        assert np.allclose(np.linalg.norm(way[:, :4], axis=1), 1)
        if verdict == loewner.Verdict.FREE:
            assert not arm.collide(way).any()
        elif verdict == loewner.Verdict.COLLIDING:
            assert arm.collide(arm.robot.between(q0, q1, [fraction])).all()
    counts = np.bincount(told.verdict, minlength=3)
    assert counts[loewner.Verdict.FREE] > 50
    assert counts[loewner.Verdict.COLLIDING] > 50


def test_a_ball_joint_turns_as_three_hinges_do(tmp_path):
    """The same rotation by a ball joint and by three hinges puts the body in the same place."""
    geom = '<geom size="0.1" pos="1 0 0"/>'
    hinges = "".join(f'<joint axis="{axis}" pos="0 0 0.2"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    ball = f'<body name="ball"><joint type="ball" pos="0 0 0.2"/>{geom}</body>'
    robot = Robot.from_mjcf(written(tmp_path, f'{ball}<body name="hinges">{hinges}{geom}</body>'))
    angles = np.random.default_rng(4).uniform(-1, 1, 3)
    turn = np.array([1.0, 0, 0, 0])
    for k, angle in enumerate(angles):
        by, both = np.zeros(4), np.zeros(4)
        by[0], by[1 + k] = np.cos(angle / 2), np.sin(angle / 2)
        mujoco.mju_mulQuat(both, turn, by)
        turn = both
    Ts = robot.forward_kinematics([*turn, *angles])
    assert np.allclose(*(Ts[robot.link_names.index(name)] for name in ("ball", "hinges")))


def test_no_urdf_has_a_ball_joint(tmp_path):
    """The kind is MuJoCo's alone."""
    joint = '<joint name="j" type="ball"><parent link="a"/><child link="b"/></joint>'
    with pytest.raises(InputError, match="floating, found 'ball'"):
        Robot.from_urdf(text=f'<robot name="r"><link name="a"/><link name="b"/>{joint}</robot>')


# -- scenes --------------------------------------------------------------------------------------------


def test_scenes_stand_where_mujoco_puts_them(tmp_path):
    """A scene has what collides, where the references of the joints put it, and lets touch what MuJoCo does."""
    path = random_model(np.random.default_rng(5), tmp_path)
    scene, robot = load_scene(path), Robot.from_mjcf(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    Ts = robot.forward_kinematics(np.array(model.qpos0))
    assert set(scene) == set(robot.bodies)
    for name in scene:
        assert np.allclose(scene.pose(name), Ts[robot.link_names.index(name)], atol=1e-14)
    found = (scene.pairs(), CollisionChecker(robot).pairs(np.array(model.qpos0)))
    ours, theirs = ({tuple(sorted((c.name_a, c.name_b))) for c in contacts} for contacts in found)
    assert ours == theirs


def test_a_plane_is_the_space_below_it(tmp_path):
    """What is under a plane collides with it, however deep, and what is over it does not."""
    scene = load_scene(written(tmp_path, '<geom name="floor" type="plane" size="0.1 0.1 0.1"/>'))
    ball, T = Body.sphere(0.1), np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, 3] = [[300, -200, 0.1001], [300, -200, 0.0999], [0, 0, -1], [0, 0, -900]]
    assert loewner.collide(ball, T, scene["floor"], scene.pose("floor")).tolist() == [False, True, True, True]


@pytest.mark.parametrize("count", quick(150, 2000))
def test_height_fields_are_where_mujoco_has_them(count, tmp_path):
    """Balls touch a tilted terrain for both, over it, in it and at its rim, and so do they in a scene."""
    rng = np.random.default_rng(0)
    asset = (
        '<asset><hfield name="h" nrow="7" ncol="5" size="1.5 1 0.7 0.2"'
        f' elevation="{numbers(rng.uniform(0, 1, 35))}"/></asset>'
    )
    path = written(
        tmp_path,
        '<geom name="hill" type="hfield" hfield="h" pos="0.1 0.2 0.3" euler="10 20 30"/>'
        '<body name="ball"><freejoint/><geom size="0.1"/></body>',
        asset,
    )
    Q = np.zeros((count, 7))
    Q[:, :3], Q[:, 3] = rng.uniform([-1.7, -1.3, -0.2], [1.9, 1.7, 1.4], (count, 3)), 1
    told = compare(Robot.from_mjcf(path), path, Q)
    assert told["off"] < 1e-14
    assert told["both"] > 0.15 * count
    assert (told["ours"], told["theirs"]) == (0, 0)
    scene, Ts = load_scene(path), np.tile(np.eye(4), (count, 1, 1))
    Ts[:, :3, 3] = Q[:, :3]
    assert loewner.collide(scene["ball"], Ts, scene["hill"], scene.pose("hill")).sum() == told["both"] + told["near"]


def test_a_viewer_shows_what_stands_on_a_plane(tmp_path):
    """The camera starts at the robot, not where it would see all of the floor; a ball joint has sliders."""
    viewer = pytest.importorskip("loewner.viewer")
    pytest.importorskip("viser")
    inside = '<geom type="plane" size="1 1 1"/><body pos="0 0 1"><joint name="b" type="ball"/><geom size="0.2"/></body>'
    robot = Robot.from_mjcf(written(tmp_path, inside))
    with viewer.show_robot(CollisionChecker(robot), robot.configuration()) as page:
        assert np.linalg.norm(page.server.initial_camera.position) < 10
        assert len(page._sliders) == 4


# -- files that MuJoCo would never be done with -----------------------------------------------------


def model_file(folder, body, name="model.xml"):
    path = folder / name
    path.write_text(f"<mujoco>{body}</mujoco>")
    return path


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<worldbody><replicate count="1000000000"><geom size="1"/></replicate></worldbody>', "at most 4096 copies"),
        (
            '<worldbody><replicate count="1000"><replicate count="1000"><replicate count="1000"><geom size="1"/>'
            "</replicate></replicate></replicate></worldbody>",
            "at most 4096 copies",
        ),
        ("<worldbody>" + '<replicate count="1000"><geom size="1"/></replicate>' * 5 + "</worldbody>", "4096 copies"),
        ('<asset><hfield name="h" nrow="1000000" ncol="1000000" size="1 1 1 1"/></asset>', "height field of 10{12}"),
        ('<worldbody><geom size="1"></worldbody>', "expected an MJCF file, found broken XML"),
    ],
)
def test_models_that_take_for_ever_are_refused_before_they_are_compiled(tmp_path, body, message):
    """MuJoCo's compiler heeds no interrupt: what would keep it busy or fill the memory does not reach it."""
    with pytest.raises(loewner.LoewnerError, match=message):
        Robot.from_mjcf(model_file(tmp_path, body))


def test_copies_in_included_files_count(tmp_path):
    """An include in a replica is copied with it; a file that includes itself ends."""
    model_file(tmp_path, '<worldbody><replicate count="100"><geom size="1"/></replicate></worldbody>', "many.xml")
    path = model_file(tmp_path, '<worldbody><replicate count="100"><include file="many.xml"/></replicate></worldbody>')
    with pytest.raises(FileError, match=r"many.xml, line 1: expected at most 4096 copies"):
        Robot.from_mjcf(path)
    with pytest.raises(FileError, match="at most 100 included files"):
        Robot.from_mjcf(model_file(tmp_path, '<include file="self.xml"/>', "self.xml"))


def test_pipes_that_a_model_names_are_refused(tmp_path):
    """A pipe would block the compiler for ever, wherever <compiler> says that files are."""
    (tmp_path / "meshes").mkdir()
    os.mkfifo(tmp_path / "meshes" / "a.stl")
    os.mkfifo(tmp_path / "b.xml")
    for body in ('<compiler meshdir="meshes"/><asset><mesh file="a.stl"/></asset>', '<include file="b.xml"/>'):
        with pytest.raises(FileError, match="regular file|which is none"):
            Robot.from_mjcf(model_file(tmp_path, body))


def test_replicas_within_the_limits_are_read(tmp_path):
    """A row of twenty balls is twenty bodies."""
    replica = '<replicate count="20" offset="1 0 0"><body><joint/><geom size="0.1"/></body></replicate>'
    assert Robot.from_mjcf(model_file(tmp_path, f"<worldbody>{replica}</worldbody>")).dof == 20


def test_limits_in_degrees_are_doubted(tmp_path):
    """A file whose compiler takes radians, with limits of a right angle."""
    text = """<mujoco><compiler angle="{}"/><worldbody><body><joint name="j" range="-90 90"/><geom size="0.1"/></body>
    </worldbody></mujoco>"""
    for angle, told in (("radian", 1), ("degree", 0)):
        (tmp_path / "arm.xml").write_text(text.format(angle))
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            robot = Robot.from_mjcf(tmp_path / "arm.xml")
        assert len(found) == told
        assert all("joint 'j': expected limits in radians, found -90 .. 90" in str(one.message) for one in found)
    assert robot.upper[0] == np.pi / 2
