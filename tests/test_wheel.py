"""How the package is built: what a wheel takes, what it refuses, what it says. `verify/test_wheel.py` installs one."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PINS = [line for line in (ROOT / "requirements" / "core.txt").read_text().split() if line.startswith(("num", "llvm"))]


def built(kind: str, to: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run one of the hooks by which pip builds."""
    code = f"from hatchling.build import *; print(build_{kind}({str(to)!r}))"
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def packaged() -> set[str]:
    """Files of the package, as git would have them."""
    files = [path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src" / "loewner").rglob("*")]
    return {
        name for name in files if name.endswith((".py", "/py.typed", ".h", ".hpp", ".cmake", ".pc", ".schema.json"))
    }


def required(kind: str, **environment: str) -> list[str]:
    """Return what a build asks pip to install first."""
    code = f"from hatchling.build import *; print(*get_requires_for_build_{kind}(), sep='\\n')"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_a_build_asks_for_the_pinned_compiler():
    """A wheel is built with the Numba that everything is tested with; sources, and a pure wheel, need none."""
    assert len(PINS) == 3
    assert required("wheel") == PINS
    assert required("wheel", LOEWNER_BUILD="pure") == required("sdist") == []


@pytest.mark.parametrize("missing", ["/nowhere/cc", pytest.param("false", marks=pytest.mark.verify)])
def test_without_a_compiler_one_message_says_what_to_do(tmp_path, missing):
    """No traceback: what was missing, what to install, and how to do without."""
    done = built("wheel", tmp_path, CC=missing)
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    assert missing in done.stderr
    assert "LOEWNER_BUILD=pure" in done.stderr
    assert "loewner[jit]" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_setting_is_an_error(tmp_path):
    """A typing mistake does not choose another kind of wheel."""
    done = built("wheel", tmp_path, LOEWNER_BUILD="Pure")
    assert done.returncode != 0
    assert "LOEWNER_BUILD: expected native or pure, found 'Pure'" in done.stderr


def test_a_pure_wheel_has_the_sources_only(tmp_path):
    """It fits any platform, and takes no library that lies in a clone."""
    done = built("wheel", tmp_path, LOEWNER_BUILD="pure", CC="/nowhere/cc")
    assert done.returncode == 0, done.stderr
    (path,) = tmp_path.iterdir()
    assert path.name.endswith("-py3-none-any.whl")
    names = zipfile.ZipFile(path).namelist()
    assert {name for name in names if ".dist-info/" not in name} == packaged()
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_an_editable_installation_builds_nothing(tmp_path):
    """It needs no compiler: `native/build.py` makes the library in a clone."""
    done = built("editable", tmp_path, CC="/nowhere/cc")
    assert done.returncode == 0, done.stderr
    assert not [name for name in zipfile.ZipFile(next(tmp_path.iterdir())).namelist() if name.endswith(".so")]


@pytest.mark.verify
def test_the_sources_hold_what_a_build_needs(tmp_path):
    """The hook, what it calls, and the versions; nothing that was built."""
    done = built("sdist", tmp_path)
    assert done.returncode == 0, done.stderr
    with tarfile.open(next(tmp_path.iterdir())) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    native = {path.relative_to(ROOT).as_posix() for path in (ROOT / "native").glob("*.[pc]*") if path.is_file()}
    assert len(native) > 4
    assert names >= native | {"hatch_build.py", "pyproject.toml", "requirements/core.txt", "LICENSE", "README.md"}
    assert names >= {f"src/{name}" for name in packaged()}
    assert not [name for name in names if name.endswith((".so", ".pyc", "built.json", ".ptx"))]


def test_a_wheel_is_checked(tmp_path):
    """The check of `make wheel` finds a foreign file, a missing licence and missing libraries."""
    path = tmp_path / "loewner-0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("loewner/__init__.py", "")
        wheel.writestr("loewner/_native/built.json", '{"files": {}}')
        wheel.writestr("loewner/_native/.build-x/first.o", "")
        wheel.writestr("tests/test_x.py", "")
    command = [sys.executable, str(ROOT / "native" / "check_wheel.py"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "found loewner/_native/.build-x/first.o, tests/test_x.py" in done.stderr
    assert "expected a LICENSE" in done.stderr
    assert "expected the libraries" in done.stderr
    assert "expected threads.ptx.z as it was built" in done.stderr
