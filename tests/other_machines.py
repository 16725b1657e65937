"""Let this machine compute as others do, by switches of its libraries, and run the core of the quick suite so.

    python tests/other_machines.py

NumPy works without its wide registers, OpenBLAS with its routines for older processors, and loewner with its kernels
for a lower level, if this processor has one and they were built. No answer may depend on any of this.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from loewner._native import library

HERE = Path(__file__).parent

# The tests of answers: those of pages, files, windows and processes are the same on every machine.
CORE = (
    "batch_invariance", "bodies", "capi", "certificate_at_contact", "certified_constants", "certified_motions",
    "changed_scenes", "checkers", "clearance", "contacts", "courses", "crowds", "curves", "depth_searches",
    "ellipsoid_pairs", "ellipsoids", "exports", "first_contacts", "fits", "gjk_batch", "gradients", "improving",
    "inscribed", "invariance", "jerk", "joined_robots", "kept_axes", "large_inner_fits", "large_outer_fits",
    "lattice_soups", "lines", "meshes", "motion_bounds", "moving_bodies", "native_calls", "other_machines",
    "pair_proofs", "parts", "piece_trees", "planes", "planners", "plans_in_time", "polytopes", "pose_goals",
    "protrusion", "queries", "reach", "roadmaps", "robots", "scenes", "second_checker", "sensed", "sliding_motions",
    "support_search", "surface_depths", "surfaces", "tracking", "trajectories", "written_proofs",
)  # fmt: skip

# OpenBLAS's routines for processors with AVX2, which fuse products with sums, and for some without. Other BLAS
# libraries, such as that of macOS, take no notice.
NEWER, OLDER = {"OPENBLAS_CORETYPE": "Haswell"}, {"OPENBLAS_CORETYPE": "Nehalem"}


def without_wide_registers() -> dict[str, str]:
    """Return the switch that keeps NumPy from using features that this processor has; empty if there are none."""
    core = getattr(np, "_core", None) or np.core  # NumPy 1 names it so
    umath = core._multiarray_umath
    chosen = [name for name in umath.__cpu_dispatch__ if umath.__cpu_features__.get(name)]
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(chosen)} if chosen else {}


def lower_level() -> dict[str, str]:
    """Return the switch to the kernels for the lowest level that was built; empty if no other than those in use was."""
    built = [level for level in library.levels() if (library.HOME / f"kernels-{level}.so").exists()]
    return {"LOEWNER_LEVEL": built[-1]} if len(built) > 1 else {}


def machines() -> dict[str, dict[str, str]]:
    """Return the switches of the machines that this one can stand for."""
    return {"with AVX2": NEWER | lower_level(), "before AVX": OLDER | without_wide_registers()}


def environment(switches: dict[str, str]) -> dict[str, str]:
    """Return the variables of a process with these switches, whatever switches this process has."""
    own = {"NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE", "LOEWNER_LEVEL"}
    return {name: value for name, value in os.environ.items() if name not in own} | switches


def main() -> int:
    """Run the core on each of these machines; arguments are handed on to pytest."""
    if not lower_level():
        print("other-machines: kernels for one level were built, or run here, so LOEWNER_LEVEL stays", flush=True)
    worst = 0
    for machine, switches in machines().items():
        print(f"other-machines: {machine}:", *(f"{name}={value!r}" for name, value in switches.items()), flush=True)
        files = [str(HERE / f"test_{name}.py") for name in CORE]
        command = [sys.executable, "-m", "pytest", *sys.argv[1:], "-m", "not verify and not fuzz", *files]
        worst = max(worst, subprocess.run(command, env=environment(switches), check=False).returncode)
    return worst


if __name__ == "__main__":
    sys.exit(main())
