"""The tests keep the rules that CONTRIBUTING.md sets them, and its table of tests names every kernel file."""

import ast
import os
import re
import subprocess
import sys
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


def test_light_cases_call_no_kernel():
    """A case with the mark `light` that calls a kernel fails, whatever was called before."""
    from loewner import Body, collide

    with pytest.raises(pytest.fail.Exception, match="called a kernel"):
        collide(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), None)


CASES = """
import pytest

def test_plain():
    pass

@pytest.mark.slow("it has a reason")
def test_with_a_reason():
    pass

@pytest.mark.verify
def test_of_verify():
    pass
"""


@pytest.mark.parametrize("long", [True, False])
def test_long_cases_are_listed(tmp_path, long):
    """A case above the limit is listed with its reason, a warning on CI if it has none; none of them fails."""
    (tmp_path / "test_cases.py").write_text(CASES)
    (tmp_path / "conftest.py").write_text("import long_cases\nlong_cases.LONG = " + ("0.0" if long else "1e9"))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, "-p", "long_cases", "."],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT / "tests"), "CI": "true"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    listed = re.findall(r"^ *[\d.]+ s (\S+): (.*)$", done.stdout, flags=re.M)
    warned = re.findall(r"^::warning file=(\S+),line=(\d+)::(\S+):", done.stdout, flags=re.M)
    assert sorted(listed) == long * [
        ("test_cases.py::test_plain", "without a mark slow(reason)"),
        ("test_cases.py::test_with_a_reason", "it has a reason"),
    ]
    assert warned == long * [("test_cases.py", "4", "test_cases.py::test_plain")]
