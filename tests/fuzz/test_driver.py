"""The driver of hostile cases tells every kind of outcome."""

import os
import signal
import time

import driver
from loewner import InputError


def task(case: str) -> str | None:
    if case == driver.REFUSED:
        raise InputError("no")
    if case == driver.RAW:
        raise ValueError("raw")
    if case == driver.CRASH:
        os.kill(os.getpid(), signal.SIGSEGV)
    if case == driver.HANG:
        time.sleep(60)
    return "wrong" if case == driver.WRONG else None


def test_every_kind_of_outcome_is_told():
    """Crashes and hangs cost no other case its outcome."""
    kinds = [driver.OK, driver.CRASH, driver.REFUSED, driver.HANG, driver.RAW, driver.WRONG, driver.OK]
    outcomes = driver.run(task, kinds, limit=2.5)
    assert [outcome.kind for outcome in outcomes] == kinds
    assert all(kind in driver.faults(outcomes) for kind in driver.FAULTS)
    assert driver.faults(outcomes[:1]) == ""
