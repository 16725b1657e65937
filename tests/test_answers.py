"""Answers have the bits of one committed table: at every level, from the library and from Numba, with any C library."""

import os
import pickle
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import answers
import other_machines
from loewner._kernels import _fused, _sealed
from loewner._kernels._numba import cpu_target
from loewner._kernels._sources import source_hash
from loewner._native import library
from native_files import NATIVE, module

LEVELS = module("build").LEVELS["x86_64"]
_, CPU, FEATURES = cpu_target.target_context.codegen().magic_tuple()

# Checks of bounds divide a function's blocks, and so leave more products apart; the table is of x86-64.
pytestmark = pytest.mark.skipif(
    bool(numba.config.BOUNDSCHECK)
    or platform.machine() not in ("x86_64", "AMD64")
    or not _fused.can_fuse(CPU, FEATURES),
    reason="other products are fused here: checks of bounds, or a processor without fused products or of another kind",
)


def expected() -> list[str]:
    return answers.TABLE.read_text(encoding="utf-8").splitlines()


def printed(switches: dict[str, str]) -> list[str]:
    """The table as a process with these switches prints it."""
    command = [sys.executable, "-W", "ignore", str(Path(answers.__file__))]
    environment = other_machines.environment(switches)
    return subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", answers.questions())
def test_the_bits_are_those_of_the_table(name: str):
    """A change that is not meant to alter an answer alters no bit of any; if it is meant to, write the table anew."""
    assert f"{answers.digest(answers.questions()[name]())}  {name}" in expected()


def test_the_table_has_a_line_for_each_question():
    """No question is left out of the table, and none is listed that is not asked."""
    assert [line.split("  ")[1] for line in expected()] == list(answers.questions())


@pytest.mark.verify
@pytest.mark.parametrize("machine", other_machines.machines())
def test_other_processors_answer_the_same(machine: str):
    """With the routines of NumPy and OpenBLAS, and the kernels, of other processors."""
    assert printed(other_machines.machines()[machine]) == expected()


@pytest.mark.verify
@pytest.mark.skipif(library.level() is None, reason="no native library here")
@pytest.mark.parametrize(("count", "order"), [(1, 1), (1, -1), (4, 1), (4, -1)])
def test_a_library_that_is_linked_otherwise_answers_the_same(count: int, order: int, tmp_path: Path):
    """In one object file or in four whose functions have other neighbours, forwards and backwards."""
    script = Path(answers.__file__).with_name("linked_otherwise.py")
    level = {"NUMBA_CPU_NAME": library.level(), "NUMBA_CPU_FEATURES": LEVELS[library.level()]}
    command = [sys.executable, "-W", "ignore", str(script), str(tmp_path), str(count), str(order)]
    done = subprocess.run(command, env={**os.environ, **level}, stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.splitlines() == expected()


@pytest.mark.verify
def test_parts_are_the_same_for_all_levels(tmp_path: Path):
    """What is compiled for a processor that this one is not: the same code in the same files, up to the last pass."""
    compiled = {}
    for level, features in LEVELS.items():
        folder = tmp_path / level
        folder.mkdir()
        (folder / "sources").write_text(source_hash())
        (folder / "groups.json").write_text('{"some": ["settle_range", "fit_range"]}')
        switches = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": features, "LOEWNER_CACHE_DIR": str(folder)}
        command = [sys.executable, str(NATIVE / "emit.py"), str(folder), level, "0"]
        subprocess.run(command, env=os.environ | switches, check=True, stdout=subprocess.DEVNULL)
        files = [path for path in (folder / "kernels").iterdir() if ".o-" not in path.name]
        compiled[level] = {path.name: pickle.loads(_sealed.read(path))[1][2] for path in files}
    first, *others = compiled.values()
    assert len(first) > 300
    assert all(other == first for other in others)


@pytest.mark.verify
@pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs cc and LD_PRELOAD")
def test_another_c_library_answers_the_same(tmp_path: Path):
    """With sines, powers and logarithms that are one unit in the last place off."""
    source, to = Path(__file__).with_name("another_libm.c"), tmp_path / "libm.so"
    subprocess.run(["cc", "-O2", "-fno-builtin", "-shared", "-fPIC", "-o", to, source, "-ldl"], check=True)
    probe = [sys.executable, "-c", "import math; print(math.sin(1.0).hex())"]
    off = subprocess.run(probe, env={**os.environ, "LD_PRELOAD": str(to)}, capture_output=True, text=True, check=True)
    own = subprocess.run(probe, capture_output=True, text=True, check=True)
    assert off.stdout != own.stdout, "the other library must be in use, or nothing is tested"
    assert printed({"LD_PRELOAD": str(to)}) == expected()


@pytest.mark.verify
def test_numba_answers_the_same(tmp_path: Path):
    """Compiled by Numba, for an older processor than most."""
    older = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+fma,+avx2"}
    assert printed({"LOEWNER_JIT": "1", "LOEWNER_CACHE_DIR": str(tmp_path), **older}) == expected()
