"""Exchange arrays on a GPU with other libraries, by address.

CuPy, PyTorch, JAX and Numba share arrays through ``__cuda_array_interface__`` (versions 2 and 3) and DLPack. Any object
that supports one of the two protocols is accepted as an array. No library is imported, and no array is copied.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner.errors import InputError
from loewner.gpu.driver import Device, Memory

# Kinds of devices in DLPack whose memory a GPU can access: the GPU itself, and memory that it shares with the CPU.
CUDA, CUDA_MANAGED = 2, 13

# Kinds of numbers in DLPack.
KINDS = {0: "i", 1: "u", 2: "f", 6: "b"}

ALIGNED = 16  # number of bytes that kernels read at a time


class View(NamedTuple):
    """An array on the GPU.

    Attributes
    ----------
    address : int
    shape : tuple of int
    owner : object
        The object that keeps the memory alive.
    """

    address: int
    shape: tuple[int, ...]
    owner: Any


def is_on_gpu(x: Any) -> bool:
    """Return whether an object is an array on a GPU."""
    if isinstance(x, np.ndarray):
        return False
    if hasattr(x, "__cuda_array_interface__"):
        return True
    where = getattr(x, "__dlpack_device__", None)
    return callable(where) and int(where()[0]) in (CUDA, CUDA_MANAGED)


def taken(x: Any, name: str, device: Device) -> View:
    """Check a float32 array on the GPU, and return a view with its address.

    All later work on the device's stream waits for pending work on the array's own stream.

    Raises
    ------
    InputError
        If the array is not float32, not in C order, not aligned, or on a different GPU.
    """
    read = _by_interface if hasattr(x, "__cuda_array_interface__") else _by_dlpack
    address, shape, kind, strides, owner = read(x, name, device)
    size = math.prod(shape)
    if kind != "f4":
        raise InputError(f"{name}: expected float32 on the GPU, found {np.dtype(kind).name}; convert it there")
    if strides is not None and size and strides != _in_order(shape):
        raise InputError(f"{name}: expected an array in C order, found strides {strides} for shape {shape}")
    if address % ALIGNED:
        raise InputError(f"{name}: expected memory that begins at a multiple of {ALIGNED} bytes; copy the array")
    if size and not device.holds(address):
        raise InputError(f"{name}: expected an array on GPU {device.number} ({device.name}), found one elsewhere")
    return View(address, shape, owner)


def _in_order(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the strides, in bytes, of a float32 array in C order."""
    return tuple(4 * math.prod(shape[axis + 1 :]) for axis in range(len(shape)))


def _by_interface(x: Any, name: str, device: Device) -> tuple[int, tuple[int, ...], str, Any, Any]:
    """Read address, shape, kind, strides and owner through ``__cuda_array_interface__``."""
    told = x.__cuda_array_interface__
    try:
        address, _ = told["data"]
        shape, kind = tuple(int(length) for length in told["shape"]), str(told["typestr"])
        strides, masked, stream = told.get("strides"), told.get("mask"), told.get("stream")
        address = int(address or 0)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{name}: expected a __cuda_array_interface__, found a malformed one ({error!r})") from None
    if masked is not None:
        raise InputError(f"{name}: expected an array without a mask, found one with")
    if kind[:1] not in "<|=":
        raise InputError(f"{name}: expected float32 in the byte order of this machine, found {kind}")
    if stream is not None:
        device.after(int(stream))
    return address, shape, kind[1:], None if strides is None else tuple(int(s) for s in strides), x


class _DLDevice(ctypes.Structure):
    _fields_ = (("kind", ctypes.c_int32), ("number", ctypes.c_int32))


class _DLType(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16))


class _DLTensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device", _DLDevice),
        ("ndim", ctypes.c_int32),
        ("dtype", _DLType),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
    )


class _DLManaged(ctypes.Structure):
    pass


_DELETER = ctypes.CFUNCTYPE(None, ctypes.POINTER(_DLManaged))
_DLManaged._fields_ = (("tensor", _DLTensor), ("context", ctypes.c_void_p), ("deleter", _DELETER))

_CAPSULE, _USED = b"dltensor", b"used_dltensor"  # the interpreter keeps the addresses of these two

_api = ctypes.pythonapi
_api.PyCapsule_IsValid.argtypes, _api.PyCapsule_IsValid.restype = (ctypes.py_object, ctypes.c_char_p), ctypes.c_int
_api.PyCapsule_GetPointer.argtypes = ctypes.py_object, ctypes.c_char_p
_api.PyCapsule_GetPointer.restype = ctypes.c_void_p
_api.PyCapsule_SetName.argtypes, _api.PyCapsule_SetName.restype = (ctypes.py_object, ctypes.c_char_p), ctypes.c_int
_api.PyCapsule_New.argtypes = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
_api.PyCapsule_New.restype = ctypes.py_object

# While a capsule is being destroyed, it must not be referenced. These functions therefore take its address.
_DESTRUCTOR = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
_is_valid = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)(("PyCapsule_IsValid", _api))
_pointer_of = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(("PyCapsule_GetPointer", _api))


class _Borrowed:
    """A DLPack tensor, which is released when this object is destroyed."""

    def __init__(self, managed: Any) -> None:
        self.managed = managed

    def __del__(self) -> None:
        if self.managed.contents.deleter:
            self.managed.contents.deleter(self.managed)


def _by_dlpack(x: Any, name: str, device: Device) -> tuple[int, tuple[int, ...], str, Any, Any]:
    """Read address, shape, kind, strides and owner through DLPack."""
    kind, number = x.__dlpack_device__()
    if int(kind) == CUDA and int(number) != device.number:
        raise InputError(f"{name}: expected an array on GPU {device.number}, found one on GPU {int(number)}")
    capsule = x.__dlpack__(stream=device.stream)
    if not _api.PyCapsule_IsValid(capsule, _CAPSULE):
        raise InputError(f"{name}: expected a capsule of DLPack, found {_validate.short(capsule)}")
    managed = ctypes.cast(_api.PyCapsule_GetPointer(capsule, _CAPSULE), ctypes.POINTER(_DLManaged))
    _api.PyCapsule_SetName(capsule, _USED)
    owner, tensor = _Borrowed(managed), managed.contents.tensor
    of_type = tensor.dtype
    if of_type.code not in KINDS or of_type.lanes != 1:
        raise InputError(f"{name}: expected float32 on the GPU, found another kind of numbers")
    shape = tuple(tensor.shape[k] for k in range(tensor.ndim))
    strides = tuple(4 * tensor.strides[k] for k in range(tensor.ndim)) if tensor.strides else None
    address = (tensor.data or 0) + tensor.byte_offset
    return address, shape, f"{KINDS[of_type.code]}{of_type.bits // 8}", strides, owner


class DeviceArray:
    """An array of results on the GPU, for use by other libraries.

    ``cupy.asarray``, ``torch.as_tensor(..., device="cuda")``, ``torch.from_dlpack`` and ``jax.dlpack.from_dlpack`` wrap
    it in arrays of their own without copying; ``numpy.asarray`` copies the array to the CPU.

    Attributes
    ----------
    shape : tuple of int
    dtype : numpy.dtype

    Examples
    --------
    With PyTorch and a GPU:

    >>> torch.from_dlpack(loewner.gpu.classify(body, T, other, None))  # doctest: +SKIP
    tensor([0, 1, 2], device='cuda:0', dtype=torch.int8)
    """

    def __init__(self, memory: Memory, shape: tuple[int, ...], dtype: Any) -> None:
        self._memory, self.shape, self.dtype = memory, shape, np.dtype(dtype)

    def __len__(self) -> int:
        return self.shape[0]

    def __repr__(self) -> str:
        return f"<array of {self.dtype}, shape {self.shape}, on {self._memory.device.name}>"

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self._memory.address, False),
            "strides": None,
            "stream": self._memory.device.stream,
            "version": 3,
        }

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("expected a copy to be allowed: the array is on a GPU")
        host_array = np.empty(self.shape, dtype=self.dtype)
        self._memory.device.download(self._memory.address, host_array)
        return host_array if dtype is None else host_array.astype(dtype)

    def __dlpack_device__(self) -> tuple[int, int]:
        return CUDA, self._memory.device.number

    def __dlpack__(
        self, *, stream: Any = None, max_version: Any = None, dl_device: Any = None, copy: Any = None
    ) -> Any:
        self._memory.device.wait()  # so that every stream can read the array
        return _capsule_of(self)


# Arrays of this library that other libraries have not yet released, keyed by the addresses of their tensors.
_lent: dict[int, tuple[Any, ...]] = {}


@_DELETER
def _give_back(managed: Any) -> None:
    """Drop a tensor that another library has released."""
    _lent.pop(ctypes.addressof(managed.contents), None)


@_DESTRUCTOR
def _unclaimed(capsule: Any) -> None:
    """Drop the tensor of a capsule that was never consumed."""
    if _is_valid(capsule, _CAPSULE):
        _lent.pop(_pointer_of(capsule, _CAPSULE), None)


def _capsule_of(array: DeviceArray) -> Any:
    """Make a DLPack capsule."""
    code = {kind: code for code, kind in KINDS.items()}[array.dtype.kind]
    shape = (ctypes.c_int64 * len(array.shape))(*array.shape)
    where, of_type = _DLDevice(CUDA, array._memory.device.number), _DLType(code, 8 * array.dtype.itemsize, 1)
    lengths = ctypes.cast(shape, ctypes.POINTER(ctypes.c_int64))
    tensor = _DLTensor(array._memory.address, where, len(array.shape), of_type, lengths, None, 0)
    managed = _DLManaged(tensor, None, _give_back)
    _lent[ctypes.addressof(managed)] = managed, shape, array._memory
    return _api.PyCapsule_New(ctypes.addressof(managed), _CAPSULE, _unclaimed)
