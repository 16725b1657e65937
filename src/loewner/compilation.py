"""Compile ahead of first use, on all cores, the kernels that queries otherwise compile at their first call."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from loewner import _validate
from loewner._native import entries, library
from loewner.errors import FileError

_ARM = """<robot name="arm">
  <link name="base"><collision><geometry><cylinder radius="0.5" length="1"/></geometry></collision></link>
  <link name="hand"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="9" effort="1" velocity="1"/></joint>
</robot>"""


def _poses() -> np.ndarray:
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = 0.3, 1.05, 4.0
    return T


# Curved bodies where any will do: those with vertices need the kernels of hulls and fits besides.


def _verdicts() -> None:
    import loewner

    a, b = loewner.Body.cylinder(0.5, 1), loewner.Body.sphere(0.5)
    loewner.classify(a, None, b, _poses())
    loewner.collide(a, None, b, _poses(), margin=0.1)
    _validate.rigid_motions(_poses(), "T")


def _estimates() -> None:
    import loewner

    a, b = loewner.Body.cylinder(0.5, 1), loewner.Body.sphere(0.5)
    loewner.collide(a, None, b, _poses(), method="estimate")


def _crowds() -> None:
    import loewner

    balls = loewner.Bodies.spheres([0.5, 0.5, 0.5])
    loewner.overlapping_pairs(balls, _poses())


def _paper() -> None:
    from loewner import paper

    paper.run(20)
    paper.mvce_by_lifted_mvie(np.random.default_rng(0).normal(size=(12, 3)))


def _distances() -> None:
    import loewner

    box, ball, tube = loewner.Body.box([1, 1, 1]), loewner.Body.ellipsoid([1, 2, 3]), loewner.Body.cylinder(1, 1)
    for body in (box, ball, tube):
        loewner.distance(box, None, body, _poses(), exact=True)
    loewner.distance(ball, None, ball, _poses(), exact=True)
    touching = np.eye(4)
    touching[0, 3] = 1.0
    loewner.collide(box, None, box, touching)  # the fallback, which is made of the same searches


def _fits() -> None:
    import loewner

    points = np.random.default_rng(0).normal(size=(12, 3))
    loewner.Body.from_points(points)
    round_points = np.random.default_rng(0).normal(size=(400, 3))
    loewner.Body.from_points(round_points / np.linalg.norm(round_points, axis=1)[:, None])  # with a map of directions
    loewner.mvce(points)
    loewner.mvie(points)
    one, other = (loewner.Ellipsoids([x, 0.0, 0.0], np.eye(3)) for x in (0.0, 3.0))
    loewner.near_points(one, other)
    loewner.contact_function(one, other)
    loewner.overlap(one, other)


def _robots() -> None:
    import loewner
    from loewner import planners

    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder, "arm.urdf")
        urdf.write_text(_ARM, encoding="utf-8")
        robot = loewner.Robot.from_urdf(urdf)
    robot.forward_kinematics([[0.0]])
    checker = loewner.CollisionChecker(robot, skip_adjacent=False)
    checker.collide([[0.0], [5.0]])
    checker.valid_edges([5.0], [6.0], resolution=0.5)
    checker.certify_edges([5.0], [6.0])
    planners.plan(checker, [5.0], [6.0])
    planners.shorten(checker, [[5.0], [5.5], [6.0]])


_PARTS = {
    "verdicts": _verdicts, "crowds": _crowds, "robots": _robots, "fits": _fits, "distances": _distances,
    "estimates": _estimates, "paper": _paper,
}  # fmt: skip
PARTS = tuple(_PARTS)

# What one process compiles, since most of it is the same; those that take longest first.
_TOGETHER = (("verdicts", "crowds", "robots"), ("fits",), ("distances", "estimates", "paper"))

POLL = 0.1  # seconds between looks at the processes


def compile_kernels(parts: Iterable[str] = PARTS, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Compile kernels for this machine now, in as many processes as are useful.

    Kernels that have been compiled before are only looked up, which takes some seconds. Where the native library is in
    use there is nothing to compile.

    Parameters
    ----------
    parts : iterable of str
        Any of "verdicts", "crowds", "robots", "fits", "distances", "estimates" and "paper"; all by default.
    progress : callable, optional
        Called as ``progress(done, total)`` after each part.

    Returns
    -------
    Path
        The folder that holds the compiled code, or the native library.

    Raises
    ------
    InputError, UnknownNameError
        If there is no such part.
    MissingExtraError
        If there is neither a library nor Numba.
    FileError
        If a part cannot be compiled, or the folder cannot be written; the message includes the output of the process.
    """
    wanted = [_validate.choice(name, "parts", PARTS) for name in _validate.listed(parts, "parts")]
    chosen = [[name for name in group if name in wanted] for group in _TOGETHER]
    _validate.callback(progress, "progress")
    if library.level() is not None:
        return library.HOME
    entries.expect_numba()
    from loewner._kernels._jit import CACHE_FOLDER

    waiting, running, ended = [names for names in chosen if names], list[_Group](), 0
    total, told = sum(map(len, chosen)), 0
    folder = tempfile.TemporaryDirectory()
    try:
        while waiting or running:
            while waiting and len(running) < (os.cpu_count() or 1):
                running.append(_Group(waiting.pop(0), Path(folder.name)))
            time.sleep(POLL)
            for group in [group for group in running if group.process.poll() is not None]:
                group.check()
                running.remove(group)
                ended += len(group.names)
            done = ended + sum(group.done() for group in running)
            if progress is not None:
                for number in range(told + 1, done + 1):
                    progress(number, total)
            told = done
    finally:
        for group in running:
            group.process.kill()
            group.process.wait()
        folder.cleanup()
    return CACHE_FOLDER


class _Group:
    """Some parts in a process of their own: Numba compiles one function at a time in each."""

    def __init__(self, names: list[str], folder: Path) -> None:
        self.names = names
        # Files, not pipes: nobody has to read them in time, and a full pipe would stop the process.
        self._told, self._said = folder / f"{names[0]}.out", folder / f"{names[0]}.err"
        environment = {**os.environ, "LOEWNER_QUIET": "1"}
        command = [sys.executable, "-c", _code(names)]
        with self._told.open("wb") as told, self._said.open("wb") as said:
            self.process = subprocess.Popen(command, env=environment, stdout=told, stderr=said)

    def done(self) -> int:
        """How many parts are done."""
        return sum(line in self.names for line in self._told.read_text(encoding="utf-8", errors="replace").splitlines())

    def check(self) -> None:
        """Raise what the process ended with."""
        if self.process.returncode:
            what, why = ", ".join(self.names), self._said.read_text(encoding="utf-8", errors="replace").strip()[-2000:]
            raise FileError(f"the kernels for {what} could not be compiled:\n{why}")


def _code(names: list[str]) -> str:
    # This package, wherever it lies. And Numba makes millions of small objects that stay: looking through them for
    # garbage takes a sixth of the time.
    return f"""
import gc, sys
sys.path.insert(0, {str(Path(__file__).parent.parent)!r})
gc.set_threshold(200_000, 50, 100)
from loewner._kernels import _jit
from loewner.compilation import _PARTS
for name in {names!r}:
    _PARTS[name]()
    print(name, flush=True)
sys.exit(_jit.unwritten())
"""
