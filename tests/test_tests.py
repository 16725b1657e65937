"""The tests keep the rules that CONTRIBUTING.md sets them, and its table of tests names every kernel file."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
KERNELS = ROOT / "src" / "loewner" / "_kernels"
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))

pytestmark = pytest.mark.light


@pytest.mark.parametrize("path", TESTS, ids=lambda path: path.stem)
def test_every_test_says_its_law(path: Path):
    """Every test function has a docstring."""
    functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
    tests = [node for node in functions if node.name.startswith("test")]
    assert tests
    assert [node.name for node in tests if not ast.get_docstring(node)] == []


def table() -> list[tuple[list[str], list[str]]]:
    """Rows of the table in CONTRIBUTING.md: the kernel files, and the files of their tests."""
    (block,) = re.findall(r"^\| kernel file \| test files \|\n\|---\|---\|\n((?:\|.*\n)+)", CONTRIBUTING, flags=re.M)
    cells = [line.strip("|").split("|") for line in block.splitlines()]
    assert all(len(row) == 2 for row in cells)
    return [(re.findall(r"`(.+?)`", kernels), re.findall(r"`(.+?)`", tests)) for kernels, tests in cells]


def test_every_kernel_file_has_its_tests():
    """The table names each kernel file once, with at least one file of tests, and every file named exists."""
    listed = [name for kernels, _ in table() for name in kernels]
    existing = [path.relative_to(KERNELS).as_posix() for path in KERNELS.rglob("*.py") if path.name != "__init__.py"]
    assert sorted(listed) == sorted(existing)
    for kernels, tests in table():
        assert tests, kernels
        assert [name for name in tests if not (ROOT / "tests" / name).is_file()] == []


def test_files_to_change_exist():
    """Every Python file and test that the how-tos for kernels name exists."""
    (section,) = re.findall(r"^## How to change a kernel\n(.*?)(?=^## )", CONTRIBUTING, flags=re.M | re.S)
    named = set(re.findall(r"`((?:\w+/)*\w+\.(?:py|md))`", section))
    assert len(named) > 10
    folders = (ROOT, ROOT / "src" / "loewner", KERNELS)
    assert [name for name in sorted(named) if not any((folder / name).is_file() for folder in folders)] == []
