"""Check the size of an MJCF file before MuJoCo compiles the file, since no signal can interrupt the compiler."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

from loewner._base import _validate
from loewner._base._files import read_regular, shown
from loewner._base._xml import Element, XmlError, parse
from loewner.errors import FileError

# Limits on the bytes, the elements, and the nesting of elements in a file; and on the included files of a model, and
# the copies made by replicas. The time to compile grows with the square of the number of copies. Compiling MOST_COPIES
# copies takes a few seconds, and gives more pairs than a checker accepts.
MOST_BYTES = 2**26
MOST_ELEMENTS = 2_000_000
DEEPEST = 1000
MOST_INCLUDES = 100
MOST_COPIES = 4096

# Bytes that MuJoCo's compiler uses for each sample of a height field.
BYTES_A_SAMPLE = 64

# Elements that name files, and the attributes of <compiler> that name folders of files.
FILE_ELEMENTS = ("mesh", "hfield", "skin", "texture", "model", "include", "plugin", "flexcomp")
FOLDERS = ("meshdir", "texturedir", "assetdir")


@dataclass
class _Model:
    """The parts of a model that have been found so far.

    Attributes
    ----------
    folder : Path
        Folder of the main file.
    copies : int
        Number of copies made by replicas and composites; the numbers of nested replicas are multiplied.
    folders : set of str
        Folders that <compiler> names, and the empty folder.
    files : list of tuple of Path and str
        Each entry is a file, and a name of another file that it contains.
    included : int
    """

    folder: Path
    copies: int = 0
    folders: set[str] = field(default_factory=lambda: {""})
    files: list[tuple[Path, str]] = field(default_factory=list)
    included: int = 0


def check_limits(file: Path) -> str:
    """Refuse a model on which MuJoCo's compiler would run for very long or block; return the tag of the root element.

    Raises
    ------
    FileError
        If a file is missing or is not a regular file, or if includes, replicas or height fields exceed the limits.
    """
    model = _Model(file.parent)
    tag = _look(file, model, 1)
    for source, name in model.files:
        for folder in sorted(model.folders):
            for start in (model.folder, source.parent):
                path = start / folder / name
                if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
                    raise FileError(f"{shown(source)}: expected regular files, found {shown(path)}, which is none")
    return tag


def _look(file: Path, model: _Model, copies: int) -> str:
    """Search a file, which the model contains `copies` times, and its included files; return the tag of its root."""
    data = read_regular(file, "an MJCF file", MOST_BYTES)
    try:
        root = parse(data, "an MJCF file", Element, deepest=DEEPEST, most=MOST_ELEMENTS)
    except XmlError as error:
        raise FileError(f"{shown(file)}, line {error.line}: {error}") from None
    waiting = [(root, copies)]
    while waiting:
        element, around = waiting.pop()
        attributes, repeats = element.attributes, element.tag in ("replicate", "composite", "flexcomp")
        count = _product(attributes.get("count", "")) if repeats else 1
        within = around * count
        waiting += [(child, within) for child in reversed(element.children)]
        where = f"{shown(file)}, line {element.line}: expected at most"
        if count > 1:
            model.copies += within
        if model.copies > MOST_COPIES:
            raise FileError(f"{where} {MOST_COPIES} copies by <replicate> and the like, found {model.copies} or more")
        if element.tag == "hfield":
            samples = _product(attributes.get("nrow", "")) * _product(attributes.get("ncol", ""))
            _validate.fits_memory(BYTES_A_SAMPLE * samples, f"{shown(file)}: a height field of {samples} samples")
        if element.tag == "compiler":
            model.folders.update(attributes[name] for name in FOLDERS if name in attributes)
        name = attributes.get("file", "")
        if element.tag in FILE_ELEMENTS and name:
            model.files.append((file, name))
        if element.tag in ("include", "model") and name:
            model.included += 1
            if model.included > MOST_INCLUDES:
                raise FileError(f"{where} {MOST_INCLUDES} included files, found more")
            for folder in dict.fromkeys((model.folder, file.parent)):  # MuJoCo searches the main file's folder first
                if os.path.lexists(folder / name):
                    _look(folder / name, model, within)
                    break
    return root.tag


def _product(text: str) -> int:
    """Multiply the integers in a text; 1 if there are none."""
    try:
        return math.prod(max(int(float(word)), 1) for word in text.split())
    except (ValueError, OverflowError):
        return 1
