"""Build the native library: the kernels as machine code, for levels of processors, and the extension that calls it.

    python native/build.py                     for this machine's level, if it is not there already
    python native/build.py --gpu               the threads' functions as PTX, too; elsewhere a GPU's first use makes it
    python native/build.py --levels all --gpu  for all levels of this architecture, as a wheel has them
    python native/build.py --to FOLDER         somewhere else than beside `src/loewner/_native/library.py`

It takes Numba, NumPy's headers and a C compiler.
"""

import argparse
import hashlib
import json
import os
import platform
import shlex
import subprocess
import sys
import sysconfig
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
SOURCES = HERE.parent / "src"
sys.path.insert(0, str(SOURCES))

from loewner import _ptx  # noqa: E402
from loewner._kernels import codes, columns  # noqa: E402
from loewner._kernels._sources import source_hash  # noqa: E402
from loewner._native.entries import ENTRIES  # noqa: E402
from loewner._native.library import CALL, HOME, LIST  # noqa: E402
from loewner._native.library import levels as built_levels  # noqa: E402
from loewner._threads import processors  # noqa: E402
from loewner.planners import compiled as compiled_planner  # noqa: E402
from loewner.planners import joint_limits, judge  # noqa: E402
from loewner.robots import checker, contacts, motion_tables, robot, watch  # noqa: E402
from loewner.robots.edges import NEARLY_WHOLE  # noqa: E402

# By architecture: the levels, best first, and what LLVM is told of each. Without the last word it takes registers of
# half the width for level 4.
LEVELS = {
    "x86_64": {"x86-64-v4": "-prefer-256-bit", "x86-64-v3": ""},
    "arm64": {"arm64": ""},
}
CPU_OF = {"arm64": "generic"}

# For estimates of the time that is left: functions that make up the entries of each half, and steps of machine code;
# seconds of one core for the code of both halves, for a level and for GPUs, where the check of Numba takes `CHECK`.
FUNCTIONS, STEPS = (470, 630), 3
CODE, LEVEL, GPU, CHECK = 245.0, 71.0, 28.0, 2.3

# Entries that one process compiles while another compiles the rest, which takes as long. It begins with those that
# share little: by the time that it reaches the robots, the other has compiled the searches for them.
FIRST = (
    "fit_range", "center_in", "fit_halfspaces", "to_unit_size", "finish_hull", "fit_outer", "enclose", "outer_gap",
    "solve_primal_dual", "inscribed_ellipsoids", "direction_map", "mark_beyond", "piece_trees", "triangle_tree",
    "cut_up", "equal_vertices", "part_vertices", "body_boxes", "curve_order", "box_tree", "meeting_boxes",
    "first_fault", "contact_of_pairs", "near_points_of_pairs", "link_poses", "link_jacobians", "check_configurations",
    "check_motion", "memory_size", "certify_motions", "free_motions", "motion_memory", "connect_trees", "shorten_path",
    "polish_path", "memory_of_clearances", "clearances", "pair_gradients", "measure_moving", "place_static",
)  # fmt: skip


# What the C compiler is told of files that people get. The linker of macOS knows no -s; Windows is untried.
MAC, WINDOWS = sys.platform == "darwin", sys.platform == "win32"
RELEASE = ("-O2",) if MAC or WINDOWS else ("-O2", "-s")

EXTENSION = ("call.c", "single.c", "pairs.c", "configurations.c", "module.c")

# Names of `codes` that the extension knows.
CODES = ("FREE", "COLLIDING", "AMBIGUOUS", "CERTIFY", "EXACT", "OPEN", "TIERS")

# What the extension knows of `codes` and of the steps of a motion: definitions for the C compiler.
DEFINED = [f"-DCODE_{name}={getattr(codes, name)}" for name in CODES] + [f"-DNEARLY_WHOLE={NEARLY_WHOLE!r}"]


# `libloewner`, which programs in C and C++ link with, and the constants of Python that it knows.
LIBRARY, API = "libloewner.so", ("kernels.c", "files.c", "scene.c", "queries.c", "plans.c", "pairs.c")
FOR_C = () if WINDOWS else (LIBRARY,)  # it maps files and locks as POSIX does
HEADERS = SOURCES / "loewner" / "include"
API_CODES = (*CODES, "INEXACT", "TOO_LONG", "BY_CARE", "MOST_POINTS", "MET", "SPENT", "FULL", "SINE_OF", "ARC_COSINE")
API_COLUMNS = (
    "SOLID", "SURFACE", "MAPPED", "POLYTOPE", "REACH", "HOT", "COLUMNS", "POINTS_FROM", "POINTS_TO", "SURFACE_AT",
    "LAYOUT", "PARTS", "DEEPEST", "WIDE", "FIXED", "REVOLUTE", "PLANAR", "BALL", "TRANSLATION", "SINE", "COSINE",
    "BOUNDS",
)  # fmt: skip
API_CONSTANTS = {
    **{name: getattr(columns, name) for name in API_COLUMNS},
    "KIND_OF": columns.KIND,
    "LAST_KIND": columns.POINT,
    "POINT_BLOCK": columns.BLOCK,
    "LINK_CONSTANTS": columns.CONSTANTS,
    "STRETCH": motion_tables.STRETCH,
    "ROUNDED_VALUES": contacts.OFF,
    "FIRST_LOOK": checker.FIRST_LOOK,
    "LARGEST_VALUE": watch.LARGEST_VALUE,
    "QUATERNION_TOLERANCE": robot.QUATERNION_TOLERANCE,
    "ON_LIMIT": joint_limits.ON_LIMIT,
    "PLAN_TOLERANCE": judge.TOLERANCE,
    "LONGEST_SHARE": compiled_planner.SHARE,
    "TREE_CAPACITY": compiled_planner.CAPACITY,
    "FIRST_ITERATIONS": compiled_planner.FIRST,
    "MOST_ITERATIONS": compiled_planner.AT_A_TIME,
    "A_WHILE": compiled_planner.A_WHILE,
    "USUAL_CUTS": compiled_planner.CUTS,
    "USUAL_ITERATIONS": 100_000,
    "MOST_ROOM": compiled_planner.MOST_ROOM,
}
API_DEFINED = [f"-DCODE_{name}={getattr(codes, name)}" for name in API_CODES] + [
    f"-D{name}=({value!r})" for name, value in API_CONSTANTS.items()
]


# Seconds between words on the progress, and what the first estimate counts for beside the share that is done.
EVERY, FIRST_WEIGHT = 10.0, 0.1


class Command(NamedTuple):
    """What is made, arguments of Python, variables of its environment, the file made, and those needed first.

    The command prints how many of its `steps` are done, a number a line, and names of what it is at. `seconds` weighs
    it against the others.
    """

    what: str
    arguments: list[str]
    environment: dict[str, str]
    to: Path
    needed: tuple[Path, ...] = ()
    steps: int = 1
    seconds: float = 1.0

    def progress(self) -> tuple[float, str]:
        """Fraction that is done, and what the command is at."""
        try:
            lines = self.to.with_suffix(".told").read_text(encoding="utf-8", errors="replace").split()
        except OSError:
            return 0.0, ""
        done = [int(line) for line in lines if line.isdecimal()]
        names = [line for line in lines if not line.isdecimal()]
        return min(done[-1] / self.steps, 0.99) if done else 0.0, names[-1] if names else ""


class BuildError(Exception):
    """Something that a build needs is missing, or failed; the text says what."""


def architecture() -> str:
    """Name of this machine's architecture."""
    name = platform.machine().lower()
    return {"amd64": "x86_64", "aarch64": "arm64"}.get(name, name)


def recipe() -> str:
    """Hash of all that decides what is built, but for the levels."""
    digest = hashlib.sha256(source_hash().encode())
    digest.update(repr((version("numba"), version("llvmlite"), version("numpy"), DEFINED, API_DEFINED)).encode())
    written = [
        HERE / "build.py",
        HERE / "emit.py",
        *HERE.glob("*.[ch]"),
        *HERE.glob("capi/*.[ch]"),
        HEADERS / "loewner.h",
    ]
    besides = SOURCES / "loewner" / "_native" / "entries.py", SOURCES / "loewner" / "_ptx.py"
    for path in sorted([*written, *besides]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def is_built(levels: list[str], home: Path = HOME, gpu: bool = False) -> bool:
    """Tell whether the library is there for these levels, and for GPUs, and whole."""
    try:
        built = json.loads((home / LIST).read_text(encoding="utf-8"))
        wanted = [f"kernels-{level}.so" for level in levels] + [CALL, *FOR_C, *([_ptx.NAME] if gpu else [])]
        return built["recipe"] == recipe() and all(built["files"][name] == _sum(home / name) for name in wanted)
    except (OSError, ValueError, KeyError):
        return False


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def told(level: str) -> dict[str, str]:
    """Variables by which Numba is told to compile for a level instead of for this processor."""
    return {"NUMBA_CPU_NAME": CPU_OF.get(level, level), "NUMBA_CPU_FEATURES": LEVELS[architecture()][level]}


def machine_level() -> str:
    """Level of this machine's processor, asked of the extension that was built, or of one made for this."""
    if known := built_levels():
        return known[0]
    with tempfile.TemporaryDirectory() as folder:
        extension = Path(folder, CALL)
        compile_extension(extension)
        ask = f"import sys; sys.path.insert(0, {str(SOURCES)!r}); from loewner._native.library import loaded; "
        ask += f"print(*loaded({str(extension)!r}).levels())"
        found = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True).stdout.split()
    if not found:
        raise BuildError("this processor is older than all levels that are built; Numba compiles for it")
    return found[0]


def build(levels: list[str], home: Path = HOME, gpu: bool = False) -> list[Path]:
    """Build for these levels, and for GPUs if asked; what was there is replaced only when all is done.

    Returns
    -------
    list of Path
        The files made, the list of them last.

    Raises
    ------
    BuildError
        If the compiler is missing, or something does not compile or link.
    """
    home.mkdir(parents=True, exist_ok=True)
    before = source_hash()
    with tempfile.TemporaryDirectory(dir=home, prefix=".build-") as folder, ThreadPoolExecutor() as pool:
        work = Path(folder)
        compile_extension(work / CALL)  # first: it fails at once where there is no compiler
        what = f"{len(ENTRIES)} kernels for {' and '.join(levels)}, which takes one to five minutes on two cores"
        print(f"native library: {what} ...", file=sys.stderr, flush=True)
        for_c = [pool.submit(compile_api, work / name) for name in FOR_C]
        start = time.perf_counter()
        run(
            [str(HERE / "emit.py")],
            os.environ | {"LOEWNER_QUIET": "1"},
            "expected a Numba with which the kernels can be built, found another or none",
        )
        slowness = (time.perf_counter() - start) / CHECK
        # Two processes make the intermediate code of half the entries each, and hand each other what the halves share.
        halves = FIRST, tuple(name for name in ENTRIES if name not in FIRST)
        codes = [emission(n, "code", levels[0], half, work / f"code-{n}") for n, half in enumerate(halves)]
        codes = [code._replace(steps=count, seconds=CODE / 2) for code, count in zip(codes, FUNCTIONS, strict=True)]
        # Several levels keep processes busy. For one level each half becomes an object file of its own, which together
        # are an eighth larger, since some functions are in both.
        parts = tuple(code.to for code in codes)
        groups = [parts] if len(levels) > 1 else [(part,) for part in parts]
        jobs = [(level, group) for level in levels for group in groups]
        objects = [emission(2 + n, "object", *job, work / f"{job[0]}-{n}.o") for n, job in enumerate(jobs)]
        objects = [one._replace(steps=STEPS, seconds=LEVEL / len(groups)) for one in objects]
        run_all([*codes, *objects, *([ptx(work / _ptx.NAME)] if gpu else [])], slowness)
        for library in for_c:
            library.result()
        for level in levels:
            link(sorted(work.glob(f"{level}-*.o")), level, work / f"kernels-{level}.so")
        # Processes read the sources as they need them: code of two versions may not be called code of one.
        if source_hash.__wrapped__() != before:
            raise BuildError("the kernels' sources changed while they were compiled; build again")
        made = [*sorted(work.glob("*.so")), *work.glob(_ptx.NAME)]
        files = {path.name: _sum(path) for path in made}
        listed = {
            "recipe": recipe(),
            "sources": source_hash(),
            "numba": version("numba"),
            "llvmlite": version("llvmlite"),
            "files": files,
        }
        (work / LIST).write_text(json.dumps(listed, indent=2) + "\n", encoding="utf-8")
        for path in [home / LIST, home / _ptx.NAME, *home.glob("*.so")]:
            path.unlink(missing_ok=True)
        for path in [*made, work / LIST]:
            os.replace(path, home / path.name)
        return [home / path.name for path in [*made, work / LIST]]


def emission(number: int, what: str, level: str, given: tuple[str | Path, ...], to: Path) -> Command:
    """Emit the code of entries, or the object file of such code; jobs of one build share a cache, and nobody else does.

    Object code is only made of functions that these processes numbered.
    """
    environment = told(level) | {"LOEWNER_CACHE_DIR": str(to.parent / "cache")}
    arguments = [str(HERE / "emit.py"), what, str(to), str(number), *map(str, given)]
    if what == "code":
        return Command(f"intermediate code of {len(given)} of {len(ENTRIES)} kernels", arguments, environment, to)
    return Command(f"machine code for {level}", arguments, environment, to, tuple(map(Path, given)))


def ptx(to: Path) -> Command:
    """Write the threads' functions as PTX, which are the same for all processors."""
    paths = os.pathsep.join([str(SOURCES), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {"PYTHONPATH": paths, "LOEWNER_CACHE_DIR": f"{to}.cache"}
    return Command("code for GPUs", ["-m", "loewner._ptx", str(to)], environment, to, seconds=GPU)


def run_all(commands: list[Command], slowness: float = 1.0) -> None:
    """Run commands, each in a process of its own, as many at a time as there are processors.

    Print what begins and, every ten seconds, what is being compiled; and how long the rest will take, at first by the
    speed of the machine, then by what was done so far.
    """
    start, done = time.perf_counter(), set[Path]()
    waiting, running = list(commands), list[tuple[subprocess.Popen[bytes], Command]]()
    cores = min(processors(), len(commands))
    whole = sum(command.seconds for command in commands)
    next_word = start + EVERY

    def say(what: str) -> None:
        elapsed = time.perf_counter() - start
        share = sum(one.seconds * (1.0 if one.to in done else one.progress()[0]) for one in commands) / whole
        expected = (elapsed + FIRST_WEIGHT * whole * slowness / cores) / (share + FIRST_WEIGHT)
        left = f"about {max(expected - elapsed, 1):.0f} s left"
        print(f"native library: {elapsed:4.0f} s, {left}: {what}", file=sys.stderr, flush=True)

    try:
        while waiting or running:
            ready = [command for command in waiting if done.issuperset(command.needed)]
            for command in ready[: processors() - len(running)]:
                waiting.remove(command)
                say(f"{command.what} ...")
                environment = os.environ | command.environment | {"LOEWNER_QUIET": "1"}
                told, log = (command.to.with_suffix(suffix).open("wb") for suffix in (".told", ".log"))
                with told, log:
                    call = [sys.executable, *command.arguments]
                    running.append((subprocess.Popen(call, env=environment, stdout=told, stderr=log), command))
            time.sleep(0.05)
            for process, command in [one for one in running if one[0].poll() is not None]:
                running.remove((process, command))
                if process.returncode:
                    said = command.to.with_suffix(".log").read_text(encoding="utf-8", errors="replace")
                    raise BuildError(f"{command.what}: this could not be compiled:\n{said.strip()[-4000:]}")
                done.add(command.to)
            if time.perf_counter() > next_word:
                next_word += EVERY
                say(", ".join(name for _, command in running if (name := command.progress()[1])) or "...")
    finally:
        for process, _ in running:
            process.kill()
            process.wait()


def run(arguments: list[str], environment: dict[str, str], failed: str) -> None:
    """Run Python in a process of its own, or stop with what it said."""
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"{failed}:\n{done.stderr.strip()[-4000:]}")


def compile_extension(to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Compile the extension, which any Python from 3.11 on can load: see `call.h`."""
    import numpy

    headers = Path(sysconfig.get_path("include"), "Python.h")
    if not headers.exists():
        raise BuildError(f"expected the headers of Python, found no {headers}; install them (python3-dev)")
    included = [f"-I{headers.parent}", f"-I{numpy.get_include()}"]
    python = (
        ["-undefined", "dynamic_lookup"] if MAC else [f"-L{Path(sys.base_prefix, 'libs')}"] if WINDOWS else ["-ldl"]
    )
    compile_c([*(HERE / name for name in EXTENSION), *DEFINED, *included, *python], to, flags)


def api_flags() -> list[str]:
    """What the C compiler is told of the library for C.

    No products are fused with sums, so that lengths and fractions are Python's to the last bit.
    """
    known = [*API_DEFINED, f'-DSOURCES="{source_hash()}"']
    return [*known, "-Wextra", "-fvisibility=hidden", "-ffp-contract=off", f"-I{HEADERS}"]


def compile_api(to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Compile the library for programs in C and C++."""
    sources = [HERE / "capi" / name for name in API]
    name = f"-Wl,-install_name,@rpath/{LIBRARY}" if MAC else f"-Wl,-soname,{LIBRARY}"
    compile_c([*sources, *api_flags(), name, "-pthread", "-ldl", "-lm"], to, flags)


def link(objects: list[Path], level: str, to: Path) -> None:
    """Link object files and what they need of Numba's run time; nothing may be left to be found elsewhere but libm."""
    strict = [] if MAC or WINDOWS else ["-Wl,-z,defs", "-Wl,--gc-sections", "-lm"]
    compile_c([*objects, HERE / "runtime.c", f'-DLOEWNER_BUILD="{source_hash()} {level}"', *strict], to)


def compile_c(what: list[Path | str], to: Path, flags: tuple[str, ...] = RELEASE) -> None:
    """Call the C compiler: that of the environment, or `cc`; on Windows `clang`."""
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


def main() -> int:
    """Build what is asked for, unless it is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", default="machine", help="'machine' (default), 'all', or names with commas")
    parser.add_argument("--gpu", action="store_true", help="code for NVIDIA's GPUs, too")
    parser.add_argument("--to", type=Path, default=HOME, metavar="FOLDER", help="where what is built goes")
    arguments = parser.parse_args()
    asked, home = arguments.levels, arguments.to
    try:
        known = LEVELS.get(architecture())
        if known is None:
            raise BuildError(f"expected one of {', '.join(LEVELS)}, found a processor of {architecture()}")
        levels = list(known) if asked == "all" else [machine_level()] if asked == "machine" else asked.split(",")
        if any(level not in known for level in levels):
            raise BuildError(f"--levels: expected some of {', '.join(known)}, found {asked}")
        if not is_built(levels, home, arguments.gpu):
            start = time.perf_counter()
            made = build(levels, home, arguments.gpu)
            size = sum(path.stat().st_size for path in made)
            print(f"native library: {', '.join(levels)}, {size / 1e6:.1f} MB, {time.perf_counter() - start:.0f} s")
    except (BuildError, OSError) as error:
        print(f"native library: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
