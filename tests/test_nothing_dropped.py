"""No part of a file is dropped without a word: each is used, is known to be harmless, or is told or refused.

The sample of a format has every word of it. Its mutants have one part renamed, doubled, or joined by a stranger; a
reader that picks what it knows, and does not account for the rest, reads some of them as if nothing had happened. The
parts where that is right are listed.
"""

import copy
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest

from loewner import LoewnerError
from loewner.robots.srdf import read_srdf
from loewner.robots.urdf import read_urdf as description


class Format(NamedTuple):
    """A format of files.

    Attributes
    ----------
    sample : str
    read : callable
        Reads a file, given by its path.
    mutants : callable
        Yields, for a sample: what was done, the path of the part to which it was done, and the text.
    harmless : tuple of str
        Parts whose contents may change without a word: paths, each of which stands for all that begin with it.
    repeated : tuple of str
        Parts that may occur several times.
    """

    sample: str
    read: Callable[[Path], object]
    mutants: Callable[[str], Iterator[tuple[str, str, str]]]
    harmless: tuple[str, ...]
    repeated: tuple[str, ...]


def without_a_word(form: Format, path: Path) -> set[tuple[str, str]]:
    """What can be done to which parts of a sample without an error or a warning of the reader."""
    path.write_text(form.sample)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        form.read(path)
    quiet = set()
    for what, part, text in form.mutants(form.sample):
        path.write_text(text)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                form.read(path)
            except LoewnerError:
                continue
        if not told:
            quiet.add((what, part))
    return quiet


# -- XML ------------------------------------------------------------------------------------------


def xml_mutants(sample: str) -> Iterator[tuple[str, str, str]]:
    """Rename and double each element, give it a child that no format has, and likewise with its attributes."""
    for number, (path, _, element) in enumerate(_elements(ElementTree.fromstring(sample))):
        changes = [("renamed", path, _rename), ("doubled", path, _double)]
        changes += [("joined", f"{path}/stranger", _join), ("joined", f"{path}@stranger", _join_attribute)]
        changes += [("renamed", f"{path}@{name}", partial(_rename_attribute, name)) for name in element.attrib]
        for what, part, change in changes:
            root = ElementTree.fromstring(sample)
            change(*_elements(root)[number][1:])
            yield what, part, ElementTree.tostring(root, encoding="unicode")


def _elements(root: ElementTree.Element) -> list[tuple[str, ElementTree.Element, ElementTree.Element]]:
    """Each element but the root, with its path and the element that contains it, in the order of the file."""
    found, waiting = [], [("", root)]
    while waiting:
        path, above = waiting.pop(0)
        inside = [(f"{path}/{element.tag}".lstrip("/"), element) for element in above]
        found += [(name, above, element) for name, element in inside]
        waiting += inside
    return found


def _rename(_: ElementTree.Element, element: ElementTree.Element) -> None:
    element.tag += "x"


def _rename_attribute(name: str, _: ElementTree.Element, element: ElementTree.Element) -> None:
    element.set(name + "x", element.attrib.pop(name))


def _join(_: ElementTree.Element, element: ElementTree.Element) -> None:
    ElementTree.SubElement(element, "stranger")


def _join_attribute(_: ElementTree.Element, element: ElementTree.Element) -> None:
    element.set("stranger", "1")


def _double(above: ElementTree.Element, element: ElementTree.Element) -> None:
    """Add a copy with other numbers, so that it matters which of the two counts."""
    twin = copy.deepcopy(element)
    for one in twin.iter():
        for name, value in one.attrib.items():
            if re.fullmatch(r"[-+.\d\s]+", value):
                one.set(name, " ".join(str(1.25 * float(word)) for word in value.split()))
    above.insert(list(above).index(element) + 1, twin)


# -- robots ---------------------------------------------------------------------------------------

URDF = """<robot name="r" version="1.2">
<material name="m"><color rgba="1 0 0 1"/></material><transmission name="t"><joint name="j"><x/></joint></transmission>
<sensor name="s"><parent link="a"/></sensor><gazebo reference="a"><mu1>1</mu1></gazebo>
<ros2_control name="c" type="system"><joint name="j"><state_interface name="position"/></joint></ros2_control>
<link name="a" type="x"><inertial><mass value="1"/></inertial>
  <visual><geometry><box size="1 1 1"/></geometry><material name="m"/></visual>
  <collision name="c"><origin xyz="0.1 0 0" rpy="0 0 0.1"/><geometry><box size="1 1 1"/></geometry></collision></link>
<link name="b"><collision><origin quat_xyzw="0 0 0.6 0.8"/>
  <geometry><cylinder radius="0.1" length="0.5"/></geometry></collision></link>
<link name="d"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="e"><collision><geometry><capsule radius="0.1" length="0.5"/></geometry></collision></link>
<link name="f"><collision><geometry><mesh filename="m.obj" scale="1 1 2"/></geometry></collision></link>
<joint name="j" type="revolute"><origin xyz="0 0 1" rpy="0.1 0 0"/><parent link="a"/><child link="b"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1.5" effort="1" velocity="2" acceleration="3" deceleration="2" jerk="9"/>
  <dynamics damping="1"/><calibration rising="0"/>
  <safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.5" k_position="1" k_velocity="1"/></joint>
<joint name="k" type="prismatic"><origin xyz="0 0 0.5"/><parent link="b"/><child link="d"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" velocity="1"/><mimic joint="j" multiplier="0.5" offset="0.01"/></joint>
<joint name="l" type="continuous"><parent link="d"/><child link="e"/><axis xyz="1 0 0"/><limit velocity="1"/></joint>
<joint name="n" type="fixed"><origin xyz="0 0 1"/><parent link="d"/><child link="f"/></joint></robot>"""

SRDF = """<robot name="r"><group name="arm"><joint name="j"/></group><group name="all"><group name="arm"/>
<link name="d"/></group><group name="way"><chain base_link="a" tip_link="d"/></group>
<group_state name="home" group="arm"><joint name="j" value="0.3"/></group_state>
<group_state name="rest"><joint name="j" value="0.2"/></group_state>
<disable_collisions link1="a" link2="b" reason="Adjacent"/><enable_collisions link1="d" link2="b" reason="x"/>
<disable_default_collisions link="d"/><end_effector name="e" parent_link="b" group="arm"/>
<joint_property joint_name="j" property_name="p" value="1"/><gripper name="g"><link name="d"/></gripper>
<virtual_joint name="v" type="fixed" parent_frame="w" child_link="a"/></robot>"""

ROBOT = description("URDF text", URDF)

FORMATS = {
    "URDF": Format(
        URDF, description, xml_mutants,
        ("material", "transmission", "sensor", "gazebo", "ros2_control", "link/inertial", "link/visual",
         "joint/dynamics", "joint/calibration"),
        ("link/collision",),
    ),
    "SRDF": Format(
        SRDF, lambda path: read_srdf(path, ROBOT), xml_mutants,
        ("end_effector", "gripper"),
        ("group/joint", "group/link", "group/chain", "group/group", "disable_collisions", "enable_collisions",
         "disable_default_collisions", "joint_property", "virtual_joint"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS)
def test_no_part_of_a_file_is_dropped_without_a_word(form, tmp_path):
    """Only what is listed may be renamed, doubled or joined by a stranger: the list is complete, and no longer."""
    quiet = without_a_word(form, tmp_path / "file")
    harmless = {(what, part) for what, part in quiet if re.match(rf"({'|'.join(form.harmless)})\b", part)}
    repeated = {(what, part) for what, part in quiet if what == "doubled" and part in form.repeated}
    assert quiet - harmless - repeated == set()
    assert {part for _, part in repeated} == set(form.repeated)
    assert {name for name in form.harmless for _, part in harmless if part.startswith(name)} == set(form.harmless)
