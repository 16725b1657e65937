"""Robots of Drake's, pinocchio's and MuJoCo's models in memory: their poses, pairs, verdicts, distances and positions.

Drake is not among the packages of the quick suite; `make test-models` installs it.
"""

import warnings

import numpy as np
import pytest

from loewner import Body, CollisionChecker, InputError, Robot, Scene, UnknownNameError, planners
from other_models import TOUCHING, Drake, MuJoCo, Pinocchio, compare, every_joint, made_of_every_joint
from sampling import quick

COUPLED = """<mujoco model="coupled"><worldbody>
<geom name="floor" type="plane" size="1 1 1" pos="0 0 -2"/>
<body name="a"><joint name="h" ref="30" axis="0 1 0" range="-60 60"/><geom size="0.1" pos="0 0 0.3"/>
<body name="b" pos="0 0 0.5"><joint name="f" ref="10" axis="1 0 1"/><geom size="0.1" pos="0.1 0 0.3"/>
<body name="c" pos="0 0.3 0.3"><joint name="s" type="slide" ref="0.1" axis="0 1 1"/>
<geom type="box" size="0.1 0.1 0.1"/></body></body></body>
<body name="m" mocap="true" pos="0 0 1"><geom size="0.2"/></body>
<body name="z" pos="0 0 3"><freejoint name="free"/><geom size="0.2"/></body></worldbody>
<equality><joint joint1="f" joint2="h" polycoef="0.1 -1 0 0 0"/>
<joint name="off" joint1="s" joint2="f" polycoef="0.02 0.3 0 0 0"/></equality>
<keyframe><key name="k" qpos="0.1 0.2 0.3 0 0 1 1 0 0 0"/></keyframe></mujoco>"""


COUNT, DETAILS = 300, 100


@pytest.fixture(autouse=True, params=quick((120, 30), (300, 100)), ids=str)
def number(request, monkeypatch):
    """How many configurations are compared, and of how many all pairs, whatever the verdicts."""
    for name, value in zip(("COUNT", "DETAILS"), request.param, strict=True):
        monkeypatch.setitem(globals(), name, value)


def agreed(theirs, count=None, details=None):
    """Expect no difference that is not within the tolerances of the other library."""
    count, details = count or COUNT, DETAILS if details is None else details
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        told = compare(theirs, count, details=details)
    assert told["wrong"] == []
    assert told["off"] < 1e-13
    assert told["split"] == 0
    assert told["over"] < 1e-4
    assert told["under"] < TOUCHING
    assert told["near"] <= count / 100
    return told


# -- pinocchio --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", quick(0, 1, 2))
def test_pinocchio_joints(seed):
    """Links are where pinocchio has its frames, and the same pairs touch, for joints of every kind and mimics."""
    told = agreed(Pinocchio(*made_of_every_joint(seed)), details=100)
    assert 0 < told["hits"] < COUNT
    assert told["pairs"] > 10


def free_body(shape, other):
    """A shape of Coal that floats freely about another one, which is fixed."""
    pin = pytest.importorskip("pinocchio")
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.lowerPositionLimit[:3], model.upperPositionLimit[:3] = -0.7, 0.7
    frame = model.addBodyFrame("moving", joint, pin.SE3.Identity(), 0)
    geometry.addGeometryObject(pin.GeometryObject("moving", joint, frame, pin.SE3.Identity(), shape))
    aside = pin.SE3(pin.rpy.rpyToMatrix(0.5, 1.0, 0.3), np.array([0.1, 0.05, 0.0]))
    geometry.addGeometryObject(pin.GeometryObject("still", 0, 0, aside, other))
    geometry.addAllCollisionPairs()
    return model, geometry


def coal_shapes():
    """One of each kind that is read."""
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(6)
    points = coal.StdVec_Vec3s()
    for point in rng.normal(size=(20, 3)) * 0.2:
        points.append(point)
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(12, 36)
    for triangle in rng.normal(size=(12, 3, 3)) * 0.15 + rng.normal(size=(12, 1, 3)) * 0.2:
        mesh.addTriangle(*triangle)
    mesh.endModel()
    swept = coal.Sphere(0.1)
    swept.setSweptSphereRadius(0.15)
    return {
        "box": coal.Box(0.3, 0.4, 0.2), "sphere": coal.Sphere(0.2), "capsule": coal.Capsule(0.1, 0.4),
        "cylinder": coal.Cylinder(0.15, 0.3), "cone": coal.Cone(0.2, 0.4), "ellipsoid": coal.Ellipsoid(0.1, 0.2, 0.3),
        "convex": coal.Convex.convexHull(points, True, ""),
        "mesh": mesh, "swept": swept,
        "terrain": coal.HeightFieldOBBRSS(1.0, 1.5, rng.uniform(0, 0.3, (5, 4)), -0.1),
    }  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    ["box", "sphere", "capsule", "cylinder", "cone", "ellipsoid", "convex", "mesh", "swept", "terrain"],
)
def test_coal_shapes(kind):
    """Each shape collides and is as far away as in Coal, which has no distances to height fields."""
    coal = pytest.importorskip("coal")
    model, geometry = free_body(coal_shapes()[kind], coal.Box(0.3, 0.2, 0.25))
    theirs = Pinocchio(model, geometry)
    if kind == "terrain":
        theirs.distance = lambda q: None
    told = agreed(theirs)
    assert COUNT / 30 < told["hits"] < 0.97 * COUNT


def test_coal_half_space_and_octree():
    """A half-space is solid below its plane; an octree is its boxes."""
    coal, pin = pytest.importorskip("coal"), pytest.importorskip("pinocchio")
    told = agreed(Pinocchio(*free_body(coal.Box(0.3, 0.2, 0.25), coal.Halfspace(np.array([0.0, 0.6, 0.8]), 0.1))))
    assert COUNT / 30 < told["hits"] < 0.97 * COUNT
    tree = coal.makeOctree(np.random.default_rng(7).uniform(-0.5, 0.5, (30, 3)), 0.1)
    model, geometry = free_body(coal.Box(0.3, 0.2, 0.25), tree)
    geometry.geometryObjects[1].placement = pin.SE3.Identity()
    told = agreed(Pinocchio(model, geometry), details=0)
    assert COUNT / 30 < told["hits"] < 0.97 * COUNT


def test_closed_meshes_are_solid_unlike_in_coal():
    """A ball inside a closed mesh collides, and is free in Coal; with hulls it collides as well."""
    coal, pin = pytest.importorskip("coal"), pytest.importorskip("pinocchio")
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((1, 1, 1))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(12, 8)
    for triangle in box.triangles:
        mesh.addTriangle(*triangle)
    mesh.endModel()
    model, geometry = free_body(coal.Sphere(0.05), mesh)
    geometry.geometryObjects[1].placement = pin.SE3.Identity()
    q = np.array([0, 0, 0, 0, 0, 0, 1.0])
    assert not pin.computeCollisions(model, model.createData(), geometry, geometry.createData(), q, True)
    for meshes in ("surface", "hull"):
        robot = Robot.from_pinocchio(model, geometry, meshes=meshes)
        assert CollisionChecker(robot).collide(robot.imported(q))
    agreed(Pinocchio(model, geometry, hollow=True))


@pytest.mark.parametrize(("hole", "kind"), [(False, "solid"), (True, "polytope")])
def test_meshes_of_pinocchio_become_hulls_or_solids(hole, kind):
    """As those of a URDF: an L-shaped mesh stays hollow between its arms, and an open one becomes its hull, told."""
    coal, trimesh = pytest.importorskip("coal"), pytest.importorskip("trimesh")
    pytest.importorskip("pinocchio")
    outline = np.array([[0, 0], [1, 0], [1, 0.1], [0.1, 0.1], [0.1, 1], [0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    corner = trimesh.creation.extrude_triangulation(outline, faces, height=0.1)
    triangles = corner.triangles[(4 if hole else 0) :]
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), 3 * len(triangles))
    for triangle in triangles:
        mesh.addTriangle(*triangle)
    mesh.endModel()
    model, geometry = free_body(coal.Sphere(0.05), mesh)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        robot = Robot.from_pinocchio(model, geometry, meshes="auto")
    assert kind in {piece.kind for body in robot.bodies.values() for piece in body.pieces}
    assert any("open, whose hulls were taken" in str(warning.message) for warning in told) == hole


def test_pinocchio_pairs():
    """The listed pairs are checked, but of shapes that are disabled; pairs on one link are told if they collide."""
    coal, pin = pytest.importorskip("coal"), pytest.importorskip("pinocchio")
    model, geometry = pin.Model(), pin.GeometryModel()
    joints = [model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name) for name in ("i", "j")]
    for name, joint in (("a", 0), ("b", 0), ("c", 1), ("d", 1), ("e", 1), ("f", 1)):
        geometry.addGeometryObject(
            pin.GeometryObject(name, joints[joint], 0, pin.SE3.Identity(), coal.Sphere(0.1 + 0.1 * (name == "b")))
        )
    for a, b in ((0, 2), (0, 3), (0, 1), (4, 1), (5, 0)):
        geometry.addCollisionPair(pin.CollisionPair(a, b))
    geometry.geometryObjects[5].disableCollision = True
    with pytest.warns(UserWarning, match="^model: not checked, since they are fixed to each other.*: 'i' and 'i/b'$"):
        robot = Robot.from_pinocchio(model, geometry)
    assert robot.link_names == ("universe", "i", "i/b", "j", "j/e", "j/f")
    assert len(robot.bodies["j"].pieces) == 2  # c and d are checked alike
    found = {frozenset(pair) for pair in CollisionChecker(robot).checked_pairs}
    assert found == {frozenset(pair) for pair in (("i", "j"), ("j/e", "i/b"))}
    geometry.removeAllCollisionPairs()
    with pytest.warns(UserWarning, match="expected collisionPairs, found none for 6 shapes"):
        Robot.from_pinocchio(model, geometry)


def test_pinocchio_refuses():
    """What cannot be represented is refused by its name."""
    coal, pin = pytest.importorskip("coal"), pytest.importorskip("pinocchio")
    model, geometry = free_body(coal.Sphere(0.1), coal.Plane(np.array([0.0, 0, 1]), 0.0))
    with pytest.raises(InputError, match="geometry 'still': expected a box, .*found a Plane"):
        Robot.from_pinocchio(model, geometry)
    fat = coal.Box(1, 1, 1)
    fat.setSweptSphereRadius(0.1)
    with pytest.raises(InputError, match="geometry 'moving': expected a Box without a swept sphere"):
        Robot.from_pinocchio(*free_body(fat, coal.Sphere(0.1)))
    odd = pin.Model()
    odd.addJoint(0, pin.JointModelEllipsoid(0.1, 0.2, 0.3), pin.SE3.Identity(), "odd")
    with pytest.raises(InputError, match="joint 'odd': .*JointModelEllipsoid"):
        Robot.from_pinocchio(odd, pin.GeometryModel())
    with pytest.raises(InputError, match="expected a joint of the model, found joint 1"):
        Robot.from_pinocchio(pin.Model(), geometry)
    with pytest.raises(InputError, match="model: expected a Model, found"):
        Robot.from_pinocchio(geometry, geometry)
    with pytest.raises(InputError, match="geometry_model: expected a GeometryModel, found None"):
        Robot.from_pinocchio(model, None)
    with pytest.raises(UnknownNameError, match="meshes"):
        Robot.from_pinocchio(model, geometry, meshes="triangles")


# -- MuJoCo -----------------------------------------------------------------------------------------


def coupled():
    """The model with three joints, two of which follow."""
    mujoco = pytest.importorskip("mujoco")
    theirs = MuJoCo(mujoco.MjModel.from_xml_string(COUPLED))
    theirs.data.mocap_pos[0], theirs.data.mocap_quat[0] = [0.3, 0.2, 1], [0.5, 0.5, 0.5, 0.5]
    return theirs


@pytest.mark.filterwarnings("ignore:.*keyframes have values of joints that follow")
def test_mujoco_couplings():
    """Joints follow by active equalities, chained and with references, and MuJoCo finds the constraints satisfied."""
    theirs = coupled()
    told = agreed(theirs)
    assert 0 < told["hits"] < COUNT
    robot = theirs.robot()
    assert robot.mimics == {"f": ("h", -1.0), "s": ("h", -0.3)}
    assert robot.states["k"][1].keys() == {"h", "free"}
    for q in robot.exported(robot.random_configurations(20)):
        theirs.data.qpos[:] = q
        theirs.mujoco.mj_forward(theirs.model, theirs.data)
        equal = theirs.data.efc_type == theirs.mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert equal.sum() == 2
        assert np.abs(theirs.data.efc_pos[equal]).max() < 1e-14
    theirs.data.eq_active[1] = 0
    assert theirs.robot().mimics == {"f": ("h", -1.0)}


def test_mujoco_without_couplings():
    """Then a configuration is a qpos, as of a file; what is not read is told."""
    theirs = coupled()
    with pytest.warns(UserWarning, match=r"^coupled: not read, although MuJoCo .*: 2 constraints \(equality\)$"):
        robot = Robot.from_mujoco(theirs.model, theirs.data, couplings=False)
    Q = robot.random_configurations(10)
    np.testing.assert_array_equal(robot.exported(Q), Q)
    assert robot.dof == theirs.model.nq
    with pytest.warns(UserWarning, match="keyframes have values of joints that follow .* not used: 'f' in 'k', 's' in"):
        theirs.robot()


def test_mujoco_leaves_rings_and_curves():
    """Joints that follow in a ring, twice, a constant or a curve keep their own values, which is told."""
    mujoco = pytest.importorskip("mujoco")
    bodies = "".join(f'<body name="{n}"><joint name="{n}" type="slide"/><geom size="1"/></body>' for n in "abcd")
    rules = (("a", "b", "0 1 0"), ("b", "a", "0 1 0"), ("a", "c", "0 1 0"), ("c", "b", "0 1 2"), ("d", "", "1 0 0"))
    equalities = "".join(
        f'<joint joint1="{one}" {f"joint2={chr(34)}{other}{chr(34)}" if other else ""} polycoef="{poly} 0 0"/>'
        for one, other, poly in rules
    )
    text = f"<mujoco><worldbody>{bodies}</worldbody><equality>{equalities}</equality></mujoco>"
    with pytest.warns(UserWarning, match="4 constraints"):
        robot = Robot.from_mujoco(mujoco.MjModel.from_xml_string(text))
    assert robot.mimics == {"a": ("b", 1.0)}


def test_mujoco_refuses():
    """Other objects, and data of another model."""
    theirs = coupled()
    with pytest.raises(InputError, match=r"model: expected a MjModel, found 'arm.xml'"):
        Robot.from_mujoco("arm.xml")
    with pytest.raises(InputError, match="data: expected a MjData"):
        Robot.from_mujoco(theirs.model, theirs.model)
    other = theirs.mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InputError, match="data: expected that of the model"):
        Robot.from_mujoco(other, theirs.data)


# -- positions --------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*keyframes have values of joints that follow")
def test_positions_keep_the_couplings():
    """Positions of the model that break a coupling are refused, unless the tolerance allows it; so are other shapes."""
    robot = coupled().robot()
    q = robot.exported(robot.random_configurations(3))
    np.testing.assert_allclose(robot.exported(robot.imported(q)), q, rtol=0, atol=1e-15)
    q[1, 2] += 1e-3
    with pytest.raises(InputError, match=r"^q: expected values within 1e-06 .*for 's', which is 0.001 off"):
        robot.imported(q)
    np.testing.assert_array_equal(robot.imported(q, tolerance=2e-3)[1], robot.imported(q[0:2], tolerance=2e-3)[1])
    with pytest.raises(InputError, match="q: expected shape"):
        robot.imported(q[:, 1:])
    q[1, 2] = np.nan
    with pytest.raises(InputError, match="q: expected finite numbers"):
        robot.imported(q)


@pytest.mark.filterwarnings("ignore:.*keyframes have values of joints that follow")
def test_positions_need_the_model_s_values():
    """Bodies on fixed joints and on joints that follow leave the values; others, and joins, do not."""
    robot = coupled().robot()
    q = robot.exported(robot.random_configurations(3))
    for changed in (
        robot.with_body("tool", Body.sphere(0.1), parent="c", joint="fixed"),
        robot.with_body("cam", Body.sphere(0.1), joint="continuous", mimic=("h", 2.0, 0.0)),
        robot.placed(np.eye(4)),
        robot.disabling([("a", "z")]),
    ):
        np.testing.assert_array_equal(changed.exported(changed.imported(q)), q)
    both = Robot.join({"a": robot, "b": robot})
    for changed in (both, robot.with_body("door", Body.sphere(0.1)), Robot.from_links({"a": None}, [])):
        with pytest.raises(InputError, match="expected a robot with the values of a model"):
            changed.exported(changed.random_configurations(1))
    np.testing.assert_array_equal(both.part("b").robot.exported(robot.imported(q)), q)


def test_a_robot_as_a_scene():
    """The scene of a configuration touches where the robot does; and another robot collides with it."""
    robot = coupled_without_warnings()
    checker = CollisionChecker(robot)
    Q = robot.random_configurations(50)
    Q[:, robot.configuration_names.index("free/z")] -= 2
    found = [robot.as_scene(q).collide() for q in Q]
    np.testing.assert_array_equal(found, checker.collide(Q))
    assert 0 < sum(found) < 50
    scene = robot.as_scene(Q[0])
    assert isinstance(scene, Scene)
    np.testing.assert_allclose(scene.pose("c"), robot.forward_kinematics(Q[0])[robot.link_names.index("c")])


def coupled_without_warnings():
    """The robot of the coupled model."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return coupled().robot()


# -- Drake ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_drake_joints(seed, tmp_path):
    """Bodies are where Drake has them, and the same pairs touch, for joints and shapes of every kind."""
    corners = "v 0 0 0\nv .3 0 0\nv 0 .3 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "corner.obj").write_text(corners)
    told = agreed(Drake(every_joint(seed, 12, tmp_path / "corner.obj")))
    assert told["pairs"] > 10


def gripper(analysis, plant, scene_graph):
    """Two fingers that are coupled, on a floor, with a filter."""
    inertia = analysis.SpatialInertia.SolidBoxWithMass(1, 0.1, 0.1, 0.1)
    friction, pose = analysis.CoulombFriction(1, 1), analysis.RigidTransform
    model = plant.AddModelInstance("hand")
    palm = plant.AddRigidBody("palm", model, inertia)
    plant.WeldFrames(plant.world_frame(), palm.body_frame(), pose([0, 0, 0.3]))
    plant.RegisterCollisionGeometry(palm, pose(), analysis.Box(0.1, 0.3, 0.05), "palm", friction)
    joints = []
    for name, sign in (("left", 1), ("right", -1)):
        finger = plant.AddRigidBody(name, model, inertia)
        frame = plant.AddFrame(analysis.FixedOffsetFrame(name + "_at", palm.body_frame(), pose([0, 0.05 * sign, -0.1])))
        slide = analysis.PrismaticJoint(name, frame, finger.body_frame(), [0, sign, 0], -0.05, 0.1)
        slide.set_velocity_limits([-0.5], [0.4])
        joints.append(plant.AddJoint(slide))
        plant.RegisterCollisionGeometry(finger, pose(), analysis.Box(0.05, 0.02, 0.1), name, friction)
    plant.AddCouplerConstraint(joints[1], joints[0], 0.5, 0.01)
    plant.RegisterCollisionGeometry(plant.world_body(), pose(), analysis.HalfSpace(), "floor", friction)


def test_drake_couplers():
    """Couplers are told where they are not given; given as mimics they hold, and a trajectory goes back to Drake."""
    theirs = Drake(gripper)
    with pytest.warns(UserWarning, match="1 constraints between bodies or joints are not read"):
        assert theirs.robot().dof == 2
    theirs.mimic = {"right": ("left", 0.5, 0.01)}
    agreed(theirs)
    robot = theirs.robot()
    assert robot.configuration_names == ("left",)
    assert robot.velocity.tolist() == [0.4]
    moved = planners.trajectory(robot, [[0.0], [0.1], [0.05]], acceleration=2.0)
    times, expected = moved.sample(100.0)
    polynomial = moved.to_drake(robot)
    found = np.array([polynomial.value(t)[:, 0] for t in times])
    np.testing.assert_allclose(found, robot.exported(expected), rtol=0, atol=1e-14)
    with pytest.raises(InputError, match="robot: expected the robot of the trajectory"):
        moved.to_drake(robot.add_base("planar"))


def test_drake_locked_joints_are_fixed():
    """With a context, a locked joint has no value, and keeps the one it has; others are refused for it."""
    theirs = Drake(gripper, {})
    joint = theirs.plant.GetJointByName("right")
    joint.set_translation(theirs.state, 0.03)
    joint.Lock(theirs.state)
    with pytest.warns(UserWarning, match="1 constraints"):
        robot = theirs.robot()
    assert robot.configuration_names == ("left",)
    np.testing.assert_array_equal(robot.exported([0.02]), [0.02, 0.03])
    with pytest.raises(InputError, match="locked joints"):
        robot.imported([0.02, 0.04])


def test_drake_refuses():
    """Plants that are not finalized, contexts of parts of the diagram, mimics of joints that do not exist."""
    theirs = Drake(gripper)
    with pytest.raises(InputError, match="context: expected the context of the whole diagram"):
        Robot.from_drake(theirs.plant, theirs.scene_graph, theirs.state)
    with pytest.raises(UnknownNameError, match="joint in mimic"):
        Robot.from_drake(theirs.plant, theirs.scene_graph, mimic={"up": ("left", 1, 0)})
    with pytest.raises(InputError, match="plant: expected a MultibodyPlant"):
        Robot.from_drake(theirs.scene_graph, theirs.scene_graph)
    analysis = pytest.importorskip("pydrake.all")
    plant, scene_graph = analysis.AddMultibodyPlantSceneGraph(analysis.DiagramBuilder(), 0.001)
    with pytest.raises(InputError, match="scene_graph: expected the one with which the plant is registered"):
        Robot.from_drake(theirs.plant, scene_graph)
    with pytest.raises(InputError, match="plant: expected one that is finalized"):
        Robot.from_drake(plant, scene_graph)
