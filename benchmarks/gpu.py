"""Pairs and configurations on a GPU: how many a second, and whether the answers are the CPU's.

    python benchmarks/gpu.py [--pairs N] [--configurations N] [--motions N] [--device NUMBER]

Without a GPU it says so and ends. All bodies, poses and configurations are on the GPU already.

    pairs            turned hulls of twenty points: the kernel alone, the bytes of poses and verdicts by the second and
                     their share of what the GPU copies by the second; with the CPU's part; the CPU alone; and whether
                     all verdicts are `classify`'s
    configurations   Panda among ten obstacles: the kernels alone, the whole call, the CPU alone, and whether all
                     answers are `CollisionChecker.collide`'s
    sizes            whole calls for few and many configurations and motions, from which size on the GPU is faster
    motions          the same, from a random configuration some share of the way to another one, for
                     `CollisionChecker.certify_edges`; a verdict that only the GPU or only the CPU can give is no fault
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from loewner import Bodies, CollisionChecker, classify, gpu
from loewner._kernels import codes
from loewner.gpu import arrays, driver
from loewner.gpu.driver import Device
from loewner.gpu.motions import certified, slots
from loewner.robots.checker import prepared_of
from robot_samples import obstacles, panda
from samples import Array, poses, rotations

KINDS, POINTS, SPREAD, SEED = 1000, 20, 1.0, 1
ROUNDS = 20

# What a pair moves: two poses and a verdict. The rows of the pieces stay in the cache.
BYTES = 2 * 4 * 16 + 1

SHARES = 1.0, 0.3, 0.05

SIZES = 1, 100, 1_000, 10_000, 100_000


class OnGpu:
    """An array on the GPU, as another library would hand it over."""

    def __init__(self, device: Device, array: Array) -> None:
        self._memory = device.upload(array.astype(np.float32))
        self.__cuda_array_interface__ = {
            "shape": array.shape, "typestr": "<f4", "data": (self._memory.address, False), "version": 3,
        }  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=10_000_000)
    parser.add_argument("--configurations", type=int, default=10_000_000)
    parser.add_argument("--motions", type=int, default=1_000_000)
    parser.add_argument("--device", type=int, default=0)
    asked = parser.parse_args(arguments)
    missing = gpu.why_not(asked.device)
    if missing:
        print(f"no GPU to measure: {missing}")
        return 0
    device = driver.opened(asked.device)
    print(
        f"{device.name}, compute capability {device.capability[0]}.{device.capability[1]}, CUDA {device.driver // 1000}"
    )
    print(f"copies {copied(device) / 1e9:.0f} GB/s, read and written")
    agree = measure_pairs(device, asked.pairs) & measure_configurations(device, asked.configurations)
    for share in SHARES:
        agree &= measure_motions(device, asked.motions, share)
    measure_sizes(device)
    return 0 if agree else 1


def in_kernels(device: Device, run: Callable[[], Any]) -> float:
    """Seconds that a call spends in kernels, on the GPU's own clock: the median of some runs after a first."""
    moments: list[tuple[Any, Any]] = []
    launch = device.launch

    def watched(*arguments: Any) -> None:
        start = device.time()
        launch(*arguments)
        moments.append((start, device.time()))

    run()
    times = []
    for _ in range(ROUNDS):
        moments.clear()
        vars(device)["launch"] = watched
        try:
            run()
        finally:
            del vars(device)["launch"]
        times.append(sum(device.seconds(*moment) for moment in moments))
    return float(np.median(times))


def copied(device: Device, size: int = 2**30) -> float:
    """Bytes a second that the GPU reads and writes when it only copies."""
    source, to = device.memory(size), device.memory(size)

    def copy() -> float:
        start = device.time()
        with device._current():
            device._ask(
                "cuMemcpyDtoDAsync_v2", ctypes.c_uint64(to.address), ctypes.c_uint64(source.address),
                ctypes.c_size_t(size), device._stream,
            )  # fmt: skip
        return device.seconds(start, device.time())

    return 2 * size / float(np.median([copy() for _ in range(ROUNDS)]))


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the best of three calls, and what it returns."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        found = run()
        times.append(time.perf_counter() - start)
    return min(times), found


def measure_pairs(device: Device, count: int) -> bool:
    """Pairs a second; whether the verdicts are the CPU's."""
    rng = np.random.default_rng(SEED)
    a = Bodies.from_points(list(rng.normal(size=(KINDS, POINTS, 3)) * 0.3))
    b = a[rng.permutation(KINDS)]
    shape = -(-count // KINDS), KINDS
    count = shape[0] * KINDS
    Ta, Tb = (
        poses(rotations(rng, count), rng.uniform(-SPREAD, SPREAD, (count, 3))).reshape(*shape, 4, 4) for _ in range(2)
    )
    here = [T.astype(np.float32).astype(np.float64) for T in (Ta, Tb)]
    there = [OnGpu(device, T) for T in (Ta, Tb)]

    def ask(refine: bool) -> arrays.DeviceArray:
        return gpu.classify(a, there[0], b, there[1], refine=refine, device=device.number)

    seconds = in_kernels(device, lambda: ask(False))
    share = BYTES * count / seconds / copied(device)
    whole, verdicts = timed(lambda: np.asarray(ask(True)))
    alone, expected = timed(lambda: classify(a, here[0], b, here[1]))
    agree = bool((verdicts == expected).all())
    print(
        f"{count} pairs: {count / seconds / 1e9:.2f} G/s, {share:.0%} of what it copies; with the CPU's part "
        f"{count / whole / 1e6:.0f} M/s, the CPU alone {count / alone / 1e6:.0f} M/s; {told(agree)}"
    )
    return agree


def told(agree: bool) -> str:
    return "all as on the CPU" if agree else "NOT ALL as on the CPU"


def measure_configurations(device: Device, count: int) -> bool:
    """Configurations a second; whether the answers are the checker's."""
    checker = CollisionChecker(panda().robot, obstacles(SEED))
    Q = checker.robot.random_configurations(count, SEED).astype(np.float32)
    there, on_gpu = OnGpu(device, Q), gpu.Checker(checker, device=device.number)
    ready, address = prepared_of(checker), there._memory.address
    seconds = in_kernels(device, lambda: on_gpu._asked(ready, device, count, address))
    left = len(on_gpu._asked(ready, device, count, address)[1])
    whole, answers = timed(lambda: np.asarray(on_gpu.collide(there)))
    alone, expected = timed(lambda: checker.collide(Q.astype(np.float64)))
    agree = bool((answers == expected).all())
    print(
        f"{count} configurations: {count / seconds / 1e6:.0f} M/s, {left / count:.2%} left to the CPU; with its part "
        f"{count / whole / 1e6:.0f} M/s, the CPU alone {count / alone / 1e6:.1f} M/s; {told(agree)}"
    )
    return agree


def measure_motions(device: Device, count: int, share: float) -> bool:
    """Proven motions a second; whether any verdict contradicts the checker's."""
    checker = CollisionChecker(panda().robot, obstacles(SEED))
    Q0 = checker.robot.random_configurations(count, SEED)
    Q1 = Q0 + share * (checker.robot.random_configurations(count, SEED + 1) - Q0)
    ends = [Q.astype(np.float32) for Q in (Q0, Q1)]
    there, on_gpu = [OnGpu(device, Q) for Q in ends], gpu.Checker(checker, device=device.number)
    addresses = there[0]._memory.address, there[1]._memory.address
    tables = on_gpu._tables_of(device, prepared_of(checker))
    asked = device, tables, on_gpu._tile_of(device, tables, slots(count)), checker.robot.dof, addresses, count
    seconds = in_kernels(device, lambda: certified(*asked))
    left = len(certified(*asked)[1])
    whole, verdicts = timed(lambda: np.asarray(on_gpu.certify_edges(*there)))
    alone, expected = timed(lambda: checker.certify_edges(*(Q.astype(np.float64) for Q in ends)).verdict)
    agree = not ((verdicts != expected) & (verdicts != codes.AMBIGUOUS) & (expected != codes.AMBIGUOUS)).any()
    print(
        f"{count} motions over {share:g} of the way ({(expected == codes.FREE).mean():.0%} free): "
        f"{count / seconds / 1e6:.2f} M/s, {left / count:.2%} left to the CPU; with its part "
        f"{count / whole / 1e6:.2f} M/s, the CPU alone {count / alone / 1e6:.2f} M/s; {told(agree)}"
    )
    return agree


def measure_sizes(device: Device) -> None:
    """Microseconds of whole calls, on the GPU and on the CPU."""
    checker = CollisionChecker(panda().robot, obstacles(SEED))
    on_gpu = gpu.Checker(checker, device=device.number)
    for count in SIZES:
        Q0, Q1 = (checker.robot.random_configurations(count, SEED + k) for k in range(2))
        Q1 = Q0 + 0.3 * (Q1 - Q0)
        there = [OnGpu(device, Q) for Q in (Q0, Q1)]
        compare(f"{count} configurations", partial(on_gpu.collide, there[0]), partial(checker.collide, Q0))
        compare(f"{count} motions", partial(on_gpu.certify_edges, *there), partial(checker.certify_edges, Q0, Q1))


def compare(what: str, there: Callable[[], Any], here: Callable[[], Any]) -> None:
    np.asarray(there())
    print(f"{what}: {timed(lambda: np.asarray(there()))[0] * 1e6:.0f} us, the CPU alone {timed(here)[0] * 1e6:.0f} us")


if __name__ == "__main__":
    sys.exit(main())
