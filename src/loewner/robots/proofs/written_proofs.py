"""Proofs of motions, for verification by other programs: `Proof`, and functions that make proofs."""

from __future__ import annotations

import hashlib
import os
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from loewner._base import _files, _validate
from loewner._base._validate import Floats
from loewner.errors import FileError, InputError
from loewner.queries.pairs import Verdict
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import separations
from loewner.robots.proofs.proof_models import LARGEST, TURNS, Model, contents, differences, model_of

if TYPE_CHECKING:
    from loewner.verify import Report

# Files whose models have no contact rules have the first version of the format.
MAGIC, VERSION, WITHOUT_RULES, FREE, COMMON, RANGES = b"LOEWNERP", 2, 1, 1, 2, 3
_HEAD = struct.Struct("<8sIIII")

# Programs that check proofs may refuse files larger than MOST_BYTES, and joints that turn beyond FARTHEST_TURN [rad].
MOST_BYTES, FARTHEST_TURN = 2**24, 1e6


@dataclass(frozen=True, repr=False)
class Proof:
    """A proof that motions or ranges are free of collisions, or a proof of the verdict about two bodies.

    `loewner.verify`, a program that shares no code with the rest of this library, checks such proofs.
    docs/proof-format.md describes the format.

    Attributes
    ----------
    data : bytes
        The contents of the file.

    Raises
    ------
    InputError
        If `data` is not the contents of a complete file.

    Examples
    --------
    >>> from loewner import CollisionChecker, Proof, Robot
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> proof = checker.certify_edges([0.0, 0.0], [1.0, 0.5], proof=True).proof
    >>> proof.save("motion.proof")
    >>> Proof.load("motion.proof") == proof, proof.model_hash == checker.model_hash
    (True, True)
    >>> proof.verify().sizes["pairs"] == len(checker.checked_pairs), proof.differences(checker)
    (True, [])
    >>> proof.motions
    [array([[0. , 0. ],
           [1. , 0.5]])]
    """

    data: bytes

    def __post_init__(self) -> None:
        if not isinstance(self.data, bytes):
            raise InputError(f"data: expected bytes, found {type(self.data).__name__}")
        if (fault := _fault(self.data)) is not None:
            raise InputError(f"data: expected {fault}")

    def __repr__(self) -> str:
        return f"Proof({self.verdict.name}, {len(self.data)} bytes, model {self.model_hash[:12]})"

    @property
    def size(self) -> int:
        """Number of bytes of the proof without the model and without the header."""
        return int(_HEAD.unpack_from(self.data)[4])

    @property
    def model(self) -> bytes:
        """The block of the file that describes the robot, its surroundings, and the pairs that are checked."""
        length = _HEAD.unpack_from(self.data)[3]
        return self.data[_HEAD.size : _HEAD.size + length]

    @property
    def model_hash(self) -> str:
        """SHA-256 of the model, in hexadecimal digits; `CollisionChecker.model_hash` returns it without a proof."""
        return hashlib.sha256(self.model).hexdigest()

    @property
    def verdict(self) -> Verdict:
        """FREE for a proof of motions, of ranges or of two bodies that are apart; COLLIDING for a common point."""
        return Verdict.COLLIDING if _HEAD.unpack_from(self.data)[2] == COMMON else Verdict.FREE

    @property
    def motions(self) -> list[Floats]:
        """Control points of each motion, shape (degree + 1, dof); for a straight motion, its two ends.

        An InputError is raised if the file has no motions that can be read. Only `verify` checks that the motions are
        free.
        """
        claim = _HEAD.unpack_from(self.data)[2]
        if claim != FREE:
            raise InputError(f"data: expected motions, found {'a common point' if claim == COMMON else 'ranges'}")
        block, motions = self.data[-32 - self.size : -32], list[Floats]()
        try:
            dof = len(contents(self.model)[0])
            at = 8 * dof + 4
            for _ in range(*struct.unpack_from("<I", block, at - 4)):
                shape = block[at] + 1, dof
                motions.append(np.array(struct.unpack_from(f"<{shape[0] * dof}d", block, at + 1)).reshape(shape))
                at += 1 + 8 * shape[0] * dof
        except (struct.error, IndexError, ValueError):
            raise InputError("data: expected motions, found something else") from None
        return motions

    def verify(self) -> Report:
        """Verify the proof with `loewner.verify.verify`, which shares no code with the rest of the library.

        Returns
        -------
        loewner.verify.Report
            The `str` of the report is the table that ``loewner verify`` prints.

        Raises
        ------
        FileError
            If `data` does not prove anything.
        """
        from loewner.verify import Refused, verify

        try:
            return verify(self.data)
        except Refused as error:
            raise FileError(f"proof: {error}") from None

    def differences(self, checker: Any) -> list[str]:
        """Describe how the model differs from the model of a checker.

        Parameters
        ----------
        checker : CollisionChecker

        Returns
        -------
        list of str
            Links, limits, bodies, pairs and margins that differ, each with its name; the list is empty if the hashes
            are equal.

        Raises
        ------
        InputError
            If proofs cannot express the checker's robot or scene, or if `data` does not contain a model.
        """
        if not hasattr(checker, "_ready"):  # the checker's class is in a higher module
            raise InputError(f"checker: expected loewner.CollisionChecker, found {type(checker).__name__}")
        expected = model_of(checker._ready(timed=True)).data
        try:
            return differences(self.model, expected)
        except (struct.error, IndexError):
            raise InputError("data: expected a model, found something else") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file under a temporary name, and then rename it.

        Parameters
        ----------
        path : path

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        _files.write_atomically(_validate.path(path, "path"), self.data)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Proof:
        """Read a file, and check its length and checksum, but do not verify the proof.

        Parameters
        ----------
        path : path

        Returns
        -------
        Proof

        Raises
        ------
        FileError
            If the file cannot be read, or is not a complete file of this format.
        """
        at = _validate.path(path, "path")
        data = _files.read_regular(at, "a proof", MOST_BYTES)
        try:
            return cls(data)
        except InputError as error:
            raise FileError(f"{_files.shown(at)}: {str(error).removeprefix('data: ')}") from None


def _fault(data: bytes) -> str | None:
    """Return an error message, without its beginning, for data that are not a whole file; None for a whole file."""
    if len(data) < _HEAD.size + 32 or not data.startswith(MAGIC):
        return "a proof of loewner, found something else"
    _, version, what, model, proof = _HEAD.unpack_from(data)
    if (version, what) not in ((WITHOUT_RULES, FREE), (WITHOUT_RULES, COMMON), (VERSION, FREE), (VERSION, RANGES)):
        return f"version {WITHOUT_RULES} or {VERSION} of the format, found {version}, which proves {what}"
    if len(data) != _HEAD.size + model + proof + 32:
        return f"{_HEAD.size + model + proof + 32} bytes, found {len(data)}: it is not whole"
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        return "the checksum at its end, found another: the file was changed"
    return None


def assembled(what: int, model: bytes, proof: bytes, version: int = WITHOUT_RULES) -> Proof:
    """Make a file from its blocks, unless it is larger than checkers accept."""
    data = _HEAD.pack(MAGIC, version, what, len(model), len(proof)) + model + proof
    if len(data) + 32 > MOST_BYTES:
        raise InputError(
            f"proof: expected a file of at most {MOST_BYTES} bytes, found {len(data) + 32}, of which the model takes "
            f"{len(model)}; prove fewer motions at a time"
        )
    return Proof(data + hashlib.sha256(data).digest())


def proof_of(model: Model, ready: Problem, courses: Floats, deviations: Floats, tolerance: float | None) -> Proof:
    """Write the proof of courses that the kernel has proven free.

    Parameters
    ----------
    model : Model
        The problem's model; see `proof_models.model_of`.
    ready : Problem
    courses : ndarray, shape (N, degree + 1, dof)
    deviations : ndarray, shape (dof,)
        How far each value may deviate from the courses.
    tolerance : float or None
        Distance in metres by which allowed contacts may become deeper than they are at the ends of joined motions; None
        if contact rules do not apply.

    Raises
    ------
    InputError
        If checkers might refuse the file because it is too large, has no motions, or has a joint that turns too far.
    ConvergenceError
        If the format's bounds do not suffice.
    """
    if len(courses) == 0:
        raise InputError("proof: expected one motion or more, found none; there is nothing to prove")
    turns = model.links.moves == TURNS
    values = courses[..., model.links.value[turns]] * model.links.multiplier[turns] + model.links.offset[turns]
    if not (np.abs(values) <= FARTHEST_TURN).all() or not (np.abs(courses) < LARGEST).all():
        raise InputError(
            f"proof: expected values below {LARGEST:g} and joints that turn to {FARTHEST_TURN:g} rad at most, found "
            "others"
        )
    touching, trees = separations.trees(ready, model, courses, deviations, tolerance)
    block = separations.written(deviations, courses) + separations.written_contacts(model, touching) + trees
    return assembled(FREE, model.data, block, VERSION if model.rules.any() else WITHOUT_RULES)
