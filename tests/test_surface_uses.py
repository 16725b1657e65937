"""Surfaces wherever bodies go: files, robots, motions, scene files, the command line, pictures, the paper."""

import io
import json
import pickle
import re
import time
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loewner
from checker_oracle import agrees, robot_of
from families import pieces, random_poses, translation
from loewner import (
    Bodies,
    Body,
    CollisionChecker,
    FileError,
    InputError,
    Robot,
    Scene,
    Verdict,
    cli,
    collide,
    distance,
    load_scene,
    paper,
    planners,
    plots,
    save_scene,
)
from loewner._base import _archives
from loewner.robots.description import link_bodies
from motion_oracle import assert_true, example
from robot_oracle import robots_folder
from sampling import quick, quick_of

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS


def cup(height: float = 1.0) -> trimesh.Trimesh:
    """Open at the top; its inside begins at z = 0 and has a radius of 0.4."""
    profile = [(0, -0.05), (0.45, -0.05), (0.45, height), (0.4, height), (0.4, 0), (0, 0)]
    return trimesh.creation.revolve(profile, sections=24)


def sheet() -> trimesh.Trimesh:
    """A square of edge 1 at z = 0, open and flat."""
    corners = [[-0.5, -0.5, 0], [0.5, -0.5, 0], [-0.5, 0.5, 0], [0.5, 0.5, 0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)


def hollow() -> trimesh.Trimesh:
    """A box of 2 m with a cavity of 1.6 m."""
    inner = trimesh.creation.box((1.6, 1.6, 1.6))
    inner.invert()
    return trimesh.util.concatenate([trimesh.creation.box((2, 2, 2)), inner])


def run(capsys, *arguments):
    """Exit status, standard output and standard error of a command."""
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


# -- files -------------------------------------------------------------------------------------


def stored(body: Body | Bodies, folder: Path) -> dict[str, np.ndarray]:
    """The arrays of a saved body."""
    body.save(folder / "stored.npz")
    with np.load(folder / "stored.npz", allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def forged(arrays: dict[str, np.ndarray], folder: Path) -> Path:
    """A file of these arrays with a checksum that fits."""
    content = {name: array for name, array in arrays.items() if name not in ("format", "version", "digest")}
    with open(folder / "forged.npz", "wb") as stream:
        np.savez(
            stream, format=arrays["format"], version=arrays["version"], digest=_archives.digest(content), **content
        )
    return folder / "forged.npz"


def test_files_without_surfaces_are_of_the_older_version(tmp_path):
    """What an older loewner can read is written so that it does; what it cannot says that the file is newer."""
    for body, version in ((Body.box([1, 1, 1]), 1), (Body.from_surface(cup()), 2), (Body.from_surface(sheet()), 2)):
        assert stored(body, tmp_path)["version"] == version
    mixed = Bodies([Body.sphere(1.0), Body.from_surface(sheet())])
    assert stored(mixed, tmp_path)["version"] == 2
    assert stored(mixed[:1], tmp_path)["version"] == 1
    newer = {**stored(Body.box([1, 1, 1]), tmp_path), "version": np.array(3)}
    with pytest.raises(FileError, match="expected format version 2 or older, found 3; a newer loewner"):
        Body.load(forged(newer, tmp_path))


def test_an_older_version_is_read(tmp_path):
    """The same arrays under version 1, as they were written before there were surfaces."""
    arrays = stored(Body.cone(1, 2), tmp_path)
    assert arrays["version"] == 1
    assert Body.load(forged(arrays, tmp_path)).pieces[0].kind == "cone"


def test_loaded_surfaces_are_the_same(tmp_path):
    """Every array, to the bit, among polytopes small and large and curved pieces; twice moved as well."""
    ball = np.random.default_rng(0).normal(size=(400, 3))
    parts = [Body.from_surface(cup(), radius=0.01), Body.from_points(ball / np.linalg.norm(ball, axis=1)[:, None])]
    parts += [Body.from_surface(sheet()), Body.from_pieces(pieces("boxes", 3)), Body.cone(1, 2)]
    parts += [Body.from_surface(hollow()), Body.union([parts[1], parts[0], Body.sphere(1.0), parts[2], parts[3]])]
    T = random_poses(np.random.default_rng(1), 1, 30.0)[0]
    moved = [part.transformed(T).transformed(T) for part in parts]
    bodies = Bodies([*parts, *moved])
    bodies.save(tmp_path / "all.npz")
    loaded = Bodies.load(tmp_path / "all.npz")
    copied = pickle.loads(pickle.dumps(bodies))
    for name in ("layout", "points", "triangles", "outer_factor", "inner_factor", "frames", "gaps"):
        np.testing.assert_array_equal(getattr(loaded._packed, name), getattr(bodies._packed, name))
        np.testing.assert_array_equal(getattr(copied._packed, name), getattr(bodies._packed, name))
    assert [b.pieces[0].kind for b in loaded] == [b.pieces[0].kind for b in bodies]


def test_a_union_keeps_trees(tmp_path):
    """Pieces of a union answer as they do alone; iterating, indexing and joining as well."""
    body = Body.union([Body.sphere(0.1), Body.from_surface(cup())]).transformed(translation(0.5))
    for one in (body, next(iter(Bodies([body]))), Bodies([body, body])[1], pickle.loads(pickle.dumps(body))):
        assert [piece.kind for piece in one.pieces] == ["sphere", "solid"]
        assert collide(one, None, Body.sphere(0.05), translation(0.5))
        assert not collide(one, None, Body.sphere(0.05), translation(0.5, 0, 0.5))


def _set(name, index, value):
    def change(arrays):
        arrays[name] = arrays[name].copy()
        arrays[name][index] = value

    return change


def _opened(arrays):
    arrays["triangles"] = arrays["triangles"][1:]
    arrays["triangle_start"] = arrays["triangle_start"] - [0, 1]


def _without_triangles(arrays):
    arrays["triangles"] = arrays["triangles"][:0]
    arrays["triangle_start"] = arrays["triangle_start"] * 0


def _with_a_point(arrays):
    arrays["points"] = np.concatenate([arrays["points"], [[0.0, 0.0, 0.0]]])
    arrays["layout"] = arrays["layout"] + [[0, 0, 1, 0, 0]]


FORGED = {
    "an open solid": (_opened, "solid: expected a closed mesh"),
    "a triangle turned over": (_set("triangles", 0, [1, 0, 2]), "solid: expected a closed mesh|triangles"),
    "no triangles": (_without_triangles, "expected triangles of a surface"),
    "an index out of range": (_set("triangles", (0, 1), 10**9), "triangles: expected the piece's own points"),
    "a negative index": (_set("triangles", (0, 1), -1), "triangles: expected the piece's own points"),
    "a point of no triangle": (_with_a_point, "triangles: expected every point in one"),
    "points that are NaN": (_set("points", (0, 0), np.nan), "points: expected finite"),
    "points far away": (_set("points", (0, 0), 1e15), "mesh: expected sizes|outer ellipsoid"),
    "points outside the ellipsoid": (_set("points", (0, 2), 9.0), "outer ellipsoid|solid"),
    "a negative zero": (_set("points", (0, 0), -0.0), "negative zeros|solid|outer"),
    "a negative radius": (_set("frames", (0, 0), -1.0), "frames: expected a radius >= 0"),
    "a radius beyond the ellipsoid": (_set("frames", (0, 0), 0.5), "outer ellipsoid"),
    "a radius that is NaN": (_set("frames", (0, 0), np.nan), "frames: expected finite"),
    "a frame": (_set("frames", (0, 5), 1.0), "frames: expected a radius alone"),
    "a smaller outer ellipsoid": (lambda a: a.update(outer_factor=a["outer_factor"] * 0.99), "outer ellipsoid"),
    "a flat outer ellipsoid": (_set("outer_factor", (0, slice(None), 2), 0.0), "outer_factor"),
    "an inner ellipsoid": (_set("inner_factor", 0, np.eye(3) * 0.3), "inner ellipsoid"),
    "a shifted inner ellipsoid": (_set("inner_center", 0, [0.0, 0.0, 9.0]), "inner ellipsoid"),
    "infinite gaps": (_set("gaps", (0, 1), np.inf), "gaps"),
    "kind -1": (_set("layout", (0, 0), -1), "layout: expected kinds"),
    "kind 0": (_set("layout", (0, 0), 0), "layout: expected at least four planes"),
}


@pytest.mark.parametrize("radius", [0.0, 0.01])
@pytest.mark.parametrize("name", FORGED)
def test_forged_surfaces_are_refused(name, radius, tmp_path):
    """A file that breaks a law is refused by name, its checksum notwithstanding."""
    change, message = FORGED[name]
    solid = "inner" not in name  # the inner ellipsoid of a solid is found anew, whatever the file says
    arrays = stored(Body.from_surface(trimesh.creation.box((1, 2, 3)), radius=radius, solid=solid), tmp_path)
    arrays["points"] = np.abs(arrays["points"]) * np.sign(arrays["points"])
    change(arrays)
    with pytest.raises(FileError, match=f"(?s)forged.npz.*({message})"):
        Body.load(forged(arrays, tmp_path))


@pytest.mark.filterwarnings("ignore:.*Then give scale=:UserWarning")
@pytest.mark.parametrize("seed", quick_of(range(40), range(12)))
def test_radii_of_any_size_are_loaded(seed, tmp_path):
    """What from_surface made is never refused: flat, thin and round, radii from far below its size to far above."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3)) * 10.0 ** rng.uniform(-7, 0, 3) + rng.normal(size=3) * 10.0 ** rng.uniform(-3, 2)
    points[:, 2] *= rng.random() < 0.7
    mesh = trimesh.Trimesh(points, rng.permuted(np.tile(np.arange(12), (8, 1)), axis=1)[:, :3], process=False)
    body = Body.from_surface(mesh, solid=False, radius=10.0 ** rng.uniform(-9, 3))
    for one in (body, body.transformed(random_poses(rng, 1, 1.0)[0])):
        one.save(tmp_path / "one.npz")
        Body.load(tmp_path / "one.npz")


@pytest.mark.parametrize("radius", [1e-320, 1e-200, 1e-100, 1e-30, 1e-15, 1e6, 1e11])
def test_radii_beyond_all_use(radius, tmp_path):
    """Whatever is taken for a radius makes a body that is saved, loaded and asked; what is larger is refused."""
    body = Body.from_surface(cup(), radius=radius)
    body.save(tmp_path / "one.npz")
    assert collide(Body.load(tmp_path / "one.npz"), None, Body.sphere(0.1), translation(0, 0, 0.5)) == (radius > 1)
    for far in (1e13, 1e200, 1e308):
        with pytest.raises(loewner.GeometryError, match="radius: expected at most"):
            Body.from_surface(cup(), radius=far)


# -- inner ellipsoids that are points ----------------------------------------------------------


def test_a_point_for_an_inner_ellipsoid():
    """Every method of an ellipsoid without a size answers, and what takes two of them says what is wrong."""
    inner = Body.from_surface(sheet()).inner
    assert (inner.semi_axes == 0).all()
    assert (inner.volume == 0).all()
    assert not np.isnan(inner.rotation).any()
    assert (inner.shape_matrix == 0).all()
    at = inner.center[0]
    assert inner.contains(at).tolist() == [True]
    assert inner.contains(at + 1e-9).tolist() == [False]
    np.testing.assert_array_equal(inner.support([1, 2, 3]), inner.center)
    np.testing.assert_array_equal(inner.bounding_box(), [inner.center, inner.center])
    np.testing.assert_allclose(inner.transformed(translation(1.0)).center, inner.center + [1, 0, 0])
    np.testing.assert_allclose(inner.affine(2 * np.eye(3), [0, 0, 1]).center, 2 * inner.center + [0, 0, 1])
    both = Body.union([Body.from_surface(sheet()), Body.sphere(1.0)]).inner
    assert both.contains([0.1, 0.1, 0.1]).tolist() == [False, True]
    assert "0.0" in repr(inner[0])
    for query in (loewner.overlap, loewner.contact_function, loewner.near_points):
        for pair in ((inner, both), (both, inner)):
            with pytest.raises(loewner.GeometryError, match="found a point"):
                query(*pair)


# -- robots ------------------------------------------------------------------------------------


URDF = """<robot name="barista">
<link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
<link name="tray"><collision><origin xyz="0 0 0.2"/><geometry><mesh filename="cup.stl"/></geometry></collision></link>
<link name="lid"><collision><geometry><mesh filename="lid.stl" scale="-0.5 0.5 0.5"/></geometry></collision>
  <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="tray"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1"/></joint>
<joint name="lift" type="prismatic"><parent link="tray"/><child link="lift"/><origin xyz="0 0 0.9"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1"/></joint>
<link name="lift"/>
<joint name="turn" type="revolute"><parent link="lift"/><child link="lid"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3"/></joint>
</robot>"""


@pytest.fixture
def barista(tmp_path, monkeypatch):
    """A folder with a robot that moves a lid in and out of a cup."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "robot.urdf").write_text(URDF)
    cup().export(tmp_path / "cup.stl")
    trimesh.creation.annulus(0.2, 0.4, 0.1, sections=12).export(tmp_path / "lid.stl")
    return tmp_path / "robot.urdf"


@pytest.mark.verify
def test_meshes_of_a_robot(barista):
    """Hulls, pieces and surfaces on request; the kept ones are not mistaken for one another."""
    boxes = [trimesh.creation.box((0.4, 0.1, 0.1)), trimesh.creation.box((0.1, 0.4, 0.1))]
    boxes[1].apply_translation([0.3, 0.2, 0])
    trimesh.util.concatenate(boxes).export(barista.parent / "cup.stl")
    kinds = {}
    for _ in range(2):
        for model in ("hull", "pieces", "surface"):
            robot = Robot.from_urdf(barista, meshes=model)
            found = [piece.kind for piece in robot.bodies["tray"].pieces]
            assert kinds.setdefault(model, found) == found
            assert robot.bodies["lid"].pieces[-1].kind == "sphere"
    assert (kinds["hull"], kinds["surface"]) == (["polytope"], ["solid"])
    assert kinds["pieces"] == ["polytope"] * 2
    assert len(Robot.from_urdf(barista).bodies["tray"].pieces) == 1
    assert len(Robot.from_urdf(barista, decompose=True).bodies["tray"].pieces) == len(kinds["pieces"])


def test_one_model_is_asked_for(barista):
    """A word that is no model, and two models at once, are refused."""
    with pytest.raises(loewner.UnknownNameError, match="meshes: expected one of hull, pieces, surface, auto"):
        Robot.from_urdf(barista, meshes="mesh")
    with pytest.raises(InputError, match="decompose: expected False with meshes='surface'"):
        Robot.from_urdf(barista, meshes="surface", decompose=True)


def test_models_are_those_of_the_command_line():
    """One list of models everywhere; only links have "auto"."""
    assert set(link_bodies.MODELS) == {*cli.inputs.MODELS, "auto"}


@pytest.fixture
def checker(barista):
    """The robot of surfaces among surfaces, one of which it carries."""
    scene = Scene()
    scene.add("ring", Body.from_surface(trimesh.creation.torus(0.8, 0.1, 16, 8)), translation(0.3, 0, 1.1))
    scene.add("sheet", Body.from_surface(sheet(), radius=0.01), translation(0, 0.5, 1.4))
    scene.add("shell", Body.from_surface(hollow(), scale=3.0))
    scene.add("spoon", Body.from_surface(trimesh.creation.capsule(height=0.2, radius=0.02)))
    scene.attach("spoon", "lid", translation(0, 0, 0.1), touch_links=["lid"])
    scene.set_margin(0.02, "ring")
    return CollisionChecker(Robot.from_urdf(barista, meshes="surface"), scene)


@pytest.mark.parametrize("count", quick(100, 300))
def test_a_checker_of_surfaces_is_its_pairs(checker, count):
    """Verdicts, pairs and distances are those of the queries, pair by pair."""
    Q = checker.robot.random_configurations(count, 1)
    found = agrees(checker, Q)
    assert count / 15 < found.sum() < count * 14 / 15
    by_pair = checker.collide_by_pair(Q)
    np.testing.assert_array_equal(by_pair.any(axis=1), found)
    for q, hits in zip(Q[:20], by_pair[:20], strict=True):
        named = {frozenset((c.name_a, c.name_b)) for c in checker.pairs(q)}
        assert named == {frozenset(p) for p, hit in zip(checker.checked_pairs, hits, strict=True) if hit}
    apart = Q[~found][:10]
    for q, nearest in zip(apart, checker.distance(apart, exact=True).distance, strict=True):
        assert checker.distance(q, exact=True).distance == pytest.approx(nearest)
        assert nearest > 0


def test_a_lid_within_a_cup(barista):
    """Between walls that the hull of the cup would hold, the lid is free, and a motion through a wall is not."""
    surface, hull = (CollisionChecker(Robot.from_urdf(barista, meshes=m)) for m in ("surface", "hull"))
    Q = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, -0.75, 0.0]])
    assert surface.collide(Q).tolist() == [False, False, True]
    assert hull.collide(Q).tolist() == [True, False, True]
    assert surface.valid_edges(Q[0], Q[1], 0.01)
    assert not surface.valid_edges(Q[1], Q[2], 0.01)


@pytest.fixture(scope="module")
def panda():
    try:
        folder = robots_folder()
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    urdf = folder / "panda_description/urdf/panda.urdf"
    srdf = folder / "panda_description/srdf/panda.srdf"
    return Robot.from_urdf(urdf, srdf=srdf, package_dirs=[folder.parents[1]], meshes="surface")


def shelf() -> Scene:
    """A shelf open to the front, as one mesh, and a cup on it."""
    boards = [trimesh.creation.box((0.4, 0.8, 0.02)).apply_translation([0.6, 0, z]) for z in (0.2, 0.6, 1.0)]
    boards.append(trimesh.creation.box((0.02, 0.8, 0.82)).apply_translation([0.8, 0, 0.6]))
    scene = Scene()
    scene.add("shelf", Body.from_surface(trimesh.util.concatenate(boards)))
    scene.add("cup", Body.from_surface(cup(), scale=0.1), translation(0.55, 0, 0.63))
    return scene


def test_panda_of_surfaces(panda):
    """A real arm: what the checker says is what the queries say; its hulls collide wherever its surfaces do."""
    kinds = {link: [piece.kind for piece in body.pieces] for link, body in panda.bodies.items()}
    assert all(kinds[f"panda_link{k}"] == ["solid"] for k in range(8))
    checker = CollisionChecker(panda, shelf())
    Q = panda.random_configurations(60, 2)
    found = agrees(checker, Q)
    assert 5 < found.sum() < 60
    hulls = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    assert (CollisionChecker(hulls, shelf()).collide(Q) >= found).all()


# -- motions -----------------------------------------------------------------------------------


@pytest.mark.parametrize("within", [True, pytest.param(False, marks=pytest.mark.verify)])
@pytest.mark.parametrize("count", quick(12, 60))
def test_motions_of_surfaces_are_true(checker, within, count):
    """Nothing called FREE collides at a sample, what is called COLLIDING does, and little else is left."""
    if not within:
        checker.scene.remove("shell")
        checker.scene.remove("ring")
    rng = np.random.default_rng(3)
    Q = checker.robot.random_configurations(20 * count, 4)
    Q = Q[~checker.collide(Q)][:count]
    end = Q + rng.normal(size=Q.shape) * 0.1
    verdicts = assert_true(checker, Q, end, samples=500)
    assert (verdicts == FREE).sum() > min(3, count // 6)
    assert (verdicts != AMBIGUOUS).mean() > 0.95


def test_motions_of_panda_with_surfaces(panda):
    """A real arm at a shelf: proofs hold at samples, and there are some."""
    checker = CollisionChecker(panda, shelf())
    rng = np.random.default_rng(5)
    Q = panda.random_configurations(300, 6)
    Q = Q[~checker.collide(Q)][:25]
    verdicts = assert_true(checker, Q, Q + rng.normal(size=Q.shape) * 0.05, samples=300)
    assert (verdicts == FREE).sum() > 10


def test_motions_in_a_cavity(tmp_path):
    """They are proven, whichever of the two moves, and those that collide are found."""
    slide = '<axis xyz="1 0 0"/><limit lower="-3" upper="3"/>'
    box, shell = Body.from_surface(trimesh.creation.box((0.2,) * 3)), Body.from_surface(hollow())
    for link, standing in ((box, shell), (shell, box)):
        robot = robot_of(tmp_path, [("prismatic", 0, slide)], {"l1": link})
        scene = Scene()
        scene.add("body", standing)
        checker = CollisionChecker(robot, scene)
        for tolerance in (1e-3, 1e-6):
            found = checker.certify_edges(
                [[-0.5], [0.0], [2.0], [1.5]], [[0.5], [1.2], [2.5], [0.0]], tolerance=tolerance
            )
            assert found.verdict.tolist() == [FREE, COLLIDING, FREE, COLLIDING]
            assert set(found.names[1]) == {"l1", "body"}


def test_plans_around_a_cup(tmp_path):
    """A planner finds a way past the cup whose motions are proven, and one into it if motions are looked at."""
    slides = [("prismatic", k, f'<axis xyz="{axis}"/><limit lower="-2" upper="2"/>') for k, axis in
              enumerate(("1 0 0", "0 1 0", "0 0 1"))]  # fmt: skip
    robot = robot_of(tmp_path, slides, {"l3": Body.from_surface(trimesh.creation.icosphere(radius=0.1))})
    scene = Scene()
    scene.add("cup", Body.from_surface(cup()))
    checker = CollisionChecker(robot, scene)
    past = planners.plan(checker, [-1.0, 0.0, 0.5], [1.0, 0.0, 0.5], seed=1, timeout=20)
    assert (checker.certify_edges(past[:-1], past[1:], tolerance=1e-5).verdict == FREE).all()
    into = planners.plan(checker, [-1.0, 0.0, 0.5], [0.0, 0.0, 0.5], seed=1, certified=False, resolution=0.02)
    assert checker.valid_edges(into[:-1], into[1:], 0.02).all()
    started = time.process_time()
    with pytest.raises(loewner.PlanningError):
        planners.plan(checker, [-1.0, 0.0, 0.5], [0.0, 0.0, 0.1], seed=1, timeout=2)
    assert time.process_time() - started < 20


# -- scene files -------------------------------------------------------------------------------


def test_surfaces_in_scene_files(tmp_path):
    """`model: surface` with its radius and `solid`; saved and read again, the verdicts are the same."""
    cup().export(tmp_path / "cup.stl")
    (tmp_path / "scene.yaml").write_text(
        """bodies:
  cup: {mesh: cup.stl, model: surface}
  skin: {mesh: cup.stl, model: surface, solid: false, radius: 0.01, scale: 0.5, position: [2, 0, 0]}
  twin: {mesh: cup.stl, model: surface, position: [0, 4, 0]}
  hull: {mesh: cup.stl, model: hull, position: [4, 0, 0]}
"""
    )
    scene = load_scene(tmp_path / "scene.yaml")
    assert [scene[name].pieces[0].kind for name in scene] == ["solid", "surface", "solid", "polytope"]
    assert scene["cup"] is scene["twin"]
    assert scene["skin"]._packed.frames[0, 0] == 0.01
    save_scene(scene, tmp_path / "again.yaml")
    again = load_scene(tmp_path / "again.yaml")
    ball = Body.sphere(0.05)
    for T in random_poses(np.random.default_rng(7), 40, 2.0):
        for name in scene:
            expected = collide(scene[name], scene.pose(name), ball, T)
            assert collide(again[name], again.pose(name), ball, T) == expected
    assert again["skin"].pieces[0].kind == "surface"


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("model: mesh", "expected one of hull, pieces, surface, found 'mesh'"),
        ("model: surface, decompose: true", "expected either model or decompose"),
        ("radius: 0.1", "expected radius only with model: surface"),
        ("model: hull, solid: true", "expected solid only with model: surface"),
        ("model: surface, radius: -1", "expected"),
        ("model: surface, radius: .nan", "expected"),
        ("model: surface, solid: maybe", "expected true or false"),
        ("model: surface, solid: true", "expected a closed mesh"),
        ("model: [surface]", "expected a name"),
    ],
)
def test_bad_surfaces_in_scene_files(entry, message, tmp_path):
    """Each fault is told with its line."""
    sheet().export(tmp_path / "sheet.stl")
    (tmp_path / "scene.yaml").write_text(f"bodies:\n  part: {{mesh: sheet.stl, {entry}}}\n")
    with pytest.raises(loewner.LoewnerError, match=f"line 2.*{message}"):
        load_scene(tmp_path / "scene.yaml")


# -- the command line --------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A working folder with a cup, a ball that fits into it, and an open sheet."""
    monkeypatch.chdir(tmp_path)
    cup().export("cup.stl")
    trimesh.creation.icosphere(radius=0.1).export("ball.stl")
    sheet().export("sheet.stl")
    return tmp_path


def test_check_answers_about_the_meshes(files, capsys):
    """Of two meshes the surfaces are compared, unless pieces or hulls are asked for; the answer says which."""
    inside = ("check", "cup.stl", "ball.stl", "--pose-b", "0 0 0.5")
    status, out, _ = run(capsys, *inside)
    assert status == 0
    assert "solid of the mesh's" in out
    for option in (["--model", "hull"], ["--hull"]):
        status, out, _ = run(capsys, *inside, *option)
        assert status == 1
        assert "solid of the mesh's" not in out
    status, out, _ = run(capsys, *inside, "--json")
    answer = json.loads(out)
    assert answer["a_exact"]
    assert answer["b_exact"]
    assert answer["a_model"].startswith("solid")
    found = distance(
        Body.from_surface("cup.stl"), None, Body.from_surface("ball.stl"), translation(0, 0, 0.5), exact=True
    )
    assert answer["distance"] == pytest.approx(found.distance)
    assert run(capsys, *inside, "--radius", "0.2")[0] == 1
    assert run(capsys, *inside, "--no-solid")[0] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--hull", "--model", "surface"], "--hull: expected no other model"),
        (["--model", "surface", "--threshold", "0.1"], "--threshold: expected it with --model pieces only"),
        (["--model", "pieces", "--radius", "0.1"], "--radius: expected it with --model surface only"),
        (["--max-pieces", "3", "--radius", "0.1"], "--max-pieces: expected it with --model pieces only"),
        (["--model", "hull", "--tolerance", "0.1"], "--tolerance: expected it with --model pieces only, found it with"),
        (["--hull", "--max-pieces", "3"], "--max-pieces: expected it with --model pieces only, found it with --mo"),
        (["--solid"], "solid: expected a closed mesh"),
        (["--radius", "-1"], "radius"),
    ],
)
def test_options_of_other_models_are_refused(files, options, message, capsys):
    """One line that says which option goes with which model."""
    status, _, err = run(capsys, "check", "sheet.stl", "ball.stl", *options)
    assert status == 2
    assert message in err
    assert err.count("\n") == 1


def test_fit_makes_surfaces(files, fits_here, capsys):
    """`loewner fit --model surface` writes them, says what they are, and `check` takes them."""
    status, out, _ = run(capsys, "fit", "cup.stl", "sheet.stl", "-o", "made", "--model", "surface")
    assert status == 0
    assert "solid of the mesh's" in out
    assert "surface of the mesh's 2 triangles" in " ".join(out.split())
    assert Body.load("made/cup.npz").pieces[0].kind == "solid"
    assert run(capsys, "check", "made/cup.npz", "ball.stl", "--pose-b", "0 0 0.5")[0] == 0
    assert run(capsys, "fit", "ball.stl", "-o", "made")[0] == 0
    assert Body.load("made/ball.npz").pieces[0].kind == "polytope"


def test_a_tolerance_of_fits_is_not_passed_over(files, capsys):
    """A surface has no fit of pieces that --tol could be about."""
    status, _, err = run(capsys, "fit", "cup.stl", "-o", "made", "--model", "surface", "--tol", "1e-6")
    assert status == 2
    assert "--tol: expected it with pieces or hulls only" in err


def test_view_takes_the_model(barista, files, capsys, monkeypatch):
    """Two meshes, or a robot, are shown as `--model` has it; as pieces, or as hulls and solids, without it."""
    pytest.importorskip("viser")
    from loewner import viewer

    shown = []

    class Page:
        url = "a page"

        def wait(self):
            """Closed at once."""

    def show(first, *others, **options):
        bodies = first.robot.bodies.values() if isinstance(first, CollisionChecker) else (first, others[1])
        shown.append({piece.kind for body in bodies for piece in body.pieces})
        return Page()

    monkeypatch.setattr(viewer, "show_pair", show)
    monkeypatch.setattr(viewer, "show_robot", show)
    ball = ("view", "ball.stl", "ball.stl", "--no-browser")
    robot = ("view", "--robot", barista, "--no-browser")
    for arguments, kinds in (
        (ball, {"polytope"}),
        ((*ball, "--model", "surface"), {"solid"}),
        ((*robot, "--model", "hull"), {"polytope", "sphere"}),
        (robot, {"polytope", "solid", "sphere"}),
        ((*robot, "--model", "surface"), {"polytope", "solid", "sphere"}),
    ):
        assert run(capsys, *arguments)[0] == 0
        assert shown.pop() == kinds


def test_robots_of_surfaces_on_the_command_line(barista, capsys):
    """`loewner robot` takes the model; its tables say which it is."""
    status, out, _ = run(capsys, "robot", "info", barista, "--model", "surface")
    assert status == 0
    assert re.search(r"solid, \d+ triangles", out)
    np.save("q.npy", np.zeros((1, 3)))
    check = ("robot", "check", barista, "--configs", "q.npy")
    assert run(capsys, *check, "--model", "surface")[0] == 0
    assert run(capsys, *check)[0] == 0
    assert run(capsys, *check, "--model", "hull")[0] == 1
    status, _, err = run(capsys, *check, "--model", "surface", "--decompose")
    assert status == 2
    assert "--decompose: expected no other model" in err


# -- pictures ----------------------------------------------------------------------------------


def test_pages_draw_surfaces():
    """Their triangles, from both sides, and outer ellipsoids; where there is no inner one, none."""
    pytest.importorskip("viser")
    from loewner import viewer
    from loewner.viewer import drawing

    skin, mug = Body.from_surface(sheet()), Body.from_surface(cup(), radius=0.01)
    vertices, triangles = drawing.pieces(skin)
    assert (len(vertices), len(triangles)) == (4, 2)
    assert len(drawing.ellipsoids(skin, "inner")[1]) == 0
    assert len(drawing.ellipsoids(skin, "outer")[1]) > 0
    assert len(drawing.ellipsoids(mug, "inner")[1]) > 0
    both = Body.union([skin, Body.sphere(1.0)])
    assert len(drawing.ellipsoids(both, "inner")[1]) == len(drawing.ellipsoids(Body.sphere(1.0), "inner")[1])
    with viewer.show_pair(skin, None, mug, translation(2.0)) as page:
        a, b = page._drawings.values()
        for shown in (a, b):
            shown.show(dict.fromkeys(drawing.LABELS, True))
            assert shown._nodes["pieces"].side == "double"
        assert a._nodes["inner"] is None
        assert b._nodes["inner"] is not None


def test_figures_draw_surfaces():
    """A figure has every triangle, and no inner ellipsoid of what has none."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    ax = plots.body(Body.from_surface(cup()), translation(1.0))
    (drawn,) = [c for c in ax.collections if isinstance(c, Poly3DCollection)]
    lines = [c for c in ax.collections if isinstance(c, Line3DCollection)]
    ax.figure.canvas.draw()
    assert len(drawn.get_facecolor()) == len(cup().faces)
    assert len(lines) == 2  # both ellipsoids of a solid
    skin = plots.body(Body.from_surface(cup(), solid=False), None)
    assert len([c for c in skin.collections if isinstance(c, Line3DCollection)]) == 1  # the outer one
    assert (
        "COLLIDING" not in plots.pair(Body.from_surface(sheet()), None, Body.sphere(0.1), translation(2.0)).get_title()
    )
    ax.figure.savefig(io.BytesIO())


# -- what has no use for them ------------------------------------------------------------------


def test_the_papers_detectors_take_polytopes_only():
    """They are told which body is none."""
    surfaces = Bodies([Body.box([1, 1, 1]), Body.from_surface(cup())])
    boxes = Bodies([Body.box([1, 1, 1])] * 2)
    for pair in ((surfaces, boxes), (boxes, surfaces)):
        with pytest.raises(InputError, match=r"bodies\[1\]: expected one convex polytope, found Body\(solid"):
            paper.Pairs.from_bodies(*pair)


def test_a_piece_joined_behind_a_surface_has_no_parts(rng):
    """Of unions, packs and scenes in which a convex piece follows a surface, classify never says FREE of contact.

    Joining packs once gave such a piece the end of the surface's parts, and no parts of its own are apart from all.
    """
    ball = Body.from_surface(trimesh.creation.icosphere(1, 0.1), solid=True)
    far = np.eye(4)
    far[0, 3] = 5.0
    both, probe = Body.union([ball, Body.box([0.1, 0.6, 0.05])]), Body.box([0.2, 0.02, 0.2])
    unions = [
        Body.union([ball.transformed(far), ball, Body.box([0.1, 0.6, 0.05])]),
        Body.union([ball.transformed(far), both]),
        Body.union([Body.sphere(0.01).transformed(far), ball, both]),
    ]
    T = random_poses(rng, 300)
    T[:, :3, 3] *= 0.2
    for body in (*unions, *Bodies([ball, both, *unions])):
        certified, hit = loewner.classify(body, None, probe, T), loewner.collide(body, None, probe, T)
        assert hit.any()
        assert not hit[certified == Verdict.FREE].any()
        assert hit[certified == Verdict.COLLIDING].all()
    scene = Scene()
    scene.add("ball", ball, far)
    scene.add("both", both)
    arm = Robot.from_urdf(
        text="""<robot name="r"><link name="a"/>
        <link name="b"><collision><geometry><box size="0.2 0.02 0.2"/></geometry></collision></link>
        <joint name="j" type="continuous"><parent link="a"/><child link="b"/>
        <origin xyz="-0.05 0.3 0"/><axis xyz="0 0 1"/></joint></robot>"""
    )
    checker, Q = CollisionChecker(arm, scene), np.linspace(-3, 3, 100)[:, None]
    assert checker.collide(Q).any()
    assert not checker.collide(Q)[checker.classify(Q) == Verdict.FREE].any()
