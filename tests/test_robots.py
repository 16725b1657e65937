"""Robots: read whole or refused with a reason; links where the joints put them; bodies where the shapes are."""

import copy
import os
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loewner
from families import translation
from loewner import (
    Body,
    CollisionChecker,
    FileError,
    GeometryError,
    InputError,
    PoseError,
    Robot,
    UnknownNameError,
)
from loewner._kernels import _sources
from loewner._kernels._jit import njit
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import load, store
from loewner.robots.description import link_bodies, reaching
from loewner.robots.description.tree import KINDS
from loewner.robots.description.urdf import VALUES, Shape
from robot_oracle import disagreement, robots_folder


def links(names):
    return "".join(f'<link name="{name}"/>' for name in names)


LINKS = links("abcdef")


def joint(name, kind, parent, child, inside='<axis xyz="0 0 1"/><limit lower="-2" upper="2"/>'):
    if kind in ("planar", "floating", "continuous"):  # a range causes a warning
        inside = re.sub("<limit[^>]*/>", "", inside)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/>{inside}</joint>'
    )


def urdf(folder: Path, inside: str, name: str = "robot.urdf") -> Path:
    path = folder / name
    path.write_text(f'<?xml version="1.0"?>\n<robot name="r">\n{inside}\n</robot>\n')
    return path


def read(folder: Path, inside: str, **options) -> Robot:
    return Robot.from_urdf(urdf(folder, inside), **options)


TURNED = links("ab") + "<joint name='ab' type='fixed'>\n<parent link='a'/><child link='b'/>\n<origin {}/></joint>"


def shape(text: str, origin: str = "") -> str:
    return f"<collision>{origin}<geometry>{text}</geometry></collision>"


def rotation(axis, angle):
    """Rodrigues' formula, as in the textbook."""
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


ORIGIN = np.eye(4)
ORIGIN[:3, :3] = rotation([0, 0, 1], -0.6) @ rotation([0, 1, 0], 0.5) @ rotation([1, 0, 0], 0.4)
ORIGIN[:3, 3] = 0.1, -0.2, 0.3


# -- sine and cosine ----------------------------------------------------------------------------


@njit()
def _sines_cosines(x, s, c):
    for i in range(0, x.size, 8):
        sine, cosine = sine_cosine(load(x, i))
        store(s, i, sine)
        store(c, i, cosine)


def sines_cosines(x):
    s, c = np.empty_like(x), np.empty_like(x)
    _sines_cosines(x, s, c)
    return s, c


@pytest.mark.parametrize("largest", [1.0, 10.0, 1e5, 1e6, 1e12])
def test_sine_and_cosine_to_two_units_in_the_last_place(largest, rng):
    """Beside NumPy's, over small and huge angles, and next to multiples of a quarter turn."""
    near = np.round(rng.uniform(-largest, largest, 4000)) * (np.pi / 2)
    near = near[np.abs(near) <= largest][: len(near[np.abs(near) <= largest]) // 8 * 8]
    x = np.concatenate([rng.uniform(-largest, largest, 40_000), near, np.nextafter(near, 0)])
    s, c = sines_cosines(x)
    assert (np.abs(s - np.sin(x)) <= 2 * np.spacing(np.abs(np.sin(x)))).all()
    assert (np.abs(c - np.cos(x)) <= 2 * np.spacing(np.abs(np.cos(x)))).all()


def test_sine_and_cosine_of_no_angle():
    """NaN and infinity give NaN, and leave the other lanes alone."""
    s, c = sines_cosines(np.array([0.0, np.nan, 1.0, np.inf, -1.0, -np.inf, 2.0, 3.0]))
    assert np.isnan(s[[1, 3, 5]]).all()
    assert np.isnan(c[[1, 3, 5]]).all()
    np.testing.assert_allclose(s[[0, 2, 4, 6, 7]], np.sin([0, 1, -1, 2, 3]), rtol=1e-15)


# -- joints -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic", "planar", "floating", "fixed"])
def test_each_kind_of_joint_moves_as_the_textbook_says(kind, tmp_path, rng):
    """The child is at origin * motion(q), by formulas written out here."""
    axis = np.array([1.0, 2.0, -2.0])
    robot = read(
        tmp_path, links("ab") + joint("j", kind, "a", "b", '<axis xyz="1 2 -2"/><limit lower="-1" upper="3"/>')
    )
    Q = robot.random_configurations(21)
    found = robot.forward_kinematics(Q)
    np.testing.assert_array_equal(found[:, 0], np.broadcast_to(np.eye(4), (21, 4, 4)))
    for q, T in zip(Q, found[:, 1], strict=True):
        motion = np.eye(4)
        if kind in ("revolute", "continuous"):
            motion[:3, :3] = rotation(axis, q[0])
        elif kind == "prismatic":
            motion[:3, 3] = q[0] * axis / 3
        elif kind == "planar":
            motion[:3, :3] = rotation(axis, q[2])
            turn = rotation(np.cross([0, 0, 1], axis), np.arccos(-2 / 3))
            motion[:3, 3] = turn @ [q[0], q[1], 0]
            assert abs(motion[:3, 3] @ axis) < 1e-12
        elif kind == "floating":
            w, v = q[3], q[4:]
            motion[:3, :3] = rotation(v, 2 * np.arctan2(np.linalg.norm(v), w))
            motion[:3, 3] = q[:3]
        np.testing.assert_allclose(T, ORIGIN @ motion, atol=1e-14)


def test_names_and_limits_say_what_the_columns_are(tmp_path):
    """One name and one limit a column; quaternions as w, x, y, z; order of the file, not of the tree."""
    robot = read(
        tmp_path,
        LINKS
        + joint("last", "revolute", "d", "e")
        + joint("base", "floating", "a", "b", "")
        + joint("disc", "planar", "b", "c", "")
        + joint("wheel", "continuous", "c", "d", "")
        + joint("tip", "fixed", "e", "f", ""),
    )
    assert robot.link_names == tuple("abcdef")
    assert robot.joint_names == ("last", "base", "disc", "wheel")
    base = [f"base/{v}" for v in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    assert robot.configuration_names == ("last", *base, "disc/x", "disc/y", "disc/theta", "wheel")
    assert robot.dof == 12
    np.testing.assert_array_equal(robot.lower, [-2, *[-np.inf] * 3, *[-1] * 4, *[-np.inf] * 4])
    np.testing.assert_array_equal(robot.upper, -robot.lower)
    q = robot.configuration({"wheel": 1.0, "base": [1, 2, 3, 0, 1, 0, 0], "disc/theta": -1})
    np.testing.assert_array_equal(q, [0, 1, 2, 3, 0, 1, 0, 0, 0, 0, -1, 1])
    np.testing.assert_array_equal(robot.configuration(), np.eye(12)[4])


def test_mimicking_joints_have_no_columns_and_follow(tmp_path):
    """multiplier * value + offset, along a chain of two as well."""
    robot = read(
        tmp_path,
        links("abc")
        + joint(
            "second",
            "revolute",
            "b",
            "c",
            '<limit lower="-9" upper="9"/><mimic joint="first" multiplier="-2" offset="0.5"/>',
        )
        + joint("first", "prismatic", "a", "b", '<limit lower="0" upper="1"/><mimic joint="lead" offset="0.25"/>')
        + '<link name="z"/>'
        + joint("lead", "continuous", "a", "z", ""),
    )
    assert robot.joint_names == ("lead",)
    T = robot.forward_kinematics([0.3])
    slid, turned = np.eye(4), np.eye(4)
    slid[0, 3] = 0.55
    turned[:3, :3] = rotation([1, 0, 0], -2 * 0.55 + 0.5)
    at = {name: T[i] for i, name in enumerate(robot.link_names)}
    np.testing.assert_allclose(at["b"], ORIGIN @ slid, atol=1e-15)
    np.testing.assert_allclose(at["c"], at["b"] @ ORIGIN @ turned, atol=1e-15)


def arm(folder, **options):
    """Six links on revolute, fixed, prismatic, floating and continuous joints."""
    return read(
        folder,
        LINKS
        + joint("one", "revolute", "a", "b")
        + joint("two", "fixed", "b", "c")
        + joint("three", "prismatic", "c", "d")
        + joint("four", "floating", "c", "e")
        + joint("five", "continuous", "e", "f"),
        **options,
    )


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 16, 3001])
def test_a_configuration_gives_the_same_poses_in_any_company(count, tmp_path):
    """Bit for bit, wherever it stands in a batch of any size, and on any number of threads."""
    robot = arm(tmp_path)
    Q = robot.random_configurations(count)
    together = robot.forward_kinematics(Q)
    assert together.shape == (count, 6, 4, 4)
    for k in {0, count // 2, count - 1} & set(range(count)):
        np.testing.assert_array_equal(robot.forward_kinematics(Q[k]), together[k])


def test_poses_are_rigid(tmp_path):
    """To rounding; and they pass where poses are checked."""
    robot = arm(tmp_path)
    T = robot.forward_kinematics(robot.random_configurations(500))
    R = T[..., :3, :3]
    np.testing.assert_allclose(R.swapaxes(-1, -2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    loewner._base._validate.poses(T, "T")


def test_shapes_of_batches_and_odd_layouts(tmp_path):
    """Leading axes are kept; integers, strides and read-only arrays are taken."""
    robot = arm(tmp_path)
    Q = robot.random_configurations(12)
    expected = robot.forward_kinematics(Q)
    np.testing.assert_array_equal(robot.forward_kinematics(Q.reshape(3, 4, -1)), expected.reshape(3, 4, 6, 4, 4))
    np.testing.assert_array_equal(robot.forward_kinematics(np.asfortranarray(Q)), expected)
    Q.setflags(write=False)
    np.testing.assert_array_equal(robot.forward_kinematics(Q), expected)


def test_placed_moves_the_whole_robot(tmp_path):
    """All links by the same motion; the robot itself stays."""
    robot = arm(tmp_path)
    Q = robot.random_configurations(9)
    before = robot.forward_kinematics(Q)
    T = ORIGIN @ ORIGIN
    np.testing.assert_allclose(robot.placed(T).forward_kinematics(Q), T @ before, atol=1e-14)
    np.testing.assert_array_equal(robot.forward_kinematics(Q), before)
    with pytest.raises(PoseError):
        robot.placed(np.diag([2.0, 1, 1, 1]))


def test_a_robot_without_joints(tmp_path):
    """No columns, one link at the origin."""
    robot = read(tmp_path, '<link name="a"/>')
    assert (robot.dof, robot.joint_names, robot.bodies) == (0, (), {})
    np.testing.assert_array_equal(robot.forward_kinematics(np.empty((3, 0))), np.broadcast_to(np.eye(4), (3, 1, 4, 4)))


def test_random_configurations_lie_within_the_limits(tmp_path):
    """And come again with the same seed."""
    robot = arm(tmp_path)
    Q = robot.random_configurations(2000, 3)
    assert (robot.lower <= Q).all()
    assert (robot.upper >= Q).all()
    assert np.ptp(Q[:, 0]) > 3.9
    np.testing.assert_array_equal(Q, robot.random_configurations(2000, 3))
    assert not (robot.random_configurations(2000, 4) == Q).any()


@pytest.mark.parametrize(
    ("Q", "words"),
    [
        (np.zeros((5, 11)), [r"\(\.\.\., 10\)", "one, three, four/x", r"\(5, 11\)"]),
        (np.zeros(3), [r"\(\.\.\., 10\)"]),
        (1.0, [r"\(\.\.\., 10\)"]),
        (np.full((2, 10), np.nan), [r"Q\[0\]", "nan for one"]),
        (np.full(10, np.inf), ["inf for one"]),
        (np.zeros((2, 10)), ["norm 1 for four", "norm 0"]),
        ([["x"] * 10], ["real numbers"]),
    ],
)
def test_bad_configurations_are_refused(Q, words, tmp_path):
    """With the width expected and its names, the entry that is not finite, or the quaternion that is none."""
    robot = arm(tmp_path)
    with pytest.raises(InputError) as caught:
        robot.forward_kinematics(Q)
    for word in words:
        caught.match(word)


def test_configurations_outside_the_limits_are_allowed(tmp_path):
    """Limits are for samplers; geometry has none."""
    robot = read(tmp_path, links("ab") + joint("j", "revolute", "a", "b"))
    with pytest.warns(UserWarning, match="is it in degrees"):
        T = robot.forward_kinematics([[0.5], [0.5 + 2 * np.pi * 1e3], [0.5 + 2 * np.pi * 1e9]])
    np.testing.assert_allclose(T[1], T[0], atol=1e-12)
    np.testing.assert_allclose(T[2], T[0], atol=1e-5)


def test_robots_can_be_pickled(tmp_path):
    """For worker processes."""
    robot = arm(tmp_path)
    again = pickle.loads(pickle.dumps(robot))
    q = robot.random_configurations(3)
    np.testing.assert_array_equal(again.forward_kinematics(q), robot.forward_kinematics(q))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda robot: pickle.loads(pickle.dumps(robot))])
def test_names_that_a_robot_lacks_are_unknown_names(tmp_path, copied):
    """A misspelt link, group or state is told with those that there are, also of a copy; `get` gives None."""
    (tmp_path / "robot.srdf").write_text(
        """<robot name="r"><group name="wrist"><joint name="ab"/></group>
        <group_state name="ready" group="wrist"><joint name="ab" value="0.5"/></group_state></robot>"""
    )
    links = '<link name="a"/><link name="hand">' + shape('<sphere radius="0.5"/>') + "</link>"
    robot = copied(read(tmp_path, links + joint("ab", "revolute", "a", "hand"), srdf=tmp_path / "robot.srdf"))
    for what, known, name in (
        ("link with a body", robot.bodies, "hand"),
        ("group", robot.groups, "wrist"),
        ("state", robot.states, "ready"),
    ):
        with pytest.raises(UnknownNameError, match=f"^{what}: expected one of {name}; found '{name}s' .*'{name}'"):
            known[f"{name}s"]
        assert known.get(f"{name}s") is None


@pytest.mark.parametrize(
    "copied", [lambda robot: robot, copy.copy, copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))]
)
def test_the_bodies_of_a_robot_cannot_be_replaced_in_place(tmp_path, copied):
    """A checker has prepared the bodies, so a robot that showed others would show what is not checked."""
    links = '<link name="a"/><link name="hand">' + shape('<sphere radius="0.5"/>') + "</link>"
    robot = copied(read(tmp_path, links + joint("ab", "revolute", "a", "hand")))
    shown, other = dict(robot.bodies), Body.box([1, 1, 1])
    for change in (
        lambda: robot.bodies.__setitem__("hand", other),
        lambda: robot.bodies.__delitem__("hand"),
        lambda: robot.bodies.update(hand=other),
        lambda: robot.bodies.__ior__({"hand": other}),
        lambda: robot.bodies.setdefault("a", other),
        lambda: robot.bodies.pop("hand"),
        lambda: robot.bodies.popitem(),
        lambda: robot.bodies.clear(),
    ):
        with pytest.raises(InputError, match="link with a body cannot be set or removed in place: expected a new"):
            change()
    assert dict(robot.bodies) == shown == robot.bodies | {}


# -- bodies -------------------------------------------------------------------------------------


def block(folder, name="block.stl", size=(1, 2, 3), at=(5, 0, 0)):
    """A box as a mesh file, off the origin."""
    trimesh.creation.box(size).apply_translation(at).export(folder / name)
    return folder / name


def bounds(body):
    """Corners of the bounding box, from supports of polytopes and centres and axes of the others."""
    low, high = [], []
    for piece in body.pieces:
        points = piece.vertices
        assert points is not None
        low.append(points.min(axis=0))
        high.append(points.max(axis=0))
    return np.array([np.min(low, axis=0), np.max(high, axis=0)])


def test_primitives_stand_where_the_urdf_puts_them(tmp_path):
    """Kind, size and place of each; several shapes of a link are one body."""
    origin = '<origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/>'
    shapes = [
        shape('<box size="0.2 0.4 0.6"/>', origin),
        shape('<sphere radius="0.5"/>', origin),
        shape('<cylinder radius="0.5" length="2"/>', origin),
        shape('<capsule radius="0.5" length="2"/>', origin),
    ]
    robot = read(tmp_path, f'<link name="a">{"".join(shapes)}</link>')
    body = robot.bodies["a"]
    assert [piece.kind for piece in body.pieces] == ["polytope", "sphere", "cylinder", "capsule"]
    np.testing.assert_allclose(body.inner.center, np.tile([1, 2, 3], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(
        bounds(loewner.Body.from_points(body.pieces[0].vertices)), [[0.9, 1.7, 2.8], [1.1, 2.3, 3.2]]
    )
    # The cylinder's axis, z, points to -y; half its length is 1, and the outer ellipsoid is √3 as long.
    outer = body.outer.shape_matrix[2]
    np.testing.assert_allclose(np.sqrt(np.diag(outer)), [0.5 * np.sqrt(1.5), np.sqrt(3), 0.5 * np.sqrt(1.5)], rtol=1e-9)


def test_meshes_are_scaled_mirrored_and_placed(tmp_path):
    """Scale along the mesh's own axes first, then the origin."""
    block(tmp_path)
    robot = read(
        tmp_path,
        '<link name="a">'
        + shape(
            '<mesh filename="block.stl" scale="-0.1 0.1 0.2"/>', '<origin xyz="0 0 1" rpy="0 0 3.141592653589793"/>'
        )
        + "</link>",
    )
    np.testing.assert_allclose(bounds(robot.bodies["a"]), [[0.45, -0.1, 0.7], [0.55, 0.1, 1.3]], atol=1e-7)
    assert robot.bodies["a"].covering.exact


def l_shape(folder):
    """Two boxes that make an L, as one mesh of two closed parts, which overlap."""
    parts = [trimesh.creation.box((2, 1, 1)), trimesh.creation.box((1, 2, 1)).apply_translation([0.5, 0.5, 0])]
    trimesh.util.concatenate(parts).export(folder / "l.stl")


def test_hull_and_pieces_on_request(tmp_path):
    """The hull holds all sub-meshes; decomposing keeps the notch."""
    l_shape(tmp_path)
    path = urdf(tmp_path, f'<link name="a">{shape("""<mesh filename="l.stl"/>""")}</link>')
    hull = Robot.from_urdf(path, meshes="hull").bodies["a"]
    assert len(hull.pieces) == 1
    np.testing.assert_allclose(bounds(hull), [[-1, -0.5, -0.5], [1, 1.5, 0.5]], atol=1e-7)
    parts = Robot.from_urdf(path, decompose=True).bodies["a"]
    assert len(parts.pieces) == 2
    probe, at = loewner.Body.sphere(0.01), translation(-0.1, 0.6)
    assert loewner.collide(hull, None, probe, at)
    assert not loewner.collide(parts, None, probe, at)


@pytest.mark.parametrize(
    ("name", "place", "package_dirs"),
    [
        ("block.stl", "desc/urdf", []),
        ("../meshes/block.stl", "desc/meshes", []),
        ("package://desc/meshes/block.stl", "desc/meshes", []),
        ("model://desc/meshes/block.stl", "desc/meshes", []),
        ("package://other/block.stl", "elsewhere/other", ["elsewhere"]),
        ("package://other/block.stl", "elsewhere/other", ["elsewhere/other"]),
        ("file://{root}/far/block.stl", "far", []),
        ("{root}/far/block.stl", "far", []),
        ("block.stl", "elsewhere", ["elsewhere"]),
    ],
)
def test_meshes_are_found(name, place, package_dirs, tmp_path):
    """Relative, package, model and file names; packages given, or above the URDF."""
    for folder in (place, "desc/urdf"):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    block(tmp_path / place)
    mesh = shape(f'<mesh filename="{name.format(root=tmp_path)}"/>')
    path = urdf(tmp_path / "desc/urdf", f'<link name="a">{mesh}</link>')
    robot = Robot.from_urdf(path, package_dirs=[tmp_path / folder for folder in package_dirs])
    np.testing.assert_allclose(bounds(robot.bodies["a"]), [[4.5, -1, -1.5], [5.5, 1, 1.5]])


def test_ros_packages_are_found(tmp_path, monkeypatch):
    """Where a sourced workspace says they are."""
    (tmp_path / "ws/share/thing").mkdir(parents=True)
    (tmp_path / "home").mkdir()
    block(tmp_path / "ws/share/thing")
    path = urdf(tmp_path / "home", f'<link name="a">{shape("""<mesh filename="package://thing/block.stl"/>""")}</link>')
    with pytest.raises(FileError):
        Robot.from_urdf(path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ws"))
    assert set(Robot.from_urdf(path).bodies) == {"a"}


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """An empty folder for fits."""
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(tmp_path / "kept"))
    return tmp_path / "kept" / "bodies"


def test_fits_are_kept_by_content(kept, tmp_path, monkeypatch):
    """The same mesh is fitted once; another mesh, scale, place or tolerance anew; a damaged entry too."""
    fitted = []
    fit = link_bodies._mesh_body
    monkeypatch.setattr(link_bodies, "_mesh_body", lambda *a: fitted.append(a) or fit(*a))

    def made(scale="1", **options):
        text = shape(f'<mesh filename="block.stl" scale="{scale}"/>')
        robot = read(tmp_path, f'<link name="a">{text}</link>', **options)
        return len(fitted), bounds(robot.bodies["a"])[1, 0]

    block(tmp_path)
    assert made() == (1, 5.5)
    assert made() == (1, 5.5)
    assert made("2") == (2, 11.0)
    assert made(tol=1e-3) == (3, 5.5)
    block(tmp_path, size=(2, 2, 2))
    assert made() == (4, 6.0)
    assert made() == (4, 6.0)
    entries = sorted(kept.iterdir())
    assert len(entries) == 4
    for entry in entries:
        entry.write_bytes(entry.read_bytes()[:-200])
    assert made() == (5, 6.0)
    assert made() == (5, 6.0)
    assert made(cache=False) == (6, 6.0)


def test_a_mesh_that_changes_while_it_is_fitted_is_not_kept(kept, tmp_path, monkeypatch):
    """The fit of a mesh that was replaced after its checksum was taken is not found under the first mesh's checksum."""
    fit = link_bodies._mesh_body

    def changing(*arguments):
        block(tmp_path, size=(2, 2, 2))
        return fit(*arguments)

    link = f'<link name="a">{shape("""<mesh filename="block.stl"/>""")}</link>'
    with monkeypatch.context() as patched:
        patched.setattr(link_bodies, "_mesh_body", changing)
        block(tmp_path)
        read(tmp_path, link)
    block(tmp_path)
    assert bounds(read(tmp_path, link).bodies["a"])[1, 0] == 5.5


def test_fits_of_unknown_code_are_not_kept(kept, tmp_path, monkeypatch):
    """Where the sources are no files, as in a zip, nobody could tell what made a fit."""
    monkeypatch.setattr(_sources, "source_hash", lambda: "")
    block(tmp_path)
    assert read(tmp_path, f'<link name="a">{shape("""<mesh filename="block.stl"/>""")}</link>').bodies
    assert not kept.exists()


def test_no_place_for_fits_is_no_error(tmp_path, monkeypatch):
    """The robot is read all the same."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(tmp_path / "file" / "below"))
    block(tmp_path)
    assert read(tmp_path, f'<link name="a">{shape("""<mesh filename="block.stl"/>""")}</link>').bodies


def test_progress_is_told(tmp_path):
    """Once a shape."""
    told = []
    two = shape('<sphere radius="1"/>') + shape('<box size="1 1 1"/>')
    read(tmp_path, f'<link name="a">{two}</link>', progress=lambda *at: told.append(at))
    assert told == [(1, 2), (2, 2)]


# -- bad descriptions ---------------------------------------------------------------------------

TWO = links("ab")


@pytest.mark.parametrize(
    ("inside", "kind", "words"),
    [
        ("", InputError, ["line 2", "at least one <link>"]),
        ("<link/>", InputError, ["line 3", "'name' of <link>"]),
        (TWO, InputError, ["one root", "a, b"]),
        (TWO + '<link name="a"/>', InputError, ["'a' again, first in line 3"]),
        (TWO + joint("j", "fixed", "a", "b") + joint("j", "fixed", "a", "b"), InputError, ["'j' again"]),
        (TWO + joint("j", "fixed", "a", "b") + joint("k", "fixed", "b", "a"), InputError, ["cycle: a, b"]),
        (
            links("abc") + joint("j", "fixed", "a", "c") + joint("k", "fixed", "b", "c"),
            InputError,
            ["'c' below two", "'k'"],
        ),
        (links("abc") + joint("j", "fixed", "b", "c") + joint("k", "fixed", "c", "b"), InputError, ["cycle: b, c"]),
        (TWO + joint("j", "fixed", "a", "x"), UnknownNameError, ["child of joint 'j', found 'x'; known are a, b"]),
        (TWO + joint("j", "ball", "a", "b"), InputError, ["revolute", "'ball' of joint 'j'"]),
        (TWO + '<joint name="j" type="fixed"><parent link="a"/></joint>', InputError, ["a <child> in <joint>"]),
        (TWO + joint("j", "revolute", "a", "b", ""), InputError, ["<limit> of the revolute joint 'j'"]),
        (TWO + joint("j", "prismatic", "a", "b", ""), InputError, ["<limit> of the prismatic joint 'j'"]),
        (
            TWO + joint("j", "revolute", "a", "b", '<limit lower="2" upper="1"/>'),
            InputError,
            ["lower <= upper", "2 > 1"],
        ),
        (TWO + joint("j", "revolute", "a", "b", '<limit lower="x"/>'), InputError, ["1 number as 'lower'", "'x'"]),
        (TWO + joint("j", "revolute", "a", "b", '<limit lower="nan"/>'), InputError, ["1 number as 'lower'", "'nan'"]),
        (TWO + joint("j", "continuous", "a", "b", '<axis xyz="0 0 0"/>'), InputError, ["axis", "joint 'j'"]),
        (
            TWO + joint("j", "continuous", "a", "b", '<axis xyz="0 1e-320 0"/>'),
            InputError,
            ["no less than 1e-09", "joint 'j'"],
        ),
        (TWO + joint("j", "continuous", "a", "b", '<axis xyz="0 9e-10 0"/>'), InputError, ["found 0 9e-10 0"]),
        (TWO + joint("j", "continuous", "a", "b", '<axis xyz="0 1"/>'), InputError, ["3 numbers as 'xyz'", "'0 1'"]),
        (TWO + joint("j", "continuous", "a", "b", '<axis xyz="0 inf 0"/>'), InputError, ["finite numbers as 'xyz'"]),
        (TWO + joint("j", "continuous", "a", "b", '<mimic joint="j"/>'), InputError, ["'j' to mimic", "ring: j"]),
        (
            TWO + joint("j", "floating", "a", "b", '<mimic joint="k"/>'),
            InputError,
            ["one value only", "floating joint 'j'"],
        ),
        (
            links("abc")
            + joint("j", "floating", "a", "b", "")
            + joint("k", "continuous", "b", "c", '<mimic joint="j"/>'),
            InputError,
            ["one value for 'k' to mimic", "'j', which is floating"],
        ),
        (f'<link name="a">{shape("")}</link>', InputError, ["one shape among mesh, box", "none"]),
        (f'<link name="a">{shape("<torus/>")}</link>', InputError, ["one shape among", "<torus>"]),
        ('<link name="a"><collision/></link>', InputError, ["<geometry> in <collision>"]),
        (f'<link name="a">{shape("<box/>")}</link>', InputError, ["'size' of <box>"]),
        (
            """<link name="a">{}</link>""".format(shape('<box size="1 -1 1"/>')),
            GeometryError,
            ["line 3", "above 0", "1 -1 1"],
        ),
        ("""<link name="a">{}</link>""".format(shape('<sphere radius="0"/>')), GeometryError, ["above 0 for a sphere"]),
        (
            """<link name="a">{}</link>""".format(shape('<cylinder radius="1"/>')),
            InputError,
            ["'length' of <cylinder>"],
        ),
        (
            """<link name="a">{}</link>""".format(shape('<mesh filename="m.stl" scale="1 0 1"/>')),
            GeometryError,
            ["scale without a 0"],
        ),
        ("""<link name="a">{}</link>""".format(shape("<mesh/>")), InputError, ["'filename' of <mesh>"]),
        (
            """<link name="lost">{}</link>""".format(shape('<mesh filename="package://p/m.stl"/>')),
            FileError,
            ["line 3", "'package://p/m.stl' of link 'lost'", "looked at .*p/m.stl", "package_dirs"],
        ),
        ("<xacro:macro/>", FileError, ["line 3", "run xacro"]),
        ("<link name='a'><xacro:if value='1'/></link>", FileError, ["line 3", "<xacro:if>; run xacro"]),
        ("<link name='a'><visual><xacro:v/></visual></link>", FileError, ["line 3", "<xacro:v>; run xacro"]),
        ("<gazebo><x:v xmlns:x='http://ros.org/wiki/xacro#v'/></gazebo>", FileError, ["line 3", "<x:v>; run xacro"]),
        ("<gazebo xmlns:x='http://www.ros.org/wiki/xacro/'><a><x:v/></a></gazebo>", FileError, ["<x:v>; run xacro"]),
        ("<v xmlns='http://www.ros.org/wiki/xacro'><w/></v>", FileError, ["<v>; run xacro"]),
        ("<xacro:v xmlns:xacro='urn:other'/>", FileError, ["<xacro:v>; run xacro"]),
        ("<link name='a'><xi:include href='b'/></link>", FileError, ["line 3", "<xi:include>"]),
        ("<i:include xmlns:i='http://www.w3.org/2001/XInclude' href='b'/>", FileError, ["<i:include>"]),
        (TURNED.format("xyz='0 0 ${h}'"), InputError, ["line 5", "3 numbers as 'xyz'", "'0 0 .{h}'; run xacro on"]),
        (TURNED.format("rpy='0 0 $(arg turn)'"), InputError, ["line 5", "; run xacro on the file first"]),
        ("<include filename='b'/>", FileError, ["line 3", "<include>; run xacro"]),
        ("<macro name='b'/>", FileError, ["<macro>; run xacro"]),
        ("<property name='b' value='1'/>", FileError, ["<property>; run xacro"]),
        (
            "<link name='a'>{}</link>".format(shape("<sphere radius='1'/>", "<origin quat_xyzw='0 0 0 1'/>")),
            InputError,
            ["only xyz and rpy as attributes of <origin>, found 'quat_xyzw'"],
        ),
        (TURNED.format("xyz='0 0 0' wxyz='1 0 0 0'"), InputError, ["line 5", "found 'wxyz'"]),
        (TURNED.format("position='0 0 0'"), InputError, ["line 5", "found 'position'"]),
        ("<link name='a'>", FileError, ["line 4", "broken XML"]),
    ],
)
def test_bad_urdf_is_refused(inside, kind, words, tmp_path):
    """With the file, the line, what was expected and what was found."""
    with pytest.raises(kind) as caught:
        read(tmp_path, inside)
    caught.match("robot.urdf")
    for word in words:
        caught.match(word)


def test_declared_namespaces_alone_are_no_macros(tmp_path):
    """Files that xacro has written still declare its namespace, and other programs' extensions have names like its."""
    declared = "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro' xmlns='http://www.ros.org'>"
    inside = "<link name='a'/><gazebo><include/><property/><a:macro xmlns:a='urn:a'/></gazebo>"
    assert Robot.from_urdf(text=f"{declared}{inside}</robot>").link_names == ("a",)


def test_files_that_are_no_urdf(tmp_path):
    """A folder, nothing, no XML, another XML."""
    with pytest.raises(FileError, match="no such file"):
        Robot.from_urdf(tmp_path / "none.urdf")
    with pytest.raises(FileError, match="directory"):
        Robot.from_urdf(tmp_path)
    (tmp_path / "empty.urdf").write_text("")
    with pytest.raises(FileError, match="line 1.*broken XML"):
        Robot.from_urdf(tmp_path / "empty.urdf")
    (tmp_path / "world.sdf").write_text("<sdf/>")
    with pytest.raises(FileError, match="root element <robot>, found <sdf>"):
        Robot.from_urdf(tmp_path / "world.sdf")


def test_flat_and_broken_meshes_name_their_link(tmp_path):
    """Link, file and reason."""
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(tmp_path / "flat.stl")
    with pytest.raises(GeometryError, match="robot.urdf, line 3, link 'plate': .*flat.stl"):
        read(tmp_path, f'<link name="plate">{shape("""<mesh filename="flat.stl"/>""")}</link>')
    (tmp_path / "cut.stl").write_bytes(block(tmp_path).read_bytes()[:-7])
    with pytest.raises(FileError, match="line 3, link 'plate': .*cut.stl"):
        read(tmp_path, f'<link name="plate">{shape("""<mesh filename="cut.stl"/>""")}</link>')


def test_mimicking_nobody_is_told(tmp_path):
    """The joint gets a value of its own, as in MoveIt and pinocchio."""
    with pytest.warns(UserWarning, match="for 'j' to mimic, found 'k'; it gets a value of its own. known are j"):
        robot = read(tmp_path, TWO + joint("j", "continuous", "a", "b", '<mimic joint="k"/>'))
    assert robot.joint_names == ("j",)


# -- SRDF ---------------------------------------------------------------------------------------

TREE = LINKS.replace('<link name="c"/>', f'<link name="c">{shape("""<sphere radius="1"/>""")}</link>') + "".join(
    [
        joint("ab", "revolute", "a", "b"),
        joint("bc", "fixed", "b", "c"),
        joint("cd", "continuous", "c", "d"),
        joint("be", "floating", "b", "e"),
        joint("ef", "revolute", "e", "f"),
    ]
)


def with_srdf(folder, inside):
    (folder / "robot.srdf").write_text(f'<robot name="r">\n{inside}\n</robot>')
    return read(folder, TREE, srdf=folder / "robot.srdf")


def test_srdf_groups_states_and_pairs(tmp_path):
    """Joints, links, chains (up and down again) and groups of groups; values by joint; pairs sorted."""
    robot = with_srdf(
        tmp_path,
        """<group name="all"><group name="chain"/><joint name="ab"/><joint name="base"/></group>
        <group name="chain"><chain base_link="d" tip_link="f"/></group>
        <group name="links"><link name="d"/><link name="a"/><link name="c"/></group>
        <group_state name="home" group="all"><joint name="ab" value="0.5"/><joint name="bc" value="3"/>
          <joint name="be" value="1 2 3 0.6 0 0 0.8"/><joint name="base" value="0 0 0"/></group_state>
        <group_state name="home" group="links"><joint name="cd" value="-1"/></group_state>
        <virtual_joint name="base" type="planar" parent_frame="world" child_link="a"/>
        <disable_collisions link1="d" link2="b" reason="Never"/>
        <disable_default_collisions link="f"/><enable_collisions link1="f" link2="a"/>
        <gripper name="left"/>""",
    )
    assert robot.groups == {"all": ("ab", "cd", "be", "ef"), "chain": ("cd", "be", "ef"), "links": ("cd",)}
    be = (1.0, 2.0, 3.0, 0.8, 0.6, 0.0, 0.0)
    assert robot.states == {"home": ("all", {"ab": 0.5, "be": be}), "links/home": ("links", {"cd": -1.0})}
    np.testing.assert_array_equal(robot.configuration("home"), [0.5, 0, *be, 0])
    assert robot.disabled_pairs == {("b", "d"), *(tuple(sorted(("f", x))) for x in "bcde")}


def test_srdf_for_another_robot_is_refused(tmp_path):
    """Valid names are listed."""
    with pytest.raises(
        UnknownNameError, match="another robot, with link 'p' .line 2.*links: known are a, b.*joints: .*ab"
    ):
        with_srdf(tmp_path, '<disable_collisions link1="p" link2="q"/>')


def test_srdf_for_a_bigger_variant_is_told(tmp_path):
    """What it knows is taken, what it does not know is said."""
    with pytest.warns(UserWarning, match=r"left out.*link 'q' \(line 3\), group 'hand' \(line 4\)"):
        robot = with_srdf(
            tmp_path,
            """<disable_collisions link1="a" link2="b"/>
            <disable_collisions link1="a" link2="q"/>
            <group name="all"><joint name="ab"/><group name="hand"/></group>""",
        )
    assert robot.disabled_pairs == {("a", "b")}
    assert robot.groups == {"all": ("ab",)}


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<group name="g"><group name="h"/></group><group name="h"><group name="g"/></group>', "g in h in g"),
        ('<group name="g"/><group name="g"/>', "'g' again"),
        ('<group name="g"/><group_state name="s" group="g"><joint name="ab" value="x"/></group_state>', "'value'.*'x'"),
        ('<group name="g"/><group_state name="s" group="g"><joint name="be" value="1"/></group_state>', "7 numbers"),
        ('<disable_collisions link1="a"/>', "'link2'"),
    ],
)
def test_bad_srdf_is_refused(inside, words, tmp_path):
    """With line and reason."""
    with pytest.raises(InputError, match="robot.srdf, line 2: expected .*" + words):
        with_srdf(tmp_path, inside)


@pytest.mark.parametrize("inside", ['<group name="g"><xacro:arm/></group>', "<xacro:arm/>", '<include filename="b"/>'])
def test_macros_in_an_srdf_are_refused(inside, tmp_path):
    """A macro may stand for groups or for rules on pairs, at any depth."""
    with pytest.raises(FileError, match="robot.srdf, line 2: expected an SRDF, found the macro .*; run xacro"):
        with_srdf(tmp_path, inside)


def test_unknown_names_of_a_configuration(tmp_path):
    """Valid ones are listed."""
    robot = with_srdf(tmp_path, '<group name="g"><joint name="ab"/></group><group_state name="home" group="g"/>')
    with pytest.raises(UnknownNameError, match=r"state: expected one of home; found 'hom' \(did you mean 'home'"):
        robot.configuration("hom")
    with pytest.raises(UnknownNameError, match="joint: expected one of ab, cd, .*be/qw.*, be; found 'x'"):
        robot.configuration({"x": 1})
    with pytest.raises(InputError, match=r"be: expected shape \(7,\), found \(1,\)"):
        robot.configuration({"be": 1})


def test_a_mimicking_joint_has_no_value_to_set(tmp_path):
    """Setting a mimicking joint is refused, and the error names the joint it follows."""
    mimic = joint("follow", "continuous", "b", "c", '<mimic joint="lead"/>')
    robot = read(tmp_path, links("abc") + joint("lead", "revolute", "a", "b") + mimic)
    with pytest.raises(UnknownNameError, match="'follow': follow mimics lead; set 'lead'"):
        robot.configuration({"follow": 0.1})


@pytest.mark.parametrize("values", [3, [0.0, 1.0], {"ab"}])
def test_what_names_no_configuration(values, tmp_path):
    """Values are named by joints or by a state; anything else is refused."""
    with pytest.raises(
        InputError, match="values: expected a mapping by names of joints, or the name of a state, found"
    ):
        read(tmp_path, TREE).configuration(values)


@pytest.mark.parametrize("n", [-1, 1.5, "a", None, 10**18])
def test_numbers_of_random_configurations_that_are_none(n, tmp_path):
    """A batch that fits no memory is none either."""
    with pytest.raises(InputError, match="integer >= 0|fit into memory"):
        read(tmp_path, TREE).random_configurations(n)


@pytest.mark.parametrize("seed", [-1, 0.5, "a", None])
def test_seeds_that_are_none(seed, tmp_path):
    """A seed has to be a whole number that is not negative."""
    with pytest.raises(InputError, match="seed: expected an integer >= 0"):
        read(tmp_path, TREE).random_configurations(3, seed=seed)


@pytest.mark.parametrize(
    ("path", "found"), [(None, "None"), (3, "3"), ('\n<robot name="r"/>', "XML text"), (b"r.urdf", "b'r.urdf'")]
)
def test_paths_that_are_none(path, found, tmp_path):
    """What is no path, XML text included, is refused as a URDF and as an SRDF."""
    with pytest.raises(InputError, match=f"expected a path to a URDF, found {found}"):
        Robot.from_urdf(path)
    if path is not None:
        with pytest.raises(InputError, match=f"expected a path to an SRDF, found {found}"):
            read(tmp_path, TREE, srdf=path)


def test_package_dirs_that_are_no_folders(tmp_path):
    """Folders of packages that do not exist or are files are refused by name."""
    (tmp_path / "file").touch()
    for name in ("none", "file"):
        with pytest.raises(FileError, match=f"{name}: expected a folder of packages"):
            read(tmp_path, TREE, package_dirs=[tmp_path / "file" if name == "file" else "none"])
    with pytest.raises(InputError, match="package_dirs: expected a path or several, found 3"):
        read(tmp_path, TREE, package_dirs=3)


# -- SRDF files that are none, or another robot's -------------------------------------------------

PAIR = '<disable_collisions link1="a" link2="b"/>'


def test_a_urdf_is_no_srdf(tmp_path):
    """A URDF in place of the SRDF is recognised and refused, with the line."""
    path = urdf(tmp_path, TREE)
    with pytest.raises(InputError, match="line 3: expected an SRDF, with .*, found a URDF, with a <link>"):
        Robot.from_urdf(path, srdf=path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<robot name="r"/>', "of 'r', found none of its links and joints named"),
        ('<robot name="r"><virtual_joint name="v" child_link="a"/></robot>', "none of its links and joints named"),
        (f'<robot name="other">{PAIR}</robot>', "expected an SRDF for 'r', as .* calls it, found one for 'other'"),
        (
            f'<robot name="r">\n{PAIR}<disable_colisions link1="a" link2="c"/></robot>',
            r"SRDF does not define them.*: <disable_colisions> in <robot> \(line 2\)",
        ),
    ],
)
def test_odd_srdf_files_are_told(text, message, tmp_path):
    """An SRDF that is for another robot, empty or misspelt is read with a warning."""
    path = tmp_path / "robot.srdf"
    path.write_text(text)
    with pytest.warns(UserWarning, match=message):
        read(tmp_path, TREE, srdf=path)


def test_an_srdf_without_a_name_is_no_other_robots(tmp_path):
    """With a pair disabled, and elements of other programs: no warning (they are errors here)."""
    path = tmp_path / "robot.srdf"
    path.write_text(f'<robot>{PAIR}<end_effector name="e"/><handle name="h"/><gripper name="g"/></robot>')
    assert read(tmp_path, TREE, srdf=path).disabled_pairs == {("a", "b")}


def test_kept_bodies_are_those_of_this_code(tmp_path, monkeypatch):
    """What another version of the code made of the same file is not found again."""
    (tmp_path / "part.stl").write_bytes(b"the same bytes")
    part = Shape("mesh", (), "part.stl", np.ones(3), np.eye(4), 1)
    keys = [link_bodies._key(tmp_path / "part.stl", part, False, 1e-4)]
    monkeypatch.setattr(link_bodies, "_code", lambda: "another version")
    keys.append(link_bodies._key(tmp_path / "part.stl", part, False, 1e-4))
    assert keys[0] != keys[1]
    home = Path(loewner.__file__).parent
    assert all((home / maker).exists() for maker in link_bodies._MAKERS)


def test_adjacent_pairs_reach_through_links_without_bodies(tmp_path):
    """Parent and child; what hangs on one bodiless link; through two of them in a row; and no others."""
    solid = shape('<sphere radius="1"/>')
    links = "".join(f'<link name="{x}">{solid if x in "acdfg" else ""}</link>' for x in "abcdefg")
    joints = [("a", "b"), ("b", "c"), ("b", "e"), ("e", "f"), ("c", "d"), ("f", "g")]
    robot = read(tmp_path, links + "".join(joint(x + y, "fixed", x, y) for x, y in joints))
    assert robot.adjacent_pairs == {("a", "c"), ("a", "f"), ("c", "f"), ("c", "d"), ("f", "g")}


def test_links_that_two_joints_move_against_each_other_are_not_adjacent(tmp_path):
    """Links without bodies between them change nothing about that: such a pair may well collide, and is checked."""
    solid = shape('<sphere radius="0.3"/>')
    links = "".join(f'<link name="{x}">{solid if x in "adf" else ""}</link>' for x in "abcdef")
    kinds = [
        ("a", "b", "fixed"),
        ("b", "c", "revolute"),
        ("c", "d", "fixed"),
        ("c", "e", "revolute"),
        ("e", "f", "revolute"),
    ]
    joints = "".join(joint(x + y, kind, x, y) for x, y, kind in kinds)
    robot = read(tmp_path, links + joints)
    assert robot.adjacent_pairs == {("a", "d")}
    checker = CollisionChecker(robot)
    assert set(checker.checked_pairs) == {("a", "f"), ("d", "f")}
    assert checker.collide(np.zeros(3))  # the balls are larger than what the joints put between them


# -- beside pinocchio ---------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.* that leave 'r_gripper_l_finger_joint'")
@pytest.mark.parametrize(
    "name", ["panda_description/urdf/panda", "talos_data/robots/talos_full_v2_box", "pr2_description/urdf/pr2"]
)
def test_links_are_where_pinocchio_sees_them(name):
    """To 1e-9, with continuous, prismatic and mimicking joints among them."""
    path = robots_folder() / f"{name}.urdf"
    assert disagreement(without_bodies(path), path, 50) < 1e-9


def without_bodies(path: Path) -> Robot:
    """A robot whose meshes are left alone: only where its links are is asked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("loewner.robots.description.robot.link_bodies", lambda *a, **k: ({}, {}))
        return Robot.from_urdf(path)


def test_every_joint_kind_agrees_with_pinocchio(tmp_path):
    """Planar and floating joints as well, which no robot above has."""
    path = urdf(
        tmp_path,
        LINKS
        + joint("j", "floating", "a", "b", "")
        + joint("k", "planar", "b", "c", "")
        + joint("l", "prismatic", "c", "d", '<axis xyz="1 2 3"/><limit lower="-1" upper="1" effort="1" velocity="1"/>')
        + joint("m", "revolute", "d", "e", '<axis xyz="3 -2 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>')
        + joint("n", "continuous", "d", "f", ""),
    )
    assert disagreement(Robot.from_urdf(path), path, 50) < 1e-12


def test_panda_with_its_srdf():
    """Its groups, pairs and bodies, as a reader of the two files would list them."""
    folder = robots_folder() / "panda_description"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = Robot.from_urdf(folder / "urdf/panda.urdf", srdf=folder / "srdf/panda.srdf")
    assert robot.joint_names == (*(f"panda_joint{k}" for k in range(1, 8)), "panda_finger_joint1")
    assert robot.groups["hand"] == ("panda_finger_joint1",)
    assert ("panda_hand", "panda_link7") in robot.adjacent_pairs & robot.disabled_pairs
    assert set(robot.link_names) - set(robot.bodies) == {"panda_link8", "panda_hand_tcp"} & set(robot.link_names)
    T = robot.forward_kinematics(robot.configuration())
    np.testing.assert_allclose(T[robot.link_names.index("panda_link8"), :3, 3], [0.088, 0, 0.926], atol=1e-9)


def test_reading_urdf_needs_no_optional_package(tmp_path):
    """Primitives are read without trimesh, lxml and the others."""
    path = urdf(tmp_path, f'<link name="a">{shape("""<box size="1 1 1"/>""")}</link>')
    code = f"import loewner, sys; loewner.Robot.from_urdf({str(path)!r}); print(*sys.modules)"
    environment = os.environ | {"LOEWNER_QUIET": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert {"trimesh", "lxml", "coacd", "networkx"}.isdisjoint(done.stdout.split())


def test_kernels_and_descriptions_agree_on_widths():
    """Columns of a joint, by kind, are told twice: to kernels and to people."""
    for kind, values in VALUES.items():
        assert reaching.WIDTHS[KINDS[kind]] == len(values)


class Labelled:
    """A table of another library, such as pandas: an array with labels."""

    def __init__(self, values, **labels):
        self.values = np.asarray(values)
        vars(self).update(labels)

    def __array__(self, dtype=None, copy=None):
        return self.values.astype(dtype or float)


def test_labels_of_tables_are_in_the_robots_order():
    """An array has no labels, so columns in another order would be other joints."""
    inside = LINKS + joint("j", "revolute", "a", "b") + joint("k", "revolute", "b", "c")
    inside += "".join(joint(f"f{k}", "fixed", a, b) for k, (a, b) in enumerate(("cd", "de", "ef")))
    robot = Robot.from_urdf(text=f'<robot name="r">{inside}</robot>')
    right, wrong = (robot.configuration_names, robot.configuration_names[::-1])
    for label, values in (("columns", [[0.1, 0.2], [0.3, 0.4]]), ("index", [0.1, 0.2])):
        assert robot.checked(Labelled(values, **{label: list(right)})).tolist() == values
        assert robot.checked(Labelled(values, **{label: [0, 1]})).tolist() == values
        with pytest.raises(InputError, match="Q: expected columns in the order 'j, k', found 'k, j'; choose them by"):
            robot.checked(Labelled(values, **{label: list(wrong)}))
