"""Pictures for notebooks, as HTML of a few kilobytes: bodies, curves of joints, and rows of verdicts.

Bodies are drawn with a depth buffer into a PNG file, which is small for any number of triangles. Every picture is
self-contained, without scripts or requests, and has the text colour and the background of the page.
"""

from __future__ import annotations

import struct
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, NamedTuple

import numpy as np

from loewner._base._log import log
from loewner._base._validate import Floats, Ints

# Colours of bodies and curves, used in turn, and of the verdicts in the order of their codes. Colour-blind people can
# distinguish the colours, on light and dark pages.
COLOURS = ("#4477aa", "#ddaa33", "#228833", "#cc6677", "#66ccee", "#aa3377", "#bbbbbb", "#ee7733")
LINKS = COLOURS[0], "#77a0cc"  # for the links of a robot, used in turn
VERDICT_COLOURS = ((34, 136, 51), (204, 51, 68), (221, 170, 51))
VERDICT_NAMES = ("FREE", "COLLIDING", "AMBIGUOUS")

# Size of a picture on the page [pixels], and its border.
WIDTH, HEIGHT, BORDER = 400, 300, 6.0

# Along each axis, a picture has two pixels for each pixel of the page. It has fewer if its triangles, added up, would
# cover more than MOST_PIXELS pixels. If there are more than MOST_TRIANGLES triangles, only every n-th triangle of a
# shape is drawn, enlarged by the factor ENLARGED times sqrt(n).
MOST_PIXELS, MOST_TRIANGLES, ENLARGED = 1.2e6, 40_000, 1.8

# Largest PNG file [bytes]; a larger picture is drawn with half of its rows and columns.
MOST_BYTES = 40_000

# A body that is longer than this [m], and much longer than the other bodies, is not drawn.
VAST = 100.0

# Number of levels of brightness, and the lowest level.
LEVELS, DARKEST = 20, 0.45

# A picture has at most MOST_NAMES named curves or bodies, and at most MOST_BODIES bodies. A row of verdicts has at most
# MOST_BARS bars, and a curve has POINTS points.
MOST_NAMES, MOST_BODIES, MOST_BARS, POINTS = 7, 1000, 200, 161

# The directions to the right, down, and towards the viewer, and the direction to the light. The viewer is in front of
# the bodies, above and to the right.
_TOWARDS = np.array([0.43, -0.66, 0.35])
_TOWARDS /= np.linalg.norm(_TOWARDS)
_RIGHT = np.cross([0.0, 0.0, 1.0], _TOWARDS) / np.linalg.norm(_TOWARDS[:2])
_VIEW = np.array([_RIGHT, np.cross(_RIGHT, _TOWARDS), _TOWARDS])
_LIGHT = np.array([-0.35, -0.6, 0.72])


# Ellipsoids whose outlines are drawn: centers (n, 3), factors (n, 3, 3), and attributes of the lines.
Outlines = tuple[Floats, Floats, str]


class Shape(NamedTuple):
    """Triangles of one colour.

    Attributes
    ----------
    corners : ndarray, shape (n, 3, 3)
        In metres.
    radii : ndarray, shape (n,)
        Radii of the balls around the triangles; drawn only around triangles that are points or segments.
    colour : str
    """

    corners: Floats
    radii: Floats
    colour: str

    def at(self, T: Floats, colour: str) -> Shape:
        """Return the shape at a pose, in a colour."""
        return Shape(self.corners @ T[:3, :3].T + T[:3, 3], self.radii, colour)

    def size(self) -> float:
        """Return the longest side of the box around the triangles."""
        return float(np.ptp(self.corners, axis=(0, 1)).max())

    def thinned(self, step: int) -> Shape:
        """Return every `step`-th triangle, enlarged, if the shape has many triangles."""
        if step == 1 or len(self.corners) < MOST_TRIANGLES // 100:
            return self
        corners = self.corners[::step]
        middles = corners.mean(axis=1, keepdims=True)
        return Shape(middles + ENLARGED * step**0.5 * (corners - middles), self.radii[::step], self.colour)


def escape(text: str) -> str:
    """Escape text for HTML."""
    import html  # imported late, since it would take a percent of the time of `import loewner`

    return html.escape(text)


def pictured(draw: Callable[[Any], str]) -> Callable[[Any], str]:
    """Make `_repr_html_` from a function that draws; if drawing fails, only the text is shown."""

    @wraps(draw)
    def shown(thing: Any) -> str:
        text = f'<pre style="margin:0;white-space:pre-wrap">{escape(repr(thing))}</pre>'
        try:
            return f"<div>{text}{draw(thing)}</div>"
        except Exception:
            log.debug("no picture of %s", type(thing).__name__, exc_info=True)
            return text

    return shown


def _svg(width: float, height: float, inside: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" style="max-width:100%;height:auto">{inside}</svg>'
    )


def legend(entries: Sequence[tuple[str, str]], more: str = "") -> str:
    """Format names with their colours, followed by a remark."""
    spots = " ".join(
        f'<span style="white-space:nowrap;margin-right:0.6em"><span style="color:{colour}">&#9632;</span> '
        f"{escape(name)}</span>"
        for name, colour in entries
    )
    return f'<div style="font-size:small;max-width:{WIDTH}px">{spots} {escape(more)}</div>'


# -- bodies -------------------------------------------------------------------------------------


def bodies(
    shapes: Sequence[Shape],
    ellipsoids: Sequence[Outlines] = (),
    entries: Sequence[tuple[str, str]] = (),
    note: str = "",
) -> str:
    """Draw shapes and, over them, the outlines of ellipsoids; add a legend and the extent along the axes below."""
    shapes = [shape for shape in shapes if len(shape.corners)]
    if not shapes:
        return legend(entries, note)
    shapes.sort(key=Shape.size)
    sizes = [shape.size() for shape in shapes]
    for k in range(1, len(sizes)):
        if sizes[k] > max(VAST, 20.0 * sizes[k - 1]):  # a half-space, next to which all other bodies would be points
            shapes, note = shapes[:k], f"{note}; bodies of {sizes[k]:.0f} m are not drawn"
            break
    step = 1 + sum(len(shape.corners) for shape in shapes) // MOST_TRIANGLES
    shapes = [shape.thinned(step) for shape in shapes]
    colours = sorted({shape.colour for shape in shapes})
    colour = np.repeat([colours.index(shape.colour) for shape in shapes], [len(shape.corners) for shape in shapes])
    corners, radii = (np.concatenate(arrays) for arrays in zip(*(shape[:2] for shape in shapes), strict=True))
    around = radii[:, None, None]
    extent = (corners + around).max(axis=(0, 1)) - (corners - around).min(axis=(0, 1))
    seen = [(centers @ _VIEW[:2].T, _VIEW[:2] @ factors, line) for centers, factors, line in ellipsoids]
    corners = corners @ _VIEW.T
    boxes = [(corners[..., :2].reshape(-1, 2), np.repeat(radii, 3)[:, None])]
    boxes += [(centers, np.linalg.norm(factors, axis=2)) for centers, factors, _ in seen]
    low = np.min([(middle - reach).min(axis=0) for middle, reach in boxes], axis=0)
    high = np.max([(middle + reach).max(axis=0) for middle, reach in boxes], axis=0)
    scale = float(np.min((np.array([WIDTH, HEIGHT]) - 2 * BORDER) / np.maximum(high - low, 1e-9 * (high - low).max())))
    width, height = np.ceil(scale * (high - low) + 2 * BORDER)
    moved = np.append(BORDER - scale * low, 0.0)
    pixels = _raster(*_thick(scale * corners + moved, scale * radii, colour), width, height)
    png = _png(pixels, colours)
    while len(png) > MOST_BYTES:
        pixels = pixels[::2, ::2]
        png = _png(pixels, colours)
    lines = [
        _outline(scale * c + moved[:2], scale * F, line)
        for centers, factors, line in seen for c, F in zip(centers, factors, strict=True)
    ]  # fmt: skip
    image = f'<image width="{width:.0f}" height="{height:.0f}" href="data:image/png;base64,{b64encode(png).decode()}"/>'
    size = " × ".join(f"{length:.3g}" for length in extent)
    return _svg(width, height, image + "".join(lines)) + legend(entries, f"{size} m{note}")


def _outline(center: Floats, factor: Floats, line: str) -> str:
    """Draw the image of the unit ball under a matrix of shape (2, 3)."""
    turn, (a, b), _ = np.linalg.svd(factor, full_matrices=False)
    degrees = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    place = f"translate({center[0]:.1f} {center[1]:.1f}) rotate({degrees:.1f})"
    return f'<ellipse rx="{a:.1f}" ry="{b:.1f}" transform="{place}" fill="none" stroke="currentColor" {line}/>'


def _thick(corners: Floats, radii: Floats, colour: Ints) -> tuple[Floats, Ints]:
    """Replace points and segments that have balls around them with rectangles; return triangles and palette entries.

    Coordinates are pixels of the page; the third coordinate points towards the viewer.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    thin = (radii > 0) & (lengths <= 1e-9 * radii**2)
    light = np.abs(normals[:, 2]) * _LIGHT[2] + (normals[:, :2] * np.sign(normals[:, 2:])) @ _LIGHT[:2]
    light = np.divide(np.maximum(light, 0.0), lengths, out=np.zeros(len(lengths)), where=lengths > 0)
    if thin.any():
        ends, radius = corners[thin], np.maximum(radii[thin], 0.6)[:, None]
        a, far = ends[:, 0], np.linalg.norm(ends - ends[:, :1], axis=2).argmax(axis=1)
        b = ends[np.arange(len(ends)), far]
        way = (b - a)[:, :2]
        long = np.linalg.norm(way, axis=1, keepdims=True)
        along = radius * np.where(long > 0, way, [1.0, 0.0]) / np.where(long > 0, long, 1.0)
        across = along[:, ::-1] * [-1.0, 1.0]
        square = np.stack([a, a, b, b], axis=1)
        square[..., :2] += np.stack([-along - across, across - along, along + across, along - across], axis=1)
        corners = np.concatenate([corners[~thin], square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
        colour = np.concatenate([colour[~thin], colour[thin], colour[thin]])
        near = (a[:, 2] - a[:, 2].min()) / max(np.ptp(a[:, 2]), 1e-9)  # nearer shapes are brighter
        light = np.concatenate([light[~thin], near, near])
    return corners, 1 + colour * LEVELS + np.rint(light.clip(0.0, 1.0) * (LEVELS - 1)).astype(np.int64)


def _raster(corners: Floats, value: Ints, width: float, height: float) -> Any:
    """Draw triangles into an image of palette entries: each pixel has the entry of the nearest triangle, or 0."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.abs(normal[:, 2]).sum())
    ratio = next((r for r in (2.0, 1.0, 0.5) if area * r**2 <= MOST_PIXELS), 0.25)
    columns, rows = int(np.ceil(ratio * width)), int(np.ceil(ratio * height))
    corners = ratio * corners
    near, far = corners[..., 2].max(), corners[..., 2].min()
    low, high = corners.min(axis=1), corners.max(axis=1)
    small = (high - low)[:, :2].max(axis=1) < 1.0
    middles = corners[small].mean(axis=1)
    pixels = [middles[:, 1].astype(np.int64) * columns + middles[:, 0].astype(np.int64)]
    depths, values = [middles[:, 2]], [value[small]]
    corners, normal, low, high, value = (array[~small] for array in (corners, normal, low, high, value))
    # Find the pixels of a triangle in each row that it crosses, from one edge to another.
    owner, row = _ranges(low[:, 1], high[:, 1], rows)
    x, y = corners[owner, :, 0], corners[owner, :, 1]
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        share = np.divide(row + 0.5 - y[:, i], y[:, j] - y[:, i], out=np.full(len(row), -1.0), where=y[:, j] != y[:, i])
        crossing = np.where((share >= 0) & (share <= 1), x[:, i] + share * (x[:, j] - x[:, i]), np.nan)
        left, right = np.fmin(left, crossing), np.fmax(right, crossing)
    line, column = _ranges(left, right, columns)
    owner, row = owner[line], row[line]
    slope = np.divide(-normal[:, :2], normal[:, 2:], out=np.zeros((len(normal), 2)), where=normal[:, 2:] != 0)
    at, rise = corners[owner, 0], slope[owner]
    depth = at[:, 2] + rise[:, 0] * (column + 0.5 - at[:, 0]) + rise[:, 1] * (row + 0.5 - at[:, 1])
    pixels.append(row * columns + column)
    depths.append(np.clip(depth, low[owner, 2], high[owner, 2]))
    values.append(value[owner])
    keys = ((np.concatenate(depths) - far) * (2.0**40 / max(near - far, 1e-9))).astype(np.int64) << 8
    image = np.zeros(rows * columns, dtype=np.int64)
    np.maximum.at(image, np.concatenate(pixels), keys | np.concatenate(values))
    return (image & 255).astype(np.uint8).reshape(rows, columns)


def _ranges(low: Floats, high: Floats, most: int) -> tuple[Ints, Ints]:
    """List the pixels below `most` whose centers are in each interval: the index of the interval, and the pixel."""
    first, end = (np.ceil(np.clip(x, 0.0, most) - 0.5).astype(np.int64) for x in (low, high))
    counts = np.maximum(end - first, 0)
    owner = np.repeat(np.arange(len(first)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts - first, counts)


def _png(image: Any, colours: Sequence[str]) -> bytes:
    """Encode an image of palette entries: a transparent one, then each colour at all levels of brightness."""
    bright = np.linspace(DARKEST, 1.0, LEVELS)[:, None]
    shades = [np.rint(bright * np.frombuffer(bytes.fromhex(colour[1:]), dtype=np.uint8)) for colour in colours]
    palette = np.concatenate([np.zeros((1, 3)), *shades]).astype(np.uint8).tobytes()
    rows = np.zeros((image.shape[0], image.shape[1] + 1), dtype=np.uint8)  # a row begins with its filter's number
    rows[:, 1:] = image
    head = struct.pack(">2I5B", image.shape[1], image.shape[0], 8, 3, 0, 0, 0)
    data = {b"IHDR": head, b"PLTE": palette, b"tRNS": b"\0", b"IDAT": zlib.compress(rows.tobytes(), 9), b"IEND": b""}
    chunks = (struct.pack(">I", len(x)) + k + x + struct.pack(">I", zlib.crc32(k + x)) for k, x in data.items())
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


# -- curves and verdicts ------------------------------------------------------------------------


def curves(names: Sequence[str] | None, times: Floats, values: Floats) -> str:
    """Draw values (n, k) over times (n,): the `MOST_NAMES` columns that change most, with their names or numbers."""
    names = names or [f"value {k}" for k in range(values.shape[1])]
    chosen = np.sort(np.argsort(-np.ptp(values, axis=0), kind="stable")[:MOST_NAMES])
    left, top, wide, high = 44.0, 8.0, WIDTH - 52.0, 150.0
    low, top_value = float(values[:, chosen].min(initial=0.0)), float(values[:, chosen].max(initial=0.0))
    x = left + wide * (times - times[0]) / max(float(times[-1] - times[0]), 1e-300)
    y = top + high * (top_value - values[:, chosen]) / max(top_value - low, 1e-300)
    drawn = ""
    for k in range(len(chosen)):
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y[:, k], strict=True))
        drawn += f'<polyline points="{points}" fill="none" stroke="{COLOURS[k]}" stroke-width="1.5"/>'
    more = f"rad or m; {values.shape[1] - len(chosen)} more" if len(chosen) < values.shape[1] else "rad or m"
    frame = f'<path d="M{left} {top}v{high}h{wide}" fill="none" stroke="currentColor" stroke-opacity="0.5"/>'
    marks = _text(left - 4, top + 8, "end", f"{top_value:.3g}") + _text(left - 4, top + high, "end", f"{low:.3g}")
    marks += _ticks(left, top + high + 14, wide, times, "time, s")
    entries = [(names[k], colour) for k, colour in zip(chosen.tolist(), COLOURS, strict=False)]
    return _svg(WIDTH, top + high + 18, frame + drawn + marks) + legend(entries, more)


def verdicts(codes: Any, ends: Floats, label: str) -> str:
    """Draw n verdicts as bars between n + 1 `ends`, lower for FREE; for a large n, a bar shows the worst of several."""
    starts = np.arange(0, len(codes), 1 + len(codes) // MOST_BARS)
    worst = np.maximum.reduceat(np.array([0, 2, 1])[codes], starts)  # COLLIDING is the worst
    left, wide, at = 4.0, WIDTH - 8.0, np.append(ends[starts], ends[-1])
    x = left + wide * (at - at[0]) / (at[-1] - at[0])
    bars = "".join(
        f'<rect x="{x[k]:.2f}" y="{14 if code == 0 else 4}" width="{x[k + 1] - x[k]:.2f}" '
        f'height="{12 if code == 0 else 22}" fill="rgb{VERDICT_COLOURS[code]}" shape-rendering="crispEdges"/>'
        for k, code in enumerate(np.array([0, 2, 1])[worst].tolist())
    )
    counts = np.bincount(codes, minlength=3).tolist()
    named = zip(VERDICT_NAMES, counts, VERDICT_COLOURS, strict=True)
    entries = [(f"{name} {count}", f"rgb{colour}") for name, count, colour in named if count]
    return _svg(WIDTH, 42, bars + _ticks(left, 38, wide, at, label)) + legend(entries)


def shares(counts: Mapping[str, int]) -> str:
    """Draw a bar with a part per count; names begin with "free" or "colliding", and costlier tests are more opaque."""
    at, parts, entries = 4.0, "", []
    for name, count in counts.items():
        alike = [other for other in counts if other[:4] == name[:4]]
        colour = f"rgb{VERDICT_COLOURS[name.startswith('colliding')]}"
        opacity = 0.25 + 0.75 * (alike.index(name) + 1) / len(alike)
        wide = (WIDTH - 8) * count / max(sum(counts.values()), 1)
        parts += f'<rect x="{at:.1f}" y="4" width="{wide:.1f}" height="20" fill="{colour}" opacity="{opacity:.2f}"/>'
        entries += [(f"{name.replace('_', ' ')} {count}", f"{colour};opacity:{opacity:.2f}")] * (count > 0)
        at += wide
    return _svg(WIDTH, 28, parts) + legend(entries)


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return (
        f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" fill="currentColor" font-size="11" '
        f'font-family="sans-serif">{escape(text)}</text>'
    )


def _ticks(left: float, y: float, wide: float, at: Floats, label: str) -> str:
    """Write the first and last number below an axis, and its label between them."""
    first, last = _text(left, y, "start", f"{at[0]:.4g}"), _text(left + wide, y, "end", f"{at[-1]:.4g}")
    return first + _text(left + wide / 2, y, "middle", label) + last
