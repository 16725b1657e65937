"""The compiled-kernel cache: an edit anywhere in the kernels changes the answer at once."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import loewner
from loewner import compilation

ASK = """
import sys
sys.path.insert(0, {root!r})
import loewner.ellipsoids
assert loewner.__file__.startswith({root!r}), loewner.__file__
from loewner._kernels import edited_caller
print(edited_caller.answer(1.0))
"""

CALLEE = """
from loewner._kernels._jit import njit

@njit()
def constant():
    return {value}
"""

CALLER = """
from loewner._kernels._jit import njit
from loewner._kernels.edited_callee import constant

@njit()
def answer(x):
    return x + constant()
"""


def ask(root: Path, cache: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "LOEWNER_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    env.pop("PYTHONPATH", None)
    return subprocess.run(
        [sys.executable, "-c", ASK.format(root=str(root))], env=env, capture_output=True, text=True, check=True
    )


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with two kernels of its own, one calling the other from another file."""
    root = tmp_path / "site"
    source = Path(loewner.__file__).parent
    shutil.copytree(source, root / "loewner", ignore=shutil.ignore_patterns("__pycache__"))
    (root / "loewner" / "_kernels" / "edited_callee.py").write_text(CALLEE.format(value=1.0))
    (root / "loewner" / "_kernels" / "edited_caller.py").write_text(CALLER)
    return root


def test_an_edited_callee_changes_the_answer(package: Path, tmp_path: Path):
    """The caller's file is untouched and its compiled code is on disk; the new callee must be seen all the same."""
    cache = tmp_path / "cache"
    first = ask(package, cache)
    assert float(first.stdout) == 2.0
    assert list(cache.rglob("*.nbi")), "the first run must have filled the cache, or nothing is tested"
    callee = package / "loewner" / "_kernels" / "edited_callee.py"
    stamp = callee.stat()
    callee.write_text(CALLEE.format(value=5.0))
    # Not even the time stamp gives the edit away.
    os.utime(callee, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert float(ask(package, cache).stdout) == 6.0


def test_the_wait_is_announced_once(package: Path, tmp_path: Path):
    """Compiling says so once, on standard error; a second run loads from disk and says nothing."""
    cache = tmp_path / "cache"
    assert ask(package, cache).stderr.count("compiling") == 1
    assert ask(package, cache).stderr == ""
    assert ask(package, tmp_path / "fresh", LOEWNER_QUIET="1").stderr == ""


def test_no_place_for_a_cache_is_no_error(package: Path, tmp_path: Path):
    """Where nothing can be written, kernels are compiled in memory and answer the same."""
    blocked = tmp_path / "a file"
    blocked.write_text("")
    assert float(ask(package, blocked).stdout) == 2.0


QUERIES = """
import numpy as np
import loewner
box, other = loewner.Body.box([1, 1, 1]), loewner.Body.box([0.5, 0.6, 0.7])
T = np.tile(np.eye(4), (3, 1, 1))
T[:, 0, 3] = [0.2, 1.1, 1.7]
loewner.classify(box, None, other, T)
loewner.collide(box, None, other, T)
loewner.distance(box, None, other, T, exact=True)
loewner.overlapping_pairs(box, T)
"""


def test_a_second_process_compiles_nothing():
    """Every query is found on disk the next time."""
    env = {k: v for k, v in os.environ.items() if k != "LOEWNER_QUIET"}
    runs = [
        subprocess.run([sys.executable, "-c", QUERIES], env=env, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert runs[1].stderr == ""


def test_a_broken_part_is_told(monkeypatch: pytest.MonkeyPatch):
    """Compiling ahead says which part failed, and what the process said."""
    monkeypatch.setattr(compilation, "PARTS", ("no such part",))
    with pytest.raises(loewner.FileError, match="no such part could not be compiled(.|\n)*KeyError"):
        compilation.compile_kernels(["no such part"])


def test_an_unknown_part_is_told():
    """The error names the parts that there are."""
    with pytest.raises(loewner.UnknownNameError, match="distances, verdicts, fits, robots, found 'verdict'"):
        compilation.compile_kernels(["verdict"])


@pytest.mark.verify
def test_compiling_ahead_leaves_nothing_to_compile(tmp_path: Path):
    """After `loewner compile` into an empty folder the queries find everything there."""
    env = {k: v for k, v in os.environ.items() if k != "LOEWNER_QUIET"} | {"LOEWNER_CACHE_DIR": str(tmp_path)}
    compiling = subprocess.run([sys.executable, "-m", "loewner", "compile"], env=env, capture_output=True, text=True)
    assert compiling.returncode == 0, compiling.stderr
    asked = subprocess.run([sys.executable, "-c", QUERIES], env=env, capture_output=True, text=True, check=True)
    assert asked.stderr == ""
