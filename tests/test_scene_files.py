"""Scenes in files: what is written is read back, what is malformed is refused with line and key."""

import json
import os
import re
import shutil
import sys
import threading
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import loewner
from families import translation
from loewner import Body, FileError, GeometryError, Scene, load_scene, read_motion_bench_maker, save_scene
from loewner.scenes.files import yaml_scenes
from loewner.scenes.files.sensor_shapes import read_array
from sampling import examples

EVERYTHING = """\
margin: 0.01
bodies:
  table: {box: [1.2, 0.8, 0.04], position: [0.6, 0, 0.4], rpy: [0.1, -0.2, 0.3]}
  can:
    cylinder: {radius: 0.03, length: 0.14}
    position: [0, 0, 1e-1]
    quaternion_wxyz: [0.7071, 0.7071, 0, 0]
    attach: {link: panda_hand, touch: [panda_leftfinger]}
  ball: {sphere: {radius: 0.1}, pose: [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], margin: 0.2}
  egg: {ellipsoid: [0.1, 0.2, 0.3], position: [0, 0, 5]}
  pill: {capsule: {radius: 0.1, length: 0.2}, position: [0, 0, 6]}
  hat: {cone: {radius: 0.1, length: 0.2}, position: [0, 0, 7]}
  rock: {points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], position: [0, 0, 8]}
  1: {mesh: parts/part.stl, scale: [1, -2, 0.5], position: [0, 0, 10]}
  kept: {saved: kept.npz, position: [0, 0, 12]}
allow: [[table, panda_link0], [egg, ball]]
margins:
- [table, egg, 0.05]
- [panda_hand, 0.02]
- {of: [rock, ball], margin: 0.0, lower: true}
- {of: [egg], margin: 0.001, lower: true}
- {of: [hat], margin: 0.03, lower: false}
- {of: [panda_hand], margin: 0.002, against: links}
- {margin: 0.004, against: links}
- {of: [panda_link5], margin: 0.0, against: links, lower: true}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((0.1, 0.2, 0.3)).apply_translation((1, 1, 1)).export(tmp_path / "parts/part.stl")
    Body.union([Body.sphere(0.2), Body.box([0.1, 0.1, 1])]).save(tmp_path / "kept.npz")
    (tmp_path / "scene.yaml").write_text(EVERYTHING)
    return tmp_path


def read(folder: Path, text: str) -> Scene:
    (folder / "scene.yaml").write_text(text)
    return load_scene(folder / "scene.yaml")


def same_bodies(a: Body, b: Body) -> bool:
    """Whether two bodies hold the same arrays."""
    return all(np.array_equal(x, y) for x, y in zip(a._packed.kernel, b._packed.kernel, strict=True))


def same_scenes(a: Scene, b: Scene) -> None:
    assert a.names == b.names
    assert (a.margin, a.margins, a.lowered, a.allowed) == (b.margin, b.margins, b.lowered, b.allowed)
    for name in a:
        assert same_bodies(a[name], b[name]), name
    assert a.attachments.keys() == b.attachments.keys()
    for name, held in a.attachments.items():
        other = b.attachments[name]
        assert (held.link, held.touch_links) == (other.link, other.touch_links)
        np.testing.assert_array_equal(held.T_link_body, other.T_link_body)
    np.testing.assert_array_equal(a.static_poses, b.static_poses)


def test_every_key_is_read(folder):
    """Every key of a scene file takes effect: shapes, poses, attachments, margins, allowed pairs."""
    scene = load_scene(folder / "scene.yaml")
    assert scene.names == ("table", "can", "ball", "egg", "pill", "hat", "rock", "1", "kept")
    kinds = {name: scene[name].pieces[0].kind for name in scene}
    assert [kinds[name] for name in ("can", "ball", "egg", "pill", "hat")] == [
        "cylinder",
        "sphere",
        "ellipsoid",
        "capsule",
        "cone",
    ]
    assert same_bodies(scene["table"], Body.box([1.2, 0.8, 0.04]))
    assert same_bodies(scene["hat"], Body.cone(0.1, 0.2))
    assert same_bodies(scene["rock"], Body.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    assert len(scene["kept"].pieces) == 2
    np.testing.assert_allclose(scene["1"].pieces[0].vertices.min(axis=0), [0.95, -2.2, 0.425], atol=1e-7)
    np.testing.assert_allclose(scene["1"].pieces[0].vertices.max(axis=0), [1.05, -1.8, 0.575], atol=1e-7)

    table = scene.pose("table")
    np.testing.assert_allclose(table[:3, :3], Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix(), atol=1e-15)
    np.testing.assert_array_equal(table[:, 3], [0.6, 0, 0.4, 1])
    np.testing.assert_array_equal(scene.pose("ball"), [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    can = scene.attachments["can"]
    assert (can.link, can.touch_links) == ("panda_hand", ("panda_hand", "panda_leftfinger"))
    np.testing.assert_allclose(can.T_link_body, [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0.1], [0, 0, 0, 1]], atol=1e-15)

    assert scene.margin == 0.01
    assert scene.margins == {
        ("ball",): 0.2,
        ("egg", "table"): 0.05,
        ("panda_hand",): 0.02,
        ("ball", "rock"): 0.0,
        ("egg",): 0.001,
        ("hat",): 0.03,
        ("panda_hand", None): 0.002,
        (None, None): 0.004,
        ("panda_link5", None): 0.0,
    }
    assert scene.lowered == {("ball", "rock"), ("egg",), ("panda_link5", None)}
    assert scene.allowed == {("panda_link0", "table"), ("ball", "egg")}


def test_saved_scenes_come_back_the_same(folder):
    """Bodies, poses, attachments and rules, to the last bit."""
    scene = load_scene(folder / "scene.yaml")
    (folder / "other").mkdir()
    save_scene(scene, folder / "other" / "copy.yaml")
    same_scenes(load_scene(folder / "other" / "copy.yaml"), scene)
    *bodies, file = sorted(os.listdir(folder / "other"))
    assert file == "copy.yaml"
    assert [re.sub(r"-[0-9a-f]{16}\.", ".", name) for name in bodies] == [
        "copy-1.npz",
        "copy-kept.npz",
        "copy-rock.npz",
    ]


def test_strange_names_are_written_and_shared_bodies_once(folder):
    """Names that YAML or a file system could take for something else; clashing file names are told apart."""
    shared = Body.from_points(np.random.default_rng(1).normal(size=(9, 3)))
    names = [
        "yes",
        "1.0",
        "a: b",
        "ä/ö",
        "Ä/Ö",
        "null",
        "2020-01-01",
        "- x",
        "x" * 150,
        "#",
        "rock",
        "ROCK",
        "line\nbreak",
    ]
    scene = Scene()
    for name in names:
        scene.add(name, Body.from_points(np.random.default_rng(len(scene)).normal(size=(9, 3))))
        scene.add(name + "2", shared)
    save_scene(scene, folder / "names.yaml")
    back = load_scene(folder / "names.yaml")
    same_scenes(back, scene)
    assert all(back[name + "2"] is back["yes2"] for name in names)
    files = [file.lower() for file in os.listdir(folder) if file.startswith("names-")]
    assert len(set(files)) == len(files) == len(names) + 1


def test_names_from_answers_are_written(folder):
    """The names in answers are NumPy's strings, which YAML's writer does not know."""
    hand, wall = np.array(["hand", "wall"])
    scene = Scene()
    scene.add(wall, Body.box([1, 1, 1]), margin=0.1)
    scene.allow(hand, wall)
    scene.set_margin(0.2, hand, wall)
    scene.attach(wall, hand, touch_links=[np.str_("finger")])
    save_scene(scene, folder / "answers.yaml")
    same_scenes(load_scene(folder / "answers.yaml"), scene)


def test_moved_primitives_are_saved_as_they_are(folder):
    """A body that is no primitive in its own frame is not written as one."""
    T = translation(0.1)
    bodies = [make.transformed(T) for make in (Body.box([1, 2, 3]), Body.sphere(1.0), Body.capsule(0.1, 0.2))]
    scene = Scene()
    for k, body in enumerate([*bodies, Body.from_points(Body.box([1, 1, 1]).pieces[0].vertices)]):
        scene.add(f"b{k}", body)
    save_scene(scene, folder / "moved.yaml")
    same_scenes(load_scene(folder / "moved.yaml"), scene)


@pytest.mark.filterwarnings("ignore:.*in metres, found:UserWarning")
@examples(6, 40)
@given(st.integers(0, 2**32 - 1))
def test_sizes_and_poses_survive_exactly(tmp_path_factory, seed):
    """Primitives of any size at any pose are saved and loaded without changing a bit."""
    rng = np.random.default_rng(seed)
    sizes = 10 ** rng.uniform(-4, 4, size=3)
    makers = (Body.box, Body.ellipsoid, lambda s: Body.sphere(s[0]), lambda s: Body.cylinder(*s[:2]))
    makers += (lambda s: Body.capsule(*s[:2]), lambda s: Body.cone(*s[:2]))
    scene = Scene(margin=float(rng.uniform()))
    for k, make in enumerate(makers):
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        T[:3, 3] = rng.normal(size=3) * 10 ** rng.uniform(-6, 6)
        scene.add(f"b{k}", make(sizes), T)
    file = tmp_path_factory.mktemp("exact") / "scene.yaml"
    save_scene(scene, file)
    same_scenes(load_scene(file), scene)
    assert os.listdir(file.parent) == ["scene.yaml"]


def test_failed_save_leaves_the_old_file(folder, monkeypatch):
    """A save that fails leaves the file as it was."""

    def refuse(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(FileError, match="disk full"):
        save_scene(Scene(), folder / "scene.yaml")
    assert (folder / "scene.yaml").read_text() == EVERYTHING


def hull(seed: int) -> Body:
    return Body.from_points(np.random.default_rng(seed).normal(size=(9, 3)))


def scene_of(**bodies: Body) -> Scene:
    scene = Scene()
    for name, body in bodies.items():
        scene.add(name.replace("_", "-"), body)
    return scene


def test_scenes_of_one_folder_share_no_files(tmp_path):
    """A scene keeps its bodies, whatever is saved beside it, over it, or under names that run together with its own."""
    first, second = scene_of(left_bin=hull(0)), scene_of(bin=hull(1))
    save_scene(first, tmp_path / "cell.yaml")
    save_scene(second, tmp_path / "cell-left.yaml")
    same_scenes(load_scene(tmp_path / "cell.yaml"), first)
    same_scenes(load_scene(tmp_path / "cell-left.yaml"), second)
    shutil.copy(tmp_path / "cell.yaml", tmp_path / "before.yaml")
    save_scene(scene_of(left_bin=hull(2)), tmp_path / "cell.yaml")
    same_scenes(load_scene(tmp_path / "before.yaml"), first)
    assert len(list(tmp_path.glob("*.npz"))) == 3  # none is removed, since a copy of a scene may need it


def test_another_body_in_a_scene_s_file_is_refused(tmp_path):
    """The file of a body that was written anew, even by the library, is refused with both checksums."""
    save_scene(scene_of(rock=hull(0)), tmp_path / "scene.yaml")
    (file,) = tmp_path.glob("scene-rock-*.npz")
    hull(1).save(file)
    checksum = "[0-9a-f]{64}"
    told = f"line 3: bodies/rock/saved: .*expected .*{checksum}, found {checksum}; the file"
    with pytest.raises(FileError, match=told):
        load_scene(tmp_path / "scene.yaml")
    save_scene(scene_of(rock=hull(0)), tmp_path / "scene.yaml")
    same_scenes(load_scene(tmp_path / "scene.yaml"), scene_of(rock=hull(0)))


def test_scenes_without_checksums_are_read(tmp_path):
    """Scenes of earlier versions, and those that people write, name a file alone."""
    hull(0).save(tmp_path / "scene-rock.npz")
    (tmp_path / "scene.yaml").write_text("bodies: {rock: {saved: scene-rock.npz}}")
    same_scenes(load_scene(tmp_path / "scene.yaml"), scene_of(rock=hull(0)))


def test_failed_save_changes_no_file(tmp_path, monkeypatch):
    """Where the last body, or the scene itself, cannot be written, an older scene is read as it was."""
    old = scene_of(a=hull(0), b=hull(1))
    save_scene(old, tmp_path / "scene.yaml")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    replace, calls = os.replace, []

    def refuse(*names):
        calls.append(names)
        if len(calls) == failing:
            raise OSError("disk full")
        replace(*names)

    monkeypatch.setattr(os, "replace", refuse)
    for failing in (1, 2, 3):
        calls.clear()
        with pytest.raises(FileError, match="disk full"):
            save_scene(scene_of(a=hull(2), b=hull(3)), tmp_path / "scene.yaml")
        assert len(calls) == failing
        assert {file: file.read_bytes() for file in before} == before
        same_scenes(load_scene(tmp_path / "scene.yaml"), old)


def test_scenes_too_large_to_read_are_not_written(tmp_path, monkeypatch):
    """What `load_scene` would refuse is refused when it is saved, and nothing is written."""
    for limit, most in (("MOST_BYTES", 100), ("MOST_ENTRIES", 20)):
        with monkeypatch.context() as patched:
            patched.setattr(f"loewner.scenes.files.yaml_scenes.{limit}", most)
            with pytest.raises(FileError, match=f"expected a scene of at most .*{most}.*, found"):
                save_scene(scene_of(**{f"b{k}": hull(k) for k in range(9)}), tmp_path / "scene.yaml")
    assert list(tmp_path.iterdir()) == []


def test_saved_scenes_are_those_of_one_instant(tmp_path, monkeypatch):
    """While a scene is written, another thread moves, adds and removes bodies: the file holds none of these changes."""
    scene = scene_of(**{f"b{k}": Body.box([1, 2, 3]) if k % 2 else hull(k) for k in range(6)})
    before, changes = scene.copy(), []
    inside = yaml_scenes._primitive_of

    def change() -> None:
        changes.append(len(changes))
        scene.move_all(["b0", "b5"], np.tile(translation(len(changes)), (2, 1, 1)))
        scene.add(f"new {len(changes)}", Body.sphere(1.0))
        if "b4" in scene:
            scene.remove("b4")
        scene.set_margin(len(changes), "b0", "b1")

    def shape(body: Body) -> Any:
        thread = threading.Thread(target=change)
        thread.start()
        thread.join()
        return inside(body)

    monkeypatch.setattr(yaml_scenes, "_primitive_of", shape)
    save_scene(scene, tmp_path / "scene.yaml")
    assert len(changes) == 6
    same_scenes(load_scene(tmp_path / "scene.yaml"), before)


MALFORMED = [
    ("bodies:\n  a: {box: [1, 2]}", 2, r"bodies/a/box: expected a sequence of 3, found a sequence of 2"),
    ("bodies:\n  a: {box: [1, 2, x]}", 2, r"bodies/a/box\[2\]: expected a finite number, found 'x'"),
    ("bodies:\n  a:\n    box: [1,\n      .nan, 2]", 4, r"box\[1\]: expected a finite number, found '.nan'"),
    ("bodies:\n  a: {box: [1, nan, 2]}", 2, "expected a finite number, found 'nan'"),
    ('bodies:\n  a: {box: [1, "2", 3]}', 2, r"box\[1\]: expected a finite number, found '2'"),
    ("bodies:\n  a: {box: [1, , 3]}", 2, "expected YAML"),
    ("bodies:\n  a: {box: [1, -2, 3]}", 2, r"bodies/a/box: size: expected numbers > 0"),
    ("bodies:\n  a: {sphere: 0.1}", 2, "bodies/a/sphere: expected a mapping, found '0.1'"),
    ("bodies:\n  a: {sphere: {}}", 2, "expected the key radius, found none"),
    ("bodies:\n  a:\n    cylinder:\n      radius: 1\n      height: 1", 5, "among radius, length, found 'height'"),
    ("bodies:\n  a: {sphere: {radius: }}", 2, "sphere/radius: expected a finite number, found nothing"),
    ("bodies:\n  a: {position: [0, 0, 0]}", 2, "expected one shape among box, .*; found position"),
    ("bodies:\n  a: {sphere: {radius: 1}, box: [1, 1, 1]}", 2, "found sphere and box"),
    ("bodies:\n  a: {bx: [1, 1, 1]}", 2, "found bx"),
    ("bodies:\n  a: {box: [1, 1, 1],\n    psition: [0, 0, 0]}", 3, "keys among box, position, .*, found 'psition'"),
    ("bodies:\n  a: {box: [1, 1, 1], scale: 2}", 2, "found 'scale'"),
    (
        "bodies:\n  a: {box: [1, 1, 1]}\n\n  a: {box: [1, 1, 1]}",
        4,
        "bodies: expected each key once in a mapping, found 'a' again",
    ),
    ("bodies: {}\nbodies: {}", 2, "expected each key once in a mapping, found 'bodies'"),
    ("bodies: {}\nbody: {}", 2, "expected keys among margin, bodies, allow, leave, reach, margins, found 'body'"),
    ("bodies:\nmargin: 1", 1, "bodies: expected a mapping, found nothing"),
    ("margin: 1", 1, "expected the key bodies, found margin"),
    ("- 1", 1, "expected a mapping, found a sequence of 1"),
    ("bodies: {}\nmargin: -1", 2, "margin: expected a number of metres >= 0, found -1"),
    ("bodies: {}\nmargin: [1]", 2, "margin: expected a number, found a sequence of 1"),
    ("bodies: {}\nallow: [[a]]", 2, r"allow\[0\]: expected a sequence of 2, found a sequence of 1"),
    ("bodies: {}\nallow: [[a, a]]", 2, r"allow\[0\]: a, b: expected two names, found 'a' twice"),
    ("bodies: {}\nallow:\n- [a, b]\n- [a, {}]", 4, r"allow\[1\]\[1\]: expected a name, found a mapping of 0"),
    ("bodies: {}\nmargins: [[a, b, -1]]", 2, r"margins\[0\]\[2\]: expected a number of metres"),
    ("bodies: {}\nmargins: [[a]]", 2, "expected a sequence of 2 or 3"),
    ("bodies: {}\nmargins: [{margin: 1}]", 2, "expected the key of, or against: links, found neither"),
    ("bodies: {}\nmargins: [{of: [a]}]", 2, "expected the key margin"),
    ("bodies: {}\nmargins: [{of: [a], margin: 1, against: bodies}]", 2, "against: expected links, found 'bodies'"),
    ("bodies: {}\nmargins: [{of: [a, b], margin: 1, against: links}]", 2, "against: expected none with a pair"),
    ("bodies: {}\nmargins: [{of: [a], margin: 1, lower: perhaps}]", 2, "expected true or false"),
    ("bodies:\n  a: {box: [1, 1, 1], rpy: [0, 0, 0], quaternion_wxyz: [1, 0, 0, 0]}", 2, "expected one rotation"),
    ("bodies:\n  a: {box: [1, 1, 1], pose: [], position: []}", 2, "found position and pose"),
    ("bodies:\n  a: {box: [1, 1, 1],\n    quaternion_wxyz: [1, 1, 0, 0]}", 3, "unit quaternion qw qx qy qz, found"),
    (
        "bodies:\n  a: {box: [1, 1, 1],\n   pose: [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}",
        3,
        "pose: matrix: expected a rot.*; a pose is a 4x4 matrix, in four rows of four; position with rpy or quat",
    ),
    (
        "bodies:\n  a: {box: [1, 1, 1], pose: [0, 0, 1]}",
        2,
        "pose: expected a sequence of 4, found a sequence of 3; a pose is a 4x4 matrix.*; position with",
    ),
    (
        "bodies:\n  a: {box: [1, 1, 1], pose: [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]]}",
        2,
        r"pose\[0\]: expected a sequence of 4, found a sequence of 3; a pose is a 4x4 matrix",
    ),
    ("bodies:\n  a: {box: [1, 1, 1], position: [0, 1]}", 2, r"expected a sequence of 3 \(x, y, z\), found"),
    ("bodies:\n  a: {box: [1, 1, 1], rpy: [0]}", 2, r"expected a sequence of 3 \(roll, pitch, yaw\), found"),
    (
        "bodies:\n  a: {box: [1, 1, 1], quaternion_wxyz: [0, 0, 0]}",
        2,
        r"expected a sequence of 4 \(w, x, y, z\), found",
    ),
    ("bodies:\n  a: {box: [1, 1, 1], attach: {touch: []}}", 2, "attach: expected the key link, found touch"),
    ("bodies:\n  a: {box: [1, 1, 1], attach: hand}", 2, "attach: expected a mapping, found 'hand'"),
    ("bodies:\n  a: {box: [1, 1, 1], attach: {link: }}", 2, "attach/link: expected a name, found nothing"),
    ("bodies:\n  a: {points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}", 2, "points: .*expected"),
    ("bodies:\n  a: {points: []}", 2, "points: .*expected"),
    ("bodies:\n  a: {mesh: none.stl}", 2, "mesh: .*none.stl: expected a mesh file, but there is no such file"),
    ("bodies:\n  a: {mesh: scene.yaml}", 2, "mesh: .*scene.yaml: expected one of .stl"),
    ("bodies:\n  a: {mesh: parts/part.stl, scale: 0}", 2, "scale: expected factors other than 0"),
    ("bodies:\n  a: {mesh: parts/part.stl, decompose: maybe}", 2, "expected true or false, found 'maybe'"),
    ("bodies:\n  a: {saved: kept.npz, sha256: 12}", 2, "sha256: expected 64 hexadecimal digits, found '12'"),
    ("bodies:\n  a: {box: [1, 1, 1], sha256: 12}", 2, "found 'sha256'"),
    ("bodies:\n  a: {saved: none.npz}", 2, "saved: .*none.npz: expected a saved file, but there is no such file"),
    ("bodies:\n  '': {box: [1, 1, 1]}", 2, "bodies/: name: expected a name, found ''"),
    ("bodies:\n  [a, b]: {box: [1, 1, 1]}", 2, "bodies: expected a name as key, found a sequence of 2"),
    ("bodies:\n  a: !box {box: [1, 1, 1]}", 2, "expected a mapping, found the tag !box"),
    ("x: !!python/object/apply:os.getcwd []\nbodies: {}", 1, "found 'x'"),
    ("bodies: !!python/object/apply:os.getcwd []", 1, "found the tag tag:yaml.org,2002:python/object/apply"),
    ("bodies:\n  a: &a {box: [1, 1, 1]}\n  b:\n    <<: *a", 4, "found the tag tag:yaml.org,2002:merge"),
    ("bodies: {a: &p {points: *p}}", 1, "bodies/a/points: expected a sequence"),
    ("bodies:\n\ta: 1", 2, "expected YAML, found a fault"),
    ("bodies: {\n", 2, "expected YAML, found a fault"),
    ("bodies: {}\n---\nbodies: {}", 2, "found several, separated by ---"),
    ("bodies: {}\nmargin: *none", 2, "undefined alias"),
]


@pytest.mark.parametrize(("text", "line", "message"), MALFORMED)
def test_malformed_scenes_are_refused_with_line_and_key(folder, text, line, message):
    """Every malformed scene is refused with its line, its key, what was expected and what was found."""
    with pytest.raises(FileError, match=rf"scene.yaml, line {line}:.*{message}"):
        read(folder, text)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"# only a comment\n",
        b"\xff\xfe\x00",
        b"bodies: \x00",
        b"bodies: {a: \xff}",
        b'bodies: {"\\UFFFFFFFF": 1}',
        b'bodies: {"\\U00110000": 1}',
        b"[" * 20000,
    ],
    ids=["empty", "comment", "utf16", "nul", "not-utf8", "no-character", "beyond-unicode", "deep"],
)
def test_files_that_are_no_yaml_are_refused(folder, data):
    """Bytes that are no YAML scene are a FileError that names the file."""
    (folder / "scene.yaml").write_bytes(data)
    with pytest.raises(FileError, match="scene.yaml"):
        load_scene(folder / "scene.yaml")


def test_missing_scene_file(tmp_path):
    """A missing file and a directory are refused as what they are."""
    with pytest.raises(FileError, match="none.yaml: expected a scene in YAML, but there is no such file"):
        load_scene(tmp_path / "none.yaml")
    with pytest.raises(FileError, match="found a directory"):
        load_scene(tmp_path)


@examples(15, 40)
@given(
    st.integers(0, len(EVERYTHING) - 1),
    st.integers(0, 12),
    st.sampled_from(["", " ", "\n", "[", "}", "0", "-", "&", "x"]),
)
def test_damaged_scenes_never_end_in_another_error(tmp_path_factory, start, cut, insert):
    """Whatever is cut out of a scene and put in its place: it is read, or refused by a FileError."""
    folder = tmp_path_factory.mktemp("damaged")
    text = EVERYTHING[:start] + insert + EVERYTHING[start + cut :]
    text = text.replace("mesh: parts/part.stl, scale", "box").replace("saved: kept.npz", "box: [1, 1, 1]")
    with suppress(FileError):
        assert isinstance(read(folder, text), Scene)


def test_missing_package_is_named(folder, monkeypatch):
    """Without PyYAML the error names the package to install."""
    monkeypatch.setitem(sys.modules, "yaml", None)
    for ask in (load_scene, lambda file: save_scene(Scene(), file)):
        with pytest.raises(loewner.MissingExtraError, match=r"PyYAML: pip install \"loewner\[robots\]\""):
            ask(folder / "scene.yaml")


def test_equal_meshes_are_read_once(folder):
    """Entries with the same mesh and scale share one body."""
    scene = read(
        folder,
        """bodies:
  a: {mesh: parts/part.stl}
  b: {mesh: parts/part.stl, position: [1, 0, 0]}
  c: {mesh: parts/part.stl, scale: 2}
""",
    )
    assert scene["a"] is scene["b"]
    assert scene["a"] is not scene["c"]


def test_decompose_is_passed_on(folder):
    """Two boxes in one file: two pieces, or one hull."""
    boxes = [trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((x, 0, 0)) for x in (0, 1)]
    trimesh.util.concatenate(boxes).export(folder / "two.stl")
    scene = read(folder, "bodies:\n  parts: {mesh: two.stl}\n  hull: {mesh: two.stl, decompose: false}")
    assert (len(scene["parts"].pieces), len(scene["hull"].pieces)) == (2, 1)


@examples(3, 15)
@given(st.integers(0, 2**32 - 1))
def test_scaled_mesh_is_the_mesh_of_scaled_vertices(seed):
    """`scale` of from_mesh, mirrors included, against trimesh's own."""
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0.2, 3, 3) * rng.choice([-1, 1], 3)
    mesh = trimesh.creation.annulus(0.5, 1.0, 0.4)
    body = Body.from_mesh(mesh, scale=factors, decompose=False)
    scaled = trimesh.Trimesh(mesh.vertices * factors, mesh.faces, process=False)
    assert same_bodies(body, Body.from_mesh(scaled, decompose=False))


@pytest.mark.parametrize("scale", [0, [1, 0, 1], [1, 2], float("nan"), "wide"])
def test_bad_scales(scale):
    """A scale has to be one or three finite factors other than zero."""
    with pytest.raises(loewner.InputError, match="scale: expected"):
        Body.from_mesh(trimesh.creation.box((1, 1, 1)), scale=scale)


# -- MotionBenchMaker ---------------------------------------------------------------------------

YAW = [0.0, 0.0, np.sin(0.25), np.cos(0.25)]


def problems() -> dict:
    """Two groups of one problem each, in the form of the data set."""
    place = {"position": [0.5, 0.1, 0.2], "orientation_euler_xyz": [0.0, -0.0, 0.5], "orientation_quat_xyzw": YAW}
    can = {"name": "can", "length": 0.14, "radius": 0.03} | place
    shelf = {"name": "shelf", "half_extents": [0.1, 0.2, 0.3]} | place
    ball = {"name": "ball", "radius": 0.2, "position": [1.0, 0.0, 0.0]}
    tilted = {"name": "tilted", "half_extents": [0.1, 0.2, 0.3], "position": [0, 0, 0]}
    tilted["orientation_euler_xyz"] = [0.3, -0.2, 0.1]
    common = {"start": [0, 0.5], "goals": [[1.0, 2.0], [3.0, 4.0]]}
    return {
        "robot": "arm",
        "joints": ["j1", "j2"],
        "problems": {
            "shelf": [
                {"sphere": [ball], "cylinder": [can], "box": [shelf], "index": 1, "problem": "shelf", "valid": True}
                | common
            ],
            "tilted": [{"box": [tilted], "index": 7, "problem": "tilted"} | common],
        },
    }


def write(tmp_path: Path, content: dict) -> Path:
    (tmp_path / "problems.json").write_text(json.dumps(content))
    return tmp_path / "problems.json"


def test_problems_are_read(tmp_path):
    """Names, ends, bodies and poses of planning problems are read as they are written."""
    first, second = read_motion_bench_maker(write(tmp_path, problems()))
    assert (first.group, first.index, first.robot, first.valid) == ("shelf", 1, "arm", True)
    assert (second.group, second.index, second.robot, second.valid) == ("tilted", 7, "arm", None)
    assert first.joint_names == ("j1", "j2")
    np.testing.assert_array_equal(first.start, [0, 0.5])
    np.testing.assert_array_equal(first.goals, [[1, 2], [3, 4]])
    assert set(first.scene) == {"ball", "can", "shelf"}
    assert same_bodies(first.scene["ball"], Body.sphere(0.2))
    assert same_bodies(first.scene["can"], Body.cylinder(0.03, 0.14))
    assert same_bodies(first.scene["shelf"], Body.box([0.2, 0.4, 0.6]))
    assert second.scene["tilted"] is first.scene["shelf"]
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
    expected[:3, 3] = 0.5, 0.1, 0.2
    np.testing.assert_allclose(first.scene.pose("can"), expected, atol=1e-15)
    fixed_axes = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix()
    np.testing.assert_allclose(second.scene.pose("tilted")[:3, :3], fixed_axes, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.pop("start"), r"\[0\]: expected the key start"),
        (lambda p: p.update(start=[0]), r"\[0\]/start: expected a sequence of 2, found a sequence of 1"),
        (lambda p: p.update(start=[0, "x"]), r"start\[1\]: expected a number, found 'x'"),
        (lambda p: p.update(start=[0, True]), r"start\[1\]: expected a number, found True"),
        (lambda p: p.update(start=[0, float("nan")]), r"start\[1\]: expected a finite number, found nan"),
        (lambda p: p.update(start=[0, 10**400]), r"start\[1\]: expected a finite number"),
        (lambda p: p.update(goals=[[0, 0], [0]]), r"goals\[1\]: expected a sequence of 2"),
        (lambda p: p.update(mesh=[]), "expected keys among sphere, box, cylinder, .*, found 'mesh'"),
        (lambda p: p["box"][0].pop("half_extents"), r"box\[0\]: expected the key half_extents"),
        (lambda p: p["box"][0].update(half_extents=[1, 1, -1]), r"box\[0\]: size: expected numbers > 0"),
        (lambda p: p["box"][0].update(name="can"), r"expected a new name, found 'can'"),
        (lambda p: p["box"][0].update(name=3), r"name: expected a name, found 3"),
        (
            lambda p: p["box"][0].update(orientation_quat_xyzw=[0, 0, 1, 1]),
            r"box\[0\]/orientation_quat_xyzw: quaternion: expected",
        ),
        (lambda p: p["box"][0].update(orientation_quat_wxyz=[1, 0, 0, 0]), "found 'orientation_quat_wxyz'"),
        (lambda p: p["cylinder"][0].update(radius="wide"), r"cylinder\[0\]/radius: expected a number"),
        (lambda p: p.update(box={}), r"box: expected a sequence, found a mapping of 0"),
        (lambda p: p.update(index="one"), "index: expected a whole number"),
        (lambda p: p.update(valid=1), "valid: expected true or false"),
    ],
)
def test_malformed_problems_are_refused_with_place(tmp_path, change, message):
    """Every malformed problem is refused with its place in the file."""
    content = problems()
    change(content["problems"]["shelf"][0])
    with pytest.raises(FileError, match=rf"problems.json: problems/shelf.*{message}"):
        read_motion_bench_maker(write(tmp_path, content))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: expected JSON"),
        ("{}", "expected the key robot, found none"),
        ("[]", "expected a mapping"),
        ('{"robot":\n}', "line 2: expected JSON"),
        ('{"robot": "a",\n"robot": "b"}', "line 2: expected each key once in a mapping, found 'robot' again"),
        ("[" * 200000, "problems.json"),
        ("1" * 5000, "problems.json"),
    ],
)
def test_files_that_are_no_problems_are_refused(tmp_path, text, message):
    """Text that is no file of problems is a FileError that says why."""
    (tmp_path / "problems.json").write_text(text)
    with pytest.raises(FileError, match=message):
        read_motion_bench_maker(tmp_path / "problems.json")


def test_geometry_faults_are_told_as_file_faults(folder):
    """GeometryError is what Body.from_points raises; a reader of files catches FileError."""
    with pytest.raises(GeometryError):
        Body.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    with pytest.raises(FileError, match="line 3: bodies/flat/points"):
        read(folder, "bodies:\n  flat:\n    points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]")


@pytest.mark.verify
@pytest.mark.skipif("LOEWNER_MBM" not in os.environ, reason="LOEWNER_MBM names no file of MotionBenchMaker problems")
def test_whole_data_set(tmp_path):
    """All 700 problems for Panda: read, counted, both orientations agree, and a scene survives its YAML."""
    file = Path(os.environ["LOEWNER_MBM"])
    found = read_motion_bench_maker(file)
    content = json.loads(file.read_text())
    assert len(found) == sum(map(len, content["problems"].values())) == 700
    assert {p.start.shape for p in found} == {(7,)}
    assert len({id(p.scene[name]) for p in found for name in p.scene}) == 22
    raw = [problem for group in content["problems"].values() for problem in group]
    for problem, entry in zip(found, raw, strict=True):
        obstacles = [o for kind in ("sphere", "box", "cylinder") for o in entry[kind]]
        assert len(problem.scene) == len(obstacles)
        for obstacle in obstacles:
            fixed_axes = Rotation.from_euler("xyz", obstacle["orientation_euler_xyz"]).as_matrix()
            np.testing.assert_allclose(problem.scene.pose(obstacle["name"])[:3, :3], fixed_axes, atol=1e-14)
    for problem in found[::100]:
        save_scene(problem.scene, tmp_path / "scene.yaml")
        same_scenes(load_scene(tmp_path / "scene.yaml"), problem.scene)


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("# units: mm", "lengths in metres, found 'units: mm' in a comment"),
        ("# z,y,x", "columns x, y and z, found '# z,y,x' in a comment"),
        ("#Y X Z intensity", "columns x, y and z, found '#Y X Z intensity' in a comment"),
        ("# x y z", None),
        ("# units: m, from the scanner", None),
        ("# x, z", None),
    ],
)
def test_comments_above_a_cloud(comment, message, tmp_path):
    """Another unit, and columns in another order, are told; the numbers stay what they are."""
    (tmp_path / "cloud.xyz").write_text(f"{comment}\n1 2 3\n4 5 6\n")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert read_array(tmp_path / "cloud.xyz").tolist() == [[1, 2, 3], [4, 5, 6]]
    assert len(told) == (message is not None)
    assert all(message in str(one.message) and "cloud.xyz" in str(one.message) for one in told)


@pytest.mark.parametrize("again", ["[part, table, 0.05]", "{of: [table, part], margin: 0.05}", "[table, 0.02]"])
def test_margins_given_twice_are_refused(tmp_path, again):
    """The last one would replace the others, and could be the smallest."""
    text = f"""bodies:
  table: {{box: [1, 1, 0.1], margin: 0.3}}
  part: {{box: [0.1, 0.1, 0.1], position: [0, 0, 0.3]}}
margins:
- [table, part, 0.3]
- {again}
"""
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(FileError, match=r"line 6: margins\[1\]: expected one margin for the same names"):
        load_scene(tmp_path / "s.yaml")


def test_a_next_line_in_a_name_stays(tmp_path):
    """YAML reads it as a line end, unless it is escaped; then two names could become one."""
    scene = Scene()
    for name in ("arm\x85left", "arm left", "Ärmel"):
        scene.add(name, Body.sphere(0.1))
    linked = Scene()
    linked.allow("hand\x85l", "hand l")
    for one in (scene, linked):
        save_scene(one, tmp_path / "s.yaml")
        found = load_scene(tmp_path / "s.yaml")
        assert (found.names, found.allowed) == (one.names, one.allowed)
