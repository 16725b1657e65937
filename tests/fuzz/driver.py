"""Hostile cases, one after the other, in a process that may crash or hang without taking the tests with it."""

import faulthandler
import multiprocessing
import os
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from loewner import LoewnerError

# A case that takes longer hangs [s]. It is ten times what the slowest takes on a busy machine.
LIMIT = 150.0

OK, REFUSED, WRONG, RAW, CRASH, HANG = "ok", "refused", "wrong", "raw exception", "crash", "hang"
FAULTS = (WRONG, RAW, CRASH, HANG)


@dataclass(frozen=True)
class Outcome:
    """What became of one case: OK, REFUSED by a child of LoewnerError, or one of FAULTS."""

    case: Any
    kind: str
    text: str = ""


def run(task: Callable[[Any], str | None], cases: Sequence[Any], *, limit: float = LIMIT) -> list[Outcome]:
    """Outcomes of task(case): it returns None where all is well, or says what is wrong with the answer.

    The task runs in a forked process, which is replaced after a crash or a hang; it must not rely on what earlier
    cases left behind.
    """
    outcomes: list[Outcome] = []
    while len(outcomes) < len(cases):
        _until_a_death(task, cases, outcomes, limit)
    return outcomes


def faults(outcomes: list[Outcome], most: int = 5) -> str:
    """Counts by kind and the first few faults, for the message of an assertion; empty if there are none."""
    bad = [outcome for outcome in outcomes if outcome.kind in FAULTS]
    if not bad:
        return ""
    lines = [f"{outcome.kind}: {str(outcome.case)[:200]}\n{outcome.text[-1500:]}" for outcome in bad[:most]]
    return "\n".join([str(dict(Counter(outcome.kind for outcome in outcomes))), *lines])


def _until_a_death(task: Any, cases: Sequence[Any], outcomes: list[Outcome], limit: float) -> None:
    """Take cases from the first without an outcome to the last, or to one that kills or hangs the process."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # about forking where there are threads: they stay idle
        child = context.Process(target=_work, args=(task, cases, len(outcomes), theirs))
        child.start()
    theirs.close()
    try:
        while len(outcomes) < len(cases):
            if not ours.poll(limit):
                outcomes.append(Outcome(cases[len(outcomes)], HANG, f"no answer in {limit:g} s"))
                return
            try:
                kind, text = ours.recv()
            except EOFError:
                child.join()
                outcomes.append(Outcome(cases[len(outcomes)], CRASH, f"exit code {child.exitcode}"))
                return
            outcomes.append(Outcome(cases[len(outcomes)], kind, text))
    finally:
        child.kill()
        child.join()
        ours.close()


def _work(task: Any, cases: Sequence[Any], first: int, pipe: Any) -> None:
    faulthandler.disable()  # a crash is an outcome here
    for case in cases[first:]:
        try:
            said = task(case)
            pipe.send((OK, "") if said is None else (WRONG, said))
        except LoewnerError as error:
            pipe.send((REFUSED, f"{type(error).__name__}: {error}"))
        except BaseException:
            pipe.send((RAW, traceback.format_exc()))
    os._exit(0)
