"""Answers of a library whose functions are linked in another order, in another number of object files.

    python tests/linked_otherwise.py FOLDER COUNT ORDER    the table of `answers.py`; ORDER is 1, or -1 for backwards

Entries are dealt to the object files in turn, so that functions have other neighbours than in the library.
"""

import json
import runpy
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from loewner._native import entries, library
from native_files import module


def linked(folder: Path, count: int, order: int) -> None:
    """Link a library for the level of the one in use, and use it from now on."""
    build, emit = module("build"), module("emit")
    level, home = library.level(), library.HOME
    codes = [folder / f"{name}.code" for name in entries.ENTRIES]
    for code in codes:
        emit.write_code(entries.ENTRIES[code.stem], code)
    objects, elsewhere = [], set()
    for number in range(count):
        read = [json.loads(path.read_text()) for path in codes[number::count][::order]]
        codegen = emit.cpu_target.target_context.codegen()
        own = [emit._parts.library_of(codegen, one["key"]) for one in read]
        parts = emit._parts.everything_called(own, without=elsewhere)
        elsewhere.update(filter(emit.apart_functions, parts))
        objects.append(folder / f"{number}.o")
        objects[-1].write_bytes(emit.machine_code(parts[::order], [one["shim"] for one in read]))
    made = folder / "library"
    made.mkdir()
    build.link(objects, level, folder / f"kernels-{level}.so")
    shutil.copy(home / library.CALL, folder)
    build.publish([folder / f"kernels-{level}.so", folder / library.CALL], made)
    library.HOME = made
    library._opened.cache_clear()
    assert library.level() == level


if __name__ == "__main__":
    linked(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
    sys.argv = sys.argv[:1]
    runpy.run_path(str(Path(__file__).with_name("answers.py")), run_name="__main__")
