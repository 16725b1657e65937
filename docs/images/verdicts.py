"""Draws verdicts.svg: the three verdicts, in the plane, with ellipses that `loewner` fitted.

python docs/images/verdicts.py
"""

from pathlib import Path

import numpy as np

import loewner

SCALE, WIDTH, HEIGHT = 29.0, 240, 180
LEFT, RIGHT = ("#4477aa", "#cc6677")
CAPTIONS = (
    ("FREE", "outer ones are apart"),
    ("AMBIGUOUS", "neither"),
    ("COLLIDING", "inner ones overlap"),
)
SHIFTS = ((3.9, 0.1), (2.55, 0.3), (1.3, 0.2))


def main() -> None:
    """Write the picture beside this file."""
    a = np.array([[-1.4, -0.9], [1.5, -0.7], [0.9, 0.5], [-0.5, 1.2]])
    b = np.array([[-1.5, 0.3], [0.1, -1.2], [1.4, -0.2], [0.7, 1.1]])
    parts = []
    for k, ((name, caption), shift) in enumerate(zip(CAPTIONS, SHIFTS, strict=True)):
        drawn = []
        for points, colour in ((a - np.array(shift) / 2, LEFT), (b + np.array(shift) / 2, RIGHT)):
            drawn.append(polygon(points, colour))
            drawn.append(ellipse(loewner.mvce(points).ellipsoid, "#777777", "5 4"))
            drawn.append(ellipse(loewner.mvie(points).ellipsoid, "#228833", "none"))
        parts.append(
            f'<g transform="translate({(k + 0.5) * WIDTH:.0f} {HEIGHT / 2 - 20:.0f})">{"".join(drawn)}'
            f'<text y="{HEIGHT / 2 - 20:.0f}" font-weight="bold">{name}</text>'
            f'<text y="{HEIGHT / 2 + 4:.0f}">{caption}</text></g>'
        )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {3 * WIDTH} {HEIGHT}" width="{3 * WIDTH}" '
        'font-family="sans-serif" font-size="20" text-anchor="middle" fill="#333333">'
        '<rect width="100%" height="100%" fill="#ffffff"/>'
    )
    Path(__file__).with_suffix(".svg").write_text(head + "\n".join(parts) + "</svg>\n")


def polygon(points: np.ndarray, colour: str) -> str:
    """The piece itself."""
    corners = " ".join(f"{SCALE * x:.1f},{-SCALE * y:.1f}" for x, y in points)
    return f'<polygon points="{corners}" fill="{colour}" fill-opacity="0.35" stroke="{colour}"/>'


def ellipse(E: loewner.Ellipsoids, colour: str, dashes: str) -> str:
    """An ellipse; the y axis of SVG points down."""
    (x, y), (long, short), (cosine, sine) = E.center, E.semi_axes, E.rotation[:, 0]
    place = f"translate({SCALE * x:.1f} {-SCALE * y:.1f}) rotate({-np.degrees(np.arctan2(sine, cosine)):.1f})"
    return (
        f'<ellipse rx="{SCALE * long:.1f}" ry="{SCALE * short:.1f}" transform="{place}" fill="none" '
        f'stroke="{colour}" stroke-width="1.6" stroke-dasharray="{dashes}"/>'
    )


if __name__ == "__main__":
    main()
