"""Damaged mesh files: whole or refused, whatever was done to them."""

import time
import warnings
import zlib
from collections import Counter

import numpy as np
import pytest

import driver
import mesh_examples
import mesh_oracles
from loewner import Body
from loewner.meshes import decomposition as meshes
from sampling import quick

EXAMPLES = mesh_examples.examples()

# Coordinates may differ by the rounding of transforms, relative to the largest of the numbers that went into them.
TOLERANCE = 1e-9

# Accepted bodies whose hull is checked besides their triangles.
BODIES = 0.1


def write(files, folder):
    """Put files into a folder; the path of the first."""
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / next(iter(files))


def triangles_of(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about polygons, axes and keys
        vertices, triangles = meshes.load(path)
    return vertices[triangles]


def differ(found, wanted):
    """What is different about triangles, if anything; of a polygon they may be any that have its boundary."""
    count = sum(len(polygon) - 2 for polygon in wanted)
    if len(found) != count:
        return f"{len(found)} triangles, {count} by the other reading"
    largest, k = max((abs(x) for polygon in wanted for p in polygon for x in p), default=1.0), 0
    for polygon in wanted:
        triangles, polygon = found[k : k + len(polygon) - 2], np.array(polygon, dtype=np.float64)
        k += len(triangles)
        fan = np.stack([np.broadcast_to(polygon[0], triangles[:, 0].shape), polygon[1:-1], polygon[2:]], axis=1)
        if np.abs(triangles - fan).max() <= TOLERANCE * max(largest, 1.0):
            continue
        apart = np.abs(triangles[:, :, None] - polygon).max(axis=-1)
        if apart.min(axis=-1).max() > TOLERANCE * max(largest, 1.0):
            return "a triangle has a corner that its polygon lacks"
        if edges(apart.argmin(axis=-1)) != edges([np.abs(polygon[:, None] - polygon).max(axis=-1).argmin(axis=-1)]):
            return "triangles have another boundary than their polygon"
    return None


def edges(loops):
    """How often each edge is passed one way more than the other."""
    passed = Counter()
    for loop in loops:
        for a, b in zip(loop, np.roll(loop, -1), strict=True):
            passed[min(a, b), max(a, b)] += np.sign(b - a)
    return {edge: times for edge, times in passed.items() if times}


def case_of(case):
    """Files and suffix of a case: an example's name and a seed."""
    name, seed = case
    files, suffix = EXAMPLES[name]
    return mesh_examples.damaged(files, suffix, np.random.default_rng([seed, zlib.crc32(name.encode())])), suffix


def check(case, folder):
    """Load a damaged file and compare with the other reading; None, or what is wrong."""
    files, suffix = case_of(case)
    path = write(files, folder)
    found = triangles_of(path)
    try:
        wanted = mesh_oracles.read(suffix, files[path.name], folder)
    except mesh_oracles.Refused as refused:
        return f"accepted {len(found)} triangles; by the other reading: {refused}"
    wrong = differ(found, wanted)
    if wrong is None and np.random.default_rng(case[1]).random() < BODIES:
        # Triangles that are lines or points are dropped, as docs/meshes.md says.
        points = [p for triangle in found if len(set(map(tuple, triangle.tolist()))) == 3 for p in triangle]
        wrong = check_body(path, np.array(points, dtype=np.float64).reshape(-1, 3))
    return wrong


def check_body(path, points):
    """The hull of a body reaches as far as the points, in many directions."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about units
        body = Body.from_mesh(path, decompose=False)
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reach = (body.pieces[0].vertices @ directions.T).max(axis=0)
    error = np.abs(reach - (points @ directions.T).max(axis=0)).max()
    return None if error <= 1e-9 * np.abs(points).max() else f"the hull's support differs by {error:g}"


def campaign(count, folder):
    start = time.perf_counter()
    names = list(EXAMPLES)
    cases = [(names[k % len(names)], k) for k in range(count)]
    outcomes = driver.run(lambda case: check(case, folder), cases)
    assert not driver.faults(outcomes), driver.faults(outcomes)
    kinds = Counter(outcome.kind for outcome in outcomes)
    strict = 0  # refused, though the other reading takes it; for the record
    for outcome in outcomes:
        if outcome.kind == driver.REFUSED and outcome.text.startswith("FileError"):
            files, suffix = case_of(outcome.case)
            try:
                mesh_oracles.read(suffix, files[next(iter(files))], write(files, folder).parent)
                strict += 1
            except mesh_oracles.Refused:
                pass
    assert kinds[driver.OK] > count / 100
    assert kinds[driver.REFUSED] > count / 4
    print(
        f"mesh files: {count} damaged files of {len(EXAMPLES)} kinds: "
        f"{kinds[driver.OK]} read as the other reading does, "
        f"{kinds[driver.REFUSED]} refused (of them {strict} that the other reading takes), "
        f"0 wrong, 0 raw exceptions, 0 crashes, 0 hangs; {time.perf_counter() - start:.0f} s"
    )


@pytest.mark.parametrize("name", EXAMPLES)
def test_whole_files_are_read(name, tmp_path):
    """Undamaged, every example is read, and as the other reading does."""
    files, suffix = EXAMPLES[name]
    path = write(files, tmp_path)
    found = triangles_of(path)
    assert len(found) >= 20
    assert differ(found, mesh_oracles.read(suffix, files[path.name], tmp_path)) is None


@pytest.mark.parametrize("count", quick(90, 220))
def test_damaged_files(tmp_path, count):
    """A damaged file is refused with a LoewnerError, or read as an independent reading of the same bytes does."""
    campaign(count, tmp_path)


@pytest.mark.fuzz
def test_many_damaged_files(tmp_path):
    """20,000 of them."""
    campaign(20_000, tmp_path)
