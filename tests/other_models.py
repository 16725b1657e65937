"""What Drake, pinocchio and MuJoCo say of their own models, at their own configurations.

Each library is a class with the same questions: `robot` (ours, of the model), `poses` (of links, by name), `collides`,
`touching` (the pairs that do; bodies of the world have the names of their shapes), and `distance` (None where the
library has none).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loewner import Body, CollisionChecker, Robot, distance
from robot_oracle import robots_folder

# Nearer to touching than this [m], the searches of other libraries may find either verdict; their tolerances are 1e-6.
TOUCHING = 5e-6


class Drake:
    """A plant; `build` adds what it has to a plant and a scene graph."""

    def __init__(self, build, mimic=None):
        analysis = pytest.importorskip("pydrake.all")
        builder = analysis.DiagramBuilder()
        self.plant, self.scene_graph = analysis.AddMultibodyPlantSceneGraph(builder, 0.001)
        build(analysis, self.plant, self.scene_graph)
        if not self.plant.is_finalized():
            self.plant.Finalize()
        diagram = builder.Build()
        self.context = diagram.CreateDefaultContext()
        self.state = self.plant.GetMyMutableContextFromRoot(self.context)
        self.mimic = mimic or {}
        inspector = self.scene_graph.model_inspector()
        shapes = {
            g: type(inspector.GetShape(g)).__name__ for g in inspector.GetAllGeometryIds(analysis.Role.kProximity)
        }
        self.half_spaces = "HalfSpace" in shapes.values()
        self.world = self.plant.world_body().name()

    def robot(self):
        return Robot.from_drake(self.plant, self.scene_graph, self.context, mimic=self.mimic)

    def place(self, q):
        self.plant.SetPositions(self.state, q)
        return self.scene_graph.get_query_output_port().Eval(self.scene_graph.GetMyContextFromRoot(self.context))

    def poses(self, q):
        self.place(q)
        joints = [self.plant.get_joint(index) for index in self.plant.GetJointIndices()]
        bodies = [joint.child_body() for joint in joints]
        return {body.name(): self.plant.EvalBodyPoseInWorld(self.state, body).GetAsMatrix4() for body in bodies}

    def collides(self, q):
        return self.place(q).HasCollisions()

    def touching(self, q):
        query = self.place(q)
        inspector = query.inspector()

        def name(geometry):
            body = self.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).name()
            return inspector.GetName(geometry) if body == self.world else body

        found = query.ComputePointPairPenetration()
        return {frozenset((name(pair.id_A), name(pair.id_B))) for pair in found if pair.depth >= 0}

    def distance(self, q):
        if self.half_spaces:  # Drake has no distance of most shapes to them
            return None
        pairs = self.place(q).ComputeSignedDistancePairwiseClosestPoints()
        return min((pair.distance for pair in pairs), default=np.inf)


class Pinocchio:
    """A model and its geometry; with `hollow`, closed meshes are surfaces without their inside, as in Coal."""

    def __init__(self, model, geometry, meshes="surface", *, hollow=False):
        self.pin = pytest.importorskip("pinocchio")
        self.model, self.geometry, self.meshes, self.hollow = model, geometry, meshes, hollow
        self.data, self.geometry_data = model.createData(), geometry.createData()
        self.world = "universe"

    def robot(self):
        robot = Robot.from_pinocchio(self.model, self.geometry, meshes=self.meshes)
        if not self.hollow:
            return robot
        return replace(robot, bodies={name: _hollow(body) for name, body in robot.bodies.items()})

    def poses(self, q):
        self.pin.framesForwardKinematics(self.model, self.data, q)
        frames = [(k, frame) for k, frame in enumerate(self.model.frames) if frame.type.name == "BODY"]
        return {frame.name: self.data.oMf[k].homogeneous for k, frame in frames}

    def collides(self, q):
        return self.pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True)

    def touching(self, q):
        self.pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, False)
        names = []
        for shape in self.geometry.geometryObjects:
            frame = self.model.frames[shape.parentFrame]
            names.append(frame.name if frame.parentJoint or frame.name != self.world else shape.name)
        return {
            frozenset((names[pair.first], names[pair.second]))
            for pair, result in zip(self.geometry.collisionPairs, self.geometry_data.collisionResults, strict=True)
            if result.isCollision()
        }

    def distance(self, q):
        nearest = self.pin.computeDistances(self.model, self.data, self.geometry, self.geometry_data, q)
        return self.geometry_data.distanceResults[nearest].min_distance if len(self.geometry.collisionPairs) else np.inf


def _hollow(body):
    """Return a body whose solids are their surfaces."""
    pieces = body.pieces
    if not any(piece.kind == "solid" for piece in pieces):
        return body
    assert all(piece.kind in ("solid", "surface") for piece in pieces)
    return Body.union([Body.from_surface((piece.vertices, piece.triangles), solid=False) for piece in pieces])


class MuJoCo:
    """A compiled model."""

    def __init__(self, model):
        self.mujoco = pytest.importorskip("mujoco")
        self.model = model
        model.geom_margin[:] = 0
        model.pair_margin[:] = 0
        switches = self.mujoco.mjtDisableBit
        model.opt.disableflags &= ~(switches.mjDSBL_CONTACT | switches.mjDSBL_CONSTRAINT)
        self.data = self.mujoco.MjData(model)
        self.world = "world"

    def robot(self):
        return Robot.from_mujoco(self.model, self.data)

    def place(self, q):
        self.data.qpos[:] = q
        self.mujoco.mj_kinematics(self.model, self.data)
        self.mujoco.mj_comPos(self.model, self.data)
        self.mujoco.mj_collision(self.model, self.data)

    def poses(self, q):
        self.place(q)
        poses = {}
        for body in range(self.model.nbody):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
            poses[self.model.body(body).name or f"body{body}"] = T
        return poses

    def collides(self, q):
        self.place(q)
        return bool((self.data.contact.dist[: self.data.ncon] <= 0).any())

    def touching(self, q):
        self.place(q)

        bodies = [self.model.body(k).name or f"body{k}" for k in range(self.model.nbody)]

        def name(geom):
            own = self.model.geom(geom).name or f"geom{geom}"
            return bodies[k] if (k := int(self.model.geom_bodyid[geom])) else own + "_geom" * (own in bodies)

        contacts = (self.data.contact[k] for k in range(self.data.ncon))
        return {frozenset((name(c.geom1), name(c.geom2))) for c in contacts if c.dist <= 0}

    def distance(self, q):
        """The least distance of the pairs of which MuJoCo makes contacts with a wide margin, up to it."""
        self.model.geom_margin[:] = self.model.body_margin[:] = self.model.pair_margin[:] = 0.5
        self.place(q)
        self.model.geom_margin[:] = self.model.body_margin[:] = self.model.pair_margin[:] = 0
        pairs = {(c.geom1, c.geom2) for c in (self.data.contact[k] for k in range(self.data.ncon))}
        apart = (self.mujoco.mj_geomDistance(self.model, self.data, a, b, 1.0, None) for a, b in pairs)
        return min(apart, default=np.inf)


def compare(theirs, count, *, details, seed=1):
    """Compare verdicts at random configurations within the limits.

    At the first `details`, also compare the pairs that touch, and distances; poses at the first 100.

    Returns
    -------
    dict
        `hits`: colliding configurations; `pairs`: pairs that both find touching. `near` counts verdicts and pairs that
        differ nearer to touching than `TOUCHING`, `wrong` lists all others: configuration, pair, our distance. `off` is
        the largest difference of poses; `over` and `under` are how much larger and smaller than ours their distances
        are, of the `measured` configurations that both find apart. `split` counts configurations where the library's
        own verdict, pairs or distance disagree with each other.
    """
    robot = theirs.robot()
    checker, rows = CollisionChecker(robot), {name: k for k, name in enumerate(robot.link_names)}
    Q = robot.random_configurations(count, seed)
    q, Ts = robot.exported(Q), robot.forward_kinematics(Q)
    assert np.abs(robot.imported(q) - Q).max(initial=0.0) < 1e-12
    told = {
        "hits": 0,
        "pairs": 0,
        "near": 0,
        "wrong": [],
        "off": 0.0,
        "over": 0.0,
        "under": 0.0,
        "measured": 0,
        "split": 0,
    }
    for k, T in enumerate(Ts[:100]):
        for name, pose in theirs.poses(q[k]).items():
            told["off"] = max(told["off"], np.abs(T[rows[name]] - pose).max())
    named = {name: _of_body(robot, theirs, name, set(theirs.poses(q[0]))) for name in robot.bodies}
    for k, hit in enumerate(checker.collide(Q).tolist()):
        told["hits"] += int(hit)
        found = theirs.collides(q[k])
        if found == hit and k >= details:
            continue
        pairs, contacts = theirs.touching(q[k]), checker.pairs(Q[k])
        assert hit == bool(contacts)
        told["split"] += found != bool(pairs)  # the library disagrees with itself
        ours = {frozenset((named[c.name_a], named[c.name_b])) for c in contacts}
        told["pairs"] += len(ours & pairs)
        for pair in ours ^ pairs:
            apart = _distance(robot, checker, Ts[k], named, pair)
            if abs(apart) < TOUCHING:
                told["near"] += 1
            else:
                told["wrong"].append((k, *sorted(pair), apart))
        theirs_apart = None if hit or pairs else theirs.distance(q[k])
        told["split"] += theirs_apart is not None and theirs_apart <= 0
        if theirs_apart is not None and 0 < theirs_apart < np.inf:
            more = theirs_apart - float(checker.distance(Q[k], exact=True).distance)
            told["measured"] += 1
            told["over"], told["under"] = max(told["over"], more), max(told["under"], -more)
    return told


def _of_body(robot, theirs, link, bodies):
    """Return the body of the library to which a link of ours belongs; shapes of the world are alone."""
    parents = {name: robot._above.get(name, ("", None))[1] for name in robot.link_names}
    name = link
    while name not in bodies and parents[name] != theirs.world:
        name = parents[name]
    return name


def _distance(robot, checker, T, named, pair):
    """Return the exact distance of two bodies of the library, as ours."""
    rows = {name: k for k, name in enumerate(robot.link_names)}
    return min(
        (
            distance(robot.bodies[a], T[rows[a]], robot.bodies[b], T[rows[b]], exact=True).distance
            for a, b in checker.checked_pairs
            if frozenset((named[a], named[b])) == pair
        ),
        default=np.inf,
    )


# -- models ---------------------------------------------------------------------------------------


def parsed(*files, floor=False):
    """Let Drake's parser read files of example-robot-data, or of Drake."""

    def build(analysis, plant, scene_graph):
        parser = analysis.Parser(plant)
        parser.package_map().Add("example-robot-data", str(robots_folder().parent))
        places = robots_folder(), Path(sys.modules["pydrake"].__file__).parent / "share/drake"
        for file in files:
            parser.AddModels(str(next(place / file for place in places if (place / file).exists())))
        if floor:
            friction = analysis.CoulombFriction(1.0, 1.0)
            pose = analysis.RigidTransform([0.0, 0.0, -0.5])
            plant.RegisterCollisionGeometry(plant.world_body(), pose, analysis.HalfSpace(), "floor", friction)

    return build


def every_joint(seed, count=10, obj=None):
    """Build a random plant: joints of all kinds, offsets on both frames, and shapes of all kinds but half-spaces."""

    def build(analysis, plant, scene_graph):
        rng = np.random.default_rng(seed)
        inertia = analysis.SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1)
        friction = analysis.CoulombFriction(1.0, 1.0)

        def pose(reach=0.4):
            return analysis.RigidTransform(analysis.RollPitchYaw(*rng.uniform(-2, 2, 3)), rng.uniform(-reach, reach, 3))

        def frame(body, name):
            return plant.AddFrame(analysis.FixedOffsetFrame(name, body.body_frame(), pose()))

        kinds = {
            "revolute": lambda *a: analysis.RevoluteJoint(*a, rng.normal(size=3), -1.0, 2.0),
            "prismatic": lambda *a: analysis.PrismaticJoint(*a, rng.normal(size=3), -0.1, 0.2),
            "ball": lambda *a: analysis.BallRpyJoint(*a),
            "universal": lambda *a: analysis.UniversalJoint(*a),
            "planar": lambda *a: analysis.PlanarJoint(*a, [0.0, 0.0, 0.0]),
            "screw": lambda *a: analysis.ScrewJoint(*a, rng.normal(size=3), 0.37, 0.0),
            "rpy": lambda *a: analysis.RpyFloatingJoint(*a),
            "floating": lambda *a: analysis.QuaternionFloatingJoint(*a),
            "weld": lambda *a: analysis.WeldJoint(*a, pose()),
        }
        shapes = [
            lambda: analysis.Box(*rng.uniform(0.05, 0.3, 3)),
            lambda: analysis.Sphere(rng.uniform(0.05, 0.15)),
            lambda: analysis.Capsule(rng.uniform(0.03, 0.1), rng.uniform(0.1, 0.3)),
            lambda: analysis.Cylinder(rng.uniform(0.03, 0.1), rng.uniform(0.1, 0.3)),
            lambda: analysis.Ellipsoid(*rng.uniform(0.05, 0.15, 3)),
            *([lambda: analysis.Mesh(str(obj), 0.5), lambda: analysis.Convex(str(obj), 0.7)] if obj else []),
        ]
        above = plant.world_body()
        for k, kind in enumerate(rng.permutation(list(kinds) * 2)[:count]):
            body = plant.AddRigidBody(f"b{k}", inertia)
            plant.AddJoint(kinds[kind](f"j{k}", frame(above, f"f{k}"), frame(body, f"g{k}")))
            for n in range(2):
                shape = shapes[rng.integers(len(shapes))]()
                plant.RegisterCollisionGeometry(body, pose(0.1), shape, f"s{n}", friction)
            above = body if rng.random() < 0.7 else above
        world = plant.world_body()
        plant.RegisterCollisionGeometry(world, pose(), analysis.Box(0.5, 0.5, 0.5), "block", friction)

    return build


def example(urdf, srdf=None):
    """Return pinocchio's model of a robot of example-robot-data, and its geometry with pairs that an SRDF leaves."""
    pin = pytest.importorskip("pinocchio")
    home = robots_folder()
    model = pin.buildModelFromUrdf(str(home / urdf))
    packages = [str(home.parent.parent), str(home.parent)]
    geometry = pin.buildGeomFromUrdf(model, str(home / urdf), pin.GeometryType.COLLISION, package_dirs=packages)
    geometry.addAllCollisionPairs()
    if srdf is not None:
        pin.removeCollisionPairs(model, geometry, str(home / srdf))
    return model, geometry


def made_of_every_joint(seed):
    """Return a random pinocchio model with joints of every kind but ellipsoids, and two shapes on each."""
    pin, coal = pytest.importorskip("pinocchio"), pytest.importorskip("coal")
    rng = np.random.default_rng(seed)
    pin.seed(seed)

    def axis():
        made = rng.normal(size=3)
        return made / np.linalg.norm(made)

    def composite():
        made = pin.JointModelComposite()
        made.addJoint(pin.JointModelRY(), pin.SE3.Random())
        made.addJoint(pin.JointModelSpherical(), pin.SE3.Random())
        made.addJoint(pin.JointModelHZ(0.2), pin.SE3.Random())
        return made

    kinds = [
        pin.JointModelRX, pin.JointModelPY, pin.JointModelRUBZ, pin.JointModelFreeFlyer, pin.JointModelSpherical,
        pin.JointModelSphericalZYX, pin.JointModelPlanar, pin.JointModelTranslation, composite,
        lambda: pin.JointModelRevoluteUnaligned(axis()), lambda: pin.JointModelPrismaticUnaligned(axis()),
        lambda: pin.JointModelHX(0.4), lambda: pin.JointModelHelicalUnaligned(axis(), 0.3),
        lambda: pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[1]),
    ]  # fmt: skip
    model, geometry, above, followed = pin.Model(), pin.GeometryModel(), 0, []
    for k, kind in enumerate(rng.permutation(len(kinds))):
        joint = model.addJoint(above, kinds[kind](), pin.SE3.Random(), f"j{k}")
        followed += [joint] if kind in (0, 1) else []
        frame = model.addBodyFrame(f"b{k}", joint, pin.SE3.Random() if k % 3 == 0 else pin.SE3.Identity(), 0)
        box = coal.Box(*rng.uniform(0.1, 0.3, 3))
        geometry.addGeometryObject(pin.GeometryObject(f"g{k}", joint, frame, pin.SE3.Random(), box))
        capsule = coal.Capsule(*rng.uniform(0.05, 0.2, 2))
        geometry.addGeometryObject(pin.GeometryObject(f"h{k}", joint, frame, pin.SE3.Random(), capsule))
        above = joint if rng.random() < 0.8 else above
    for k, joint in enumerate(followed):
        rule = pin.JointModelMimic(model.joints[joint], -1.7, 0.2)
        model.addBodyFrame(f"m{k}", model.addJoint(above, rule, pin.SE3.Random(), f"mimic{k}"), pin.SE3.Identity(), 0)
    for ends, bound in ((model.lowerPositionLimit, -1.0), (model.upperPositionLimit, 1.0)):
        ends[~np.isfinite(ends)] = bound
    geometry.addGeometryObject(pin.GeometryObject("block", 0, 0, pin.SE3.Random(), coal.Sphere(0.4)))
    geometry.addAllCollisionPairs()
    return model, geometry
