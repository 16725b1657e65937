"""Body files are data: whatever is in one, it is refused, or it is bodies that keep every law and can be asked.

Forgeries start from files that `save` wrote. Any array, any field, the digest (made valid again: it has no key), the
members of the archive and its raw bytes are changed. What is accepted is judged by an oracle that shares no code with
the reader: Qhull and supports along many directions.
"""

import hashlib
import io
import os
import re
import time
import tracemalloc
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

import driver
import loewner
from families import CUT_FROM_A_MUG, FAMILIES, near_corners, pieces, prism, random_poses
from loewner import Bodies, Body
from loewner._base import _archives
from loewner.bodies import CURVED as CURVED_KINDS
from loewner.bodies import files
from loewner.meshes.protrusion import Solid
from sampling import quick

Arrays = dict[str, Any]

# Relative; the reader's tests allow some 1e-9, and digits that a thin piece lacks.
TOLERANCE = 1e-6

INDICES = ("layout", "piece_start", "triangles", "triangle_start")


def _bases() -> dict[str, Bodies]:
    rng = np.random.default_rng(0)
    primitives = [Body.sphere(0.5), Body.ellipsoid([3, 2, 1]), Body.cylinder(0.5, 2), Body.cone(1, 2)]
    primitives += [Body.capsule(0.3, 1), Body.box([1, 2, 3])]
    sphere = rng.normal(size=(150, 3))
    return {
        "polytope": Bodies([Body.from_points(pieces("ball 20", 1)[0])]),
        "polytopes": Bodies.from_points(pieces("boxes", 2) + pieces("slivers", 2) + pieces("needles 1:1e-3:1e-3", 2)),
        "pieces": Bodies([Body.from_pieces(pieces("ball 8", 9)), Body.from_pieces(pieces("boxes", 3))]),
        "curved": Bodies(primitives),
        "moved": Bodies([b.transformed(T) for b, T in zip(primitives, random_poses(rng, 6), strict=True)]),
        "mixed": Bodies([Body.union([Body.sphere(1), Body.box([1, 1, 1])]), Body.cone(1, 2)]),
        "surfaces": Bodies(_surfaces(rng)),
        "near corners": Bodies.from_points([CUT_FROM_A_MUG, *near_corners(4)]),
        "mapped": Bodies.from_points([sphere / np.linalg.norm(sphere, axis=1, keepdims=True)]),
    }


def _surfaces(rng: np.random.Generator) -> list[Body]:
    """Solids and skins, with a radius and without, flat ones, and some among other pieces."""
    box, ring = trimesh.creation.box((1, 2, 3)), trimesh.creation.torus(1.0, 0.3, 8, 5)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]], process=False)
    made = [Body.from_surface(box), Body.from_surface(ring, solid=False, radius=0.1), Body.from_surface(flat)]
    made += [Body.from_surface(flat, radius=0.02), Body.from_surface(box, radius=1e-9)]
    cube = Body.box([1, 1, 1])
    made += [Body.union([cube, made[0], Body.cone(1, 2), made[3], Body.from_points(pieces("ball 20", 1)[0])])]
    return [*made, *(body.transformed(T) for body, T in zip(made, random_poses(rng, 6), strict=True))]


def stored(save: Callable[[Path], None], folder: Path) -> Arrays:
    """The arrays of what `save` writes."""
    path = folder / "stored.npz"
    save(path)
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def digest(arrays: Arrays) -> str:
    """The checksum, as documented: SHA-256 over name, type, shape and bytes of each array by name."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        if name not in ("format", "version", "digest"):
            array = np.ascontiguousarray(arrays[name])
            total.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return total.hexdigest()


def packed(arrays: Arrays, *, compress: bool = False) -> bytes:
    """An archive of these arrays, its digest valid unless they bring one."""
    stream = io.BytesIO()
    content = {"digest": digest(arrays)} | arrays if "digest" not in arrays else arrays
    (np.savez_compressed if compress else np.savez)(stream, **content)
    return stream.getvalue()


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Arrays]:
    """What `save` writes of all kinds of bodies, without the digest; queries compiled for them."""
    folder = tmp_path_factory.mktemp("bases")
    made = {}
    for name, bodies in _bases().items():
        made[name] = stored(bodies.save, folder)
        assert ask(bodies, folder) is None
    covering = loewner.Covering("decomposition", False, 1e-3, 0.25, 1234, 0.002)
    made["covered"] = stored(Body(Body.box([1, 2, 3])._packed, covering).save, folder)
    for arrays in made.values():
        assert arrays.pop("digest") == digest(arrays)
    return made


# -- the oracle ---------------------------------------------------------------------------------


def judged(bodies: Bodies) -> str | None:
    """Say which law bodies break: inner in piece in outer, faces of the piece, sane certificates."""
    if bodies.piece_start[-1] != len(bodies.pieces) or (np.diff(bodies.piece_start) < 1).any():
        return "pieces belong to no body"
    frames = bodies._packed.frames
    for i, piece in enumerate(bodies.pieces):
        if piece.kind in ("surface", "solid"):
            said = _surface(piece, frames[i])
        else:
            said = _polytope(piece) if piece.kind == "polytope" else _curved(piece, frames[i])
        if said is None and not (np.isfinite([piece.inner_gap, piece.outer_gap]).all() and piece.inner_gap > -1e-6):
            said = "gap"
        if said is not None:
            return f"piece {i} ({piece.kind}): {said}"
    return None


def _aspect(ellipsoid: Any) -> float:
    return float(np.linalg.cond(np.atleast_3d(ellipsoid.factor).reshape(3, 3)))


def _polytope(piece: Any) -> str | None:
    V, center, F = piece.vertices, piece.inner.center.reshape(3), piece.inner.factor.reshape(3, 3)
    outer_center, G = piece.outer.center.reshape(3), piece.outer.factor.reshape(3, 3)
    doubt = TOLERANCE + 1e-12 * max(_aspect(piece.inner), _aspect(piece.outer))
    if np.linalg.norm(np.linalg.solve(G, (V - outer_center).T), axis=0).max() > 1 + doubt:
        return "a vertex outside the outer ellipsoid"
    # Seen from the inner ellipsoid, where it is the unit ball and the piece is as round as it gets.
    hull = ConvexHull(np.linalg.solve(F, (V - center).T).T)
    if hull.equations[:, 3].max() > -1 + doubt:
        return "the inner ellipsoid sticks out"
    if piece.triangles.min() < 0 or piece.triangles.max() >= len(V):
        return "triangles of vertices that are none"
    if np.abs(np.linalg.norm(piece.normals, axis=1) - 1).max() > TOLERANCE:
        return "normals not of unit length"
    off = (piece.normals @ V.T).max(axis=1) - piece.offsets
    return "planes off the piece" if np.abs(off).max() > TOLERANCE * np.abs(V).max() else None


def _surface(piece: Any, frame: np.ndarray) -> str | None:
    """Supports along many directions; edges counted."""
    V, radius, G = piece.vertices, frame[0], piece.outer.factor.reshape(3, 3)
    if not radius >= 0 or frame[1:].any():
        return "no radius"
    if piece.triangles.min() < 0 or piece.triangles.max() >= len(V):
        return "triangles of vertices that are none"
    ways = np.concatenate([SPREAD / np.linalg.norm(SPREAD, axis=1, keepdims=True), np.linalg.svd(G)[0].T])
    ways = np.concatenate([ways, -ways])
    past = (ways @ (V - piece.outer.center.reshape(3)).T).max(axis=1) + radius - np.linalg.norm(ways @ G, axis=1)
    if past.max() > 0.06 * np.linalg.norm(G, 2) * (TOLERANCE + 1e-10 * _aspect(piece.outer)) + 1e-6 * radius:
        return "outside the outer ellipsoid"
    if piece.kind == "solid":
        # Points of the inner ellipsoid lie in the solid, by another module's distances and winding numbers.
        ball = SPREAD / np.linalg.norm(SPREAD, axis=1, keepdims=True)
        points = piece.inner.center.reshape(3) + ball @ piece.inner.factor.reshape(3, 3).T
        outside = Solid(V[piece.triangles], closed=True).signed_distances(points)[0].max()
        return "the inner ellipsoid sticks out" if outside > radius + TOLERANCE * np.abs(V).max() else None
    off = np.linalg.norm(V - piece.inner.center.reshape(3), axis=1).min()
    if off + np.linalg.norm(piece.inner.factor.reshape(3, 3), 2) > radius + TOLERANCE * np.abs(V).max():
        return "the inner ellipsoid sticks out"
    if piece.kind == "solid":
        points, edges = np.unique(V, axis=0, return_inverse=True)[1].reshape(-1)[piece.triangles], Counter()
        for a, b in np.concatenate([points[:, [0, 1]], points[:, [1, 2]], points[:, [2, 0]]]).tolist():
            edges[a, b] += 1
            edges[b, a] -= 1
        if any(edges.values()):
            return "open"
    return None


SPREAD = np.random.default_rng(1).normal(size=(4000, 3))


def _curved(piece: Any, frame: np.ndarray) -> str | None:
    """Supports along many directions, seen from the piece's own axes."""
    radius, at, G = frame[0], frame[1:4], frame[4:].reshape(3, 3)
    if not np.isfinite(frame).all() or radius < 0 or np.linalg.matrix_rank(G) < 3:
        return "no frame"
    n = np.concatenate([np.eye(3), -np.eye(3), SPREAD]) @ np.linalg.inv(G)
    local = n @ G
    flat = np.linalg.norm(local[:, :2], axis=1)
    height = {
        "sphere": 0.0 * flat,
        "ellipsoid": np.linalg.norm(local, axis=1),
        "cylinder": flat + np.abs(local[:, 2]),
        "cone": np.maximum(local[:, 2], flat - local[:, 2]),
        "capsule": np.abs(local[:, 2]),
    }[piece.kind] + radius * np.linalg.norm(n, axis=1)
    # Heights above the frame's origin; no point of the shapes is farther from it than from any point inside.
    for side, sign in (("inner", 1), ("outer", -1)):
        E = getattr(piece, side)
        reach = n @ (E.center.reshape(3) - at) + np.linalg.norm(n @ E.factor.reshape(3, 3), axis=1)
        scale = np.abs(height).max() if piece.kind != "cone" else np.abs(height) + flat + np.abs(local[:, 2])
        doubt = (2e-5 if radius else TOLERANCE) + 1e-12 * np.linalg.cond(G)
        if (sign * (reach - height) > doubt * scale).any():
            return f"{side} ellipsoid on the wrong side by {np.max(sign * (reach - height) / scale):.3g}"
        if np.linalg.matrix_rank(E.factor.reshape(3, 3)) < 3:
            return f"{side} ellipsoid is flat"
    return None


POSES = random_poses(np.random.default_rng(2), 4, 0.8)


def ask(bodies: Bodies, folder: Path) -> str | None:
    """Every kind of query; what the answers are is for other tests, but bounds must hold the distance."""
    other = Body.box([1, 0.5, 0.5])
    n = len(bodies)
    if n == 0:
        return None
    T = POSES[:, None]
    verdict = loewner.classify(bodies, T, other, None)
    hit = loewner.collide(bodies, T, other, None)
    loewner.collide(bodies, T, other, None, method="estimate")
    found = loewner.distance(bodies, T, other, None, exact=True)
    loewner.overlapping_pairs(bodies, np.tile(np.eye(4), (n, 1, 1)))
    bodies.save(folder / "again.npz")
    again = Bodies.load(folder / "again.npz")
    if len(again[::-1]) != n or len(bodies[0].pieces) < 1:
        return "another number of bodies"
    if (verdict == loewner.Verdict.FREE)[hit].any() or (verdict == loewner.Verdict.COLLIDING)[~hit].any():
        return "verdicts disagree"
    return None if np.isfinite(found.distance).all() else f"distance {found.distance.min()}"


# -- forgeries ----------------------------------------------------------------------------------

NUMBERS = [0.0, -1.0, 1.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-320, 1e31, 1e150, 2.0**-60]
COUNTS = [0, -1, 1, 2, 3, 4, 5, 10**6, -(10**6), 2**31, 2**40, 2**62, 2**63 - 1, -(2**63)]
TYPES = ["<f4", "<f8", ">f8", "<i4", "<i8", ">i8", "<u8", "<c16", "?", "<U8", "S8", "<M8[s]", "<f2", "V8"]


def _cell(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    flat = arrays[name].reshape(-1)
    if flat.size == 0:
        return
    at = rng.integers(flat.size)
    if name in INDICES:
        flat[at] = rng.choice([*COUNTS, int(flat[at]) + 1, int(flat[at]) - 1, int(flat[rng.integers(flat.size)])])
    else:
        small = 1 + 10.0 ** rng.uniform(-6, 0) * rng.choice([-1, 1])
        flat[at] = rng.choice([*NUMBERS, -flat[at], flat[at] * small, flat[rng.integers(flat.size)]])


def _all(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    array = arrays[name]
    change = rng.integers(8)
    if change == 0:
        arrays[name] = np.full_like(array, rng.choice(COUNTS if name in INDICES else NUMBERS))
    elif change == 1 and name not in INDICES:
        arrays[name] = array * (1 + 10.0 ** rng.uniform(-5, 0) * rng.choice([-1, 1]))
    elif change == 2:
        arrays[name] = -array
    elif change == 3:
        arrays[name] = rng.permutation(array, axis=int(rng.integers(array.ndim)))
    elif change == 4 and array.ndim > 1:
        arrays[name] = np.flip(array, axis=1).copy()
    elif change == 5 and array.ndim == 3:
        arrays[name] = array.transpose(0, 2, 1).copy()
    elif change == 6:
        arrays[name] = array + rng.choice([1, -1, 2**20])
    elif name not in INDICES:
        arrays[name] = rng.normal(size=array.shape) * 10.0 ** rng.uniform(-40, 40)


def _shape(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    array, change = arrays[name], rng.integers(8)
    if change == 0:
        arrays[name] = array[:-1]
    elif change == 1:
        arrays[name] = np.concatenate([array, array[-1:]])
    elif change == 2:
        arrays[name] = array.reshape(-1)
    elif change == 3:
        arrays[name] = array[None]
    elif change == 4:
        arrays[name] = array[:0]
    elif change == 5:
        arrays[name] = array.T
    elif change == 6:
        arrays[name] = np.asfortranarray(array)
    else:
        arrays[name] = array.reshape(-1)[:1].reshape(()) if array.size else np.array(0)


def _type(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    with np.errstate(all="ignore"):
        try:
            arrays[name] = arrays[name].astype(rng.choice(TYPES))
        except (TypeError, ValueError):
            arrays[name] = arrays[name].astype("<U8")


def _member(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    change = rng.integers(3)
    if change == 0:
        del arrays[name]
    elif change == 1:
        arrays[rng.choice(["more", "points2", "../points", "maps", "covering"])] = arrays[name]
    else:
        other = rng.choice(files.ARRAYS)
        arrays[name], arrays[other] = arrays[other], arrays[name]


def _field(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    which = rng.integers(4)
    if which == 0:
        versions = [1.5, True, [1], 2, -1, "1", 10**18, np.nan, 0, 1 + 0j, np.uint8(1), np.int16(1), [[1]], 2**63]
        arrays["version"] = np.array(versions[rng.integers(len(versions))])
    elif which == 1:
        formats: list[Any] = [["loewner-bodies"], "loewner-bodies ", 3, b"loewner-bodies", "", "other"]
        arrays["format"] = np.array(formats[rng.integers(len(formats))])
    elif which == 2:
        digests: list[Any] = ["", "0" * 64, 3, [digest(arrays)], digest(arrays).upper(), None]
        arrays["digest"] = np.array(digests[rng.integers(len(digests))])
    else:
        values: list[Any] = ["hull", "True", "0.0", "nan", "8"]
        bad = ["", "None", "-1", "inf", "-inf", "nan", "1e999", "1" * 5000, "8.5", "True", "\x00", "0x10", "é", " 1"]
        for _ in range(rng.integers(1, 3)):
            values[rng.integers(5)] = bad[rng.integers(len(bad))]
        if rng.uniform() < 0.2:
            values = values[: rng.integers(5)]
        arrays["covering"] = np.array(values) if rng.uniform() < 0.9 else np.arange(5.0)


def _consistent(rng: np.random.Generator, arrays: Arrays, name: str) -> None:
    """Changes that leave all shapes and indices in order: only geometry can tell."""
    change = rng.integers(8)
    row = rng.integers(len(arrays["layout"]))
    by = 1 + 10.0 ** rng.uniform(-5, 1) * rng.choice([-1, 1])
    if change == 0:
        arrays[rng.choice(["inner_factor", "outer_factor"])][row] *= by
    elif change == 1:
        axis = rng.integers(3)
        arrays[rng.choice(["inner_factor", "outer_factor"])][row][:, axis] *= by
    elif change == 2:
        arrays[rng.choice(["inner_center", "outer_center"])][row] += rng.normal(size=3) * 10.0 ** rng.uniform(-5, 1)
    elif change == 3:
        first, last = arrays["layout"][row, 1:3]
        if last > first:
            arrays["points"][rng.integers(first, last)] *= by
        else:
            arrays["frames"][row, rng.integers(13)] *= by
    elif change == 4:
        arrays["layout"][row, 0] = rng.integers(-4, 7)
    elif change == 5 and len(arrays["triangles"]):
        t = rng.integers(len(arrays["triangles"]))
        arrays["triangles"][t] = rng.permutation(arrays["triangles"][t]) if by > 1 else arrays["triangles"][t - 1]
    elif change == 6 and len(arrays["triangles"]):
        # One triangle fewer, all starts in order.
        t = rng.integers(len(arrays["triangles"]))
        arrays["triangles"] = np.delete(arrays["triangles"], t, axis=0)
        arrays["triangle_start"] = arrays["triangle_start"] - (arrays["triangle_start"] > t)
    else:
        rotation = random_poses(rng, 1)[0, :3, :3]
        target = rng.choice(["inner_factor", "outer_factor", "frames"])
        if target == "frames":
            arrays["frames"][row, 4:] = (rotation @ arrays["frames"][row, 4:].reshape(3, 3)).ravel()
        else:
            arrays[target][row] = rotation @ arrays[target][row]


FORGERIES = [_cell, _cell, _cell, _all, _all, _shape, _type, _member, _field, _consistent, _consistent, _consistent]


def forged(bases: dict[str, Arrays], seed: int) -> bytes:
    """One forgery: a file whose arrays are changed once or twice, or the bytes of one."""
    rng = np.random.default_rng([12, seed])
    arrays = {k: v.copy() for k, v in bases[rng.choice(list(bases))].items()}
    if rng.uniform() < 0.2:
        return _bytes(rng, packed(arrays, compress=rng.uniform() < 0.5))
    # Each array meets each kind of change in turn; a quarter of them are changed once more.
    name, change = files.ARRAYS[seed % len(files.ARRAYS)], FORGERIES[seed // len(files.ARRAYS) % len(FORGERIES)]
    change(rng, arrays, name)
    if rng.uniform() < 0.25:
        here = [name for name in files.ARRAYS if name in arrays]
        with suppress(LookupError, ValueError, TypeError):  # it no longer has the shape that this change expects
            FORGERIES[rng.integers(len(FORGERIES))](rng, arrays, here[rng.integers(len(here))])
    return packed(arrays)


def _bytes(rng: np.random.Generator, whole: bytes) -> bytes:
    """Bytes changed, cut out, doubled, or the words of the archive's directory and headers replaced."""
    data = bytearray(whole)
    change = rng.integers(5)
    if change == 0:
        for _ in range(rng.integers(1, 8)):
            data[rng.integers(len(data))] = rng.integers(256)
    elif change == 1:
        at, length = rng.integers(len(data)), rng.integers(1, 200)
        del data[at : at + length]
    elif change == 2:
        at, length = rng.integers(len(data)), rng.integers(1, 200)
        data[at:at] = data[at : at + length]
    elif change == 3:
        del data[rng.integers(len(data)) :]
    else:
        # A word of a local header, of an entry of the directory or of its end.
        mark = [b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"][rng.integers(3)]
        places = [at for at in range(len(data) - 4) if data[at : at + 4] == mark]
        at = places[rng.integers(len(places))] + int(rng.integers(4, 22 if mark[2] == 5 else 46))
        data[at : at + 4] = rng.choice([0, 1, 8, 12, 99, 0xFFFF, 2**31, 2**32 - 1]).astype("<u4").tobytes()
    return bytes(data)


def _run(bases: dict[str, Arrays], cases: range, folder: Path) -> list[driver.Outcome]:
    def task(seed: int) -> str | None:
        path = folder / "forged.npz"
        path.write_bytes(forged(bases, seed))
        try:
            bodies = Bodies.load(path)
        except loewner.FileError:
            raise
        except loewner.LoewnerError as error:
            return f"refused, but not as a file: {error!r}"
        if len(bodies) == 1:
            Body.load(path)
        try:
            return judged(bodies) or ask(bodies, folder)
        except loewner.LoewnerError as error:
            return f"accepted, then: {error!r}"

    return driver.run(task, cases)


@pytest.mark.parametrize("count", quick(25, 150))
def test_forged_archives(bases: dict[str, Arrays], tmp_path: Path, count: int) -> None:
    """A forged file is refused as a file, or it is bodies that keep every law and answer every query."""
    outcomes = _run(bases, range(count), tmp_path)
    assert not driver.faults(outcomes), driver.faults(outcomes)


@pytest.mark.fuzz
def test_many_forged_archives(bases: dict[str, Arrays], tmp_path: Path) -> None:
    """The same, more of them."""
    cases = range(1000, 1000 + int(os.environ.get("LOEWNER_FORGERIES", "3000")))
    begin = time.perf_counter()
    outcomes = _run(bases, cases, tmp_path)
    counts = Counter(outcome.kind for outcome in outcomes)
    print(f"\narchives: {len(cases)} forged, {dict(counts)}, {time.perf_counter() - begin:.0f} s")
    assert not driver.faults(outcomes), driver.faults(outcomes)


# -- by name ------------------------------------------------------------------------------------


def _set(name: str, value: Any) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.update({name: np.array(value)})


def _put(name: str, at: Any, value: Any) -> Callable[[Arrays], None]:
    return lambda arrays: arrays[name].__setitem__(at, value)


def _scale(name: str, by: float) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.update({name: arrays[name] * by})


def _without_a_triangle(arrays: Arrays) -> None:
    arrays["triangles"] = arrays["triangles"][1:]
    arrays["triangle_start"] = arrays["triangle_start"] - (arrays["triangle_start"] > 0)


def _turned(arrays: Arrays) -> None:
    arrays["triangles"] = arrays["triangles"][:, ::-1]


# Forgeries of a box of edges 1, 2 and 3. Those of the first block crashed, raised raw errors or were accepted.
REFUSED = {
    "a million pieces": (_set("piece_start", [0, 10**6]), "piece_start"),
    "pieces from before the first": (_set("piece_start", [-(10**6), 1]), "piece_start"),
    "no start": (_set("piece_start", np.zeros(0, dtype=np.int64)), "piece_start"),
    "points that are NaN": (_put("points", (0, 0), np.nan), "points: expected finite"),
    "kind -1": (_put("layout", (0, 0), -1), "layout: expected kinds"),
    "kind -4": (_put("layout", (0, 0), -4), "layout: expected kinds"),
    "a polytope called a surface": (_put("layout", (0, 0), -2), "layout: expected no planes of a surface"),
    "no kind": (_put("layout", (0, 0), max(CURVED_KINDS) + 1), "layout: expected kinds"),
    "points from -1": (_put("layout", (0, 1), -1), "layout, points"),
    "points to 10**12": (_put("layout", (0, 2), 10**12), "layout, points"),
    "planes from the end": (_put("layout", (0, 3), 6), "layout, planes"),
    "triangles of other points": (_put("triangles", (0, 0), 8), "triangles"),
    "negative triangles": (_put("triangles", (0, 0), -1), "triangles"),
    "version 1.5": (_set("version", 1.5), "format version 2 or older"),
    "two versions": (_set("version", [1, 1]), "format version 2 or older"),
    "version 0": (_set("version", 0), "format version 2 or older"),
    "version 3": (_set("version", 3), "newer loewner"),
    "a flat layout": (lambda a: a.update(layout=a["layout"].ravel()), "layout: expected shape"),
    "four frames": (lambda a: a.update(frames=np.zeros((4, 13))), "frames: expected shape"),
    "covering of three": (_set("covering", ["hull", "True", "0"]), "covering: expected six"),
    "covering of no kind": (_set("covering", ["covers", "True", "0.0", "nan", "8"]), "covering: expected a kind"),
    "covering without a number": (_set("covering", ["hull", "True", "x", "nan", "8"]), "covering: expected numbers"),
    "negative covering": (_set("covering", ["hull", "True", "-1.0", "nan", "8"]), "covering: expected a length"),
    "covering of numbers": (_set("covering", np.arange(5)), "covering.npy: expected short text"),
    "objects": (lambda a: a.update(points=a["points"].astype(object)), "points.npy"),
    "single precision": (lambda a: a.update(points=a["points"].astype(np.float32)), "points: expected float64"),
    "unsigned": (lambda a: a.update(layout=a["layout"].astype(np.uint64)), "layout: expected int64"),
    "another array": (_set("maps", [1.0]), "maps"),
    # A digest that fits does not make them bodies:
    "a smaller outer ellipsoid": (_scale("outer_factor", 1 - 1e-6), "outer ellipsoid"),
    "a larger inner ellipsoid": (_scale("inner_factor", 1 + 1e-6), "inner ellipsoid"),
    "a flat inner ellipsoid": (_scale("inner_factor", [[[1], [1], [0]]]), "inner_factor"),
    "a shifted inner ellipsoid": (_put("inner_center", (0, 0), 1e-5), "inner ellipsoid"),
    "planes farther out": (_put("planes", (0, 3), 3.0), "planes: expected each to touch"),
    "planes of other lengths": (_scale("planes", 2.0), "planes: expected unit"),
    "an open surface": (_without_a_triangle, "triangles: expected a closed"),
    "a surface inside out": (_turned, "inner ellipsoid|triangles"),
    "a frame of a polytope": (_put("frames", (0, 0), 1.0), "frames: expected zeros"),
    "negative gaps": (_scale("gaps", -1e9), "gaps"),
    "huge numbers": (_scale("points", 1e200), "points: expected finite numbers below"),
}


@pytest.fixture(scope="module")
def stored_box(tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    """What is stored of a box; no test changes it."""
    arrays = stored(Body.box([1, 2, 3]).save, tmp_path_factory.mktemp("box"))
    del arrays["digest"]
    return arrays


@pytest.fixture
def box(stored_box: Arrays) -> Arrays:
    """The same, to be changed."""
    return {name: array.copy() for name, array in stored_box.items()}


@pytest.fixture(scope="module")
def loaded(stored_box: Arrays, tmp_path_factory: pytest.TempPathFactory) -> dict[str, driver.Outcome]:
    """Outcomes of loading all of these files, by name."""
    paths = []
    for change, _ in REFUSED.values():
        arrays = {name: array.copy() for name, array in stored_box.items()}
        change(arrays)
        paths.append(tmp_path_factory.mktemp("refused") / "forged.npz")
        paths[-1].write_bytes(packed(arrays))
    return dict(zip(REFUSED, driver.run(lambda path: Body.load(path) and None, paths), strict=True))


@pytest.mark.parametrize("name", REFUSED)
def test_refused_by_name(name: str, loaded: dict[str, driver.Outcome]) -> None:
    """Each of these is refused, in another process, and the message names array and fault."""
    _, message = REFUSED[name]
    outcome = loaded[name]
    assert outcome.kind == driver.REFUSED, outcome
    assert re.search(rf"FileError: .*forged\.npz: .*({message})", outcome.text), outcome.text


CURVED = {
    "sphere": Body.sphere(0.5),
    "capsule": Body.capsule(0.3, 1),
    "cylinder": Body.cylinder(0.5, 2),
    "cone": Body.cone(1, 2),
    "ellipsoid": Body.ellipsoid([3, 2, 1]),
}


@pytest.mark.parametrize("kind", CURVED)
def test_curved_pieces_keep_their_closed_forms(kind: str, tmp_path: Path) -> None:
    """No radius, axis or ellipsoid of a curved piece can be changed to the side that would make verdicts wrong."""
    plain = stored(CURVED[kind].save, tmp_path)
    del plain["digest"]
    changes = {
        "outer": _scale("outer_factor", 1 - 1e-4),
        "inner": _scale("inner_factor", 1 + 1e-4),
        "both moved": lambda a: (_put("outer_center", (0, 2), 0.3)(a), _put("inner_center", (0, 2), 0.3)(a)),
        "center": _put("frames", (0, 1), 1e-2),
        "frame": _scale("frames", 1.01),
        "smaller frame": _scale("frames", 0.99),
        "left-handed": lambda a: a["frames"][:, 4:7].__imul__(-1),
        "no frame": _scale("frames", 0.0),
        "radius": lambda a: a["frames"][:, 0].__iadd__(0.01),
        "another kind": lambda a: a["layout"][:, 0].__iadd__(1 if kind != "sphere" else -1),
    }
    for change in changes.values():
        arrays = {name: array.copy() for name, array in plain.items()}
        change(arrays)
        (tmp_path / "forged.npz").write_bytes(packed(arrays))
        with pytest.raises(loewner.FileError, match=r"ellipsoid|frames"):
            Body.load(tmp_path / "forged.npz")
    (tmp_path / "forged.npz").write_bytes(packed(plain))
    assert Body.load(tmp_path / "forged.npz").pieces[0].kind == kind


def members(whole: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(content: list[tuple[str, bytes]], method: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as archive:
        warnings.simplefilter("ignore")  # two of one name
        for name, data in content:
            archive.writestr(name, data)
    return stream.getvalue()


def _npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    text = header.encode()
    return b"\x93NUMPY" + version + len(text).to_bytes(2 if version[0] == 1 else 4, "little") + text + data


LAYOUT = "{'descr': '<i8', 'fortran_order': False, 'shape': (%s), }\n"

TRICKS: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "a member twice": lambda m: zipped([*m.items(), ("points.npy", m["points.npy"])]),
    "a folder": lambda m: zipped([*m.items(), ("points/", b"")]),
    "a shape of a billion": lambda m: zipped([*(m | {"layout.npy": _npy(LAYOUT % "1000000000, 5")}).items()]),
    "more digits than numbers have": lambda m: zipped([*(m | {"layout.npy": _npy(LAYOUT % ("9" * 400))}).items()]),
    "a thousand digits": lambda m: zipped([*(m | {"layout.npy": _npy(LAYOUT % ("1" * 60_000))}).items()]),
    "a header of brackets": lambda m: zipped([*(m | {"layout.npy": _npy("(" * 60_000)}).items()]),
    "a header of minus signs": lambda m: zipped([*(m | {"layout.npy": _npy("-" * 60_000 + "1")}).items()]),
    "a header that runs code": lambda m: zipped([*(m | {"layout.npy": _npy("__import__('os').abort()")}).items()]),
    "another format of headers": lambda m: zipped(
        [*(m | {"layout.npy": _npy(LAYOUT % "1, 5", b"\0" * 40, b"\x02\x00")}).items()]
    ),
    "numbers after the last": lambda m: zipped([*(m | {"layout.npy": m["layout.npy"] + b"\0" * 8}).items()]),
    "another method": lambda m: zipped([*m.items()], zipfile.ZIP_LZMA),
    "a hundred thousand members": lambda m: zipped([*m.items(), *((f"{i}.npy", b"") for i in range(100_000))]),
    "nothing in it": lambda m: zipped([]),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.verify] * ("thousand" in name)) for name in TRICKS]
)
def test_archive_tricks(name: str, box: Arrays, tmp_path: Path) -> None:
    """An archive that is not laid out as `save` does it is refused, and soon."""
    (tmp_path / "forged.npz").write_bytes(TRICKS[name](members(packed(box))))
    begin = time.process_time()
    with pytest.raises(loewner.FileError, match=r"forged\.npz"):
        Body.load(tmp_path / "forged.npz")
    assert time.process_time() - begin < 5


def test_nothing_is_unpacked_unseen(box: Arrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few hundred kilobytes that unpack to 40 MB are refused by their headers; so is what exceeds the limit."""
    zeros = io.BytesIO()
    np.save(zeros, np.zeros(40 * 2**17))  # of one dimension, where there should be two
    bomb = zipped([*(members(packed(box)) | {"points.npy": zeros.getvalue()}).items()], zipfile.ZIP_DEFLATED)
    del zeros
    assert len(bomb) < 2**20
    (tmp_path / "bomb.npz").write_bytes(bomb)
    tracemalloc.start()
    try:
        with pytest.raises(loewner.FileError, match=r"bomb\.npz: points: expected shape"):
            Body.load(tmp_path / "bomb.npz")
        assert tracemalloc.get_traced_memory()[1] < 8 * 2**20
    finally:
        tracemalloc.stop()
    (tmp_path / "good.npz").write_bytes(packed(box))
    monkeypatch.setattr(_archives, "LARGEST_CONTENT", 1000)
    with pytest.raises(loewner.FileError, match=r"good\.npz: expected arrays of at most 1,000 bytes, found 1,"):
        Body.load(tmp_path / "good.npz")
    with pytest.raises(loewner.FileError, match=r"expected arrays of at most 1,000 bytes"):
        Body.box([1, 2, 3]).save(tmp_path / "never.npz")
    assert not (tmp_path / "never.npz").exists()


def test_only_regular_files(tmp_path: Path) -> None:
    """A pipe that nobody writes to, a device and a folder are refused at once; so are paths that no system has."""
    os.mkfifo(tmp_path / "pipe.npz")
    paths: list[Any] = [tmp_path / "pipe.npz", "/dev/zero", tmp_path, "a\0b.npz", "a\ud800.npz", "x" * 5000 + ".npz"]
    outcomes = driver.run(lambda path: Body.load(path) and None, paths)
    assert [o.kind for o in outcomes] == [driver.REFUSED] * len(paths), outcomes
    assert all(o.text.startswith("FileError") for o in outcomes), outcomes
    for path in ("a\0b.npz", "a\ud800.npz"):
        with pytest.raises(loewner.FileError, match="NUL"):
            Body.sphere(1).save(path)
    for path in (3, None, 1.5, []):
        with pytest.raises(loewner.InputError, match="path: expected a path"):
            Body.load(path)  # type: ignore[arg-type]
        with pytest.raises(loewner.InputError, match="path: expected a path"):
            Body.sphere(1).save(path)  # type: ignore[arg-type]


@cache
def _extremes() -> dict[str, Callable[[], Bodies]]:
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(1500, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    turn = random_poses(rng, 40, 100)
    single = turn.astype(np.float32).astype(float)  # rigid to 1e-7 only
    curved = [b for s in (1e-3, 1, 1e3) for b in (Body.capsule(0.3 * s, s), Body.cone(s, 2), Body.cylinder(1, s))]
    return {
        "none": lambda: Bodies([]),
        "large": lambda: Bodies.from_points([ball, ball * [1, 1, 1e-6], ball * [1, 1e-3, 1e-7]]),
        "large, moved": lambda: Bodies([Body.from_points(ball * [1, 1e-2, 1e-3]).transformed(turn[0])]),
        "a prism of 1,200 corners": lambda: Bodies.from_points([prism(600, 0.3)]),
        "thin": lambda: Bodies.from_points([ball[:20] * [1, 1, 10.0**-k] for k in range(11)]),
        "thin and turned": lambda: Bodies.from_points(
            [(ball[:20] * [1, 1, 10.0**-k]) @ turn[k, :3, :3].T for k in range(10)]
        ),
        "far from the origin": lambda: Bodies.from_points([ball[:20] + 10.0**k for k in range(6)]),
        "loose fits": lambda: Bodies.from_points([ball[20 * k : 20 * k + 20] for k in range(20)], tol=1.0),
        "curved": lambda: Bodies([*curved, Body.sphere(1e-20), Body.cylinder(1e-12, 1), Body.capsule(1, 1e-300)]),
        "curved, moved": lambda: Bodies([b.transformed(T).transformed(T) for b, T in zip(curved, turn, strict=False)]),
        "moved by rounded poses": lambda: Bodies(
            [b.transformed(T).transformed(T) for b, T in zip([*curved, Body.sphere(1)], single, strict=False)]
        ),
        "taken": lambda: Bodies([*curved, Body.box([1, 2, 3]), Body.union([Body.sphere(1), Body.box([1, 1, 1])])])[
            ::-2
        ],
    }


@pytest.mark.parametrize("name", _extremes())
def test_extreme_bodies_load(name: str, tmp_path: Path) -> None:
    """No check is stricter than what making bodies promises: whatever was saved is loaded, bit by bit."""
    same_again(_extremes()[name](), tmp_path)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("count", quick(2, 4))
def test_families_load(family: str, tmp_path: Path, count: int) -> None:
    """So are pieces of all families, at any size, and moved."""
    points = pieces(family, count, seed=8)
    scales = (1e-20, 1e-3, 1.0, 1e20)
    same_again(Bodies.from_points([scale * P for scale in scales for P in points]), tmp_path)
    made = Bodies.from_points(points)
    poses = random_poses(np.random.default_rng(4), count, 10)
    same_again(Bodies([b.transformed(T) for b, T in zip(made, poses, strict=True)]), tmp_path)


def _slivers(count: int) -> list[np.ndarray]:
    """Hulls with near corners, and one cut from a mug whose corners are then moved by a few roundings."""
    rng = np.random.default_rng(1)
    steps = 10.0 ** rng.uniform(-18, -9, size=(count, 1, 1))
    return [CUT_FROM_A_MUG, *(CUT_FROM_A_MUG + steps * rng.normal(size=(count, 14, 3))), *near_corners(count)]


@pytest.mark.parametrize("count", quick(50, 200))
def test_slivers_load(tmp_path: Path, count: int) -> None:
    """Pieces with corners within a part in 1e13 of each other are loaded as they were saved, moved ones as well."""
    made = Bodies.from_points(_slivers(count))
    same_again(made, tmp_path)
    poses = random_poses(np.random.default_rng(4), len(made), 1)
    same_again(Bodies([body.transformed(T) for body, T in zip(made, poses, strict=True)]), tmp_path)


def _tallest(piece: Any) -> float:
    """The factor by which the inner ellipsoid may grow, by Qhull where the ellipsoid is the unit ball."""
    local = np.linalg.solve(piece.inner.factor.reshape(3, 3), (piece.vertices - piece.inner.center.reshape(3)).T).T
    return float(-ConvexHull(local).equations[:, 3].max())


@pytest.mark.parametrize("counts", quick((12, 1), (40, 2)))
def test_inner_ellipsoids_that_stick_out_are_refused(tmp_path: Path, counts: tuple[int, int]) -> None:
    """However short the triangles of a piece: an inner ellipsoid that sticks out by a part in 1e4 is refused."""
    near, each = counts
    families = [points for family in FAMILIES for points in pieces(family, each, seed=9)]
    for body in Bodies.from_points([CUT_FROM_A_MUG, *near_corners(near, seed=1), *families]):
        arrays = stored(body.save, tmp_path)
        del arrays["digest"]
        arrays["inner_factor"] = arrays["inner_factor"] * (_tallest(body.pieces[0]) * (1 + 1e-4))
        (tmp_path / "forged.npz").write_bytes(packed(arrays))
        with pytest.raises(loewner.FileError, match=r"forged\.npz: inner ellipsoid: expected it inside the piece"):
            Body.load(tmp_path / "forged.npz")


@pytest.mark.parametrize("tip", [0.0, 1e-170, 0.3, 0.999])
@pytest.mark.parametrize("width", [0.0, 1e-170, 1e-160, 1e-30, 1e-9, 1e-3])
def test_thin_triangles_do_not_enter_the_inner_ellipsoid(width: float, tip: float, tmp_path: Path) -> None:
    """A triangle with a corner within the inner ellipsoid is found, however thin it is; one that ends outside is not.

    Two triangles, back to back, stand on a face of a cube, across the diagonal from corner 0 to corner 6.
    """
    box = stored(Body.box([2, 2, 2]).save, tmp_path)
    del box["digest"]
    assert box["triangles"][:2].tolist() == [[6, 0, 2], [6, 4, 0]]
    around = [[6, 9, 2], [9, 8, 2], [8, 0, 2], [0, 8, 4], [8, 9, 4], [9, 6, 4]]
    box["triangles"] = np.concatenate([box["triangles"][2:], around, [[9, 8, 10], [8, 9, 10]]])
    box["triangle_start"] = np.array([0, 18])
    box["layout"][0, 2] = 11
    for end, accepted in ((tip, False), (1.0, True)):
        forged = box | {"points": np.concatenate([box["points"], [[0, 0, -1], [width, width, -1], [0, 0, -end]]])}
        (tmp_path / "forged.npz").write_bytes(packed(forged))
        if accepted:
            Body.load(tmp_path / "forged.npz")
        else:
            with pytest.raises(loewner.FileError, match=r"forged\.npz: inner ellipsoid: expected it inside the piece"):
                Body.load(tmp_path / "forged.npz")


def same_again(bodies: Bodies, folder: Path) -> None:
    bodies.save(folder / "bodies.npz")
    again = Bodies.load(folder / "bodies.npz")
    for name in files.ARRAYS:
        assert np.array_equal(getattr(again._packed, name), getattr(bodies._packed, name))


def test_other_orders_of_bytes_and_rows(box: Arrays, tmp_path: Path) -> None:
    """Files of other systems are read: big-endian numbers, narrower integers, columns stored first."""
    plain = {name: array.copy() for name, array in box.items()}
    for name in ("points", "planes", "outer_factor"):
        box[name] = np.asfortranarray(box[name].astype(">f8"))
    box["layout"], box["piece_start"] = box["layout"].astype("<i4"), box["piece_start"].astype(">i8")
    (tmp_path / "other.npz").write_bytes(packed(box))
    again = Body.load(tmp_path / "other.npz")
    for name in files.ARRAYS:
        assert np.array_equal(getattr(again._packed, name), plain[name])
        assert getattr(again._packed, name).dtype in (np.int64, np.float64)
    assert loewner.collide(again, None, Body.sphere(0.1), None)
