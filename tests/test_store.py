"""Keys of compiled code: an edit of any file that a kernel may depend on changes its key, and no other edit does."""

import ast
import os
import threading
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from numba import types
from numba.core.registry import cpu_target

from loewner._kernels import _jit, _parts, _store, linalg3
from loewner._kernels.robots import planning
from loewner._kernels.simd.vectors import vector

KERNELS = Path(_store.__file__).parent
CODEGEN = cpu_target.target_context.codegen()


@cache
def imported(path: str) -> list[str]:
    """Kernel modules that a source imports, by Python's own parser."""
    found = []
    for node in ast.walk(ast.parse((KERNELS / f"{path}.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("loewner._kernels"):
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
    return found


def behind(start: str) -> set[str]:
    """All modules that a module imports, and those that these import."""
    found, waiting = set(), [start]
    while waiting:
        path = waiting.pop().removeprefix("loewner._kernels.").replace(".", "/")
        if path not in found and (KERNELS / f"{path}.py").is_file():
            found.add(path)
            waiting += imported(path)
    return found


@pytest.mark.light
@pytest.mark.parametrize("path", sorted(path.relative_to(KERNELS) for path in KERNELS.rglob("*.py")), ids=str)
def test_all_that_a_module_imports_is_behind_it(path: Path):
    """As Python's parser finds it, also across several lines, and with the files that every kernel may depend on."""
    name = path.with_suffix("").as_posix()
    always = set().union(*(behind(one) for one in _store.ALWAYS))
    assert _store.modules_behind(f"loewner._kernels.{name.replace('/', '.')}") == behind(name) | always


@pytest.mark.light
def test_a_module_elsewhere_may_depend_on_everything():
    """For a kernel of a test or of a user, all sources count."""
    everything = {path.relative_to(KERNELS).with_suffix("").as_posix() for path in KERNELS.rglob("*.py")}
    assert _store.modules_behind("tests.test_store") == everything


class Record(NamedTuple):
    first: float
    second: float


def key(kernel: object, *kinds: types.Type) -> str:
    return kernel._cache._key(kinds, CODEGEN)


@pytest.fixture
def edited(monkeypatch: pytest.MonkeyPatch):
    """A function that replaces the content of a source as an edit would, for keys that are made from then on."""

    def edit(path: str) -> None:
        texts = dict(_store._texts())
        texts[path] += b"\n# an edit\n"
        monkeypatch.setattr(_store, "_texts", lambda: texts)
        _store.hash_of.cache_clear()

    yield edit
    monkeypatch.undo()
    _store.hash_of.cache_clear()


three = types.UniTuple(types.float64, 3)


@pytest.mark.parametrize(
    ("file", "changes"),
    [
        ("linalg3", True),
        ("simd/vectors", True),
        ("_fused", True),
        ("narrow/certificate", False),
        ("robots/lines", False),
    ],
)
def test_an_edit_changes_the_keys_that_it_must(edited, file: str, changes: bool):
    """A product of tuples depends on its own file and on the operations of vectors, but on no file above it."""
    before = key(linalg3.dot, three, three)
    edited(file)
    assert (key(linalg3.dot, three, three) != before) == changes


def test_types_count(edited):
    """A kernel depends on the module of a named tuple that it is given, although it does not import that module."""
    tree = types.NamedTuple([types.float64, types.float64], planning.Trees)
    assert "robots/planning" not in _store.modules_behind(linalg3.dot.py_func.__module__)
    before = key(linalg3.dot, tree, tree), key(linalg3.dot, vector, vector)
    edited("robots/planning")
    assert key(linalg3.dot, tree, tree) != before[0]
    assert key(linalg3.dot, vector, vector) == before[1]
    local = types.NamedTuple([types.float64, types.float64], Record)
    assert key(linalg3.dot, local, local) not in before


def test_keys_differ_by_all_that_code_is_made_of(monkeypatch: pytest.MonkeyPatch):
    """Types, forms, functions in a closure and versions."""

    def of(number: float):
        @_jit.njit()
        def added(x):
            return x + number

        return added

    made = [
        key(of(1.0), types.float64), key(of(2.0), types.float64), key(of(1.0), types.int64),
        of(1.0)._for_python._cache._key((types.float64,), CODEGEN),
    ]  # fmt: skip
    assert len(set(made)) == len(made)
    assert key(of(1.0), types.float64) == made[0]
    monkeypatch.setattr(_jit, "MADE_WITH", "another Numba")
    assert key(of(1.0), types.float64) not in made


@pytest.mark.parametrize("restored", [False, True])
def test_a_call_of_a_kernel_that_is_not_imported_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, restored: bool
):
    """Its edits would go unnoticed: the kernel is refused when it is compiled, not when it is stale."""
    monkeypatch.setattr(_store, "FOLDER", tmp_path)
    monkeypatch.setattr(_jit._Cache, "_made", {})
    monkeypatch.setattr(_parts, "_read", {})
    monkeypatch.setattr(linalg3.dot, "overloads", {})
    if restored:
        _jit.njit()(linalg3.dot.py_func).compile((three, three))
        _jit._Cache._made.clear()
        _parts._read.clear()
        linalg3.dot.compile((three, three))
        assert linalg3.dot.stats.cache_hits

    def caller(x, y):
        return linalg3.dot(x, y)

    caller.__module__ = "loewner._kernels.columns"
    with pytest.raises(ImportError, match="columns calls a kernel of linalg3, which it does not import"):
        _jit.njit()(caller).compile((three, three))


def test_code_survives_an_edit_of_another_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, edited):
    """What was compiled before the edit is found after it, and gives the same answer."""
    monkeypatch.setattr(_store, "FOLDER", tmp_path)
    a, b = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    again = [_jit.njit()(linalg3.dot.py_func) for _ in range(2)]
    assert again[0](a, b) == 32.0
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    edited("robots/lines")
    assert again[1](a, b) == 32.0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written


def test_code_of_a_module_that_was_edited_before_its_import_is_not_kept(monkeypatch: pytest.MonkeyPatch, edited):
    """Modules are imported late; one that was edited after the sources were read would get the key of the old ones."""
    monkeypatch.setattr(_store, "_edited", [])
    module = linalg3.__name__
    _store.expect_as_read.__wrapped__(module)
    assert _store.is_usable()
    edited("linalg3")
    _store.expect_as_read.__wrapped__(module)
    assert not _store.is_usable()


def test_a_second_process_waits_and_finds_what_the_first_has_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """A claim is held while code is compiled; whoever comes meanwhile looks again, and what is there needs no claim."""
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(_store, "FOLDER", tmp_path)
    with (tmp_path / "key.claim").open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        order = []
        entered = threading.Event()

        def wait() -> None:
            entered.set()
            with _store.claimed("key"):
                order.append("second")

        waiting = threading.Thread(target=wait)
        waiting.start()
        entered.wait()
        waiting.join(0.2)
        order.append("first")
        fcntl.flock(other, fcntl.LOCK_UN)
        waiting.join()
    assert order == ["first", "second"]
    assert not (tmp_path / "key.claim").exists()
    _store.write("key", b"code")
    with _store.claimed("key"):
        assert [path.name for path in tmp_path.iterdir()] == ["key.kernel"]


def test_a_folder_that_cannot_be_written_needs_no_claim(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Code is then compiled in memory."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(_store, "FOLDER", tmp_path / "file" / "kernels")
    with _store.claimed("key"):
        pass


def test_kernels_of_equal_functions_share_a_part(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Whether or not it can be kept on disk: a name that is defined twice could not be linked."""

    def of(number: float):
        @_jit.njit()
        def added(x):
            return x + number

        return added

    (tmp_path / "file").touch()
    for folder, seconds in ((tmp_path / "kernels", 3.0), (tmp_path / "file" / "kernels", 5.0)):
        monkeypatch.setattr(_store, "FOLDER", folder)
        first, second = of(seconds), of(seconds)

        @_jit.njit()
        def both(x, first=first, second=second):
            return first(x) + second(x)

        assert both(1.0) == 2.0 * (1.0 + seconds)


def test_files_that_nothing_reads_are_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """After a month; a file that is read stays, whenever it was written."""
    monkeypatch.setattr(_store, "FOLDER", tmp_path)
    for key in ("read", "unread", "new"):
        _store.write(key, key.encode())
        if key != "new":
            os.utime(_store.path_of(key), (0.0, time.time() - 1.1 * _store.KEPT))
    assert _store.read("read") == b"read"
    _store.remove_unused()
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["new", "read"]
    monkeypatch.setattr(_store, "FOLDER", tmp_path / "none")
    _store.remove_unused()
