"""Build the native library: the kernels as machine code for levels of processors, and the extension that calls them.

    python native/build.py                     for this machine's level, unless it is built already
    python native/build.py --gpu               also the threads' functions as PTX; otherwise, a GPU's first use makes it
    python native/build.py --levels all --gpu  for all levels of this architecture, as a wheel has them
    python native/build.py --to FOLDER         into a folder, instead of next to `src/loewner/_native/library.py`
    python native/build.py --log FILE          in the background, with messages written to a file

A build takes Numba, NumPy's headers and a C compiler. For this machine's level, groups of kernels can be used as soon
as they are compiled, and callers of other kernels wait for them (`library.py`). Files for other machines are built as a
whole.
"""

import argparse
import hashlib
import json
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from itertools import chain, takewhile
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parent
SOURCES = HERE.parent / "src"
sys.path[:] = [str(SOURCES), *sys.path, str(HERE)]

import headers  # noqa: E402

from loewner._base._threads import processors  # noqa: E402
from loewner._kernels._sources import source_hash  # noqa: E402
from loewner._native.entries import ENTRIES  # noqa: E402
from loewner._native.library import CALL, HOME, LIST, LOCK, is_being_built, loaded  # noqa: E402
from loewner._native.library import levels as built_levels  # noqa: E402
from loewner.gpu import _ptx  # noqa: E402

# For each architecture: the levels, best first, and LLVM's features for each level. Without the feature of level 4,
# LLVM uses only half the width of its registers.
LEVELS = {
    "x86_64": {"x86-64-v4": "-prefer-256-bit", "x86-64-v3": ""},
    "arm64": {"arm64": ""},
}
CPU_OF = {"arm64": "generic"}

# Entries by module. For this machine's level, each group becomes a separate object file. An edit then rebuilds few
# files, and a program can begin as soon as the files that it needs exist. Each group has a copy of the small functions
# that it calls, so groups with many common functions are merged. For other machines, each level has a single object
# file, which takes the least space.
GROUPS = {
    "fits": ("fits.pieces",),
    "meshes": ("fits.hulls", "pieces.directions", "trees.piece_tree", "trees.triangle_tree", "narrow.mesh_points",
               "elementary"),
    "verdicts": ("pipeline.verdicts", "pipeline.workspace", "pieces."),
    "paper": ("ellipsoids.", "paper.", "fits.mv"),
    "robots": ("robots.configurations", "robots.standing", "robots.pair_lists", "robots.kinematics",
               "low_discrepancy"),
    "motions": ("robots.motions",),
    "planning": ("robots.planning", "robots.shortening"),
    "distances": ("pipeline.distances", "pipeline.fallback", "pipeline.bounds", "robots.nearest"),
    "arms": ("robots.",),
    "others": ("",),
}  # fmt: skip

# The demo does not need these groups, so a build in the background compiles them last, with a lower priority.
LATER = ("distances", "arms", "others")

# IN_BACKGROUND is the difference in priority. A program on a second core is then not slowed down, and the build ends
# even on a busy machine.
IN_BACKGROUND = 5

# Figures for estimates of the remaining time: the number of functions, the seconds of one core per function, and the
# seconds for all objects of a level.
FUNCTIONS, FUNCTION, LEVEL = 1200, 0.07, 36.0

# On Linux, a process that has imported Numba copies itself; elsewhere, libraries of the system do not survive this.
COPIES = sys.platform == "linux"

# Options of the C compiler for files that users receive. The linker of macOS has no -s; Windows is untested.
MAC, WINDOWS = sys.platform == "darwin", sys.platform == "win32"
RELEASE = ("-O2",) if MAC or WINDOWS else ("-O2", "-s")

EXTENSION = ("call.c", "single.c", "pairs.c", "configurations.c", "module.c")

# Programs in C and C++ link with the library `libloewner`.
LIBRARY, API = "libloewner.so", ("kernels.c", "files.c", "scene.c", "queries.c", "plans.c", "gate.c", "pairs.c")
FOR_C = () if WINDOWS else (LIBRARY,)  # The library uses POSIX functions to map files and to lock.
HEADERS = SOURCES / "loewner" / "include"


# EVERY is the number of seconds between lines about the progress. FIRST_WEIGHT is the weight of the first estimate,
# compared with the share of the work that is done.
EVERY, FIRST_WEIGHT = 10.0, 0.1

KEY = re.compile(r"-[0-9a-f]{32}$")  # KEY matches the end of a line that names a function.
EARLY = re.compile(r"-\d+\.so$")  # EARLY matches the end of the name of a file that is handed out early.


class Command(NamedTuple):
    """Name of the product, arguments for Python, environment variables, and the file with the output."""

    what: str
    arguments: list[str]
    environment: dict[str, str]
    said: Path

    def lines(self) -> list[str]:
        """Lines that the command has printed."""
        try:
            return self.said.with_suffix(".told").read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return []


class BuildError(Exception):
    """A part that a build needs is missing or has failed, as described by the text."""


def architecture() -> str:
    """Name of this machine's architecture."""
    name = platform.machine().lower()
    return {"amd64": "x86_64", "aarch64": "arm64"}.get(name, name)


def recipe() -> str:
    """Hash of everything on which the files depend, except the levels."""
    digest = hashlib.sha256(source_hash().encode())
    digest.update(repr((version("numba"), version("llvmlite"), version("numpy"), headers.text())).encode())
    package = SOURCES / "loewner"
    named = HERE / "build.py", HERE / "emit.py", package / "_native" / "entries.py", package / "gpu" / "_ptx.py"
    for path in sorted([*named, *HERE.glob("*.[ch]"), *HERE.glob("capi/*.[ch]"), HEADERS / "loewner.h"]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def is_built(levels: list[str], home: Path = HOME, gpu: bool = False) -> bool:
    """Return whether a complete library exists for these levels, and for GPUs if requested."""
    try:
        built = json.loads((home / LIST).read_text(encoding="utf-8"))
        wanted = [f"kernels-{level}.so" for level in levels] + [CALL, *FOR_C, *([_ptx.NAME] if gpu else [])]
        return built["recipe"] == recipe() and all(built["files"][name] == _sum(home / name) for name in wanted)
    except (OSError, ValueError, KeyError):
        return False


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def told(level: str) -> dict[str, str]:
    """Variables that make Numba compile for a level instead of for this processor."""
    return {"NUMBA_CPU_NAME": CPU_OF.get(level, level), "NUMBA_CPU_FEATURES": LEVELS[architecture()][level]}


def machine_level(folder: Path) -> str:
    """Level of this machine's processor, from the extension that was built, or from one compiled in a folder."""
    if built := built_levels():
        return built[0]
    if not (folder / CALL).exists():
        compile_extension(folder / CALL)
    levels = loaded(folder / CALL).levels()
    if not levels:
        raise BuildError("this processor is older than all levels that are built; Numba compiles for it")
    return str(levels[0])


def build(
    levels: list[str], work: Path, home: Path = HOME, gpu: bool = False, in_groups: bool = False, nice: int = 0
) -> list[Path]:
    """Build for these levels, and for GPUs if requested; older files are replaced only when everything is done.

    The files are made in the folder `work`, which may already contain the extension. With ``in_groups``, for a single
    level, each group has its own object file, which is handed out when it is done. As soon as a process has only groups
    in `LATER` left, it lowers its priority by `nice`.

    Returns
    -------
    list of Path
        The finished files; the file that lists them comes last.

    Raises
    ------
    BuildError
        If the compiler is missing, or if compiling or linking fails.
    """
    before = source_hash()
    if not (work / CALL).exists():
        # Compile the extension first, because its compilation fails immediately if no compiler is installed.
        compile_extension(work / CALL)
    with ThreadPoolExecutor() as pool:
        what = f"{len(ENTRIES)} kernels for {' and '.join(levels)}, which takes one to five minutes on two cores"
        print(f"native library: {what} ...", file=sys.stderr, flush=True)
        groups = grouped(list(GROUPS) if in_groups else ["all"])
        (work / "groups.json").write_text(json.dumps(groups), encoding="utf-8")
        (work / "sources").write_text(before, encoding="utf-8")
        count = max(processors(), len(levels))
        later = [str(nice), *LATER] if in_groups else []
        numbers = {level: [str(number) for number in range(count)[n :: len(levels)]] for n, level in enumerate(levels)}
        if COPIES:
            numbers = {level: [",".join(those)] for level, those in numbers.items()}
        workers = [emission(work, level, some, *later) for level, those in numbers.items() for some in those]
        objects = [work / f"{level}-{group}.o" for level in levels for group in groups]
        for_c = list[Future[None]]()

        def hand_out(made: list[Path]) -> None:
            """Link the finished objects for waiting programs; after the early groups, compile the library for C."""
            if not for_c and len(made) >= len(objects) - len(LATER):
                for_c.extend(pool.submit(compile_api, work / name) for name in FOR_C)
            if in_groups and len(made) < len(objects):
                (level,) = levels
                early = work / f"kernels-{level}-{len(made)}.so"
                link(made, level, early)
                done = [name for path in made for name in groups[path.stem.removeprefix(f"{level}-")]]
                publish([early, work / CALL], home, entries=done)

        functions = build_all([*workers, *([ptx(work / _ptx.NAME)] if gpu else [])], objects, hand_out)
        for library in for_c:
            library.result()
        for level in levels:
            link([path for path in objects if path.name.startswith(level)], level, work / f"kernels-{level}.so")
        # Processes read the sources when they need them. Code of two versions must not pass for code of one version.
        if source_hash.__wrapped__() != before:
            raise BuildError("the kernels' sources changed while they were compiled; build again")
        made = [*sorted(path for path in work.glob("*.so") if not EARLY.search(path.name)), *work.glob(_ptx.NAME)]
        for path in [home / LIST, home / _ptx.NAME, *home.glob("*.so")]:
            path.unlink(missing_ok=True)
        return [*publish(made, home, recipe=recipe(), functions=functions), home / LIST]


def publish(made: list[Path], home: Path, **more: Any) -> list[Path]:
    """Copy files to the folder in which they are used, and then their list; return their paths there."""
    listed = {
        "sources": source_hash(),
        "numba": version("numba"),
        "llvmlite": version("llvmlite"),
        "files": {path.name: _sum(path) for path in made},
    }
    work = made[0].parent
    (work / LIST).write_text(json.dumps(more | listed, indent=2) + "\n", encoding="utf-8")
    for path in [*made, work / LIST]:
        copied = work / f"{path.name}.copy"
        shutil.copy2(path, copied)
        os.replace(copied, home / path.name)
    return [home / path.name for path in made]


def grouped(names: list[str]) -> dict[str, list[str]]:
    """Divide the entries into groups; a group that is not in `GROUPS` takes all remaining entries."""
    groups = dict[str, list[str]]((name, []) for name in names)
    for entry in ENTRIES.values():
        groups[next(name for name in names if entry.module.startswith(GROUPS.get(name, "")))].append(entry.name)
    return groups


def emission(folder: Path, level: str, numbers: str, *later: str) -> Command:
    """Command for some of the processes that share the work in a folder: emit codes and objects of a level."""
    arguments = [str(HERE / "emit.py"), str(folder), level, numbers, *later]
    return Command(f"kernels for {level}", arguments, told(level), folder / f"worker-{numbers}")


def ptx(to: Path) -> Command:
    """Command that writes the threads' functions as PTX, which is the same for all processors."""
    paths = os.pathsep.join([str(SOURCES), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {"PYTHONPATH": paths, "LOEWNER_CACHE_DIR": f"{to}.cache"}
    return Command("code for GPUs", ["-m", "loewner.gpu._ptx", str(to)], environment, to)


def build_all(
    commands: list[Command], objects: list[Path], hand_out: Callable[[list[Path]], None] = lambda made: None
) -> int:
    """Run commands in separate processes, as many at a time as the machine has processors; count functions.

    Whenever more objects are finished, call `hand_out` with all finished objects. Every ten seconds, print the kernels
    in progress and an estimate of the remaining time, from the progress so far.
    """
    start = time.perf_counter()
    waiting, running = list(commands), list[tuple[subprocess.Popen[bytes], Command]]()
    cores = processors()
    whole = FUNCTIONS * FUNCTION + LEVEL * len({path.name.rpartition("-")[0] for path in objects})
    next_word, there = start, 0

    def functions() -> int:
        return len({line for command in commands for line in command.lines() if KEY.search(line)})

    def say() -> None:
        elapsed = time.perf_counter() - start
        made = sum(path.exists() for path in objects) / max(len(objects), 1)
        share = (min(functions(), FUNCTIONS) * FUNCTION + made * (whole - FUNCTIONS * FUNCTION)) / whole
        expected = (elapsed + FIRST_WEIGHT * whole / cores) / (share + FIRST_WEIGHT)
        left = f"about {max(expected - elapsed, 1):.0f} s left"
        names = [[line for line in command.lines() if not KEY.search(line)] for command in commands]
        what = ", ".join(chain.from_iterable(some[-cores // len(commands) :] for some in names)) or "..."
        print(f"native library: {elapsed:4.0f} s, {left}: {what}", file=sys.stderr, flush=True)

    try:
        while waiting or running:
            while waiting and len(running) < processors():
                command = waiting.pop(0)
                environment = os.environ | command.environment | {"LOEWNER_QUIET": "1"}
                told, log = (command.said.with_suffix(suffix).open("wb") for suffix in (".told", ".log"))
                with told, log:
                    call = [sys.executable, *command.arguments]
                    group: Any = {} if WINDOWS else {"process_group": 0}
                    process = subprocess.Popen(call, env=environment, stdout=told, stderr=log, **group)
                    running.append((process, command))
            time.sleep(0.05)
            for process, command in [one for one in running if one[0].poll() is not None]:
                running.remove((process, command))
                if process.returncode:
                    end(process)
                    said = command.said.with_suffix(".log").read_text(encoding="utf-8", errors="replace")
                    ended = f"a process ended with status {process.returncode}"
                    raise BuildError(f"{command.what}: {ended}:\n{said.strip()[-4000:]}")
            made = list(takewhile(Path.exists, objects))  # Each object may call functions of earlier objects.
            if len(made) > there:
                there = len(made)
                hand_out(made)
            if time.perf_counter() >= next_word:
                next_word += EVERY
                say()
        return functions()
    finally:
        for process, _ in running:
            end(process)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process and the copies of it, which can survive it."""
    with suppress(OSError):
        process.kill() if WINDOWS else os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def compile_extension(to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Compile the extension, which Python 3.11 and all later versions can load: see `call.h`."""
    import numpy

    headers = Path(sysconfig.get_path("include"), "Python.h")
    if not headers.exists():
        raise BuildError(f"expected the headers of Python, found no {headers}; install them (python3-dev)")
    included = [f"-I{headers.parent}", f"-I{numpy.get_include()}"]
    elsewhere = [f"-L{Path(sys.base_prefix, 'libs')}"] if WINDOWS else ["-ldl"]
    python = ["-undefined", "dynamic_lookup"] if MAC else elsewhere
    compile_c([*(HERE / name for name in EXTENSION), written_header(to.parent), *included, *python], to, flags)


def written_header(folder: Path) -> str:
    """Write `kernels.h` into a folder, and return the option by which the C compiler finds it."""
    (folder / headers.NAME).write_text(headers.text(), encoding="utf-8")
    return f"-I{folder}"


def api_flags(folder: Path) -> list[str]:
    """Options of the C compiler for the library for C; `kernels.h` is written into a folder.

    Products are not fused with sums, so that lengths and fractions equal Python's to the last bit.
    """
    return [written_header(folder), "-Wextra", "-fvisibility=hidden", "-ffp-contract=off", f"-I{HEADERS}"]


def compile_api(to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Compile the library for programs in C and C++."""
    sources = [HERE / "capi" / name for name in API]
    name = f"-Wl,-install_name,@rpath/{LIBRARY}" if MAC else f"-Wl,-soname,{LIBRARY}"
    compile_c([*sources, *api_flags(to.parent), name, "-pthread", "-ldl", "-lm"], to, flags)


def link(objects: list[Path], level: str, to: Path) -> None:
    """Link object files and the parts of Numba's run time that they need; apart from these, only libm may be needed."""
    strict = [] if MAC or WINDOWS else ["-Wl,-z,defs", "-Wl,--gc-sections", "-lm"]
    compile_c([*objects, HERE / "runtime.c", f'-DLOEWNER_BUILD="{source_hash()} {level}"', *strict], to)


def compile_c(what: list[Path | str], to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Call the C compiler: ``CC`` of the environment or `cc`, or `clang` on Windows."""
    compiler = shlex.split(os.environ.get("CC") or ("clang" if WINDOWS else "cc"))
    strict = ["-std=gnu11", "-Wall", "-Werror=implicit-function-declaration", *([] if WINDOWS else ["-fPIC"])]
    command = [*compiler, *flags, *strict, "-shared", "-o", str(to), *map(str, what)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        why = f"expected a C compiler, found no {compiler[0]} ({error.strerror}); install gcc or clang, or set CC"
        raise BuildError(why) from None
    if done.returncode:
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr.strip()[-4000:]}")


def folder_for(home: Path) -> Path:
    """Make a folder for unfinished files, in the same file system as the finished files."""
    home.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(dir=home, prefix=".build-"))


@contextmanager
def locked(home: Path, held: int | None) -> Iterator[int | None]:
    """Let one process at a time build; other processes wait, and then find everything built.

    `held` is the number of a lock that another process has handed on.
    """
    if WINDOWS or held is not None:
        yield held
        return
    import fcntl

    with (home / LOCK).open("wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("native library: waiting for another build ...", file=sys.stderr, flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield file.fileno()


def is_begun_elsewhere(home: Path) -> bool:
    """Return whether another process builds the present sources, so that programs can wait for it."""
    if home != HOME or not is_being_built():
        return False
    with suppress(OSError):  # The other build may end now, and remove its folder.
        return source_hash() in [path.read_text(encoding="utf-8") for path in home.glob(".build-*/sources")]
    return False


def go_on_in_background(lock: int | None, work: Path, log: Path) -> None:
    """Run this command again in a process that stays, and hand the lock and the folder on to that process."""
    log.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, *sys.argv, "--work", str(work), *([] if lock is None else ["--lock", str(lock)])]
    kept = () if lock is None else (lock,)
    with log.open("wb") as said:
        streams: Any = {"stdin": subprocess.DEVNULL, "stdout": said, "stderr": said}
        subprocess.Popen(command, **streams, pass_fds=kept, start_new_session=True)
    print(f"native library: being built in the background; {log} has its progress", file=sys.stderr, flush=True)


def main() -> int:
    """Build the requested files, unless they exist."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", default="machine", help="'machine' (default), 'all', or names separated by commas")
    parser.add_argument("--gpu", action="store_true", help="also compile code for NVIDIA's GPUs")
    parser.add_argument("--to", type=Path, default=HOME, metavar="FOLDER", help="folder for the files that are built")
    parser.add_argument("--log", type=Path, metavar="FILE", help="build in the background, and write messages to FILE")
    parser.add_argument("--lock", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    # Exiting ends the processes that the build began, and removes its folder.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    try:
        all_levels = LEVELS.get(architecture())
        if all_levels is None:
            raise BuildError(f"expected one of {', '.join(LEVELS)}, found a processor of {architecture()}")
        in_background = options.log is not None and options.work is None
        if in_background and not options.gpu and is_begun_elsewhere(options.to):
            print("native library: already being built by another process", file=sys.stderr)
            return 0
        with ExitStack() as stack:
            lock = stack.enter_context(locked(options.to, options.lock)) if options.to == HOME else None
            if lock is not None and options.work is None:
                for left in options.to.glob(".build-*"):  # A build that was killed has left its folder.
                    shutil.rmtree(left, ignore_errors=True)
            work = options.work or folder_for(options.to)
            stack.callback(shutil.rmtree, work)
            in_groups = options.levels == "machine"
            levels = list(all_levels) if options.levels == "all" else options.levels.split(",")
            if in_groups:
                levels = [machine_level(work)]
            if any(level not in all_levels for level in levels):
                raise BuildError(f"--levels: expected some of {', '.join(all_levels)}, found {options.levels}")
            if is_built(levels, options.to, options.gpu):
                return 0
            if in_background:
                go_on_in_background(lock, work, options.log)
                stack.pop_all()  # The other process now owns the lock and the folder.
                return 0
            start = time.perf_counter()
            nice = 0 if options.work is None else IN_BACKGROUND
            built_files = build(levels, work, options.to, options.gpu, in_groups=in_groups, nice=nice)
            size = sum(path.stat().st_size for path in built_files)
            count = json.loads(built_files[-1].read_text(encoding="utf-8"))["functions"]
            spent = os.times()  # The processes that compiled have ended.
            work_time = spent.children_user + spent.children_system
            took = f"{time.perf_counter() - start:.0f} s, {work_time:.0f} s of processor time"
            print(f"native library: {', '.join(levels)}, {count} functions, {size / 1e6:.1f} MB, {took}")
    except (BuildError, OSError) as error:
        print(f"native library: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("native library: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
