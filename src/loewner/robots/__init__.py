"""Robots: read descriptions into links with bodies, place the links, and check them for collisions.

`robot` defines links connected by joints, which `urdf`, `srdf` and `link_bodies` read; `links` takes them from memory,
`drake` and `pinocchio` from models of other libraries. Users call `checker`; `checked_pairs` and `problem` prepare its
queries, and `verdicts`, `proofs` and `distances` answer them. `pair_ranges` proves which pairs can ever collide,
`sampling` guesses it. `written_proofs` writes proofs that other programs verify.
"""

from loewner.robots import covers as _covers  # noqa: F401 - it answers methods of Robot, and so do the next two
from loewner.robots import pair_ranges as _pair_ranges  # noqa: F401
from loewner.robots import swept as _swept  # noqa: F401
from loewner.robots.approaches import ClosestApproach
from loewner.robots.assembly import Part
from loewner.robots.checker import CollisionChecker
from loewner.robots.contact_times import TrajectoryContact
from loewner.robots.curves import CertifiedTrajectory
from loewner.robots.distances import PairDistances, StateDistance
from loewner.robots.links import Joint
from loewner.robots.motions import CertifiedMotions
from loewner.robots.pair_proofs import prove
from loewner.robots.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs
from loewner.robots.reaching import Reached
from loewner.robots.robot import Robot
from loewner.robots.sampling import pairs_by_sampling
from loewner.robots.verdicts import Settled
from loewner.robots.written_proofs import Proof

__all__ = [
    "CertifiedMotions",
    "CertifiedTrajectory",
    "ClosestApproach",
    "CollisionChecker",
    "Joint",
    "PairDistances",
    "PairVerdict",
    "Part",
    "Proof",
    "ProvenPair",
    "ProvenPairs",
    "Reached",
    "Robot",
    "Settled",
    "StateDistance",
    "TrajectoryContact",
    "pairs_by_sampling",
    "prove",
]
