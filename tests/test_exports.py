"""Bodies in other programs' formats: MuJoCo, pinocchio and trimesh read them back, and they are the same sets."""

import os
from itertools import pairwise

import coal
import mujoco
import numpy as np
import pinocchio
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import loewner
from families import random_poses
from loewner import Body, InputError, Robot, load_scene
from sampling import quick

# How far float32, in which MuJoCo and GLB keep vertices, rounds lengths about 1 m.
SINGLE = 1e-6

BODIES = {
    "box": Body.box([0.3, 0.2, 1.5]),
    "cube": Body.box([0.5, 0.5, 0.5]),
    "sphere": Body.sphere(0.3),
    "capsule": Body.capsule(0.2, 0.5),
    "cylinder": Body.cylinder(0.2, 0.7),
    "cone": Body.cone(0.3, 0.6),
    "ellipsoid": Body.ellipsoid([0.2, 0.3, 0.5]),
    "points": Body.from_points(np.random.default_rng(0).normal(size=(30, 3)) * 0.3),
    "union": Body.union(
        [Body.box([0.1, 0.2, 1]), Body.from_points(np.random.default_rng(1).normal(size=(9, 3)) * 0.2)]
    ),
}
WHICH = (None, "inner", "outer")


@pytest.fixture(params=BODIES, ids=str)
def body(request, tmp_path, monkeypatch):
    """A body off the origin and turned, in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    T = random_poses(np.random.default_rng(7), 1)[0]
    T[:3, 3] = [0.3, -0.2, 0.1]
    return BODIES[request.param].transformed(T)


def wanted(body, which):
    """The body that a file should be: itself, or its ellipsoids as bodies."""
    if which is None:
        return body
    ellipsoids = getattr(body, which)
    parts = []
    for E in ellipsoids:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = E.rotation, E.center
        parts.append(Body.ellipsoid(E.semi_axes).transformed(T))
    return Body.union(parts)


def around(seed, n=300):
    """Poses of a small ball near the body."""
    Ts = np.tile(np.eye(4), (n, 1, 1))
    Ts[:, :3, 3] = np.random.default_rng(seed).normal(size=(n, 3)) * 0.6
    return Ts


@pytest.mark.parametrize("which", WHICH)
def test_mujoco_reads_back_the_same_set(body, which):
    """Distances to a small ball are those of the body, or of its ellipsoids, and MuJoCo finds the same contacts."""
    text = body.to_mjcf("body.xml", ellipsoids=which, name="thing")
    with open("body.xml") as file:
        assert file.read() == text
    back = load_scene("body.xml")["thing"]
    Ts, ball = around(1), Body.sphere(0.05)
    here = loewner.distance(back, None, ball, Ts, exact=True).distance
    there = loewner.distance(wanted(body, which), None, ball, Ts, exact=True).distance
    apart = there > 0
    # A cone is a polytope of 48 sides around it, which is larger by a part in 450 across.
    slack = 0.3 / 450 if any(p.kind == "cone" for p in body.pieces) and which is None else 0
    assert (np.abs(here - there)[apart] <= SINGLE + slack).all()
    assert (here <= there + SINGLE).all()

    model = mujoco.MjModel.from_xml_string(
        text.replace("</worldbody>", '<body mocap="true"><geom size="0.05"/></body></worldbody>')
    )
    data = mujoco.MjData(model)
    sure = np.abs(here) > 1e-5
    for T, distance in zip(Ts[sure], here[sure], strict=True):
        data.mocap_pos[0] = T[:3, 3]
        mujoco.mj_kinematics(model, data)
        ball_geom = model.ngeom - 1
        near = min(mujoco.mj_geomDistance(model, data, g, ball_geom, 1.0, None) for g in range(ball_geom))
        if distance < 0.5:
            assert (near > 0) == (distance > 0)


@pytest.mark.parametrize("which", WHICH)
def test_mujoco_finds_the_same_volumes(body, which):
    """MuJoCo computes masses from its own geoms; at density 1 they are the volumes."""
    text = body.to_mjcf(ellipsoids=which).replace("<geom ", '<geom density="1" ')
    mass = mujoco.MjModel.from_xml_string(text).body_mass.sum()
    if which is not None:
        assert mass == pytest.approx(getattr(body, which).volume.sum(), rel=1e-6)
    else:
        assert mass == pytest.approx(VOLUMES[body.pieces[0].kind](body), rel=1e-2 if "cone" in repr(body) else 1e-6)


VOLUMES = {
    "polytope": lambda body: body.to_trimesh().volume,
    "sphere": lambda body: 4 / 3 * np.pi * 0.3**3,
    "capsule": lambda body: np.pi * 0.2**2 * (0.5 + 4 / 3 * 0.2),
    "cylinder": lambda body: np.pi * 0.2**2 * 0.7,
    "cone": lambda body: np.pi * 0.3**2 * 0.6 / 3,
    "ellipsoid": lambda body: 4 / 3 * np.pi * 0.2 * 0.3 * 0.5,
}


@pytest.mark.parametrize("which", WHICH)
@pytest.mark.parametrize("count", quick(25, 100))
def test_urdf_reads_back_the_same_set(body, which, count):
    """Pinocchio and `Robot.from_urdf` find the body; polytopes are around what they are for, or in inner ellipsoids."""
    body.to_urdf("thing.urdf", ellipsoids=which)
    robot = Robot.from_urdf("thing.urdf")
    back = robot.bodies["thing"]
    Ts, ball = around(2), Body.sphere(0.05)
    here = loewner.distance(back, None, ball, Ts, exact=True).distance
    there = loewner.distance(wanted(body, which), None, ball, Ts, exact=True).distance
    apart, rounding = there > 0, 1e-11
    if which == "inner":
        assert (here >= there - rounding)[apart].all()
    else:
        assert (here <= there + rounding)[apart].all()
    curved = which is not None or any(piece.kind in ("ellipsoid", "cone") for piece in body.pieces)
    assert (np.abs(here - there)[apart] <= (0.08 if curved else rounding)).all()

    model = pinocchio.buildModelFromUrdf("thing.urdf")
    kind = pinocchio.GeometryType.COLLISION
    found = pinocchio.buildGeomFromUrdf(model, "thing.urdf", kind, package_dirs=[os.getcwd()]).geometryObjects
    assert len(found) == len(back.pieces)
    for T, distance in zip(Ts[apart][:count], here[apart][:count], strict=True):
        at, small = coal.Transform3s(np.eye(3), T[:3, 3]), coal.Sphere(0.05)
        theirs = [
            coal.distance(
                thing.geometry,
                coal.Transform3s(thing.placement.rotation, thing.placement.translation),
                small,
                at,
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            for thing in found
        ]
        assert min(theirs) == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize("what", ["pieces", "inner", "outer"])
def test_trimesh_has_a_mesh_for_each_piece(body, what):
    """The meshes are closed, face outward, lie in what they stand for and fill it; GLB keeps them."""
    scene = body.to_trimesh(what)
    assert list(scene.geometry) == [f"piece_{k}" for k in range(len(body.pieces))]
    for piece, mesh in zip(body.pieces, scene.geometry.values(), strict=True):
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        if what != "pieces":
            ellipsoid = getattr(piece, what)
            assert 0.98 * ellipsoid.volume < mesh.volume < ellipsoid.volume
            assert np.allclose(
                np.linalg.norm(np.linalg.solve(ellipsoid.factor, (mesh.vertices - ellipsoid.center).T), axis=0), 1
            )
        elif piece.kind == "polytope":
            assert mesh.volume == pytest.approx(trimesh.Trimesh(piece.vertices, piece.triangles).volume)
        else:
            assert 0.98 * VOLUMES[piece.kind](body) < mesh.volume < VOLUMES[piece.kind](body)
    scene.export("thing.glb")
    back = trimesh.load("thing.glb")
    assert sorted(back.geometry) == sorted(scene.geometry)
    assert back.volume == pytest.approx(scene.volume, rel=SINGLE)


def test_a_box_stays_a_box(tmp_path):
    """However it is turned and however long, a box is written as one, and what is nearly a box is not."""
    for seed, T in enumerate(random_poses(np.random.default_rng(3), 20)):
        size = 10 ** np.random.default_rng(seed).uniform(-2, 1, 3)
        box = Body.box(size).transformed(T)
        assert 'type="box"' in box.to_mjcf()
        bent = box.pieces[0].vertices.copy()
        bent[0] += 1e-6 * size.max()
        assert 'type="mesh"' in Body.from_points(bent).to_mjcf()


def test_urdf_keeps_poses_where_roll_and_yaw_turn_alike(tmp_path):
    """At a pitch of a right angle, or near one, the box stands where it did."""
    for seed, off in enumerate([0.0, 1e-16, 1e-12, 1e-9, 1e-8, 1e-6, 1e-3]):
        roll, yaw = np.random.default_rng(seed).uniform(-3, 3, 2)
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", [roll, (-1) ** seed * (np.pi / 2 - off), yaw]).as_matrix()
        box = Body.box([0.1, 0.2, 0.3]).transformed(T)
        box.to_urdf(tmp_path / "box.urdf")
        back = Robot.from_urdf(tmp_path / "box.urdf").bodies["box"]
        corners, found = box.pieces[0].vertices, back.pieces[0].vertices
        assert np.linalg.norm(corners[:, None] - found, axis=2).min(axis=1).max() < 1e-15


def test_surfaces_are_refused_but_for_their_ellipsoids(tmp_path):
    """MuJoCo would take the hull of a surface, which is another set; around it the outer ellipsoid still is."""
    bowl = trimesh.creation.annulus(0.1, 0.2, 0.3)
    surface = Body.from_surface(bowl)
    for write in (surface.to_mjcf, lambda **options: surface.to_urdf(tmp_path / "bowl.urdf", **options)):
        with pytest.raises(InputError, match="piece 0 is a surface"):
            write()
        write(ellipsoids="outer")
    assert not list(tmp_path.glob("*.npz"))
    open_one = Body.from_surface((bowl.vertices, bowl.faces[1:]), solid=False)
    with pytest.raises(InputError, match="inner ellipsoids are points"):
        open_one.to_mjcf(ellipsoids="inner")
    assert open_one.to_trimesh().geometry["piece_0"].faces.shape == bowl.faces[1:].shape


@pytest.mark.parametrize("name", ["", "a b", "a<b", 3, None, "ö/../x"])
def test_names_are_plain(name, tmp_path):
    """A name that some reader would stumble on is refused."""
    with pytest.raises(InputError, match="name: expected letters"):
        Body.sphere(1).to_mjcf(name=name)


def test_the_world_is_no_body_of_a_model():
    """MuJoCo has a body of that name in every model."""
    with pytest.raises(InputError, match="name: expected another one than 'world'"):
        Body.sphere(1).to_mjcf(name="world")


def test_files_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    """A disk that is full leaves the older file, and no temporary one."""
    path = tmp_path / "part.xml"
    Body.sphere(1).to_mjcf(path)
    before = path.read_text()

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises(loewner.FileError, match="No space left"):
        Body.sphere(2).to_mjcf(path)
    with pytest.raises(loewner.FileError, match="No space left"):
        Body.sphere(2).to_urdf(tmp_path / "part.urdf")
    assert path.read_text() == before
    assert [file.name for file in tmp_path.iterdir()] == ["part.xml"]


def test_mesh_names_have_their_prefix(tmp_path):
    """A package of ROS finds the meshes where the prefix says."""
    stones = Body.from_pieces(np.random.default_rng(0).normal(size=(2, 8, 3)))
    (tmp_path / "rocks").mkdir()
    stones.to_urdf(tmp_path / "rocks" / "stones.urdf", mesh_prefix="package://rocks/")
    meshes = [file.name for file in (tmp_path / "rocks").glob("stones-*.obj")]
    text = (tmp_path / "rocks" / "stones.urdf").read_text()
    assert len(meshes) == 2
    assert all(f'"package://rocks/{mesh}"' in text for mesh in meshes)
    back = Robot.from_urdf(tmp_path / "rocks" / "stones.urdf", package_dirs=tmp_path).bodies["stones"]
    for a, b in zip(stones.pieces, back.pieces, strict=True):
        assert np.array_equal(np.sort(a.vertices, axis=0), np.sort(b.vertices, axis=0))
    assert all(a < b for a, b in pairwise(sorted(file.name for file in (tmp_path / "rocks").iterdir())))


def test_meshes_of_an_older_urdf_stay(tmp_path):
    """A URDF, or a copy of it, keeps its meshes when another is written under its name, or none can be written."""
    rng = np.random.default_rng(0)
    first, second = (Body.from_points(rng.normal(size=(8, 3))) for _ in range(2))
    first.to_urdf(tmp_path / "stone.urdf")
    (tmp_path / "copy.urdf").write_text((tmp_path / "stone.urdf").read_text())
    second.to_urdf(tmp_path / "stone.urdf")
    for name, body in (("copy", first), ("stone", second)):
        (back,) = Robot.from_urdf(tmp_path / f"{name}.urdf").bodies.values()
        assert np.array_equal(np.sort(back.pieces[0].vertices, axis=0), np.sort(body.pieces[0].vertices, axis=0))
    before = {file.name for file in tmp_path.iterdir()}
    (tmp_path / "other.urdf").mkdir()
    with pytest.raises(loewner.FileError, match="found a directory"):
        Body.from_points(rng.normal(size=(8, 3))).to_urdf(tmp_path / "other.urdf")
    assert {file.name for file in tmp_path.iterdir()} == before | {"other.urdf"}


@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-5, 1e-6, 1e-7])
def test_mujoco_reads_small_pieces(size):
    """Also pieces whose volume, for MuJoCo, is too small for a solid; those that it refuses are refused here."""
    hull, thin = 0.5 * np.random.default_rng(0).normal(size=(2, 20, 3))
    for body in (Body.from_points(size * hull), Body.cone(size, size), Body.from_points(thin * [1.0, size, 0.1])):
        model = mujoco.MjModel.from_xml_string(body.to_mjcf())
        low, high = body.outer.bounding_box()
        assert 0.2 < model.geom_rbound[0] / np.linalg.norm(high - low) < 2.0
    with pytest.raises(InputError, match="surface is at least 1e-14 m².*metres"):
        Body.from_points(1e-8 * hull).to_mjcf()
