"""Models of a robot and its surroundings as stored in proofs: as bytes, and as arrays for the search for planes.

docs/proof-format.md describes the bytes. Links that do not move become frames of bodies, a planar joint becomes two
links that slide and one that turns, and surfaces become the hulls of their parts.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from loewner._base import _validate
from loewner._base._matrices import image, product
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns
from loewner._kernels.records import Tree
from loewner.bodies import Packed
from loewner.bodies.kinds import KIND_NAMES
from loewner.bodies.pack import join
from loewner.errors import InputError
from loewner.robots.checking.problem import Problem

# Kinds of joints and of pieces in the format.
STAYS, TURNS, SLIDES = 0, 1, 2
HULL = 0
# KINDS contains the kernels' kinds of pieces; the index of a kind is its number in the format. FARTHEST contains the
# largest distance of any point of each kind's unit shape from the origin. Sums of a core and a ball are stored as hulls
# of their cores.
KINDS = columns.POLYTOPE, columns.ELLIPSOID, columns.CYLINDER, columns.CONE
FARTHEST = 0.0, 1.0, np.sqrt(2.0), np.sqrt(2.0)

# Where rules allow contact: at the start of motions, at their end, or at both (the sum).
AT_START, AT_END = 1, 2

# Programs that check proofs may refuse lengths above LARGEST [m], and more than MOST_LINKS links.
LARGEST, MOST_LINKS = 2.0**32, 1000

# Names are preceded by their length in 16 bits.
LONGEST_NAME = 2**16 - 1

# Names of the bodies of a pair.
PAIR = "a", "b"


class Links(NamedTuple):
    """Links in the order of the format, as arrays with an entry or a row for each link.

    Attributes
    ----------
    names : list of str
    above : ndarray of int64
        Index of the link above; -1 for the world.
    moves : ndarray of int64
        STAYS, TURNS or SLIDES.
    value : ndarray of int64
    multiplier, offset : ndarray
    quaternion, translation, axis : ndarray, shapes (L, 4), (L, 3) and (L, 3)
    of_robot : ndarray of int64
        The robot's link that has the same pose; -1 for links that the robot does not have.
    """

    names: list[str]
    above: Ints
    moves: Ints
    value: Ints
    multiplier: Floats
    offset: Floats
    quaternion: Floats
    translation: Floats
    axis: Floats
    of_robot: Ints


class Pieces(NamedTuple):
    """Pieces of all bodies; `points` are the corners of a hull, or the center and the factor's rows of any other piece.

    Attributes
    ----------
    start : ndarray of int64, shape (bodies + 1,)
    kind : ndarray of int64
    radius : ndarray
    points : list of ndarray, shape (k, 3)
        Points in the frame of the body.
    """

    start: Ints
    kind: Ints
    radius: Floats
    points: list[Floats]


class Placed(NamedTuple):
    """Bodies, with their poses in the frames of their links.

    Attributes
    ----------
    names : tuple of str
    link : ndarray of int64, shape (bodies,)
        Indices of the bodies' links; -1 for the world.
    turn, shift : ndarray, shapes (bodies, 3, 3) and (bodies, 3)
        Rotation and translation from the frame of each body to the frame of its link.
    pieces : Pieces
    hollow : ndarray of bool, shape (bodies,)
        Whether bodies have an interior that their parts do not cover.
    """

    names: tuple[str, ...]
    link: Ints
    turn: Floats
    shift: Floats
    pieces: Pieces
    hollow: Bools


class Model(NamedTuple):
    """A model of a robot and its surroundings.

    Attributes
    ----------
    data : bytes
        The block of the file that contains the model.
    links : Links
    bodies : Placed
    pairs : ndarray of int64, shape (pairs, 2)
    margins : ndarray, shape (pairs,)
    rules : ndarray of int64, shape (pairs,)
        1 for pairs that may be in contact at the start of motions, 2 at the end, 3 at both, and otherwise 0.
    """

    data: bytes
    links: Links
    bodies: Placed
    pairs: Ints
    margins: Floats
    rules: Ints

    @property
    def hash(self) -> str:
        """SHA-256 of the block, in hexadecimal digits."""
        return hashlib.sha256(self.data).hexdigest()


_known: WeakKeyDictionary[Problem, Model] = WeakKeyDictionary()


def model_of(ready: Problem) -> Model:
    """Make the model of the pairs to check; the model is cached for each problem.

    Raises
    ------
    InputError
        If the format cannot express the model.
    """
    model = _known.get(ready)
    if model is not None:
        return model
    _refuse(ready)
    robot, cut = ready.robot, ready.in_small_parts
    links, at, turns, shifts = _links(robot.tree, robot.link_names)
    moving, standing = ready.link, cut.standing.poses.reshape(-1, 4, 4)
    link = np.append(at[moving], np.full(len(standing), -1))
    turn = np.concatenate([turns[moving], standing[:, :3, :3]])
    shift = np.concatenate([shifts[moving], standing[:, :3, 3]])
    placed = Placed(ready.names, link, turn, shift, pieces_of(cut.packed), _hollow(ready.packs, cut.packs))
    limits = list(zip(robot.configuration_names, robot.hard_lower, robot.hard_upper, strict=True))
    rules = AT_START * ready.leaving + AT_END * ready.reaching
    model = _known[ready] = _model(links, limits, placed, ready.pairs, ready.margins, rules)
    return model


def model_of_pair(packs: Sequence[Packed], cut: Sequence[Packed], poses: Floats, margin: float) -> Model:
    """Make the model of two static bodies, which have the names a and b in the model.

    Parameters
    ----------
    packs, cut : sequences of Packed
        The two bodies, and the same bodies with their surfaces cut into parts.
    poses : ndarray, shape (2, 4, 4)
    margin : float

    Raises
    ------
    InputError
        If a length exceeds the largest length that checkers accept.
    """
    none, nothing = np.array([-1]), np.zeros((1, 3))
    identity = quaternions_of(np.eye(3)[None])
    # One body gets its own link, since bodies of the world are not checked against each other.
    links = Links(["a"], none, np.array([STAYS]), none, np.ones(1), np.zeros(1), identity, nothing, nothing, none)
    pieces, hollow = pieces_of(join(cut)), _hollow(packs, cut)
    placed = Placed(PAIR, np.array([0, -1]), poses[:, :3, :3], poses[:, :3, 3], pieces, hollow)
    return _model(links, [], placed, np.array([[0, 1]]), np.array([margin]), np.zeros(1, int))


def _hollow(packs: Sequence[Packed], cut: Sequence[Packed]) -> Bools:
    """Return which bodies have an interior that their parts do not cover."""
    solid = [(pack.layout[:, columns.KIND] == columns.SOLID).any() for pack in packs]
    return np.logical_and(solid, [one is not other for one, other in zip(packs, cut, strict=True)])


def _model(
    links: Links, limits: list[tuple[str, float, float]], bodies: Placed, pairs: Ints, margins: Floats, rules: Ints
) -> Model:
    """Make a model from its parts, if checkers accept its numbers."""
    pieces = bodies.pieces
    lengths = bodies.shift, links.translation, links.axis, pieces.radius, margins, *pieces.points
    if len(links.names) > MOST_LINKS or not all((np.abs(array) < LARGEST).all() for array in lengths):
        raise InputError(
            f"proof: expected at most {MOST_LINKS} links and lengths below {LARGEST:g} m, which checkers take, found "
            f"{len(links.names)} links, or longer lengths"
        )
    data = [
        struct.pack("<I", len(links.names)), *_of_links(links),
        struct.pack("<I", len(limits)), *(_name(name) + struct.pack("<dd", *ends) for name, *ends in limits),
        of_bodies(bodies), of_pairs(_groups(links, bodies.link), pairs, margins),
    ]  # fmt: skip
    if rules.any():
        data += [struct.pack("<I", np.count_nonzero(rules))]
        data += [struct.pack("<IIB", *pairs[k].tolist(), rules[k]) for k in np.flatnonzero(rules)]
    return Model(b"".join(data), links, bodies, pairs, margins, rules)


def _refuse(ready: Problem) -> None:
    """Refuse robots and scenes that the format cannot express."""
    if ready.paths is not None:
        raise InputError(
            "proof: expected bodies at rest, found some that follow motions or grow (Scene.follow); motions among them "
            "are proven without proof= or --proof, but no proof can be written"
        )
    tree = ready.robot.tree
    for k in np.flatnonzero((tree.kind == columns.FLOATING) | (tree.kind == columns.BALL))[:1]:
        raise InputError(
            f"proof: expected joints that turn or slide, found a floating or ball joint, that of the link "
            f"{ready.robot.link_names[k]}"
        )


# -- links ------------------------------------------------------------------------------------


def _links(tree: Tree, names: tuple[str, ...]) -> tuple[Links, Ints, Floats, Floats]:
    """Make the links; for each link of the robot, also return the link that carries it, and its frame in that link."""
    rows: list[tuple[str, int, int, int, float, float, Floats, Floats, Floats, int]] = []
    count = len(names)
    at, turns, shifts = np.zeros(count, dtype=np.int64), np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    nothing, identity = np.zeros(3), np.eye(3)
    rows.append((names[0], -1, STAYS, -1, 1.0, 0.0, identity, nothing, nothing, -1))
    for k, (above, kind, row) in enumerate(zip(tree.parent.tolist(), tree.kind.tolist(), tree.constants, strict=True)):
        blocks = columns.ROTATION, columns.SINE, columns.COSINE
        fixed, sine, cosine = (row[first : first + 9].reshape(3, 3) for first in blocks)
        t = row[columns.TRANSLATION : columns.TRANSLATION + 3]
        carrier = int(at[above]) if above >= 0 else 0
        if kind == columns.FIXED:
            at[k], turns[k], shifts[k] = carrier, fixed, t
            continue
        value, m, f = int(tree.column[k]), float(tree.multiplier[k]), float(tree.offset[k])
        R, slides = fixed + cosine, row[columns.ACROSS : columns.ACROSS + 6].reshape(2, 3)
        if kind == columns.PLANAR:
            for number, axis in enumerate(slides):
                name = f"{names[k]} slides {number + 1}"
                rows.append((name, carrier, SLIDES, value + number, 1.0, 0.0, identity, t, axis, -1))
                carrier, t = len(rows) - 1, nothing
            value += 2
        # The turn about n is R (nnᵀ + sin q [n]× + cos q (1 - nnᵀ)).
        across = product(R.T, sine)
        axis = np.array([across[2, 1] - across[1, 2], across[0, 2] - across[2, 0], across[1, 0] - across[0, 1]]) / 2
        if kind == columns.PRISMATIC:
            axis = image(R.T, slides[0])
        at[k] = len(rows)
        rows.append((names[k], carrier, SLIDES if kind == columns.PRISMATIC else TURNS, value, m, f, R, t, axis, k))
    column: list[Any] = [list(entries) for entries in zip(*rows, strict=True)]
    above_, moves, values, own = (np.array(column[k], dtype=np.int64) for k in (1, 2, 3, 9))
    numbers = np.array(column[4]), np.array(column[5]), quaternions_of(np.stack(column[6]))
    links = Links(column[0], above_, moves, values, *numbers, np.stack(column[7]), np.stack(column[8]) + 0.0, own)
    return links, at, turns, shifts


def _groups(links: Links, link: Ints) -> Ints:
    """Assign a number to each group of bodies that do not move relative to each other; -1 for bodies in the world."""
    group = np.where((links.moves != STAYS) | (links.above < 0), np.arange(len(links.above)), links.above)
    return np.append(group, -1)[link]


# -- pieces -----------------------------------------------------------------------------------


def pieces_of(packed: Packed) -> Pieces:
    """List the pieces of packed bodies; surfaces, or their parts, are represented by the hulls of their corners."""
    kinds, corners = [], []
    for k, (kind, frame) in enumerate(zip(packed.layout[:, columns.KIND].tolist(), packed.frames, strict=True)):
        kinds.append(KINDS.index(kind) if kind in KINDS else HULL)
        center, factor = frame[1:4], frame[4:].reshape(3, 3)
        if kinds[-1] != HULL:
            corners.append(np.vstack([center, factor]))
        elif kind == columns.POINT:
            corners.append(center[None])
        elif kind == columns.SEGMENT:
            corners.append(np.stack([center - factor[:, 2], center + factor[:, 2]]))
        elif kind <= columns.POLYTOPE:
            own = packed.points_of(k)
            corners.append(np.unique(own + 0.0, axis=0) if kind <= columns.SURFACE else own)
        else:
            raise InputError(f"proof: expected pieces of a kind that the format has, found a {KIND_NAMES[kind]}")
    return Pieces(packed.piece_start, np.array(kinds, dtype=np.int64), packed.frames[:, 0], corners)


# -- bytes ------------------------------------------------------------------------------------


def _name(text: str) -> bytes:
    data = text.encode("utf-8", "backslashreplace")
    if len(data) > LONGEST_NAME:
        raise InputError(f"proof: expected names of at most {LONGEST_NAME} bytes, found {_validate.short(text)}")
    return struct.pack("<H", len(data)) + data


def _of_links(links: Links) -> list[bytes]:
    # Adding 0 turns -0 into 0.
    numbers = 0.0 + np.column_stack([links.multiplier, links.offset, links.quaternion, links.translation, links.axis])
    return [
        _name(name) + struct.pack("<iBi", above, moves, value) + row.astype("<f8").tobytes()
        for name, above, moves, value, row in zip(
            links.names, links.above.tolist(), links.moves.tolist(), links.value.tolist(), numbers, strict=True
        )
    ]


def of_bodies(bodies: Placed) -> bytes:
    """Write the bodies and their pieces."""
    names, link, turn, shift, pieces, hollow = bodies
    data, first = [struct.pack("<I", len(names))], pieces.start.tolist()
    for k, name in enumerate(names):
        count = first[k + 1] - first[k]
        placed = (np.append(turn[k], shift[k]) + 0.0).astype("<f8").tobytes()
        data.append(_name(name) + struct.pack("<iB", link[k], bool(hollow[k])) + placed + struct.pack("<I", count))
        for piece in range(first[k], first[k + 1]):
            kind, points = int(pieces.kind[piece]), pieces.points[piece]
            data.append(struct.pack("<Bd", kind, pieces.radius[piece]))
            if kind == HULL:
                data.append(struct.pack("<I", len(points)))
            data.append((points + 0.0).astype("<f8").tobytes())
    return b"".join(data)


def of_pairs(group: Ints, pairs: Ints, margins: Floats) -> bytes:
    """Write the pairs that are not checked, and the margins of the other pairs."""
    moving = int((group >= 0).sum())  # moving bodies come first; pairs in the world are not checked
    unchecked = np.triu(group[:moving, None] != group, 1)
    unchecked[pairs[:, 0], pairs[:, 1]] = False
    usual = 0.0
    if len(margins):
        values, times = np.unique(margins, return_counts=True)
        usual = float(values[times.argmax()])
    other = np.flatnonzero(margins != usual)
    left_out = np.stack(np.nonzero(unchecked), axis=1)
    data = [struct.pack("<I", len(left_out)), left_out.astype("<u4").tobytes(), struct.pack("<dI", usual, len(other))]
    data += [struct.pack("<IId", *pairs[k].tolist(), margins[k]) for k in other]
    return b"".join(data)


# -- two models -------------------------------------------------------------------------------


def contents(data: bytes) -> tuple[list[str], dict[str, Any]]:
    """Read the names of a model's values, and the contents of each of its parts, keyed by the part's name.

    Raises
    ------
    struct.error, IndexError
        If the bytes are not a model.
    """
    at, values, contents_by_part, links, bodies = 0, list[str](), dict[str, Any](), list[str](), list[str]()

    def take(form: str) -> Any:
        nonlocal at
        start, at = at, at + struct.calcsize("<" + form)
        return struct.unpack_from("<" + form, data, start)

    def name() -> str:
        text: str = bytes(*take(f"{take('H')[0]}s")).decode(errors="backslashreplace")
        return text if text.isprintable() else ascii(text)

    def pair() -> str:
        return " and ".join(sorted(bodies[k] for k in take("2I")))

    for _ in range(*take("I")):
        links.append(name())
        (above, *joint), numbers = take("iBi"), take("12d")
        parts = {"link above": links[above] if above >= 0 else None, "joint": (joint, numbers[:2])}
        contents_by_part[f"link {links[-1]}"] = parts | {"place": numbers[2:9], "axis": numbers[9:]}
    for _ in range(*take("I")):
        values.append(name())
        contents_by_part[f"limits of {values[-1]}"] = take("2d")
    for _ in range(*take("I")):
        bodies.append(name())
        (link, hollow), place, (count,) = take("iB"), take("12d"), take("I")
        first = at
        for _ in range(count):
            kind, _ = take("Bd")
            take(f"{12 if 0 < kind < 4 else (3 if kind == HULL else 4) * take('I')[0]}d")
        parts = {"link": links[link] if link >= 0 else None, "place": place, "interior": hollow}
        contents_by_part[f"body {bodies[-1]}"] = parts | {"pieces": data[first:at]}
    for _ in range(*take("I")):
        contents_by_part[f"pair left out, {pair()}"] = True
    contents_by_part["usual margin"] = take("d")
    for _ in range(*take("I")):
        part = f"margin of {pair()}"
        contents_by_part[part] = take("d")
    for _ in range(*take("I") if at < len(data) else (0,)):
        part = f"ends of motions at which contact is allowed for {pair()}"
        contents_by_part[part] = take("B")
    return values, contents_by_part


def differences(one: bytes, other: bytes) -> list[str]:
    """Describe how the model of a proof differs from the expected model; the list is empty only for equal bytes."""
    if one == other:
        return []
    (_, has), (_, wanted), words = contents(one), contents(other), list[str]()
    for part in sorted(has | wanted, key=lambda part: not part.startswith("body ")):
        a, b = has.get(part), wanted.get(part)
        if a is None or b is None:
            words.append(f"{part}: only in {'the proof' if b is None else 'the robot and scene'}")
        elif isinstance(a, dict) and a != b:
            words.append(f"{part}: different {' and '.join(what for what in a if a[what] != b[what])}")
        elif a != b:
            words.append(f"{part}: {', '.join(map(repr, a))} instead of {', '.join(map(repr, b))}")
    return words or ["another order of links, values, bodies or pairs"]
