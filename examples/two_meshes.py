"""Do two meshes touch, and how far apart are they?

python examples/two_meshes.py [A B]
"""

import argparse
from pathlib import Path

import numpy as np

import loewner


def main() -> None:
    """Compare two meshes, by default two of the Panda arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path, help="two mesh files")
    parser.add_argument("--hull", action="store_true", help="convex hulls: no decomposition")
    options = parser.parse_args()
    meshes = options.meshes
    if not meshes:
        from robot_meshes import panda

        meshes = [panda("collision/link5.stl"), panda("collision/hand.stl")]
    a, b = (loewner.Body.from_mesh(mesh, decompose=not options.hull) for mesh in meshes)

    for x in (0.0, 0.1, 0.2, 0.3):
        T_world_b = np.eye(4)
        T_world_b[0, 3] = x
        verdict = loewner.classify(a, None, b, T_world_b)
        found = loewner.distance(a, None, b, T_world_b, exact=True)
        print(
            f"x = {x:.1f} m: {verdict!s:9}  exact distance {found.distance:+.4f} m, "
            f"certified between {found.lower:+.4f} and {found.upper:+.4f}"
        )


if __name__ == "__main__":
    main()
