"""Xacro files are expanded if their names say so, or arguments are given, and never because of their contents."""

import sys
from pathlib import Path

import pytest

from loewner import FileError, InputError, MissingExtraError, Robot

FILE = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="reach" default="1"/><xacro:arg name="short" default="false"/>
<xacro:include filename="$(find parts)/urdf/parts.xacro"/>
<xacro:property name="half" value="${$(arg reach) / 2}"/>
<link name="base"/><xacro:unless value="$(arg short)"><xacro:slide name="lift" way="${half}"/></xacro:unless></robot>"""

PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="slide" params="name way">
<link name="${name}"><collision><geometry><mesh filename="package://parts/box.obj"/></geometry></collision></link>
<joint name="${name}_joint" type="prismatic"><parent link="base"/><child link="${name}"/>
<limit lower="0" upper="${way}"/></joint></xacro:macro></robot>"""

SEMANTICS = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="apart" default="true"/>
<xacro:if value="$(arg apart)"><disable_collisions link1="base" link2="lift"/></xacro:if>
<group name="all"><joint name="lift_joint"/></group></robot>"""

BOX = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)


def written(folder: Path, name: str = "r.urdf.xacro", text: str = FILE) -> Path:
    package = folder / "packages" / "parts"
    (package / "urdf").mkdir(parents=True, exist_ok=True)
    (package / "urdf" / "parts.xacro").write_text(PARTS)
    (package / "box.obj").write_text(BOX)
    (folder / name).write_text(text)
    return folder / name


def test_macros_includes_and_arguments(tmp_path):
    """Packages are found where meshes are; numbers and bools are written as xacro has them."""
    pytest.importorskip("xacro")
    path = written(tmp_path)
    robot = Robot.from_urdf(path, package_dirs=tmp_path / "packages")
    assert (robot.joint_names, robot.upper.tolist(), list(robot.bodies)) == (("lift_joint",), [0.5], ["lift"])
    assert robot.urdf == path
    longer = Robot.from_urdf(path, package_dirs=tmp_path / "packages/parts", xacro_args={"reach": 5.0})
    assert longer.upper.tolist() == [2.5]
    assert Robot.from_urdf(path, package_dirs=tmp_path / "packages", xacro_args={"short": True}).dof == 0


def test_only_the_name_or_arguments_let_a_file_be_expanded(tmp_path, monkeypatch):
    """Its contents do not, since they are evaluated: without xacro, other files are read or refused as ever."""
    monkeypatch.setitem(sys.modules, "xacro", None)
    for path, options in ((written(tmp_path), {}), (written(tmp_path, "r.urdf"), {"xacro_args": {}})):
        with pytest.raises(MissingExtraError, match=r'needs the package xacro: pip install "loewner\[xacro\]"'):
            Robot.from_urdf(path, **options)
    with pytest.raises(FileError, match="found the macro <xacro:arg>; run xacro"):
        Robot.from_urdf(written(tmp_path, "r.urdf"))
    with pytest.raises(FileError, match="found the macro <xacro:arg>; run xacro"):
        Robot.from_urdf(text=FILE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FILE, "expected the package 'parts', but there is no such folder; looked at .*parts"),
        (FILE.replace("$(find parts)", "."), "No such file"),
        (FILE.replace("$(arg reach) / 2", "1 / 0"), "division by zero"),
        ("<robot", "cannot"),
    ],
)
def test_files_that_xacro_cannot_expand_are_refused(text, words, tmp_path):
    """With the reason that xacro gives; a second expansion is not affected."""
    pytest.importorskip("xacro")
    folders = () if "$(find" in text and text == FILE else tmp_path / "packages"
    for _ in range(2):
        with pytest.raises(FileError, match=f"(?s)r.urdf.xacro: (expected a file that xacro can expand, .*)?{words}"):
            Robot.from_urdf(written(tmp_path, text=text), package_dirs=folders)
    assert Robot.from_urdf(written(tmp_path), package_dirs=tmp_path / "packages").dof == 1


def test_faults_after_the_expansion_are_those_of_a_urdf(tmp_path):
    """What xacro leaves is checked as any URDF."""
    pytest.importorskip("xacro")
    path = written(tmp_path, text='<robot name="r"><link name="${1 + 1}"/><link name="2"/></robot>')
    with pytest.raises(InputError, match="r.urdf.xacro, line [34]: expected each name of a link once"):
        Robot.from_urdf(path)


@pytest.mark.parametrize("arguments", [3, {"reach": None}, {"reach": [1]}, {1: "2"}])
def test_arguments_that_are_none_are_refused(arguments, tmp_path):
    """Arguments are a mapping, and need a file of xacro."""
    with pytest.raises(InputError, match="xacro_args: expected"):
        Robot.from_urdf(written(tmp_path), xacro_args=arguments)


def test_a_text_has_no_arguments(tmp_path):
    """Arguments with a text instead of a path are refused."""
    with pytest.raises(InputError, match="xacro_args: expected a path to a xacro file"):
        Robot.from_urdf(text=FILE, xacro_args={"reach": 1})
    with pytest.raises(FileError, match="expected a xacro file, but there is no such file"):
        Robot.from_urdf(tmp_path / "none.xacro")


def test_arguments_that_no_file_declares_are_refused(tmp_path):
    """A misspelt name would leave the default; an argument of the SRDF alone is declared there."""
    pytest.importorskip("xacro")
    path = written(tmp_path)
    (tmp_path / "r.srdf.xacro").write_text(SEMANTICS)
    options = {"package_dirs": tmp_path / "packages", "srdf": tmp_path / "r.srdf.xacro"}
    with pytest.raises(InputError, match=r"xacro_args: expected arguments .*reach, short\), found 'reech'"):
        Robot.from_urdf(path, xacro_args={"reech": 5.0}, package_dirs=tmp_path / "packages")
    assert Robot.from_urdf(path, **options).disabled_pairs == {("base", "lift")}
    given = Robot.from_urdf(path, xacro_args={"reach": 5.0, "apart": False}, **options)
    assert (given.disabled_pairs, given.upper.tolist()) == (frozenset(), [2.5])


def test_folders_of_packages_may_be_relative(tmp_path, monkeypatch):
    """From the working directory, not from the folder of the file."""
    pytest.importorskip("xacro")
    (tmp_path / "robots").mkdir()
    path = written(tmp_path)
    path = path.rename(tmp_path / "robots" / path.name)
    monkeypatch.chdir(tmp_path)
    for folder in ("packages", "./packages", "packages/parts"):
        assert Robot.from_urdf("robots/r.urdf.xacro", package_dirs=[folder]).dof == 1
