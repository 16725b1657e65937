"""A wheel, installed as users do, where there is neither Numba nor a compiler: it answers at once, or says why not."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from collections import Counter
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

import loewner

ROOT = Path(__file__).parents[2]
LARGEST_WHEEL, LARGEST_INSTALLED = 3e6, 10e6  # bytes

pytestmark = pytest.mark.verify

BOXES = """
import sys, loewner
from loewner._native import library
box = loewner.Body.box([1, 1, 1])
assert loewner.collide(box, None, box, None)
assert not loewner.collide(box, None, box, [[1, 0, 0, 1.01], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
assert "numba" not in sys.modules and "llvmlite" not in sys.modules
print(library.level())
"""

# All queries, on pairs close to contact; answers as a hash.
ANSWERS = """
import hashlib, sys
import numpy as np, loewner
from loewner import Body
from loewner._native import library
rng = np.random.default_rng(7)
bodies = [Body.box([1, 2, 3]), Body.sphere(1.0), Body.capsule(0.5, 2.0), Body.cylinder(1.0, 2.0), Body.cone(1.0, 2.0),
          Body.ellipsoid([1.0, 2.0, 3.0]), Body.load(sys.argv[1]), Body.load(sys.argv[2])]
poses = np.tile(np.eye(4), (COUNT, 1, 1))
Q, R = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))
Q[np.linalg.det(Q) < 0, :, 0] *= -1
poses[:, :3, :3], poses[:, :3, 3] = Q, rng.normal(size=(COUNT, 3)) * 1.5
digest = hashlib.sha256()
for a in bodies:
    for b in bodies:
        digest.update(loewner.classify(a, None, b, poses).tobytes())
        digest.update(loewner.collide(a, None, b, poses).tobytes())
        apart = loewner.distance(a, None, b, poses[:50], exact=True)
        assert (apart.lower <= apart.upper).all()
assert "numba" not in sys.modules
print(library.level(), digest.hexdigest())
"""


@pytest.fixture(scope="session")
def wheel(tmp_path_factory) -> Path:
    """The wheel of `make wheel` if it holds these sources; otherwise one that is built now."""
    for path in (ROOT / "dist").glob("*.whl"):
        if is_current(path):
            return path
    folder = tmp_path_factory.mktemp("wheel")
    code = f"from hatchling.build import build_wheel; build_wheel({str(folder)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
    (path,) = folder.iterdir()
    return path


def is_current(path: Path) -> bool:
    """Tell whether a wheel holds these sources, built as they would be now."""
    spec = importlib.util.spec_from_file_location("native_build", ROOT / "native" / "build.py")
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    archive = zipfile.ZipFile(path)
    held = {name: archive.read(name) for name in archive.namelist() if name.endswith(".py")}
    with zipfile.ZipFile(BytesIO(archive.read("loewner/_kernels/sources.zip"))) as kernels:
        held |= {f"loewner/_kernels/{name}": kernels.read(name) for name in kernels.namelist()}
    files = (ROOT / "src" / "loewner").rglob("*.py")
    sources = {path.relative_to(ROOT / "src").as_posix(): path.read_bytes() for path in files}
    return (
        "-cp311-abi3-" in path.name
        and held == sources
        and json.loads(archive.read("loewner/_native/built.json"))["recipe"] == build.recipe()
    )


@pytest.fixture(scope="session")
def installed(wheel, tmp_path_factory) -> Path:
    """A new environment, elsewhere, with the wheel; of what is installed here it sees NumPy and SciPy only."""
    home = tmp_path_factory.mktemp("elsewhere") / "environment"
    venv.create(home, symlinks=True)
    python = home / "bin" / "python"
    command = ["--quiet", "--disable-pip-version-check", "--python", str(python)]
    install = ["install", "--no-index", "--no-deps", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", *command, *install], check=True)
    seen = home / "seen"
    seen.mkdir()
    for name in ("numpy", "scipy"):
        package = Path(importlib.util.find_spec(name).origin).parent
        for path in [package, *package.parent.glob(f"{name}[.-]*")]:
            (seen / path.name).symlink_to(path)
    (packages(home) / "seen.pth").write_text(f"{seen}\n")
    return home


def packages(home: Path) -> Path:
    """Where an environment has its packages."""
    return home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"


@pytest.fixture(scope="session")
def saved(tmp_path_factory) -> list[str]:
    """Two bodies of several polytopes, in files."""
    rng = np.random.default_rng(3)
    paths = []
    for name in "ab":
        pieces = [loewner.Body.from_points(rng.normal(size=(60, 3)) / 3 + [0.8 * n, 0, 0]) for n in range(3)]
        paths.append(str(tmp_path_factory.mktemp("bodies") / f"{name}.npz"))
        loewner.Body.union(pieces).save(paths[-1])
    return paths


def start(home: Path, code: str, *arguments: str, before: tuple[str, ...] = (), **settings: str) -> subprocess.Popen:
    """Start a process of the environment, on a machine without a compiler."""
    clean = {"PATH": "/nowhere", "HOME": str(home), "LANG": "C.UTF-8", **settings}
    command = [*before, str(home / "bin" / "python"), "-c", code, *arguments]
    return subprocess.Popen(command, cwd=home, env=clean, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run(home: Path, code: str, *arguments: str, **settings) -> str:
    """Return what such a process prints; it has to end well."""
    process = start(home, code, *arguments, **settings)
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.strip()


@pytest.fixture(scope="session")
def levels(installed) -> list[str]:
    """Levels that this processor runs, the best first."""
    found = run(installed, "from loewner._native import library; print(*library.levels())").split()
    assert found
    return found


def refused(home: Path, **settings) -> str:
    """Return the last line of a process that ends without an answer."""
    process = start(home, BOXES, **settings)
    _, err = process.communicate()
    assert process.returncode == 1
    return err.strip().splitlines()[-1]


def test_it_is_the_wheel_that_is_tested(installed):
    """The package of the environment is imported, and Numba and a compiler are out of reach."""
    code = "import importlib.util as u, loewner, shutil; print(loewner.__file__); assert not shutil.which('cc')"
    code += "; assert not any(map(u.find_spec, ('numba', 'llvmlite', 'rich')))"
    assert run(installed, code).startswith(str(packages(installed)))


def test_two_boxes_are_answered_by_the_library(installed, levels):
    """The first answer needs no Numba, and leaves no compiled code behind."""
    assert run(installed, BOXES) == levels[0]
    assert not (installed / ".cache").exists()


def test_two_bodies_from_files_are_answered_by_the_library(installed, saved):
    """Bodies of meshes that were saved need no SciPy either."""
    code = "import sys, loewner; a, b = map(loewner.Body.load, sys.argv[1:]); print(loewner.collide(a, None, b, None))"
    assert run(installed, code + "; assert 'scipy' not in sys.modules", *saved) == "True"


@pytest.mark.xfail(reason="a goal that is not reached, see docs/design/native.md", strict=True)
def test_it_is_small(wheel, installed):
    """The wheel as it is downloaded; the package as it is installed, with byte code."""
    assert wheel.stat().st_size < LARGEST_WHEEL
    subprocess.run([installed / "bin" / "python", "-m", "compileall", "-q", packages(installed)], check=True)
    files = [path for path in packages(installed).rglob("*") if path.is_file() and not path.is_symlink()]
    by_kind = Counter[str]()
    for path in files:
        by_kind[path.suffix] += path.stat().st_size
    assert by_kind.total() < LARGEST_INSTALLED, by_kind


def test_four_processes_at_once_are_right(installed, saved):
    """Nothing is shared that starting together could disturb."""
    processes = [start(installed, ANSWERS.replace("COUNT", "100"), *saved) for _ in range(4)]
    told = [process.communicate() for process in processes]
    assert [process.returncode for process in processes] == [0] * 4, told
    assert len({out for out, _ in told}) == 1


def test_all_levels_answer_alike(installed, saved, levels):
    """Every level that the processor runs gives the same verdicts."""
    told = [run(installed, ANSWERS.replace("COUNT", "3000"), *saved, LOEWNER_LEVEL=name) for name in levels]
    assert [line.split()[0] for line in told] == levels
    assert len({line.split()[1] for line in told}) == 1


@pytest.fixture
def copy(installed, tmp_path) -> Path:
    """A copy of the installed package, which a test may spoil."""
    shutil.copytree(packages(installed) / "loewner", tmp_path / "loewner", ignore=shutil.ignore_patterns("*.pyc"))
    return tmp_path


def test_a_damaged_library_is_refused(installed, copy, levels):
    """One byte is another: the reason is told, and what to install."""
    path = copy / "loewner" / "_native" / f"kernels-{levels[0]}.so"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    told = refused(installed, PYTHONPATH=str(copy))
    assert f"{path} is damaged" in told
    assert "pip install 'loewner[jit]'" in told


def test_a_library_of_other_sources_is_refused(installed, copy):
    """A kernel was edited after the library was built, in the archive or beside it."""
    kernels = copy / "loewner" / "_kernels"
    with zipfile.ZipFile(kernels / "sources.zip", "a") as archive:
        archive.writestr("another.py", "")
    assert "built from other sources" in refused(installed, PYTHONPATH=str(copy))
    shutil.copy(packages(installed) / "loewner" / "_kernels" / "sources.zip", kernels)
    with (kernels / "codes.py").open("a") as file:
        file.write("\n")
    assert "built from other sources" in refused(installed, PYTHONPATH=str(copy))


def test_a_foreign_library_is_refused(installed, copy, levels):
    """Another library in its place, even one whose sum is in the list."""
    native = copy / "loewner" / "_native"
    foreign = native / f"kernels-{levels[0]}.so"
    shutil.copy(next(native.glob("_call*.so")), foreign)
    assert "is damaged" in refused(installed, PYTHONPATH=str(copy))
    built = json.loads((native / "built.json").read_text())
    built["files"][foreign.name] = sha256(foreign.read_bytes()).hexdigest()
    (native / "built.json").write_text(json.dumps(built))
    assert "expected a library built from" in refused(installed, PYTHONPATH=str(copy))


def test_without_library_and_numba_an_error_says_what_to_install(installed):
    """Numba alone would do; there is none."""
    told = refused(installed, LOEWNER_JIT="1")
    assert told.startswith("loewner.errors.MissingExtraError")
    assert "LOEWNER_JIT=1" in told
    assert "pip install 'loewner[jit]'" in told


# -- older processors, emulated: those that NumPy itself runs on ------------------------------------

emulator = shutil.which("qemu-x86_64")
emulated = pytest.mark.skipif(emulator is None, reason="expected qemu-x86_64 (Debian: qemu-user), found none")


def processor(model: str) -> tuple[str, ...]:
    """Run a process on this model."""
    return (str(emulator), "-cpu", model)


@emulated
@pytest.mark.parametrize("model", ["Haswell", "EPYC"])
def test_a_processor_without_avx512_is_answered_by_level_3(installed, saved, model):
    """It chooses the lower level by itself, and answers as this machine does."""
    code = ANSWERS.replace("COUNT", "100")
    level, answers = run(installed, code, *saved, before=processor(model)).split()
    assert level == "x86-64-v3"
    assert answers == run(installed, code, *saved).split()[1]


@emulated
@pytest.mark.parametrize("model", ["SandyBridge", "IvyBridge"])
def test_a_processor_without_avx2_is_told_to_install_numba(installed, model):
    """No level runs there; nothing is executed that it cannot."""
    told = refused(installed, before=processor(model))
    assert told.startswith("loewner.errors.MissingExtraError")
    assert "this processor runs none" in told


@emulated
def test_a_processor_without_avx2_is_answered_by_numba(installed, tmp_path):
    """With Numba at hand the kernels are compiled for what the processor is."""
    seen = [str(Path(importlib.util.find_spec(name).origin).parent.parent) for name in ("numba", "llvmlite")]
    code = BOXES.replace('assert "numba" not in sys.modules and "llvmlite" not in sys.modules', "")
    path = os.pathsep.join([str(packages(installed)), *seen])
    told = run(installed, code, before=processor("SandyBridge"), PYTHONPATH=path, LOEWNER_CACHE_DIR=str(tmp_path))
    assert told == "None"
