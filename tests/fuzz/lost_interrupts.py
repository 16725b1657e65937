"""Interrupts during calls of one process, and how many of them are lost; it imports little, since it starts anew."""

import gc
import random
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import loewner
from families import random_poses
from loewner import Body


def losses(count: int, seed: int) -> tuple[int, list[str]]:
    """Interrupt `collide` shared by two threads, and in every other round the garbage collector after it.

    Return how many interrupts were lost, and where. The handler counts what it raises, so the test itself loses none:
    each is caught in the call, or in the wait after it.

    Python drops what is raised in a finalizer, such as a weak reference's callback. A signal that arrives while the
    collector works is handled in the first finalizer in Python of what it found; each thread of `call` has one. So an
    interrupted call must leave nothing to the collector: neither its own objects nor, by a traceback, the callers'.
    """
    rng, draw, raised, caught = np.random.default_rng(0), random.Random(seed), 0, 0
    rock, drum = Body.from_points(rng.normal(size=(40, 3))), Body.cylinder(0.5, 2.0)
    Ta, Tb = random_poses(rng, 12_000), random_poses(rng, 12_000)
    dropped: list[str] = []

    def interrupt(*_: Any) -> None:
        nonlocal raised
        raised += 1
        raise KeyboardInterrupt

    def call(k: int) -> None:
        thread = threading.Thread(target=int)
        thread.start()
        thread.join()
        usual = colliding if k % 2 == 0 else colliding + collecting
        signal.setitimer(signal.ITIMER_REAL, 1e-6 + draw.random() * usual)
        loewner.collide(rock, Ta, drum, Tb)
        if k % 2:
            gc.collect()
        while raised == k:
            time.sleep(0.0002)

    before = signal.signal(signal.SIGALRM, interrupt), sys.unraisablehook, loewner.get_num_threads()
    sys.unraisablehook = lambda what: dropped.append(f"{what.exc_type.__name__} in {what.object}")
    loewner.set_num_threads(2)
    gc.collect()
    gc.freeze()  # as `conftest.py` does: the collector then takes as long as `heap` needs, not all that is loaded
    heap = [[n] for n in range(100_000)]
    try:
        right = loewner.collide(rock, Ta, drum, Tb)
        colliding, collecting = timed(lambda: loewner.collide(rock, Ta, drum, Tb)), timed(gc.collect)
        for k in range(count):
            try:
                call(k)
            except KeyboardInterrupt:
                caught += 1
        assert np.array_equal(loewner.collide(rock, Ta, drum, Tb), right)
        assert len(heap) == 100_000
    finally:
        signal.signal(signal.SIGALRM, before[0])
        sys.unraisablehook = before[1]
        loewner.set_num_threads(before[2])
    return raised - caught, dropped


def timed(call: Callable[[], Any]) -> float:
    """Duration of a call [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
