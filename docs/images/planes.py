"""Draws planes.svg: the planes of a proof along a motion of a rod past a post.

python docs/images/planes.py
"""

from pathlib import Path

import numpy as np

import loewner
from loewner import verify

SCALE, WIDTH, HEIGHT, TOP = 150.0, 225, 340, 140
ROD, POST, PLANE = "#4477aa", "#cc6677", "#228833"
START, END = 0.6, -1.3
URDF = """<robot name="rod"><link name="base"/><link name="rod"><collision><origin xyz="0.55 0 0"/><geometry>
<box size="0.9 0.12 0.1"/></geometry></collision></link><joint name="turn" type="revolute"><parent link="base"/>
<child link="rod"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"""


class Leaves(verify._Checker):
    """The checker of proofs, which also lists the intervals and planes that it accepted."""

    def __init__(self, proof: loewner.Proof) -> None:
        super().__init__(proof.model, proof.data[-32 - proof.size : -32])
        self.found: list[tuple[float, float, bool, np.ndarray]] = []
        self.run()

    def leaf(self, motion: verify._Motion, pair: verify.Pair, spans: list[verify.Pair]) -> None:
        """Check a plane; the normal is in the frame of the first body, or in that of the second."""
        super().leaf(motion, pair, spans)
        first, normal = self.last[pair]
        low, high = (t / 2**verify.DEEPEST for t in spans[0])
        self.found.append((low, high, first, np.array(normal[:2]) / np.hypot(*normal[:2])))


def main() -> None:
    """Write the picture beside this file."""
    angles = 2 * np.pi * np.arange(6) / 6
    post = np.array([0.5, 0.62]) + 0.16 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rod = np.array([[0.1, -0.06], [1.0, -0.06], [1.0, 0.06], [0.1, 0.06]])
    scene = loewner.Scene()
    scene.add("post", loewner.Body.from_points([[*p, z] for p in post for z in (-0.1, 0.1)]))
    checker = loewner.CollisionChecker(loewner.Robot.from_urdf(text=URDF), scene)
    proof = checker.certify_edges([START], [END], proof=True).proof
    panels = []
    for k, (low, high, of_rod, n) in enumerate(Leaves(proof).found):
        drawn, turns = (
            [polygon(post, POST, 0.35)],
            [rotation(START + t * (END - START)) for t in np.linspace(low, high, 9)],
        )
        for turn in turns:
            drawn.append(polygon(rod @ turn.T, ROD, 0.3 if turn is turns[0] or turn is turns[-1] else 0.03))
        # In the frame of the body to which the plane is fixed, it lies in the middle of the smallest gap.
        gaps = [(post @ turn @ n).min() if of_rod else (rod @ turn.T @ n).min() for turn in turns]
        offset = (((rod if of_rod else post) @ n).max() + min(gaps)) / 2
        for turn in (turns[0], turns[-1]) if of_rod else (np.eye(2),):
            drawn.append(line(turn @ n, offset))
        panels.append(
            f'<g transform="translate({k * WIDTH + 40} {TOP})">{"".join(drawn)}</g>'
            f'<text x="{(k + 0.5) * WIDTH:.0f}" y="{HEIGHT - 26}" font-weight="bold">t from {low:g} to {high:g}</text>'
            f'<text x="{(k + 0.5) * WIDTH:.0f}" y="{HEIGHT - 8}">fixed to the {"rod" if of_rod else "post"}</text>'
        )
    width = len(panels) * WIDTH
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {HEIGHT}" width="{width}" '
        'font-family="sans-serif" font-size="13" text-anchor="middle" fill="#333333">'
        '<rect width="100%" height="100%" fill="#ffffff"/>'
    )
    Path(__file__).with_suffix(".svg").write_text(head + "\n".join(panels) + "</svg>\n")


def rotation(angle: float) -> np.ndarray:
    """The turn of the rod."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def polygon(points: np.ndarray, colour: str, opacity: float) -> str:
    """A body; the y axis of SVG points down."""
    corners = " ".join(f"{SCALE * x:.1f},{-SCALE * y:.1f}" for x, y in points)
    return f'<polygon points="{corners}" fill="{colour}" stroke="{colour}" opacity="{opacity}"/>'


def line(n: np.ndarray, offset: float) -> str:
    """A plane, as the line of the points x with n·x = offset."""
    middle, along = offset * n + np.array([0.5, 0.2]) - n * (n @ [0.5, 0.2]), 0.55 * np.array([-n[1], n[0]])
    (a, b), (c, d) = SCALE * (middle - along), SCALE * (middle + along)
    return f'<path d="M{a:.1f} {-b:.1f}L{c:.1f} {-d:.1f}" stroke="{PLANE}" stroke-width="2"/>'


if __name__ == "__main__":
    main()
