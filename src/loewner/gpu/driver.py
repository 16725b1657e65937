"""Call NVIDIA's driver through ctypes: open a GPU, allocate its memory, run kernels, and explain errors.

The driver is the library that comes with the GPU's software, ``libcuda.so.1`` or ``nvcuda.dll``; the CUDA toolkit is
not needed. When a `Device` is opened, the driver compiles the PTX of `loewner.gpu._ptx` for its GPU, and keeps the
result on disk.

All work goes to one stream, in order. The context is the GPU's primary context. PyTorch, JAX and CuPy also use this
context, so their memory can be read here.
"""

from __future__ import annotations

import contextlib
import ctypes
import sys
import threading
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner.errors import GpuError
from loewner.gpu import _ptx

LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"

# Number of threads in a block. Every GPU since `_ptx.OLDEST` has registers for at least six blocks of this size at a
# time.
BLOCK = 128

# Codes of errors for which this module has its own messages.
OUT_OF_MEMORY, NO_DEVICE, UNSUPPORTED_PTX, INVALID_PTX, NO_IMAGE = 2, 100, 222, 218, 209
OLD_DRIVER = (34, 35, 36, 803)

# After these errors, the context can no longer be used; it holds all of this process's work on the GPU.
LOST = (201, 700, 702, 709, 710, 714, 715, 716, 717, 718, 719, 721, 999)

# Messages without numbers, keyed by the code of the error.
CAUSES = {
    **dict.fromkeys(LOST, "the GPU's work was lost, and everything that this process keeps there; restart the process"),
    **dict.fromkeys(OLD_DRIVER, "expected a newer driver of the GPU: update it"),
    NO_DEVICE: "expected an NVIDIA GPU, found none",
}

# Attributes that contain a GPU's compute capability, and the lowest accepted capability, which is sm_75.
MAJOR, MINOR, LEAST_CAPABILITY = 75, 76, (7, 5)

# Options of the driver's compiler: the buffer for its log, and the buffer's size.
ERROR_LOG, ERROR_LOG_SIZE, LOG_BYTES = 5, 6, 8192

ORDINAL_OF_POINTER = 9
NOT_WAITING_FOR_THE_DEFAULT_STREAM = 1
WITHOUT_TIMES = 2


class Memory:
    """Memory of a GPU, freed when the last reference to it is dropped.

    Attributes
    ----------
    address, size : int
    device : Device
    """

    def __init__(self, device: Device, address: int, size: int) -> None:
        self.device, self.address, self.size = device, address, size
        weakref.finalize(self, device._free, address)


class Device:
    """One GPU, with the kernels loaded.

    Parameters
    ----------
    number : int
        Index of the GPU among those visible to the driver.
    cuda : object
        The driver's functions.

    Attributes
    ----------
    number : int
    name : str
    capability : tuple of int
    driver : int
        Version of CUDA that the driver supports: 1000 times the major version, plus 10 times the minor version.

    Raises
    ------
    GpuError
        If there is no such GPU, or the driver is too old or refuses the kernels.
    """

    def __init__(self, number: int, cuda: Any) -> None:
        self.number, self._cuda, self.lost = number, cuda, False
        self._ask("cuInit", 0)
        self.driver = self._integer("cuDriverGetVersion")
        count = self._integer("cuDeviceGetCount")
        if not 0 <= number < count:
            raise GpuError(f"device: expected one of the {count} GPUs that the driver sees, found number {number}")
        handle = self._integer("cuDeviceGet", number)
        text = ctypes.create_string_buffer(256)
        self._ask("cuDeviceGetName", text, len(text), handle)
        self.name = text.value.decode(errors="replace")
        major, minor = (self._integer("cuDeviceGetAttribute", which, handle) for which in (MAJOR, MINOR))
        self.capability = major, minor
        if self.capability < LEAST_CAPABILITY:
            raise GpuError(
                "device: expected a GPU of compute capability 7.5 (Turing) or newer, found "
                f"{self.name} of {major}.{minor}"
            )
        self._context = ctypes.c_void_p()
        self._ask("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), handle)
        with self._current():
            self._stream = ctypes.c_void_p()
            self._ask("cuStreamCreate", ctypes.byref(self._stream), NOT_WAITING_FOR_THE_DEFAULT_STREAM)
            self._functions = self._load(_ptx.text())

    @property
    def stream(self) -> int:
        """The stream that receives all work, as a number."""
        return int(self._stream.value or 0)

    # -- memory -------------------------------------------------------------------------------

    def memory(self, size: int) -> Memory:
        """Allocate at least one byte of memory."""
        address = ctypes.c_uint64()
        self._run("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(max(1, size)), size=size)
        return Memory(self, int(address.value), size)

    def upload(self, array: NDArray[Any]) -> Memory:
        """Copy an array to the GPU."""
        array = np.ascontiguousarray(array)
        to = self.memory(array.nbytes)
        if array.nbytes:
            there, here, size = _places(to.address, array)
            self._run("cuMemcpyHtoDAsync_v2", there, here, size, self._stream)
        return to

    def download(self, address: int, array: NDArray[Any]) -> None:
        """Fill an array from the GPU's memory after all earlier work."""
        there, here, size = _places(address, array)
        if array.nbytes:
            self._run("cuMemcpyDtoHAsync_v2", here, there, size, self._stream)
        self.wait()

    def clear(self, address: int, size: int) -> None:
        """Set memory to zero."""
        self._run("cuMemsetD8Async", ctypes.c_uint64(address), 0, ctypes.c_size_t(size), self._stream)

    # -- work ---------------------------------------------------------------------------------

    def launch(self, kernel: str, threads: int, *arguments: int | Memory) -> None:
        """Run a kernel in `threads` threads; its arguments are the number of threads, and then `arguments`."""
        if threads == 0:
            return
        numbers = [ctypes.c_int64(x.address if isinstance(x, Memory) else x) for x in (threads, *arguments)]
        packed = (ctypes.c_void_p * len(numbers))(*map(ctypes.addressof, numbers))
        sizes = -(-threads // BLOCK), 1, 1, BLOCK, 1, 1, 0
        self._run("cuLaunchKernel", self._functions[kernel], *sizes, self._stream, packed, None)

    def wait(self) -> None:
        """Wait until all work is done."""
        self._run("cuStreamSynchronize", self._stream)

    def after(self, stream: int) -> None:
        """Let all later work wait for the present work of another stream."""
        if stream == self.stream:
            return
        event, other = ctypes.c_void_p(), ctypes.c_void_p(stream)
        self._run("cuEventCreate", ctypes.byref(event), WITHOUT_TIMES)
        self._run("cuEventRecord", event, other)
        self._run("cuStreamWaitEvent", self._stream, event, 0)
        self._run("cuEventDestroy_v2", event)  # the driver frees the event once the event has been reached

    def time(self) -> Any:
        """Record a point in time on the stream; `seconds` computes the time between two such points."""
        event = ctypes.c_void_p()
        self._run("cuEventCreate", ctypes.byref(event), 0)
        self._run("cuEventRecord", event, self._stream)
        return event

    def seconds(self, start: Any, stop: Any) -> float:
        """Wait for two recorded points in time, free them, and return the seconds between them."""
        milliseconds = ctypes.c_float()
        self._run("cuEventSynchronize", stop)
        self._run("cuEventElapsedTime", ctypes.byref(milliseconds), start, stop)
        for event in (start, stop):
            self._run("cuEventDestroy_v2", event)
        return float(milliseconds.value) * 1e-3

    def holds(self, address: int) -> bool:
        """Return whether an address belongs to this GPU's memory."""
        ordinal = ctypes.c_int(-1)
        with self._current():
            code = self._cuda.cuPointerGetAttribute(ctypes.byref(ordinal), ORDINAL_OF_POINTER, ctypes.c_uint64(address))
        return code == 0 and ordinal.value == self.number

    # -- inside -------------------------------------------------------------------------------

    def _load(self, ptx: bytes) -> dict[str, Any]:
        """Let the driver compile the kernels for its GPU."""
        module, log = ctypes.c_void_p(), ctypes.create_string_buffer(LOG_BYTES)
        options = (ctypes.c_int * 2)(ERROR_LOG, ERROR_LOG_SIZE)
        values = (ctypes.c_void_p * 2)(ctypes.cast(log, ctypes.c_void_p), ctypes.c_void_p(LOG_BYTES))
        code = self._cuda.cuModuleLoadDataEx(ctypes.byref(module), ctypes.c_char_p(ptx), 2, options, values)
        if code:
            raise self._error("cuModuleLoadDataEx", code, said=log.value.decode(errors="replace").strip())
        functions = {}
        for name in (name for names in _ptx.KERNELS.values() for name in names):
            functions[name] = ctypes.c_void_p()
            self._ask("cuModuleGetFunction", ctypes.byref(functions[name]), module, ctypes.c_char_p(name.encode()))
        return functions

    @contextlib.contextmanager
    def _current(self) -> Iterator[None]:
        """Make the context current on this thread for the duration of a block."""
        self._ask("cuCtxPushCurrent_v2", self._context)
        try:
            yield
        finally:
            self._cuda.cuCtxPopCurrent_v2(ctypes.byref(ctypes.c_void_p()))

    def _integer(self, function: str, *arguments: Any) -> int:
        """Call a function that writes one integer."""
        integer = ctypes.c_int()
        self._ask(function, ctypes.byref(integer), *arguments)
        return int(integer.value)

    def _run(self, function: str, *arguments: Any, size: int | None = None) -> None:
        """Make the context current, and call a function of the driver as `_ask` does."""
        with self._current():
            self._ask(function, *arguments, size=size)

    def _ask(self, function: str, *arguments: Any, size: int | None = None) -> None:
        """Call a function of the driver, and raise an exception if it fails."""
        code = getattr(self._cuda, function)(*arguments)
        if code:
            raise self._error(function, code, size=size)

    def _error(self, function: str, code: int, size: int | None = None, said: str = "") -> GpuError:
        """Make the error for a code, with the driver's explanation and, for some codes, a clearer explanation."""
        self.lost = self.lost or code in LOST
        cause, text = CAUSES.get(code), f"{function}: {self._words(code)}"
        if code == OUT_OF_MEMORY and size is not None:
            cause = f"expected {size / 1e6:.0f} MB of memory on the GPU, found less; pass fewer at a time"
        elif code in (UNSUPPORTED_PTX, INVALID_PTX, NO_IMAGE):
            wanted = f"PTX {_ptx.VERSION[3]}.{_ptx.VERSION[4]} (CUDA 11.0 or newer)"
            version = f"CUDA {self.driver // 1000}.{self.driver % 1000 // 10}"
            cause = f"expected a driver that takes {wanted}, found one for {version} that refuses it; update the driver"
        return GpuError((f"{cause} ({text})" if cause else text) + (f": {said}" if said else ""), code)

    def _words(self, code: int) -> str:
        """Return the driver's name and description of an error."""
        words = []
        for function in ("cuGetErrorName", "cuGetErrorString"):
            text = ctypes.c_char_p()
            if getattr(self._cuda, function)(code, ctypes.byref(text)) == 0 and text.value:
                words.append(text.value.decode(errors="replace"))
        return f"{', '.join(words)} ({code})" if words else f"error {code}"

    def _free(self, address: int) -> None:
        """Free memory; at the end of a process or of a context, the memory may have been freed already."""
        with contextlib.suppress(Exception), self._current():
            self._cuda.cuMemFree_v2(ctypes.c_uint64(address))


def _places(address: int, array: NDArray[Any]) -> tuple[Any, Any, Any]:
    """Return the driver's arguments for copying an array: address on the GPU, address on the CPU, and size."""
    return ctypes.c_uint64(address), ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes)


_opened: dict[int, Device] = {}
_lock = threading.Lock()


def opened(number: int) -> Device:
    """Return a GPU, opened once per process.

    Raises
    ------
    GpuError
        If there is no driver or no such GPU, or the GPU cannot be used.
    """
    with _lock:
        device = _opened.get(number)
        if device is None or device.lost:
            device = _opened[number] = Device(number, library())
        return device


def library() -> Any:
    """Load the driver."""
    try:
        return getattr(ctypes, "WinDLL" if sys.platform == "win32" else "CDLL")(LIBRARY)
    except OSError as error:
        raise GpuError(f"expected NVIDIA's driver, found no {LIBRARY} to load ({error})") from None
