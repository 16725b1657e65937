"""The pages of the site tell the truth: their code runs and prints what it says, and nothing public is left out."""

import csv
import dataclasses
import inspect
import re
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import pytest
import trimesh

import loewner

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
CODE = r"^```python\n(.*?)^```"
# test_docs.py runs the code of these.
GUIDES = {"meshes.md", "robots.md", "scenes.md", "viewer.md"}
PAGES = sorted(page for page in DOCS.rglob("*.md") if re.search(CODE, page.read_text(), flags=re.M | re.S))


@pytest.fixture
def folder_with_mesh(tmp_path, monkeypatch):
    """A working folder that holds the mesh file that the pages name."""
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "page", [p for p in PAGES if str(p.relative_to(DOCS)) not in GUIDES], ids=lambda p: str(p.relative_to(DOCS))
)
def test_pages_print_what_they_say(page, folder_with_mesh):
    """All Python blocks of a page run, in order, as one program, and `print(...)  # -> text` prints that text."""

    def said(expected, *values):
        assert " ".join(map(str, values)) == expected, page

    program = "\n".join(re.findall(CODE, page.read_text(), flags=re.M | re.S))
    program = re.sub(r"^(\s*)print\((.+)\)  # -> (.+)$", r"\1said(r'''\3''', \2)", program, flags=re.M)
    exec(compile(program, str(page), "exec"), {"said": said})


def test_index_leads_to_every_page():
    """Every page is in a table of contents, and every entry of one exists."""
    listed = set()
    for page in [*DOCS.glob("*.md"), *DOCS.glob("reference/*.md")]:
        for entries in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), flags=re.M | re.S):
            names = [line for line in entries.splitlines() if line and not line.startswith(":")]
            listed |= {(page.parent / name).relative_to(DOCS).as_posix() for name in names}
    pages = {p.relative_to(DOCS).with_suffix("").as_posix() for p in DOCS.rglob("*") if p.suffix in (".md", ".rst")}
    pages = {p for p in pages if not p.startswith(("_", "reference/generated/"))}
    made_by_the_build = {"measured", "reference/command"}
    assert listed | {"index"} == pages | made_by_the_build


def test_reference_names_everything_public():
    """Each public name is on exactly one page of the reference."""
    entries = [
        line.strip()
        for page in DOCS.glob("reference/*.rst")
        for line in page.read_text().split(":toctree: generated")[1].splitlines()
        if line.strip()
    ]
    assert sorted(name for name in entries if "." not in name) == sorted(loewner.__all__)


def public_objects():
    """Everything public that has a docstring of its own: names, and methods of classes."""
    for name in loewner.__all__:
        thing = getattr(loewner, name)
        yield name, thing
        if inspect.isclass(thing) and not issubclass(thing, (Exception, IntEnum)):
            for attribute, member in vars(thing).items():
                if not attribute.startswith("_") and not isinstance(member, (property, cached_property)):
                    method = getattr(thing, attribute)
                    if inspect.isroutine(method):
                        yield f"{name}.{attribute}", method


def section(thing, title):
    """Text of one section of a numpydoc docstring."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\w+\n---|\Z)", inspect.getdoc(thing), flags=re.M | re.S)
    return found[1] if found else ""


def named_in(text):
    """Names that a section of parameters or attributes describes."""
    return {name for line in re.findall(r"^(\S.*?)(?: :.*)?$", text, flags=re.M) for name in re.findall(r"\w+", line)}


@pytest.mark.parametrize(("name", "thing"), list(public_objects()), ids=lambda x: x if isinstance(x, str) else "")
def test_public_names_are_documented(name, thing):
    """Each public name shows an example and names every argument, field and result that it has."""
    if "." not in name:
        assert ">>> " in section(thing, "Examples")
    if inspect.isroutine(thing):
        signature = inspect.signature(thing)
        assert set(signature.parameters) - {"self"} <= named_in(section(thing, "Parameters"))
        makes_an_object = inspect.ismethod(thing)  # of its class: a class method
        if signature.return_annotation not in (None, "None") and not makes_an_object:
            assert section(thing, "Returns")
    elif dataclasses.is_dataclass(thing):
        fields = {field.name for field in dataclasses.fields(thing) if not field.name.startswith("_")}
        assert fields <= named_in(section(thing, "Attributes") + section(thing, "Parameters"))


def test_measurements_are_those_of_the_files(tmp_path, monkeypatch):
    """The page that is made from benchmark results has every row of every file, and survives a file without rows."""
    monkeypatch.syspath_prepend(str(DOCS))
    import measured

    text = measured.page(measured.RESULTS)
    for path in measured.RESULTS.glob("*/*.csv"):
        with path.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        section = text.split(f"### {measured.TITLES.get(path.stem, path.stem)}\n")[1].split("\n### ")[0]
        assert len(re.findall(r"^\| (?!---)", section, flags=re.M)) == len(rows) + 1, path
    (tmp_path / "machine").mkdir()
    (tmp_path / "machine/odd.csv").write_text("case,us\n")
    assert "### odd\n\nNothing was measured." in measured.page(tmp_path)


def test_command_line_is_shown_whole(monkeypatch):
    """The page of the command line has the help of every command."""
    monkeypatch.syspath_prepend(str(DOCS))
    import command

    found = re.findall(r"^usage: loewner(.*?) \[", command.page(), flags=re.M)
    assert found == ["", " fit", " check", " robot", " robot info", " robot check", " view", " compile", " paper"]
