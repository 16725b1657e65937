"""Read mesh files as triangles, completely or not at all, and check a file's declarations against its content.

The readers are loewner's own. General readers are designed to show as much of a file as possible: they drop unknown
elements, replace undecodable values with zeros and let negative indices wrap around. That is the wrong compromise here,
since half a mesh may be free where the whole mesh collides. Checking the results of such a reader would require reading
the file again. `stl`, `obj`, `ply`, `off`, `gltf` and `dae` read the formats, and share `parts` and `text`.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from loewner._base._files import read_regular, shown
from loewner._base._plausible import warn
from loewner._base._validate import Floats
from loewner.errors import FileError
from loewner.meshes.files.parts import Refusal, Tell, Triangles

# Limit on the size of a mesh file, and on the total size of the files that a glTF file names [bytes]. A binary STL of
# this size has 43 million triangles, whose fit takes more memory than most machines have.
LIMIT = 1 << 31

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf", ".dae")


def read(path: Path) -> tuple[Floats, Triangles]:
    """Read the vertices in metres, shape (v, 3), and the triangles, shape (t, 3), of a file.

    A file that states its unit of length is converted to metres; all other files are assumed to be in metres. Vertices
    may be infinite or NaN if the file contains such values; all indices belong to existing vertices. Each kind of
    doubtful content causes one warning, which names the place of its first occurrence in the file.

    Raises
    ------
    FileError
        If the file cannot be read, is larger than `LIMIT`, or is not a complete mesh in the format of its extension.
    """
    name, suffix = shown(path), path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(f"{name}: expected one of {', '.join(SUFFIXES)}, found {shown(path.suffix) or 'no suffix'}")
    data = read_regular(path, "a mesh file", LIMIT)
    if not data:
        raise FileError(f"{name}: expected a mesh file, found an empty one")
    told: dict[str, list[str]] = {}
    try:
        with np.errstate(all="ignore"):  # non-finite results are noticed later
            mesh = _reader(suffix, path.parent)(data, lambda text, place: told.setdefault(text, []).append(place))
    except Refusal as refusal:
        where = f", line {refusal.line}" if refusal.line else ""
        raise FileError(f"{name}{where}: {refusal}") from None
    except MemoryError:
        raise FileError(
            f"{name}: expected a mesh that fits into memory, found {len(data)} bytes; reading takes ten times as much"
        ) from None
    for text, places in told.items():
        where = ", ".join(filter(None, [name, places[0]]))
        warn(f"{where}: {text}" + (f" ({len(places) - 1} more of this kind)" if len(places) > 1 else ""))
    return mesh


def _reader(suffix: str, folder: Path) -> Callable[[bytes, Tell], tuple[Floats, Triangles]]:
    """Return the reader of a format; readers are imported only when a mesh file is read."""
    from loewner.meshes.files import dae, gltf, obj, off, ply, stl

    readers: dict[str, Callable[[bytes, Tell], tuple[Floats, Triangles]]] = {
        ".stl": stl.read,
        ".obj": obj.read,
        ".ply": ply.read,
        ".off": off.read,
        ".glb": lambda data, tell: gltf.read(data, folder, True, LIMIT, tell),
        ".gltf": lambda data, tell: gltf.read(data, folder, False, LIMIT, tell),
        ".dae": dae.read,
    }
    return readers[suffix]
