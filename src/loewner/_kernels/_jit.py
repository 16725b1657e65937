"""Compile kernels, and keep the compiled code in the store."""

import hashlib
import os
import pickle
import platform
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from types import CodeType
from typing import Any, ClassVar

import llvmlite
import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from loewner._kernels import _fused, _parts, _sealed, _store
from loewner._kernels._numba import (
    CompileResult,
    CPUDispatcher,
    NullCache,
    dumps,
    event,
    global_compiler_lock,
    normalize_signature,
)

_config: Any = numba.config  # Numba's settings are created at run time and have no type annotations.

if _config.DISABLE_JIT:
    raise ImportError("NUMBA_DISABLE_JIT: expected Numba to compile, for loewner's kernels are nothing without it")

# By this flag, `_fused` recognises the products and sums that may be fused. A fused product has one rounding fewer, so
# every error bound stays valid. Options that reorder operations, or assume that no number is NaN, are not allowed here.
FASTMATH = {"contract"}


# Everything that determines the compiled code, except the sources, the types of the arguments and the processor.
MADE_WITH = (
    numba.__version__, llvmlite.__version__, np.__version__, platform.python_version(), platform.machine(),
    _config.BOUNDSCHECK, str(_config.OPT), _config.LOOP_VECTORIZE, _config.SLP_VECTORIZE,
)  # fmt: skip

_said: set[str] = set()


def _say(text: str) -> None:
    """Print a message on standard error, once per process."""
    if text not in _said and "LOEWNER_QUIET" not in os.environ:
        print(f"loewner: {text}", file=sys.stderr, flush=True)
    _said.add(text)


class _Announcer(event.Listener):
    """Announces, once per process, that kernels are being compiled."""

    def on_start(self, event: Any) -> None:
        dispatcher = event.data.get("dispatcher")
        if getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("loewner._kernels"):
            _say("compiling kernels for this machine (first use only) ...")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcer())


def _identity(value: Any) -> Any:
    """Identity of a function among the functions made by the same factory: its code and its closure.

    All other dependencies of the function are in the sources. Neither the code nor the closure contains paths, so that
    a copy of the package elsewhere finds the same files.
    """
    function = getattr(value, "py_func", value)
    if not callable(function) or isinstance(function, type) or not hasattr(function, "__code__"):
        return repr(value)
    cells = tuple(_identity(cell.cell_contents) for cell in function.__closure__ or ())
    return function.__module__, function.__qualname__, _code(function.__code__), cells


def _code(code: CodeType) -> tuple[Any, ...]:
    """Instructions and constants of a function, and of the functions defined in it."""
    inner = tuple(_code(one) if isinstance(one, CodeType) else repr(one) for one in code.co_consts)
    return code.co_code.hex(), inner


def _modules(value: Any) -> set[str]:
    """Modules of a function, and of the functions in its closure."""
    function = getattr(value, "py_func", value)
    if not hasattr(function, "__code__"):
        return set()
    return {function.__module__}.union(*(_modules(cell.cell_contents) for cell in function.__closure__ or ()))


def _modules_of_type(kind: Any) -> set[str]:
    """Modules that define a type, except Numba's modules."""
    if isinstance(kind, types.NamedTuple | types.NamedUniTuple):
        named = {kind.instance_class.__module__}
    else:
        named = {type(kind).__module__}
    inner: Any = getattr(kind, "types", ()) if isinstance(kind, types.BaseTuple) else ()
    return {name for name in named.union(*map(_modules_of_type, inner)) if not name.startswith("numba.")}


class _Cache(NullCache):
    """The compiled code of one kernel in the store: one file per signature, as a part or as an entry for Python.

    Disk faults raise no errors here: code that cannot be read is compiled again, and code that cannot be written stays
    in memory.
    """

    failure: OSError | None = None  # The error of the last failed attempt to write a file.

    # The parts that were compiled in this process, by their keys. Equal functions share one part; otherwise, its name
    # would be defined twice.
    _made: ClassVar[dict[str, tuple[Any, ...]]] = {}

    def __init__(self, kernel: Callable[..., Any], form: str) -> None:
        self._kernel, self._form = kernel, form

    @property
    def cache_path(self) -> str:
        return str(_store.FOLDER)

    def _behind(self, signature: Any) -> frozenset[str]:
        """Kernel modules on whose sources the code may depend."""
        modules = _modules(self._kernel).union(*map(_modules_of_type, signature))
        return frozenset().union(*map(_store.modules_behind, modules))

    def _key(self, signature: Any, codegen: Any) -> str:
        """Name of a file: the kernel, and a hash of everything that determines its code."""
        triple, cpu, features = codegen.magic_tuple()
        # A part has one code for all processors that can fuse products, and another code for all that cannot.
        target = (triple, _fused.can_fuse(cpu, features)) if self._form == "part" else (triple, cpu, features)
        made_of = MADE_WITH, self._form, repr(signature), target, _identity(self._kernel)
        module = self._kernel.__module__.removeprefix("loewner._kernels.")
        return _store.key_of(f"{module}.{self._kernel.__qualname__}", made_of, self._behind(signature))

    def claimed(self, signature: Any, codegen: Any) -> AbstractContextManager[None]:
        """Compile code for a signature in one process at a time."""
        return _store.claimed(self._key(signature, codegen)) if _store.is_usable() else nullcontext()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        key = self._key(sig, target_context.codegen())
        if key in _Cache._made:
            return _parts.result_of(target_context, *_Cache._made[key])
        if not _store.is_usable():
            return None
        try:
            name, *content = pickle.loads(_store.read(key))
            if name != key:
                raise _sealed.DamagedFileError(_store.path_of(key))
            target_context.refresh()
            restored = CompileResult._rebuild if self._form == "entry" else _parts.restored
            return restored(target_context, *([key] if self._form == "part" else []), *content)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            why = f"cannot be read ({error.strerror or error})"
        except _sealed.DamagedFileError as error:
            key, why = error.args[0].stem, "is damaged"
        except Exception as error:  # The file is intact, but its content cannot be used.
            why = f"is not understood ({type(error).__name__})"
        _say(f"{_store.path_of(key)} {why}; compiling it anew")
        with suppress(OSError):
            _store.path_of(key).unlink()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        key = self._key(sig, data.codegen)
        if self._form == "part":
            _Cache._made[key] = data.library, data.fndesc, data.environment, data.signature
        if data.lifted or data.library.has_dynamic_globals or not _store.is_usable():
            return  # The code contains addresses that are valid only in this process, or its sources are unknown.
        if self._form == "part":
            self._expect_imported(data.library, self._behind(sig))
            if any(part.key == "" for part in data.library.called if isinstance(part, _parts.PartLibrary)):
                return  # The code calls parts that could not be written to the store.
        try:
            _store.write(key, dumps((key, *data._reduce())))
        except OSError as error:
            _Cache.failure = error
            _say(f"{_store.FOLDER} cannot be written ({error.strerror or error}); compiled kernels stay in memory")
        else:
            if self._form == "part":
                _parts.keep(key, data.library)

    def _expect_imported(self, library: Any, behind: frozenset[str]) -> None:
        """Refuse a call to a kernel whose sources are not in the key: edits to these sources would go unnoticed."""
        for part in library.called:
            home = getattr(part, "home", "").removeprefix("loewner._kernels.").replace(".", "/")
            if home in _store.modules_behind("") and home not in behind:
                raise ImportError(f"{self._kernel.__module__} calls a kernel of {home}, which it does not import")


def unwritten() -> str | None:
    """The reason why compiled code could not be written to disk in this process; None if none is known."""
    error = _Cache.failure
    return None if error is None else f"{_store.FOLDER} cannot be written ({error.strerror or error})"


def _any_integer(kind: Any) -> Any:
    """Type of an argument, without the value of an integer literal."""
    return types.unliteral(kind) if isinstance(kind, types.IntegerLiteral) else kind


class _Stored(CPUDispatcher):
    """A function whose code is in the store; two processes never compile it at the same time."""

    _cache: _Cache
    targetctx: Any
    overloads: Any

    def compile(self, sig: Any) -> Any:
        """Compile the function for a signature, or find its code in the store."""
        arguments, _ = normalize_signature(sig)
        if tuple(arguments) in self.overloads:
            return self.overloads[tuple(arguments)].entry_point
        # Take Numba's compiler lock before the claim. Otherwise, a thread that holds the claim could wait for the lock
        # while the thread that holds the lock waits for the claim.
        with global_compiler_lock, self._cache.claimed(arguments, self.targetctx.codegen()):
            return super().compile(sig)


class _Kernel(_Stored):
    """A compiled function in up to two forms: a part of the kernels that call it, and a function that Python calls.

    Numba compiles every function in both forms, although most functions are called only by other kernels. The unused
    wrappers, their full optimisation and their machine code took two fifths of the compile time.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], apart: bool) -> None:
        quiet = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        compiler = _parts.ApartCompiler if apart else _parts.PartCompiler
        super().__init__(function, targetoptions=options | quiet, pipeline_class=compiler)
        self._cache = _Cache(function, "part")
        self._for_python: Any = _Callable(self, function, options | {"no_cfunc_wrapper": True})

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type a call from another kernel.

        Otherwise, Numba would compile the function once for each integer literal of a caller.
        """
        return super().get_call_template([_any_integer(kind) for kind in args], kws)

    def add_overload(self, cres: Any) -> None:
        """Keep a part where kernels look it up; Python cannot call a part."""
        self.overloads[tuple(cres.signature.args)] = cres

    def compile_ahead(self, signature: tuple[Any, ...]) -> None:
        """Compile the form that Python calls, for given types."""
        self._for_python.compile(signature)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """Compile the form that Python calls, for new types."""
        return self._for_python._compile_for_args(*args, **kws)


class _Callable(_Stored):
    """The form of a kernel that Python calls; the calls go through the kernel."""

    def __init__(self, kernel: _Kernel, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options, pipeline_class=_parts.CallableCompiler)
        self._kernel = kernel
        self._cache = _Cache(function, "entry")

    def add_overload(self, cres: Any) -> None:
        """Register the code with the kernel; Numba calls this under a lock, once for each signature.

        Given two equal signatures, the kernel could not choose, and would compile at every call.
        """
        kernel: Any = self._kernel
        kernel._insert([kind._code for kind in cres.signature.args], cres.entry_point, False)
        super().add_overload(cres)


def _compiled(function: Callable[..., Any], apart: bool = False, **options: Any) -> Any:
    if function.__closure__:
        # Functions made by the same factory share a name, and Numba distinguishes them by numbers. These numbers start
        # again in each process, so parts from different processes could be confused.
        identity = hashlib.sha256(repr(_identity(function)).encode()).hexdigest()
        function.__qualname__ = f"{function.__qualname__}.{identity[:12]}"
    _store.expect_as_read(function.__module__)
    options |= {"nopython": True, "error_model": "numpy", "fastmath": FASTMATH, "nogil": True}
    return _Kernel(function, options, apart)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel with NumPy's error model and fused products, and keep it in the store.

    LLVM inlines the kernel at its own discretion. Numba would request inlining if the first caller happened to be an
    `inline` function.
    """
    return lambda function: _compiled(function, **{"forceinline": False, **options})


def apart(function: Callable[..., Any]) -> Any:
    """Compile a large kernel that has several callers and should not be copied into them."""
    return _compiled(function, apart=True, forceinline=False)


def inline(function: Callable[..., Any]) -> Any:
    """Compile a small pure function that LLVM should inline into its callers."""
    return _compiled(function, forceinline=True)


@intrinsic
def borrowed(typingctx: Any, array: Any) -> Any:
    """borrowed(array): the array without its reference count.

    Numba counts references atomically wherever an array passes through a function, inlined or not. In a short search,
    this counting takes most of the time. Passing on a borrowed array costs nothing. Borrow only arrays that the caller
    keeps alive: arguments, and entries of argument tuples, never arrays that the function makes itself.
    """
    if not isinstance(array, types.Array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()

    return array(array), codegen
