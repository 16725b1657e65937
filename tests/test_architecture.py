"""ARCHITECTURE.md is true: its lists are the modules, its order the import rules', its arrows the imports."""

import ast
import functools
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "loewner"
TEXT = (ROOT / "ARCHITECTURE.md").read_text()


@functools.cache
def imports() -> dict[str, set[str]]:
    """The modules that each module imports, wherever in its files."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        module = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if module == "__init__":
            continue
        named = found.setdefault(module, set())
        for node in ast.walk(ast.parse(path.read_text())):
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


def layers(container: str = "loewner") -> list[set[str]]:
    """Layers of the import rules of a package, from the top."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (rule,) = (contract for contract in contracts if contract.get("containers") == [container])
    return [set(re.findall(r"\w+", layer)) for layer in rule["layers"]]


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


@pytest.mark.parametrize("package", ["robots", "scene_files", "bodies", "cli"])
def test_packages_are_listed(package):
    """The list of a package names each file once, from the top layer of its import rules to the lowest."""
    (block,) = re.findall(rf"^    {package}/\n(.*?)^$", TEXT, flags=re.M | re.S)
    listed = re.findall(r"(\w+)\.py +", block)
    files = [path.stem for path in (PACKAGE / package).glob("*.py") if path.stem != "__init__"]
    level = {name: depth for depth, layer in enumerate(layers(f"loewner.{package}")) for name in layer}
    assert sorted(listed) == sorted(files) == sorted(level)
    assert [level[name] for name in listed] == sorted(level[name] for name in listed)


def test_kernels_are_listed():
    """The list of kernels names each file once, and no file uses one of a folder that comes later in the rules."""
    (block,) = re.findall(r"^    _kernels/\n(.*?)^$", TEXT, flags=re.M | re.S)
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
