"""What the meshes of links become with ``meshes="auto"``: hulls, solids, and what is told of them."""

import logging
import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import links
import loewner
from families import translation
from loewner import Body, CollisionChecker, InputError, Robot, cli
from loewner.meshes.protrusion import Solid
from loewner.robots.description.link_meshes import hull_or_solid

LINK = '<collision><origin xyz="{}"/><geometry><mesh filename="{}.stl"/></geometry></collision>'
URDF = """<robot name="r"><link name="a">{}</link><link name="b">{}</link>
<joint name="j" type="prismatic"><parent link="a"/><child link="m"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint><link name="m"/>
<joint name="k" type="continuous"><parent link="m"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""


def choice(mesh: trimesh.Trimesh) -> str:
    """What a mesh becomes."""
    return hull_or_solid(np.array(mesh.vertices), np.array(mesh.faces))[0]


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Several meshes as one."""
    return trimesh.util.concatenate(meshes)


def box(size=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0), *, inverted: bool = False) -> trimesh.Trimesh:
    """A box at a place, or its surface turned inside out."""
    made = trimesh.creation.box(size)
    made.apply_translation(at)
    if inverted:
        made.invert()
    return made


def grooved(length: float, depth: float) -> trimesh.Trimesh:
    """A bar of square section, with a wide groove: its hull sticks out by nearly the depth."""
    half = length / 2
    outline = np.array([(-half, 0), (half, 0), (half, half), (0, half - depth), (-half, half)])
    corners = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (0, half)])
    caps = np.array([(3, 0, 4), (3, 1, 0), (3, 2, 1)])
    sides = np.array([[((k + 1) % 5, k, k + 5), ((k + 1) % 5, k + 5, (k + 1) % 5 + 5)] for k in range(5)])
    return trimesh.Trimesh(corners, np.concatenate([caps[:, ::-1], caps + 5, sides.reshape(-1, 3)]), process=False)


def bucket(sides: int = 1) -> trimesh.Trimesh:
    """A box without a lid, of triangles with one side or two."""
    made = box()
    made.update_faces(made.face_normals[:, 2] < 0.5)
    if sides == 2:
        other = made.copy()
        other.invert()
        made = joined(made, other)
    return made


def tube(rings: int) -> trimesh.Trimesh:
    """A tube that is open at both ends."""
    made = trimesh.creation.cylinder(0.2, 1.0, sections=12).subdivide_loop(0)
    for _ in range(rings):
        made = made.subdivide()
    made.update_faces(np.abs(made.face_normals[:, 2]) < 0.5)
    return made


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box(), "hull"),
        (box(inverted=True), "hull"),
        (joined(box(), box(at=(3, 0, 0))), "solid"),
        (joined(box((2, 2, 2)), box(inverted=True)), "solid"),
        (bucket(), "open"),
        (bucket(2), "open"),
        (joined(box(at=(3, 0, 0)), bucket(2)), "open"),
        (joined(box(), box((0.2, 0.2, 0.0), (0, 0, 2))), "solid"),
        (grooved(0.08, 0.9e-3), "hull"),
        (grooved(0.08, 1.1e-3), "solid"),
        (grooved(1.0, 11.5e-3), "hull"),
        (grooved(1.0, 13e-3), "solid"),
    ],
)
def test_what_meshes_become(mesh, expected):
    """Hulls stick out by 1 mm or 1 % of the diameter at most; a sheet with two sides has no inside, unless it is flat.

    The diameter of the bar of 1 m is 1.22 m.
    """
    assert choice(mesh) == expected


@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(1, 8))
@settings(max_examples=25)
def test_holes_are_closed(seed, flipped, count):
    """In spite of holes or flipped triangles, points deep in a torus are in the solid, and points outside are not."""
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.torus(1.0, 0.4, 20, 12)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    corners, faces = mesh.vertices @ turn.T, np.array(mesh.faces)
    chosen = rng.choice(len(faces), count, replace=False)
    broken = np.delete(faces, chosen, axis=0)
    if flipped:
        broken = np.concatenate([broken, faces[chosen][:, ::-1]])
    kind, (vertices, triangles), edges = hull_or_solid(corners, broken)
    assert (kind, edges > 0) == ("solid", True)
    kept = {tuple(sorted(map(tuple, triangle))) for triangle in vertices[triangles].tolist()}
    assert all(tuple(sorted(map(tuple, triangle))) in kept for triangle in corners[broken].tolist())
    points = rng.uniform(-1.5, 1.5, (400, 3))
    from_circle = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1.0, points[:, 2])
    clear = np.abs(from_circle - 0.4) > 0.15  # flat triangles, and caps of neighbouring holes, are within it
    winding = Solid(vertices[triangles], closed=True).winding_numbers(points @ turn.T)
    np.testing.assert_array_equal((winding != 0)[clear], (from_circle < 0.4)[clear])


def test_a_tube_is_closed_at_its_ends():
    """Each end by its own disc: the solid is the cylinder, whose hull is near, and a robot says nothing of it."""
    kind, (vertices, triangles), edges = hull_or_solid(np.array(tube(2).vertices), np.array(tube(2).faces))
    assert (kind, edges) == ("hull", 96)
    whole = trimesh.Trimesh(vertices, triangles)
    assert whole.volume == pytest.approx(trimesh.creation.cylinder(0.2, 1.0, sections=12).volume)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder for a robot's meshes and the fits."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path


def read(a: str, b: str = "", **options) -> tuple[Robot, list[str]]:
    """A robot of two links, and the warnings of reading it."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        robot = Robot.from_urdf(text=URDF.format(a, b), meshes="auto", **options)
    return robot, [str(one.message) for one in told]


def test_each_mesh_of_a_link_decides(folder, caplog):
    """A link may be hulls and solids at once; words, warning and log are the same when the fits are kept."""
    cracked = trimesh.creation.torus(1.0, 0.4, 24, 12)
    cracked.update_faces(np.arange(len(cracked.faces)) > 0)
    for name, mesh in {"box": box(), "l": grooved(1.0, 0.2), "torus": cracked, "bucket": bucket()}.items():
        mesh.export(f"{name}.stl")
    link = "".join(LINK.format(f"{k * 3} 0 0", name) for k, name in enumerate(("box", "l", "torus")))
    sphere = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    caplog.set_level(logging.INFO, "loewner")
    for _ in range(2):
        caplog.clear()
        robot, told = read(link, LINK.format("0 0 0", "bucket") + sphere)
        assert robot.shapes["a"] == (
            "hull, sticks out by up to 0 mm",
            "solid, 16 triangles",
            "solid of a nearly closed mesh, 578 triangles",
        )
        assert robot.shapes["b"] == ("hull of an open mesh", "sphere")
        assert [piece.kind for piece in robot.bodies["a"].pieces] == ["polytope", "solid", "solid"]
        assert len(told) == 1
        for words in (
            "1 nearly closed, whose holes were closed (torus.stl of 'a')",
            "1 open, whose hulls were taken (bucket.stl of 'b')",
        ):
            assert words in told[0]
        assert "link 'b': hull of an open mesh; sphere" in caplog.text
        assert repr(robot).endswith("meshes: hull 1, solid 1, solid of a nearly closed mesh 1, hull of an open mesh 1)")
    assert np.isnan(robot.bodies["b"].covering.max_protrusion)
    both = Robot.join({"one": robot, "two": robot}, {"two": translation(0, 9, 0)})
    assert both.shapes["two/b"] == pickle.loads(pickle.dumps(robot)).shapes["b"] == robot.shapes["b"]
    assert Robot.from_urdf(text=URDF.format(link, ""), meshes="hull").shapes["a"][1] != robot.shapes["a"][1]
    with pytest.raises(loewner.UnknownNameError, match="link with shapes of a URDF"):
        robot.shapes["c"]


def test_a_kept_solid_is_the_same(folder):
    """The body that is read from the cache is the one that was made, and not the one of another representation."""
    grooved(1.0, 0.2).export("l.stl")
    made = [read(LINK.format("0 0 0", "l"), cache=cache)[0].bodies["a"] for cache in (False, True, True)]
    assert len({pickle.dumps(body) for body in made}) == 1
    text = URDF.format(LINK.format("0 0 0", "l"), "")
    kinds = [
        Robot.from_urdf(text=text, meshes=model).bodies["a"].pieces[0].kind for model in ("hull", "surface", "auto")
    ]
    assert kinds == ["polytope", "solid", "solid"]


def test_overlapping_parts_have_no_hollow(folder):
    """One of two overlapping boxes is inside out: their surface winds about the overlap not at all, the link does."""
    joined(box(), box(at=(0.5, 0.5, 0.5), inverted=True)).export("two.stl")
    crumb = Body.sphere(0.05)
    at = translation(0.25, 0.25, 0.25)
    link = LINK.format("0 0 0", "two")
    assert loewner.collide(read(link)[0].bodies["a"], None, crumb, at)
    assert not loewner.collide(
        Robot.from_urdf(text=URDF.format(link, ""), meshes="surface").bodies["a"], None, crumb, at
    )


def test_bad_meshes_and_models(folder):
    """A flat mesh is refused as it is with hulls; surfaces are not split; a word that is no model is refused."""
    box((1, 1, 0)).export("flat.stl")
    texts = []
    for model in ("hull", "auto"):
        with pytest.raises(loewner.GeometryError, match=r"link 'a': .*flat.stl") as error:
            Robot.from_urdf(text=URDF.format(LINK.format("0 0 0", "flat"), ""), meshes=model)
        texts.append(str(error.value).replace("mesh: ", ""))
    assert texts[0] == texts[1]
    with pytest.raises(InputError, match="decompose: expected False with meshes='surface', found True"):
        Robot.from_urdf(text=URDF.format("", ""), meshes="surface", decompose=True)
    with pytest.raises(loewner.UnknownNameError, match="meshes: expected one of hull, pieces, surface, auto"):
        Robot.from_urdf(text=URDF.format("", ""), meshes="automatic")


def test_hulls_that_always_collide_are_told(folder, capsys):
    """A rod in a ring never leaves its hull: the checker and `loewner robot info` say which hulls; solids are free."""
    trimesh.creation.annulus(0.8, 1.0, 4.0, sections=16).export("ring.stl")
    box((0.2, 0.2, 0.2)).export("rod.stl")
    text = URDF.format(LINK.format("0 0 0", "ring"), LINK.format("0 0 0", "rod"))
    (folder / "r.urdf").write_text(text)
    checker = CollisionChecker(Robot.from_urdf("r.urdf", meshes="hull"))
    with pytest.warns(
        UserWarning, match=r"\('a': hull, sticks out by up to \d+ mm\) \('b': hull, sticks out by up to 0 "
    ):
        assert checker.collide(checker.robot.random_configurations(100)).all()
    note = "note: a and b collide in each of 64 random configurations"
    for model, words in (("hull", "hull, sticks out by up to"), ("auto", "solid, 128 triangles")):
        assert cli.main(["robot", "info", "r.urdf", "--model", model]) == 0
        out = capsys.readouterr().out
        assert words in out
        assert (note in out) == (model == "hull")
    assert (
        not CollisionChecker(Robot.from_urdf("r.urdf", meshes="auto"))
        .collide(checker.robot.random_configurations(9))
        .any()
    )


@pytest.mark.verify
@pytest.mark.parametrize("name", ["talos", "pr2", "baxter"])
def test_solids_agree_with_coals_triangles(name):
    """Where triangles meet, by pinocchio and Coal, links meet, and their hulls too; solids add next to nothing."""
    files = links.robots(None)[name]
    checkers = [CollisionChecker(files.read(meshes)) for meshes in ("auto", "hull")]
    Q = checkers[0].robot.random_configurations(300, 5)
    auto, hull = (checker.collide(Q) for checker in checkers)
    coal = links.coal_answers(files, checkers[0], Q)
    assert not (coal & ~auto).any()
    assert not (auto & ~hull).any()
    assert (auto & ~coal).sum() <= 1 < (hull & ~coal).sum()
