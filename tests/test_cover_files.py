"""Models of robots in the files of planners: what is read and reported, and that written files contain the bodies."""

import json
import re
import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from families import translation
from gantry import gantry_robot
from loewner import Body, CollisionChecker, FileError, InputError, Joint, Robot, UnknownNameError, cli, plots
from loewner.bodies import packed_of
from loewner.bodies.triangulated import of_pieces
from loewner.cli.cover_tables import _interval
from loewner.robots import covers
from loewner.robots.cover_files import FORMATS, _Balls, _rounded
from sampling import quick

SUFFIX = {
    "curobo": "yml",
    "vamp": "urdf",
    "foam": "urdf",
    "pyroki": "json",
    "urdf": "urdf",
    "mjcf": "xml",
    "scene": "yaml",
}
TURN = np.array([[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0.0, -0.2], [0.48, 0.64, 0.6, 0.3], [0, 0, 0, 1]])


@pytest.fixture
def robot(tmp_path):
    """A ball that slides and carries a rod that turns."""
    return gantry_robot(tmp_path)


@pytest.fixture
def model(robot, tmp_path):
    """The same robot with spheres of numbers that float32 does not have."""
    return robot.with_cover(written(tmp_path / "model.json", PYROKI))


PYROKI = """{"ball": {"centers": [[0, 0, 0.01]], "radii": [0.125]},
"rod": {"centers": [[0.2, 0, 0], [0.3, 0.001, 0], [0.4, 0, 0]], "radii": [0.07, 0.06, 0.07]}}"""
CUROBO = """
robot_cfg:
  kinematics:
    urdf_path: gantry.urdf
    base_link: base
    collision_link_names: [ball, rod]
    collision_sphere_buffer: 0.005
    collision_spheres:
      ball:
        - {center: [0, 0, 0.5], radius: 0.125}
        - {center: [0, 0, 0], radius: 0.1}
      rod:
        - "center": [0.25, 0.0, 0.0]
          "radius": 0.0625
    self_collision_ignore: {rod: [ball]}
    self_collision_buffer: {rod: 0.0}
"""


def written(path, text):
    """Write a file and return its path."""
    path.write_text(text)
    return path


def spheres(body):
    """Centers and radii of a body of spheres."""
    packed = packed_of(body)
    return packed.frames[:, 1:4], packed.frames[:, 0]


def holds(outer, inner):
    """Whether each ball contains the ball of the same number, in exact arithmetic."""
    for c, r, d, s in zip(*outer, *inner, strict=True):
        gap = Fraction(float(r)) - Fraction(float(s))
        squared = sum((Fraction(float(a)) - Fraction(float(b))) ** 2 for a, b in zip(c, d, strict=True))
        if gap < 0 or gap * gap < squared:
            return False
    return True


# -- writing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", FORMATS)
def test_written_spheres_contain_the_given_ones(model, tmp_path, format):
    """Each ball that is read back, by a reader in float32 too, contains the ball that was written."""
    given = model
    path = tmp_path / f"written.{SUFFIX[format]}"
    given.save_cover(path, format)
    back = given.with_cover(path, format)
    assert list(back.bodies) == list(given.bodies)
    for link, body in given.bodies.items():
        assert holds(spheres(back.bodies[link]), spheres(body))
    again = given.with_cover(path)
    assert {link: len(body.pieces) for link, body in again.bodies.items()} == {"ball": 1, "rod": 3}


@pytest.mark.parametrize("format", FORMATS)
def test_exempt_pairs_survive(robot, model, tmp_path, format):
    """The pairs that a checker leaves out are the same after reading, and a robot without rules keeps checking all."""
    path = tmp_path / f"written.{SUFFIX[format]}"
    model.save_cover(path, format)
    back = robot.with_cover(path, format)
    assert CollisionChecker(back).checked_pairs == CollisionChecker(model).checked_pairs == ()
    if format == "mjcf":  # MuJoCo never checks a body with the next one of the tree
        return
    checked = Robot.from_links(
        {"base": None, "ball": robot.bodies["ball"], "rod": robot.bodies["rod"]}, joints(), disabled=[]
    )
    checked = checked.with_cover(tmp_path / "model.json")
    checked.save_cover(path, format)
    assert CollisionChecker(checked.with_cover(path, format)).checked_pairs == (("ball", "rod"),)


def joints():
    """Joints of a ball that slides and of a rod that turns on it."""
    return [
        Joint("x", "prismatic", "base", "ball", axis=[1, 0, 0], lower=-1, upper=1),
        Joint("turn", "continuous", "ball", "rod"),
    ]


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.floats(1e-9, 1e3),
)
def test_rounding_to_float32_is_outwards(center, radius):
    """A rounded ball contains the given one in fractions, is in float32, and is rounded to itself."""
    balls = _Balls(np.array([center]), np.array([radius]))
    made = _rounded(balls)
    assert holds(made, balls)
    for values, again in zip(made, _rounded(made), strict=True):
        assert (np.float32(values).astype(float) == values).all()
        assert (values == again).all()
    assert made.radii[0] <= radius + 2e-7 * (np.linalg.norm(center) + radius) + 1e-12


def test_a_radius_beyond_float32_is_refused():
    """A radius that float32 has not is an error, not infinity."""
    with pytest.raises(InputError, match="float32"):
        _rounded(_Balls(np.zeros((1, 3)), np.array([1e39])))


@pytest.mark.parametrize("format", ["urdf", "mjcf", "scene"])
@pytest.mark.parametrize(
    "shape",
    [
        Body.capsule(0.1, 0.4),
        Body.box([0.1, 0.2, 0.3]),
        Body.cylinder(0.1, 0.3),
        Body.union([Body.sphere(0.1), Body.box([0.3, 0.1, 0.1])]),
    ],
    ids=["capsule", "box", "cylinder", "union"],
)
@pytest.mark.parametrize("count", quick(150, 500))
def test_written_shapes_contain_the_given_ones(tmp_path, format, shape, count):
    """Points of a shape in a turned pose are within the pieces that are read back, up to no rounding at all."""
    body = shape.transformed(TURN)
    robot = Robot.from_links({"base": None, "ball": body, "rod": Body.sphere(0.1)}, joints(), name="gantry")
    path = tmp_path / f"written.{SUFFIX[format]}"
    robot.save_cover(path, format)
    back = robot.with_cover(path, format).bodies["ball"]
    rng = np.random.default_rng(1)
    for direction in rng.normal(size=(count, 3)):
        assert support(back, direction) >= support(body, direction)
        assert support(back, direction) <= support(body, direction) + 1e-8 * np.linalg.norm(direction)


def support(body, direction):
    """The largest product with a direction over a body."""
    packed, found = packed_of(body), -np.inf
    for piece, frame in zip(body.pieces, packed.frames, strict=True):
        if piece.vertices is not None:
            found = max(found, (piece.vertices @ direction).max())
            continue
        along = frame[4:].reshape(3, 3).T @ direction
        reach = {"sphere": 0.0, "capsule": abs(along[2]), "ellipsoid": np.linalg.norm(along)}.get(piece.kind)
        if piece.kind == "cylinder":
            reach = np.hypot(*along[:2]) + abs(along[2])
        found = max(found, frame[1:4] @ direction + reach + frame[0] * np.linalg.norm(direction))
    return found


@pytest.mark.parametrize("format", ["curobo", "vamp", "foam", "pyroki"])
def test_formats_of_spheres_refuse_other_shapes(robot, tmp_path, format):
    """A rod that is a box is refused by the name of its link, and nothing is written."""
    path = tmp_path / f"refused.{SUFFIX[format]}"
    with pytest.raises(InputError, match=f"link 'rod': expected spheres only, which is all that {format} has"):
        robot.save_cover(path, format)
    assert not path.exists()


def test_mjcf_moves_as_the_robot(robot, model, tmp_path):
    """MuJoCo's model of a cover has the joints and the poses of the links."""
    pytest.importorskip("mujoco")
    model.save_cover(tmp_path / "written.xml")
    back = Robot.from_mjcf(tmp_path / "written.xml")
    assert back.configuration_names == robot.configuration_names
    Q = robot.random_configurations(20)
    places = [back.link_names.index(link) for link in robot.link_names]
    np.testing.assert_allclose(back.forward_kinematics(Q)[:, places], robot.forward_kinematics(Q), atol=1e-12)


@pytest.mark.parametrize("bodies", [{"world": Body.sphere(0.1), "arm": Body.sphere(0.1)}, {"arm": Body.sphere(0.1)}])
@pytest.mark.parametrize("root", ["world", "arm"])
def test_a_link_called_world_in_mjcf(bodies, root, tmp_path):
    """As a root without shapes it is MuJoCo's world; otherwise MuJoCo would refuse the file, so none is written."""
    pytest.importorskip("mujoco")
    other = {"world": "arm", "arm": "world"}[root]
    links = {name: bodies.get(name) for name in (root, other)}
    robot = Robot.from_links(links, [Joint("turn", "continuous", root, other)], name="r")
    path = tmp_path / "r.xml"
    if root == "world" and "world" not in bodies:
        robot.save_cover(path)
        assert set(robot.with_cover(path).bodies) == {"arm"}
        return
    found = "with shapes" if root == "world" else "below the joint 'turn'"
    with pytest.raises(InputError, match=f"expected a link 'world' only as a root without shapes, found one {found}"):
        robot.save_cover(path)
    assert not path.exists()


def test_warnings_about_mjcf_are_passed_on(robot, model, tmp_path):
    """What MuJoCo computes with and is not read is named; files that were written here have none of it."""
    pytest.importorskip("mujoco")
    path = tmp_path / "m.xml"
    model.save_cover(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot.with_cover(path)
    text = path.read_text()
    assert "<equality />" in text
    path.write_text(text.replace("<equality />", '<equality><weld body1="rod"/></equality>'))
    with pytest.warns(UserWarning, match="not read, although MuJoCo computes with it: 1 constraints"):
        robot.with_cover(path)


# -- reading --------------------------------------------------------------------------------------


def test_curobo_configuration(robot, tmp_path):
    """Buffers are added to radii, numbers are in float32, and ignored pairs replace the robot's own."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = robot.with_cover(written(tmp_path / "c.yml", CUROBO))
    centers, radii = spheres(found.bodies["ball"])
    np.testing.assert_array_equal(centers, [[0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_array_equal(radii, np.float32([0.13, 0.105]).astype(float))
    assert found.disabled_pairs == {("ball", "rod")}


def test_buffer_by_link(robot, tmp_path):
    """A mapping of buffers grows the spheres of the links that it names only."""
    text = CUROBO.replace("buffer: 0.005", "buffer: {rod: 0.25}", 1)
    found = robot.with_cover(written(tmp_path / "c.yml", text))
    assert spheres(found.bodies["ball"])[1].tolist() == [0.125, float(np.float32(0.1))]
    assert spheres(found.bodies["rod"])[1].tolist() == [0.3125]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("radius: 0.1}", "radius: -0.01}", "1 disabled spheres .* of 'ball'"),
        ("[ball, rod]", "[rod]", "spheres of 'ball', which is not among collision_link_names; .* no shapes: ball"),
        ("{rod: 0.0}", "{rod: 0.02}", "self_collision_buffer"),
        ("base_link: base", "speed: 3", "keys that are not read: speed"),
        ("base_link: base", "extra_collision_spheres: {ball: 4}", "'ball' that extra_collision_spheres replaces"),
        ("base_link: base", "load_collision_spheres: false", "load_collision_spheres"),
        ("{rod: [ball]}", "{rod: [ball, forarm]}", "ignored pairs of links that the robot does not have: forarm"),
        ("      rod:", "      base:\n        - {center: [0, 0, 0], radius: 1}\n      rod:", "not among"),
    ],
)
def test_whatever_is_not_used_is_reported(robot, tmp_path, old, new, told):
    """Disabled spheres, spheres that cuRobo does not use and unknown keys cause a warning that names them."""
    with pytest.warns(UserWarning, match=told):
        robot.with_cover(written(tmp_path / "c.yml", CUROBO.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("old", "new", "error", "found"),
    [
        ("ball:\n", "bell:\n", UnknownNameError, r"link: expected one of .*found 'bell' \(did you mean 'ball'"),
        ("radius: 0.1}", "radius: .nan}", FileError, "line 11.*radius: expected a finite number"),
        ("radius: 0.1}", "radius: 0.1, radius: 2}", FileError, "each key once"),
        ("radius: 0.1}", "radius: 0.1, colour: 2}", FileError, "expected keys among center, radius"),
        ("radius: 0.1}", "diameter: 0.1}", FileError, "expected keys among center, radius, found 'diameter'"),
        ("[0, 0, 0]", "[0, 0]", FileError, "sequence of 3"),
        ("      rod:", "      ball:", FileError, "found 'ball' again"),
        ("collision_spheres:", "spheres:", FileError, "expected the key collision_spheres"),
    ],
)
def test_faults_of_curobo_files_have_places(robot, tmp_path, old, new, error, found):
    """Unknown links, numbers that are none, keys that occur twice and missing keys are errors with their place."""
    text = CUROBO.replace("[ball, rod]", "null").replace(old, new, 1)
    with pytest.raises(error, match=found):
        robot.with_cover(written(tmp_path / "c.yml", text))


def test_a_file_without_spheres_is_refused(robot, tmp_path):
    """A file whose spheres are all disabled is no model."""
    with pytest.raises(FileError, match="expected shapes of links, found none: 1 disabled"):
        robot.with_cover(written(tmp_path / "c.yml", "collision_spheres: {ball: [{center: [0, 0, 0], radius: -1}]}"))


def test_spheres_in_a_file_of_their_own(robot, tmp_path):
    """cuRobo's older configurations name a file of spheres, and Lula lists links."""
    (tmp_path / "spheres").mkdir()
    written(
        tmp_path / "spheres" / "s.yml",
        "collision_spheres:\n- ball: [{center: [0, 0, 0], radius: 0.5}]\n- rod: [{center: [0, 0, 0], radius: 1}]\n",
    )
    found = robot.with_cover(written(tmp_path / "c.yml", "robot_cfg: {kinematics: {collision_spheres: spheres/s.yml}}"))
    assert spheres(found.bodies["ball"])[1].tolist() == [0.5]
    assert found.disabled_pairs == robot.disabled_pairs  # the file has no rules


def test_xrdf(robot, tmp_path):
    """An XRDF's geometry of checks with the world, its distances and its ignored pairs are read."""
    text = """
format: xrdf
format_version: 1.0
modifiers: [{set_base_frame: base}]
collision: {geometry: a, buffer_distance: {ball: 0.5}}
self_collision: {geometry: b, ignore: {ball: [rod]}}
geometry:
  a: {spheres: {ball: [{center: [0, 0, 0], radius: 0.5}], rod: [{center: [0, 0, 0], radius: 1}]}}
"""
    with pytest.warns(UserWarning, match="found: another geometry for checks of links with each other$"):
        found = robot.with_cover(written(tmp_path / "c.xrdf", text))
    assert [spheres(found.bodies[link])[1].tolist() for link in ("ball", "rod")] == [[1.0], [1.0]]
    assert found.disabled_pairs == {("ball", "rod")}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"ball": {"centers": [[0, 0, 0]], "radii": []}}', "as many radii as centers, found 0 and 1"),
        ('{"ball": {"centers": [[0, 0, 0]]}}', "expected the key radii"),
        ('{"ball": {"centers": [[0, 0, 0]], "radii": ["1"]}}', "expected a number"),
        ('{"ball": {"centers": [[0, 0, NaN]], "radii": [1]}}', "expected a finite number"),
        ('{"ball": 1}', "expected a mapping"),
        ("[1]", "expected a mapping"),
    ],
)
def test_faults_of_pyroki_files(robot, tmp_path, text, found):
    """Lists of different lengths, which pyroki would cut, and other faults are errors."""
    with pytest.raises(FileError, match=found):
        robot.with_cover(written(tmp_path / "p.json", text))


def test_foam_database(robot, tmp_path):
    """The finest level of each mesh is read, several meshes of a link are one body, and coarser levels are reported."""

    def level(radius, count=1):
        balls = [{"origin": [0.25 * k, 0, 0], "radius": radius} for k in range(count)]
        return {"mean": 0.1, "best": 0.0, "worst": 0.2, "spheres": balls}

    database = {
        "ball::a.stl": {"8": {"0": level(2.0), "1": level(1.0, 3)}},
        "ball::primitive1": [level(0.5)],
        "rod::b.stl": level(0.25),
    }
    with pytest.warns(UserWarning, match="1 coarser levels of 'ball::a.stl'"):
        found = robot.with_cover(written(tmp_path / "f.json", json.dumps(database)))
    assert spheres(found.bodies["ball"])[1].tolist() == [1.0, 1.0, 1.0, 0.5]
    assert spheres(found.bodies["rod"])[1].tolist() == [0.25]


def test_foam_levels_of_one_mesh_need_a_link(robot, tmp_path):
    """The spheres of one mesh alone have no link."""
    text = json.dumps({"mean": 0, "best": 0, "worst": 0, "spheres": []})
    with pytest.raises(FileError, match="by the names of links"):
        robot.with_cover(written(tmp_path / "f.json", text), "foam")


def test_bad_arguments(robot, tmp_path):
    """Unknown formats, suffixes and missing files are errors."""
    with pytest.raises(UnknownNameError, match="format: expected one of curobo, vamp"):
        robot.with_cover("a.yml", "cuRobo")
    with pytest.raises(InputError, match="for a file with the suffix '.txt'"):
        robot.save_cover(tmp_path / "a.txt")
    for name, format in (("a.yml", "vamp"), ("a.json", "foam"), ("a.xrdf", None), ("a.json", "scene")):
        with pytest.raises(FileError, match=rf"{name}: expected a \.\w+.* file for"):
            robot.save_cover(tmp_path / name, format)
    assert not list(tmp_path.glob("a.*"))
    with pytest.raises(FileError, match="no such file"):
        robot.with_cover(tmp_path / "a.yml")
    with pytest.raises(InputError, match="path"):
        robot.with_cover(3)


def test_scene_bodies_at_poses(robot, tmp_path):
    """A body of a scene is read at its pose in the link."""
    text = "bodies: {ball: {sphere: {radius: 0.5}, position: [0, 0, 1]}, rod: {sphere: {radius: 1}}}"
    found = robot.with_cover(written(tmp_path / "s.yaml", text))
    assert spheres(found.bodies["ball"])[0].tolist() == [[0, 0, 1]]


# -- covers of robots -----------------------------------------------------------------------------


@pytest.fixture
def near():
    """A cart 5 mm above its rail, which it never touches, and a flap that can turn into the rail."""
    joints = [
        Joint(
            "slide",
            "prismatic",
            "rail",
            "cart",
            T_parent_joint=translation(z=0.105),
            axis=[1, 0, 0],
            lower=-0.2,
            upper=0.2,
        ),
        Joint("turn", "revolute", "cart", "flap", T_parent_joint=translation(y=0.2), axis=[1, 0, 0], lower=-2, upper=0),
    ]
    flap = Body.box([0.1, 0.1, 0.02]).transformed(translation(y=0.1))
    links = {"rail": Body.box([0.4, 0.4, 0.1]), "cart": Body.box([0.1, 0.1, 0.1]), "flap": flap}
    return Robot.from_links(links, joints, disabled=[])


@pytest.fixture
def lumps(monkeypatch):
    """A fit without proofs that takes no time: balls around the cells of a grid, which stick out by less than half."""

    def cover(body, kind="spheres", *, n=None, protrusion=None, progress=None):
        meshes = [vertices for vertices, _ in of_pieces(packed_of(body))]
        low, high = np.concatenate(meshes).min(axis=0), np.concatenate(meshes).max(axis=0)
        counts = np.ceil((high - low) / protrusion).astype(int)
        size = (high - low) / counts
        cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
        radius = float(np.float32(np.linalg.norm(size) * 0.52))
        return Body.spheres(low + (cells + 0.5) * size, np.full(len(cells), radius))

    monkeypatch.setattr(Body, "cover", cover)


def test_covers_contain_the_links(near):
    """Each link is covered by shapes that stick out by no more than was asked, and the tree is the same."""
    cover = near.cover("boxes", protrusion=0.02)
    assert list(cover.bodies) == list(near.bodies)
    for report in near.covered_by(cover).values():
        assert report.outcome == "covered"
        assert report.excess[1] <= 0.02 * 1.02
    Q = near.random_configurations(5)
    np.testing.assert_array_equal(cover.forward_kinematics(Q), near.forward_kinematics(Q))
    with pytest.raises(UnknownNameError, match="kind: expected one of spheres, capsules, boxes, ellipsoids"):
        near.cover("cones")


def test_pairs_that_only_the_cover_makes_collide(near, lumps):
    """A pair that is proven never to collide becomes exempt; one that can collide stays checked."""
    cover = near.cover("spheres", protrusion=0.02)
    assert cover.disabled_pairs == {("cart", "rail")}
    assert {frozenset(pair) for pair in CollisionChecker(cover).checked_pairs} == {
        frozenset({"flap", "rail"}),
        frozenset({"flap", "cart"}),
    }
    shares = {pair: share for pair, share, _ in covers.new_contacts(near, cover)}
    assert ("cart", "rail") not in shares
    assert 0 < shares["flap", "rail"] < 1


def test_adjacent_pairs_stay_exempt(robot, lumps):
    """Without rules on pairs, adjacent links are exempt before and after further pairs are."""
    alone = Robot.from_urdf(robot.urdf)
    cover = alone.cover("spheres", protrusion=0.05)
    assert CollisionChecker(cover).checked_pairs == CollisionChecker(alone).checked_pairs


def test_a_pair_that_always_meets_is_reported(lumps):
    """A cover with which no configuration is free, though the links may collide, causes a warning."""
    joint = Joint(
        "turn", "revolute", "base", "arm", T_parent_joint=translation(x=0.35), axis=[0, 0, 1], lower=-1.57, upper=0.5
    )
    arm = Body.box([0.3, 0.3, 0.1])
    robot = Robot.from_links({"base": Body.box([0.3, 0.3, 0.1]), "arm": arm}, [joint], disabled=[])
    with pytest.warns(UserWarning, match="meet in all of 1000 configurations.*: arm and base"):
        cover = robot.cover("spheres", protrusion=0.3)
    assert cover.disabled_pairs == frozenset()


@pytest.mark.verify
def test_covers_of_a_number(near):
    """A cover has at most the number of shapes, and a number below that of the links is an error."""
    steps = []
    cover = near.cover("boxes", n=6, progress=lambda done, total: steps.append(done / total))
    assert 3 <= sum(len(body.pieces) for body in cover.bodies.values()) <= 6
    assert steps == sorted(steps)
    assert steps[-1] == 1.0
    with pytest.raises(InputError, match="n: expected more shapes for 3 links, found 2"):
        near.cover("boxes", n=2)
    with pytest.raises(InputError, match="n: expected none with protrusion"):
        near.cover(n=5, protrusion=0.1)


def test_a_link_without_shapes_is_uncovered(near):
    """A link that the model lacks is uncovered as a whole, at a point of it."""
    model = Robot.from_links({"rail": near.bodies["rail"]}, [])
    reports = near.covered_by(model)
    assert reports["rail"].outcome == "covered"
    assert reports["flap"].outcome == "uncovered"
    assert reports["flap"].depth == (np.inf, np.inf)
    assert abs(reports["flap"].witness - [0, 0.1, 0]).max() <= 0.05
    with pytest.raises(InputError, match="model: expected loewner.Robot"):
        near.covered_by(near.bodies)


# -- commands -------------------------------------------------------------------------------------


def run(capsys, *words):
    """Exit status, standard output and standard error of a command."""
    status = cli.main([str(word) for word in words])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize(
    "format", [one if one == "curobo" else pytest.param(one, marks=pytest.mark.verify) for one in FORMATS]
)
@pytest.mark.parametrize("protrusion", quick("0.05", "0.02"))
def test_cover_command(robot, lumps, tmp_path, monkeypatch, capsys, format, protrusion):
    """The file that the command writes is read back, proven, and has a row for each link."""
    monkeypatch.chdir(tmp_path)
    name = f"written.{SUFFIX[format]}"
    words = ("gantry.urdf", "--srdf", "gantry.srdf", "-o", name, "--for", format, "--protrusion", protrusion)
    status, out, _ = run(capsys, "cover", *words)
    assert status == 0
    assert re.search(r"rod +.? *\d+ +.? *covered", out)
    assert "2 covered of 2 links" in out
    assert run(capsys, "judge", "--model", name, "--format", format, "gantry.urdf")[0] == 0


@pytest.mark.verify  # fits of spheres
def test_cover_command_with_spheres(robot, tmp_path, monkeypatch, capsys):
    """Fitted spheres are written and proven as they are read."""
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "cover", "gantry.urdf", "-o", "s.yml", "--protrusion", "0.02", "--json")
    assert status == 0
    answer = json.loads(out)["links"]
    assert {link["outcome"] for link in answer.values()} == {"covered"}
    assert max(link["excess"][1] for link in answer.values()) <= 0.02 * 1.02


def test_judge_command(robot, tmp_path, monkeypatch, capsys):
    """An uncovered link gives the status 1, a row with its place, and a picture."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "model.json", PYROKI.replace("0.07", "0.001"))
    status, out, _ = run(capsys, "judge", "--model", "model.json", "gantry.urdf", "--picture", "holes.png")
    assert status == 1
    assert "1 uncovered of 2 links" in out
    assert (tmp_path / "holes.png").read_bytes().startswith(b"\x89PNG")
    answer = json.loads(run(capsys, "judge", "--model", "model.json", "gantry.urdf", "--json")[1])
    assert answer["links"]["ball"]["outcome"] == "covered"
    rod = answer["links"]["rod"]
    assert rod["outcome"] == "uncovered"
    assert 0.01 < rod["uncovered_share"][0] <= rod["uncovered_share"][1] < 1


def test_judge_command_of_missing_links(robot, tmp_path, monkeypatch, capsys):
    """A link without shapes has no finite depth, which JSON has as null."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "model.json", '{"ball": {"centers": [[0, 0, 0]], "radii": [0.2]}}')
    status, out, err = run(capsys, "judge", "--model", "model.json", "gantry.urdf", "--json")
    assert status == 1
    assert "links of the robot that have no shapes: rod" in err
    assert json.loads(out)["links"]["rod"]["depth"] == [None, None]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("judge", "--model", "model.json"), "expected one robot with --model, found 0 files"),
        (("judge", "--model", "model.json", "gantry.urdf", "--picture", "a.gif"), "--picture: expected a .png or .svg"),
        (("judge", "--model", "none.json", "gantry.urdf"), "no such file"),
        (("cover", "gantry.urdf", "-o", "a.txt", "--protrusion", "0.1"), "format: expected one of curobo"),
        (("cover", "gantry.urdf", "-o", "a.yml", "--kind", "boxes"), "--kind: expected spheres for curobo"),
        (("cover", "gantry.urdf", "-o", "a.yml", "--protrusion", "-1"), "protrusion"),
    ],
)
def test_bad_options(robot, model, tmp_path, monkeypatch, capsys, words, found):
    """Missing files, other pictures and shapes that a format lacks are one line and the status 2."""
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words)
    assert status == 2
    assert found in err
    assert out == ""


def test_pictures_show_what_is_outside(near):
    """The title counts the links that have parts outside."""
    pytest.importorskip("matplotlib")
    assert plots.cover(near, near).get_title() == "robot: no part of 3 links is outside"
    model = Robot.from_links({"rail": near.bodies["rail"]}, [])
    assert plots.cover(near, model).get_title() == "robot: parts of 2 of 3 links are outside"
    with pytest.raises(InputError, match="model: expected loewner.Robot"):
        plots.cover(near, 3)


def test_pinocchio_reads_the_urdf_of_vamp(model, tmp_path):
    """VAMP's generator reads the file with pinocchio: spheres only, where they are, and no pair that is exempt."""
    pin = pytest.importorskip("pinocchio")
    path = tmp_path / "spheres.urdf"
    model.save_cover(path, "vamp")
    kinematics = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(kinematics, str(path), pin.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(kinematics, geometry, str(path.with_suffix(".srdf")))
    assert len(geometry.collisionPairs) == 0
    found = sorted(
        (round(g.geometry.radius, 12), *np.round(g.placement.translation, 12)) for g in geometry.geometryObjects
    )
    given = [spheres(body) for body in model.bodies.values()]
    expected = sorted(
        (round(r, 12), *np.round(c, 12)) for centers, radii in given for c, r in zip(centers, radii, strict=True)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ((0.0, 0.0), "0 mm"),
        ((0.0099999, 0.0099999), "9.99 .. 10 mm"),
        ((0.25, 0.25), "250 mm"),
        ((0.0123401, 0.0123401), "12.3 .. 12.4 mm"),
        ((np.inf, np.inf), "inf mm"),
    ],
)
def test_bounds_are_shown_outwards(ends, text):
    """Bounds with three digits contain the bounds with all digits."""
    assert _interval(ends, 1e3, "mm") == text


def test_an_empty_list_of_ignored_pairs_is_a_rule(tmp_path):
    """The model then checks all pairs, adjacent ones as well; without the key, the robot's own rules hold."""
    robot = Robot.from_links(
        {name: Body.sphere(0.1) for name in "abc"},
        [Joint("j", "revolute", "a", "b", lower=-1, upper=1), Joint("k", "revolute", "b", "c", lower=-1, upper=1)],
    )
    spheres = "collision_spheres:\n" + "".join(f"  {x}:\n  - {{center: [0, 0, 0], radius: 0.11}}\n" for x in "abc")
    exempted = {}
    for tail in ("", "self_collision_ignore: {}\n", "self_collision_ignore: {a: [b]}\n"):
        (tmp_path / "m.yml").write_text(spheres + tail)
        exempted[tail] = sorted(covers.exempt_pairs(robot.with_cover(tmp_path / "m.yml")))
    assert list(exempted.values()) == [[("a", "b"), ("b", "c")], [], [("a", "b")]]


def test_polytopes_in_mjcf_hold_after_single_precision(tmp_path):
    """MuJoCo keeps corners as float32, so they are written farther out; a robot that checks all pairs still does."""
    body = Body.from_points(np.random.default_rng(0).normal(size=(6, 3)) * 0.2)
    robot = Robot.from_links({"a": body, "b": Body.sphere(0.1)}, [Joint("j", "revolute", "a", "b")], disabled=[])
    robot.save_cover(tmp_path / "o.xml", "mjcf")
    back = robot.with_cover(tmp_path / "o.xml")
    assert robot.covered_by(back)["a"].outcome == "covered"
    assert covers.exempt_pairs(back) == covers.exempt_pairs(robot) == frozenset()


@pytest.mark.parametrize(
    ("center", "radius"), [("[0, 0, 0]", "1.0e-60"), ("[0, 0, 0]", "1.0e39"), ("[1.0e39, 0, 0]", "1")]
)
def test_numbers_beyond_single_precision_name_file_and_link(tmp_path, center, radius):
    """cuRobo would have infinities or spheres of nothing."""
    robot = Robot.from_links({"a": Body.sphere(0.1)}, [])
    (tmp_path / "m.yml").write_text(f"collision_spheres:\n  a:\n  - {{center: {center}, radius: {radius}}}\n")
    with pytest.raises(FileError, match=r"m.yml: link 'a': expected spheres that float32 can express"):
        robot.with_cover(tmp_path / "m.yml")


def test_parts_of_a_scene_that_is_a_cover_are_told(tmp_path):
    """Margins, errors of poses and rules are not the cover's; without allowed pairs, the robot's rules remain."""
    robot = gantry_robot(tmp_path)
    (tmp_path / "c.yaml").write_text(
        "margin: 0.1\nbodies:\n  ball: {sphere: {radius: 0.1}, error: [0.1, 0]}\n  rod: {box: [0.3, 0.02, 0.02]}\n"
        "leave:\n- [ball, rod]\n"
    )
    with pytest.warns(UserWarning, match="margins, which are not read; errors of poses, .*; rules of leave and reach"):
        covered = robot.with_cover(tmp_path / "c.yaml")
    assert CollisionChecker(covered).checked_pairs == CollisionChecker(robot).checked_pairs


def test_a_joint_that_cannot_move_is_not_written_for_mujoco(tmp_path):
    """MuJoCo refuses equal limits, so that the file could not be read."""
    links = {"a": [(Body.sphere(0.1), None)], "b": [(Body.sphere(0.1), translation(1.0))]}
    robot = Robot.from_links(links, [Joint("j", "revolute", "a", "b", axis=(0, 0, 1), lower=0.2, upper=0.2)])
    with pytest.raises(InputError, match="expected joints with a range, .* found equal limits of 'j'"):
        robot.save_cover(tmp_path / "locked.xml", "mjcf")
    assert not (tmp_path / "locked.xml").exists()
