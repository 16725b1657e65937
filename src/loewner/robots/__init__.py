"""Robots: read descriptions into links with bodies, place the links, and check them for collisions.

`description` contains links, joints and the formats of robots, `checking` checks configurations, and `proofs` proves
motions. `checker` defines `CollisionChecker`, which users call. `sampling` guesses which pairs can never collide.
`covers` and `cover_files` replace the bodies of links with a few simple shapes. `swept` constructs bodies that contain
links throughout their motion along curves. `gradients` prepares queries for JAX and PyTorch.
"""

from loewner.robots import covers as _covers  # noqa: F401 - `covers`, `swept` and `pair_ranges` extend Robot
from loewner.robots import swept as _swept  # noqa: F401
from loewner.robots.checker import CollisionChecker
from loewner.robots.checking.distances import PairDistances, StateDistance
from loewner.robots.checking.verdicts import Settled
from loewner.robots.description.assembly import Part
from loewner.robots.description.links import Joint
from loewner.robots.description.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs
from loewner.robots.description.reaching import Reached
from loewner.robots.description.robot import Robot
from loewner.robots.proofs import pair_ranges as _pair_ranges  # noqa: F401
from loewner.robots.proofs.approaches import ClosestApproach
from loewner.robots.proofs.contact_times import TrajectoryContact
from loewner.robots.proofs.curves import CertifiedTrajectory
from loewner.robots.proofs.motions import CertifiedMotions
from loewner.robots.proofs.pair_proofs import prove
from loewner.robots.proofs.written_proofs import Proof
from loewner.robots.sampling import pairs_by_sampling

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
