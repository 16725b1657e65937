"""The code of the site's pages runs, and prints what the pages say."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import trimesh

from site_pages import pages

DOCS = Path(__file__).parent.parent / "docs"
CODE = r"^```python\n(.*?)^```"
LARGE = {"import torch\n": "torch", "from pydrake.all import": "pydrake"}
# test_docs.py runs the code of these.
LONG = {"howto/cluster.md", "howto/covers.md"}  # processes of a cluster, and fits of spheres
GUIDES = {"meshes.md", "motions.md", "pairs.md", "proofs.md", "robots.md", "scenes.md", "viewer.md", "tutorial/pick.md"}
PAGES = sorted(page for page in pages(DOCS) if re.search(CODE, page.read_text(), flags=re.M | re.S))


@pytest.fixture
def folder_with_mesh(tmp_path, monkeypatch):
    """A working folder that holds the mesh file that the pages name."""
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    yield
    if "jax" in sys.modules:  # a page may have set what holds for all that comes after it
        sys.modules["jax"].config.update("jax_enable_x64", False)


def needs_what_is_missing(block):
    """Whether it imports PyTorch or Drake, which are too large to be there for the usual tests, and they are not."""
    return any(text in block and find_spec(name) is None for text, name in LARGE.items())


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=name, marks=[pytest.mark.verify] * (name in LONG))
        for page, name in ((page, str(page.relative_to(DOCS))) for page in PAGES)
        if name not in GUIDES
    ],
)
def test_pages_print_what_they_say(page, folder_with_mesh):
    """All Python blocks of a page run, in order, as one program, and `print(...)  # -> text` prints that text."""
    run(page)


def run(page):
    """Run the program of a page, whose robots in XML are files of their names."""

    def said(expected, *values):
        assert " ".join(map(str, values)) == expected, page

    for robot in re.findall(r"^```xml\n(<robot .*?)^```", page.read_text(), flags=re.M | re.S):
        Path(re.search(r'name="(.+?)"', robot)[1] + ".urdf").write_text(robot)
    blocks = re.findall(CODE, page.read_text(), flags=re.M | re.S)
    program = "\n".join(block for block in blocks if not needs_what_is_missing(block))
    program = re.sub(r"^(\s*)print\((.+)\)  # -> (.+)$", r"\1said(r'''\3''', \2)", program, flags=re.M)
    assert "# ->" not in program  # else nobody checks it
    exec(compile(program, str(page), "exec"), {"said": said})
