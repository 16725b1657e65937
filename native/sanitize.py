"""Run the tests of the C files with sanitizers for addresses, undefined behaviour and threads.

    python native/sanitize.py

The extension and the library for C are compiled into `build/sanitize`, a copy of the package with the kernels that were
built already. The kernels are not examined. A report ends the tests, and the exit status is 1. The run needs gcc with
libasan and libtsan, on Linux. The sanitizer for threads watches a program with eight threads, `tests/capi_threads.c`,
because it cannot watch Python.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from build import API, HERE, LIBRARY, SOURCES, BuildError, _sum, api_flags, compile_api, compile_extension

from loewner._native import library

TO = HERE.parent / "build" / "sanitize"
FLAGS = ("-O1", "-g", "-fno-omit-frame-pointer", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined")

# These tests drive the extension.
TESTS = ("tests/test_native.py", "tests/test_native_calls.py", "tests/test_threads.py", "tests/test_capi.py",
         "tests/test_capi_gates.py", "tests/test_bounded_work.py::test_limits_in_c_are_those_of_python",
         "tests/fuzz/test_border.py", "tests/fuzz/test_hostile_calls.py")  # fmt: skip
# The first test measures memory, but the sanitizer keeps freed memory. The second test forks: if another thread is in
# the sanitizer's allocator at that moment, the child has no allocator. A sample of the bad arguments suffices, because
# few of them reach the extension.
LEFT_OUT = (
    "tests/test_native.py::test_results_leave_no_memory_behind",
    "tests/fuzz/test_hostile_calls.py::test_forks_under_load",
    "tests/fuzz/test_border.py::test_all_bad_arguments",
)


def instrumented(to: Path) -> None:
    """Copy the package with its kernels, and compile the extension again."""
    if library.level() is None:
        raise BuildError(f"expected a native library that is built, found none ({library.why_not()})")
    shutil.rmtree(to, ignore_errors=True)
    name = library.CALL
    package = to / "loewner"
    kept_out = shutil.ignore_patterns("__pycache__", ".build-*", name, LIBRARY)
    shutil.copytree(SOURCES / "loewner", package, ignore=kept_out)
    home = package / library.HOME.relative_to(SOURCES / "loewner")
    compile_extension(home / name, FLAGS)
    compile_api(home / LIBRARY, FLAGS)
    built = json.loads((home / library.LIST).read_text(encoding="utf-8"))
    for file_name in (name, LIBRARY):
        built["files"][file_name] = _sum(home / file_name)
    (home / library.LIST).write_text(json.dumps(built), encoding="utf-8")


def threads_are_clean(to: Path) -> bool:
    """Run eight threads with gates under the sanitizer for threads, then under the one for addresses and leaks."""
    cell, kernels = to / "cell.lwn", library.HOME
    save = [sys.executable, str(HERE.parent / "examples" / "save_cell.py"), cell.name]
    subprocess.run(save, check=True, cwd=to, env=os.environ | {"PYTHONPATH": str(SOURCES)})
    sources = [str(HERE / "capi" / name) for name in API] + [str(HERE.parent / "tests" / "capi_threads.c")]
    clean = True
    for kind in ("thread", "address,undefined"):
        program = to / f"threads-{kind.partition(',')[0]}"
        told = ["-std=gnu11", "-O1", "-g", f"-fsanitize={kind}", "-fno-sanitize-recover=undefined", *api_flags(to)]
        compiler = shlex.split(os.environ.get("CC") or "cc")
        subprocess.run([*compiler, *told, *sources, "-o", str(program), "-pthread", "-ldl", "-lm"], check=True)
        for path in kernels.glob("kernels-*.so"):
            shutil.copy(path, to)
        done = subprocess.run(
            [str(program), str(cell)], check=False, env=os.environ | {"TSAN_OPTIONS": "halt_on_error=1"}
        )
        print(f"sanitize: eight threads, {kind}: {'clean' if done.returncode == 0 else 'a report'}", flush=True)
        clean = clean and done.returncode == 0
    return clean


def runtime() -> str:
    """Libraries that a program compiled without the sanitizer has to load first.

    They include the C++ library: the sanitizer looks for its functions at the start, but Python loads it later.
    """
    compiler = shlex.split(os.environ.get("CC") or "cc")
    commands = [[*compiler, f"-print-file-name={name}"] for name in ("libasan.so", "libstdc++.so.6")]
    told = [subprocess.run(command, capture_output=True, text=True, check=False).stdout for command in commands]
    paths = [Path(text.strip()) for text in told]
    if not all(path.is_absolute() for path in paths):
        raise BuildError(f"expected gcc with its libasan, found none with {compiler[0]}")
    return " ".join(str(path.resolve()) for path in paths)


def environment(to: Path) -> dict[str, str]:
    """Environment variables for an interpreter that uses the copy, and whose objects the sanitizer sees one by one."""
    # Leaks are ignored, because Python and NumPy release some memory only at the end. Allocations may fail, because
    # tests request more memory than the machine has.
    report = f"'{to / 'report'}'"  # The path is quoted, because blanks divide options.
    options = f"halt_on_error=1:detect_leaks=0:allocator_may_return_null=1:log_path={report}"
    return os.environ | {
        "LD_PRELOAD": runtime(),
        "ASAN_OPTIONS": options,
        "UBSAN_OPTIONS": f"{options}:print_stacktrace=1",
        "PYTHONMALLOC": "malloc",
        "PYTHONPATH": str(to),
        "LOEWNER_NATIVE": "required",
    }


def main() -> int:
    """Compile, run the tests, and show the reports."""
    try:
        instrumented(TO)
        around = environment(TO)
        clean = threads_are_clean(TO)
    except (BuildError, subprocess.CalledProcessError) as error:
        print(f"sanitize: {error}", file=sys.stderr)
        return 1
    ask = "from loewner._native import library; print(library.extension().__file__)"
    used = subprocess.run([sys.executable, "-c", ask], env=around, capture_output=True, text=True, check=False).stdout
    if not used.startswith(str(TO)):
        print(f"sanitize: expected an extension in {TO} to be used, found {used.strip() or 'none'}", file=sys.stderr)
        return 1
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not verify"]
    tests += [*(f"--deselect={name}" for name in LEFT_OUT), *TESTS, *sys.argv[1:]]
    done = subprocess.run(tests, env=around, cwd=HERE.parent, check=False)
    reports = sorted(TO.glob("report*"))
    for report in reports:
        print(report.read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
    return 1 if reports or done.returncode or not clean else 0


if __name__ == "__main__":
    sys.exit(main())
