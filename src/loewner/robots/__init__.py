"""Robots: reading descriptions into links with bodies, placing the links, and checking them for collisions.

`robot` holds links on joints (read by `urdf`, `srdf` and `link_bodies`). `checker` is what users call; `checked_pairs`
and `problem` prepare, and `verdicts`, `proofs` and `distances` answer. `sampling` finds pairs that need no check.
"""

from loewner.robots.checker import CollisionChecker
from loewner.robots.curves import CertifiedTrajectory
from loewner.robots.distances import PairDistances, StateDistance
from loewner.robots.motions import CertifiedMotions
from loewner.robots.robot import Robot
from loewner.robots.sampling import pairs_by_sampling
from loewner.robots.verdicts import Settled

__all__ = [
    "CertifiedMotions",
    "CertifiedTrajectory",
    "CollisionChecker",
    "PairDistances",
    "Robot",
    "Settled",
    "StateDistance",
    "pairs_by_sampling",
]
