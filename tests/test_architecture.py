"""ARCHITECTURE.md is true: its lists are the modules, its order the import rules', its arrows the imports.

And functions stay small enough to be read.
"""

import ast
import functools
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "loewner"
TEXT = (ROOT / "ARCHITECTURE.md").read_text()

pytestmark = pytest.mark.light

# A package's plan is short enough to be read before its files.
MOST_LINES_OF_A_PLAN = 12


@functools.cache
def imports() -> dict[str, set[str]]:
    """The modules that each module imports, wherever in its files."""
    found: dict[str, set[str]] = {}
    for path, tree in trees().items():
        module = path.split("/")[0].removesuffix(".py")
        if module == "__init__":
            continue
        named = found.setdefault(module, set())
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module == "loewner":
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("loewner."):
                named.add(node.module.split(".")[1])
    return {module: {name for name in names if name in found} - {module} for module, names in found.items()}


def without_detours(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Leave out each arrow that other arrows lead along as well."""

    @functools.cache
    def below(module: str) -> set[str]:
        return arrows[module].union(*map(below, arrows[module]))

    return {module: names.difference(*map(below, names)) for module, names in arrows.items()}


@functools.cache
def contracts() -> list[dict[str, Any]]:
    """The import rules."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]


def layers(container: str = "loewner") -> list[set[str]]:
    """Layers of the import rules of a package, from the top."""
    (rule,) = (contract for contract in contracts() if contract.get("containers") == [container])
    return [set(re.findall(r"\w+", layer)) for layer in rule["layers"]]


def names_of(contract: dict[str, Any]) -> set[str]:
    """The modules that the layers of a rule name."""
    return set(re.findall(r"\w+", " ".join(contract["layers"])))


def drawn() -> dict[str, set[str]]:
    """Arrows of the diagram."""
    (diagram,) = re.findall(r"^```mermaid\nflowchart TD\n(.*?)^```", TEXT, flags=re.M | re.S)
    lines = [line.split(" --> ") for line in diagram.splitlines()]
    return {module.strip(): set(names.split(" & ")) for module, names in lines}


def test_list_has_the_order_of_the_rules():
    """The list names each module once, from the top layer of the import rules to the lowest."""
    (block,) = re.findall(r"^    src/loewner/\n(.*?)^$", TEXT, flags=re.M | re.S)
    lines = re.findall(r"^      ((?:\w+(?:\.py|/) +)+)", block, flags=re.M)
    listed = [name for line in lines for name in re.findall(r"\w+(?=\.py|/)", line) if name != "__init__"]
    level = {module: depth for depth, layer in enumerate(layers()) for module in layer}
    assert sorted(listed) == sorted(set(level) - {"__main__"})
    assert [level[module] for module in listed] == sorted(level[module] for module in listed)
    assert set(level) == set(imports())


def test_diagram_shows_the_imports():
    """Each arrow of the diagram is an import, and each import is an arrow or a way along several."""
    expected = {module: names for module, names in without_detours(imports()).items() if names}
    lines = "\n".join(f"    {module} --> {' & '.join(sorted(names))}" for module, names in sorted(expected.items()))
    assert drawn() == expected, f"the diagram of these imports is\n{lines}"


def test_arrows_point_down():
    """The diagram agrees with the import rules: every arrow leads to a lower layer."""
    level = {module: depth for depth, layer in enumerate(layers()) for module in layer}
    upward = [(module, name) for module, names in drawn().items() for name in names if level[name] <= level[module]]
    assert upward == []


PACKAGES = sorted(
    path.parent.relative_to(PACKAGE).as_posix()
    for path in PACKAGE.rglob("__init__.py")
    if path.parent != PACKAGE and not path.is_relative_to(PACKAGE / "_kernels")
)


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_say_what_is_where(package):
    """The first lines of a package name each of its files, and its import rules, where it has some, list them all."""
    text = ast.get_docstring(ast.parse((PACKAGE / package / "__init__.py").read_text()))
    files = {path.stem for path in (PACKAGE / package).glob("*.py")} - {"__init__"}
    folders = {path.parent.name for path in (PACKAGE / package).glob("*/__init__.py")}
    assert (files | folders) - set(re.findall(r"`(\w+)", text)) == set()
    assert len(text.splitlines()) <= MOST_LINES_OF_A_PLAN
    container = "loewner." + package.replace("/", ".")
    ruled = [names_of(contract) for contract in contracts() if contract.get("containers") == [container]]
    assert ruled in ([], [files | folders])


def test_kernels_are_listed():
    """The list of kernels names each file once, and no file uses one of a folder that comes later in the rules."""
    text = (ROOT / "docs" / "design" / "queries.md").read_text()
    (block,) = re.findall(r"^    _kernels/\n(.*?)^$", text, flags=re.M | re.S)
    listed, folder = [], ""
    for line in block.splitlines():
        if heading := re.match(r"^      (\w+)/$", line):
            folder = heading[1] + "/"
            continue
        name = re.match(r"^( +)((?:\w+\.py +)+)", line)
        assert name, line
        listed += [(folder if len(name[1]) == 8 else "") + file for file in name[2].split()]
    kernels = PACKAGE / "_kernels"
    assert sorted(listed) == sorted(
        path.relative_to(kernels).as_posix() for path in kernels.rglob("*.py") if path.name != "__init__.py"
    )
    level = {name: depth for depth, layer in enumerate(layers("loewner._kernels")) for name in layer}
    tops = [level[file.split("/")[0].removesuffix(".py")] for file in listed]
    assert set(level) == {file.split("/")[0].removesuffix(".py") for file in listed}
    assert tops == sorted(tops, reverse=True)


@functools.cache
def trees() -> dict[str, ast.Module]:
    """The syntax trees of all files of the library, by their path in it."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in paths}


# Parameters of a function, and lines of its body without the docstring, at most.
MOST_PARAMETERS, MOST_LINES = 14, 130


def test_functions_are_small():
    """No function takes 15 parameters or more, and no body has over 130 lines."""
    large = []
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            lines = body[-1].end_lineno - body[0].lineno + 1 if body else 0
            parameters = sum(isinstance(part, ast.arg) for part in ast.walk(node.args))
            if parameters > MOST_PARAMETERS or lines > MOST_LINES:
                large.append(f"{path}: {node.name}: {parameters} parameters, {lines} lines")
    assert large == []


# What a variable was, not what it holds.
PARTICIPLES = {"found", "made", "given", "known", "asked"}


def test_variables_are_named_for_what_they_hold():
    """No local variable is a bare participle; `made` of `lay_out` is a field that programs in C read."""
    bare = set()
    for path, tree in trees().items():
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            parameters = {part.arg for part in ast.walk(function.args) if isinstance(part, ast.arg)}
            names = (part for part in ast.walk(function) if isinstance(part, ast.Name))
            stored = {name.id for name in names if isinstance(name.ctx, ast.Store)} & PARTICIPLES
            bare |= {f"{path}: {function.name}: {name}" for name in stored - parameters}
    assert bare == {"_kernels/robots/pair_lists.py: lay_out: made"}


# Private names of other projects: the standard library and named tuples; files that use Numba, viser or argparse.
FOREIGN_NAMES = {"_getframe", "_exit", "_asdict", "_replace"}
FOREIGN_FILES = {
    "_kernels/_jit.py",
    "_kernels/_parts.py",
    "_kernels/simd/memory.py",
    "gpu/_ptx.py",
    "viewer/guard.py",
    "cli/completion.py",
}


def bound(tree: ast.Module) -> set[str]:
    """Names of functions, classes, variables and attributes that a file defines."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.attr)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def test_private_names_stay_in_their_package():
    """No file uses a name with an underscore that no file of its package defines, be it of an object or of a module."""
    files, defined = trees(), {}
    for path, tree in files.items():
        defined.setdefault(path.split("/")[0], set()).update(bound(tree))
    strange = []
    for path, tree in files.items():
        known = defined[path.split("/")[0]] | FOREIGN_NAMES
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and path not in FOREIGN_FILES:
                names = {node.attr}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("loewner"):
                folder = PACKAGE.joinpath(*node.module.split(".")[1:])
                names = {alias.name for alias in node.names if not list(folder.glob(f"{alias.name}*"))}  # no module
            else:
                continue
            private = {name for name in names if re.match("_[^_]", name)} - known
            strange += [f"{path}:{node.lineno}: {name}" for name in private]
    assert strange == []


def test_json_and_yaml_have_one_reader_each():
    """Only these files call the parsers, which let a key occur twice; the library's own list is read below them all."""
    callers = {"json": set(), "yaml": set()}
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr in ("load", "loads", "safe_load", "compose", "SafeLoader"):
                for module in callers.keys() & {part.id for part in ast.walk(node.value) if isinstance(part, ast.Name)}:
                    callers[module].add(path)
    assert callers == {"json": {"_base/_json.py", "_native/library.py"}, "yaml": {"_base/_nodes.py"}}


def test_unsettled_answers_travel_as_values():
    """Below the command line and the viewer nothing catches the error of an unsettled answer, but to name its file."""
    catchers = []
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ExceptHandler) and node.type and "ConvergenceError" in ast.unparse(node.type):
                again = any(isinstance(inner, ast.Raise) for inner in node.body)
                catchers += [] if again else [path]
    assert set(catchers) <= {"cli/clearance.py", "cli/report.py", "viewer/robot.py"}
