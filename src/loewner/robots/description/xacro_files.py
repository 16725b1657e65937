"""Expand xacro files to URDF, with the package xacro.

Xacro files contain Python expressions. The expressions are evaluated only if the caller names such a file or passes
arguments.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from loewner._base import _validate
from loewner.errors import FileError, InputError, imported
from loewner.robots.description.link_bodies import package_folder

# Suffix of the names of files that are expanded.
SUFFIX = ".xacro"

# The package keeps the state of an expansion in its modules, so only one expansion runs at a time.
_alone = threading.RLock()


class _Arguments(dict[str, str]):
    """Arguments of a file; the names that the file declares or reads are added to `used`."""

    def __init__(self, given: Mapping[str, str], used: set[str]) -> None:
        super().__init__(given)
        self.used = used

    def __contains__(self, name: object) -> bool:
        self.used.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.used.add(name)
        return super().__getitem__(name)


class Expansion(NamedTuple):
    """The expansion of a robot's xacro files.

    Attributes
    ----------
    arguments : mapping of str to str, number or bool
        Values of ``<xacro:arg>``.
    folders : sequence of paths
        Packages, and folders that contain packages, for ``$(find package)``.
    used : set of str
        Names of the arguments that the files expanded so far declare or read.
    """

    arguments: Mapping[str, object]
    folders: Sequence[str | os.PathLike[str]]
    used: set[str]

    def text(self, path: str | os.PathLike[str]) -> str:
        """Return the text of the URDF or SRDF that a xacro file describes.

        Raises
        ------
        MissingExtraError
            If the package xacro is not installed.
        FileError
            If the file does not exist, or xacro cannot expand it.
        InputError
            If an argument is not a string, a number or a bool.
        """
        file = _validate.path(path, "path", wanted="a path to a xacro file").absolute()
        texts = {name: _text(name, value) for name, value in self.arguments.items()}
        if not os.path.isfile(file):  # Path.is_file raises if a name is too long
            raise FileError(f"{path}: expected a xacro file, but there is no such file")
        purpose = f"reading {file.name} needs the package xacro"
        xacro, substitution = (imported(name, purpose, "xacro") for name in ("xacro", "xacro.substitution_args"))
        with _alone, _finding(substitution, file, self.folders):
            try:
                document = xacro.process_file(str(file), mappings=_Arguments(texts, self.used), verbosity=0)
                return str(document.documentElement.toprettyxml(indent="  "))
            except Exception as error:  # expressions in the file can raise any error
                if isinstance(getattr(error, "exc", None), FileError):
                    raise error.exc from None  # type: ignore[attr-defined]
                why = str(error) or type(error).__name__
                raise FileError(f"{path}: expected a file that xacro can expand, found that it cannot: {why}") from None

    def refuse_unused(self) -> None:
        """Refuse arguments that no file declares or reads, since most of them are misspelt.

        Raises
        ------
        InputError
        """
        unused = [name for name in self.arguments if name not in self.used]
        if unused:
            raise InputError(
                f"xacro_args: expected arguments that the file declares ({', '.join(sorted(self.used)) or 'none'}), "
                f"found {_validate.short(', '.join(map(str, unused)))}"
            )


def _text(name: object, value: object) -> str:
    """Return the value of an argument as it would be written on a command line."""
    if not isinstance(name, str) or not isinstance(value, (str, int, float)):
        raise InputError(
            f"xacro_args: expected texts, numbers or bools by name, found {_validate.short(value)} for "
            f"{_validate.short(name)}"
        )
    return str(value).lower() if isinstance(value, bool) else str(value)


@contextmanager
def _finding(substitution: Any, file: Path, folders: Sequence[str | os.PathLike[str]]) -> Iterator[None]:
    """Let ``$(find package)`` search the same folders as for meshes; on its own, xacro needs ROS for this."""

    def find(package: str) -> str:
        return str(package_folder(package, file, folders).absolute())  # xacro resolves paths from the file's folder

    names = vars(substitution)
    before = names["_eval_find"]
    names["_eval_find"] = names["_eval_dict"]["find"] = find
    try:
        yield
    finally:
        names["_eval_find"] = names["_eval_dict"]["find"] = before
