"""Compile kernels, and cache the compiled code on disk.

Numba's own cache notices a change only in the file of the function itself, not in functions called from other files,
and it trusts any file. Stale or damaged collision code is dangerous, so this module has its own cache: the folder's
name contains a hash of all source files of this package, so any edit starts from an empty folder, and each entry is a
sealed file (`_sealed`) that is replaced when it is damaged.

The folder is ``$LOEWNER_CACHE_DIR`` if set, otherwise the platform's cache folder of the user.
"""

import hashlib
import os
import pickle
import platform
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import event
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.extending import intrinsic

from loewner._kernels import _parts, _sealed, _sources

_config: Any = numba.config  # its settings are made at run time and have no types

if _config.DISABLE_JIT:
    raise ImportError("NUMBA_DISABLE_JIT: expected Numba to compile, for loewner's kernels are nothing without it")

# The flag by which `_fused` recognises products and sums. Fusing drops a rounding and adds none, so every error bound
# stays valid. Options that reorder operations, or assume that there is no NaN, are not allowed here.
FASTMATH = {"contract"}


def _version() -> str:
    """Hash of the kernel sources and of everything else that determines the compiled code."""
    made_with = numba.__version__, platform.python_version(), platform.machine(), _config.BOUNDSCHECK, _config.OPT
    return hashlib.sha256(repr((made_with, _sources.source_hash())).encode()).hexdigest()[:16]


CACHE_FOLDER = _sources.cache_folder() / f"kernels-{_version()}"

_said: set[str] = set()


def _say(text: str) -> None:
    """Print a message on standard error, once per process."""
    if text not in _said and "LOEWNER_QUIET" not in os.environ:
        print(f"loewner: {text}", file=sys.stderr, flush=True)
    _said.add(text)


class _Announcer(event.Listener):
    """Announces once per process that kernels are being compiled."""

    def on_start(self, event: Any) -> None:
        dispatcher = event.data.get("dispatcher")
        if getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("loewner._kernels"):
            _say("compiling kernels for this machine (first use only) ...")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcer())


def _identity(value: Any) -> Any:
    """Identity of a function among those made by the same factory: its code and its closure.

    All its other dependencies are in the sources, whose hash names the folder. Neither contains paths, so a copy of the
    package elsewhere finds the same entries.
    """
    function = getattr(value, "py_func", value)
    if not callable(function) or isinstance(function, type) or not hasattr(function, "__code__"):
        return repr(value)
    cells = tuple(_identity(cell.cell_contents) for cell in function.__closure__ or ())
    return function.__module__, function.__qualname__, function.__code__.co_code.hex(), cells


class _KernelCache(NullCache):
    """Compiled code of one kernel on disk: one sealed file for each signature and processor.

    Faults of the disk are not errors here: code that cannot be read is compiled, and code that cannot be written stays
    in memory.
    """

    failure: OSError | None = None  # reason of the last failure to write

    def __init__(self, kernel: Callable[..., Any], form: str) -> None:
        self._kernel, self._form = kernel, form

    @property
    def cache_path(self) -> str:
        return str(CACHE_FOLDER)

    def _path(self, signature: Any, codegen: Any) -> Path:
        """Name of an entry: the kernel, and a hash of the other dependencies of its code."""
        key = hashlib.sha256(repr((self._form, signature, codegen.magic_tuple(), _identity(self._kernel))).encode())
        module = self._kernel.__module__.removeprefix("loewner._kernels.")
        name = re.sub(r"[^A-Za-z0-9_.]", "", f"{module}.{self._kernel.__qualname__}")
        return CACHE_FOLDER / f"{name}-{key.hexdigest()[:24]}.kernel"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        if not _sources.source_hash():
            return None
        path = self._path(sig, target_context.codegen())
        try:
            name, *parts = pickle.loads(_sealed.read(path))
            if name != path.name:
                raise _sealed.DamagedFileError(path)
            return _parts.restored(target_context, *parts)
        except FileNotFoundError:
            return None
        except OSError as error:
            why = f"cannot be read ({error.strerror or error})"
        except _sealed.DamagedFileError:
            why = "is damaged"
        except Exception as error:  # sealed, but unusable
            why = f"is not understood ({type(error).__name__})"
        _say(f"{path} {why}; compiling it anew")
        with suppress(OSError):
            path.unlink()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if data.lifted or data.library.has_dynamic_globals or not _sources.source_hash():
            return  # it contains addresses of this process, or its origin is unknown
        try:
            CACHE_FOLDER.mkdir(parents=True, exist_ok=True)
            path = self._path(sig, data.codegen)
            _sealed.write(path, dumps((path.name, *data._reduce())))
        except OSError as error:
            _KernelCache.failure = error
            _say(f"{CACHE_FOLDER} cannot be written ({error.strerror or error}); compiled kernels stay in memory")


def unwritten() -> str | None:
    """The reason why compiled code could not be written to disk, if that happened in this process."""
    error = _KernelCache.failure
    return None if error is None else f"{CACHE_FOLDER} cannot be written ({error.strerror or error})"


def _any_integer(kind: Any) -> Any:
    """Type of an argument, without the value of an integer literal."""
    return types.unliteral(kind) if isinstance(kind, types.IntegerLiteral) else kind


class _Kernel(CPUDispatcher):
    """A compiled function in up to two forms: a part of the kernels that call it, and a function that Python calls.

    Numba compiles every function in both forms, although most are only called by other kernels: their wrappers, full
    optimisation and machine code took two fifths of the time.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], apart: bool) -> None:
        quiet = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        compiler = _parts.ApartCompiler if apart else _parts.PartCompiler
        super().__init__(function, targetoptions=options | quiet, pipeline_class=compiler)
        self._cache = _KernelCache(function, "part")
        self._for_python: Any = _Callable(self, function, options | {"no_cfunc_wrapper": True})

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type a call from another kernel.

        Numba would otherwise compile the function once for each integer literal of a caller.
        """
        return super().get_call_template([_any_integer(kind) for kind in args], kws)

    def add_overload(self, cres: Any) -> None:
        """Keep a part where kernels look it up; Python could not call it."""
        self.overloads[tuple(cres.signature.args)] = cres

    def compile_ahead(self, signature: tuple[Any, ...]) -> None:
        """Compile the form that Python calls, for these types."""
        self._for_python.compile(signature)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """Compile the form that Python calls, for new types."""
        return self._for_python._compile_for_args(*args, **kws)


class _Callable(CPUDispatcher):
    """The form of a kernel that Python calls, by way of the kernel."""

    def __init__(self, kernel: _Kernel, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options, pipeline_class=_parts.CallableCompiler)
        self._kernel = kernel
        self._cache = _KernelCache(function, "entry")

    def add_overload(self, cres: Any) -> None:
        """Register the code with the kernel; Numba calls this under a lock, once for each signature.

        The kernel could not choose between two equal signatures, and would request compilation at every call.
        """
        kernel: Any = self._kernel
        kernel._insert([kind._code for kind in cres.signature.args], cres.entry_point, False)
        super().add_overload(cres)


def _compiled(function: Callable[..., Any], apart: bool = False, **options: Any) -> Any:
    if function.__closure__:
        # Functions of one factory share their name. Numba distinguishes them by numbers that start anew in each
        # process, but parts made by two processes must not be confused.
        identity = hashlib.sha256(repr(_identity(function)).encode()).hexdigest()
        function.__qualname__ = f"{function.__qualname__}.{identity[:12]}"
    options |= {"nopython": True, "error_model": "numpy", "fastmath": FASTMATH, "nogil": True}
    return _Kernel(function, options, apart)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel: NumPy's error model, products fused, cached under `CACHE_FOLDER`."""
    return lambda function: _compiled(function, **options)


def apart(function: Callable[..., Any]) -> Any:
    """Compile a large kernel that has several callers and should not be copied into them.

    LLVM inlines at its own discretion, and Numba requests it for all functions that are first compiled for an `inline`
    caller.
    """
    return _compiled(function, apart=True, forceinline=False)


def inline(function: Callable[..., Any]) -> Any:
    """Compile a small pure function that LLVM should inline into its callers."""
    return _compiled(function, forceinline=True)


@intrinsic
def borrowed(typingctx: Any, array: Any) -> Any:
    """borrowed(array): the array without its reference count.

    Numba counts references atomically wherever an array passes through a function, inlined or not; in the kernels this
    takes most of the time of a short search. A borrowed array costs nothing to pass on. Borrow only arrays that the
    caller keeps alive: arguments, and entries of argument tuples, never arrays that the function makes itself.
    """
    if not isinstance(array, types.Array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()

    return array(array), codegen
