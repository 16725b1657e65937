"""Warn once about values that are allowed but usually a mistake: degrees for radians, millimetres for metres.

With the chosen thresholds, a warning is almost certainly right. If the value is intended, the only effect is a line of
text.
"""

from __future__ import annotations

import math
import re
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

# Largest plausible angle [rad]: two turns, since files give angles within one turn in any convention.
LARGEST_RPY = 4 * math.pi

# Limits [rad] in this range are probably in degrees. A joint between stops makes few turns, so that its limits in
# radians are below the range; limits in degrees are at most two turns. Some files write a thousand or more to mean that
# there is no limit.
LIMITS_IN_DEGREES = 4 * math.pi, 720.0

# Velocity limits [rad/s] in this range are probably in degrees, because robot joints make less than eight turns per
# second.
VELOCITY_IN_DEGREES = 50.0, 2000.0

# A larger limit [rad or m], such as 1e16 or the largest float, means that there is no limit.
FARTHEST_LIMIT = 1e6

# Sizes and distances [m] beyond which a warning asks about the unit, as for a hall in millimetres or a screw that was
# scaled down twice.
LARGEST_RADIUS, SMALLEST_RADIUS, LARGEST_DISTANCE = 1000.0, 1e-5, 2000.0

# A robot's mesh with a larger radius [m] is probably in millimetres.
LARGEST_MESH_RADIUS = 25.0

# Modules whose frames belong to a call of the library, including `contextlib`, which wraps context managers.
OF_THE_CALL = ("loewner", "contextlib")

# A comment about units other than metres. The word "in" alone means inches only if nothing follows.
_UNIT = re.compile(
    r"(?<![a-z])units?[\s:=\"'(]+(?:(?:is|are|in|of|length)[\s:=\"'(]+)*"
    r"(?:[mck]m|um|mils?|thou|ft|yd|(?:milli|centi|micro|kilo)met\w*|inch\w*|foot|feet|in(?=[\"')]?\s*$))(?![a-z])",
    re.IGNORECASE | re.MULTILINE,
)


class _Listener(threading.local):
    """The calling thread's list for warnings; Python's own way to catch warnings affects all threads."""

    texts: list[str] | None = None


_listener = _Listener()


@contextmanager
def told_to(texts: list[str]) -> Iterator[None]:
    """Collect this thread's warnings in a list, instead of issuing them, until the block ends."""
    before = _listener.texts
    _listener.texts = texts
    try:
        yield
    finally:
        _listener.texts = before


def warn(text: str) -> None:
    """Issue a warning at the line that called the library, not at a line within the library."""
    if _listener.texts is not None:
        _listener.texts.append(text)
        return
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in OF_THE_CALL:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def doubt_about_size(radius: float, distance: float, largest: float = LARGEST_RADIUS) -> str:
    """Explain why a body's radius and distance from the origin [m] may be in another unit; empty if plausible."""
    if radius > largest:
        return f"lengths in metres, found a body {2 * radius:.3g} m across; is it in millimetres?"
    if 0 < radius < SMALLEST_RADIUS:
        return f"lengths in metres, found a body {2 * radius:.3g} m across; was it scaled twice?"
    if distance > LARGEST_DISTANCE:
        return f"lengths in metres, found a place {distance:.4g} m away; is it in millimetres?"
    return ""


def doubt_about_unit(comments: str) -> str:
    """Explain why lengths may be in another unit, judged by a file's comments; empty if they name no unit."""
    match = _UNIT.search(comments)
    return f"lengths in metres, found {match[0]!r} in a comment, which is not read; give a scale" if match else ""


def doubt_about_rpy(rpy: Sequence[float]) -> str:
    """Explain why roll, pitch and yaw may be in degrees; empty if they are plausible in radians."""
    most = max(abs(angle) for angle in rpy)
    return f"roll, pitch and yaw in radians, found {most:g}; is it in degrees?" if most > LARGEST_RPY else ""


def doubt_about_limits(lower: float, upper: float) -> str:
    """Explain why the limits of a revolute joint may be in degrees; empty if they are plausible in radians."""
    least, most = LIMITS_IN_DEGREES
    doubtful = least < max(abs(lower), abs(upper)) <= most
    return f"limits in radians, found {lower:g} .. {upper:g}; are they in degrees?" if doubtful else ""


def doubt_about_velocity(velocity: float) -> str:
    """Explain why the velocity limit of a turning joint may be in degrees; empty if it is plausible in radians."""
    least, most = VELOCITY_IN_DEGREES
    return f"radians per second, found {velocity:g}; is it in degrees?" if least < velocity <= most else ""
