"""Draws swept.svg: what an arm of two links sweeps, seen from above, within two tolerances.

python docs/images/swept.py
"""

from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

import loewner

SCALE, WIDTH, HEIGHT, LEFT, TOP = 150.0, 340, 300, 90, 270
SWEPT, LINK = "#cc6677", "#4477aa"
TOLERANCES = (0.1, 0.02)
LINKS = "".join(
    f'<link name="{name}"><collision><origin xyz="0.4 0 0"/><geometry><box size="0.84 0.12 0.1"/></geometry>'
    "</collision></link>"
    for name in ("upper", "fore")
)
URDF = f"""<robot name="arm"><link name="base"/>{LINKS}
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0.8 0 0"/>
<axis xyz="0 0 1"/></joint></robot>"""
PATH = np.array([[0.2, 0.1], [1.5, 1.2]])


def main() -> None:
    """Write the picture beside this file."""
    robot, panels = loewner.Robot.from_urdf(text=URDF), []
    for k, tolerance in enumerate(TOLERANCES):
        body = robot.swept(PATH, tolerance=tolerance)
        drawn = [polygon(piece.vertices, SWEPT, 0.22) for piece in body.pieces]
        for q in PATH[0] + np.linspace(0.0, 1.0, 4)[:, None] * (PATH[1] - PATH[0]):
            poses = robot.forward_kinematics(q)
            for name, link in robot.bodies.items():
                T = poses[robot.link_names.index(name)]
                drawn.append(polygon(link.pieces[0].vertices @ T[:3, :3].T + T[:3, 3], LINK, 0.3))
        text = f"{1e3 * tolerance:.0f} mm: {len(body.pieces)} pieces"
        label = f'<text y="22" font-size="14" font-family="sans-serif" fill="#222222">{text}</text>'
        panels.append(f'<g transform="translate({k * WIDTH + LEFT} {TOP})">{"".join(drawn)}{label}</g>')
    size = f"{len(panels) * WIDTH} {HEIGHT}"
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}">{"".join(panels)}</svg>\n'
    Path(__file__).with_suffix(".svg").write_text(text, encoding="utf-8")


def polygon(points: np.ndarray, colour: str, opacity: float) -> str:
    """The outline of points, seen from above."""
    flat = points[:, :2]
    corners = " ".join(f"{SCALE * x:.1f},{-SCALE * y:.1f}" for x, y in flat[ConvexHull(flat).vertices])
    return (
        f'<polygon points="{corners}" fill="{colour}" fill-opacity="{opacity}" stroke="{colour}" stroke-width="0.7"/>'
    )


if __name__ == "__main__":
    main()
