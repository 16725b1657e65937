"""ARCHITECTURE.md is true: its rooms are the modules, its order the import rules', its arrows the imports."""

import ast
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "loewner"
TEXT = (ROOT / "ARCHITECTURE.md").read_text()


def imports() -> dict[str, set[str]]:
    """The rooms that each room imports, wherever in its files."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if room == "__init__":
            continue
        named = found.setdefault(room, set())
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "loewner":
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("loewner."):
                named.add(node.module.split(".")[1])
    return {room: {name for name in names if name in found} - {room} for room, names in found.items()}


def without_detours(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Leave out each arrow that other arrows lead along as well."""

    def below(rooms: set[str]) -> set[str]:
        return rooms | {deeper for room in rooms for deeper in below(arrows[room])}

    return {room: {name for name in names if name not in below(names - {name})} for room, names in arrows.items()}


def layers() -> list[set[str]]:
    """Layers of the import rules, from the top."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (rule,) = (contract for contract in contracts if contract["type"] == "layers")
    return [set(re.findall(r"\w+", layer)) for layer in rule["layers"]]


def drawn() -> dict[str, set[str]]:
    """Arrows of the diagram."""
    (diagram,) = re.findall(r"^```mermaid\nflowchart TD\n(.*?)^```", TEXT, flags=re.M | re.S)
    lines = [line.split(" --> ") for line in diagram.splitlines()]
    return {room.strip(): set(names.split(" & ")) for room, names in lines}


def test_list_has_the_order_of_the_rules():
    """The list names each module once, from the top layer of the import rules to the lowest."""
    lines = re.findall(r"^      ((?:\w+(?:\.py|/) +)+)", TEXT, flags=re.M)
    listed = [name for line in lines for name in re.findall(r"\w+(?=\.py|/)", line) if name != "__init__"]
    level = {room: depth for depth, layer in enumerate(layers()) for room in layer}
    assert sorted(listed) == sorted(set(level) - {"__main__"})
    assert [level[room] for room in listed] == sorted(level[room] for room in listed)
    assert set(level) == set(imports())


def test_diagram_shows_the_imports():
    """Each arrow of the diagram is an import, and each import is an arrow or a way along several."""
    expected = {room: names for room, names in without_detours(imports()).items() if names}
    lines = "\n".join(f"    {room} --> {' & '.join(sorted(names))}" for room, names in sorted(expected.items()))
    assert drawn() == expected, f"the diagram of these imports is\n{lines}"


def test_arrows_point_down():
    """The diagram agrees with the import rules: every arrow leads to a lower layer."""
    level = {room: depth for depth, layer in enumerate(layers()) for room in layer}
    upward = [(room, name) for room, names in drawn().items() for name in names if level[name] <= level[room]]
    assert upward == []
