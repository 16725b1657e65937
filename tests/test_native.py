"""The native library: what it relies on in Numba, when it is refused, how its functions take what they are given."""

import ctypes
import inspect
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import threading
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import loewner
import small_kernels
from loewner._kernels import _parts, _store, columns, records
from loewner._kernels._sources import source_hash
from loewner._native import entries, library
from loewner.errors import InputError, MissingExtraError
from native_files import NATIVE, module, needs_library


@pytest.fixture(scope="module")
def emit():
    return module("emit")


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of what was built, which the library is looked for in."""
    for path in [library.HOME / library.LIST, *library.HOME.glob("*.so"), *library.HOME.glob("*.ptx.z")]:
        shutil.copy(path, tmp_path)
    monkeypatch.setattr(library, "HOME", tmp_path)
    monkeypatch.delitem(sys.modules, "loewner._native._call", raising=False)
    monkeypatch.delenv("LOEWNER_JIT", raising=False)
    monkeypatch.delenv("LOEWNER_LEVEL", raising=False)
    library._opened.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    library._opened.cache_clear()


def relist(folder: Path, **changes) -> None:
    """Change the list of what was built."""
    built = json.loads((folder / library.LIST).read_text())
    (folder / library.LIST).write_text(json.dumps(built | changes))


def sum_of(path: Path) -> str:
    import hashlib

    return hashlib.sha256(path.read_bytes()).hexdigest()


# -- what the build relies on in Numba -------------------------------------------------------------


def test_the_installed_numba_lays_arrays_and_memory_out_as_the_build_expects(emit):
    """Fields of arrays, and where a description of memory holds its count, address and size."""
    emit.check_numba()


@pytest.mark.parametrize(("name", "value"), [("DATA", 16), ("MEMORY_SIZE", 0), ("FIELDS", ("data", "shape"))])
def test_another_layout_fails_at_build_time(emit, monkeypatch, name, value):
    """A build with a Numba that lays memory out otherwise stops with a reason."""
    monkeypatch.setattr(emit, name, value)
    with pytest.raises(SystemExit, match="Numba"):
        emit.check_numba()


def test_references_to_arguments_are_counted_only_where_they_are_handed_on(emit):
    """Arguments that are only passed on lose their counts; those that are stored, and what is made, keep them."""
    count = "  tail call void @NRT_{}ref(ptr {})"
    kept = [count.format(way, name) for way in ("inc", "dec") for name in ("%stored", "%made", "%mixed")]
    gone = [count.format(way, "%passed") for way in ("inc", "dec")]
    before = ["define i32 @f(ptr %out, ptr captures(none) %passed, ptr %stored, ptr %mixed) #1 {", "entry:"]
    before += ["  %made = tail call ptr @NRT_new(i64 8)", "  %is = icmp eq ptr %passed, null"]
    after = ["  %called = tail call i32 @g(ptr %passed)", "  store ptr %stored, ptr %out, align 8"]
    after += ["  %both = phi ptr [ %made, %entry ], [ %mixed, %other ]", "  ret i32 0", "}", ""]
    text = "\n".join([*before, *kept, *gone, *after])
    assert emit.uncounted(text) == "\n".join([*before, *kept, *after])


def test_every_entry_has_the_signature_that_the_table_says(emit):
    """Names are kernels of the modules named, with as many arguments as the table lists."""
    from importlib import import_module

    for entry in entries.ENTRIES.values():
        kernel = getattr(import_module(f"loewner._kernels.{entry.module}"), entry.name)
        assert kernel.py_func.__code__.co_argcount == len(emit.types_of(entry.arguments)), entry.name


@needs_library
def test_library_needs_nothing_but_libc_and_libm():
    """No symbol of Python, NumPy or Numba: the library does not depend on their versions."""
    path = library.HOME / f"kernels-{library.level()}.so"
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    listed = subprocess.run(["nm", "-D", "--undefined-only", str(path)], capture_output=True, text=True, check=True)
    needed = {line.split()[-1].split("@")[0] for line in listed.stdout.splitlines()}
    assert {"free", "aligned_alloc"} <= needed, "or nothing was read"
    assert not [name for name in needed if name.startswith(("Py", "_Py", "NRT", "numba", "_ZN"))]


@pytest.mark.skipif((platform.system(), platform.machine()) != ("Linux", "x86_64"), reason="expected Linux on x86-64")
@needs_library
def test_levels_are_those_that_the_processor_and_the_system_support():
    """The extension asks the processor itself; Linux lists the same, by names of its own."""
    found = re.findall(r"^flags\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    flags = set(found[0].split())
    v3 = flags >= {"avx", "avx2", "fma", "bmi1", "bmi2", "popcnt", "f16c", "abm", "movbe"}
    v4 = v3 and flags >= {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
    assert library.levels() == ("x86-64-v4",) * v4 + ("x86-64-v3",) * v3


@needs_library
def test_the_extension_is_for_all_pythons():
    """No private symbol but those of the stable interface, which macros use and every later Python has."""
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    command = ["nm", "-D", "--undefined-only", str(library.HOME / library.CALL)]
    listed = subprocess.run(command, capture_output=True, text=True, check=True)
    private = {name for name in (line.split()[-1] for line in listed.stdout.splitlines()) if name.startswith("_Py")}
    stable = {"_Py_NoneStruct", "_Py_TrueStruct", "_Py_FalseStruct", "_Py_Dealloc", "_Py_BuildValue_SizeT"}
    stable |= {"_PyArg_ParseTuple_SizeT", "_PyArg_ParseTupleAndKeywords_SizeT"}
    assert private <= stable
    assert "PyType_FromModuleAndSpec" in listed.stdout, "or nothing was read"


# -- how processes share the work of a build -------------------------------------------------------


def test_a_build_hands_out_what_is_done_and_prints_what_it_does(tmp_path, capsys, monkeypatch):
    """Objects are handed out as they appear; what is being compiled is printed, and so is why it cannot be."""
    build = module("build")
    monkeypatch.setattr(build, "EVERY", 0.0)
    objects = [tmp_path / f"level-{name}.o" for name in ("one", "two")]
    code = "import pathlib, sys, time; print('one', flush=True); pathlib.Path(sys.argv[1]).touch(); time.sleep(0.5)"
    workers = [build.Command("work", ["-c", code, str(path)], {}, tmp_path / path.stem) for path in objects]
    handed = []
    build.build_all(workers, objects, handed.append)
    assert handed[-1] == objects
    assert [len(made) for made in handed] in ([2], [1, 2])
    said = capsys.readouterr().err
    assert re.search(r"native library: +\d+ s, about \d+ s left: one", said)
    broken = build.Command("kernels for a level", ["-c", "raise SystemExit('of no use')"], {}, tmp_path / "broken")
    with pytest.raises(build.BuildError, match="kernels for a level: a process ended with status 1:\nof no use"):
        build.build_all([broken], [])


def test_every_kernel_is_in_one_group():
    """A kernel in none would be missing, one in two would be defined twice."""
    build = module("build")
    for names in (list(build.GROUPS), ["all"]):
        groups = build.grouped(names)
        assert list(groups) == names
        assert sorted(name for group in groups.values() for name in group) == sorted(entries.ENTRIES)
        assert all(groups.values())


@pytest.mark.parametrize("number", [0, 1, 2])
def test_processes_share_the_work(emit, tmp_path, monkeypatch, number):
    """Each file is made once, objects after the code of their entries; groups that can wait come last."""
    groups = {"first": ["one", "two"], "second": ["three"], "third": ["six"], "last": ["four", "five"]}
    (tmp_path / "groups.json").write_text(json.dumps(groups))
    made = []

    def write(to, *needed):
        assert all(path.exists() for path in needed)
        made.append(to.name)
        to.touch()

    monkeypatch.setattr(emit, "ENTRIES", {name: name for group in groups.values() for name in group})
    monkeypatch.setattr(emit, "write_code", lambda entry, to: write(to))
    monkeypatch.setattr(emit, "write_object", lambda codes, before, to: write(to, *before, *codes))
    assert emit.is_mine(tmp_path / "one.code")  # by another process, which writes it now
    (tmp_path / "one.code").touch()
    lowered = []
    monkeypatch.setattr(os, "nice", lambda by: lowered.append((by, len(made))))
    emit.work(tmp_path, "x86-64-v3", number, 19, "last")
    codes = [f"{name}.code" for name in ("two", "three", "six", "four", "five")]
    assert sorted(made) == sorted([*codes, *(f"x86-64-v3-{name}.o" for name in groups)])
    assert made[0] == ("two.code", "three.code", "three.code")[number]
    # Once, when only groups that can wait are left; the third process ends with another group.
    assert lowered == ([] if number == 2 else [(19, 6)])
    emit.work(tmp_path, "x86-64-v3", number, 19, "last")
    assert len(made) == 9


@pytest.mark.parametrize("number", [0, 1])
def test_nothing_is_compiled_while_an_earlier_group_can_be_finished(emit, tmp_path, monkeypatch, number):
    """Two processes wait for each other's first codes, since a long function would delay their objects."""
    groups = {"first": ["one"], "second": ["two"], "third": ["three"]}
    (tmp_path / "groups.json").write_text(json.dumps(groups))
    monkeypatch.setattr(emit, "ENTRIES", {name: name for group in groups.values() for name in group})
    monkeypatch.setattr(emit, "write_code", lambda entry, to: to.touch())
    monkeypatch.setattr(emit, "write_object", lambda codes, before, to: to.touch())
    other = tmp_path / ("two.code", "one.code")[number]
    assert emit.is_mine(other)  # The other process writes this code, and has written it when this process has waited.
    monkeypatch.setattr(emit.time, "sleep", lambda seconds: other.touch())
    order = []
    monkeypatch.setattr(emit, "say", order.append)
    emit.work(tmp_path, "v3", number)
    assert order == [("one", "two")[number], "v3-first", "v3-second", "three", "v3-third"]


COPYING = f"""
import os, sys
sys.path[:0] = {[str(NATIVE), str(NATIVE.parent / "tests")]}
import emit, multiprocessing, pathlib, time
emit.work = lambda path, task: (pathlib.Path(path).write_text(str(os.getpid())), eval(task))
emit.in_processes(os.getppid(), [("a", sys.argv[1]), ("b", sys.argv[2])])
print(os.getpid())
"""


@pytest.mark.skipif(not module("build").COPIES, reason="copies of processes are made on Linux only")
@pytest.mark.parametrize(("first", "second"), [("0", "0"), ("time.sleep(3600)", "sys.exit(3)"), ("0", "os._exit(3)")])
def test_a_process_copies_itself_and_ends_when_a_copy_fails(tmp_path, first, second):
    """Each share is done by a copy of its own; a failure ends the other copies, and nobody waits for them."""
    command = [sys.executable, "-c", COPYING, first, second]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if "exit" in second:
        assert done.returncode == 1
        assert "a copy of the process has failed; its status: 3" in done.stderr
    else:
        assert len({done.stdout.strip(), *((tmp_path / name).read_text() for name in "ab")}) == 3
    for name in "ab":
        assert not (tmp_path / name).exists() or has_ended(int((tmp_path / name).read_text()))


@pytest.mark.skipif(not module("build").COPIES, reason="copies of processes are made on Linux only")
@pytest.mark.parametrize(("first", "is_interrupted"), [("time.sleep(3600)", True), ("sys.exit(3)", False)])
def test_all_copies_end_with_a_build_that_ends(tmp_path, first, is_interrupted):
    """Neither a build that is interrupted nor one whose first process has failed leaves a process that compiles on."""
    build, object_file = module("build"), tmp_path / "level-one.o"
    code = (
        "import os, pathlib, sys, time; copy = os.fork(); path = pathlib.Path(sys.argv[1] + 'art')\n"
        "if copy: path.write_text(f'{os.getpid()} {copy}'); path.rename(sys.argv[1])\n"
        f"{first} if copy else time.sleep(3600)"
    )

    def hand_out(made):
        if is_interrupted:
            raise KeyboardInterrupt

    work = build.Command("work", ["-c", code, str(object_file)], {}, tmp_path / "work")
    with pytest.raises(KeyboardInterrupt if is_interrupted else build.BuildError):
        build.build_all([work], [object_file], hand_out)
    assert all(has_ended(int(number)) for number in object_file.read_text().split())


def test_a_second_build_in_the_background_does_not_wait(tmp_path, monkeypatch):
    """Only if another process builds the present sources; those of a build that was killed do not count."""
    build = module("build")
    monkeypatch.setattr(build, "HOME", tmp_path)
    sources = tmp_path / ".build-1" / "sources"
    sources.parent.mkdir()
    told = []
    for is_running, text in ((True, source_hash()), (True, "0" * 64), (False, source_hash())):
        monkeypatch.setattr(build, "is_being_built", lambda is_running=is_running: is_running)
        sources.write_text(text)
        told.append(build.is_begun_elsewhere(tmp_path))
    assert told == [True, False, False]
    monkeypatch.setattr(build, "is_being_built", lambda: True)
    sources.unlink()
    sources.symlink_to(tmp_path / "removed meanwhile")
    assert not build.is_begun_elsewhere(tmp_path)


def test_an_interrupted_build_says_so_and_removes_what_others_left(tmp_path, monkeypatch, capsys):
    """One line instead of a traceback; a folder of a build that was killed does not stay for good."""
    build = module("build")

    def interrupt(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(build, "HOME", tmp_path)
    monkeypatch.setattr(build, "machine_level", interrupt)
    monkeypatch.setattr(build.signal, "signal", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["build.py", "--to", str(tmp_path)])
    (tmp_path / ".build-1").mkdir()
    assert build.main() == 130
    assert capsys.readouterr().err == "native library: interrupted\n"
    assert not list(tmp_path.glob(".build-*"))


def has_ended(number: int) -> bool:
    """Whether a process has ended; one that was killed may take a moment."""
    for _ in range(600):
        state = Path(f"/proc/{number}/stat")
        if not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.05)
    return False


def test_processes_begin_at_different_places(emit):
    """Two begin with the first two groups, which are soon complete; the others begin at the groups in turn."""
    groups = {"first": [*"ab"], "second": [*"cd"], "third": ["e"], "last": [*"fg"]}
    orders = ["".join(emit.in_order(groups, number, ("last",))) for number in range(7)]
    assert orders == ["abcdefg", "dcbaegf", "cdabfge", "bagfedc", "fgecdab", "edcbagf", "cdabfge"]


def test_a_process_that_comes_after_an_edit_does_not_share_the_work(emit, tmp_path):
    """Its code would be kept under keys of other sources, and used again when the edit is undone."""
    (tmp_path / "sources").write_text(source_hash())
    emit.expect_sources(tmp_path)
    (tmp_path / "sources").write_text("1" * 64)
    with pytest.raises(SystemExit, match="sources changed while they were compiled"):
        emit.expect_sources(tmp_path)


def test_objects_are_made_once(emit, tmp_path, monkeypatch):
    """From the store, unless a part or a shim has changed."""
    monkeypatch.setattr(_store, "FOLDER", tmp_path / "store")
    code, to = tmp_path / "irrationals.code", tmp_path / "object.o"
    emit.write_code(entries.ENTRIES["irrationals"], code)
    emit.write_object([code], [], to)
    made = to.read_bytes()
    assert b"loewner_irrationals" in made
    to.unlink()
    monkeypatch.setattr(emit, "machine_code", lambda parts, shims: b"made anew")
    emit.write_object([code], [], to)
    assert to.read_bytes() == made
    changed = json.loads(code.read_text())
    code.write_text(json.dumps(changed | {"shim": changed["shim"] + "\n; another"}))
    emit.write_object([code], [], to)
    assert to.read_bytes() == b"made anew"


SMALL = [library.Entry("small", name, "F1", "f") for name in ("total_of", "twice_of")]
PLACING = [entries.ENTRIES[name] for name in ("link_poses", "link_jacobians")]


@needs_library
@pytest.mark.parametrize(
    ("some", "called"), [(SMALL, "add_up"), pytest.param(PLACING, "place_links", marks=pytest.mark.verify)]
)
def test_what_is_apart_is_in_the_first_object_that_calls_it(emit, tmp_path, monkeypatch, some, called):
    """Both entries call a function; the second object needs the first, and defines nothing twice."""
    build = module("build")
    monkeypatch.setattr(_store, "FOLDER", tmp_path / "store")
    monkeypatch.setitem(sys.modules, "loewner._kernels.small", small_kernels)
    codes = [tmp_path / f"{entry.name}.code" for entry in some]
    for entry, code in zip(some, codes, strict=True):
        emit.write_code(entry, code)
    objects = [tmp_path / "first.o", tmp_path / "second.o"]
    emit.write_object(codes[:1], [], objects[0])
    emit.write_object(codes[1:], codes[:1], objects[1])
    assert all(called.encode() in path.read_bytes() for path in objects)
    build.link(objects, library.level(), tmp_path / "both.so")
    with pytest.raises(build.BuildError, match=called):
        build.link(objects[1:], library.level(), tmp_path / "second.so")


def test_modules_linked_in_chunks_are_those_linked_in_a_line(monkeypatch):
    """No function is lost or defined twice, however many are linked at a time."""
    import llvmlite.binding as llvm

    def modules():
        names = [f"f{number}" if number % 3 else f'"f <{number}>"' for number in range(100)]
        for number, name in enumerate(names):
            called = [other for other in (names[-number - 1], names[number // 2]) if other != name]
            declared = "".join(f"declare double @{other}(double)\n" for other in dict.fromkeys(called))
            calls = "".join(f"  %y{n} = call double @{other}(double %x)\n" for n, other in enumerate(called))
            yield llvm.parse_assembly(f"{declared}define double @{name}(double %x) {{\n{calls}  ret double %x\n}}\n")

    first, *others = modules()
    for other in others:
        first.link_in(other)
    for size in (1000, 32, 3):
        monkeypatch.setattr(_parts, "CHUNK", size)
        linked = _parts.in_one(list(modules()))
        assert sorted(one.name for one in linked.functions) == sorted(one.name for one in first.functions)
        assert str(linked).count("define") == str(first).count("define") == 100


# -- what is refused -------------------------------------------------------------------------------


@needs_library
def test_a_whole_copy_is_taken(copied):
    """The copy that the tests below damage would be loaded."""
    assert library.level() is not None
    assert library.why_not() == ""


@needs_library
@pytest.mark.parametrize("which", ["kernels", "_call"])
def test_a_damaged_file_is_refused(copied, which):
    """One bit of difference: the library is not loaded, and the reason says which file it is."""
    for path in copied.glob(f"{which}*.so"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    assert library.level() is None
    assert "damaged" in library.why_not()


@needs_library
def test_a_damaged_library_is_built_anew(copied):
    """What would be refused does not count as built."""
    build, level = module("build"), library.level()
    relist(copied, recipe=build.recipe())
    assert build.is_built([level], copied)
    path = copied / f"kernels-{level}.so"
    content = path.read_bytes()
    path.unlink()  # it is loaded: written over, it would change under the process
    path.write_bytes(content + b"x")
    assert not build.is_built([level], copied)
    path.unlink()
    assert not build.is_built([level], copied)


@pytest.fixture
def growing(copied):
    """Functions that begin and end a build in the folder of `copied`, and list the entries that are there."""
    fcntl = pytest.importorskip("fcntl")
    whole = json.loads((copied / library.LIST).read_text())
    (best,) = (path for path in copied.glob(f"kernels-{library.level()}.so"))
    library._opened.cache_clear()
    lock = (copied / library.LOCK).open("wb")

    def listed(names: list[str] | None) -> None:
        """List some kernels under a name of their own, or all."""
        if names is None:
            (copied / library.LIST).write_text(json.dumps(whole))
            return
        early = best.with_name(f"{best.stem}-{len(names)}.so")
        shutil.copy(best, early)
        files = {library.CALL: whole["files"][library.CALL], early.name: whole["files"][best.name]}
        text = json.dumps({key: whole[key] for key in ("sources", "numba")} | {"files": files, "entries": names})
        (copied / "list").write_text(text)
        os.replace(copied / "list", copied / library.LIST)

    fcntl.flock(lock, fcntl.LOCK_EX)
    (copied / library.LIST).unlink()
    yield listed, lock.close
    lock.close()


@needs_library
def test_a_library_that_is_being_built_is_waited_for(growing, capsys, monkeypatch):
    """First for any kernel, then for the one that is needed; it is said once each time."""
    listed, end = growing
    monkeypatch.setattr(library, "POLL", 0.01)
    monkeypatch.delenv("LOEWNER_QUIET", raising=False)
    first, second, third = (entries.ENTRIES[name] for name in ("first_fault", "workspace_size", "motion_memory"))
    assert library.is_being_built()
    later = threading.Timer(0.2, listed, [["first_fault"]])
    later.start()
    assert library.kernel(first) is not None
    assert library.level() is not None
    assert library.is_missing(second)
    assert capsys.readouterr().err == "loewner: waiting for the native library, which is being built ...\n"
    later = threading.Timer(0.2, listed, [["first_fault", "workspace_size"]])
    later.start()
    assert library.kernel(second)() > 0
    assert capsys.readouterr().err.count("waiting") == 1
    later = threading.Timer(0.2, lambda: (listed(None), end()))
    later.start()
    assert library.kernel(third) is not None
    assert not library.is_missing(third)
    assert not library.is_being_built()
    later.join()


@needs_library
def test_a_build_that_ends_early_leaves_the_rest_to_numba(growing):
    """What was handed out stays in use; a kernel that was not is compiled elsewhere."""
    listed, end = growing
    listed(["first_fault"])
    assert library.kernel(entries.ENTRIES["first_fault"]) is not None
    end()
    assert library.kernel(entries.ENTRIES["workspace_size"]) is None
    assert library.kernel(entries.ENTRIES["first_fault"]) is not None


@needs_library
def test_a_build_that_fails_before_all_leaves_everything_to_numba(growing):
    """Waiting ends with the build."""
    _, end = growing
    threading.Timer(0.2, end).start()
    assert library.level() is None
    assert library.why_not() == "it was not built"


@needs_library
def test_the_library_has_not_grown():
    """Neither its functions nor its size by more than a tenth, unless a line in `native/growth.txt` says why."""
    built = json.loads((library.HOME / library.LIST).read_text())
    count, level, size, _ = (NATIVE / "growth.txt").read_text().splitlines()[-1].split(maxsplit=3)
    assert built["functions"] <= 1.1 * int(count)
    if library.level() == level:
        assert (library.HOME / f"kernels-{level}.so").stat().st_size <= 1.1 * int(size)


STRUCT = re.compile(r"^struct (\w+) \{\n(.*?)^\};", re.M | re.S)  # name and fields


def test_structs_for_c_are_the_signatures_of_the_kernels():
    """A struct has as many fields as a signature has words, of their types; the header lists kernels and words."""
    text = module("headers").text()
    structs = {name: re.findall(r"^ +(.*) \w+;$", fields, re.M) for name, fields in STRUCT.findall(text)}
    types = {"i": {"int64_t", "void *"}, "b": {"int64_t"}, "f": {"double"}}
    for entry in entries.ENTRIES.values():
        assert f'#define {entry.name.upper()}_WORDS "{entry.arguments}", "{entry.results}"\n' in text
        assert f" X({entry.name})" in text
        takes, gives = entry.arguments.split(), entry.results.split()
        for name, words, array in (
            (entry.name, takes, "Array"),
            (f"{entry.name}_results", gives[1:] and gives, "Given"),
        ):
            found = zip(structs.pop(name, []), words, strict=True)
            assert all(kind in types.get(word, {array + word[-1]}) for kind, word in found), name
    assert {name: len(fields) for name, fields in structs.items()} == {
        "pieces": 12,
        "problem": 14,
        "motion_tables": 10,
        "search": 13,
    }
    assert records.MOTIONS == 8 * records.ENTRIES * 14


def test_names_and_numbers_for_c_are_those_of_the_modules():
    """The header reads them from sources; Python finds them in the modules, which import Numba."""
    from loewner._kernels.robots import brakes
    from loewner._kernels.trees import boxes, triangle_tree

    headers = module("headers")
    for imported, read in (
        (boxes, headers.numbers_of("trees/boxes.py", WIDE=columns.WIDE)),
        (triangle_tree, headers.numbers_of("trees/triangle_tree.py")),
    ):
        assert all(value == getattr(imported, name) for name, value in read.items())
    fields = re.findall(r"(\w+);", dict(STRUCT.findall(headers.text()))["brakes_by_joint"])
    assert fields == list(inspect.signature(brakes.brakes_by_joint.py_func).parameters)


@needs_library
def test_a_library_of_other_sources_is_refused(copied):
    """An edit of a kernel leaves the library aside, and Numba compiles what was edited."""
    relist(copied, sources="0" * 64)
    assert library.level() is None
    assert "other sources" in library.why_not()


@needs_library
def test_a_foreign_library_is_refused(copied):
    """A file in the list, with its sum, that says of itself that it was built from something else."""
    built = json.loads((copied / library.LIST).read_text())
    best = next(name for name in library.levels() if f"kernels-{name}.so" in built["files"])
    foreign = copied / f"kernels-{best}.so"
    mine = built["sources"].encode()
    content = foreign.read_bytes()
    assert content.count(mine) == 1
    foreign.write_bytes(content.replace(mine, b"1" * len(mine)))
    relist(copied, files=built["files"] | {foreign.name: sum_of(foreign)})
    library._opened.cache_clear()
    assert library.level() is None
    assert "expected a library built from" in library.why_not()


@needs_library
@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b'{"sources": 1', b"\xff\xfe"])
def test_a_broken_list_is_refused(copied, content):
    """What was built is not guessed."""
    (copied / library.LIST).write_bytes(content)
    assert library.level() is None
    assert library.LIST in library.why_not()


@needs_library
@pytest.mark.parametrize("files", [[], "text", None, 3, {"a": 1}])
def test_a_list_of_odd_types_is_refused(copied, files):
    """What is not as it was written is left aside, whatever it is."""
    relist(copied, files=files)
    assert library.level() is None
    assert library.why_not()


@needs_library
def test_a_list_nested_too_deep_is_refused(copied):
    """No more than any other broken list."""
    (copied / library.LIST).write_text("[" * 100_000)
    assert library.level() is None


@needs_library
def test_nothing_built_for_this_processor_is_told(copied, monkeypatch):
    """The reason names what the processor runs and what was built."""
    built = json.loads((copied / library.LIST).read_text())
    relist(copied, files={name: value for name, value in built["files"].items() if name.startswith("_call")})
    assert library.level() is None
    assert "this processor runs" in library.why_not()


@needs_library
def test_wrong_settings_are_errors(copied, monkeypatch):
    """A typing mistake in an environment variable does not quietly choose another path."""
    monkeypatch.setenv("LOEWNER_JIT", "yes")
    with pytest.raises(InputError, match="LOEWNER_JIT: expected 0 or 1"):
        library.level()
    monkeypatch.setenv("LOEWNER_JIT", "0")
    monkeypatch.setenv("LOEWNER_LEVEL", "x86-64-v9")
    with pytest.raises(InputError, match="LOEWNER_LEVEL"):
        library.level()


def test_neither_library_nor_numba_says_what_to_install(monkeypatch):
    """The first kernel asked for raises an error that names the extra."""
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.setattr(library, "_opened", lambda: (None, "for a test"))
    monkeypatch.delitem(vars(entries), "first_fault", raising=False)
    with pytest.raises(MissingExtraError, match=r"loewner\[jit\]"):
        entries.first_fault  # noqa: B018


# -- how arguments are taken -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def native():
    """A kernel of the library for each name."""
    opened, _ = library._opened()
    if opened is None:
        pytest.skip(f"no native library here: {library.why_not()}")
    return lambda name: opened.kernel(name, entries.ENTRIES[name].arguments, entries.ENTRIES[name].results)


@pytest.mark.parametrize(
    "poses",
    [
        np.eye(4),
        np.eye(4, dtype=np.float32)[None],
        np.eye(4)[None].astype(">f8"),
        np.tile(np.eye(4), (4, 1, 1))[::2],
        np.eye(4)[None].transpose(0, 2, 1),
        np.frombuffer(np.eye(4)[None].tobytes()).reshape(1, 4, 4),
        [[1.0]],
        None,
    ],
    ids=["axes", "float32", "swapped", "strided", "fortran", "read-only", "list", "none"],
)
def test_an_array_of_another_kind_is_refused(native, poses):
    """A kernel takes arrays of its type and number of axes, in C order, writeable unless it says otherwise."""
    with pytest.raises(TypeError, match="first_fault: argument 1"):
        native("first_fault")(poses)


def test_a_kernel_keeps_its_library_and_is_told_from_other_functions(native):
    """It is a builtin function, which the interpreter calls fastest; what takes kernels takes no other function."""
    kernel = native("first_fault")
    assert kernel.__name__ == "first_fault"
    assert kernel.__self__.__class__.__name__ == "Kernel"
    with pytest.raises(TypeError, match="no keyword arguments"):
        kernel(poses=np.eye(4)[None])
    with pytest.raises(TypeError, match="cannot create"):
        type(kernel.__self__)()
    with pytest.raises(OSError, match="expected a function loewner_no_such, found none"):
        library._opened()[0].kernel("no_such", "i", "")
    call = library.extension()
    for other in (len, [].append, None, kernel.__self__):
        with pytest.raises(TypeError, match="expected kernels of the library"):
            call.Pairs(other, kernel, kernel, kernel, 0, 0)


@pytest.mark.parametrize("given", [(), (np.eye(4)[None],) * 2])
def test_another_number_of_arguments_is_refused(native, given):
    """No argument is left to chance."""
    with pytest.raises(TypeError, match="expected 1 arguments"):
        native("first_fault")(*given)


def test_numbers_are_taken_as_python_takes_them(native):
    """Integers of NumPy pass for integers, integers for floats; a float is no integer."""
    fit = native("to_unit_size")
    points = np.vstack([np.eye(3), -np.eye(3)])
    assert fit(points, 1)[0] == fit(points, 1.0)[0]
    curve = native("memory_size")
    with pytest.raises(TypeError):
        curve(1.5, 1, 1)
    with pytest.raises(OverflowError):
        curve(2**64, 1, 1)


@pytest.mark.verify  # Numba compiles the kernels with which it compares
def test_results_are_as_from_numba(native):
    """Numbers, flags and arrays come back with the same values and types as from the compiled function."""
    from loewner._kernels.fits import hulls
    from loewner._kernels.pieces import rigid

    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3))
    for kernel, arguments in (
        (hulls.to_unit_size, (points, 1e-12)),
        (rigid.first_fault, (rng.normal(size=(5, 4, 4)),)),
    ):
        ours, theirs = native(kernel.__name__)(*arguments), kernel(*arguments)
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert type(one) is type(other)
            np.testing.assert_array_equal(one, other)
            if isinstance(one, np.ndarray):
                assert one.dtype == other.dtype
                assert one.flags.owndata
                assert one.flags.writeable


def held() -> int:
    """How many arrays of kernels are not given back."""
    opened = ctypes.CDLL(str(library.HOME / f"kernels-{library.level()}.so"))  # the one that is open already
    return ctypes.c_size_t.in_dll(opened, "loewner_held").value


def test_results_leave_no_memory_behind(native):
    """Every array that a kernel made is given back by the time it returns, and the copies when nobody has them."""
    points = np.random.default_rng(0).normal(size=(300, 3))
    corners, ball = np.tile(points[:100], (3, 1)), loewner.Body.from_points(points)
    calls = {
        "to_unit_size": lambda: native("to_unit_size")(points, 1e-12),
        "direction_map": lambda: native("direction_map")(points),
        "equal_vertices": lambda: native("equal_vertices")(corners),
        "triangle_tree": lambda: native("triangle_tree")(points, np.arange(300).reshape(100, 3)),
        "curve_order": lambda: native("curve_order")(points, points + 1.0),
        "distances": lambda: loewner.distance(ball, None, ball, np.tile(np.eye(4), (40, 1, 1)), exact=True),
    }
    copies = tracemalloc.DomainFilter(inclusive=True, domain=np.lib.tracemalloc_domain)
    for name, call in calls.items():
        call()  # what is kept from the first call on
        before = held()
        tracemalloc.start()
        try:
            result = call()
            assert held() == before, name
            del result
            left = tracemalloc.take_snapshot().filter_traces([copies])
        finally:
            tracemalloc.stop()
        assert not left.traces, (name, *left.traces)


@needs_library
def test_the_build_string_is_what_the_loader_asks_for():
    """Sources and level, as a text in the library."""
    loaded = ctypes.CDLL(str(library.HOME / f"kernels-{library.level()}.so"))
    text = ctypes.c_char_p(ctypes.addressof(ctypes.c_char.in_dll(loaded, "loewner_build"))).value.decode()
    assert text == f"{library.source_hash()} {library.level()}"


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("compiler", "expected a C compiler, found no /nowhere/cc .*; install gcc or clang, or set CC"),
        ("headers", r"expected the headers of Python, found no /nowhere/Python.h; install them \(python3-dev\)"),
        pytest.param("folder", ".*Not a directory: .*", marks=pytest.mark.verify),
    ],
)
def test_a_build_tells_in_one_line_what_is_missing(missing, message, tmp_path):
    """Without a compiler, Python's headers or a folder that can be written, the build ends with 1 and no traceback."""
    pytest.importorskip("numba")
    (tmp_path / "sitecustomize.py").write_text(
        "import sysconfig\nreal = sysconfig.get_path\n"
        "sysconfig.get_path = lambda name, *rest: '/nowhere' if name == 'include' else real(name, *rest)\n"
        if missing == "headers"
        else ""
    )
    (tmp_path / "a file").write_text("")
    place = tmp_path / ("a file" if missing == "folder" else "a folder") / "native"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    if missing == "compiler":
        environment["CC"] = "/nowhere/cc"
    command = [sys.executable, str(NATIVE / "build.py"), "--levels", "all", "--to", str(place)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 1
    assert re.fullmatch(f"native library: {message}\n", done.stderr), done.stderr
    assert not (place / "built.json").exists()
