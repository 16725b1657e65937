"""Bodies in ``.npz`` files: written whole or not at all, read checked."""

from __future__ import annotations

import hashlib
import os
import zipfile
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from loewner import meshes
from loewner._files import replacing
from loewner.bodies.pack import ARRAYS, Packed, arrays_of
from loewner.errors import FileError, InputError

FORMAT, VERSION = "loewner-bodies", 1


def save(packed: Packed, path: str | os.PathLike[str], covering: meshes.Covering | None) -> None:
    """Write a pack, and what the pieces of a mesh leave uncovered."""
    arrays = arrays_of(packed)
    if covering is not None:
        arrays["covering"] = np.array([str(value) for value in astuple(covering)])
    target = Path(path)
    if target.suffix != ".npz":
        raise InputError(f"path: expected a name that ends in .npz, found {target.name!r}")
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "digest": _digest(arrays), **arrays}
    with replacing(target) as temporary, open(temporary, "xb") as stream:
        np.savez_compressed(stream, **content)


def load(path: str | os.PathLike[str]) -> tuple[Packed, meshes.Covering | None]:
    """Read what `save` wrote."""
    if os.path.isfile(path) and not zipfile.is_zipfile(path):
        raise FileError(
            f"{path}: expected a body saved as .npz, found another kind of file or a damaged one; "
            "for a mesh use loewner.Body.from_mesh"
        )
    try:
        stored = np.load(path, allow_pickle=False)
        if not isinstance(stored, np.lib.npyio.NpzFile):
            raise FileError(f"{path}: expected a loewner .npz, found a single array")
        with stored:
            content = {name: stored[name] for name in stored.files}
    except FileNotFoundError:
        raise FileError(f"{path}: expected a file, found none") from None
    except FileError:
        raise
    except Exception as error:  # a damaged zip or array header ends in any of a dozen exceptions, zlib's among them
        raise FileError(f"{path}: expected a loewner .npz, found something unreadable ({error})") from None
    if str(content.get("format")) != FORMAT:
        raise FileError(f"{path}: expected a loewner .npz, found another kind of .npz")
    version = content.get("version")
    if version is None or version.shape != () or int(version) != VERSION:
        raise FileError(
            f"{path}: expected format version {VERSION}, found {version}; a newer loewner may have written it"
        )
    missing = [name for name in ARRAYS if name not in content]
    if missing:
        raise FileError(f"{path}: expected the arrays of a body, found none called {', '.join(missing)}")
    arrays: dict[str, Any] = {name: content[name] for name in ARRAYS}
    checked = arrays | ({"covering": content["covering"]} if "covering" in content else {})
    if str(content.get("digest")) != _digest(checked):
        raise FileError(f"{path}: the content does not match its checksum; the file is damaged or was altered")
    covering = None
    if "covering" in content:
        kind, exact, uncovered, excess, samples = (str(entry) for entry in content["covering"])
        covering = meshes.Covering(kind, exact == "True", float(uncovered), float(excess), int(samples))
    return Packed(**arrays), covering


def _digest(arrays: dict[str, Any]) -> str:
    """Checksum over all arrays, so that a damaged or altered file never turns into a verdict."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
