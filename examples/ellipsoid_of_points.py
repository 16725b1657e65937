"""Löwner-John ellipsoids for their own sake, in any dimension, each with its certificate.

python examples/ellipsoid_of_points.py [--points 100000] [--dimension 5]
"""

import argparse

import numpy as np

import loewner


def main() -> None:
    """Smallest ellipsoid around points, largest inside a polytope."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--dimension", type=int, default=5)
    options = parser.parse_args()
    n = options.dimension
    rng = np.random.default_rng(0)

    points = rng.normal(size=(options.points, n)) * np.arange(1, n + 1)
    fit = loewner.mvce(points, tol=1e-6)
    print(f"smallest ellipsoid around {options.points:,} points in dimension {n}")
    print(f"  semi-axes {np.round(fit.ellipsoid.semi_axes, 3)}")
    print(f"  log-volume at most {fit.gap:.1e} above the optimum, proven; {fit.iterations} iterations")
    print(f"  all points inside: {fit.ellipsoid.contains(points).all()}")

    # The cube [-1, 1]^n: the largest ellipsoid inside is the unit ball.
    fit = loewner.mvie(np.vstack([np.eye(n), -np.eye(n)]), np.ones(2 * n), tol=1e-6)
    print(f"largest ellipsoid in the cube [-1, 1]^{n}")
    print(f"  semi-axes {np.round(fit.ellipsoid.semi_axes, 6)}, gap {fit.gap:.1e}")


if __name__ == "__main__":
    main()
