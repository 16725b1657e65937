"""Install what programs in C and C++ need below a prefix: headers, libraries, and files for CMake and pkg-config.

    python native/install.py PREFIX              the library that was built for this machine
    python native/install.py PREFIX --levels all    for all processors of this architecture; built if necessary

The installed files need neither Python nor any other part of loewner.
"""

import argparse
import shutil
import sys
from pathlib import Path

from build import HEADERS, HOME, LEVELS, LIBRARY, BuildError, architecture, build, folder_for, is_built, machine_level

SHARE = HEADERS.parent / "share"


def install(prefix: Path, home: Path = HOME) -> list[Path]:
    """Copy the files, and return their new paths."""
    lib = prefix / "lib"
    wanted = {
        **{path: prefix / "include" / path.name for path in sorted(HEADERS.iterdir())},
        **{path: lib / path.name for path in (home / LIBRARY, *sorted(home.glob("kernels-*.so")))},
        **{path: lib / "cmake" / "loewner" / path.name for path in sorted((SHARE / "cmake").iterdir())},
    }
    for source, target in wanted.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
        target.chmod(0o755 if target.suffix == ".so" else 0o644)
    text = (SHARE / "pkgconfig" / "loewner.pc").read_text(encoding="utf-8")
    listed = lib / "pkgconfig" / "loewner.pc"
    listed.parent.mkdir(exist_ok=True)
    listed.write_text(text.replace("libdir=${prefix}/_native", "libdir=${prefix}/lib"), encoding="utf-8")
    return [*wanted.values(), listed]


def main() -> int:
    """Build missing files, and install all files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prefix", type=Path)
    parser.add_argument("--levels", choices=("machine", "all"), default="machine")
    parser.add_argument(
        "--from", type=Path, default=HOME, metavar="FOLDER", dest="home", help="where the library is built"
    )
    options = parser.parse_args()
    try:
        work = folder_for(options.home)
        try:
            levels = list(LEVELS[architecture()]) if options.levels == "all" else [machine_level(work)]
            if not is_built(levels, options.home):
                build(levels, work, options.home)
        finally:
            shutil.rmtree(work)
        for path in install(options.prefix, options.home):
            print(path)
    except (BuildError, OSError) as error:
        print(f"install: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
