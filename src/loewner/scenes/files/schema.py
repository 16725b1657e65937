"""The JSON Schema of scene files; editors use it, and the reader takes its keys from it."""

from __future__ import annotations

import pkgutil
from pathlib import Path
from typing import Any

from loewner._base import _json

# `loewner --scene-schema` prints this path.
SCHEMA_FILE = Path(__file__).parents[2] / "share" / "scene.schema.json"

SCHEMA: dict[str, Any] = _json.parsed(pkgutil.get_data("loewner", "share/scene.schema.json") or b"", str(SCHEMA_FILE))
BODY: dict[str, Any] = SCHEMA["definitions"]["body"]

Keys = tuple[tuple[str, ...], tuple[str, ...]]


def keys_of(place: str) -> Keys:
    """Return the allowed keys and the required keys of the mapping `place` in a body's entry."""
    return keys_in(BODY["properties"][place])


def keys_in(rule: dict[str, Any]) -> Keys:
    """Return the allowed keys and the required keys of a mapping according to a rule of the schema."""
    return tuple(rule["properties"]), tuple(rule.get("required", ()))
