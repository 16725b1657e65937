"""Bad input gets a clear error that is a LoewnerError, never an answer, a crash or half a file."""

import copy
import os
import pickle
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import box_corners, pieces, translation
from loewner import (
    Bodies,
    Body,
    FileError,
    GeometryError,
    InputError,
    LoewnerError,
    PoseError,
    Scene,
    UnknownNameError,
    paper,
)
from loewner._base import _validate
from sampling import quick

CUBE = box_corners(np.ones(3))


def with_entry(value: float) -> np.ndarray:
    P = CUBE.copy()
    P[3, 1] = value
    return P


# -- vertices ------------------------------------------------------------------------------------------

POINTS: dict[str, tuple[object, type[LoewnerError]]] = {
    "NaN": (with_entry(np.nan), InputError),
    "inf": (with_entry(np.inf), InputError),
    "empty": (np.empty((0, 3)), InputError),
    "one point": (CUBE[:1], GeometryError),
    "two points": (CUBE[:2], GeometryError),
    "three points": (CUBE[:3], GeometryError),
    "flat": (CUBE * [1, 1, 0], GeometryError),
    "flat and tilted": (CUBE @ [[1, 0, 0.3], [0, 1, 0.7], [0, 0, 0]], GeometryError),
    "flat and far": (CUBE * [1, 1, 0] + 1e6, GeometryError),
    "collinear": (CUBE[:, :1] * [[1, 2, 3]], GeometryError),
    "one point many times": (np.ones((10, 3)), GeometryError),
    "three points many times": (np.tile(CUBE[:3], (5, 1)), GeometryError),
    "two columns": (CUBE[:, :2], InputError),
    "one vector": (np.zeros(3), InputError),
    "four columns": (np.ones((8, 4)), InputError),
    "ragged": ([[0, 0, 0], [1, 0], [0, 1, 0], [0, 0, 1]], InputError),
    "text": ([["a", "b", "c"]] * 4, InputError),
    "complex": (CUBE.astype(complex), InputError),
    "None": (None, InputError),
    "larger than a float can square": (CUBE * 1e200, InputError),
    "too small to square": (CUBE * 1e-200, InputError),
}


@pytest.mark.parametrize("what", POINTS)
def test_bad_points(what: str):
    """Points that bound no volume, or are no numbers, are refused with what was expected and what was found."""
    points, error = POINTS[what]
    makers: list[Callable[[object], object]] = [Body.from_points, lambda P: Body.from_pieces([P])]
    if not isinstance(points, np.ndarray) or points.ndim == 2:
        makers.append(lambda P: Bodies.from_points([CUBE, P]))
    for make in makers:
        with pytest.raises(error, match="(?s)expected .*found") as caught:
            make(points)
        assert isinstance(caught.value, ValueError)


def test_the_bad_one_of_many_is_named():
    """In a list of bodies the message says which one."""
    with pytest.raises(GeometryError, match="2"):
        Bodies.from_points([CUBE, CUBE, CUBE * [1, 1, 0]])


def test_bad_half_spaces():
    """Half-spaces that are unbounded, empty or flat are a GeometryError; malformed arrays are an InputError."""
    box = np.concatenate([np.eye(3), -np.eye(3)])
    for A, b in [
        (np.eye(3), np.ones(3)),  # unbounded
        (box[:5], np.ones(5)),  # unbounded
        (box, np.array([1, 1, 1, -2, 1, 1])),  # empty
        (box, np.array([1, 1, 1, -1, 1, 1])),  # flat
        (box, np.zeros(6)),  # a point
        (np.eye(3), np.zeros(3)),  # a cone
        (box, np.full(6, 5e-324)),  # lost in scaling
        (np.zeros((6, 3)), np.zeros(6)),  # all of space
        (np.r_[np.diag([1e308, 1, 1]), -np.eye(3)], np.ones(6)),  # a corner cut by a plane nearly through the middle
    ]:
        for make in (loewner.Polytope.from_halfspaces, loewner.mvie):
            with pytest.raises(GeometryError):
                make(A, b)
    for A, b in [
        (np.empty((0, 3)), np.empty(0)),
        (box, np.ones(5)),
        (box * np.nan, np.ones(6)),
        (box, np.array([1, 1, 1, np.inf, np.nan, 1])),
        (np.ones(3), np.ones(3)),
        (box * 1e-300, np.full(6, 1e300)),
    ]:
        for make in (loewner.Polytope.from_halfspaces, loewner.mvie):
            with pytest.raises(InputError):
                make(A, b)


# -- primitives ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), "one", None])
def test_bad_sizes(bad: object):
    """Every size of every primitive has to be a finite number greater than zero."""
    for make in (
        lambda: Body.sphere(bad),
        lambda: Body.cylinder(bad, 1),
        lambda: Body.cylinder(1, bad),
        lambda: Body.capsule(bad, 1),
        lambda: Body.cone(bad, 1),
        lambda: Body.cone(1, bad),
        lambda: Body.box([1, bad, 1]),
        lambda: Body.ellipsoid([1, 1, bad]),
    ):
        with pytest.raises(InputError):
            make()


def test_bad_lengths_of_capsules():
    """A capsule may have length 0 (a ball) or refuse it, but never a negative or NaN one."""
    for bad in (-1, float("nan"), float("inf")):
        with pytest.raises(InputError):
            Body.capsule(1, bad)


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e200])
def test_sizes_beyond_the_kernels(size: float):
    """Refused with the range that is allowed, without a warning on the way there."""
    for make in (
        lambda: Body.sphere(size),
        lambda: Body.cylinder(size, size),
        lambda: Body.capsule(size, size),
        lambda: Body.cone(size, size),
        lambda: Body.ellipsoid([size, size, size]),
    ):
        with pytest.raises(GeometryError, match="expected sizes between 1e-30 and 1e\\+30 m"):
            make()


def test_bad_shapes_of_sizes():
    """A primitive is refused if it gets too few or too many sizes."""
    for make in (
        lambda: Body.box([1, 1]),
        lambda: Body.box(1),
        lambda: Body.ellipsoid([1, 1, 1, 1]),
        lambda: Body.sphere([1, 1]),
    ):
        with pytest.raises(InputError):
            make()


def test_bad_tolerance():
    """A tolerance of fits has to be greater than zero."""
    for tol in (0, -1, float("nan")):
        with pytest.raises(InputError):
            Body.from_points(CUBE, tol=tol)


# -- poses ---------------------------------------------------------------------------------------------


def pose(**entries: float) -> np.ndarray:
    T = np.eye(4)
    for where, value in entries.items():
        T[int(where[1]), int(where[2])] = value
    return T


POSES: dict[str, object] = {
    "scaled": np.diag([2.0, 2, 2, 1]),
    "slightly scaled": np.diag([1.0001, 1.0001, 1.0001, 1]),
    "sheared": pose(_01=0.5),
    "mirrored": pose(_00=-1),
    "zero": np.zeros((4, 4)),
    "NaN rotation": pose(_00=np.nan),
    "NaN translation": pose(_03=np.nan),
    "inf translation": pose(_23=np.inf),
    "bad last row": pose(_30=0.1),
    "transposed": pose(_32=1.0),
    "3 x 3": np.eye(3),
    "3 x 4": np.eye(4)[:3],
    "a vector": np.ones(4),
    "text": "identity",
    "one bad among good": np.stack([np.eye(4), np.diag([1.0, 1, 2, 1])]),
}


@pytest.mark.parametrize("what", POSES)
@pytest.mark.parametrize("ask", ["classify", "collide", "distance"])
def test_bad_poses(what: str, ask: str):
    """A pose that is no rigid motion is refused by every query, for either operand, and by `transformed`."""
    a, b = Body.box([1, 1, 1]), Body.sphere(1)
    query = getattr(loewner, ask)
    for arguments in ((a, POSES[what], b, None), (a, None, b, POSES[what])):
        with pytest.raises(PoseError):
            query(*arguments)
    with pytest.raises(PoseError):
        a.transformed(POSES[what])


def test_poses_that_do_not_broadcast():
    """Bodies and poses that do not broadcast are a PoseError that tells the counts."""
    a = Body.box([1, 1, 1])
    three, four = np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(4), (4, 1, 1))
    many = Bodies([a, a, a])
    for arguments in (
        (a, three, a, four),
        (many, four, a, None),
        (many, None, Bodies([a, a]), None),
        (many, np.tile(np.eye(4), (3, 2, 1, 1)), a, None),
    ):
        for query in (loewner.classify, loewner.collide, loewner.distance):
            with pytest.raises(PoseError, match="3"):
                query(*arguments)


# -- options ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("margin", [-1e-9, -1, float("nan"), float("inf"), "wide", None, [0.1, 0.2]])
def test_bad_margin(margin: object):
    """A margin has to be one finite number that is not negative."""
    a = Body.sphere(1)
    for query in (loewner.classify, loewner.collide):
        for arguments in ((a, None, a, None), (a, np.tile(np.eye(4), (3, 1, 1)), a, None)):
            with pytest.raises(InputError, match="margin: expected a"):
                query(*arguments, margin=margin)
    with pytest.raises(InputError, match="margin: expected a"):
        loewner.overlapping_pairs(Bodies([a, a]), margin=margin)


class Sulky:
    """An object that fails at whatever it is asked."""

    def __fail(self, *_: object, **__: object) -> None:
        raise RuntimeError("not today")

    __float__ = __index__ = __array__ = __bool__ = __len__ = __iter__ = __getitem__ = __repr__ = __fail


# Name: what is no number wherever one is wanted.
NO_NUMBERS: dict[str, object] = {
    "huge integer": 10**400,
    "huge negative integer": -(10**400),
    "integer too long to write": 10**5000,
    "huge fraction": Fraction(10**400),
    "NaN": np.nan,
    "Decimal NaN": Decimal("NaN"),
    "inf": -np.inf,
    "text": "1",
    "bytes": b"1",
    "bytearray": bytearray(b"1"),
    "NumPy text": np.str_("1"),
    "NumPy bytes": np.bytes_(b"1"),
    "True": True,
    "NumPy True": np.True_,
    "array of True": np.array(True),
    "None": None,
    "complex": 1 + 0j,
    "NumPy complex": np.complex128(1),
    "date": np.datetime64(1, "ns"),
    "span of time": np.timedelta64(1, "ns"),
    "masked": np.ma.masked,
    "masked number": np.ma.array(1.0, mask=True),
    "array with an axis": np.ones(1),
    "list": [1.0],
    "set": {1.0},
    "type": float,
    "object that fails": Sulky(),
    "array of text": np.array("1"),
    "array of None": np.array(None, dtype=object),
}
NUMBERS: dict[str, object] = {
    "int": 2,
    "float": 2.0,
    "float32": np.float32(2),
    "float16": np.float16(2),
    "longdouble": np.longdouble(2),
    "int8": np.int8(2),
    "uint64": np.uint64(2),
    "array": np.array(2.0),
    "big-endian array": np.array(2, dtype=">i4"),
    "array of an object": np.array(2, dtype=object),
    "masked array without a mask": np.ma.array(2.0),
    "Fraction": Fraction(2),
    "Decimal": Decimal(2),
}


@pytest.mark.parametrize("what", NO_NUMBERS)
def test_what_is_no_number(what: str):
    """Text, booleans, dates, masked entries and what no float can hold are refused as numbers, whoever asks."""
    a, bad = Body.sphere(1), NO_NUMBERS[what]
    for ask_for in (
        lambda: _validate.positive_scalar(bad, "x"),
        lambda: _validate.positive_scalar(bad, "x", zero=True),
        lambda: Body.sphere(bad),
        lambda: loewner.collide(a, None, a, None, margin=bad),
        lambda: loewner.mvce(CUBE, tol=bad),
        lambda: loewner.near_points(a.outer, a.outer, angle=bad),
        lambda: Scene(margin=bad),
    ):
        with pytest.raises(InputError, match=r"^(x|radius|margin|tol|angle): expected a (finite )?number") as caught:
            ask_for()
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize("what", NUMBERS)
def test_what_is_a_number(what: str):
    """Whatever type it has, the number counts."""
    assert _validate.positive_scalar(NUMBERS[what], "x") == 2.0
    assert Body.sphere(NUMBERS[what]).outer.semi_axes[0, 0] == pytest.approx(2.0)


@pytest.mark.parametrize("what", [*NO_NUMBERS, "float", "Fraction", "Decimal", "longdouble"])
def test_what_is_no_count(what: str):
    """Of numbers, only integers that an array could have as its length."""
    with pytest.raises(InputError, match="n: expected an integer [<>]= "):
        _validate.whole_number(NO_NUMBERS.get(what, 2.5), "n", 0)


def test_counts():
    """Integers of any type, within the bounds given."""
    for x in (2, np.int8(2), np.uint64(2), np.array(2)):
        assert _validate.whole_number(x, "n", 0, 2) == 2
        for least, most in ((3, 9), (0, 1)):
            with pytest.raises(InputError, match="n: expected an integer"):
                _validate.whole_number(x, "n", least, most)


def masked(P: np.ndarray, at: object) -> np.ma.MaskedArray:
    mask = np.zeros(P.shape, dtype=bool)
    mask[at] = True
    return np.ma.array(P, mask=mask)


# Name: what is no array of numbers, made from one.
NO_ARRAYS: dict[str, Callable[[np.ndarray], object]] = {
    "booleans": lambda P: P > 0,
    "lists of booleans": lambda P: (P > 0).tolist(),
    "complex": lambda P: P + 0j,
    "text": lambda P: P.astype(str),
    "bytes": lambda P: P.astype("S"),
    "dates": lambda P: P.astype("datetime64[s]"),
    "spans of time": lambda P: P.astype("timedelta64[s]"),
    "records": lambda P: P.view([("x", float)]),
    "one masked entry": lambda P: masked(P, (0, 0)),
    "all masked": lambda P: masked(P, ...),
    "rows with a mask": lambda P: list(masked(P, (1, 1))),
    "objects": lambda P: np.full(P.shape, None),
    "numbers as text among objects": lambda P: P.astype(str).astype(object),
    "an object that fails": lambda P: Sulky(),
    "a row that fails": lambda P: [Sulky(), *P[1:]],
    "integers beyond a float": lambda P: [[10**400] * P.shape[1]] * len(P),
    "beyond a float": lambda P: np.full(P.shape, np.longdouble("1e4000")),
    "a generator": lambda P: (row for row in P),
    "a set": lambda P: {1.0, 2.0},
    "a dict": lambda P: dict(enumerate(P)),
    "a body": lambda P: Body.sphere(1),
}


@pytest.mark.parametrize("what", NO_ARRAYS)
def test_what_is_no_array(what: str):
    """Booleans, dates, masked entries and objects are refused, as points, poses and whatever else is an array."""
    a, make = Body.sphere(1), NO_ARRAYS[what]
    for ask_for in (
        lambda: Body.from_points(make(CUBE)),
        lambda: loewner.mvce(make(CUBE)),
        lambda: loewner.mvie(make(np.r_[np.eye(3), -np.eye(3)]), np.ones(6)),
        lambda: loewner.Ellipsoids.from_semi_axes(make(np.zeros((2, 3))), [1, 1, 1]),
    ):
        with pytest.raises(InputError):
            ask_for()
    for query in (loewner.classify, loewner.collide, loewner.distance):
        with pytest.raises(PoseError):
            query(a, make(np.eye(4)), a, None)


KINDS_OF_ARRAYS: dict[str, Callable[[np.ndarray], object]] = {
    "big-endian": lambda P: P.astype(">f8"),
    "float16": lambda P: P.astype(np.float16),
    "longdouble": lambda P: P.astype(np.longdouble),
    "read-only": lambda P: np.broadcast_to(P, P.shape),
    "Fortran order": np.asfortranarray,
    "not aligned": lambda P: np.frombuffer(b"x" + P.tobytes(), dtype=np.uint8)[1:].view(np.float64).reshape(P.shape),
    "matrix": lambda P: P.view(np.matrix) if P.ndim == 2 else P,
    "masked, none of it": lambda P: np.ma.array(P),
    "masked rows, none of it": lambda P: list(np.ma.array(P)),
    "objects": lambda P: P.astype(object),
    "fractions": lambda P: [[Fraction(x) for x in row] for row in P.tolist()],
    "decimals": lambda P: [[Decimal(x) for x in row] for row in P.tolist()],
    "huge integers": lambda P: [[int(x) * 2**70 for x in row] for row in P.tolist()],
}


@pytest.mark.parametrize("what", KINDS_OF_ARRAYS)
def test_every_kind_of_array_says_the_same(what: str):
    """The numbers count, not their type or layout."""
    P = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2]], dtype=float)
    size = 2.0**70 if what == "huge integers" else 1.0
    wanted, found = loewner.mvce(P * size), loewner.mvce(KINDS_OF_ARRAYS[what](P))
    assert np.array_equal(found.ellipsoid.factor, wanted.ellipsoid.factor)
    if size == 1.0:
        a, T = Body.box([1, 1, 1]), np.eye(4)
        T[0, 3] = 1.5
        given = KINDS_OF_ARRAYS[what](T)
        assert loewner.distance(a, given, a, None, exact=True).distance == pytest.approx(0.5)


NO_PAIRS: dict[str, object] = {
    "floats": [[0.0, 0.0]],
    "booleans": [[True, False]],
    "beyond 64 bits": [[2**70, 0]],
    "beyond 63 bits": np.array([[2**63, 0]], dtype=np.uint64),
    "negative": [[-1, 0]],
    "text": [["0", "0"]],
    "None": [[None, 0]],
    "masked": np.ma.array([[0, 0]], mask=[[True, False]]),
    "ragged": [[0, 0], [0]],
    "three numbers": [[0, 0, 0]],
    "one number": 0,
    "an object that fails": Sulky(),
}


@pytest.mark.parametrize("what", NO_PAIRS)
def test_what_is_no_list_of_pairs(what: str):
    """Row numbers are integers in two columns."""
    a = Bodies.spheres([1.0, 1.0])
    for query in (loewner.classify, loewner.collide, loewner.distance):
        with pytest.raises(InputError):
            query(a, None, a, None, pairs=NO_PAIRS[what])


@pytest.mark.parametrize("bad", ["no", "", 0, 1, None, [], np.ones(2), Sulky()], ids=lambda x: type(x).__name__)
def test_what_is_neither_true_nor_false(bad: object):
    """A choice of two takes True and False: 'no' is not taken for yes."""
    a = Body.sphere(1)
    with pytest.raises(InputError, match="exact: expected True or False"):
        loewner.distance(a, None, a, None, exact=bad)
    with pytest.raises(InputError, match="depth: expected True or False"):
        loewner.overlapping_pairs(a, depth=bad)
    assert loewner.distance(a, None, a, None, exact=np.True_).distance is not None


@pytest.mark.parametrize(
    "bad", [None, 1, b"exact", ["exact"], {"exact"}, np.array(["exact"] * 2), Sulky()], ids=lambda x: type(x).__name__
)
def test_what_is_no_name_of_a_method(bad: object):
    """Also what has no hash, or compares entry by entry."""
    a, E = Body.sphere(1), loewner.Ellipsoids([0, 0, 0], np.eye(3))
    for ask_for in (
        lambda: loewner.collide(a, None, a, None, method=bad),
        lambda: loewner.overlapping_pairs(a, method=bad),
        lambda: loewner.near_points(E, E, method=bad),
        lambda: paper.distance_estimate(E, E, E, E, method=bad),
    ):
        with pytest.raises((UnknownNameError, InputError), match="expected "):
            ask_for()


# -- batches -----------------------------------------------------------------------------------------------

PAIRWISE = ("classify", "collide", "distance")


def ask(query: str, a: object, Ta: object, b: object, Tb: object) -> np.ndarray:
    """One array of answers, from whichever query."""
    if query == "distance":
        return np.asarray(loewner.distance(a, Ta, b, Tb, exact=True).distance)
    return np.asarray(getattr(loewner, query)(a, Ta, b, Tb))


def row_of_poses(count: int) -> np.ndarray:
    """Poses along x: whole metres, which every type of number can say."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3] = np.arange(count)
    return T


@pytest.mark.parametrize("query", PAIRWISE)
def test_lengths_that_do_not_match_are_named(query: str):
    """Seven poses for eight, or for eight bodies: both lengths are in the message."""
    a = Body.box([1, 1, 1])
    seven, eight, many = row_of_poses(7), row_of_poses(8), Bodies([a] * 8)
    for arguments in (
        (a, seven, a, eight),
        (many, seven, a, None),
        (a, None, many, seven),
        (many, None, many[:7], None),
    ):
        with pytest.raises(PoseError) as caught:
            ask(query, *arguments)
        assert "7" in str(caught.value)
        assert "8" in str(caught.value)


def test_one_pose_for_each_body_of_a_crowd():
    """A crowd with another number of poses than bodies is refused, with both counts."""
    many = Bodies([Body.box([1, 1, 1])] * 8)
    with pytest.raises(PoseError, match="8 bodies, found 7"):
        loewner.overlapping_pairs(many, row_of_poses(7))


@pytest.mark.parametrize("query", PAIRWISE)
def test_empty_batches_come_back_empty(query: str):
    """A batch without pairs gets a result without entries, of the shape the operands broadcast to."""
    a, none = Body.box([1, 1, 1]), np.empty((0, 4, 4))
    nobody = Bodies([a])[:0]
    for arguments in ((a, none, a, None), (a, None, a, none), (a, none, a, none), (nobody, None, a, None)):
        assert ask(query, *arguments).shape == (0,)
    assert ask(query, a, np.empty((3, 0, 4, 4)), a, None).shape == (3, 0)
    assert ask(query, nobody, np.tile(np.eye(4), (3, 1, 1, 1)), a, None).shape == (3, 0)


def test_an_empty_crowd_has_no_pairs():
    """A crowd without bodies has no pairs: an array of shape (0, 2), of integers."""
    for found in (
        loewner.overlapping_pairs(Bodies([Body.sphere(1)])[:0]),
        loewner.overlapping_pairs(Body.sphere(1), np.empty((0, 4, 4))),
    ):
        assert found.shape == (0, 2)
        assert found.dtype == np.int64


def read_only(T: np.ndarray) -> np.ndarray:
    T = T.copy()
    T.setflags(write=False)
    return T


KINDS_OF_POSES: dict[str, Callable[[np.ndarray], object]] = {
    "every second": lambda T: np.repeat(T, 2, axis=0)[::2],
    "backwards twice": lambda T: np.ascontiguousarray(T[::-1])[::-1],
    "part of wider rows": lambda T: np.concatenate([T, T], axis=2)[:, :, :4],
    "Fortran order": np.asfortranarray,
    "transposed twice": lambda T: np.ascontiguousarray(T.transpose(0, 2, 1)).transpose(0, 2, 1),
    "broadcast": lambda T: np.broadcast_to(T, (2, *T.shape))[0],
    "other byte order": lambda T: T.astype(T.dtype.newbyteorder()),
    "read-only": read_only,
    "float32": lambda T: T.astype(np.float32),
    "float16": lambda T: T.astype(np.float16),
    "int64": lambda T: T.astype(np.int64),
    "int8": lambda T: T.astype(np.int8),
    "uint8": lambda T: T.astype(np.uint8),
    "lists": lambda T: T.tolist(),
}


@pytest.mark.parametrize("kind", KINDS_OF_POSES)
@pytest.mark.parametrize("query", [*PAIRWISE, "overlapping_pairs"])
def test_any_array_of_poses_will_do(query: str, kind: str):
    """How poses are laid out or typed changes no answer, and they are not written to: in batches and one at a time."""
    a, T = Body.from_points(CUBE), row_of_poses(6)
    given = KINDS_OF_POSES[kind](T)
    if query == "overlapping_pairs":
        assert loewner.overlapping_pairs(a, given).tolist() == [[k, k + 1] for k in range(5)]
    else:
        wanted = ask(query, a, T, a, None)
        assert len(np.unique(wanted)) > 1
        assert np.array_equal(ask(query, a, given, a, None), wanted)
        assert np.array_equal(ask(query, a, None, a, given), ask(query, a, None, a, T))
        assert [ask(query, a, given[k], a, None).item() for k in range(6)] == wanted.tolist()
    assert np.array_equal(given, T)


@pytest.mark.parametrize("query", PAIRWISE)
def test_a_batch_beyond_memory_is_refused(query: str, monkeypatch: pytest.MonkeyPatch):
    """Before anything is computed, with the shape asked for and the memory that it would take."""
    a = Body.sphere(1)
    monkeypatch.setattr(_validate, "physical_memory", lambda: 2**30)
    across, down = row_of_poses(40_000), row_of_poses(40_000)[:, None]
    with pytest.raises(InputError, match=r"memory \(1 GiB\), found \(40000, 40000\) pairs, which need [0-9.]+ GiB"):
        ask(query, a, across, a, down)


@pytest.mark.parametrize("exact", [False, True])
def test_distances_take_more_memory_than_verdicts(exact: bool, monkeypatch: pytest.MonkeyPatch):
    """A batch of as many distances as bytes: each takes more than one, and is counted so."""
    a, T = Body.sphere(1), row_of_poses(1000)
    monkeypatch.setattr(_validate, "physical_memory", lambda: 1000)
    assert loewner.classify(a, T, a, None).shape == (1000,)
    with pytest.raises(InputError, match="fit into memory"):
        loewner.distance(a, T, a, None, exact=exact)


def test_a_crowd_with_more_pairs_than_memory_is_refused(monkeypatch: pytest.MonkeyPatch):
    """All of them in one place: 500,000 pairs, told as soon as they become too many."""
    T = np.tile(np.eye(4), (1000, 1, 1))
    monkeypatch.setattr(_validate, "physical_memory", lambda: 2**20)
    with pytest.raises(InputError, match="pairs of 1000 bodies"):
        loewner.overlapping_pairs(Body.sphere(1), T)


def test_unknown_names_list_the_known():
    """An unknown method is refused by a message that lists the known ones."""
    a, E = Body.sphere(1), loewner.Ellipsoids([0, 0, 0], np.eye(3))
    with pytest.raises(UnknownNameError, match="exact"):
        loewner.collide(a, None, a, None, method="exakt")
    for method in ("rimon", "", ["rimon-boyd"]):
        with pytest.raises(UnknownNameError, match="rimon-boyd"):
            paper.distance_estimate(E, E, E, E, method)
    for method in ("rimon", "", ["rimon-boyd"]):
        with pytest.raises(UnknownNameError, match="rimon-boyd"):
            loewner.near_points(E, E, method)


def test_things_that_are_no_bodies():
    """An operand that is no body is refused by every query, on either side."""
    a = Body.sphere(1)
    for other in (CUBE, None, "sphere", [a]):
        for query in (loewner.classify, loewner.collide, loewner.distance):
            with pytest.raises(InputError):
                query(a, None, other, None)
            with pytest.raises(InputError):
                query(other, None, a, None)
        with pytest.raises(InputError, match=f"bodies: expected .* found {type(other).__name__}"):
            loewner.overlapping_pairs(other)


def test_bodies_without_pieces():
    """A body needs at least one piece, and bodies are made of bodies only."""
    for make in (lambda: Body.from_pieces([]), lambda: Body.union([])):
        with pytest.raises(GeometryError):
            make()
    for make in (lambda: Bodies([CUBE]), lambda: Body.union([CUBE])):
        with pytest.raises(InputError):
            make()


# -- files -------------------------------------------------------------------------------------------------


def write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_bad_body_files(tmp_path: Path):
    """A missing, cut or foreign body file is a FileError, which is an OSError and names the file."""
    good = tmp_path / "good.npz"
    Body.from_points(CUBE).save(good)
    whole = good.read_bytes()
    bad = [
        tmp_path / "missing.npz",
        tmp_path,  # a folder
        write(tmp_path / "empty.npz", b""),
        write(tmp_path / "text.npz", b"not a body"),
        write(tmp_path / "half.npz", whole[: len(whole) // 2]),
        write(tmp_path / "nearly.npz", whole[:-10]),
    ]
    np.savez(tmp_path / "other.npz", x=np.ones(3))
    np.savez(tmp_path / "pickle.npz", x=np.array([{}], dtype=object))
    np.save(tmp_path / "array.npy", np.ones(3))
    bad += [tmp_path / "other.npz", tmp_path / "pickle.npz", tmp_path / "array.npy"]
    for path in bad:
        for load in (Body.load, Bodies.load):
            with pytest.raises(FileError) as caught:
                load(path)
            assert isinstance(caught.value, OSError)
            assert path.name in str(caught.value)


@pytest.mark.parametrize("count", quick(60, 150))
def test_no_flipped_bit_gives_another_body(tmp_path: Path, count: int):
    """Any byte of a body file changed: an error, or the very same body (padding); never a different one."""
    body = Body.from_points(pieces("ball 20", 1)[0])
    path = tmp_path / "good.npz"
    body.save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for k in rng.choice(len(whole), size=count, replace=False):
        changed = bytearray(whole)
        changed[k] ^= 1 << rng.integers(8)
        try:
            again = Body.load(write(tmp_path / "bad.npz", bytes(changed)))
        except FileError:
            continue
        assert np.array_equal(again.inner.factor, body.inner.factor)
        assert np.array_equal(again.outer.factor, body.outer.factor)
        assert np.array_equal(again.outer.center, body.outer.center)
        assert np.array_equal(again.pieces[0].vertices, body.pieces[0].vertices)


def tampered(source: Path, target: Path, change: Callable[[dict[str, np.ndarray]], None]) -> Path:
    with np.load(source, allow_pickle=False) as data:
        arrays = {name: data[name].copy() for name in data.files}
    change(arrays)
    np.savez(target, **arrays)
    return target


def test_tampered_arrays(tmp_path: Path):
    """A well-formed file with any array missing, cut, or spoilt by NaN is refused."""
    good = tmp_path / "good.npz"
    Body.from_pieces(pieces("boxes", 2)).save(good)
    with np.load(good, allow_pickle=False) as data:
        names, kinds = data.files, {name: data[name].dtype.kind for name in data.files}
        sizes = {name: data[name].shape for name in data.files}

    def drop(name: str) -> Callable[[dict[str, np.ndarray]], None]:
        return lambda arrays: arrays.pop(name)

    def cut(name: str) -> Callable[[dict[str, np.ndarray]], None]:
        return lambda arrays: arrays.update({name: arrays[name][:-1]})

    def spoil(name: str) -> Callable[[dict[str, np.ndarray]], None]:
        return lambda arrays: arrays[name].flat.__setitem__(0, np.nan)

    def past_the_end(name: str) -> Callable[[dict[str, np.ndarray]], None]:
        return lambda arrays: arrays[name].flat.__setitem__(-1, 2**40)

    accepted = []
    for name in names:
        changes = [("dropped", drop(name))]
        if sizes[name] and sizes[name][0]:
            changes.append(("cut", cut(name)))
            if kinds[name] == "f":
                changes.append(("NaN", spoil(name)))
            elif kinds[name] in "iu":
                changes.append(("past the end", past_the_end(name)))
        for what, change in changes:
            try:
                Body.load(tampered(good, tmp_path / "bad.npz", change))
            except FileError:
                continue
            accepted.append((name, what))
    # Provenance (a covering's record, say) may be optional; geometry is not.
    assert not [x for x in accepted if not x[0].startswith(("covering", "meta"))]


def test_a_shrunken_outer_ellipsoid_is_refused(tmp_path: Path):
    """A file whose ellipsoids do not nest about the piece would certify wrong verdicts; it is not loaded."""
    good = tmp_path / "good.npz"
    Body.from_points(CUBE).save(good)
    with np.load(good, allow_pickle=False) as data:
        shapes = {name: data[name].shape for name in data.files if data[name].dtype.kind == "f"}
    refused = 0
    for name, shape in shapes.items():
        if not shape:
            continue
        for factor in (0.5, 2.0):
            path = tampered(
                good, tmp_path / "bad.npz", lambda arrays, n=name, f=factor: arrays.update({n: arrays[n] * f})
            )
            try:
                body = Body.load(path)
            except FileError:
                refused += 1
                continue
            # Whatever was accepted must still be sound.
            piece = body.pieces[0]
            u = np.linalg.solve(body.outer.factor[0], (piece.vertices - body.outer.center[0]).T)
            assert np.linalg.norm(u, axis=0).max() <= 1 + 1e-12
            F = body.inner.factor[0]
            reach = piece.normals @ body.inner.center[0] + np.linalg.norm(piece.normals @ F, axis=1)
            assert (reach <= piece.offsets + 1e-12).all()
            assert (piece.vertices @ piece.normals.T <= piece.offsets + 1e-12).all()
    assert refused > 0


def test_a_newer_file_says_so(tmp_path: Path):
    """A file of a later format version is refused with a message that says why."""
    good = tmp_path / "good.npz"
    Body.from_points(CUBE).save(good)
    with np.load(good, allow_pickle=False) as data:
        versions = [n for n in data.files if "version" in n or "format" in n]
    assert versions

    def newer(arrays: dict[str, np.ndarray]) -> None:
        for name in versions:
            if arrays[name].dtype.kind in "iu":
                arrays[name] = arrays[name] + 1000

    with pytest.raises(FileError, match=r"newer|version"):
        Body.load(tampered(good, tmp_path / "new.npz", newer))


def test_bad_mesh_files(tmp_path: Path):
    """A missing, cut or malformed mesh file is an error that names the file, or a GeometryError."""
    pytest.importorskip("trimesh")
    binary = b"\0" * 80 + (1000).to_bytes(4, "little") + b"\0" * 120
    for path in (
        tmp_path / "missing.stl",
        tmp_path,
        write(tmp_path / "empty.stl", b""),
        write(tmp_path / "text.stl", b"this is no mesh\n"),
        write(tmp_path / "half.stl", binary),
        write(tmp_path / "empty.obj", b""),
        write(tmp_path / "points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        write(tmp_path / "index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        write(tmp_path / "nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"),
        write(tmp_path / "what.xyz", b"1 2 3"),
        write(tmp_path / "none", b"abc"),
    ):
        with pytest.raises((FileError, InputError)) as caught:
            Body.from_mesh(path)
        assert path.name in str(caught.value) or isinstance(caught.value, GeometryError)


def test_a_flat_mesh_is_an_error(tmp_path: Path):
    """A mesh without volume makes no body."""
    pytest.importorskip("trimesh")
    path = write(tmp_path / "flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with pytest.raises(LoewnerError):
        Body.from_mesh(path, decompose=False)


class Unfit(os.PathLike[str]):
    """A path-like object that is none."""

    def __repr__(self) -> str:  # the name of a test must not change from process to process
        return "Unfit()"

    def __fspath__(self) -> str:
        raise RuntimeError("no path today")


@pytest.mark.parametrize("bad", [None, 3, b"part.stl", "", "a\0b", "\ud800", [], Unfit(), CUBE], ids=repr)
def test_what_is_no_path(bad: object):
    """A path is text that the file system can hold; anything else is an InputError that names the argument."""
    with pytest.raises(InputError, match="file: expected the path of a file, found "):
        _validate.path(bad, "file")


@pytest.mark.parametrize("good", ["a", "a b/ü", os.fsdecode(b"not\xffutf-8"), Path("a/b"), np.str_("a")], ids=ascii)
def test_what_is_a_path(good: os.PathLike[str]):
    """Also names that are not UTF-8, as `os.listdir` gives them."""
    assert _validate.path(good, "file") == Path(good)


# -- what is not bad ------------------------------------------------------------------------------------------


def test_empty_batches_have_the_usual_types():
    """Results without entries have the same types and trailing shapes as any others."""
    a, none = Body.box([1, 1, 1]), np.empty((0, 4, 4))
    assert loewner.classify(a, none, a, None).dtype == np.int8
    assert loewner.collide(a, none, a, None).dtype == np.bool_
    result = loewner.distance(a, none, a, None, exact=True)
    assert result.lower.shape == result.upper.shape == result.estimate.shape == (0,)
    assert result.witness_a.shape == result.witness_b.shape == result.normal.shape == (0, 3)


@pytest.mark.parametrize(
    "array",
    [
        CUBE.astype(np.float32),
        (CUBE * 2).astype(int) * 1,
        (CUBE * 2).astype(np.int8),
        CUBE.tolist(),
        np.asfortranarray(CUBE),
        np.repeat(CUBE, 2, axis=0)[::2],
        np.concatenate([CUBE, CUBE], axis=1)[:, 3:],
        CUBE[::-1],
    ],
    ids=["float32", "int", "int8", "list", "Fortran order", "strided rows", "strided columns", "reversed"],
)
def test_any_array_of_numbers_will_do(array: object):
    """The kind of array changes nothing: same piece, same answers."""
    body = Body.from_points(array)
    half = float(np.abs(np.asarray(array)).max())
    assert body.inner.semi_axes[0] == pytest.approx([half] * 3, rel=1e-3)
    T = translation(2 * half + 0.01)
    for made in (T, T.tolist(), np.asfortranarray(T), np.stack([T, T])[::-1][0], T.astype(np.float32)):
        assert not loewner.collide(body, made, body, None)


def test_read_only_input_is_accepted_and_unchanged():
    """Read-only points and poses are accepted, and a query leaves its input as it was."""
    P, T = CUBE.copy(), np.eye(4)
    P.setflags(write=False)
    T.setflags(write=False)
    body = Body.from_points(P)
    assert loewner.collide(body, T, body, T)
    assert np.array_equal(P, CUBE)
    assert np.array_equal(T, np.eye(4))


def test_a_failed_construction_changes_nothing():
    """An error in the middle of a batch leaves the bodies made before it as they were."""
    good = Bodies.from_points([CUBE, CUBE])
    before = good.outer.factor.copy()
    with pytest.raises(LoewnerError):
        Bodies.from_points([CUBE, with_entry(np.nan)])
    with pytest.raises(PoseError):
        loewner.classify(good, None, good, np.zeros((4, 4)))
    assert np.array_equal(good.outer.factor, before)


def test_every_error_is_a_loewner_error():
    """One except clause catches them all, and the usual built-in ones work too."""
    for error, builtin in [
        (InputError, ValueError),
        (GeometryError, ValueError),
        (PoseError, ValueError),
        (FileError, OSError),
        (UnknownNameError, KeyError),
        (loewner.MissingExtraError, ImportError),
        (loewner.ConvergenceError, ArithmeticError),
    ]:
        assert issubclass(error, LoewnerError)
        assert issubclass(error, builtin)


def test_bodies_whose_constructor_was_left_out_are_refused() -> None:
    """A body without content is an InputError in every query; a class, its copies and its pickles are as ever."""
    ball = Body.sphere(1.0)
    for kind in (Body, Bodies):
        empty = kind.__new__(kind)
        for call in (
            lambda empty=empty: loewner.collide(empty, None, ball, None),
            lambda empty=empty: loewner.classify(ball, None, empty, None),
            lambda empty=empty: loewner.distance(empty, None, ball, None),
            lambda empty=empty: loewner.overlapping_pairs(empty),
            lambda empty=empty: empty.pieces,
        ):
            with pytest.raises(InputError, match=f"expected a {kind.__name__} made by its constructors"):
                call()
    assert loewner.collide(copy.copy(ball), None, pickle.loads(pickle.dumps(ball)), None)
