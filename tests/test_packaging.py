"""Files about the package that no build reads: they agree with pyproject.toml, the Makefile and the code."""

import re
import subprocess
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import loewner
from loewner import verify
from loewner.bodies.files import BODIES
from loewner.cli import report
from loewner.planners.roadmaps import ROADMAPS
from loewner.robots.proofs.written_proofs import VERSION

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

pytestmark = pytest.mark.light


def spaced(requirement: str) -> str:
    """A requirement as conda writes it."""
    return re.sub(r"(?=[<>=])(?<![<>=])", " ", requirement, count=1)


def test_citation():
    """The version, license and description are the project's; the paper is among the references."""
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert set(cff) >= {"cff-version", "message", "title", "authors", "type"}
    assert (cff["version"], cff["license"]) == (PROJECT["version"], PROJECT["license"])
    assert cff["abstract"] == PROJECT["description"]
    assert cff["keywords"] == PROJECT["keywords"]
    assert cff["authors"] == [{"name": author["name"]} for author in PROJECT["authors"]]
    assert all({"type", "title", "authors"} <= set(reference) for reference in cff["references"])
    assert cff["references"][0]["title"] in (ROOT / "README.md").read_text()


def pinned(file):
    """Names that a file of requirements/ pins, by itself or by the files that it includes."""
    names = set()
    for line in (ROOT / "requirements" / file).read_text().splitlines():
        if line.startswith("-r "):
            names |= pinned(line.removeprefix("-r "))
        elif found := re.match(r"([\w-]+)==", line):
            names.add(found[1].lower().replace("_", "-"))
    return names


def test_groups_are_what_requirements_pin():
    """Groups have names without versions, all of which are pinned, and the tools of a file are in its group."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]
    assert groups["dev"] == [{"include-group": name} for name in ("lint", "test", "oracles", "wheel")]
    files = {"docs": "docs.txt", "wheel": "wheel.txt"}
    for name, group in groups.items():
        if name != "dev":
            assert set(group) <= pinned(files.get(name, "dev.txt")) | pinned("data.txt")


def test_conda_recipe():
    """Name, version, license, requirements and the command are the project's."""
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    assert recipe["package"]["name"] == PROJECT["name"]
    assert recipe["context"]["version"] == PROJECT["version"] == loewner.__version__
    run = {f"python {PROJECT['requires-python']}", *map(spaced, PROJECT["dependencies"])}
    assert set(recipe["requirements"]["run"]) == run
    (build,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    jit = PROJECT["optional-dependencies"]["jit"]
    assert set(recipe["requirements"]["host"]) >= {spaced(build), *map(spaced, jit)}
    commands = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == commands
    assert (recipe["about"]["summary"], recipe["about"]["license"]) == (PROJECT["description"], PROJECT["license"])
    assert (ROOT / "packaging" / "conda" / recipe["source"]["path"] / recipe["about"]["license_file"]).is_file()


def test_ros_package():
    """A package of format 3, whose tags are in the order of the format; its dependencies are the project's."""
    root = ElementTree.parse(ROOT / "packaging" / "ros" / "package.xml").getroot()
    assert (root.tag, root.get("format")) == ("package", "3")
    assert [root.findtext(tag) for tag in ("name", "version", "description", "license")] == [
        PROJECT[key] for key in ("name", "version", "description", "license")
    ]
    assert re.fullmatch(r"\d+\.\d+\.\d+", PROJECT["version"])  # of ROS, no other form
    assert (ROOT / "packaging" / "ros" / root.find("license").get("file")).is_file()
    assert "@" in root.find("maintainer").get("email")
    needed = {f"python3-{re.match(r'[a-z]+', line)[0]}" for line in PROJECT["dependencies"]}
    assert {element.text for element in root.findall("exec_depend")} >= needed
    assert root.findtext("export/build_type") == "cmake"


def test_the_list_of_placeholders_is_true():
    """Each text that CONTRIBUTING.md lists under "A release" is in its file, and each that it calls missing is not."""
    section = (ROOT / "CONTRIBUTING.md").read_text().partition("## A release")[2]
    rows = re.findall(r"^\|[^|]*\| `([^`]+)` \| (no )?`([^`]+)` \|$", section, flags=re.M)
    assert len(rows) == len(re.findall(r"^\|", section, flags=re.M)) - 2
    for file, missing, text in rows:
        assert (text in (ROOT / file).read_text()) != bool(missing), (file, text)


def test_pythons_are_the_same_everywhere():
    """The classifiers name the Pythons for which wheels are tested, from the oldest that is required."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    tested = [f"3.{build[3:-2]}" for build in tool["cibuildwheel"]["build"]]
    named = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if "Python :: 3." in text]
    assert named == tested
    assert PROJECT["requires-python"] == f">={named[0]}"


def test_changelog_begins_with_the_version():
    """The first heading is that of this version."""
    assert re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[1] == PROJECT["version"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows(path):
    """Each step uses an action or runs a program or target that exists, and may only read."""
    workflow = yaml.safe_load(path.read_text())
    assert set(workflow) == {"name", True, "permissions", "jobs"}  # "on" is a boolean in YAML
    assert workflow["permissions"] == {"contents": "read"}
    targets = set(re.findall(r"^([\w-]+):(?!=)", (ROOT / "Makefile").read_text(), flags=re.M))
    for job in workflow["jobs"].values():
        for step in job["steps"]:
            assert len({"uses", "run"} & set(step)) == 1
            command = [word for word in step.get("run", "").split() if not word.startswith("LOEWNER_")]
            if command[:2] == ["python", "-m"]:
                assert command[2] in ("pip", "build", "cibuildwheel")
            elif command:
                assert (ROOT / command[0]).is_file() or (command[0] == "make" and command[1] in targets)
        for entry in job.get("strategy", {}).get("matrix", {}).get("include", []):
            assert all((ROOT / name).exists() for name in entry["tests"].split())


def test_nightly_has_the_newest_packages():
    """The nightly run names each package of the policy, and `make newest` installs them."""
    job = yaml.safe_load((ROOT / ".github/workflows/nightly.yml").read_text())["jobs"]["newest"]
    names = " ".join(entry["packages"] for entry in job["strategy"]["matrix"]["include"]).split()
    assert sorted(names) == ["mujoco", "numba", "numpy", "scipy", "viser"]
    made = ["make", "-n", "newest", "PACKAGES=viser", "TESTS=tests/viewer"]
    commands = subprocess.run(made, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert re.search(r"install .*--upgrade viser$", commands, flags=re.M)
    assert re.search(r"pytest .* tests/viewer$", commands, flags=re.M)


def test_policy_names_the_versions_of_formats():
    """The table of formats has the versions that are written."""
    rows = dict(
        re.findall(r"^\| (\w+), `[^|]* \| [^|]* \| (\d)[^|]*\|", (ROOT / "docs/policy.md").read_text(), flags=re.M)
    )
    written = {"body": BODIES.version, "proof": VERSION, "report": report.VERSION, "roadmap": ROADMAPS.version}
    assert rows == {name: str(version) for name, version in written.items()}
    text = Path(verify.__file__).read_text()
    assert "reads version 1," in text
    assert f"version {VERSION}, claims 1 and 3." in text
