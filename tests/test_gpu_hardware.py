"""What only a GPU can show: its answers, arrays of other libraries, and its own faults. Skipped where there is none."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import pieces, random_poses
from gantry import beside_a_post
from loewner import Bodies, Body, CollisionChecker, GpuError, gpu

pytestmark = pytest.mark.skipif(bool(gpu.why_not()), reason=f"no GPU here: {gpu.why_not()}")


def some_pairs(rng: np.random.Generator, n: int):
    """Bodies, and poses that single precision holds."""
    bodies = Bodies.from_points(pieces("ball 20", 200))
    Ta, Tb = (
        random_poses(rng, n * 200, 1.0).astype(np.float32).astype(np.float64).reshape(n, 200, 4, 4) for _ in range(2)
    )
    return bodies, Ta, Tb


def test_pairs(rng):
    """100,000 pairs have the CPU's verdicts, from poses of the CPU."""
    bodies, Ta, Tb = some_pairs(rng, 500)
    np.testing.assert_array_equal(gpu.classify(bodies, Ta, bodies, Tb), loewner.classify(bodies, Ta, bodies, Tb))


def of_torch(array):
    torch = pytest.importorskip("torch")
    return torch.tensor(array, device="cuda"), lambda x: torch.from_dlpack(x).cpu().numpy()


def of_cupy(array):
    cupy = pytest.importorskip("cupy")
    return cupy.asarray(array), lambda x: cupy.asnumpy(cupy.asarray(x))


def of_jax(array):
    jax = pytest.importorskip("jax")
    return jax.device_put(array, jax.devices("gpu")[0]), lambda x: np.asarray(jax.dlpack.from_dlpack(x))


def of_numba(array):
    cuda = pytest.importorskip("numba.cuda")
    return cuda.to_device(array), lambda x: cuda.as_cuda_array(x).copy_to_host()


@pytest.mark.parametrize("library", [of_torch, of_cupy, of_jax, of_numba])
def test_arrays_of_other_libraries(library, rng):
    """Poses are read where they lie, and verdicts are taken where they lie."""
    bodies, Ta, Tb = some_pairs(rng, 50)
    a, _ = library(Ta.astype(np.float32))
    b, back = library(Tb.astype(np.float32))
    found = gpu.classify(bodies, a, bodies, b)
    np.testing.assert_array_equal(back(found), loewner.classify(bodies, Ta, bodies, Tb))


@pytest.fixture
def checker(tmp_path: Path) -> CollisionChecker:
    return beside_a_post(tmp_path)


def test_configurations(checker):
    """Configurations of a robot have the checker's answers."""
    Q = checker.robot.random_configurations(100_000, 1).astype(np.float32).astype(np.float64)
    np.testing.assert_array_equal(gpu.Checker(checker).collide(Q), checker.collide(Q))


def test_motions(checker):
    """Motions of a robot have the checker's verdicts."""
    Q0, Q1 = (checker.robot.random_configurations(50_000, k).astype(np.float32).astype(np.float64) for k in (1, 2))
    found, expected = gpu.Checker(checker).certify_edges(Q0, Q1), checker.certify_edges(Q0, Q1).verdict
    assert (np.bincount(expected, minlength=3)[:2] > 1000).all()
    np.testing.assert_array_equal(found, expected)


def test_too_little_memory():
    """More than the GPU has is refused with its size, and the GPU goes on working."""
    device = gpu.driver.opened(0)
    with pytest.raises(GpuError, match="expected 100000000 MB of memory on the GPU, found less"):
        device.memory(10**14)
    assert gpu.classify(Body.sphere(1.0), None, Body.sphere(1.0), None) == loewner.Verdict.COLLIDING


LOST = """
import numpy as np, loewner
from loewner import Body, GpuError, gpu
class Lie:  # an array that says it is longer than it is
    def __init__(self, device):
        self.memory = device.upload(np.eye(4, dtype=np.float32))
        self.__cuda_array_interface__ = {"shape": (10**8, 4, 4), "typestr": "<f4", "version": 3,
                                         "data": (self.memory.address, False)}
ball = Body.sphere(1.0)
try:
    gpu.classify(ball, Lie(gpu.driver.opened(0)), ball, None)
except GpuError as error:
    print(error)
try:
    print(gpu.classify(ball, None, ball, None))
except GpuError as error:
    print(error)
print(gpu.classify(ball, None, ball, None, fallback="cpu"))
"""


def test_a_lost_context():
    """Work that reads where nothing lies is lost, and says so; the CPU answers where it may."""
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert "the GPU's work was lost" in said[0]
    assert said[-1] == "COLLIDING"


def test_no_visible_gpu():
    """A process from which the GPU is hidden says that it has none."""
    done = subprocess.run(
        [sys.executable, "-c", "from loewner import gpu; print(gpu.why_not())"], capture_output=True, text=True,
        check=True, env={**os.environ, "CUDA_VISIBLE_DEVICES": ""},
    )  # fmt: skip
    assert "expected an NVIDIA GPU, found none" in done.stdout
