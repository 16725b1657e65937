"""Draws surfaces.svg: a section through two links of the Panda as hulls, as pieces, and as surfaces.

python docs/images/surfaces.py

Needs the extra `meshes` and the package example-robot-data, and a minute for the decomposition.
"""

from importlib.metadata import distribution
from pathlib import Path

import numpy as np

import loewner

SCALE, WIDTH, TOP = 950.0, 330, 24
COLOURS = "#4477aa", "#cc6677"
# The hand, in the hollow of the link; and the plane x = 0 of the link, which both are cut by.
T_LINK_HAND = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.03], [1.0, 0.0, 0.0, -0.09], [0.0, 0.0, 0.0, 1.0]])


def main() -> None:
    """Write the picture beside this file."""
    link, hand = (visual_mesh(name) for name in ("link5", "hand"))
    kinds = {
        "hulls": [loewner.Body.from_mesh(file, decompose=False) for file in (link, hand)],
        "pieces": [loewner.Body.from_mesh(file) for file in (link, hand)],
        "surfaces": [loewner.Body.from_surface(file) for file in (link, hand)],
    }
    panels = []
    for k, (name, (a, b)) in enumerate(kinds.items()):
        gap = loewner.distance(a, None, b, T_LINK_HAND, exact=True).distance
        said = f"{1e3 * gap:.0f} mm apart" if gap > 0 else "colliding"
        drawn = "".join(
            section(body, T, colour) for body, T, colour in zip((a, b), (np.eye(4), T_LINK_HAND), COLOURS, strict=True)
        )
        panels.append(
            f'<g transform="translate({(k + 0.5) * WIDTH:.0f} {TOP})"><text font-weight="bold">{name}: {said}</text>'
            f'<g transform="translate(-30 75)">{drawn}</g></g>'
        )
    height = TOP + 345
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {3 * WIDTH} {height}" width="{3 * WIDTH}" '
        'font-family="sans-serif" font-size="15" text-anchor="middle" fill="#333333">'
        '<rect width="100%" height="100%" fill="#ffffff"/>'
    )
    Path(__file__).with_suffix(".svg").write_text(head + "\n".join(panels) + "</svg>\n")


def visual_mesh(name: str) -> Path:
    """A visual mesh of the Panda."""
    robots = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
    return Path(str(robots)) / f"panda_description/meshes/visual/{name}.dae"


def section(body: loewner.Body, T: np.ndarray, colour: str) -> str:
    """A body's section: each piece filled; the lines alone of a surface."""
    drawn = []
    for piece in body.pieces:
        corners = (piece.vertices @ T[:3, :3].T + T[:3, 3])[piece.triangles]
        ends = crossings(corners)
        if not len(ends):
            continue
        if piece.kind == "polytope":
            drawn.append(f'<polygon points="{text(outline(ends.reshape(-1, 2)))}" fill-opacity="0.3"/>')
        else:
            drawn.append(f'<path d="{chained(ends)}" fill="none"/>')
    return f'<g fill="{colour}" stroke="{colour}" stroke-width="0.8">{"".join(drawn)}</g>'


def crossings(corners: np.ndarray) -> np.ndarray:
    """Where triangles cross the plane x = 0: segments of it, shape (n, 2, 2)."""
    found = []
    for triangle in corners[(corners[:, :, 0].min(axis=1) < 0) & (corners[:, :, 0].max(axis=1) >= 0)]:
        ends = []
        for p, q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            if (p[0] < 0) != (q[0] < 0):
                ends.append((p + (q - p) * p[0] / (p[0] - q[0]))[1:])
        found.append(ends)
    return SCALE * np.array(found).reshape(-1, 2, 2) * [1.0, -1.0]  # the y axis of SVG points down


def outline(points: np.ndarray) -> np.ndarray:
    """The corners of the points' hull, in order; of those within a tenth of a pixel, one."""
    points = np.unique(np.round(points, 1), axis=0)
    hull: list[np.ndarray] = []
    for half in (points, points[::-1]):
        start = len(hull)
        for p in half:
            while len(hull) > start + 1 and np.linalg.det([hull[-1] - hull[-2], p - hull[-1]]) <= 0:
                hull.pop()
            hull.append(p)
        hull.pop()
    return np.array(hull)


def chained(segments: np.ndarray) -> str:
    """Segments as lines of a path, those joined that follow each other; shorter ones than half a pixel are left out."""
    ends = np.round(segments, 1)
    left = {k: (tuple(a), tuple(b)) for k, (a, b) in enumerate(ends.tolist()) if a != b}
    at: dict[tuple[float, ...], list[int]] = {}
    for k, (a, b) in left.items():
        at.setdefault(a, []).append(k)
        at.setdefault(b, []).append(k)
    lines = []
    while left:
        _, (first, place) = left.popitem()
        line = [first, place]
        while follow := [k for k in at[place] if k in left]:
            a, b = left.pop(follow[0])
            place = b if a == place else a
            line.append(place)
        lines.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line))
    return "".join(lines)


def text(points: np.ndarray) -> str:
    """Points as SVG wants them."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


if __name__ == "__main__":
    main()
