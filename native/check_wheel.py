"""Check a wheel: its files, its size, and the system libraries that it needs.

python native/check_wheel.py dist/*.whl
python native/check_wheel.py --same-as other.whl dist/*.whl     also check that both hold the same files
"""

import argparse
import json
import sys
import zipfile
from hashlib import sha256
from io import BytesIO
from pathlib import Path

from build import CALL, FOR_C, LEVELS, architecture  # type: ignore[attr-defined]  # the file beside this one
from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile

LARGEST = 3_000_000  # A wheel may take up to LARGEST bytes.
ALLOWED = {"libc.so.6", "libm.so.6", "libdl.so.2", "libpthread.so.0", "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"}
HOME, PTX = "loewner/_native/", "threads.ptx.z"


def faults(path: Path) -> list[str]:
    """Return the faults of a wheel."""
    wheel, names, messages = zipfile.ZipFile(path), files(path), list[str]()
    if (size := path.stat().st_size) >= LARGEST:
        messages.append(f"expected less than {LARGEST:,} bytes, found {size:,}")
    if "-cp311-abi3-" not in path.name:
        messages.append("expected a wheel for all Pythons from 3.11 on, with the tag cp311-abi3")
    if foreign := sorted(name for name in names if not _belongs(name)):
        messages.append(f"expected nothing but the package, found {', '.join(foreign)}")
    if not any(name.endswith("/licenses/LICENSE") for name in names):
        messages.append("expected a LICENSE, found none")
    wanted = {f"kernels-{level}.so" for level in LEVELS[architecture()]} | {CALL, *FOR_C}
    libraries = {name.removeprefix(HOME) for name in names if name.endswith(".so")}
    if libraries != wanted:
        messages.append(f"expected the libraries {', '.join(sorted(wanted))}, found {', '.join(sorted(libraries))}")
    listed = json.loads(wheel.read(f"{HOME}built.json"))["files"]
    if HOME + PTX not in names or sha256(wheel.read(HOME + PTX)).hexdigest() != listed.get(PTX):
        messages.append(f"expected {PTX} as it was built, found none or another")
    for name in sorted(libraries):
        content = wheel.read(HOME + name)
        if sha256(content).hexdigest() != listed.get(name):
            messages.append(f"{name} is not as it was built")
        if strange := needed(content) - ALLOWED:
            messages.append(f"{name}: expected to need nothing but the C library, found {', '.join(sorted(strange))}")
    return messages


def files(path: Path) -> set[str]:
    """Names of a wheel's files."""
    return {name for name in zipfile.ZipFile(path).namelist() if not name.endswith("/")}


def _belongs(name: str) -> bool:
    """Return whether a wheel may have a file with this name."""
    top, _, rest = name.partition("/")
    if rest.startswith("_native/"):
        return rest.endswith((".py", ".so", "built.json", "threads.ptx.z"))
    if rest.startswith(("include/", "share/")):
        return rest.endswith((".h", ".hpp", ".cmake", ".pc", ".schema.json"))
    kinds = (".py", "py.typed", "_kernels/sources.zip")
    return top.endswith(".dist-info") or (top == "loewner" and rest.endswith(kinds))


def needed(content: bytes) -> set[str]:
    """Libraries that an ELF library needs; libraries of other systems are not read."""
    if not content.startswith(b"\x7fELF"):
        return set()
    sections = [one for one in ELFFile(BytesIO(content)).iter_sections() if isinstance(one, DynamicSection)]
    return {tag.needed for section in sections for tag in section.iter_tags("DT_NEEDED")}


def main() -> int:
    """Check a wheel, and print its faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--same-as", type=Path, metavar="WHEEL", help="another wheel, which holds the same files")
    options = parser.parse_args()
    messages = faults(options.wheel)
    other = options.same_as or options.wheel
    if apart := sorted(files(options.wheel) ^ files(other)):
        messages.append(f"expected the files of {other}, found in one only: {', '.join(apart)}")
    for fault in messages:
        print(f"{options.wheel.name}: {fault}", file=sys.stderr)
    unpacked = sum(one.file_size for one in zipfile.ZipFile(options.wheel).infolist())
    print(f"{options.wheel}: {options.wheel.stat().st_size:,} bytes, {unpacked:,} unpacked")
    return 1 if messages else 0


if __name__ == "__main__":
    sys.exit(main())
