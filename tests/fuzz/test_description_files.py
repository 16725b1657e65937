"""Descriptions of robots and scenes that are damaged, hostile or absurd: read, or refused by a child of LoewnerError.

What is accepted has finite poses at random configurations within its limits, and a checker whose answers agree with
one another; where pinocchio reads the same URDF, its links stand in the same places.
"""

import copy
import functools
import json
import os
import random
import re
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

import driver
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    Robot,
    Scene,
    UnknownNameError,
    Verdict,
    load_scene,
    read_motion_bench_maker,
    save_scene,
)
from loewner._kernels.tolerances import ROTATION_TOLERANCE
from robot_oracle import disagreement
from sampling import quick

URDF = """<?xml version="1.0" encoding="UTF-8"?>
<robot name="r">
<link name="base"><collision><geometry><box size="0.4 0.4 0.1"/></geometry></collision></link>
<link name="a"><collision><origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><geometry><cylinder radius="0.05" length="0.3"/>
</geometry></collision><collision><geometry><sphere radius="0.08"/></geometry></collision></link>
<link name="b"><collision><geometry><mesh filename="part.stl" scale="1 -1 1"/></geometry></collision></link>
<link name="c"><visual><geometry><sphere radius="1"/></geometry></visual></link>
<link name="d"><collision><geometry><capsule radius="0.03" length="0.2"/></geometry></collision></link>
<link name="e"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
</joint>
<joint name="lift" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0" rpy="0 1.5 0"/>
<axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="1" velocity="1"/></joint>
<joint name="weld" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0 0.1 0"/></joint>
<joint name="bend" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0.2 0 0"/><axis xyz="1 1 0"/>
<limit lower="-2" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="follow" type="revolute"><parent link="d"/><child link="e"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="bend" multiplier="-0.5" offset="0.1"/></joint>
</robot>
"""
SRDF = """<?xml version="1.0"?>
<robot name="r">
<group name="arm"><chain base_link="base" tip_link="d"/></group>
<group name="hand"><link name="e"/><joint name="bend"/></group>
<group name="all"><group name="arm"/><group name="hand"/></group>
<group_state name="home" group="arm"><joint name="turn" value="0.5"/><joint name="bend" value="-1"/></group_state>
<disable_collisions link1="base" link2="a" reason="Adjacent"/>
<disable_collisions link1="a" link2="b" reason="Adjacent"/>
<disable_default_collisions link="e"/><enable_collisions link1="e" link2="base"/>
<virtual_joint name="world" type="fixed" parent_frame="world" child_link="base"/>
</robot>
"""
YAML = """margin: 0.01
bodies:
  table: {box: [1.2, 0.8, 0.04], position: [0.6, 0, 0.4], rpy: [0.1, -0.2, 0.3]}
  can: &can
    cylinder: {radius: 0.03, length: 0.14}
    position: [0, 0, 1e-1]
    quaternion_wxyz: [0.7071, 0.7071, 0, 0]
  held: {capsule: {radius: 0.1, length: 0.2}, attach: {link: hand, touch: [finger]}}
  ball: {sphere: {radius: 0.1}, pose: [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], margin: 0.2}
  egg: {ellipsoid: [0.1, 0.2, 0.3], position: &p [0, 0, 5]}
  hat: {cone: {radius: 0.1, length: 0.2}, position: *p}
  rock: {points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], position: [0, 0, 8]}
  part: {mesh: part.stl, scale: [1, -2, 0.5], decompose: false, position: [0, 0, 10]}
  kept: {saved: kept.npz, position: [0, 0, 12]}
  twin: *can
allow: [[table, hand], [egg, ball]]
margins: [[table, egg, 0.05], [hand, 0.02]]
"""
PROBLEM = {
    "box": [{"name": "board", "half_extents": [0.5, 0.2, 0.01], "position": [0.5, 0, 0.3],
             "orientation_quat_xyzw": [0, 0, 0.6, 0.8], "orientation_euler_xyz": [0, 0, 1.287]}],
    "cylinder": [{"name": "can", "radius": 0.03, "length": 0.1, "position": [0.4, 0, 0.5],
                  "orientation_euler_xyz": [0, 1.5, 0]}],
    "sphere": [{"name": "ball", "radius": 0.1, "position": [1, 1, 1]}],
    "index": 1, "problem": "shelf", "start": [0.0, 0.1], "goals": [[1.0, 0.5], [0.5, 1.0]], "valid": True,
}  # fmt: skip
JSON = json.dumps({"robot": "r", "joints": ["one", "two"], "problems": {"shelf": [PROBLEM], "none": []}}, indent=1)
TEXTS = {"urdf": URDF, "srdf": SRDF, "yaml": YAML, "json": JSON}

# What stands where a number, a name or a whole value stood.
VALUES = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "-1e308", "1e200", "1e12", "1e-320", "1e-150", "0", "-0", "-1",
    "1e16", "", " ", "x", "1_0", "0x10", "9" * 400, "1 2", "1 2 3 4", "٣", "\u00a0", "true", "null", "~", ".inf", "[]",
    "{}", "n" * 300, "../../..", "/dev/zero", "package://x/y", "<", "&amp;", "\\ud800", "\\u0000",
    "!!python/object:os.system", "*can", "floating", "planar", "fixed", "mesh", "base", "e", "bend", "follow", "turn",
    "arm", "all",
)  # fmt: skip
OTHERS = (None, True, -1, 0, 1e308, 10**400, float("nan"), "x", [], {}, [[1, 2, 3]], {"radius": 1}, 1e-310)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
WORD = re.compile(r"[A-Za-z_]+")
# One file in so many is not damaged but made to explode.
HOSTILE = 11
COUNT, SHORT = 6000, 60
CONFIGURATIONS = 12


# -- mutations ------------------------------------------------------------------------------------


def mutated(kind: str, seed: int) -> bytes:
    """A file of a kind, damaged in one way or several."""
    rng = random.Random(f"{kind} {seed}")
    if seed % HOSTILE == 0:
        return {"urdf": hostile_urdf, "srdf": hostile_srdf, "yaml": hostile_yaml, "json": hostile_json}[kind](
            rng
        ).encode()
    text = TEXTS[kind]
    if rng.random() < 0.5:
        grown = {"urdf": of_elements, "srdf": of_elements, "yaml": of_yaml, "json": of_json}[kind]
        text = grown(text, rng)
    for _ in range(rng.choice([0, 0, 0, 1, 2] if text != TEXTS[kind] else [1, 1, 1, 2, 5])):
        text = rng.choice([number, number, scaled, scaled, scaled, word, swapped, lines, nested, piece])(text, rng)
    return of_bytes(text, rng)


def number(text: str, rng: random.Random) -> str:
    return replaced(text, list(NUMBER.finditer(text)), rng)


def scaled(text: str, rng: random.Random) -> str:
    """A number of another size."""
    at = rng.choice(list(NUMBER.finditer(text)) or [None])
    if at is None:
        return text
    return (
        f"{text[: at.start()]}{float(at[0]) * rng.uniform(-2, 2) * 10.0 ** rng.randrange(-3, 15):g}{text[at.end() :]}"
    )


def word(text: str, rng: random.Random) -> str:
    return replaced(text, list(WORD.finditer(text)), rng)


def replaced(text: str, found: list[re.Match[str]], rng: random.Random) -> str:
    if not found:
        return text
    at = rng.choice(found)
    return text[: at.start()] + rng.choice(VALUES) + text[at.end() :]


def swapped(text: str, rng: random.Random) -> str:
    """Two words change places."""
    found = list(WORD.finditer(text))
    if len(found) < 2:
        return text
    a, b = sorted(rng.sample(found, 2), key=re.Match.start)
    return text[: a.start()] + b[0] + text[a.end() : b.start()] + a[0] + text[b.end() :]


def lines(text: str, rng: random.Random) -> str:
    """A line is lost, there many times, or elsewhere."""
    rows = text.split("\n")
    line = rows.pop(rng.randrange(len(rows)))
    copies = rng.choice([0, 1, 2, 300])
    at = rng.randrange(len(rows) + 1)
    return "\n".join([*rows[:at], *[line] * copies, *rows[at:]])


def nested(text: str, rng: random.Random) -> str:
    """Something opens, very often."""
    opening, closing = rng.choice(
        [("<group>", "</group>"), ("[", "]"), ("{a: ", "}"), ('{"a": ', "}"), ("<!--", "-->")]
    )
    depth, at = rng.choice([3, 60, 3000]), rng.randrange(len(text) + 1)
    return text[:at] + opening * depth + rng.choice(["", closing * depth]) + text[at:]


def piece(text: str, rng: random.Random) -> str:
    """A piece is cut out, and put somewhere else or not at all; or the end is missing."""
    a, b = sorted(rng.randrange(len(text) + 1) for _ in range(2))
    b = min(b, a + rng.choice([1, 10, 200]))
    rest = text[:a] + text[b:]
    at = rng.randrange(len(rest) + 1)
    return rng.choice([rest, rest[:at] + text[a:b] + rest[at:], text[:a]])


def of_elements(text: str, rng: random.Random) -> str:
    """Elements of XML lost, twice, elsewhere; attributes lost or changed."""
    root = ET.fromstring(text)
    for _ in range(rng.choice([1, 1, 1, 3])):
        owners = [e for e in root.iter() if len(e)]
        owner = rng.choice(owners)
        child = rng.choice(list(owner))
        change = rng.randrange(5)
        if change == 0:
            owner.remove(child)
        elif change == 1:
            owner.append(copy.deepcopy(child))
        elif change == 2:
            rng.choice([e for e in root.iter() if e not in child.iter()]).append(copy.deepcopy(child))
        elif child.attrib:
            key = rng.choice(sorted(child.attrib))
            if change == 3:
                child.set(key, rng.choice(VALUES).replace("\x00", ""))
            else:
                del child.attrib[key]
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode").replace("><", ">\n<")


def of_yaml(text: str, rng: random.Random) -> str:
    return str(yaml.safe_dump(changed(yaml.safe_load(text), rng), sort_keys=False, allow_unicode=True))


def of_json(text: str, rng: random.Random) -> str:
    return json.dumps(changed(json.loads(text), rng), indent=1)


def changed(content, rng: random.Random):
    """Entries of nested lists and mappings lost, twice, elsewhere, or of another kind."""
    for _ in range(rng.choice([1, 1, 1, 3])):
        places = list(_places(content))
        owner, key = rng.choice(places)
        other = rng.choice(
            [None, True, -1, 0, 1e308, 10**400, float("nan"), "x", [], {}, [[1, 2, 3]], {"radius": 1}, 1e-310]
        )
        change = rng.randrange(4)
        if change == 0:
            del owner[key]
        elif change == 1:
            owner[key] = copy.deepcopy(other)
        elif change == 2:
            from_owner, from_key = rng.choice(places)
            with suppress(KeyError, IndexError):
                owner[key] = copy.deepcopy(from_owner[from_key])
        elif isinstance(owner, list):
            owner.insert(key, owner[key])
        else:
            owner[rng.choice(["x", "margin", "box", "sphere", "mesh", "position"])] = owner.pop(key)
        if not content:
            break
    return content


def _places(content):
    inside = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in inside:
        yield content, key
        if isinstance(value, (dict, list)):
            yield from _places(value)


def of_bytes(text: str, rng: random.Random) -> bytes:
    """Encoded, mostly as it says; sometimes bytes flip, or the end is missing."""
    encoding = rng.choice(["utf-8"] * 40 + ["utf-16", "utf-8-sig", "utf-32", "latin-1", "cp037"])
    data = bytearray(text.encode(encoding, "replace"))
    if rng.random() < 0.1:
        for _ in range(rng.choice([1, 1, 5])):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    if rng.random() < 0.05:
        del data[rng.randrange(len(data)) :]
    if rng.random() < 0.02:
        data[rng.randrange(len(data) + 1) : 0] = b"\0"
    return bytes(data)


# -- files that are made to explode -----------------------------------------------------------------


def hostile_urdf(rng: random.Random) -> str:
    """Long chains, limits, factors and names that are absurd, entities."""
    count = rng.choice([50, 1000, 10_000])
    makers = [
        lambda: f'<mimic joint="j{rng.choice([-1, 1])}" multiplier="{rng.choice(VALUES[:12])}"/>',
        lambda: f'<limit lower="{rng.choice(VALUES[:15])}" upper="{rng.choice(VALUES[:15])}"/>',
    ]
    choice = rng.randrange(6)
    if choice < 3:
        step = rng.choice([1, -1, 0])
        factor = rng.choice(["1", "-1", "1e3", "1e200"])
        inside = [
            f'<mimic joint="j{(k + step) % count}" multiplier="{factor}"/>' if choice == 0 and k else ""
            for k in range(count)
        ]
        kind = "fixed" if choice == 1 else "continuous"
        joints = "".join(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>{inside[k]}</joint>'
            for k in range(count)
        )
        return f'<robot name="r">{"".join(f"""<link name="l{k}"/>""" for k in range(count + 1))}{joints}</robot>'
    if choice == 3:
        insides = [rng.choice(makers)() for _ in range(2)]
        text = URDF.replace(
            '<limit lower="-2" upper="2.5" effort="1" velocity="1"/>', insides[0].replace("j-1", "turn")
        )
        return text.replace('multiplier="-0.5"', f'multiplier="{rng.choice(VALUES[:12])}"')
    if choice == 4:
        return URDF.replace(
            "part.stl", rng.choice(["n" * 300 + ".stl", ".", "/dev/zero", "/proc/self/mem", "x" * 5000])
        )
    entities = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(12))
    return f'<!DOCTYPE robot [<!ENTITY e0 "ha">{entities}]><robot name="&e{rng.choice([1, 12])};"/>'


def hostile_srdf(rng: random.Random) -> str:
    """Groups in chains and rings, each named more than once."""
    count, times, ring = rng.choice([40, 3000, 10_000]), rng.choice([1, 2]), rng.random() < 0.3
    groups = "".join(
        f'<group name="g{k}">{f"""<group name="g{(k + 1) % count if ring else k + 1}"/>""" * times}</group>'
        for k in range(count)
    )
    return f'<robot name="r">{groups}<group name="g{count}"><joint name="bend"/></group></robot>'


def hostile_yaml(rng: random.Random) -> str:
    """Aliases of aliases, depth, and names that no file can have."""
    levels, width = rng.choice([3, 30]), rng.choice([2, 10])
    bomb = "".join(f"- &a{k + 1} [{', '.join([f'*a{k}'] * width)}]\n" for k in range(levels))
    name = rng.choice(['"a\\0.stl"', '"\\ud800.stl"', "n" * 300 + ".stl", "/dev/zero", "/proc/self/mem", "."])
    return rng.choice([
        f"bodies: {{}}\nallow:\n- &a0 [x, y]\n{bomb}",
        f"bodies:\n  a: &a {{box: [1, 1, *b]}}\n  b: *a\nmargin: {'[' * rng.choice([40, 4000])}",
        f"bodies: {{a: {{{rng.choice(['mesh', 'saved'])}: {name}}}}}",
        f"bodies: {{a: &a {{box: *a}}, b: {'{a: ' * rng.choice([40, 4000])}",
    ])  # fmt: skip


def hostile_json(rng: random.Random) -> str:
    """Depth, and whole numbers without end."""
    depth = rng.choice([40, 900, 100_000])
    return rng.choice([
        "[" * depth,
        JSON.replace('"r"', "[" * depth + "]" * depth),
        JSON.replace("0.03", rng.choice(["1", "-9"]) + "0" * rng.choice([400, 5000])),
        JSON.replace('"index": 1', f'"index": {"7" * 4000}'),
    ])  # fmt: skip


# -- what has to hold -----------------------------------------------------------------------------


@functools.cache
def folder(process: int) -> Path:
    """A place for the files of one process."""
    path = Path(tempfile.mkdtemp(prefix="loewner-descriptions-"))
    trimesh.creation.box((0.1, 0.2, 0.3)).export(path / "part.stl")
    Body.union([Body.sphere(0.2), Body.box([0.1, 0.1, 1])]).save(path / "kept.npz")
    for kind, text in TEXTS.items():
        (path / f"good.{kind}").write_text(text)
    return path


def written(kind: str, data: bytes) -> Path:
    path = folder(os.getpid()) / f"case.{kind}"
    path.write_bytes(data)
    return path


def robot_of(kind: str, path: Path) -> Robot:
    if kind == "urdf":
        return Robot.from_urdf(path, cache=False)
    return Robot.from_urdf(path.with_name("good.urdf"), srdf=path, cache=False)


def checked(case: tuple[str, int]) -> str | None:
    """What is wrong with what was read from a damaged file."""
    kind, seed = case
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        path = written(kind, mutated(kind, seed))
        if kind in ("urdf", "srdf"):
            return fault_of_robot(robot_of(kind, path))
        if kind == "yaml":
            return fault_of_saved(load_scene(path), path.with_name("again.yaml"))
        return next(filter(None, map(fault_of_problem, read_motion_bench_maker(path))), None)


def fault_of_robot(robot: Robot) -> str | None:
    Q = robot.random_configurations(CONFIGURATIONS)
    if not ((robot.lower <= Q) & (robot.upper >= Q)).all():
        return "samples outside the limits"
    T = robot.forward_kinematics(Q)
    if not np.isfinite(T).all():
        return "poses that are no numbers"
    R = T[..., :3, :3]
    if np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max(initial=0.0) > ROTATION_TOLERANCE:
        return "poses that are not rigid"
    for values in robot.states.values():
        robot.configuration({**values[1]})
    if not robot.bodies:
        return None
    scene = Scene()
    scene.add("post", Body.box([0.2, 0.2, 2.0]))
    checker = CollisionChecker(robot, scene)
    colliding, verdicts, settled = checker.collide(Q), checker.classify(Q), checker.tiers(Q)
    if settled.total != len(Q) or settled.colliding != colliding.sum():
        return "tiers that do not add up"
    if (colliding & (verdicts == Verdict.FREE)).any() or (~colliding & (verdicts == Verdict.COLLIDING)).any():
        return "a certified verdict that the exact one contradicts"
    if not (colliding == checker.collide_by_pair(Q).any(axis=-1)).all():
        return "pairs that contradict the whole"
    if checker.checked_pairs:
        found = checker.distance(Q)
        if not (found.lower <= found.upper).all():
            return "bounds that are none"
    return None


def fault_of_scene(scene: Scene) -> str | None:
    if not np.isfinite(scene.static_poses).all():
        return "poses that are no numbers"
    return None if scene.collide(0.0) == bool(scene.pairs(0.0)) else "pairs that contradict the whole"


def fault_of_saved(scene: Scene, path: Path) -> str | None:
    fault = fault_of_scene(scene)
    if fault is None:
        save_scene(scene, path)
        again = load_scene(path)
        if again.names != scene.names or again.margins != scene.margins or again.collide(0.0) != scene.collide(0.0):
            return "a scene that is another one when it is saved"
    return fault


def fault_of_problem(problem) -> str | None:
    width = len(problem.joint_names)
    if problem.start.shape != (width,) or problem.goals.shape[1:] != (width,):
        return "configurations of another width"
    if not (np.isfinite(problem.start).all() and np.isfinite(problem.goals).all()):
        return "configurations that are no numbers"
    return fault_of_scene(problem.scene)


def beside_pinocchio(case: tuple[str, int]) -> str | None:
    """Where the links of an accepted robot are, compared with pinocchio's, if that reads the file as well."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        path = written("urdf", mutated(*case))
        robot = Robot.from_urdf(path, cache=False)
        Q = robot.random_configurations(5)
        size = max(1.0, float(np.abs(robot.forward_kinematics(Q)).max()))
        # The multiple of an angle is rounded, by more than a pose may be off where it is some billions of turns.
        angle = np.abs(robot.tree.multiplier).max() * np.abs(Q).max(initial=0.0) + np.abs(robot.tree.offset).max()
        tolerance = (1e-9 + 4 * np.finfo(float).eps * angle) * size
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # it writes to standard error what it does not like
        try:
            difference = disagreement(robot, path, 5)
        except Exception:  # it refuses the file, or has no link of that name
            raise UnknownNameError("pinocchio does not read it") from None
    return None if difference <= tolerance else f"a pose {difference:g} from pinocchio's"


def cases(count: int) -> list[tuple[str, int]]:
    """Half of them URDF."""
    kinds = ("urdf", "srdf", "urdf", "yaml", "urdf", "json")
    return [(kinds[k % len(kinds)], k) for k in range(count)]


def campaign(count: int) -> str:
    """Run it; the line about it."""
    for kind in TEXTS:  # compiled kernels are read here, once, and not by each process
        assert checked_as_is(kind) is None
    asked = cases(count)
    outcomes = driver.run(checked, asked)
    assert driver.faults(outcomes) == ""
    tally = Counter(outcome.kind for outcome in outcomes)
    sound = [outcome.case for outcome in outcomes if outcome.kind == driver.OK]
    accepted = [(kind, seed) for kind, seed in sound if kind == "urdf" and seed % HOSTILE]
    assert tally[driver.OK] > count / 50  # else nothing but the reader was tried
    assert tally[driver.REFUSED] > count / 50
    beside = driver.run(beside_pinocchio, accepted[: count // 10])
    # Pinocchio may crash or hang by itself.
    wrong = [outcome for outcome in beside if outcome.kind in (driver.WRONG, driver.RAW)]
    assert driver.faults(wrong) == ""
    read = sum(outcome.kind == driver.OK for outcome in beside)
    return (
        f"descriptions: {count} damaged URDF, SRDF, YAML and JSON files: {tally[driver.REFUSED]} refused, "
        f"{tally[driver.OK]} read and sound, 0 faults; of {len(beside)} robots read, pinocchio reads {read}, with the "
        "same poses"
    )


def checked_as_is(kind: str) -> str | None:
    path = written(kind, TEXTS[kind].encode())
    if kind in ("urdf", "srdf"):
        return fault_of_robot(robot_of(kind, path))
    if kind == "yaml":
        return fault_of_saved(load_scene(path), path.with_name("again.yaml"))
    return next(filter(None, map(fault_of_problem, read_motion_bench_maker(path))), None)


@pytest.mark.parametrize("count", quick(12, 60))
def test_some_damaged_descriptions(count):
    """A small part of the campaign below."""
    pytest.importorskip("pinocchio")
    campaign(count)


@pytest.mark.fuzz
def test_many_damaged_descriptions():
    """No crash, no hang, no raw exception; what is read is sound."""
    pytest.importorskip("pinocchio")
    print("\n" + campaign(COUNT))


def test_the_campaign_can_fail():
    """A robot with poses that are no numbers, or samples outside its limits, is noticed."""
    path = folder(os.getpid()) / "good.urdf"
    robot = Robot.from_urdf(path, cache=False)
    robot.tree.constants[2, 9] = np.nan
    assert fault_of_robot(robot) == "poses that are no numbers"
    with pytest.raises(InputError):
        robot.checked([np.nan] * robot.dof)
