"""Shared set-up: the oracles and families beside this file are importable, Hypothesis is repeatable."""

import gc
import json
import os
import re
import signal
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import loewner
from loewner import Verdict
from loewner._native import entries, library, singles
from loewner.cli import jobs
from loewner.robots.checker import UNPREPARED
from loewner.robots.checking import pair_cache, verdicts

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "fuzz")]

import long_cases  # noqa: E402  # beside this file, too
import sampling  # noqa: E402
from gantry import gantry_robot, wall  # noqa: E402

# The same examples every run: a red test must be red again on the next run.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")


if os.environ.get("LOEWNER_INSTALLED") == "required":  # by `make test-wheel`
    SOURCES = Path(__file__).parents[1] / "src"
    if SOURCES in Path(loewner.__file__).parents:
        raise pytest.UsageError(f"expected an installed loewner, found {loewner.__file__}")


# A suite that a shell runs in its background ignores interrupts, and so would the processes that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Garbage is collected less often, and what thousands of collected tests are made of is not looked through every time: a
# tenth of the time of all tests.
gc.set_threshold(10_000, 10, 10)


# Answers about pairs that one test keeps would be warnings in another one.
pair_cache.FOLDER = Path(os.devnull) / "pairs"


# Files go to processes in the order of their cases (`--no-loadscope-reorder`). Two with oracles come first, one for a
# process: what Numba compiles for one, in seconds, the other finds on disk. Then come those that take long although
# they have few cases: a browser, and a checker of types.
FIRST = [str(Path(__file__).parent / name) for name in ("test_oracles", "test_surface_oracle", "viewer", "test_types")]


def place_of(item: pytest.Item) -> tuple[int, str]:
    """Place of a test's file: in this list, or after it by name."""
    file = str(item.path)
    return next((k for k, name in enumerate(FIRST) if file.startswith(name)), len(FIRST)), file


class Backwards:
    """A plugin for each second process of several, which all read all tests: it reads the last file first.

    In a fresh clone two processes then rewrite the assertions of half of the files each, and find the others on disk.
    """

    class Folder(pytest.Dir):
        def collect(self) -> list[pytest.Item | pytest.Collector]:
            return list(super().collect())[::-1]

    def pytest_collect_directory(self, path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        return None if (path / "__init__.py").exists() else self.Folder.from_parent(parent, path=path)


def pytest_collection_finish() -> None:
    gc.freeze()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", default="1/1", metavar="K/N", help="run the k-th of n parts of the chosen tests")


@pytest.hookimpl(trylast=True)  # after tests were chosen by name and by mark
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with some files, and leave every n-th test: neighbours take about as long as each other, so parts do, too.

    Tests of a file that share a fixture stay together, since a wheel, say, takes minutes to build.
    """
    items.sort(key=place_of)
    part = config.getoption("--part")
    found = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", part)
    if not found or int(found[1]) > int(found[2]):
        raise pytest.UsageError(f"--part: expected K/N with K from 1 to N, found {part!r}")
    groups: dict[str, int] = {}
    parts = [groups.setdefault(group_of(item), len(groups)) % int(found[2]) for item in items]
    chosen = [number == int(found[1]) - 1 for number in parts]
    config.hook.pytest_deselected(items=[item for item, kept in zip(items, chosen, strict=True) if not kept])
    items[:] = [item for item, kept in zip(items, chosen, strict=True) if kept]


def group_of(item: pytest.Item) -> str:
    """Name of a test, or of its file if it has a fixture that the tests of this file share."""
    file = item.nodeid.partition("::")[0]
    known = item._fixtureinfo.name2fixturedefs.values() if isinstance(item, pytest.Function) else ()
    return file if any(one[-1].scope != "function" and one[-1].baseid == file for one in known) else item.nodeid


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(long_cases)
    sampling.quick_suite = "not verify" in config.option.markexpr
    if getattr(config, "workerinput", {}).get("workerid", "gw0")[-1] in "13579":
        config.pluginmanager.register(Backwards())


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files without a case to run are not imported: the long proofs, all in a folder, or files without a light case."""
    words = config.option.markexpr
    if collection_path.name == "verify" and "not verify" in words:
        return True
    if words == "light" and collection_path.name.startswith("test_"):
        return "pytest.mark.light" not in collection_path.read_text() or None
    return None


@pytest.fixture(autouse=True)
def without_kernels(request: pytest.FixtureRequest) -> None:
    """Light cases run without the library, so one that calls a kernel fails instead of compiling it."""
    if request.node.get_closest_marker("light"):
        monkeypatch = request.getfixturevalue("monkeypatch")

        def refused(*_: object) -> None:
            pytest.fail("a case with the mark `light` called a kernel: it has to run without the library")

        for module, names in ((entries, entries.ENTRIES), (singles, singles.PAIRS)):
            for name in names:
                monkeypatch.setitem(vars(module), name, refused)
        monkeypatch.setattr(library, "_opened", refused)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240229)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The gantry, unless a file has another robot."""
    return gantry_robot(tmp_path_factory.mktemp("gantry"))


@pytest.fixture(scope="module")
def alone(robot):
    """A robot with nothing around it."""
    return loewner.CollisionChecker(robot)


@pytest.fixture
def scene():
    """The gantry's wall."""
    return wall()


@pytest.fixture
def checker(robot, scene):
    return loewner.CollisionChecker(robot, scene)


@pytest.fixture
def calls(monkeypatch):
    """Shapes about which a checker's clearance is computed, and whether with gradients."""
    seen, ask = [], loewner.CollisionChecker.clearance

    def counted(self, Q, **options):
        seen.append((Q.shape, options["gradient"]))
        return ask(self, Q, **options)

    monkeypatch.setattr(loewner.CollisionChecker, "clearance", counted)
    return seen


@pytest.fixture
def fits_here(monkeypatch):
    """Have `loewner fit` work in this process, where it is the bodies and not the processes that are tested."""

    def answers(entry, tasks, count):
        serve_task = import_module(entry).serve_task
        for place, task in enumerate(json.loads(json.dumps(tasks))):
            yield jobs.Event("begun", place)
            yield jobs.Event("answer", place, json.loads(json.dumps(serve_task(task, lambda *_: None))))

    monkeypatch.setattr(jobs, "answers", answers)


@pytest.fixture
def undecided(monkeypatch):
    """Have arithmetic fail to settle configurations of a checker: all of them, or those that a function picks."""

    def call(checker, chosen=lambda Q: np.ones(len(Q), dtype=bool)):
        classified = verdicts.classified

        def doubtful(ready, mode, Q):
            found = classified(ready, mode, Q)
            found.verdicts[chosen(Q)] = Verdict.AMBIGUOUS
            return found

        monkeypatch.setattr(verdicts, "classified", doubtful)
        monkeypatch.setattr(verdicts, "pair_verdicts", lambda ready, *_: np.full(len(ready.pairs), Verdict.AMBIGUOUS))
        monkeypatch.setattr(singles, "configurations", lambda *_: singles.LongWay())
        monkeypatch.setattr(checker, "_prepared", UNPREPARED)

    return call
