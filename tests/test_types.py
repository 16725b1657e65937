"""Types that users see: README and examples pass a strict checker; results are typed as far as types tell."""

import re
import shutil
from pathlib import Path

import pytest
from mypy import api

ROOT = Path(__file__).parent.parent

# What each query returns, as far as the types of its arguments decide: where they do not, one value or an array.
RESULTS = """
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import loewner
from loewner import planners

Bools = NDArray[np.bool_]
Verdicts = NDArray[np.int8]
Floats = NDArray[np.float64]
body, several = loewner.Body.box([1, 1, 1]), loewner.Bodies.spheres([0.5, 1.0])
assert_type(several[0], loewner.Body)
assert_type(several[1:], loewner.Bodies)
assert_type(several[[0, 1]], loewner.Bodies)
T = np.eye(4)
assert_type(loewner.classify(several, None, body, T), NDArray[np.int8])
assert_type(loewner.collide(body, T, several, None), Bools)
assert_type(loewner.collide(several, None, several, None, pairs=[[0, 1]]), Bools)
assert_type(loewner.collide(body, None, body, T), bool | Bools)
assert_type(loewner.collide(body, None, body, None), bool)
assert_type(loewner.collide(body, T, body, T, pairs=[[0, 0]]), Bools)
assert_type(loewner.classify(body, None, body, T), loewner.Verdict | Verdicts)
assert_type(loewner.classify(body, None, body, None), loewner.Verdict)
assert_type(loewner.classify(body, T, body, T, pairs=[[0, 0]]), Verdicts)
assert_type(loewner.distance(several, None, body, T).lower, Floats)
assert_type(loewner.distance(several, None, body, T).distance, None)
assert_type(loewner.distance(several, None, body, T, exact=True).distance, Floats)
assert_type(loewner.distance(body, None, body, T).witness_a, None)
assert_type(loewner.distance(body, None, body, T).lower, float | Floats)
assert_type(loewner.distance(body, None, body, T, exact=True).distance, float | Floats)
assert_type(loewner.distance(body, None, body, None, exact=True).distance, float)
assert_type(loewner.distance(body, T, body, T, pairs=[[0, 0]]).upper, Floats)
assert_type(loewner.distance(body, None, body, T, exact=True).witness_a, Floats)
assert_type(loewner.overlapping_pairs(several), NDArray[np.int64])
assert_type(loewner.overlapping_pairs(several, depth=True), loewner.Overlaps)
assert_type(loewner.overlapping_pairs(several, depth=True).distance, Floats)

scene = loewner.Scene()
assert_type(scene.distance("a", "b").upper, float)
assert_type(scene.distance("a", "b", exact=True).distance, float)
assert_type(scene.collide(), bool)


def planned(checker: loewner.CollisionChecker, a: Floats, b: Floats) -> None:
    search, improve = planners.Search(timeout=1.0), planners.Improve(seconds=1.0)
    assert_type(planners.plan(checker, a, b, search=search), Floats)
    assert_type(planners.plan(checker, a, b, timeout=1.0, improve_for=1.0), Floats)
    assert_type(planners.plan(checker, a, b, full=True, proof=True), planners.Plan)
    assert_type(planners.plan_full(checker, a, b, improve), planners.Plan)
    assert_type(planners.plan(checker, a, b, start_time=0.0, timeout=1.0), planners.Trajectory)
    assert_type(planners.plan_in_time(checker, a, b, 0.0), planners.Trajectory)
    assert_type(planners.plan(checker, a, b, base="car", radius=0.5), planners.Drive)
    assert_type(planners.plan_drive(checker, a, b, "car", radius=0.5), planners.Drive)


def asked(checker: loewner.CollisionChecker, q: Floats, exact: bool) -> loewner.Distance:
    assert_type(checker.distance(q).distance, None)
    assert_type(checker.distance(q, exact=True).normal, Floats)
    assert_type(checker.collide_by_pair(q), Bools)
    assert_type(checker.settle(q)[1].free, int)
    return loewner.distance(body, None, body, T, exact=exact)
"""


def blocks(path: Path) -> str:
    """All Python of a page."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", path.read_text(), flags=re.M | re.S))


# JAX's own types take longer to read than all others together.
JAX = "bend_a_path_jax.py"
EXAMPLES = sorted(path.name for path in (ROOT / "examples").glob("*.py") if path.name != JAX)


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """What a strict checker says of all files that do without JAX, by file, in one run."""
    folder = tmp_path_factory.mktemp("types")
    (folder / "results.py").write_text(RESULTS)
    (folder / "readme.py").write_text(blocks(ROOT / "README.md"))
    for example in EXAMPLES:
        shutil.copy(ROOT / "examples" / example, folder)
    return said(folder, follow_jax=False)


def said(folder, follow_jax):
    """What a strict checker says of each file of a folder."""
    # PyTorch, where it is there, has no types for half of what everybody calls.
    settings = "[mypy]\nstrict = true\nignore_missing_imports = true\nfollow_imports = silent\n"
    left_out = "[mypy-torch.*]\nfollow_imports = skip\n" + "[mypy-jax.*]\nfollow_imports = skip\n" * (not follow_jax)
    (folder / "mypy.ini").write_text(settings + left_out)
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("MYPYPATH", str(ROOT / "src"))
        out, error, _ = api.run(
            [
                "--config-file",
                str(folder / "mypy.ini"),
                "--cache-dir",
                str(folder / "cache"),
                *map(str, folder.glob("*.py")),
            ]
        )
    assert not error, error
    return {path.name: [line for line in out.splitlines() if path.name in line] for path in folder.glob("*.py")}


@pytest.mark.light
@pytest.mark.slow("one run of the type checker reads the library and all examples")
def test_results_are_typed(checked):
    """Arrays where bodies are several, None where nothing exact was asked for; no cast anywhere."""
    assert checked["results.py"] == []


@pytest.mark.light
@pytest.mark.parametrize("name", ["readme.py", *EXAMPLES])
def test_examples_pass_a_strict_checker(checked, name):
    """Users who check their types strictly can begin with this file."""
    assert checked[name] == []


@pytest.mark.verify
def test_the_example_of_jax_passes_a_strict_checker(tmp_path):
    """Users who check their types strictly can begin with this file, with JAX's own types."""
    for example in (JAX, "bend_a_path.py"):  # which the former imports
        shutil.copy(ROOT / "examples" / example, tmp_path)
    assert said(tmp_path, follow_jax=True)[JAX] == []
