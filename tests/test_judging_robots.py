"""Answers of other programs about robots: Coal's booleans, OMPL's paths and a pseudo-inverse's joint values, judged."""

import json
import re
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest

from gantry import gantry, wall
from loewner import Body, CollisionChecker, Joint, Robot, Scene, Verdict, cli, save_scene

SHARE = "cmeel.prefix/share/example-robot-data"


@pytest.fixture(scope="module")
def panda():
    """The Panda as pinocchio has it, with Coal's hulls of its meshes: model, shapes, and our robot of both."""
    pin, coal = pytest.importorskip("pinocchio"), pytest.importorskip("coal")
    data = Path(str(distribution("example-robot-data").locate_file(SHARE)))
    home = data / "robots" / "panda_description"
    urdf, folders = str(home / "urdf" / "panda.urdf"), [str(data.parent), str(data)]
    model = pin.buildModelFromUrdf(urdf)
    shapes = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION, package_dirs=folders)
    for one in shapes.geometryObjects:
        if isinstance(one.geometry, coal.BVHModelBase):
            one.geometry.buildConvexHull(True, "Qt")
            one.geometry = one.geometry.convex
    shapes.addAllCollisionPairs()
    pin.removeCollisionPairs(model, shapes, str(home / "srdf" / "panda.srdf"))
    return model, shapes, Robot.from_pinocchio(model, shapes)


@pytest.mark.verify
def test_booleans_of_coal_over_configurations(panda):
    """Coal's answers are confirmed; without a pair of links, the collisions that it misses are found, with depths."""
    pin = pytest.importorskip("pinocchio")
    model, shapes, robot = panda
    checker, Q = CollisionChecker(robot), robot.random_configurations(400, seed=1)

    def said(shapes) -> np.ndarray:
        data, results = model.createData(), shapes.createData()
        theirs = robot.exported(Q)
        return np.array([pin.computeCollisions(model, data, shapes, results, q, True) for q in theirs])

    assert not (checker.collide(Q) ^ said(shapes)).any()
    fewer = shapes.copy()
    hits = checker.collide_by_pair(Q)
    k = int((hits & (hits.sum(axis=1) == 1)[:, None]).sum(axis=0).argmax())  # often the only pair that collides
    names = checker.checked_pairs[k]
    for pair in list(fewer.collisionPairs):
        ends = (fewer.geometryObjects[i] for i in (pair.first, pair.second))
        if {model.frames[end.parentFrame].name for end in ends} == set(names):
            fewer.removeCollisionPair(pin.CollisionPair(pair.first, pair.second))
    missed = checker.collide(Q) & ~said(fewer)
    assert missed.any()
    assert not (said(fewer) & ~checker.collide(Q)).any()
    depths = checker.distance(Q[missed], exact=True)
    assert (depths.distance <= 0.0).all()
    assert {tuple(sorted(pair)) for pair in depths.names} == {names}


def test_paths_of_ompl():
    """Motions that OMPL took for free by coarse samples are proven to cross a thin wall; the others are proven free."""
    base, geometric = pytest.importorskip("ompl.base"), pytest.importorskip("ompl.geometric")
    joints = [
        Joint("x", "prismatic", "world", "rail", axis=[1, 0, 0], lower=-1, upper=1),
        Joint("y", "prismatic", "rail", "ball", axis=[0, 1, 0], lower=-1, upper=1),
    ]
    robot, scene = Robot.from_links({"world": None, "rail": None, "ball": Body.sphere(0.1)}, joints), Scene()
    scene.add("wall", Body.box([1.4, 0.02, 1.0]))
    checker = CollisionChecker(robot, scene)
    space, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    bounds.setLow(-1)
    bounds.setHigh(1)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda q: not checker.collide([q[0], q[1]]))
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(0.6)
    ends = [space.allocState(), space.allocState()]
    for state, y in zip(ends, (0.7, -0.7), strict=True):
        state[0], state[1] = 0.0, y
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(3.0)
    setup.setPlanner(planner)
    assert setup.solve(5.0)
    path = np.array([[q[0], q[1]] for q in setup.getSolutionPath().getStates()])
    assert information.checkMotion(*ends)
    path = np.concatenate([path, [path[0]]])  # and back on the straight motion that OMPL takes to be free
    found = checker.certify_edges(path[:-1], path[1:])
    for k, (q, r) in enumerate(zip(path[:-1], path[1:], strict=True)):
        samples = q + np.linspace(0.0, 1.0, 2001)[:, None] * (r - q)
        assert checker.collide(samples).any() == (found.verdict[k] == Verdict.COLLIDING)
        if found.verdict[k] == Verdict.COLLIDING:
            assert found.names[k].tolist() == ["ball", "wall"]
            assert checker.collide(q + found.fraction[k] * (r - q))
    assert found.verdict[-1] == Verdict.COLLIDING


@pytest.mark.verify
def test_joint_values_of_a_pseudo_inverse(panda):
    """Poses that an iteration reached, and those that it did not, are told apart by forward kinematics."""
    pin = pytest.importorskip("pinocchio")
    model, _, robot = panda
    data, link = model.createData(), "panda_hand"
    frame, at = model.getFrameId(link), robot.link_names.index(link)
    Q = robot.random_configurations(20, seed=2)
    wanted = robot.forward_kinematics(Q)[:, at]

    def solved(T: np.ndarray, q: np.ndarray, steps: int) -> np.ndarray:
        for _ in range(steps):
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(pin.SE3(T))).vector
            J = pin.computeFrameJacobian(model, data, q, frame)
            q = pin.integrate(model, q, J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error))
        return q

    starts = robot.exported(Q + 0.05 * np.random.default_rng(3).normal(size=Q.shape))
    for steps, right in ((1, False), (8, True)):
        found = robot.imported(np.array([solved(T, q, steps) for T, q in zip(wanted, starts, strict=True)]))
        reached = robot.forward_kinematics(found)[:, at]
        off = np.linalg.norm(reached[:, :3, 3] - wanted[:, :3, 3], axis=1)
        turned = np.linalg.norm(reached[:, :3, :3] - wanted[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
        good = (off < 1e-6) & (turned < 1e-6)
        assert good.all() if right else not good.any()
        assert (CollisionChecker(robot).collide(found) == CollisionChecker(robot).collide(Q)).mean() > 0.5


# -- loewner judge --configurations -------------------------------------------------------------


@pytest.fixture
def judge(tmp_path, monkeypatch, capsys):
    """A call of the command about the gantry and its wall, with a table; exit status, output and error."""
    monkeypatch.chdir(tmp_path)
    gantry(tmp_path)
    save_scene(wall(), "wall.yaml")

    def call(text: str, *words: str) -> tuple[int, str, str]:
        Path("said.csv").write_text(text)
        usual = ["--srdf", "gantry.srdf", "--scene", "wall.yaml"]
        status = cli.main(["judge", "--configurations", "said.csv", *usual, "gantry.urdf", *words])
        return status, *capsys.readouterr()

    return call


def test_a_table_of_configurations_is_judged(judge, tmp_path):
    """Missed collisions and false alarms are named with the pair and the length, largest first; right ones are not."""
    robot = Robot.from_urdf("gantry.urdf", srdf="gantry.srdf")
    checker, Q = CollisionChecker(robot, wall()), robot.random_configurations(30, seed=1)
    truth, exact = checker.collide(Q), checker.distance(Q, exact=True).distance
    order = [2, 0, 1]
    said = truth.copy()
    missed, alarm = int(np.flatnonzero(truth)[0]), int(np.flatnonzero(~truth)[0])
    head = ",".join(["colliding", *(robot.configuration_names[k] for k in order)])

    def text() -> str:
        return "\n".join(
            [head, *(f"{y},{','.join(map(repr, q[order].tolist()))}" for q, y in zip(Q, said, strict=True))]
        )

    status, out, _ = judge(text())
    assert (status, out.splitlines()[0]) == (0, "0 of 30 verdicts proven wrong")
    said[[missed, alarm]] ^= True
    status, out, _ = judge(text())
    assert status == 1
    assert "2 of 30 verdicts proven wrong\ncollisions missed  1\nfalse alarms       1\n" in out
    assert re.search(rf"row {missed + 1}: WRONG_FREE; \w+ and wall deep by {-exact[missed]:.6g} m", out)
    assert re.search(rf"row {alarm + 1}: WRONG_COLLIDING; \w+ and wall apart by {exact[alarm]:.6g} m", out)
    status, out, _ = judge(text(), "--json")
    found = json.loads(out)
    assert found["configurations"] == 30
    assert [row["row"] - 1 for row in found["wrong"]] == sorted([missed, alarm], key=lambda k: -abs(exact[k]))
    assert judge(text(), "--tolerance", "100")[0] == 0
    said[[missed, alarm]] ^= True
    with_margin = wall()
    with_margin.set_margin(10.0, "wall")
    save_scene(with_margin, "wall.yaml")  # verdicts are about contact: its margin does not count
    assert judge(text())[0] == 0
    said[:] = True
    found = json.loads(judge(text(), "--json")[1])
    assert sorted(row["row"] - 1 for row in found["wrong"]) == np.flatnonzero(~truth).tolist()
    assert {row["finding"] for row in found["wrong"]} == {"WRONG_COLLIDING"}


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        ("x,y,turn\n0,0,0\n", (), "said.csv: expected one column colliding in the header, found x, y, turn"),
        ("colliding,x,y,turn\n", (), "said.csv: expected configurations, found none"),
        (
            "colliding,x,y,turn\nmaybe,0,0,0\n",
            (),
            "said.csv, row 1: expected true or false as colliding, found 'maybe'",
        ),
        ("colliding,x,y,turn\n1,0,0\n", (), "said.csv, row 1: expected true or false as colliding, found 'too few"),
        ("colliding,x,y\n1,0,0\n", (), "said.csv: expected a column for each joint value, found none for turn"),
        ("colliding,x,y,turn\n1,0,0,far\n", (), "said.csv: expected 3 finite numbers in each row"),
        ("", (), "said.csv: expected one column colliding in the header, found none"),
        ("", ("--row", "2"), "--row: expected no such option with --configurations, found one"),
        ("", ("other.urdf",), "FILE: expected one robot with --configurations, found 2 files"),
    ],
)
def test_bad_tables_of_configurations_are_refused(text, words, message, judge):
    """Each message says where, what was expected and what was found; the exit status is 2."""
    status, out, err = judge(text, *words)
    assert (status, out) == (2, "")
    assert message in err
