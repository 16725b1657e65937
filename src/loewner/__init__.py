"""Certified collision detection for convex bodies, meshes and robots, using Löwner–John ellipsoids."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from loewner._base._threads import get_num_threads, set_num_threads
from loewner.bodies import Bodies, Body, Piece
from loewner.ellipsoids.ellipsoid_pairs import NearPoints, contact_function, near_points, overlap
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.ellipsoids.fits import Fit, mvce, mvie
from loewner.ellipsoids.polytopes import Polytope
from loewner.errors import (
    BodyIndexError,
    ConvergenceError,
    FileError,
    GeometryError,
    GpuError,
    InputError,
    LoewnerError,
    MemoryLimitError,
    MissingExtraError,
    PlanningError,
    PoseError,
    UnknownNameError,
)
from loewner.meshes.coverage import Covering, CoverReport
from loewner.queries.crowds import Overlaps, overlapping_pairs
from loewner.queries.first_contacts import FirstContact, first_contact
from loewner.queries.pairs import Distance, Verdict, classify, collide, distance, push
from loewner.queries.pose_paths import PosePath
from loewner.robots import (
    CertifiedMotions,
    CertifiedTrajectory,
    ClosestApproach,
    CollisionChecker,
    Joint,
    PairDistances,
    Part,
    Proof,
    Reached,
    Robot,
    Settled,
    StateDistance,
    TrajectoryContact,
    pairs_by_sampling,
    prove,
)
from loewner.robots import cover_files as _cover_files  # noqa: F401 - it answers methods of Robot
from loewner.scenes.files import Problem, load_scene, read_motion_bench_maker, save_scene
from loewner.scenes.scene import Attachment, Contact, Scene

__version__ = "0.1.0"

# These modules need an extra, or take longer to import than all other modules together; they are imported at first use.
_AT_FIRST_USE = ("cluster", "gpu", "jax", "paper", "planners", "plots", "torch", "viewer")

__all__ = [
    "Attachment",
    "Bodies",
    "Body",
    "BodyIndexError",
    "CertifiedMotions",
    "CertifiedTrajectory",
    "ClosestApproach",
    "CollisionChecker",
    "Contact",
    "ConvergenceError",
    "CoverReport",
    "Covering",
    "Distance",
    "Ellipsoids",
    "FileError",
    "FirstContact",
    "Fit",
    "GeometryError",
    "GpuError",
    "InputError",
    "Joint",
    "LoewnerError",
    "MemoryLimitError",
    "MissingExtraError",
    "NearPoints",
    "Overlaps",
    "PairDistances",
    "Part",
    "Piece",
    "PlanningError",
    "Polytope",
    "PoseError",
    "PosePath",
    "Problem",
    "Proof",
    "Reached",
    "Robot",
    "Scene",
    "Settled",
    "StateDistance",
    "TrajectoryContact",
    "UnknownNameError",
    "Verdict",
    "classify",
    "collide",
    "contact_function",
    "distance",
    "first_contact",
    "get_num_threads",
    "load_scene",
    "mvce",
    "mvie",
    "near_points",
    "overlap",
    "overlapping_pairs",
    "pairs_by_sampling",
    "prove",
    "push",
    "read_motion_bench_maker",
    "save_scene",
    "set_num_threads",
]


if TYPE_CHECKING:
    from loewner.planners import Gate as Gate
else:  # hidden from type checkers, which would otherwise accept any name

    def __getattr__(name: str) -> Any:
        if name in _AT_FIRST_USE:
            return import_module(f"loewner.{name}")
        if name == "Gate":
            return import_module("loewner.planners").Gate
        raise AttributeError(f"module 'loewner' has no attribute {name!r}")
