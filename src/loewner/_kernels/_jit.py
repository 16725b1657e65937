"""How kernels are compiled, and where the compiled code is kept.

Numba's own on-disk cache notices a change only in the file of the function itself, not in a
function it calls from another file. Stale collision code is dangerous, so the cache folder's
name carries a hash of every source file of this package: any edit starts from an empty folder.

The folder is ``$LOEWNER_CACHE_DIR`` if set, else the user's cache folder of the platform.
"""

import hashlib
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import event
from numba.extending import intrinsic

_config: Any = numba.config  # its settings are made at run time; no type knows them

# Contraction (fused multiply-add) drops roundings and adds none, so every error bound stays
# valid. Nothing that reorders or assumes away NaN is allowed here.
FASTMATH = {"contract"}


def _source_hash() -> str:
    """Hash of all kernel sources and of what else decides the compiled code."""
    digest = hashlib.sha256(f"{numba.__version__} {platform.python_version()} {platform.machine()}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _user_cache_folder() -> Path:
    if "LOEWNER_CACHE_DIR" in os.environ:
        return Path(os.environ["LOEWNER_CACHE_DIR"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "loewner"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "loewner"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "loewner"


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


CACHE_FOLDER = _user_cache_folder() / f"kernels-{_source_hash()}"
_CACHING = _writable(CACHE_FOLDER)  # without a place to write, compile in memory every time


class _Announcer(event.Listener):
    """Say once per process that kernels are being compiled, on standard error."""

    announced = False

    def on_start(self, event: Any) -> None:
        dispatcher = event.data.get("dispatcher")
        ours = getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("loewner._kernels")
        if ours and not self.announced and "LOEWNER_QUIET" not in os.environ:
            self.announced = True
            print("loewner: compiling kernels for this machine (first use only) ...", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcer())


def _name_by_process(dispatcher: Any) -> None:
    """Let no two processes write compiled code under one name.

    Numba numbers the data files of a function. Two processes that compile it for different argument types at
    the same time would take the same number, and one type could then load the code of the other.
    """
    files = dispatcher._cache._cache_file
    plain = files._data_name
    files._data_name = lambda number: f"{os.getpid()}-{plain(number)}"


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel: NumPy's error model, contraction only, cached under `CACHE_FOLDER`."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(error_model="numpy", fastmath=FASTMATH, nogil=True, **options)(function)
        if _CACHING and not _config.DISABLE_JIT:
            before = _config.CACHE_DIR
            _config.CACHE_DIR = str(CACHE_FOLDER)
            try:
                dispatcher.enable_caching()
                _name_by_process(dispatcher)
            finally:
                _config.CACHE_DIR = before
        return dispatcher

    return decorate


def inline(function: Callable[..., Any]) -> Any:
    """Compile a small pure function that LLVM is to inline into its callers; it is not cached by itself."""
    return numba.njit(error_model="numpy", fastmath=FASTMATH, forceinline=True)(function)


@intrinsic
def borrowed(typingctx: Any, array: Any) -> Any:
    """borrowed(array): the same array without its reference count.

    Numba counts references atomically wherever an array passes through a function, inlined or not; in the kernels
    that is most of the time of a short search. A borrowed array costs nothing to hand on. Borrow only what the caller
    keeps alive: arguments, and entries of argument tuples, never what the function makes itself.
    """
    if not isinstance(array, types.Array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()

    return array(array), codegen
