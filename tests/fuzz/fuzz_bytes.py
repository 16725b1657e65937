"""Every reader of files under a fuzzer that watches which branches bytes reach.

    python tests/fuzz/fuzz_bytes.py [--seconds 20] [--to build/bytes] [FORMAT ...]

A file gives a value or a child of LoewnerError. Any other exception, a crash, more than `LIMIT` seconds or more than
`MEMORY` bytes of address space is a finding: its bytes are written to a folder and printed, as what
`test_file_readers.read` takes, and the exit status is 1. What was reached is kept there, too, and the next run goes on
from it. It takes Atheris (requirements/bytes.txt).
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import hashlib
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

# A file takes no longer to read [s], and no more address space than this above what is taken before [bytes].
LIMIT, MEMORY = 20, 3 * 2**30

# Findings that end the process before a format is given up, of one run.
DEATHS = 5


def main() -> int:
    """Fuzz formats one after the other, or one of them in this process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help="all of them by default")
    parser.add_argument("--seconds", type=int, default=20, help="for each format")
    parser.add_argument("--to", type=Path, default=Path("build", "bytes"), help="where findings are written")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.here:
        fuzz(given.formats[0], given.to, given.seconds)
    from file_readers import READERS

    unknown = [name for name in given.formats if name not in READERS]
    if unknown:
        parser.error(f"expected formats of {', '.join(READERS)}; found {', '.join(unknown)}")
    found = [campaign(name, given.to.absolute() / name, given.seconds) for name in given.formats or READERS]
    return int(any(found))


# -- of one format, in processes of its own ------------------------------------------------------


def campaign(name: str, to: Path, seconds: int) -> bool:
    """Fuzz a format for so long, anew after a crash; print what was found and tell whether there was anything."""
    (to / "findings").mkdir(parents=True, exist_ok=True)
    before, ends, runs, deaths = set((to / "findings").iterdir()), time.monotonic() + seconds, 0, 0
    failed = ""
    while (left := round(ends - time.monotonic())) > 0 and deaths < DEATHS:
        command = [sys.executable, __file__, "--here", "--to", str(to), "--seconds", str(left), name]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        runs += max((int(n) for n in re.findall(r"^#(\d+)", done.stderr, re.M)), default=0)
        if done.returncode:
            deaths += 1
            failed = done.stderr[-2000:]
    found = sorted(set((to / "findings").iterdir()) - before)
    files = [path for path in found if path.suffix != ".txt"]
    print(f"{name}: {runs} executions, {len(files)} findings", flush=True)
    for path in files:
        about = path.with_suffix(".txt")
        print(f"  {path}\n  read({name!r}, base64.b64decode({base64.b64encode(path.read_bytes()).decode()!r}))")
        print(about.read_text() if about.exists() else failed)
    if not files and (failed or not runs):
        print(failed or "the fuzzer did not run")
    return bool(files or failed or not runs)


def fuzz(name: str, to: Path, seconds: int) -> None:
    """Fuzz a format in this process, which ends with it."""
    import atheris

    with atheris.instrument_imports(include=["loewner"], exclude=["loewner._kernels", "loewner._native"]):
        from file_readers import READERS

    from loewner import LoewnerError

    reader, (corpus, folder) = READERS[name], (to / "corpus", Path(tempfile.mkdtemp(dir=memory())))
    corpus.mkdir(exist_ok=True)
    for seed in reader.seeds():
        (corpus / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    words = {word for seed in reader.seeds() for word in re.findall(rb"[A-Za-z_]{2,40}", seed)}
    (to / "words").write_text("".join(f'"{word.decode()}"\n' for word in sorted(words)))
    path, seen = folder / f"file{reader.suffix}", set[str]()
    warnings.simplefilter("ignore")
    with contextlib.suppress(LoewnerError):  # at the first time, libraries are loaded
        path.write_bytes(reader.seeds()[0])
        reader.read(path)

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            reader.read(path)
        except LoewnerError:
            pass
        except Exception as error:
            # One of a kind: by its class, and where in the library it was raised.
            inside = [f for f in traceback.extract_tb(error.__traceback__) if "loewner" in f.filename]
            key = f"{type(error).__name__} {inside[-1].filename if inside else ''}:{inside[-1].lineno if inside else 0}"
            if key not in seen:
                seen.add(key)
                where = to / "findings" / hashlib.sha1(data).hexdigest()
                where.with_suffix(".txt").write_text(traceback.format_exc()[-2000:])
                where.write_bytes(data)

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, resource.RLIM_INFINITY))
    limits = [f"-timeout={LIMIT}", f"-max_total_time={seconds}", "-rss_limit_mb=0", "-max_len=20000"]
    places = [f"-artifact_prefix={to / 'findings'}/", f"-dict={to / 'words'}", str(corpus)]
    atheris.Setup([sys.argv[0], *limits, *places], one)
    atheris.Fuzz()


def memory() -> str | None:
    """A folder in memory, if there is one: each execution writes a file."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


if __name__ == "__main__":
    sys.exit(main())
