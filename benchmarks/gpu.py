"""Pairs and configurations on a GPU: how many a second, and whether the answers are the CPU's.

    python benchmarks/gpu.py [--pairs N] [--configurations N] [--device NUMBER]

Experimental, as `loewner.gpu` is: nobody has run it on hardware yet. Without a GPU it says so and ends.

    pairs            turned hulls of twenty points, bodies and poses on the GPU already: the kernel alone, G pairs/s,
                     the bytes that it reads and writes by the second and their share of what the GPU copies by the
                     second; then with the CPU's part; and whether all verdicts are `classify`'s
    configurations   Panda among ten obstacles, on the GPU already: the kernels alone, with the CPU's part, and whether
                     all answers are `CollisionChecker.collide`'s
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from loewner import Bodies, CollisionChecker, classify, gpu
from loewner._kernels import columns
from loewner.gpu import arrays, driver
from loewner.gpu.driver import Device
from robot_samples import obstacles, panda
from samples import Array, poses, rotations

KINDS, POINTS, SPREAD, SEED = 1000, 20, 1.0, 1
ROUNDS = 20

# What a pair moves: two rows of a piece, two poses of twelve numbers each that matter, of sixteen, and a verdict.
BYTES = 2 * 4 * columns.HOT + 2 * 4 * 16 + 1


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
    parser.add_argument("--configurations", type=int, default=1_000_000)
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


def copied(device: Device, size: int = 2**28) -> float:
    """Bytes a second that a kernel of ours reads and writes when it only copies rows in order."""
    rows = device.upload(np.arange(size // 64, dtype=np.int32))
    table, to = device.memory(size), device.memory(size)
    seconds = in_kernels(
        device, lambda: device.launch("gather_rows", size // 4, 16, rows.address, table.address, to.address)
    )
    return 2 * size / seconds


def measure_pairs(device: Device, count: int) -> bool:
    """Pairs a second; whether the verdicts are the CPU's."""
    rng = np.random.default_rng(SEED)
    bodies = Bodies.from_points(list(rng.normal(size=(KINDS, POINTS, 3)) * 0.3))
    chosen = rng.integers(0, KINDS, size=(2, count))
    a, b = bodies[chosen[0]], bodies[chosen[1]]
    Ta, Tb = (poses(rotations(rng, count), rng.uniform(-SPREAD, SPREAD, (count, 3))) for _ in range(2))
    here = [T.astype(np.float32).astype(np.float64) for T in (Ta, Tb)]
    there = [OnGpu(device, T) for T in (Ta, Tb)]

    def ask(refine: bool) -> arrays.DeviceArray:
        return gpu.classify(a, there[0], b, there[1], refine=refine, device=device.number)

    seconds = in_kernels(device, lambda: ask(False))
    start = time.perf_counter()
    verdicts = np.asarray(ask(True))
    whole = time.perf_counter() - start
    share = BYTES * count / seconds / copied(device)
    agree = bool((verdicts == classify(a, here[0], b, here[1])).all())
    told = f"{'all' if agree else 'NOT ALL'} verdicts as on the CPU"
    print(
        f"pairs: {count / seconds / 1e9:.2f} G/s, {BYTES * count / seconds / 1e9:.0f} GB/s, {share:.0%} of what it "
        f"copies; with the CPU's part {count / whole / 1e6:.0f} M/s; {told}"
    )
    return agree


def measure_configurations(device: Device, count: int) -> bool:
    """Configurations a second; whether the answers are the checker's."""
    checker = CollisionChecker(panda().robot, obstacles(SEED))
    Q = checker.robot.random_configurations(count, SEED).astype(np.float32)
    there, on_gpu = OnGpu(device, Q), gpu.Checker(checker, device=device.number)
    ready = checker._ready()
    address = there._memory.address
    seconds = in_kernels(device, lambda: on_gpu._asked(device, ready, address, count))
    left = len(on_gpu._asked(device, ready, address, count)[1])
    start = time.perf_counter()
    answers = np.asarray(on_gpu.collide(there))
    whole = time.perf_counter() - start
    agree = bool((answers == checker.collide(Q.astype(np.float64))).all())
    print(
        f"configurations: {count / seconds / 1e6:.0f} M/s, {left / count:.1%} left to the CPU; with its part "
        f"{count / whole / 1e6:.2f} M/s; {'all' if agree else 'NOT ALL'} answers as on the CPU"
    )
    return agree


if __name__ == "__main__":
    sys.exit(main())
