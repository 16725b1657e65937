"""Save bodies to ``.npz`` files and load them, with `loewner._base._archives`."""

from __future__ import annotations

import math
import os
import re
from dataclasses import astuple
from typing import Any

import numpy as np

from loewner._base import _archives
from loewner._base._archives import Format
from loewner.bodies.checks import INTEGERS, check_shapes, checked
from loewner.bodies.layout import ARRAYS, arrays_of
from loewner.bodies.pack import Packed
from loewner.errors import InputError
from loewner.meshes.coverage import Covering

BODIES = Format(
    "loewner-bodies",
    2,
    what="a body",
    else_use="for a mesh use loewner.Body.from_mesh",
    arrays=ARRAYS,
    integers=frozenset(INTEGERS),
    check_shapes=check_shapes,
    texts=("covering",),
    optional=frozenset(("covering",)),
)

# Surfaces require version 2. Bodies without surfaces are written as version 1, which older versions of loewner can
# read.
WITH_SURFACES, WITHOUT = 2, 1

COVERINGS = ("convex", "hull", "decomposition", "solid", "cover", "swept")


def save(packed: Packed, path: str | os.PathLike[str], covering: Covering | None) -> None:
    """Write a pack, and the covering of the mesh from which the pack was made."""
    _archives.write(path, BODIES, _content(packed, covering), WITH_SURFACES if packed.trees else WITHOUT)


def checksum(packed: Packed, covering: Covering | None) -> str:
    """Return the SHA-256 of the content that `save` writes, in hexadecimal digits."""
    return _archives.digest(_content(packed, covering))


def load(path: str | os.PathLike[str], wanted: str | None = None) -> tuple[Packed, Covering | None]:
    """Read a file written by `save`; refuse it if its checksum differs from `wanted`."""
    return _archives.read(path, BODIES, _bodies, wanted)


def _content(packed: Packed, covering: Covering | None) -> dict[str, Any]:
    arrays = arrays_of(packed)
    if covering is not None:
        arrays["covering"] = np.array([str(value) for value in astuple(covering)])
    return arrays


def _bodies(told: dict[str, Any]) -> tuple[Packed, Covering | None]:
    """Make bodies from their arrays, and read the covering if the arrays include one."""
    covering = _covering(told.pop("covering").tolist()) if "covering" in told else None
    return checked(told), covering


def _covering(values: list[str]) -> Covering:
    """Read how well pieces cover a mesh, from the six strings that `save` writes.

    Older files have five strings, without `max_protrusion`, which becomes NaN.
    """
    if np.shape(values) not in ((5,), (6,)):
        raise InputError(f"covering: expected six entries, found {values!r}")
    kind, exact, uncovered, excess, samples, *last = values
    if kind not in COVERINGS or exact not in ("True", "False") or not re.fullmatch(r"\d{1,18}", samples, re.ASCII):
        kinds = ", ".join(COVERINGS)
        raise InputError(f"covering: expected a kind among {kinds}, True or False, ..., found {values!r}")
    text = ", ".join([uncovered, excess, *last])
    try:
        gap, more, out = float(uncovered), float(excess), float(last[0]) if last else math.nan
    except ValueError:
        raise InputError(f"covering: expected numbers, found {text}") from None
    right = 0 <= gap < math.inf and (math.isnan(more) or -1 <= more < math.inf)
    if not (right and (math.isnan(out) or 0 <= out < math.inf)):
        raise InputError(f"covering: expected a length >= 0, a ratio >= -1 or nan, a length >= 0 or nan, found {text}")
    return Covering(kind, exact == "True", gap, more, int(samples), out)
