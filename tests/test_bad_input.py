"""Bad input gets a clear error that is a LoewnerError, never an answer, a crash or half a file."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import box_corners, pieces
from loewner import (
    Bodies,
    Body,
    FileError,
    GeometryError,
    InputError,
    LoewnerError,
    PoseError,
    UnknownNameError,
    _check,
)

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
    points, error = POINTS[what]
    makers: list[Callable[[object], object]] = [Body.from_points, lambda P: Body.from_pieces([P])]
    if not isinstance(points, np.ndarray) or points.ndim == 2:
        makers.append(lambda P: Bodies.from_points([CUBE, P]))
    for make in makers:
        with pytest.raises(error) as caught:
            make(points)
        assert isinstance(caught.value, ValueError)
        assert len(str(caught.value)) > 15


def test_the_bad_one_of_many_is_named():
    """In a list of bodies the message says which one."""
    with pytest.raises(GeometryError, match="2"):
        Bodies.from_points([CUBE, CUBE, CUBE * [1, 1, 0]])


def test_bad_half_spaces():
    box = np.concatenate([np.eye(3), -np.eye(3)])
    for A, b in [
        (np.eye(3), np.ones(3)),  # unbounded
        (box[:5], np.ones(5)),  # unbounded
        (box, np.array([1, 1, 1, -2, 1, 1])),  # empty
        (box, np.array([1, 1, 1, -1, 1, 1])),  # flat
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
    ]:
        for make in (loewner.Polytope.from_halfspaces, loewner.mvie):
            with pytest.raises(InputError):
                make(A, b)


# -- primitives ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), "one", None])
def test_bad_sizes(bad: object):
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
    for make in (
        lambda: Body.box([1, 1]),
        lambda: Body.box(1),
        lambda: Body.ellipsoid([1, 1, 1, 1]),
        lambda: Body.sphere([1, 1]),
    ):
        with pytest.raises(InputError):
            make()


def test_bad_tolerance():
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
    a, b = Body.box([1, 1, 1]), Body.sphere(1)
    query = getattr(loewner, ask)
    for arguments in ((a, POSES[what], b, None), (a, None, b, POSES[what])):
        with pytest.raises(PoseError):
            query(*arguments)
    with pytest.raises(PoseError):
        a.transformed(POSES[what])


def test_poses_that_do_not_broadcast():
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
    a = Body.sphere(1)
    for query in (loewner.classify, loewner.collide):
        for arguments in ((a, None, a, None), (a, np.tile(np.eye(4), (3, 1, 1)), a, None)):
            with pytest.raises(InputError, match="margin: expected a"):
                query(*arguments, margin=margin)
    with pytest.raises(InputError, match="margin: expected a"):
        loewner.overlapping_pairs(Bodies([a, a]), margin=margin)


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
    many = Bodies([Body.box([1, 1, 1])] * 8)
    with pytest.raises(PoseError, match="8 bodies, found 7"):
        loewner.overlapping_pairs(many, row_of_poses(7))


@pytest.mark.parametrize("query", PAIRWISE)
def test_empty_batches_come_back_empty(query: str):
    a, none = Body.box([1, 1, 1]), np.empty((0, 4, 4))
    nobody = Bodies([a])[:0]
    for arguments in ((a, none, a, None), (a, None, a, none), (a, none, a, none), (nobody, None, a, None)):
        assert ask(query, *arguments).shape == (0,)
    assert ask(query, a, np.empty((3, 0, 4, 4)), a, None).shape == (3, 0)
    assert ask(query, nobody, np.tile(np.eye(4), (3, 1, 1, 1)), a, None).shape == (3, 0)


def test_an_empty_crowd_has_no_pairs():
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
    monkeypatch.setattr(_check, "physical_memory", lambda: 2**30)
    across, down = row_of_poses(40_000), row_of_poses(40_000)[:, None]
    with pytest.raises(InputError, match=r"memory \(1 GiB\), found \(40000, 40000\) pairs, which need [0-9.]+ GiB"):
        ask(query, a, across, a, down)


@pytest.mark.parametrize("exact", [False, True])
def test_distances_take_more_memory_than_verdicts(exact: bool, monkeypatch: pytest.MonkeyPatch):
    """A batch of as many distances as bytes: each takes more than one, and is counted so."""
    a, T = Body.sphere(1), row_of_poses(1000)
    monkeypatch.setattr(_check, "physical_memory", lambda: 1000)
    assert loewner.classify(a, T, a, None).shape == (1000,)
    with pytest.raises(InputError, match="fit into memory"):
        loewner.distance(a, T, a, None, exact=exact)


def test_a_crowd_with_more_pairs_than_memory_is_refused(monkeypatch: pytest.MonkeyPatch):
    """All of them in one place: 500,000 pairs, told as soon as they become too many."""
    T = np.tile(np.eye(4), (1000, 1, 1))
    monkeypatch.setattr(_check, "physical_memory", lambda: 2**20)
    with pytest.raises(InputError, match="pairs of 1000 bodies"):
        loewner.overlapping_pairs(Body.sphere(1), T)


def test_unknown_names_list_the_known():
    a = Body.sphere(1)
    with pytest.raises(UnknownNameError, match="exact"):
        loewner.collide(a, None, a, None, method="exakt")
    with pytest.raises(UnknownNameError, match="rimon-boyd"):
        loewner.collide(a, None, a, None, method="estimate", rule="rimon")
    with pytest.raises(UnknownNameError, match="rimon-boyd"):
        loewner.distance(a, None, a, None, rule="")
    with pytest.raises(UnknownNameError, match="rimon-boyd"):
        loewner.distance(a, None, a, None, rule=["rimon-boyd"])
    with pytest.raises(InputError, match="direct"):
        loewner.mvce(CUBE, method="fast")


def test_things_that_are_no_bodies():
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


def test_no_flipped_bit_gives_another_body(tmp_path: Path):
    """Any byte of a body file changed: an error, or the very same body (padding); never a different one."""
    body = Body.from_points(pieces("ball 20", 1)[0])
    path = tmp_path / "good.npz"
    body.save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for k in rng.choice(len(whole), size=150, replace=False):
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
    pytest.importorskip("trimesh")
    path = write(tmp_path / "flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with pytest.raises(LoewnerError):
        Body.from_mesh(path, decompose=False)


class Unfit(os.PathLike[str]):
    """A path-like object that is none."""

    def __fspath__(self) -> str:
        raise RuntimeError("no path today")


@pytest.mark.parametrize("bad", [None, 3, b"part.stl", "", "a\0b", "\ud800", [], Unfit(), CUBE], ids=repr)
def test_what_is_no_path(bad: object):
    """A path is text that the file system can hold; anything else is an InputError that names the argument."""
    with pytest.raises(InputError, match="file: expected the path of a file, found "):
        _check.path(bad, "file")


@pytest.mark.parametrize("good", ["a", "a b/ü", os.fsdecode(b"not\xffutf-8"), Path("a/b"), np.str_("a")], ids=ascii)
def test_what_is_a_path(good: os.PathLike[str]):
    """Also names that are not UTF-8, as `os.listdir` gives them."""
    assert _check.path(good, "file") == Path(good)


# -- what is not bad ------------------------------------------------------------------------------------------


def test_empty_batches_have_the_usual_types():
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
    T = np.eye(4)
    T[0, 3] = 2 * half + 0.01
    for made in (T, T.tolist(), np.asfortranarray(T), np.stack([T, T])[::-1][0], T.astype(np.float32)):
        assert not loewner.collide(body, made, body, None)


def test_read_only_input_is_accepted_and_unchanged():
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
