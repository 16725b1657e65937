"""The JSON Schema of scene files accepts what the reader reads, and refuses what is malformed."""

import json
import random
import re
from pathlib import Path

import fastjsonschema
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from loewner import FileError, InputError, Scene, load_scene, save_scene
from loewner._base._nodes import NUMBER, read_yaml
from loewner.cli import main
from loewner.scenes.files import yaml_scenes
from loewner.scenes.files.schema import BODY, SCHEMA, SCHEMA_FILE, keys_of
from loewner.scenes.files.sensor_shapes import SENSOR_SHAPES
from sampling import examples
from test_scene_files import EVERYTHING, MALFORMED

ROOT = Path(__file__).parents[1]

# Faults that no schema can see: in YAML itself, in files, in rotations and bodies, and in names.
BEYOND = "|".join(
    (
        "expected YAML|found several|undefined alias|the tag|each key once|name as key|expected a name, found ''",
        "there is no such file|expected one of .stl|unit quaternion|expected a rot|two names|with a pair",
        "points: .*expected|factors other than 0",
    )
)

# The same keys in one document that needs no files.
VALID = {
    "margin": 0.01,
    "bodies": {
        "a": {"box": [1, 1, 1], "position": [0, 0, 1], "rpy": [0, 0, 1], "margin": 0.1, "error": [0.01, 0]},
        "b": {"cylinder": {"radius": 1, "length": 1}, "quaternion_wxyz": [1, 0, 0, 0], "position": [5, 0, 0]},
        "c": {"sphere": {"radius": 1}, "attach": {"link": "hand", "touch": ["finger"], "leave": ["a"], "reach": ["b"]}},
        "d": {
            "ellipsoid": [1, 2, 3],
            "follow": {
                "poses": [{"time": 0, "position": [0, 0, 0]}, {"time": 1, "position": [1, 0, 0], "rpy": [0, 0, 1]}],
                "repeat": False,
                "speed": 1,
                "turn": 0,
                "since": 0,
                "error": [0.1, 0],
            },
        },
        "e": {"half_space": {"normal": [0, 0, 1], "offset": 0, "extent": 10}},
        "f": {"spheres": [[0, 0, 0, 1]]},
        "g": {"boxes": [[0, 0, 0, 1, 1, 1]]},
        "h": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]},
        "i": {"capsule": {"radius": 1, "length": 1}},
        "j": {"cone": {"radius": 1, "length": 1}},
    },
    "allow": [["a", "b"]],
    "margins": [
        ["b", 0.1],
        ["a", "b", 0.2],
        {"of": ["f"], "margin": 0.1, "lower": True},
        {"margin": 0, "against": "links"},
    ],
}

accepts = fastjsonschema.compile(SCHEMA)


def faulty(document):
    """Whether the schema refuses a document."""
    try:
        accepts(document)
    except fastjsonschema.JsonSchemaValueException:
        return True
    return False


def plain(node):
    """A place of a scene file as JSON, by the rules of its reader."""
    if node.kind == "mapping":
        return {str(key.value): plain(type(node)(node.file, value)) for key, value in node.raw.value}
    if node.kind == "sequence":
        return [plain(type(node)(node.file, value)) for value in node.raw.value]
    value = node.raw.value
    if node.raw.style is None and NUMBER.fullmatch(value):
        return float(value)
    return None if value == "" else value.lower() == "true" if value.lower() in ("true", "false") else value


def document(text):
    return plain(read_yaml(text.encode(), Path("scene.yaml"), "a scene"))


def test_the_readers_tables_are_the_schemas():
    """Shapes and their sizes are those of the code that makes them; other keys are the schema's own."""
    made = {*yaml_scenes.AXIS_SHAPES, *yaml_scenes.ROUND_SHAPES, *SENSOR_SHAPES, "points", "mesh", "saved"}
    assert set(yaml_scenes.SHAPES) == made
    for shape, (_, names) in yaml_scenes.ROUND_SHAPES.items():
        assert keys_of(shape) == (names, names)
    assert set(yaml_scenes.POSE_KEYS) <= set(yaml_scenes.BODY_KEYS)
    for shape, keys in yaml_scenes.KEYS_OF_SHAPES.items():
        for key in keys:
            rule = BODY["dependencies"][key]
            assert shape in (rule if isinstance(rule, list) else rule["required"])


def test_all_scenes_here_are_accepted(tmp_path):
    """The scene with every key, the valid document, the scenes on pages, and what is saved from a scene."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    blocks = [
        text for page in pages for text in re.findall(r"^```yaml\n(.*?)^```$", page.read_text(), flags=re.M | re.S)
    ]
    scenes = [text for text in blocks if re.search(r"^bodies:", text, flags=re.M)]
    assert len(scenes) >= 2
    for text in (EVERYTHING, yaml.safe_dump(VALID), *scenes):
        accepts(document(text))
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(VALID))
    save_scene(load_scene(tmp_path / "scene.yaml"), tmp_path / "again.yaml")
    accepts(document((tmp_path / "again.yaml").read_text()))
    save_scene(Scene(), tmp_path / "empty.yaml")
    accepts(document((tmp_path / "empty.yaml").read_text()))


@pytest.mark.parametrize("text", [text for text, _, message in MALFORMED if not re.search(BEYOND, message)])
def test_malformed_scenes_are_refused_by_the_schema(text):
    """Each fault that the reader's tests name is one for the schema, unless it is beyond any schema."""
    assert faulty(document(text))


@pytest.mark.parametrize(
    "body",
    [
        {"box": [1, 1, 1], "position": [0, 0, 0], "follow": {"poses": [{"time": 0}]}},
        {"box": [1, 1, 1], "error": [0, 0], "attach": {"link": "hand"}},
        {"box": [0, 1, 1]},
        {"mesh": "a.stl", "radius": 0.1},
        {"mesh": "a.stl", "solid": True, "model": "hull"},
        {"mesh": "a.stl", "model": "hull", "decompose": True},
        {"mesh": "a.stl", "model": "points"},
        {"cloud": {"file": "a.npy"}},
        {"cloud": {"file": "a.npy", "radius": 1, "voxel": 1}},
        {"sphere": {"radius": 1}, "follow": {"poses": []}},
    ],
)
def test_combinations_are_refused_by_both(body, tmp_path):
    """Keys that exclude or need each other do so in the schema and in the reader."""
    scene = {"bodies": {"a": body}}
    assert faulty(scene)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    with pytest.raises(FileError):
        load_scene(tmp_path / "scene.yaml")


def places(value, path=()):
    """Paths to all values of a document."""
    yield path
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in inside:
        yield from places(each, (*path, key))


@examples(12, 75)
@given(st.integers(0, 10**6))
def test_the_schema_never_refuses_what_is_read(tmp_path_factory, seed):
    """One or two values of a scene are replaced, removed or moved: if the reader accepts it, so does the schema."""
    choose = random.Random(seed)
    changed = json.loads(json.dumps(VALID))
    for _ in range(choose.choice([1, 2])):
        *above, key = choose.choice([path for path in places(changed) if path])
        target = changed
        for step in above:
            target = target[step]
        some = [0, -1, 0.5, "a", "links", True, [], {}, [1, 1, 1], [1, 2], {"radius": 1}, None]
        if choose.random() < 0.3:
            del target[key]
        elif isinstance(target, dict) and choose.random() < 0.4:
            target[choose.choice([*BODY["properties"], "time", "radius"])] = target.pop(key)
        else:
            target[key] = choose.choice(some)
    folder = tmp_path_factory.mktemp("scene")
    (folder / "scene.yaml").write_text(yaml.safe_dump(changed))
    try:
        load_scene(folder / "scene.yaml")
    except (FileError, InputError):
        return
    assert not faulty(document((folder / "scene.yaml").read_text()))


def test_the_command_line_prints_where_the_schema_is(capsys):
    """The path is for an editor's settings."""
    with pytest.raises(SystemExit):
        main(["--scene-schema"])
    assert capsys.readouterr().out == f"{SCHEMA_FILE}\n"
