"""Write `kernels.h`, which takes from Python everything on which Python and the C files must agree.

For each kernel of ``entries.py``, the header declares a struct of its arguments. The types come from the kernel's
signature. The names of its parameters come from its source, which is parsed, because importing it would need Numba. A
kernel with several results has a struct for its results, too. The header also has the kernels' signatures, the tables
of arrays that kernels take by their address, and constants. The build writes the header next to the files that it
makes.
"""

import ast
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from loewner._kernels import codes, columns, records, tolerances
from loewner._kernels._sources import source_hash
from loewner._native.entries import ENTRIES, Entry
from loewner.bodies import CURVED, native_files
from loewner.planners import compiled, gates, joint_limits, judge, searches
from loewner.robots import checker
from loewner.robots.checking.edges import NEARLY_WHOLE
from loewner.robots.description import robot, watch
from loewner.robots.proofs import contacts

NAME = "kernels.h"
KERNELS = Path(records.__file__).parent

BEGIN = """/* Written by `native/headers.py`. */

#ifndef LOEWNER_KERNELS_H
#define LOEWNER_KERNELS_H

#include <stdint.h>

/* Arrays in C order, as arguments: an address and lengths, each in a slot of eight bytes. */
typedef struct { const void *data; int64_t length; } Array1;
typedef struct { const void *data; int64_t rows, columns; } Array2;
typedef struct { const void *data; int64_t count, rows, columns; } Array3;
typedef struct { const void *data; int64_t count, links, rows, columns; } Array4;

/* Arrays as results. The caller releases the memory, whose description comes first. */
typedef struct { void *memory; Array1 array; } Given1;
typedef struct { void *memory; Array2 array; } Given2;

_Static_assert(sizeof(void *) == sizeof(int64_t), "an address takes a slot");
"""

COLUMNS = (
    "SOLID", "SURFACE", "MAPPED", "POLYTOPE", "REACH", "HOT", "COLUMNS", "POINTS_FROM", "POINTS_TO", "SURFACE_AT",
    "LAYOUT", "PARTS", "DEEPEST", "WIDE", "FIXED", "BALL", "TRANSLATION", "CACHE_LINE", "ITERATION", "RANDOM", "ROWS",
    "STATE", "TREE_ROWS",
)  # fmt: skip


def text() -> str:
    """Return the header."""
    lists = {
        "pieces": records.Pieces._fields,
        "problem": records.Tree._fields + records.Problem._fields[1:],
        "motion_tables": records.MotionTables._fields,
        "search": records.Search._fields,
    }
    return "\n".join([
        BEGIN,
        *(f"#define {name} {value}" for name, value in constants().items()),
        "",
        *(struct(name, dict.fromkeys(fields, "Array2")) for name, fields in lists.items()),
        *(line for entry in ENTRIES.values() for line in declarations(entry)),
        "#define ALL_KERNELS(X) " + " ".join(f"X({name})" for name in ENTRIES),
        "\n#endif\n",
    ])  # fmt: skip


def constants() -> dict[str, str]:
    """Constants by their names in C; the names of all codes begin with ``CODE_``."""
    mesh = numbers_of("trees/triangle_tree.py", NODE_BITS=columns.NODE_BITS)
    boxes = numbers_of("trees/boxes.py", WIDE=columns.WIDE)
    values = {
        **{f"CODE_{name}": value for name, value in vars(codes).items() if name.isupper()},
        **{name: getattr(columns, name) for name in COLUMNS},
        "KIND_OF": columns.KIND, "LAST_KIND": max(CURVED), "POINT_BLOCK": columns.BLOCK,
        "LINK_CONSTANTS": columns.CONSTANTS, "GROUP_NUMBERS": boxes["ROWS"], "TREE_LEVELS": boxes["LEVELS"],
        "WIDE_SURFACE": mesh["WIDE"], "LEAF_BITS": mesh["LEAF_BITS"], "BLOCK_NUMBERS": mesh["BLOCK"],
        "DIAGONAL_NUMBERS": mesh["DIAGONALS"], "SURFACE_LEVELS": mesh["LEVELS"],
        "FILE_FORMAT": native_files.FORMAT, "FILE_HEADER": native_files.HEADER.size,
        "BEHIND_CHECKSUM": native_files.BEHIND_CHECKSUM,
        **{f"FILE_{name.upper()}": number for number, name in enumerate((*native_files.BEFORE, "packs"))},
        "STRETCH": tolerances.CHAIN_STRETCH, "ROUNDED_VALUES": contacts.OFF,
        "FIRST_LOOK": checker.FIRST_LOOK, "LARGEST_VALUE": watch.LARGEST_VALUE, "NEARLY_WHOLE": NEARLY_WHOLE,
        "QUATERNION_TOLERANCE": robot.QUATERNION_TOLERANCE, "ROTATION_TOLERANCE": tolerances.ROTATION_TOLERANCE,
        "ON_LIMIT": joint_limits.ON_LIMIT, "PLAN_TOLERANCE": judge.TOLERANCE,
        "TREE_CAPACITY": compiled.CAPACITY, "FIRST_ITERATIONS": compiled.FIRST, "MOST_ITERATIONS": compiled.AT_A_TIME,
        "A_WHILE": compiled.A_WHILE, "USUAL_CUTS": compiled.CUTS, "USUAL_ITERATIONS": searches.UNLIMITED,
        "MOST_ROOM": compiled.MOST_ROOM, "LEAST_STEPS": gates.LEAST_STEPS, "SAME_TICK": gates.SAME_TICK,
        "ROUNDED": gates.ROUNDED, "WITHIN": gates.WITHIN,
    }  # fmt: skip
    return {name: f"({value!r})" for name, value in values.items()} | {"SOURCES": f'"{source_hash()}"'}


def declarations(entry: Entry) -> Iterator[str]:
    """Structs of a kernel's arguments and results, and its signature."""
    defined = source(entry.module.replace(".", "/") + ".py").body
    function = next(node for node in defined if isinstance(node, ast.FunctionDef) and node.name == entry.name)
    takes, gives = entry.arguments.split(), entry.results.split()
    names = [argument.arg for argument in function.args.args]
    if takes:
        fields = {name: type_of(word, "Array") for name, word in zip(names, takes, strict=True)}
        yield struct(entry.name, fields | {"memory": "void *"} if "memory" in fields else fields)
    if len(gives) > 1:
        named = zip(result_names(function, len(gives)), gives, strict=True)
        yield struct(f"{entry.name}_results", {name: type_of(word, "Given") for name, word in named})
    yield f'#define {entry.name.upper()}_WORDS "{entry.arguments}", "{entry.results}"\n'


def struct(name: str, fields: dict[str, str]) -> str:
    """Declare a struct."""
    return "\n".join([f"struct {name} {{", *(f"    {kind} {field};" for field, kind in fields.items()), "};\n"])


def type_of(word: str, array: str) -> str:
    """Type of a word of a signature, see `entries.py`."""
    return {"i": "int64_t", "b": "int64_t", "f": "double"}.get(word, f"{array}{word[-1]}")


def result_names(function: ast.FunctionDef, count: int) -> list[str]:
    """Names of a kernel's results: names of variables, if any return statement has a different variable for each."""
    for node in ast.walk(function):
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
            names = [ast.unparse(value).partition("[")[0].rpartition(".")[2] for value in node.value.elts]
            if len(set(names)) == count and all(name.isidentifier() and name.islower() for name in names):
                return names
    return [f"result_{number}" for number in range(count)]


@cache
def source(path: str) -> ast.Module:
    """Parse a file of the kernels."""
    return ast.parse((KERNELS / path).read_text(encoding="utf-8"))


def numbers_of(path: str, **known: Any) -> dict[str, Any]:
    """Return the constants of a kernel file that depend only on known constants and on earlier constants."""
    for node in source(path).body:
        if isinstance(node, ast.Assign):
            with suppress(NameError):
                exec(compile(ast.Module([node], []), path, "exec"), {"__builtins__": {}}, known)
    return known
