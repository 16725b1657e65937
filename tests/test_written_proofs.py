"""Proofs that the library writes are verified by a program that shares nothing with it, and say what they should."""

import hashlib
import struct
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.interpolate import BPoly, CubicSpline

import loewner
from checker_oracle import composed_bodies, robot_of, simple_bodies
from families import translation
from gantry import LEFT, RIGHT, gantry, gantry_robot, wall
from loewner import (
    Body,
    CollisionChecker,
    ConvergenceError,
    FileError,
    InputError,
    Proof,
    Robot,
    Scene,
    Verdict,
    cli,
    planners,
)
from loewner._kernels.robots import plane_trees
from loewner.robots.proofs import proof_models, separations, written_proofs
from loewner.verify import Refused, verify
from motion_oracle import AFLOAT, FINGERS, example, free_configurations, ring, steps, written

PANDA = "panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"

# A cart in the plane, an arm on it that turns, and a hand that slides.
CART = [
    ("planar", 0, '<origin xyz="0 0 0.1" rpy="0 0 0.3"/><axis xyz="0 0 1"/>'),
    ("revolute", 1, '<origin xyz="0.1 0 0.2" rpy="0.2 0 0"/><axis xyz="0 1 0.2"/><limit lower="-3" upper="3"/>'),
    ("fixed", 2, '<origin xyz="0.1 0 0" rpy="0.4 1 0"/>'),
    ("prismatic", 3, '<origin xyz="0.3 0 0" rpy="0 0.3 0"/><axis xyz="1 0 1"/><limit lower="-0.2" upper="0.2"/>'),
]


BALL = """<robot name="r"><link name="a"/><link name="b"><collision><geometry><sphere radius="0.1"/></geometry>
</collision></link><joint name="j" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def panda():
    return example(*PANDA)


def proven(checker, Q0, Q1, **options):
    """Write a proof of the motions that are free, and verify it."""
    Q0, Q1 = np.broadcast_arrays(Q0, Q1)
    free = checker.certify_edges(Q0, Q1, **options).verdict == Verdict.FREE
    assert free.sum() >= 2
    proof = checker.certify_edges(Q0[free], Q1[free], proof=True, **options).proof
    report = verify(proof.data)
    assert report.sizes["pairs"] == len(checker.checked_pairs)
    assert len(report.motions) == free.sum()
    assert report.model == proof.model_hash == checker.model_hash
    return proof, report


def around(robot, rng, scene, count=4, length=0.3):
    checker = CollisionChecker(robot, scene)
    Q = free_configurations(checker, count)
    return checker, Q, steps(robot, rng, Q, length)


def test_an_arm_among_obstacles(panda, rng):
    """Proofs of an arm of hulls among boxes and hulls are verified and small."""
    checker, Q, ends = around(panda, rng, ring(rng, 8, 0.5, 0.9, 0.3), 5, 0.5)
    proof, report = proven(checker, Q, ends)
    assert proof.size < 5000 * len(report.motions)
    assert not report.uncovered
    assert not any(off for _, off in report.deviations)


def test_all_joints_and_curved_pieces(tmp_path, rng):
    """So are proofs with planar, turning and sliding joints, all kinds of pieces, margins and joint errors."""
    bodies = {f"l{k}": body for k, body in enumerate(simple_bodies(rng)[3:8])}
    robot = robot_of(tmp_path, CART, bodies)
    scene = Scene(margin=0.01)
    for k, body in enumerate(simple_bodies(rng)):
        scene.add(f"b{k}", body, translation(*rng.uniform(-1.5, 1.5, 3)))
    scene.add("held", Body.cone(0.05, 0.1))
    scene.attach("held", "l3", translation(z=0.2), touch_links=["l3", "l4"])
    scene.set_margin(0.002, "l2", "b1", lower=True)
    scene.allow("l1", "b2")
    checker, Q, ends = around(robot, rng, scene, 6)
    _, report = proven(checker, Q, ends, joint_error=1e-4)
    assert dict(report.deviations) == dict.fromkeys(robot.configuration_names, 1e-4)


def test_bodies_of_many_pieces(tmp_path, rng):
    """Pieces of one body are divided where no plane separates them together."""
    two, five, _, many, mixed = composed_bodies(rng)
    robot = robot_of(tmp_path, CART, {"l1": two, "l3": five, "l4": mixed})
    scene = Scene()
    for k in range(3):
        scene.add(f"b{k}", many, translation(*rng.uniform(-1, 1, 3)))
    checker, Q, ends = around(robot, rng, scene)
    proof, _ = proven(checker, Q, ends, tolerance=1e-3)
    assert {plane_trees.FIRST_DIVIDED, plane_trees.SECOND_DIVIDED} & set(proof.data[-proof.size - 32 :])


def test_surfaces_and_clouds(tmp_path, rng, capsys):
    """Parts of surfaces and clouds are pieces, and the verdict on closed surfaces depends on the start."""
    trimesh = pytest.importorskip("trimesh")
    ball = Body.from_surface(trimesh.creation.icosphere(3, 0.2))
    robot = robot_of(tmp_path, CART, {"l2": Body.capsule(0.04, 0.3), "l4": ball})
    scene = Scene()
    scene.add("torus", Body.from_surface(trimesh.creation.torus(0.4, 0.1)), translation(x=0.6, z=0.6))
    scene.add("cloud", Body.from_cloud(rng.normal(size=(300, 3)) * 0.1, radius=0.02), translation(x=-0.6, z=0.5))
    checker, Q, ends = around(robot, rng, scene)
    proof, report = proven(checker, Q, ends)
    assert report.uncovered == ("l4", "torus")  # the parts of their surfaces are pieces
    assert report.sizes["pieces"] > 50
    proof.save(tmp_path / "some.proof")
    assert cli.main(["verify", str(tmp_path / "some.proof")]) == 0
    assert "\nverified: FREE if nothing begins inside l4 and torus, all pairs" in capsys.readouterr().out


def test_a_mimic_and_a_placed_base(tmp_path):
    """Fingers that follow one value on a base with a pose of its own: the gap shrinks by both their deviations."""
    robot = written(tmp_path, FINGERS).placed([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    checker = CollisionChecker(robot)
    found = checker.certify_edges([0.1], [0.001], joint_error=5e-4, proof=True)
    report = verify(found.proof.data)
    assert report.tightest[-1] < 2 * 1e-3
    # The deviation of a value moves both fingers, towards each other.
    with pytest.raises(InputError, match="joint_error"):
        checker.certify_edges([0.1], [0.001], joint_error=-1, proof=True)
    assert checker.certify_edges([0.1], [0.001], joint_error=1.001e-3, proof=True).proof is None


def test_motions_that_come_near(tmp_path):
    """The gap shrinks to a micrometre, or to a nanometre, next to a plane that is parallel to no axis."""
    turn = np.eye(4)
    c, s = np.cos(0.3), np.sin(0.3)
    turn[:2, :2] = [[c, -s], [s, c]]
    turn[:3, 3] = turn[:3, :3] @ [0.4, 0.0, 0.0]
    robot = robot_of(
        tmp_path, [("prismatic", 0, '<axis xyz="1 0 0"/><limit lower="-2" upper="2"/>')], {"l1": Body.sphere(0.1)}
    )
    scene = Scene()
    scene.add("wall", Body.box([0.2, 2.0, 2.0]), turn)
    checker = CollisionChecker(robot, scene)
    touching = (0.3 - 0.1) / c
    for gap in (2e-6, 2e-9):
        _, report = proven(checker, [[0.0], [-1.0]], [[touching - gap], [-0.5]], tolerance=gap / 20)
        assert report.tightest[-1] < 5 * gap


def test_curves(tmp_path, rng):
    """Polynomials of any degree, and the segments of a spline begin exactly where the ones before end."""
    robot = robot_of(tmp_path, CART, {"l1": Body.box([0.2, 0.2, 0.1]), "l4": Body.cylinder(0.05, 0.2)})
    checker, Q, _ = around(robot, rng, ring(rng, 5, 0.6, 1.5, 0.3))
    for degree in (1, 2, 5):
        P = Q[0] + 0.05 * rng.normal(size=(degree + 1, 1, robot.dof))
        found = checker.certify_trajectory(BPoly(P, [0.0, 2.0]), joint_error=1e-5, proof=True)
        assert found.verdict == Verdict.FREE
        (motion,) = verify(found.proof.data).motions
        assert motion[0] == degree
    path = Q[0] + 0.05 * rng.normal(size=(4, robot.dof))
    found = checker.certify_trajectory([CubicSpline(np.arange(4.0), path)], proof=True)[0]
    assert [motion[1] for motion in verify(found.proof.data).motions][1:] == [True, True]


def test_plans(tmp_path):
    """The proof of a plan has a motion for each of the path's, and needs `full` and `certified`."""
    robot, scene = gantry_robot(tmp_path), wall()
    checker = CollisionChecker(robot, scene)
    found = planners.plan(checker, LEFT, RIGHT, full=True, proof=True, joint_error=1e-3)
    report = verify(found.proof.data)
    assert len(report.motions) == len(found.path) - 1
    assert all(motion[2] for motion in report.motions)
    assert np.array_equal(found.proof.motions, np.stack([found.path[:-1], found.path[1:]], axis=1))
    assert found.proof.verify() == report
    assert np.array_equal(report.points, found.proof.motions)
    assert planners.plan(checker, LEFT, RIGHT, full=True).proof is None
    assert len(planners.plan(checker, LEFT, LEFT, full=True, proof=True).proof.verify().motions) == 1  # it stays there
    for words, options in (
        ("full=True: the proof is an attribute", {"full": False}),
        ("certified=True", {"full": True, "certified": False}),
        ("in time", {"start_time": 1.3}),
    ):
        with pytest.raises(InputError, match=words):
            planners.plan(checker, LEFT, RIGHT, proof=True, **options)


def test_without_pairs_or_motions(tmp_path):
    """A motion without pairs has a proof, no motion has none: it would be verified, whatever the robot does."""
    robot = robot_of(tmp_path, CART[:1], {"l1": Body.sphere(0.1)})
    checker = CollisionChecker(robot)
    assert verify(checker.certify_edges(np.zeros(3), np.ones(3), proof=True).proof.data).sizes["pairs"] == 0
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(x=5))
    none, checker = np.empty((0, 3)), CollisionChecker(robot, scene)
    assert checker.certify_edges(none, none).proof is None
    with pytest.raises(InputError, match="proof: expected one motion or more, found none"):
        checker.certify_edges(none, none, proof=True)


def test_unproven_motions_have_no_proof(tmp_path):
    """A proof is written only on request, and only if all motions are free."""
    checker = CollisionChecker(gantry_robot(tmp_path), wall())
    found = checker.certify_edges([LEFT, LEFT], [LEFT + 0.1, RIGHT], proof=True)
    assert found.verdict.tolist() == [Verdict.FREE, Verdict.COLLIDING]
    assert found.proof is None
    assert checker.certify_edges(LEFT, LEFT + 0.1).proof is None


def test_what_a_proof_cannot_express(tmp_path):
    """Floating joints and bodies that follow motions are refused by name."""
    afloat = replace(written(tmp_path, AFLOAT), bodies={"hand": Body.sphere(0.1), "base": Body.sphere(0.01)})
    with pytest.raises(InputError, match="floating or ball joint, that of the link base"):
        _ = CollisionChecker(afloat).model_hash
    robot = robot_of(tmp_path, CART, {"l1": Body.sphere(0.1)})
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(x=3))
    scene.follow("ball", [0, 1], [translation(x=3), translation(x=4)])
    with pytest.raises(InputError, match=r"expected bodies at rest, .*follow"):
        CollisionChecker(robot, scene).certify_edges(np.zeros(5), np.ones(5), t0=0, t1=1, proof=True)


def test_joint_errors_that_a_proof_cannot_hold(tmp_path):
    """A ball that circles above a floor: deviations only move it sideways, but a proof allows for any direction."""
    joints = [("revolute", 0, '<axis xyz="0 0 1"/><limit lower="-3" upper="3"/>')]
    robot = robot_of(tmp_path, joints, {"l1": Body.sphere(0.1).transformed(translation(x=1.0))})
    scene = Scene()
    scene.add("floor", Body.box([4, 4, 1]), translation(z=-0.605))
    checker = CollisionChecker(robot, scene)
    assert checker.certify_edges([0.0], [1.0], joint_error=0.01).verdict == Verdict.FREE
    with pytest.raises(ConvergenceError, match=r"between l1 and floor .* motion 0.* lower joint_error"):
        checker.certify_edges([0.0], [1.0], joint_error=0.01, proof=True)
    verify(checker.certify_edges([0.0], [1.0], joint_error=0.004, proof=True).proof.data)


# -- the model ---------------------------------------------------------------------------------

HASH = """
import sys
from loewner import *
robot = Robot.from_urdf(sys.argv[1], srdf=sys.argv[2])
scene = Scene()
scene.add("wall", Body.box([0.1, 4.0, 1.0]), [[1, 0, 0, 0], [0, 1, 0, -1.5], [0, 0, 1, 0], [0, 0, 0, 1]])
print(CollisionChecker(robot, scene).model_hash)
"""


def test_equal_models_have_equal_hashes(tmp_path):
    """Hashes are equal in another process, and differ for each change of robot or scene."""
    urdf, srdf = gantry(tmp_path)
    robot, scene = Robot.from_urdf(urdf, srdf=srdf), wall()
    checker = CollisionChecker(robot, scene)
    known = checker.model_hash
    proof = checker.certify_edges(LEFT, LEFT + 0.1, proof=True).proof
    assert known == proof.model_hash == hashlib.sha256(proof.model).hexdigest()
    command = [sys.executable, "-c", HASH, str(urdf), str(srdf)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == known
    seen = {known}
    for change in (
        lambda: scene.move("wall", translation(y=-1.5000000001)),
        lambda: scene.set_margin(1e-9),
        lambda: scene.allow("wall", "ball"),
        lambda: scene.add("far", Body.sphere(1.0), translation(x=100)),
    ):
        change()
        seen.add(checker.model_hash)
        assert checker.model_hash in seen
    seen.add(CollisionChecker(robot.placed(translation(x=1e-12)), scene).model_hash)
    assert len(seen) == 6


def test_differences_of_models_are_named(tmp_path):
    """Each change of robot or scene is described by what it changed; the order of bodies counts, too."""
    urdf, srdf = gantry(tmp_path)
    box, post = (Body.box([0.1, 4.0, 1.0]), translation(y=-1.5)), (Body.sphere(0.1), translation(x=9.0))

    def made(margin=0.0, margins=(), allowed=(), old="", new="", **bodies):
        text = urdf.read_text()
        assert old in text
        (tmp_path / "other.urdf").write_text(text.replace(old, new, 1))
        scene = Scene(margin=margin)
        for name, (body, pose) in (bodies or {"wall": box, "post": post}).items():
            scene.add(name, body, pose)
        for given in margins:
            scene.set_margin(*given)
        for pair in allowed:
            scene.allow(*pair)
        return CollisionChecker(Robot.from_urdf(tmp_path / "other.urdf", srdf=srdf), scene)

    proof = made().certify_edges(LEFT, LEFT + 0.1, proof=True).proof
    assert proof.differences(made()) == []
    for words, checker in (
        ("body wall: different place", made(wall=(box[0], translation(y=-1.6)), post=post)),
        ("body post: different pieces", made(wall=box, post=(Body.sphere(0.2), post[1]))),
        ("body post: only in the proof", made(wall=box)),
        ("body more: only in the robot and scene", made(wall=box, post=post, more=post)),
        ("usual margin: 0.0 instead of 0.25", made(margin=0.25)),
        ("margin of ball and post: only in the robot and scene", made(margins=[(0.1, "post", "ball")])),
        ("pair left out, ball and post: only in the robot and scene", made(allowed=[("post", "ball")])),
        ("another order of links, values, bodies or pairs", made(post=post, wall=box)),
        ("limits of x: -1.0, 1.0 instead of -2.0, 1.0", made(old='lower="-1"', new='lower="-2"')),
        ("link rail: different axis", made(old='xyz="1 0 0"/>', new='xyz="1 0.5 0"/>')),
    ):
        assert proof.differences(checker) == [words]
    broken = proof.data[:24] + b"\xff" * len(proof.model) + proof.data[24 + len(proof.model) : -32]
    broken = Proof(broken + hashlib.sha256(broken).digest())
    with pytest.raises(InputError, match="expected a model"):
        broken.differences(made())
    with pytest.raises(InputError, match="expected motions"):
        _ = broken.motions
    with pytest.raises(FileError, match="cannot have"):
        broken.verify()


def test_a_proof_of_another_model_is_refused(tmp_path):
    """Planes of one model prove nothing about a model with a larger margin."""
    robot = written(tmp_path, FINGERS)
    one = CollisionChecker(robot).certify_edges([0.1], [0.001], proof=True).proof
    scene = Scene()
    scene.set_margin(0.01, against="links")
    other = proof_models.model_of(CollisionChecker(robot, scene)._ready()).data
    body = one.data[24 + len(one.model) : -32]
    head = one.data[:16] + len(other).to_bytes(4, "little") + one.data[20:24]
    data = head + other + body
    with pytest.raises(Refused):
        verify(data + hashlib.sha256(data).digest())


# -- files -------------------------------------------------------------------------------------


def test_files(tmp_path, capsys):
    """Files are written whole and read back; whatever else has the name is refused."""
    checker = CollisionChecker(written(tmp_path, FINGERS))
    proof = checker.certify_edges([0.1], [0.01], proof=True).proof
    path = tmp_path / "plan.proof"
    proof.save(path)
    assert Proof.load(path) == proof
    assert proof.size == len(proof.data) - len(proof.model) - 56
    assert repr(proof) == f"Proof(FREE, {len(proof.data)} bytes, model {proof.model_hash[:12]})"
    assert [file.name for file in tmp_path.iterdir() if "proof" in file.name] == ["plan.proof"]
    for broken, words in (
        (b"", "a proof of loewner"),
        (b"x" * 100, "a proof of loewner"),
        (proof.data[:-1], "not whole"),
        (proof.data + b"x", "not whole"),
        (proof.data[:-40] + bytes([proof.data[-40] ^ 1]) + proof.data[-39:], "changed"),
        (proof.data[:8] + b"\3" + proof.data[9:], "version"),
    ):
        path.write_bytes(broken)
        with pytest.raises(FileError, match=words):
            Proof.load(path)
        assert cli.main(["verify", str(path)]) == 1
        with pytest.raises(InputError, match=words):
            Proof(broken)
    with pytest.raises(InputError, match="expected bytes"):
        Proof("plan.proof")
    with pytest.raises(FileError, match="no such file"):
        Proof.load(tmp_path / "none.proof")
    with pytest.raises(FileError, match="written"):
        proof.save(tmp_path / "none" / "plan.proof")
    capsys.readouterr()


def test_command_line(tmp_path, capsys):
    """`loewner plan --proof` writes what `loewner verify` accepts, and compares with robot and scene."""
    urdf, srdf = gantry(tmp_path)
    scene = tmp_path / "scene.yaml"
    loewner.save_scene(wall(), scene)
    path, common = str(tmp_path / "plan.proof"), [str(urdf), "--srdf", str(srdf), "--scene", str(scene)]
    plan = ["plan", *common, "--start", "-0.5 -0.5 1.57", "--goal", "0.5 -0.5 1.57"]
    csv = str(tmp_path / "path.csv")
    assert cli.main([*plan, "--proof", path, "-o", csv]) == 0
    proof = Proof.load(path)
    sizes = f"{len(proof.data):,} bytes: model {len(proof.model):,}, proof {proof.size:,}"
    assert f"written   {path}, {sizes}" in capsys.readouterr().out
    assert cli.main(["verify", path]) == 0
    assert capsys.readouterr().out.endswith(
        "\nverified: FREE, all pairs of the proof are farther apart than their margins, at every time\n"
    )
    assert cli.main(["verify", path, "--path", csv, "--robot", *common]) == 0
    assert capsys.readouterr().out.endswith(
        f"\nthe model matches gantry.urdf, {srdf.name}, scene.yaml\nthe motions are those of path.csv\n"
        "verified: FREE, all pairs of the proof are farther apart than their margins, at every time\n"
    )
    assert cli.main(["verify", path, "--robot", *common[:3]]) == 1
    out = capsys.readouterr().out
    assert out.endswith(
        f"\ndifferent    body wall: only in the proof\nDIFFERENT MODEL: not made for gantry.urdf, {srdf.name}\n"
    )
    assert "verified" not in out
    assert cli.main(["verify", path, "--srdf", str(srdf)]) == 2
    assert cli.main([*plan, "--sampled", "--proof", path]) == 2
    assert "--proof: expected no --sampled with it" in capsys.readouterr().err
    collides = loewner.prove(Body.sphere(1.0), None, Body.sphere(1.0), None)
    collides.save(path)
    assert cli.main(["verify", path]) == 1
    assert capsys.readouterr().out.endswith("\nverified: COLLIDING, a and b have a common point\n")


def test_a_path_without_a_proof_is_written(tmp_path, capsys, monkeypatch):
    """A path is not lost where its proof cannot be written."""

    def refuse(*_):
        raise ConvergenceError("proof: expected a plane between a and b, found none")

    monkeypatch.setattr(loewner.planners.planning, "proof_of", refuse)
    urdf, srdf = gantry(tmp_path)
    csv, scene = tmp_path / "path.csv", tmp_path / "scene.yaml"
    loewner.save_scene(wall(), scene)
    plan = [
        "plan",
        str(urdf),
        "--srdf",
        str(srdf),
        "--scene",
        str(scene),
        "--start",
        "-0.5 -0.5 1.57",
        "--goal",
        "0.5 -0.5 1.57",
    ]
    assert cli.main([*plan, "--proof", str(tmp_path / "plan.proof"), "-o", str(csv)]) == 2
    assert f"{csv} is written, and its motions are free; proof: expected" in capsys.readouterr().err
    assert csv.exists()


def test_paths_are_compared_exactly(tmp_path, capsys):
    """One row too few, the last bit of a number, another order and curves are different paths."""
    checker = CollisionChecker(gantry_robot(tmp_path), wall())
    rows = np.array([LEFT, LEFT + 0.1, LEFT + 0.2])
    proof, other = str(tmp_path / "p.proof"), str(tmp_path / "other.npy")
    checker.certify_edges(rows[:-1], rows[1:], proof=True).proof.save(proof)
    near = rows.copy()
    near[1, 2] = np.nextafter(near[1, 2], 9)
    for made, status, words in (
        (rows, 0, "the motions are those of other.npy\nverified"),
        (rows[:2], 1, "DIFFERENT PATH: the proof has 2 motions, and other.npy has 2 configurations"),
        (near, 1, "DIFFERENT PATH: motion 0 is not from configuration 0 of other.npy to configuration 1"),
        (rows[::-1], 1, "DIFFERENT PATH: motion 0"),
        (rows[:1], 1, "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in other.npy, found (1, 3)"),
        (rows[0], 1, "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in other.npy, found (1, 3)"),
        (rows[:0], 1, "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in other.npy, found (0, 3)"),
        (rows[:, :2], 1, "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in other.npy, found (3, 2)"),
        (rows[None], 1, "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in other.npy, found (1, 3, 3)"),
        (rows[[0, 0, 1, 2]], 1, "DIFFERENT PATH: the proof has 2 motions, and other.npy has 4 configurations"),
    ):
        np.save(other, made)
        assert cli.main(["verify", proof, "--path", other]) == status
        assert words in capsys.readouterr().out.splitlines(keepends=False)[-1] or status == 0
    checker.certify_trajectory(BPoly(rows[:, None], [0.0, 1.0]), proof=True).proof.save(proof)
    np.save(other, rows[:2])
    assert cli.main(["verify", proof, "--path", other]) == 1
    assert "DIFFERENT PATH: motion 0 has the degree 2, and is not straight" in capsys.readouterr().out


def test_a_proof_without_motions_opens_for_no_path(tmp_path, capsys):
    """A file whose motions were cut out, with its checksum made good, is refused, and so is a path that has none."""
    checker = CollisionChecker(gantry_robot(tmp_path), wall())
    whole = checker.certify_edges(LEFT, LEFT + 0.1, proof=True).proof
    cut, file, path = struct.pack("<3dI", 0, 0, 0, 0), tmp_path / "cut.proof", tmp_path / "one.csv"
    head = whole.data[:16] + struct.pack("<II", len(whole.model), len(cut)) + whole.model + cut
    file.write_bytes(head + hashlib.sha256(head).digest())
    with pytest.raises(FileError, match="0 motions"):
        Proof.load(file).verify()
    for rows in ("", "0,-0.5,1.57\n"):
        path.write_text(f"x,y,turn\n{rows}")
        assert cli.main(["verify", str(file), "--path", str(path)]) == 1
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.startswith("refused: The proof cannot have 0 motions")
        whole.save(tmp_path / "whole.proof")
        assert cli.main(["verify", str(tmp_path / "whole.proof"), "--path", str(path)]) == 1
        told = capsys.readouterr().out
        assert "DIFFERENT PATH: expected shape (k, 3) with k >= 2 in one.csv, found (" in told
        assert "verified" not in told


def test_audits_write_proofs(tmp_path, capsys):
    """`loewner audit --proof` and `Trajectory.certify(proof=True)` write the proofs of curves that are free."""
    urdf, srdf = gantry(tmp_path)
    robot = Robot.from_urdf(urdf, srdf=srdf)
    moves = planners.trajectory(robot, np.array([LEFT, LEFT + 0.1]), velocity=1.0, acceleration=1.0)
    proof = moves.certify(CollisionChecker(robot, wall()), proof=True).proof
    points, scene, written = tmp_path / "moves.csv", tmp_path / "scene.yaml", tmp_path / "moves.proof"
    moves.save(points)
    loewner.save_scene(wall(), scene)
    audit = ["audit", str(urdf), str(points), "--srdf", str(srdf), "--scene", str(scene), "--proof", str(written)]
    assert cli.main(audit) == 0
    assert f"written   {written}" in capsys.readouterr().out
    for one in (proof, Proof.load(written)):
        assert len(one.verify().motions) >= 1


# -- parts of the search -----------------------------------------------------------------------


def test_rounded_normals(rng):
    """Normals of whole numbers of 16 bits turn by little."""
    n = rng.normal(size=(50, 3))
    found = np.array([plane_trees.rounded(tuple(row)) for row in n.tolist()])
    assert (found == np.rint(found)).all()
    assert np.abs(found).max() <= 32767
    turned = np.linalg.norm(np.cross(found, n), axis=1)
    assert (turned < 3e-5 * np.linalg.norm(found, axis=1) * np.linalg.norm(n, axis=1)).all()
    assert plane_trees.rounded((0.0, 0.0, 0.0)) == (0, 0, 0)


def of_kernel(robot, scene):
    """The input of the kernel, and the model it was made of."""
    model = proof_models.model_of(CollisionChecker(robot, scene)._ready())
    prepared = separations._Prepared(model, robot.tree, np.zeros(len(model.bodies.link), dtype=np.int64))
    return model, prepared.model


def reaches(record, cluster, n):
    """The largest products of directions with the points of a cluster."""
    return np.array([np.dot(plane_trees.support(record, cluster, tuple(row)), row) for row in n.tolist()])


def test_supports_of_clusters(rng, tmp_path):
    """Largest products with clusters are those of their halves, and boxes and balls hold all pieces."""
    mixed = composed_bodies(rng)[-1]
    robot = robot_of(tmp_path, CART[:1], {"l1": mixed})
    scene = Scene()
    scene.add("b", mixed, translation(x=3))
    model, record = of_kernel(robot, scene)
    n = rng.normal(size=(100, 3))
    for body in (0, 1):
        whole = record.bodies[body, plane_trees.ROOT]
        reach = reaches(record, whole, n)
        box, turned = record.boxes[whole], n @ model.bodies.turn[body]
        assert (reach <= n @ box[:3] + np.abs(turned) @ box[3:6] + 1e-12).all()
        assert (n @ box[6:] < reach).all()
        left, right = record.clusters[whole, [plane_trees.LEFT_HALF, plane_trees.RIGHT_HALF]]
        assert np.allclose(reach, np.maximum(reaches(record, left, n), reaches(record, right, n)))
        center, radius = record.balls[body, :3], record.balls[body, 3]
        assert (reach <= n @ center + radius * np.linalg.norm(n, axis=1) + 1e-12).all()


@pytest.mark.parametrize("k", range(9))
def test_gaps_are_distances(rng, tmp_path, k):
    """Along the normal of the exact distance, the gap is the distance, for all kinds of pieces."""
    body = simple_bodies(rng)[k]
    robot = robot_of(tmp_path, CART[:1], {"l1": body})
    scene = Scene()
    scene.add("b", body, translation(1.0, 0.5, 0.3))
    found = loewner.distance(body, None, body, translation(1.0, 0.5, 0.3), exact=True)
    _, record = of_kernel(robot, scene)
    roots = record.bodies[:, plane_trees.ROOT]
    gap = -sum(reaches(record, roots[k], sign * found.normal[None]).sum() for k, sign in ((0, 1.0), (1, -1.0)))
    assert gap == pytest.approx(found.distance, abs=1e-9)


@pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")
def test_gaps_below_what_a_proof_can_hold_end_the_search():
    """A gap of 1e-11 m is free, and too small for a proof: an error at once, however far the halving could go."""
    robot = Robot.from_urdf(text=BALL)
    for gap, far in ((1e-11, 0.0), (3e-5, 1e6)):
        scene = Scene()
        scene.add("box", Body.box([1, 1, 1]), translation(far, 0, -0.6 - gap))
        checker = CollisionChecker(robot.placed(translation(far)), scene)
        assert checker.certify_edges([-0.2], [0.2]).verdict == Verdict.FREE
        with pytest.raises(ConvergenceError, match="b and box"):
            checker.certify_edges([-0.2], [0.2], proof=True)


def test_a_moving_surface_of_many_corners():
    """Its hull has more corners than kernels search one by one; its distance from a ball is right."""
    ring_ = trimesh.creation.torus(0.25, 0.07)
    robot = replace(Robot.from_urdf(text=BALL), bodies={"b": Body.from_surface(ring_)})
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(-0.25, 0.1, 0.3))
    checker = CollisionChecker(robot, scene)
    assert checker.certify_edges([-0.02], [0.02]).verdict == Verdict.FREE
    assert verify(checker.certify_edges([-0.02], [0.02], proof=True).proof.data).sizes["planes"] == 1


def test_minus_zero_is_zero():
    """Poses that differ in the sign of a zero have the same model."""
    hashes = set()
    for zero in (0.0, -0.0):
        scene, T = Scene(), np.eye(4)
        T[0, 1], T[1, 3], T[2, 3] = zero, zero, -2.0
        scene.add("box", Body.box([1, 1, 1]), T)
        hashes.add(CollisionChecker(Robot.from_urdf(text=BALL), scene).model_hash)
    assert len(hashes) == 1


@pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")
def test_what_checkers_might_refuse_is_not_written(monkeypatch):
    """Many links, far places, far turns and large files are errors of the library, not refusals of a checker."""
    chain = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="prismatic"><parent link="{"a" if k == 0 else f"l{k - 1}"}"/>'
        f'<child link="l{k}"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for k in range(1000)
    )
    long = BALL.replace("</robot>", chain + "</robot>")
    with pytest.raises(InputError, match="at most 1000 links .* found 1002 links"):
        CollisionChecker(Robot.from_urdf(text=long)).model_hash  # noqa: B018
    turning = BALL.replace("prismatic", "continuous").replace('lower="-2" upper="2" ', "")
    checker = CollisionChecker(Robot.from_urdf(text=turning))
    with pytest.raises(InputError, match="turn to 1e.06 rad"):
        checker.certify_edges([1.5e6], [1.5e6], proof=True)
    monkeypatch.setattr(written_proofs, "MOST_BYTES", 10_000)
    with pytest.raises(InputError, match="prove fewer motions at a time"):
        checker.certify_edges(np.zeros((1000, 1)), [0.0], proof=True)
