"""Robots: descriptions in files to links with bodies, where these are, and what they collide with.

`robot` holds links on joints (read by `urdf`, `srdf` and `link_bodies`), `checker` asks about configurations and
motions (prepared by `checked_pairs`, ordered by `edges`), `sampling` finds pairs that need no check.
"""

from loewner.robots.checker import CollisionChecker, PairDistances, Settled, StateDistance
from loewner.robots.motions import CertifiedMotions
from loewner.robots.robot import Robot
from loewner.robots.sampling import pairs_by_sampling

__all__ = [
    "CertifiedMotions",
    "CollisionChecker",
    "PairDistances",
    "Robot",
    "Settled",
    "StateDistance",
    "pairs_by_sampling",
]
