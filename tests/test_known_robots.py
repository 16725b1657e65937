"""Robots as other projects publish them are read without a false warning, and as pinocchio reads them.

The table in ``docs/robots.md`` lists the warnings. `test_models.py` has robots of further packages.
"""

import re
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from loewner.robots.description.urdf import read_urdf
from robot_oracle import compare_with_pinocchio, robots_folder, without_shapes
from sampling import quick

PAGE = Path(__file__).parents[1] / "docs" / "robots.md"

# Files that cause a warning, and its reason, which is in the file.
REASONS = {
    "alex_psyonic_hands": "to mimic, found",
    "centauro": "'lower' and 'upper' in its <limit>",
    "kinova": "<limit lower>",
    "pr2": "that leave 'r_gripper_l_finger_joint'",
    "simple_humanoid": "<collision_checking> in <link>",
    "quadruped": "'lower' and 'upper' in its <limit>",
    "tiago_pro": "velocity of 'wheel_front_right_joint' in <ros2_control>",
}
EMPTY = "ur3.urdf"  # it has no links


def urdfs() -> list[Path]:
    """All URDF files of example-robot-data but the empty one."""
    return sorted(path for path in robots_folder().rglob("*.urdf") if path.name != EMPTY)


def mimics_of(text: str) -> dict[str, tuple[str, float, float]]:
    """The mimics of a URDF by the names of joints, as they are in the file."""
    found = {}
    for joint in ElementTree.fromstring(text).findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") != "fixed":
            numbers = (float(mimic.get(name, default)) for name, default in (("multiplier", "1"), ("offset", "0")))
            found[joint.get("name")] = (mimic.get("joint"), *numbers)
    return found


@pytest.mark.parametrize("every", quick(2, 1))
def test_known_robots_warn_for_reasons_only(every):
    """Of the URDF files of example-robot-data, six warn: each for a reason that is in the file."""
    paths = urdfs()
    assert len(paths) > 60
    for path in paths[::every]:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            read_urdf(path)
        assert bool(told) == (path.stem in REASONS), path
        assert all(REASONS[path.stem] in str(one.message) for one in told), (path, told)


@pytest.mark.parametrize("every", quick(7, 1))
def test_known_robots_are_as_pinocchio_reads_them(every):
    """Links to 1e-12 of the size, hard limits to the bit, mimics as in the file, of each n-th of them."""
    for path in urdfs()[::every]:
        text = without_shapes(path.read_text(encoding="utf-8"))
        compare_with_pinocchio(text)
        joints = read_urdf_quietly(text)
        written = {name: mimic for name, mimic in mimics_of(text).items() if mimic[0] in joints}
        read = {j.name: (j.mimic.joint, j.mimic.multiplier, j.mimic.offset) for j in joints.values() if j.mimic}
        chains = {name for name, mimic in written.items() if mimic[0] in written}
        assert read.keys() == written.keys(), path
        assert {name: read[name] for name in read.keys() - chains} == {
            name: written[name] for name in written.keys() - chains
        }, path


def read_urdf_quietly(text: str):
    """The joints of a URDF."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_urdf("URDF text", text).joints


def test_the_page_lists_the_files_that_warn():
    """Each file that warns has its row, and no other file of the package has one."""
    rows = re.findall(r"^\| example-robot-data \| `([^`]+)`", PAGE.read_text(encoding="utf-8"), flags=re.M)
    assert sorted(rows) == sorted(f"{name}.urdf" for name in REASONS)
