"""The compiled-kernel cache: an edit anywhere in the kernels changes the answer at once."""

import hashlib
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import loewner
from loewner._kernels import _jit, _sealed, _sources, _store
from loewner._native import library
from loewner._native.entries import ENTRIES
from loewner.cli import compilation
from sampling import quick

ASK = """
import sys
sys.path.insert(0, {root!r})
import loewner.ellipsoids.ellipsoids
assert loewner.__file__.startswith({root!r}), loewner.__file__
from loewner._kernels.edited import caller
print(caller.answer(1.0))
"""

CALLEE = """
from loewner._kernels._jit import njit

@njit()
def constant():
    return {value}
"""

CALLER = """
from loewner._kernels._jit import njit
from loewner._kernels.edited.callee import constant

@njit()
def answer(x):
    return x + constant()
"""


def ask(root: Path, cache: Path, first: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "LOEWNER_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    env.pop("PYTHONPATH", None)
    return subprocess.run(
        [sys.executable, "-c", first + ASK.format(root=str(root))], env=env, capture_output=True, text=True, check=True
    )


def entries(cache: Path) -> list[Path]:
    return sorted(cache.rglob("*.kernel"))


def copied(folder: Path) -> Path:
    """A copy of the package with two kernels in a subfolder, one calling the other from another file.

    The byte code of the other files comes with them, so that processes need not make it again; those two have none.
    """
    root = folder / "site"
    shutil.copytree(Path(loewner.__file__).parent, root / "loewner")
    folder = root / "loewner" / "_kernels" / "edited"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "callee.py").write_text(CALLEE.format(value=1.0))
    (folder / "caller.py").write_text(CALLER)
    return root


@pytest.fixture
def package(tmp_path: Path) -> Path:
    return copied(tmp_path)


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """What a first process said, and the cache that it filled. A copy of the package elsewhere uses the same one."""
    folder = tmp_path_factory.mktemp("once")
    ran = ask(copied(folder), folder / "cache")
    assert float(ran.stdout) == 2.0
    assert entries(folder / "cache"), "the first run must have filled the cache, or nothing is tested"
    return ran, folder / "cache"


def test_an_edited_callee_changes_the_answer(package: Path, once, tmp_path: Path):
    """The caller's file is untouched and its compiled code is on disk; the new callee must be seen all the same."""
    cache = shutil.copytree(once[1], tmp_path / "cache")
    callee = package / "loewner" / "_kernels" / "edited" / "callee.py"
    stamp = callee.stat()
    callee.write_text(CALLEE.format(value=5.0))
    # Not even the time stamp gives the edit away.
    os.utime(callee, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert float(ask(package, cache).stdout) == 6.0


def test_the_wait_is_announced_once(package: Path, once):
    """Compiling says so once, on standard error; a second run loads from disk, compiles nothing and says nothing."""
    first, cache = once
    assert first.stderr.count("compiling") == 1
    again = ask(package, cache)
    assert (float(again.stdout), again.stderr) == (2.0, "")


@pytest.mark.verify
def test_no_place_for_a_cache_is_no_error(package: Path, tmp_path: Path):
    """Where nothing can be written, kernels are compiled in memory and answer the same."""
    blocked = tmp_path / "a file"
    blocked.write_text("")
    assert float(ask(package, blocked).stdout) == 2.0


def foreign(data: bytes) -> bytes:
    """A sealed file as it should be, of something else."""
    content = pickle.dumps(("not", "a", "kernel"))
    return _sealed.HEADER + hashlib.sha256(content).digest() + content


DAMAGE = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "random": lambda data: np.random.default_rng(0).bytes(len(data)),
    "one bit": lambda data: data[:-100] + bytes([data[-100] ^ 16]) + data[-99:],
    "header": lambda data: data[:5] + b"!" + data[6:],
    "longer": lambda data: data + b"more",
    "foreign": foreign,
}


def answer(x: float) -> float:
    return x + 1.0


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """A function that compiles `answer` as a new process would, and gives its answer and what was said."""
    monkeypatch.setattr(_store, "FOLDER", tmp_path / "kernels")
    monkeypatch.delenv("LOEWNER_QUIET", raising=False)

    def run() -> tuple[float, str]:
        monkeypatch.setattr(_jit, "_said", set())
        return _jit.njit()(answer)(1.0), capsys.readouterr().err

    assert run() == (2.0, "")  # Numba's event names loewner's own kernels only, so that nothing is announced here
    return run


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_entry_is_made_anew(compiled, tmp_path: Path, kind: str):
    """Whatever happened to an entry, the answer is right, one line says which file it was, and it happens once."""
    (entry,) = entries(tmp_path)
    entry.write_bytes(DAMAGE[kind](entry.read_bytes()))
    result, said = compiled()
    assert result == 2.0
    assert len(said.splitlines()) == 1
    assert str(entry) in said
    assert "compiling it anew" in said
    assert compiled() == (2.0, "")


def other(x: float) -> float:
    return x + 2.0


def test_an_entry_of_another_kernel_is_not_taken(compiled, tmp_path: Path):
    """A whole and sealed file of another kernel, under this one's name, is no answer."""
    (entry,) = entries(tmp_path)
    assert _jit.njit()(other)(1.0) == 3.0
    (foreign_entry,) = set(entries(tmp_path)) - {entry}
    entry.write_bytes(foreign_entry.read_bytes())
    result, said = compiled()
    assert result == 2.0
    assert "is damaged; compiling it anew" in said


@pytest.mark.parametrize("count", quick(80, 200))
def test_any_flipped_bit_is_noticed(compiled, tmp_path: Path, rng: np.random.Generator, count: int):
    """Machine code with one wrong bit is never run: all places tried, header and checksum included."""
    (entry,) = entries(tmp_path)
    whole = entry.read_bytes()
    for place in [*range(count // 2), *rng.integers(len(whole), size=count // 2)]:
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        entry.write_bytes(data)
        with pytest.raises(_sealed.DamagedFileError):
            _sealed.read(entry)


def test_an_entry_that_cannot_be_read_is_no_error(compiled, tmp_path: Path):
    """A folder stands where the entry should be: the kernel is compiled in memory, and that is said."""
    (entry,) = entries(tmp_path)
    entry.unlink()
    entry.mkdir()
    result, said = compiled()
    assert result == 2.0
    assert f"{entry} cannot be read" in said
    assert f"{entry.parent} cannot be written" in said


FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
"""


@pytest.mark.verify
def test_a_full_disk_is_no_error(package: Path, tmp_path: Path):
    """Where a write fails half way, the kernel stays in memory, one line says so, and nothing is left on disk."""
    cache = tmp_path / "cache"
    ran = ask(package, cache, first=FULL)
    assert float(ran.stdout) == 2.0
    assert ran.stderr.count("cannot be written (File too large); compiled kernels stay in memory") == 1
    assert [path for path in cache.rglob("*") if path.is_file()] == []


@pytest.mark.verify
def test_what_only_kernels_call_becomes_no_machine_code(package: Path, once, tmp_path: Path):
    """The callee is kept as a part, the caller as what Python calls; called from Python later, the callee is both."""
    cache = shutil.copytree(once[1], tmp_path / "cache")
    contents = {path.name.split("-")[0]: _sealed.read(path) for path in entries(cache)}
    assert b"\x8c\x04part" in contents.pop("edited.callee.constant")
    assert b"\x8c\x06object" in contents.pop("edited.caller.answer")
    assert not contents
    both = "from loewner._kernels.edited.callee import constant; assert constant() == 1.0"
    again = ask(package, cache, f"import sys; sys.path.insert(0, {str(package)!r}); {both}; ")
    assert float(again.stdout) == 2.0
    assert len(entries(cache)) == 3


@pytest.mark.verify
def test_many_threads_call_a_new_kernel_at_once(package: Path, tmp_path: Path):
    """Each gets the answer, the kernel is compiled once, and the next call goes straight to the compiled code.

    A process that was told to be quiet does not announce that it compiles.
    """
    many = f"""
import sys
sys.path.insert(0, {str(package)!r})
from concurrent.futures import ThreadPoolExecutor
from loewner._kernels.edited.caller import answer
with ThreadPoolExecutor(8) as pool:
    assert set(pool.map(answer, [1.0] * 100)) == {{2.0}}
answer._compile_for_args = None
assert answer(2.0) == 3.0
"""
    ran = ask(package, tmp_path / "cache", many, LOEWNER_QUIET="1")
    assert (float(ran.stdout), ran.stderr) == (2.0, "")


@pytest.fixture
def no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """What runs on a machine without the native library."""
    monkeypatch.setenv("LOEWNER_JIT", "1")
    library._opened.cache_clear()
    yield
    monkeypatch.undo()
    library._opened.cache_clear()


def serve(monkeypatch: pytest.MonkeyPatch, folder: Path, code: str) -> None:
    """Let the processes that compile ahead run another module."""
    (folder / "served.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setattr(compilation, "__name__", "served")


@pytest.mark.usefixtures("no_library")
def test_compiling_ahead_can_be_interrupted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """What `progress` raises, an interrupt for instance, ends the processes at once."""
    alive = tmp_path / "pid"
    serve(
        monkeypatch,
        tmp_path,
        f"""
import os, time
def serve_task(task, progress):
    open({str(alive)!r}, "w").write(str(os.getpid()))
    progress(1, 1)
    time.sleep(60)
""",
    )

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compilation.compile_kernels(["fits"], progress=interrupt)
    with pytest.raises(ProcessLookupError):
        os.kill(int(alive.read_text()), 0)


@pytest.mark.verify
def test_kernels_need_the_compiler(package: Path, tmp_path: Path):
    """Numba's switch that turns its compiler off is refused by name."""
    with pytest.raises(subprocess.CalledProcessError) as raised:
        ask(package, tmp_path, NUMBA_DISABLE_JIT="1")
    assert "NUMBA_DISABLE_JIT: expected Numba to compile" in raised.value.stderr


@pytest.mark.verify
@pytest.mark.usefixtures("no_library")
def test_compiling_ahead_tells_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Compiling ahead without a place to keep the result is an error that names the folder."""
    blocked = tmp_path / "a file"
    blocked.write_text("")
    monkeypatch.setenv("LOEWNER_CACHE_DIR", str(blocked))
    monkeypatch.setattr(compilation, "PARTS", ("little",))
    monkeypatch.setattr(compilation, "_TOGETHER", (("little",),))
    serve(
        monkeypatch,
        tmp_path,
        """
from loewner.cli import compilation
def serve_task(task, progress):
    compilation._MODULES["little"] = ("pieces.rigid",)
    return compilation.serve_task(task, progress)
""",
    )
    with pytest.raises(loewner.FileError, match="a file/kernels cannot be written"):
        compilation.compile_kernels(["little"])


QUERIES = """
import numpy as np
import loewner
from loewner import paper, planners
box, other = loewner.Body.box([1, 1, 1]), loewner.Body.box([0.5, 0.6, 0.7])
T = np.tile(np.eye(4), (3, 1, 1))
T[:, 0, 3] = [0.2, 1.1, 1.7]
loewner.classify(box, None, other, T)
loewner.collide(box, None, other, T)
loewner.collide(box, None, other, T, method="estimate")
loewner.distance(box, None, other, T, exact=True)
loewner.overlapping_pairs(box, T)

points = np.random.default_rng(0).normal(size=(400, 3))
loewner.Body.from_points(points / np.linalg.norm(points, axis=1)[:, None])
loewner.mvce(points)
loewner.mvie(points)
one, far = (loewner.Ellipsoids([x, 0.0, 0.0], np.eye(3)) for x in (0.0, 3.0))
loewner.near_points(one, far)
loewner.contact_function(one, far)
loewner.overlap(one, far)
paper.run(20)
corners, triangles = points[:4], [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]
loewner.Body.from_surface((corners, triangles), solid=False)

robot = loewner.Robot.from_urdf({arm!r})
robot.forward_kinematics([[0.0]])
checker = loewner.CollisionChecker(robot, skip_adjacent=False)
checker.collide([[0.0], [5.0]])
checker.valid_edges([5.0], [6.0], resolution=0.5)
checker.certify_edges([5.0], [6.0])
checker.distance([5.0], exact=True, gradient=True)
checker.clearance([5.0], gradient=True)
planners.plan(checker, [5.0], [6.0])
planners.shorten(checker, [[5.0], [5.5], [6.0]])
"""

ARM = """<robot name="arm">
  <link name="base"><collision><geometry><cylinder radius="0.5" length="1"/></geometry></collision></link>
  <link name="hand"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="9" effort="1" velocity="1"/></joint>
</robot>"""


@pytest.mark.usefixtures("no_library")
def test_a_broken_part_is_told(monkeypatch: pytest.MonkeyPatch):
    """Compiling ahead says which part failed, and what the process said."""
    monkeypatch.setattr(compilation, "PARTS", ("no such part",))
    monkeypatch.setattr(compilation, "_TOGETHER", (("no such part",),))
    with pytest.raises(loewner.FileError, match="no such part could not be compiled(.|\n)*KeyError"):
        compilation.compile_kernels(["no such part"])


def test_every_entry_belongs_to_one_part():
    """An entry of no part would be compiled at its first call, however much was compiled ahead."""
    for entry in ENTRIES.values():
        assert sum(entry.module.startswith(modules) for modules in compilation._MODULES.values()) == 1, entry.name


def test_an_unknown_part_is_told():
    """The error names the parts that there are."""
    known = "verdicts, crowds, robots, fits, surfaces, distances, estimates, paper"
    with pytest.raises(loewner.UnknownNameError, match=f"{known}, found 'verdict'"):
        compilation.compile_kernels(["verdict"])


@pytest.mark.verify  # without its byte code, the whole package is compiled
def test_nothing_is_kept_where_the_sources_cannot_be_told(tmp_path: Path):
    """From a zip, where two versions could not be told apart, nothing is written and nothing read."""
    archive, home = tmp_path / "app.zip", Path(loewner.__file__).parent
    with zipfile.ZipFile(archive, "w") as zipped:
        for path in (*home.rglob("*.py"), *home.glob("share/*.json")):
            if "_kernels" not in path.parts:
                zipped.write(path, Path("loewner") / path.relative_to(home))
        for name, content in _sources.sources().items():
            zipped.writestr(f"loewner/_kernels/{name}", content)
    query = (
        "import sys, numpy as np; sys.path.insert(0, sys.argv[1]); import loewner; assert '.zip' in loewner.__file__; "
        "loewner._base._validate.rigid_motions(np.eye(4)[None], 'T')"
    )
    env = {**os.environ, "LOEWNER_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": ""}
    done = subprocess.run([sys.executable, "-c", query, str(archive)], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not list((tmp_path / "cache").rglob("*.kernel"))


def test_no_home_is_no_error(tmp_path: Path):
    """A user without a folder and without an entry in the list of users imports, asks, and keeps nothing."""
    code = """
import os, sys
try:
    import pwd
except ImportError:
    sys.exit()
def nobody(uid):
    raise KeyError(uid)
pwd.getpwuid = nobody
for name in ("HOME", "LOEWNER_CACHE_DIR", "XDG_CACHE_HOME"):
    os.environ.pop(name, None)
import loewner
from loewner._kernels import _sources
ball = loewner.Body.sphere(1.0)
assert loewner.collide(ball, None, ball, None)
assert not _sources.cache_folder().exists()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.verify
def test_compiling_ahead_leaves_nothing_to_compile(tmp_path: Path):
    """After `loewner compile` into an empty folder the queries find everything there."""
    env = {k: v for k, v in os.environ.items() if k != "LOEWNER_QUIET"}
    env |= {"LOEWNER_CACHE_DIR": str(tmp_path), "LOEWNER_JIT": "1"}
    compiling = subprocess.run([sys.executable, "-m", "loewner", "compile"], env=env, capture_output=True, text=True)
    assert compiling.returncode == 0, compiling.stderr
    arm = tmp_path / "arm.urdf"
    arm.write_text(ARM, encoding="utf-8")
    asked = subprocess.run(
        [sys.executable, "-c", QUERIES.format(arm=str(arm))], env=env, capture_output=True, text=True, check=True
    )
    assert asked.stderr == ""


@pytest.mark.usefixtures("no_library")
def test_compiling_ahead_looks_at_the_folder_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A folder that cannot be written is refused before anything is compiled; the message names the way out."""

    def compiled(*_: object) -> None:
        raise AssertionError("compiled before the folder was tried")

    blocked = tmp_path / "a file"
    blocked.write_text("")
    monkeypatch.setattr(_store, "FOLDER", blocked / "kernels")
    monkeypatch.setattr(compilation.jobs, "answers", compiled)
    with pytest.raises(loewner.FileError, match=r"a file/kernels cannot be written .*; set LOEWNER_CACHE_DIR"):
        compilation.compile_kernels()
