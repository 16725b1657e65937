"""How long the first answer takes: from the start of a process to its first `collide`, in a given interpreter.

python benchmarks/first_answer.py [--python .venv-wheel/bin/python] [--runs 5]

Times are wall clock as a caller sees them, the start of the interpreter included; the first run, which reads all files
from disk, is left out.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import loewner

BOXES = "import loewner; box = loewner.Body.box([1, 1, 1]); assert loewner.collide(box, None, box, None)"
FILES = "import loewner; a, b = map(loewner.Body.load, {paths!r}); assert loewner.collide(a, None, b, None)"
KERNELS = "from loewner._native import library; print(library.level() or library.why_not())"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--python", default=sys.executable, help="interpreter that has loewner (default: this one)")
    options.add_argument("--runs", type=int, default=5)
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder, f"{name}.npz")) for name in "ab"]
        for seed, path in enumerate(paths):
            mesh_like(seed).save(path)
        print(f"{chosen.python}: {run(chosen.python, KERNELS).strip()}; load {os.getloadavg()[0]:.1f}")
        for what, code in (
            ("an interpreter that does nothing", "pass"),
            ("import numpy", "import numpy"),
            ("import loewner", "import loewner"),
            ("first collide of two boxes", BOXES),
            ("first collide of two bodies from .npz", FILES.format(paths=paths)),
        ):
            times = measured(chosen.python, code, chosen.runs)
            print(f"{what:40s} median {statistics.median(times):.3f} s   {' '.join(f'{t:.3f}' for t in times)}")


def mesh_like(seed: int) -> loewner.Body:
    """A body of four pieces of eighty vertices each, as a decomposed mesh has them."""
    rng = np.random.default_rng(seed)
    pieces = [rng.normal(size=(80, 3)) / 10 + [0.2 * n, 0, 0] for n in range(4)]
    return loewner.Body.union([loewner.Body.from_points(points) for points in pieces])


def measured(python: str, code: str, runs: int) -> list[float]:
    """Wall time of some processes, in seconds, after one that is not counted."""
    times = []
    for _ in range(runs + 1):
        start = time.perf_counter()
        run(python, code)
        times.append(time.perf_counter() - start)
    return times[1:]


def run(python: str, code: str) -> str:
    """What a process prints that sees neither this one's folder nor its paths."""
    hidden = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
    clean = {name: value for name, value in os.environ.items() if name not in hidden}
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([python, "-c", code], cwd=folder, env=clean, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{python}: {done.stderr.strip()}")
    return done.stdout


if __name__ == "__main__":
    main()
