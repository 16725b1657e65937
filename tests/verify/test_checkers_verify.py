"""Whole robots against pinocchio and coal: on the same convex hulls, no configuration is judged otherwise."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loewner import Body, CollisionChecker, InputError, Robot, Scene, Verdict, read_motion_bench_maker
from loewner.robots.description.urdf import read_urdf
from robot_oracle import PAIRS, pinocchio_configuration, robots_folder

pytestmark = pytest.mark.verify

CONFIGURATIONS = 1000

# Metres within which two libraries may call a contact either way.
TOUCHING = 1e-7


class Rival:
    """A robot with the convex hulls of its meshes in pinocchio, and obstacles in coal."""

    def __init__(self, robot: Robot, path: Path, srdf: Path) -> None:
        self.pin, self.coal = pytest.importorskip("pinocchio"), pytest.importorskip("coal")
        self.robot, self.joints = robot, read_urdf(path).joints
        self.values = {name: k for k, name in enumerate(robot.configuration_names)}
        self.model = self.pin.buildModelFromUrdf(str(path))
        folders = [str(robots_folder().parent.parent), str(robots_folder().parent), str(robots_folder())]
        self.shapes = self.pin.buildGeomFromUrdf(
            self.model, str(path), self.pin.GeometryType.COLLISION, package_dirs=folders
        )
        self.too_round = set()  # links with hulls that coal refuses: more neighbours of a vertex than it can count
        for shape in self.shapes.geometryObjects:
            if isinstance(shape.geometry, self.coal.BVHModelBase):
                try:
                    shape.geometry.buildConvexHull(True, "Qt")
                except RuntimeError:
                    self.too_round.add(self.model.frames[shape.parentFrame].name)
                else:
                    shape.geometry = shape.geometry.convex
        self.links = [self.model.frames[shape.parentFrame].name for shape in self.shapes.geometryObjects]
        self.shapes.addAllCollisionPairs()
        self.pin.removeCollisionPairs(self.model, self.shapes, str(srdf))
        self.pairs = self._named()
        # Copies: a pair taken out of the list moves those behind it.
        ends = [(pair.first, pair.second) for pair in self.shapes.collisionPairs]
        self.shapes.removeAllCollisionPairs()
        for first, second in ends:
            if not self.too_round & {self.links[first], self.links[second]}:
                self.shapes.addCollisionPair(self.pin.CollisionPair(first, second))
        self.data, self.placed = self.model.createData(), self.shapes.createData()

    def _named(self) -> list[tuple[str, str]]:
        """Names of the two links of each pair of shapes."""
        pairs = self.shapes.collisionPairs
        return [tuple(sorted((self.links[p.first], self.links[p.second]))) for p in pairs]

    def own_distances(self, Q: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
        """Signed distances of all pairs of links that are checked and that coal has hulls for."""
        names = self._named()
        out = {pair: np.full(len(Q), np.inf) for pair in names}
        for k, q in enumerate(Q):
            self.pin.computeDistances(self.model, self.data, self.shapes, self.placed, self._entries(q))
            for pair, result in zip(names, self.placed.distanceResults, strict=True):
                out[pair][k] = min(out[pair][k], result.min_distance)
        return out

    def scene_distance(self, q: np.ndarray, obstacles: list, skip: set[tuple[str, str]]) -> float:
        """Least signed distance of the links and (name, shape, pose)."""
        self.pin.updateGeometryPlacements(self.model, self.data, self.shapes, self.placed, self._entries(q))
        nearest = np.inf
        request, result = self.coal.DistanceRequest(), self.coal.DistanceResult()
        for link, shape, M in zip(self.links, self.shapes.geometryObjects, self.placed.oMg, strict=True):
            T = self.coal.Transform3s(M.rotation, M.translation)
            for name, other, T_other in obstacles:
                if (link, name) not in skip:
                    result.clear()
                    found = self.coal.distance(shape.geometry, T, other, T_other, request, result)
                    nearest = min(nearest, found)
        return nearest

    def _entries(self, q: np.ndarray) -> np.ndarray:
        return pinocchio_configuration(self.pin, self.model, self.joints, self.values, q)

    def pose(self, T: np.ndarray):
        return self.coal.Transform3s(T[:3, :3], T[:3, 3])

    def hull(self, points: np.ndarray):
        vectors = self.coal.StdVec_Vec3s()
        vectors.extend(list(points))
        return self.coal.Convex.convexHull(vectors, True, None)

    def shape(self, body: Body):
        """A body of one piece; a box is a hull of eight points."""
        (piece,) = body.pieces
        if piece.kind == "polytope":
            return self.hull(piece.vertices)
        frame = body._packed.frames[0]
        radius, half = frame[4], frame[12]
        return {"sphere": lambda: self.coal.Sphere(frame[0]), "cylinder": lambda: self.coal.Cylinder(radius, 2 * half)}[
            piece.kind
        ]()


def load(urdf: str, srdf: str) -> tuple[Robot, Rival]:
    path = robots_folder() / urdf
    semantics = robots_folder() / urdf.split("/")[0] / "srdf" / f"{srdf}.srdf"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # names that the files get wrong
        robot = Robot.from_urdf(path, srdf=semantics, meshes="hull")  # as the rival takes them
        return robot, Rival(robot, path, semantics)


def same(checker: CollisionChecker, Q: np.ndarray, nearest: np.ndarray) -> int:
    """Compare with signed distances; returns how many configurations were too close to tell."""
    found, certified = checker.collide(Q), checker.classify(Q)
    clear = np.abs(nearest) > TOUCHING
    np.testing.assert_array_equal(found[clear], nearest[clear] <= 0)
    assert not ((certified == Verdict.FREE) & found).any()
    assert not ((certified == Verdict.COLLIDING) & ~found).any()
    return int((~clear).sum())


@pytest.mark.parametrize(("urdf", "srdf"), PAIRS)
def test_self_collisions_of_every_robot(urdf, srdf):
    """The same pairs are checked, and 1,000 random configurations judged alike; also without those that mostly hit."""
    robot, rival = load(urdf, srdf)
    if not robot.bodies:
        with pytest.raises(InputError, match="expected a robot with collision geometry"):
            CollisionChecker(robot, skip_adjacent=False)
        return
    everything = CollisionChecker(robot, skip_adjacent=False)
    assert {tuple(sorted(pair)) for pair in everything.checked_pairs} == {p for p in rival.pairs if p[0] != p[1]}
    refused = [pair for pair in everything.checked_pairs if rival.too_round & set(pair)]
    Q = robot.random_configurations(CONFIGURATIONS, seed=5)
    distances = {pair: d for pair, d in rival.own_distances(Q).items() if pair[0] != pair[1]}
    if not distances:
        assert not everything.collide(Q).any()
        return
    doubtful = same(
        CollisionChecker(robot, allowed=refused, skip_adjacent=False), Q, np.min(list(distances.values()), axis=0)
    )
    often = [pair for pair, d in distances.items() if (d <= 0).mean() > 0.05]
    rest = np.min([np.full(len(Q), np.inf), *(d for pair, d in distances.items() if pair not in often)], axis=0)
    doubtful += same(CollisionChecker(robot, allowed=refused + often, skip_adjacent=False), Q, rest)
    print(
        f"{robot}: {len(everything.checked_pairs)} pairs, coal refuses {sorted(rival.too_round)}, colliding "
        f"{everything.collide(Q).mean():.1%}, but for {len(often)} pairs {(rest <= 0).mean():.1%}, doubtful {doubtful}"
    )
    # The hips of iCub graze each other: to gaps below 1e-6 m coal answers 0.
    assert doubtful < 0.05 * CONFIGURATIONS


def test_panda_among_boxes_and_hulls():
    """10,000 random configurations, none judged otherwise."""
    robot, rival = load("panda_description/urdf/panda.urdf", "panda")
    assert not rival.too_round
    rng, scene, obstacles = np.random.default_rng(0), Scene(), []
    for k in range(10):
        hull = rng.normal(size=(20, 3))
        hull *= 0.12 * rng.uniform(0, 1, (20, 1)) ** (1 / 3) / np.linalg.norm(hull, axis=1, keepdims=True)
        body = Body.box(rng.uniform(0.05, 0.25, 3)) if k < 5 else Body.from_points(hull)
        T, radius, angle = np.eye(4), rng.uniform(0.45, 0.85), rng.uniform(-np.pi, np.pi)
        T[:3, :3] = Rotation.random(random_state=k).as_matrix()
        T[:3, 3] = radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 0.9)
        scene.add(f"o{k}", body, T)
        obstacles.append((f"o{k}", rival.shape(body), rival.pose(T)))
    Q = robot.random_configurations(10_000, seed=1)
    own = np.min(list(rival.own_distances(Q).values()), axis=0)
    nearest = np.minimum(own, [rival.scene_distance(q, obstacles, set()) for q in Q])
    doubtful = same(CollisionChecker(robot, scene), Q, nearest)
    print(f"colliding {np.mean(nearest <= 0):.1%}, doubtful {doubtful}")
    assert 0.05 < np.mean(nearest <= 0) < 0.95
    assert doubtful < 5


@pytest.mark.skipif("LOEWNER_MBM" not in os.environ, reason="LOEWNER_MBM names no file of MotionBenchMaker problems")
def test_starts_and_goals_of_motion_bench_maker():
    """Of all 700 problems."""
    robot, rival = load("panda_description/urdf/panda.urdf", "panda")
    problems = read_motion_bench_maker(Path(os.environ["LOEWNER_MBM"]))
    assert len(problems) == 700
    hits = total = doubtful = 0
    for problem in problems:
        obstacles = [
            (name, rival.shape(problem.scene[name]), rival.pose(problem.scene.pose(name))) for name in problem.scene
        ]
        ends = [dict(zip(problem.joint_names, q, strict=True)) for q in (problem.start, *problem.goals)]
        # Closed fingers stick in what is to be grasped, open ones are about it.
        Q = np.array([robot.configuration(q | {"panda_finger_joint1": x}) for q in ends for x in (0.0, 0.04)])
        assert not any(set(pair) & set(problem.scene.names) for pair in problem.scene.allowed)
        own = np.min(list(rival.own_distances(Q).values()), axis=0)
        nearest = np.minimum(own, [rival.scene_distance(q, obstacles, set()) for q in Q])
        doubtful += same(CollisionChecker(robot, problem.scene), Q, nearest)
        hits, total = hits + int((nearest <= 0).sum()), total + len(Q)
    print(f"{total} configurations, {hits} colliding, {doubtful} doubtful")
    assert 0 < hits < total / 2
    assert doubtful < 0.01 * total
