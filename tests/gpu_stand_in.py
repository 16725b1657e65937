"""A stand-in for NVIDIA's driver: its functions, with memory of the CPU and the threads of a kernel in a loop.

It checks what it is told as far as it can: contexts that are current, memory that was allocated. Any function can be
told to refuse.
"""

import ctypes
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from loewner._kernels._jit import njit
from loewner.gpu import _ptx, driver

INVALID_VALUE, INVALID_CONTEXT, NOT_FOUND = 1, 201, 500

# Names and texts of the driver, of the errors that tests ask about.
WORDS = {
    1: ("CUDA_ERROR_INVALID_VALUE", "invalid argument"),
    2: ("CUDA_ERROR_OUT_OF_MEMORY", "out of memory"),
    35: ("CUDA_ERROR_INSUFFICIENT_DRIVER", "CUDA driver version is insufficient for CUDA runtime version"),
    100: ("CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected"),
    201: ("CUDA_ERROR_INVALID_CONTEXT", "invalid device context"),
    222: ("CUDA_ERROR_UNSUPPORTED_PTX_VERSION", "the provided PTX was compiled with an unsupported toolchain."),
    700: ("CUDA_ERROR_ILLEGAL_ADDRESS", "an illegal memory access was encountered"),
    709: ("CUDA_ERROR_CONTEXT_IS_DESTROYED", "context is destroyed"),
}


@cache
def looped(kernel: str) -> Any:
    """The threads of a kernel, one after the other: ``loop(threads, *arguments)``."""
    (module,) = (module for module, names in _ptx.KERNELS.items() if kernel in names)
    thread = getattr(import_module(f"loewner._kernels.threads.{module}"), kernel)

    @njit()
    def loop(threads: int, *arguments: int) -> None:
        for k in range(threads):
            thread(k, *arguments)

    return loop


def put_in(monkeypatch: pytest.MonkeyPatch, made: "StandIn") -> None:
    """Have a stand-in take the driver's place; it knows kernels by their names, so none is compiled for a GPU."""
    monkeypatch.setattr(driver, "library", lambda: made)
    monkeypatch.setattr(_ptx, "text", lambda: b"// the stand-in reads none of this")


def value_of(argument: Any) -> Any:
    """The number of an argument of ctypes, or of Python."""
    return getattr(argument, "value", argument)


class StandIn:
    """The functions of the driver that are asked for.

    Parameters
    ----------
    refuses : dict of str to int
        Codes that functions return.
    after : int
        How often such a function works before it refuses.
    gpus : int
    capability : tuple of int
    log : bytes
        What the driver's compiler says if it refuses.
    """

    def __init__(self, refuses=None, after=0, gpus=1, capability=(9, 0), log=b""):
        self.refuses, self.after, self.gpus, self.capability = dict(refuses or {}), after, gpus, capability
        self.log = log
        self.calls: list[str] = []
        self.launches: list[str] = []
        self.memory: dict[int, np.ndarray] = {}
        self.pushed, self.made = 0, 1
        self.functions: dict[int, str] = {}
        self.waited: list[int] = []

    def __getattribute__(self, name: str) -> Any:
        """Count calls, and refuse those that are to be."""
        found = object.__getattribute__(self, name)
        if not name.startswith("cu"):
            return found

        def called(*arguments: Any) -> int:
            self.calls.append(name)
            if name in self.refuses and self.calls.count(name) > self.after:
                if name == "cuModuleLoadDataEx":
                    ctypes.memmove(arguments[4][0], self.log + b"\0", len(self.log) + 1)
                return self.refuses[name]
            return found(*arguments) or 0

        return called

    def _new(self) -> int:
        self.made += 1
        return self.made

    def _array(self, address: int, size: int) -> np.ndarray | None:
        """Memory at an address, if so much was allocated."""
        for begin, array in list(self.memory.items()):  # other threads allocate meanwhile
            if begin <= address and address + size <= begin + array.size:
                return array[address - begin : address - begin + size]
        return None

    def cuInit(self, flags):
        assert flags == 0

    def cuDriverGetVersion(self, found):
        found._obj.value = 12040

    def cuDeviceGetCount(self, found):
        found._obj.value = self.gpus

    def cuDeviceGet(self, found, number):
        found._obj.value = 7 + number

    def cuDeviceGetName(self, text, size, handle):
        assert handle >= 7
        text.value = b"Stand-in"

    def cuDeviceGetAttribute(self, found, which, handle):
        found._obj.value = self.capability[{75: 0, 76: 1}[which]]

    def cuDevicePrimaryCtxRetain(self, context, handle):
        context._obj.value = 99

    def cuCtxPushCurrent_v2(self, context):
        assert value_of(context) == 99
        self.pushed += 1

    def cuCtxPopCurrent_v2(self, context):
        assert self.pushed > 0
        self.pushed -= 1

    def cuModuleLoadDataEx(self, module, text, count, options, values):
        assert self.pushed
        assert text.value.startswith(b"//") or b".version" in text.value
        assert (count, list(options)) == (2, [5, 6])
        module._obj.value = self._new()

    def cuModuleGetFunction(self, function, module, name):
        if name.value.decode() not in {name for names in _ptx.KERNELS.values() for name in names}:
            return NOT_FOUND
        function._obj.value = self._new()
        self.functions[function._obj.value] = name.value.decode()
        return 0

    def cuStreamCreate(self, stream, flags):
        assert flags == 1
        stream._obj.value = self._new()

    def cuStreamSynchronize(self, stream):
        assert self.pushed

    def cuStreamWaitEvent(self, stream, event, flags):
        assert value_of(event) is not None

    def cuEventCreate(self, event, flags):
        event._obj.value = self._new()

    def cuEventRecord(self, event, stream):
        self.waited.append(value_of(stream))

    def cuEventSynchronize(self, event):
        pass

    def cuEventElapsedTime(self, found, start, stop):
        found._obj.value = 2.0

    def cuEventDestroy_v2(self, event):
        pass

    def cuMemAlloc_v2(self, address, size):
        if not self.pushed:
            return INVALID_CONTEXT
        raw = np.empty(value_of(size) + 256, dtype=np.uint8)
        skip = -raw.ctypes.data % 256
        array = raw[skip : skip + value_of(size)]
        array[:] = 0xEE  # nobody may count on zeros
        self.memory[array.ctypes.data] = array
        address._obj.value = array.ctypes.data
        return 0

    def cuMemFree_v2(self, address):
        return 0 if self.memory.pop(value_of(address), None) is not None else INVALID_VALUE

    def _copied(self, to: int, source: int, size: int, on_gpu: int) -> int:
        if not self.pushed or self._array(on_gpu, size) is None:
            return INVALID_VALUE
        ctypes.memmove(to, source, size)
        return 0

    def cuMemcpyHtoDAsync_v2(self, to, source, size, stream):
        return self._copied(value_of(to), value_of(source), value_of(size), value_of(to))

    def cuMemcpyDtoHAsync_v2(self, to, source, size, stream):
        return self._copied(value_of(to), value_of(source), value_of(size), value_of(source))

    def cuMemsetD8Async(self, address, value, size, stream):
        array = self._array(value_of(address), value_of(size))
        if array is None:
            return INVALID_VALUE
        array[:] = value
        return 0

    def cuPointerGetAttribute(self, found, which, address):
        assert which == 9
        if self._array(value_of(address), 1) is None:
            return INVALID_VALUE
        found._obj.value = 0
        return 0

    def cuLaunchKernel(self, function, x, y, z, bx, by, bz, shared, stream, parameters, extra):
        assert self.pushed
        assert (y, z, by, bz, shared, extra) == (1, 1, 1, 1, 0, None)
        name = self.functions[value_of(function)]
        numbers = [ctypes.cast(address, ctypes.POINTER(ctypes.c_int64)).contents.value for address in parameters]
        assert 0 < numbers[0] <= x * bx < numbers[0] + bx
        self.launches.append(name)
        looped(name)(*numbers)

    def cuGetErrorName(self, code, text):
        if code not in WORDS:
            return INVALID_VALUE
        text._obj.value = WORDS[code][0].encode()
        return 0

    def cuGetErrorString(self, code, text):
        if code not in WORDS:
            return INVALID_VALUE
        text._obj.value = WORDS[code][1].encode()
        return 0


class OnGpu:
    """An array in the stand-in's memory, as another library would have it: by one of the two interfaces.

    Attributes
    ----------
    shape : tuple of int
    """

    def __init__(self, driver: StandIn, array: np.ndarray, stream: int | None = 1, **changes: Any) -> None:
        raw = np.empty(array.nbytes + 512, dtype=np.uint8)
        skip = -raw.ctypes.data % 256
        self._memory = raw[skip : skip + max(1, array.nbytes)]
        self._memory[: array.nbytes] = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        driver.memory[self._memory.ctypes.data] = self._memory
        self.shape, kind = array.shape, array.dtype.str
        self.__cuda_array_interface__ = {
            "shape": self.shape, "typestr": kind, "data": (self._memory.ctypes.data, False), "version": 3,
            "stream": stream, **changes,
        }  # fmt: skip
