"""The pages of the site are whole: nothing public is left out, and numbers are the measured ones.

No page's code runs here: `test_pages.py` and `test_docs.py` run it.
"""

import csv
import dataclasses
import inspect
import re
import typing
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import pytest

import loewner
import loewner.cli
import loewner.cluster
import loewner.depth
import loewner.gpu
import loewner.jax
import loewner.judging
import loewner.paper
import loewner.planners
import loewner.plots
import loewner.reproductions
import loewner.torch
import loewner.viewer
from site_pages import MADE_BY_THE_BUILD, pages

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"

pytestmark = pytest.mark.light

CODE = r"^```python\n(.*?)^```"
PAGES = sorted(page for page in pages(DOCS) if re.search(CODE, page.read_text(), flags=re.M | re.S))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_code_fits_its_column(page):
    """No line of Python on a page is wider than 76 columns, unless it shows what it prints."""
    blocks = re.findall(CODE, page.read_text(), flags=re.M | re.S)
    assert [line for line in "".join(blocks).splitlines() if len(line) > 76 and "# ->" not in line] == []


def test_links_have_titles():
    """No link of a page shows the name of a source file."""
    links = re.compile(r"\[[^\]]*\w\.md[^\]]*\]\(")
    assert [page for page in pages(DOCS) if links.search(page.read_text())] == []


def test_tables_name_their_columns():
    """No heading of a column is empty."""
    heads = [
        line for page in pages(DOCS) for line in re.findall(r"^(\|.*\|)\n\|[-:| ]+\|$", page.read_text(), flags=re.M)
    ]
    assert len(heads) > 50
    assert [line for line in heads if re.search(r"\| *\|", line.replace("\\|", ""))] == []


def test_gallery_has_twelve_pictures():
    """Each has its code below it, and all together are small."""
    text = (DOCS / "gallery.md").read_text()
    shown = re.findall(r"\(images/(gallery/[\w.-]+)\)\{\.picture\}\n\n```python\n(.*?)^```", text, flags=re.M | re.S)
    files = [DOCS / "images" / name for name, _ in shown]
    assert len(files) == 12
    assert sorted(files) == sorted((DOCS / "images/gallery").iterdir())
    assert max(code.count("\n") for _, code in shown) <= 15
    assert sum(path.stat().st_size for path in files) < 800_000
    assert (DOCS / "images/front.png").stat().st_size < 150_000


def test_index_leads_to_every_page():
    """Every page is in a table of contents, and every entry of one exists."""
    listed = set()
    for page in pages(DOCS):
        for entries in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), flags=re.M | re.S):
            names = [line for line in entries.splitlines() if line and not line.startswith(":")]
            absolute = [DOCS / name[1:] if name.startswith("/") else page.parent / name for name in names]
            listed |= {path.relative_to(DOCS).as_posix() for path in absolute}
    found = {p.relative_to(DOCS).with_suffix("").as_posix() for p in DOCS.rglob("*") if p.suffix in (".md", ".rst")}
    found = {p for p in found if not p.startswith(("_", "reference/generated/"))}
    assert listed | {"index"} == found | MADE_BY_THE_BUILD


def test_reference_names_everything_public():
    """Each public name is on exactly one page of the reference."""
    entries = [
        line.strip()
        for page in DOCS.glob("reference/*.rst")
        for line in page.read_text().split(":toctree: generated")[1].splitlines()
        if line.strip()
    ]
    assert sorted(name for name in entries if "." not in name) == sorted(loewner.__all__)


# Public names that are not in `loewner` itself, by module.
MODULES = {
    "cli": ("main",),
    "cluster": tuple(loewner.cluster.__all__),
    "depth": tuple(loewner.depth.__all__),
    "gpu": tuple(loewner.gpu.__all__),
    "jax": tuple(loewner.jax.__all__),
    "judging": tuple(loewner.judging.__all__),
    "meshes": ("load", "convex_pieces"),
    "paper": tuple(name for name in loewner.paper.__all__ if name != "tables"),
    "planners": tuple(loewner.planners.__all__),
    "plots": ("body", "pair", "configuration", "cover", "trajectory", "tiers", "costs", "accuracy", "save"),
    "reproductions": ("reproduction",),
    "torch": tuple(loewner.torch.__all__),
    "viewer": tuple(loewner.viewer.__all__),
}


def public_names():
    """Every public function and class, by the name under which users find it."""
    for name in loewner.__all__:
        yield name, getattr(loewner, name)
    for module, names in MODULES.items():
        for name in names:
            yield f"{module}.{name}", getattr(getattr(loewner, module), name)


PROPERTIES = (property, cached_property)


def is_called(thing):
    """Whether it is a function or a method."""
    return inspect.isroutine(thing) and not isinstance(thing, PROPERTIES)


def public_members():
    """Public methods and properties of the public classes, each once."""
    for name, thing in public_names():
        if inspect.isclass(thing) and not issubclass(thing, (Exception, IntEnum)):
            for attribute, member in vars(thing).items():
                if attribute.startswith("_"):
                    continue
                # Of a property, all there is to say is what it is.
                found = member if isinstance(member, PROPERTIES) else getattr(thing, attribute)
                if isinstance(member, PROPERTIES) or inspect.isroutine(found):
                    yield f"{name}.{attribute}", found


def section(thing, title):
    """Text of one section of a numpydoc docstring."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\w+\n---|\Z)", inspect.getdoc(thing), flags=re.M | re.S)
    return found[1] if found else ""


def named_in(text):
    """Names that a section of parameters or attributes describes."""
    return {name for line in re.findall(r"^(\S.*?)(?: :.*)?$", text, flags=re.M) for name in re.findall(r"\w+", line)}


NAMES, MEMBERS = dict(public_names()), dict(public_members())


@pytest.mark.parametrize("module", ["meshes", "plots"])
def test_public_functions_of_modules_are_known(module):
    """No public function of these modules is left out of the list above: by `__all__`, or without an underscore."""
    home = getattr(loewner, module)
    public = getattr(home, "__all__", [name for name in vars(home) if not name.startswith("_")])
    members = {name: getattr(home, name) for name in public}
    # In a package they come from its files, and classes are listed too.
    whole = hasattr(home, "__all__")
    found = {k: v for k, v in members.items() if inspect.isfunction(v) or (whole and inspect.isclass(v))}
    assert {k for k, v in found.items() if v.__module__.startswith(home.__name__)} == set(MODULES[module])


@pytest.mark.parametrize("name", NAMES)
def test_public_names_show_an_example(name):
    """Each has one that runs."""
    assert ">>> " in section(NAMES[name], "Examples")


def parameters_of(thing):
    """Names of its parameters; those of a typed dictionary instead of the dictionary."""
    names = set()
    for name, parameter in inspect.signature(thing).parameters.items():
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            (options,) = typing.get_args(eval(parameter.annotation, inspect.unwrap(thing).__globals__))
            names |= set(options.__annotations__)
        else:
            names.add(name)
    return names


@pytest.mark.parametrize("name", [*NAMES, *MEMBERS])
def test_public_names_are_documented(name):
    """Each says what it is, and names every argument, field and result that it has."""
    thing = (NAMES | MEMBERS)[name]
    assert inspect.getdoc(thing)
    if is_called(thing):
        signature = inspect.signature(thing)
        assert parameters_of(thing) - {"self"} <= named_in(section(thing, "Parameters"))
        makes_an_object = inspect.ismethod(thing)  # of its class: a class method
        if signature.return_annotation not in (None, "None") and not makes_an_object:
            assert section(thing, "Returns")
    elif dataclasses.is_dataclass(thing):
        fields = {field.name for field in dataclasses.fields(thing) if not field.name.startswith("_")}
        assert fields <= named_in(section(thing, "Attributes") + section(thing, "Parameters"))


MEASURED = {"angle", "length", "margin", "radius", "resolution", "semi_axes", "size", "timeout", "tolerance"}
UNIT = re.compile(r"\b(metres|radians|seconds|units of the joints)\b", flags=re.I)


def measured_arguments(thing):
    """Arguments that are poses, lengths, angles or times."""
    if not is_called(thing):
        return set()
    return {k for k in inspect.signature(thing).parameters if k in MEASURED or re.match(r"Ts?(_|$)", k)}


@pytest.mark.parametrize("name", [name for name, thing in (NAMES | MEMBERS).items() if measured_arguments(thing)])
def test_units_are_named(name):
    """What takes a pose, a length, an angle or a time says in which unit; or its class does, for all its methods."""
    owner = NAMES.get(name.rpartition(".")[0])
    texts = [inspect.getdoc(thing) for thing in (owner, (NAMES | MEMBERS)[name]) if thing]
    assert any(map(UNIT.search, texts)), measured_arguments((NAMES | MEMBERS)[name])


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
    with measured.RATIOS.open(newline="") as stream:
        ratios = {
            tuple(row[k] for k in ("machine", "benchmark", "case", "us", "rival")) for row in csv.DictReader(stream)
        }
    section = text.split("## Ratios by commit\n")[1].split("\n## ")[0]
    assert len(re.findall(r"^\| (?!---)", section, flags=re.M)) == len(ratios) + 1
    (tmp_path / "machine").mkdir()
    (tmp_path / "machine/odd.csv").write_text("case,us\n")
    assert "### odd\n\nNothing was measured." in measured.page(tmp_path)


def test_command_line_is_shown_whole(monkeypatch):
    """The page of the command line has the help of every command."""
    monkeypatch.syspath_prepend(str(DOCS))
    import command

    found = re.findall(r"^usage: loewner(.*?) \[", command.page(), flags=re.M)
    assert found == [
        "",
        " fit",
        " check",
        " clearance",
        " judge",
        " robot",
        " robot info",
        " robot check",
        " clash",
        " cover",
        " plan",
        " verify",
        " audit",
        " swept",
        " report",
        " report check",
        " report robot",
        " report rerun",
        " view",
        " compile",
        " info",
        " paper",
    ]


def test_accuracy_page_has_the_measured_numbers():
    """Each number in the tables of theory/estimate.md is that of the CSV, and no family or rule is left out."""
    (path,) = (ROOT / "benchmarks/results").glob("*/accuracy.csv")
    with path.open(newline="") as stream:
        rows = {(row["family"], row["rule"]): row for row in csv.DictReader(stream)}
    families, rules = (list(dict.fromkeys(key)) for key in zip(*rows, strict=True))
    text = (DOCS / "theory/estimate.md").read_text()
    header = "| family | ambiguous | " + " | ".join(f"`{rule}`" for rule in rules) + " |"
    assert header in text
    lines = re.findall(rf"^\| ({'|'.join(map(re.escape, families))}) \| (.*) \|$", text, flags=re.M)
    assert [name for name, _ in lines] == 2 * families
    for k, (family, cells) in enumerate(lines):
        mine = [rows[family, rule] for rule in rules]
        if k < len(families):
            expected = [float(mine[0]["ambiguous"])]
            expected += [float(row[name]) for row in mine for name in ("percent", "low", "high")]
        else:
            expected = [100 * int(row["missed"]) / int(row["colliding"]) for row in mine]
            expected += [float(mine[0][name]) for name in ("error_median", "error_90")]
        found = [float(x) for x in re.findall(r"\d+\.?\d*", cells)]
        assert found == pytest.approx(expected, abs=0.0501), family
