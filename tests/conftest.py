"""Shared set-up: the oracles and families beside this file are importable, Hypothesis is repeatable."""

import gc
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import loewner
from loewner import Verdict
from loewner._native import singles
from loewner.robots import verdicts
from loewner.robots.checker import UNPREPARED

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "fuzz")]

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


# Garbage is collected less often, and what thousands of collected tests are made of is not looked through every time: a
# tenth of the time of all tests.
gc.set_threshold(10_000, 10, 10)


def pytest_collection_finish() -> None:
    gc.freeze()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", default="1/1", metavar="K/N", help="run the k-th of n parts of the chosen tests")


@pytest.hookimpl(trylast=True)  # after tests were chosen by name and by mark
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave every n-th test: neighbours take about as long as each other, so parts do, too."""
    part = config.getoption("--part")
    found = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", part)
    if not found or int(found[1]) > int(found[2]):
        raise pytest.UsageError(f"--part: expected K/N with K from 1 to N, found {part!r}")
    kept = items[int(found[1]) - 1 :: int(found[2])]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(kept)])
    items[:] = kept


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where the long proofs are not run, they are not imported either: all in their folder are marked."""
    return True if collection_path.name == "verify" and "not verify" in config.option.markexpr else None


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240229)


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
        monkeypatch.setattr(verdicts, "pair_verdicts", lambda ready, _: np.full(len(ready.pairs), Verdict.AMBIGUOUS))
        monkeypatch.setattr(singles, "configurations", lambda *_: singles.LongWay())
        monkeypatch.setattr(checker, "_prepared", UNPREPARED)

    return call
