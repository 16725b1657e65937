"""Draws assumptions.svg: what a proof takes from you: the shapes, the whole motion, and what is executed.

python docs/images/assumptions.py
"""

from pathlib import Path

import numpy as np

SCALE, WIDTH, HEIGHT = 100.0, 240, 210
ROBOT, OBSTACLE, PROVEN, REAL = "#4477aa", "#cc6677", "#228833", "#333333"
CAPTIONS = (
    ("the shapes", "the body holds the part,", "a cable is not in it"),
    ("the motion", "samples are free,", "the way between is not"),
    ("the execution", "the robot is off its curve,", "within the errors given"),
)


def main() -> None:
    """Write the picture beside this file."""
    parts = []
    for k, (drawn, (name, *lines)) in enumerate(zip((shapes(), motion(), execution()), CAPTIONS, strict=True)):
        text = "".join(f'<text y="{HEIGHT - 62 + 18 * m}">{line}</text>' for m, line in enumerate(lines))
        parts.append(
            f'<g transform="translate({(k + 0.5) * WIDTH:.0f} 24)"><text font-weight="bold">{name}</text>'
            f'<g transform="translate(0 68)">{drawn}</g>{text}</g>'
        )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {3 * WIDTH} {HEIGHT}" width="{3 * WIDTH}" '
        'font-family="sans-serif" font-size="15" text-anchor="middle" fill="#333333">'
        '<rect width="100%" height="100%" fill="#ffffff"/>'
    )
    Path(__file__).with_suffix(".svg").write_text(head + "\n".join(parts) + "</svg>\n")


def shapes() -> str:
    """A part in the shape of an L, its two pieces, and a cable beside it."""
    part = np.array([[-0.7, -0.4], [0.6, -0.4], [0.6, -0.1], [-0.4, -0.1], [-0.4, 0.45], [-0.7, 0.45]])
    pieces = [
        np.array([[-0.75, -0.45], [0.65, -0.45], [0.65, -0.05], [-0.75, -0.05]]),
        np.array([[-0.75, -0.45], [-0.35, -0.45], [-0.35, 0.5], [-0.75, 0.5]]),
    ]
    t = np.linspace(0.0, 1.0, 20)
    cable = np.stack([-0.4 + t, 0.3 - 0.4 * t + 0.25 * np.sin(np.pi * t)], axis=1)
    return "".join(polygon(piece, PROVEN, 0.2) for piece in pieces) + polygon(part, ROBOT, 0.6) + line(cable, REAL, 3)


def motion() -> str:
    """A rod at two samples beside a post, and the way between them."""
    rod = np.array([[0.0, -0.06], [1.15, -0.06], [1.15, 0.06], [0.0, 0.06]])
    foot = np.array([-0.75, -0.4])
    turned = [
        foot + rod @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in np.radians([8.0, 33.0, 58.0])
    ]
    angles = 2.0 * np.pi * np.arange(8) / 8
    post = np.array([0.2, 0.22]) + 0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    arc = foot + 1.15 * np.stack([np.cos(np.linspace(0.14, 1.01, 30)), np.sin(np.linspace(0.14, 1.01, 30))], axis=1)
    return (
        polygon(turned[1], ROBOT, 0.1) + polygon(turned[0], ROBOT, 0.5) + polygon(turned[2], ROBOT, 0.5)
        + line(arc, REAL, 1, "4 3") + polygon(post, OBSTACLE, 0.6)
    )  # fmt: skip


def execution() -> str:
    """A curve, the tube of its errors, and the way that the robot takes."""
    x = np.linspace(-0.85, 0.85, 60)
    curve = np.stack([x, 0.3 * np.sin(2.2 * x)], axis=1)
    real = curve + np.stack([np.zeros(60), 0.06 * np.sin(9.0 * x)], axis=1)
    box = np.array([[0.1, -0.5], [0.5, -0.5], [0.5, -0.12], [0.1, -0.12]])
    return line(curve, PROVEN, 20, opacity=0.25) + line(curve, PROVEN, 2, "6 4") + line(real, ROBOT, 2) + polygon(
        box, OBSTACLE, 0.6
    )  # fmt: skip


def points(corners: np.ndarray) -> str:
    """Points of SVG, whose y axis points down."""
    return " ".join(f"{SCALE * x:.1f},{-SCALE * y:.1f}" for x, y in corners)


def polygon(corners: np.ndarray, colour: str, opacity: float) -> str:
    """A filled polygon."""
    return f'<polygon points="{points(corners)}" fill="{colour}" fill-opacity="{opacity}" stroke="{colour}"/>'


def line(corners: np.ndarray, colour: str, width: float, dashes: str = "none", opacity: float = 1.0) -> str:
    """A line through points."""
    return (
        f'<polyline points="{points(corners)}" fill="none" stroke="{colour}" stroke-width="{width}" '
        f'stroke-opacity="{opacity}" stroke-dasharray="{dashes}"/>'
    )


if __name__ == "__main__":
    main()
