"""The GPU's driver, arrays of other libraries, and what happens where there is no GPU: with a stand-in driver."""

import ctypes
import gc
import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import loewner
from checker_oracle import robot_of
from families import pieces, random_poses
from gantry import beside_a_post
from gpu_stand_in import OnGpu, StandIn, put_in
from loewner import Bodies, Body, CollisionChecker, GpuError, InputError, PoseError, Verdict, gpu
from loewner.gpu import arrays, driver, work


@pytest.fixture(autouse=True)
def anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """No GPU is open, and nobody was warned yet."""
    monkeypatch.setattr(driver, "_opened", {})
    monkeypatch.setattr(work, "_warned", False)


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """A GPU that works."""
    return installed(monkeypatch)


def installed(monkeypatch: pytest.MonkeyPatch, **options) -> StandIn:
    """A driver with a GPU; options as of `StandIn`."""
    made = StandIn(**options)
    put_in(monkeypatch, made)
    monkeypatch.setattr(driver, "_opened", {})
    return made


def some_pairs(rng: np.random.Generator, n: int = 40):
    """Bodies and poses, in float32 as well."""
    bodies = Bodies.from_points(pieces("ball 20", n))
    Ta, Tb = (random_poses(rng, n, 1.0).astype(np.float32).astype(np.float64) for _ in range(2))
    return bodies, Ta, Tb


# -- pairs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shapes", [((), ()), ((40,), (40,)), ((3, 1), (40,)), ((2, 1, 1), (3, 40)), ((40,), ())])
def test_operands_broadcast_as_on_the_cpu(shapes, card, rng):
    """Poses of any shapes, bodies of one or many, and no poses at all."""
    bodies = Bodies.from_points(pieces("ball 20", 40))
    Ta, Tb = (random_poses(rng, int(np.prod(shape, dtype=int)), 0.7).reshape(*shape, 4, 4) for shape in shapes)
    for a, b in ((bodies, bodies), (bodies[3], bodies), (bodies[3], bodies[4])):
        np.testing.assert_array_equal(gpu.classify(a, Ta, b, Tb), loewner.classify(a, Ta, b, Tb))
        np.testing.assert_array_equal(gpu.classify(a, None, b, Tb), loewner.classify(a, None, b, Tb))
    assert isinstance(gpu.classify(bodies[0], None, bodies[1], None), Verdict)


def test_listed_pairs(card, rng):
    """Pairs by number of a body at its pose, in any shape."""
    bodies, Ta, Tb = some_pairs(rng)
    chosen = rng.integers(0, 40, size=(7, 5, 2))
    expected = loewner.classify(bodies, Ta, bodies, Tb, pairs=chosen)
    np.testing.assert_array_equal(gpu.classify(bodies, Ta, bodies, Tb, pairs=chosen), expected)
    chosen[..., 0] = 0
    expected = loewner.classify(bodies[2], None, bodies, Tb, pairs=chosen)
    np.testing.assert_array_equal(gpu.classify(bodies[2], None, bodies, Tb, pairs=chosen), expected)


def test_no_pairs_at_all(card):
    """A batch of none asks nobody."""
    ball = Body.sphere(1.0)
    assert gpu.classify(ball, np.empty((0, 4, 4)), ball, None).shape == (0,)
    assert "cuLaunchKernel" not in card.calls


def test_bodies_are_copied_to_the_gpu_once(card, rng):
    """A second question about the same bodies copies poses only; the GPU's memory is given back when all is gone."""
    bodies, Ta, Tb = some_pairs(rng)
    gpu.classify(bodies, Ta, bodies, Tb)
    first = card.calls.count("cuMemcpyHtoDAsync_v2")
    held = set(card.memory)
    gpu.classify(bodies, Ta, bodies, Tb)
    assert card.calls.count("cuMemcpyHtoDAsync_v2") - first < first
    assert set(card.memory) == held
    del bodies
    gc.collect()
    assert len(card.memory) == 0
    assert card.pushed == 0


def test_poses_on_the_gpu(card, rng):
    """Arrays on the GPU are asked about as they are; answers stay there, and are the CPU's for the same numbers."""
    bodies, Ta, Tb = some_pairs(rng)
    expected = loewner.classify(bodies, Ta, bodies, Tb)
    found = gpu.classify(bodies, OnGpu(card, Ta.astype(np.float32)), bodies, OnGpu(card, Tb.astype(np.float32)))
    assert isinstance(found, arrays.DeviceArray)
    assert (found.shape, found.dtype, len(found)) == ((40,), np.int8, 40)
    np.testing.assert_array_equal(np.asarray(found), expected)
    np.testing.assert_array_equal(found.__array__(np.int64), expected)
    mixed = gpu.classify(bodies, OnGpu(card, Ta.astype(np.float32)), bodies, Tb)
    np.testing.assert_array_equal(np.asarray(mixed), expected)
    told = found.__cuda_array_interface__
    assert (told["shape"], told["typestr"], told["version"]) == ((40,), "|i1", 3)
    assert "on Stand-in" in repr(found)


def test_the_gpu_waits_for_the_array(card, rng):
    """Work begins when the stream of the array has done what it had to do before."""
    ball, T = Body.sphere(1.0), random_poses(rng, 4, 1.0).astype(np.float32)
    gpu.classify(ball, OnGpu(card, T, stream=77), ball, None)
    assert card.waited == [77]
    gpu.classify(ball, OnGpu(card, T, stream=None), ball, None)
    assert card.waited == [77]


def test_without_refinement_what_is_left_is_ambiguous(card, rng):
    """`refine=False` asks the CPU nothing, and claims nothing that is not so."""
    bodies, Ta, Tb = some_pairs(rng)
    Ta[3, 0, 0] += 0.5
    found = gpu.classify(bodies, Ta, bodies, Tb, refine=False)
    assert found[3] == Verdict.AMBIGUOUS
    with pytest.raises(PoseError, match="T_world_a: expected a rotation"):
        gpu.classify(bodies, Ta, bodies, Tb)


@pytest.mark.parametrize("many", [False, True])
def test_a_pose_that_is_none_is_found(many, card, rng):
    """Not rigid, not finite, beyond single precision: an error, or the CPU's verdict, as without the GPU."""
    bodies = Bodies.from_points(pieces("ball 20", 3)) if many else Body.from_points(pieces("ball 20", 1)[0])
    T = random_poses(rng, 3, 1.0)
    T[1, 0, 3] = 1e200
    np.testing.assert_array_equal(gpu.classify(bodies, T, bodies, None), loewner.classify(bodies, T, bodies, None))
    T[1, 0, 3] = np.nan
    with pytest.raises(PoseError, match="found NaN or inf"):
        gpu.classify(bodies, T, bodies, None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda card, T: OnGpu(card, T), "expected float32 on the GPU, found float64"),
        (lambda card, T: OnGpu(card, T.astype("i4")), "expected float32 on the GPU, found int32"),
        (lambda card, T: OnGpu(card, T.astype("f4"), strides=(64, 4, 16)), "expected an array in C order"),
        (lambda card, T: OnGpu(card, T.astype(">f4"), typestr=">f4"), "byte order"),
        (lambda card, T: OnGpu(card, T.astype("f4"), mask=object()), "without a mask"),
        (lambda card, T: OnGpu(card, T.astype("f4"), data=(1 << 40, False)), "found one elsewhere"),
        (lambda card, T: OnGpu(card, T.astype("f4"), data=(4, False)), "multiple of 16 bytes"),
        (lambda card, T: OnGpu(card, T.astype("f4"), data="here"), "found a malformed one"),
        (
            lambda card, T: OnGpu(card, T.astype("f4")[:, :3]),
            r"expected poses of shape \(..., 4, 4\), found \(5, 3, 4\)",
        ),
    ],
)
def test_arrays_that_cannot_be_taken(make, message, card, rng):
    """An array of another type, order, place or shape is refused, with words that say what is wrong."""
    ball = Body.sphere(1.0)
    with pytest.raises(InputError, match=message):
        gpu.classify(ball, make(card, random_poses(rng, 5, 1.0)), ball, None)


def test_arguments_are_checked(card):
    """Bodies, numbers of devices, fallbacks and flags that are none."""
    ball = Body.sphere(1.0)
    for arguments, options, message in (
        ((ball, None, "b", None), {}, "b: expected loewner.Body"),
        ((ball, None, ball, None), {"device": -1}, "device: expected"),
        ((ball, None, ball, None), {"fallback": "gpu"}, "fallback: expected one of"),
        ((ball, None, ball, None), {"refine": 2}, "refine: expected"),
    ):
        with pytest.raises(loewner.LoewnerError, match=message):
            gpu.classify(*arguments, **options)
    with pytest.raises(InputError, match=r"expected pieces between 1e-3 and 1e3 m"):
        gpu.classify(Body.sphere(1e-5), None, ball, None)
    with pytest.raises(PoseError, match="broadcast"):
        gpu.classify(ball, np.tile(np.eye(4), (2, 1, 1)), ball, np.tile(np.eye(4), (3, 1, 1)))
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker, found str"):
        gpu.Checker("checker")


# -- DLPack ----------------------------------------------------------------------------------------


class ByDlpack:
    """An array on the GPU that is shared by DLPack alone."""

    def __init__(self, array: OnGpu, number: int = 0) -> None:
        self.array, self.number, self.streams = array, number, []

    def __dlpack_device__(self):
        return arrays.CUDA, self.number

    def __dlpack__(self, stream=None):
        self.streams.append(stream)
        told = self.array.__cuda_array_interface__
        shape = (ctypes.c_int64 * len(self.array.shape))(*self.array.shape)
        bits = 8 * np.dtype(told["typestr"]).itemsize
        tensor = arrays._DLTensor(
            told["data"][0], arrays._DLDevice(arrays.CUDA, 0), len(shape), arrays._DLType(2, bits, 1),
            ctypes.cast(shape, ctypes.POINTER(ctypes.c_int64)), None, 0,
        )  # fmt: skip
        managed = arrays._DLManaged(tensor, None, arrays._give_back)
        arrays._lent[ctypes.addressof(managed)] = managed, shape, self.array
        return arrays._api.PyCapsule_New(ctypes.addressof(managed), b"dltensor", None)


def test_arrays_are_taken_by_dlpack_and_given_back(card, rng):
    """An array without the other interface is taken by DLPack, on our stream, and given back when nobody needs it."""
    bodies, Ta, Tb = some_pairs(rng)
    shared = ByDlpack(OnGpu(card, Ta.astype(np.float32)))
    found = gpu.classify(bodies, shared, bodies, Tb)
    np.testing.assert_array_equal(np.asarray(found), loewner.classify(bodies, Ta, bodies, Tb))
    assert shared.streams == [driver.opened(0).stream]
    gc.collect()
    assert arrays._lent == {}
    with pytest.raises(InputError, match="on GPU 0, found one on GPU 3"):
        gpu.classify(bodies, ByDlpack(OnGpu(card, Ta.astype(np.float32)), 3), bodies, Tb)
    with pytest.raises(InputError, match="float32 on the GPU, found float64"):
        gpu.classify(bodies, ByDlpack(OnGpu(card, Ta)), bodies, Tb)


def test_results_are_lent_by_dlpack(card, rng):
    """What others take of a result they hold until they give it back; a capsule that nobody took holds nothing."""
    bodies, Ta, Tb = some_pairs(rng)
    found = gpu.classify(bodies, OnGpu(card, Ta.astype(np.float32)), bodies, Tb)
    assert found.__dlpack_device__() == (2, 0)
    capsule = found.__dlpack__(stream=1)
    assert len(arrays._lent) == 1
    del capsule
    assert arrays._lent == {}
    taken = arrays._by_dlpack(found, "found", driver.opened(0))
    assert taken[:3] == (found._memory.address, (40,), "i1")
    assert len(arrays._lent) == 1
    del found, taken
    gc.collect()
    assert arrays._lent == {}


class OfNumpy:
    """An array of NumPy that says it is on a GPU."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __dlpack_device__(self):
        return arrays.CUDA, 0

    def __dlpack__(self, stream=None):
        return self.array.__dlpack__()


def test_capsules_are_those_of_other_libraries(card, monkeypatch):
    """What NumPy lends is read as it is laid out, strides and all; what is lent to NumPy it reads as it is."""
    device = driver.opened(0)
    given = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    for array in (given, given[:, ::2], given.astype(np.int8)):
        address, shape, kind, strides, _ = arrays._by_dlpack(OfNumpy(array), "given", device)
        assert (address, shape, kind) == (array.ctypes.data, array.shape, array.dtype.str[1:])
        assert strides is None or array.dtype != np.float32 or strides == array.strides
    memory = device.upload(np.arange(6, dtype=np.int8))
    monkeypatch.setattr(arrays, "CUDA", 1)  # the CPU's number, which NumPy takes
    for dtype in (np.int8, np.bool_):
        lent = arrays.DeviceArray(memory, (2, 3), dtype)
        taken = np.from_dlpack(lent)
        np.testing.assert_array_equal(taken.view(np.int8), [[0, 1, 2], [3, 4, 5]])
        assert (taken.dtype, len(arrays._lent)) == (dtype, 1)
        del taken, lent
        gc.collect()
        assert arrays._lent == {}


# -- configurations --------------------------------------------------------------------------------


@pytest.fixture
def checker(tmp_path: Path) -> CollisionChecker:
    return beside_a_post(tmp_path)


@pytest.mark.verify  # it compiles kernels of a GPU for the stand-in
def test_configurations_on_the_gpu(card, checker):
    """Answers for arrays on the GPU stay there; they are the checker's for the same float32 numbers."""
    Q = checker.robot.random_configurations(60, 1).astype(np.float32).reshape(6, 10, -1)
    found = gpu.Checker(checker).collide(OnGpu(card, Q))
    assert (found.shape, found.dtype) == ((6, 10), np.bool_)
    np.testing.assert_array_equal(np.asarray(found), checker.collide(Q.astype(np.float64)))


def test_configurations_that_are_none(card, checker):
    """Widths and values are checked as by the checker itself, on the GPU too."""
    on_gpu, dof = gpu.Checker(checker), checker.robot.dof
    with pytest.raises(InputError, match=rf"Q: expected shape \(..., {dof}\)"):
        on_gpu.collide(np.zeros((3, dof + 1)))
    with pytest.raises(InputError, match=rf"Q: expected shape \(..., {dof}\)"):
        on_gpu.collide(OnGpu(card, np.zeros((3, dof + 1), np.float32)))
    Q = np.zeros((3, dof), np.float32)
    Q[1, 0] = np.nan
    for bad in (Q, OnGpu(card, Q)):
        with pytest.raises(InputError, match="finite"):
            on_gpu.collide(bad)
    assert on_gpu.collide(np.zeros((0, dof))).shape == (0,)


@pytest.mark.verify  # it compiles kernels of a GPU for the stand-in
def test_motions_on_the_gpu(card, checker):
    """Verdicts for arrays on the GPU stay there; they are the checker's for the same float32 numbers."""
    Q0, Q1 = (checker.robot.random_configurations(60, k).astype(np.float32).reshape(6, 10, -1) for k in (1, 2))
    on_gpu = gpu.Checker(checker)
    found = on_gpu.certify_edges(OnGpu(card, Q0), OnGpu(card, Q1))
    assert (found.shape, found.dtype) == ((6, 10), np.int8)
    expected = checker.certify_edges(Q0.astype(np.float64), Q1.astype(np.float64)).verdict
    np.testing.assert_array_equal(np.asarray(found), expected)
    np.testing.assert_array_equal(on_gpu.certify_edges(Q0[0, 0], Q1), checker.certify_edges(Q0[0, 0], Q1).verdict)
    assert on_gpu.certify_edges(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert on_gpu.certify_edges(OnGpu(card, Q0[:0]), OnGpu(card, Q1[:0])).shape == (0, 10)


def test_motions_that_are_none(card, checker):
    """Ends of different places, shapes or widths, or that are not finite, are refused."""
    on_gpu, Q = gpu.Checker(checker), np.zeros((3, checker.robot.dof), np.float32)
    with pytest.raises(InputError, match="expected both on the GPU or neither"):
        on_gpu.certify_edges(OnGpu(card, Q), Q)
    with pytest.raises(InputError, match="of the same shape"):
        on_gpu.certify_edges(OnGpu(card, Q), OnGpu(card, Q[:2]))
    with pytest.raises(InputError, match="tolerance: expected"):
        on_gpu.certify_edges(Q, Q, tolerance=0.0)
    for joint in range(checker.robot.dof):  # whether it matters to a pair or not
        bad = Q.copy()
        bad[1, joint] = np.nan
        for ends in ((bad, Q), (Q, bad)):
            with pytest.raises(InputError, match="finite"):
                on_gpu.certify_edges(*(OnGpu(card, end) for end in ends))
        with pytest.raises(InputError, match="finite"):
            on_gpu.collide(OnGpu(card, bad))


def test_pairs_in_contact_at_the_ends_are_refused(card, checker):
    """The rules of `leave` and `reach` are not those of the GPU."""
    checker.scene.leave(checker.robot.link_names[-1], "post")
    for fallback in ("error", "cpu"):
        with pytest.raises(InputError, match="in contact at the ends of motions"):
            gpu.Checker(checker, fallback=fallback).certify_edges(*np.zeros((2, checker.robot.dof)))


def test_limits_hold_without_a_gpu(monkeypatch, checker):
    """What the GPU does not take is refused where the CPU answers instead, too."""
    monkeypatch.setattr(driver, "LIBRARY", "libcuda-that-nobody-has.so.1")
    with pytest.raises(InputError, match="between 1e-3 and 1e3 m"):
        gpu.classify(Body.sphere(1e-4), None, Body.sphere(1.0), None, fallback="cpu")
    checker.scene.add("speck", Body.sphere(1e-4))
    with pytest.raises(InputError, match="between 1e-3 and 1e3 m"):
        gpu.Checker(checker, fallback="cpu").collide(np.zeros(checker.robot.dof))


def test_joints_that_the_gpu_does_not_know(tmp_path):
    """A robot with a joint that neither turns nor slides is refused when the checker is made."""
    robot = robot_of(
        tmp_path, [("floating", 0, ""), ("revolute", 1, '<limit lower="-1" upper="1"/>')], {"l1": Body.sphere(0.1)}
    )
    with pytest.raises(InputError, match="joints that turn or slide"):
        gpu.Checker(CollisionChecker(robot))


# -- without a GPU, and when it fails --------------------------------------------------------------


def test_here_without_a_driver(monkeypatch):
    """Where there is no driver the error says so; with the CPU as fallback it answers, with one warning."""
    monkeypatch.setattr(driver, "LIBRARY", "libcuda-that-nobody-has.so.1")
    ball, T = Body.sphere(1.0), np.eye(4)
    with pytest.raises(GpuError, match=r"expected NVIDIA's driver, found no libcuda-that-nobody-has"):
        gpu.classify(ball, None, ball, T)
    assert "expected NVIDIA's driver" in gpu.why_not()
    with pytest.warns(UserWarning, match="the CPU answers instead: expected NVIDIA's driver"):
        assert gpu.classify(ball, None, ball, T, fallback="cpu") is Verdict.COLLIDING
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert gpu.classify(ball, None, ball, T, fallback="cpu") is Verdict.COLLIDING


def test_import_loads_no_driver():
    """`import loewner.gpu` asks for no driver, no Numba and no other library."""
    script = (
        "import ctypes, sys\n"
        "def refuse(*_, **__): raise AssertionError('a library was loaded')\n"
        "import loewner\n"
        "ctypes.CDLL = refuse\n"
        "import loewner.gpu\n"
        "assert not {'numba', 'llvmlite', 'torch', 'cupy', 'jax'} & set(sys.modules), sorted(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env=os.environ)


FAULTS = [
    ({"refuses": {"cuInit": 100}}, "expected an NVIDIA GPU, found none .*CUDA_ERROR_NO_DEVICE, no CUDA-capable"),
    ({"refuses": {"cuInit": 35}}, "expected a newer driver of the GPU: update it"),
    ({"gpus": 0}, "expected one of the 0 GPUs"),
    ({"capability": (7, 0)}, r"compute capability 7.5 \(Turing\) or newer, found Stand-in of 7.0"),
    ({"refuses": {"cuModuleLoadDataEx": 222}, "log": b"ptxas fatal"}, "found one for CUDA 12.4 .*: ptxas fatal"),
    ({"refuses": {"cuMemAlloc_v2": 2}}, "expected 0 MB of memory on the GPU, found less; pass fewer"),
    ({"refuses": {"cuLaunchKernel": 700}}, "the GPU's work was lost, .*CUDA_ERROR_ILLEGAL_ADDRESS"),
    ({"refuses": {"cuStreamSynchronize": 709}}, "the GPU's work was lost"),
    ({"refuses": {"cuCtxPushCurrent_v2": 4711}}, r"cuCtxPushCurrent_v2: error 4711"),
]


@pytest.mark.parametrize(("options", "message"), FAULTS)
def test_faults_of_the_gpu(options, message, monkeypatch, rng, checker):
    """Whatever the driver refuses is an error with clear words, or the CPU's answer, as the caller chose."""
    installed(monkeypatch, **options)
    bodies, Ta, Tb = some_pairs(rng, 4)
    with pytest.raises(GpuError, match=message) as raised:
        gpu.classify(bodies, Ta, bodies, Tb)
    assert raised.value.code == next(iter(options.get("refuses", {}).values()), None)
    Q = checker.robot.random_configurations(20, 1)
    with pytest.raises(GpuError, match=message.replace("0 MB", "[0-9]+ MB")):
        gpu.Checker(checker).collide(Q)
    with pytest.warns(UserWarning, match="the CPU answers instead"):
        found = gpu.classify(bodies, Ta, bodies, Tb, fallback="cpu")
    np.testing.assert_array_equal(found, loewner.classify(bodies, Ta, bodies, Tb))
    np.testing.assert_array_equal(gpu.Checker(checker, fallback="cpu").collide(Q), checker.collide(Q))


def test_what_is_on_a_gpu_has_no_fallback(monkeypatch, rng):
    """Poses on a GPU that fails cannot be asked about on the CPU."""
    card = installed(monkeypatch, refuses={"cuLaunchKernel": 719})
    ball = Body.sphere(1.0)
    with pytest.raises(GpuError, match="work was lost"):
        gpu.classify(ball, OnGpu(card, np.eye(4, dtype=np.float32)), ball, None, fallback="cpu")


def test_a_lost_gpu_is_opened_anew(monkeypatch, rng):
    """After work was lost the next call does not use what was lost with it."""
    installed(monkeypatch, refuses={"cuLaunchKernel": 700})
    bodies, Ta, Tb = some_pairs(rng, 4)
    with pytest.raises(GpuError):
        gpu.classify(bodies, Ta, bodies, Tb)
    lost = driver._opened[0]
    made = StandIn()
    put_in(monkeypatch, made)
    np.testing.assert_array_equal(gpu.classify(bodies, Ta, bodies, Tb), loewner.classify(bodies, Ta, bodies, Tb))
    assert driver._opened[0] is not lost


def test_too_little_memory_in_the_middle(monkeypatch, rng):
    """Memory that runs out after some was given leaves nothing behind but the tables of the bodies."""
    card = installed(monkeypatch, refuses={"cuMemAlloc_v2": 2}, after=6)
    bodies, Ta, Tb = some_pairs(rng)
    with pytest.raises(GpuError, match="memory on the GPU"):
        gpu.classify(bodies, Ta, bodies, Tb)
    gc.collect()
    assert len(card.memory) <= 2
    assert card.pushed == 0


def test_errors_of_the_gpu_survive_pickling():
    """Text and code come back, as from another process."""
    error = pickle.loads(pickle.dumps(GpuError("what", 700)))
    assert (str(error), error.code) == ("what", 700)


def test_times_are_measured_on_the_stream(card):
    """Two moments on the stream give seconds."""
    device = driver.opened(0)
    assert device.seconds(device.time(), device.time()) == pytest.approx(2e-3)
    device.wait()
