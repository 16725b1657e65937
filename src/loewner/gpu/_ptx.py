"""Compile the functions of `_kernels.threads` to PTX, which NVIDIA's driver compiles for its GPU.

llvmlite's wheels include LLVM's back end for PTX. The back end takes the intermediate code that Numba makes from the
library's own formulas. The formulas therefore exist in one source only, and no further compiler is needed. If PTX was
built with the native library, this PTX is used. Otherwise, PTX is made when it is first requested, and is kept in the
store of compiled kernels.
"""

from __future__ import annotations

import sys
import zlib
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from loewner._kernels import _sealed
from loewner._kernels._sources import source_hash
from loewner._native import library
from loewner._native.entries import expect_numba

NAME = "threads.ptx.z"  # zlib reduces the size to a sixth

# OLDEST is the architecture of the oldest supported GPUs (Turing, 2018). All drivers since 2020 support VERSION of PTX.
OLDEST, VERSION = "sm_75", "ptx70"
TRIPLE = "nvptx64-nvidia-cuda"

# Kernels, keyed by the modules of `loewner._kernels.threads` that define their functions.
KERNELS = {
    "pairs": ("classify_pieces", "classify_bodies", "gather_rows", "scatter_bytes"),
    "configurations": ("place_links", "place_body", "cull_pair", "certify_survivor", "search_survivor", "conclude"),
    "motions": (
        "bound_motion", "list_probe", "strike_motion", "begin_motion", "place_end", "cull_interval",
        "certify_interval", "search_interval", "halve_interval",
    ),
}  # fmt: skip


@cache
def text() -> bytes:
    """Return the PTX of all functions of `_kernels.threads`: from the build, from the store, or newly compiled.

    Raises
    ------
    MissingExtraError
        If the PTX has to be compiled, and Numba is not installed.
    """
    shipped = library.shipped(NAME)
    if shipped is not None:
        return zlib.decompress(shipped)
    expect_numba()
    from loewner._kernels import _jit, _store

    key = ""
    with suppress(OSError):  # PTX from sources that cannot be read is not kept, since its origin is unknown
        if _store.is_usable():
            made_of = Path(__file__).read_bytes(), _jit.MADE_WITH, source_hash()
            key = _store.key_of("threads.ptx", made_of, frozenset())
    with suppress(OSError, _sealed.DamagedFileError):  # after an error, the PTX is made again
        if key:
            return _store.read(key)
    ptx = compiled()
    with suppress(OSError):  # after an error, the next process makes the PTX again
        if key:
            _store.write(key, ptx)
    return ptx


def compiled() -> bytes:
    """Compile the functions of `_kernels.threads` to PTX."""
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(TRIPLE).create_target_machine(
        cpu=OLDEST, features=f"+{VERSION}", opt=3, reloc="static", codemodel="small"
    )
    whole = llvm.parse_assembly("")
    _target(whole, machine)
    for module, names in KERNELS.items():
        functions = import_module(f"loewner._kernels.threads.{module}")
        for name in names:
            whole.link_in(_kernel(getattr(functions, name), machine))
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    passes.getModulePassManager().run(whole, passes)
    return str(machine.emit_assembly(whole)).encode("ascii")


def _target(module: Any, machine: Any) -> None:
    """Set the GPU as the target of a module."""
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)


def _kernel(function: Any, machine: Any) -> Any:
    """Make a kernel's module: Numba's intermediate code of a function, and a caller that passes the thread's number."""
    import llvmlite.binding as llvm
    from numba import types

    from loewner._kernels import _parts

    # The first argument is the thread's number.
    count = function.py_func.__code__.co_argcount
    kinds = (types.int64,) * count
    function.compile(kinds)
    overload = function.overloads[kinds]
    inner = overload.fndesc.llvm_func_name
    module = _parts.linked([overload.library])
    _target(module, machine)
    module.link_in(llvm.parse_assembly(_caller(function.py_func.__name__, inner, count, machine)))
    # Only the kernel is visible outside the module, because the names of other functions may occur in several modules.
    for symbol in (*module.functions, *module.global_variables):
        if not symbol.is_declaration and symbol.name != function.py_func.__name__:
            symbol.linkage = llvm.Linkage.internal
    return module


def _caller(name: str, inner: str, count: int, machine: Any) -> str:
    """Write the intermediate code of the kernel ``name(total, arguments)``, in which the first `total` threads work."""
    from llvmlite import ir

    word, half = ir.IntType(64), ir.IntType(32)
    pointer = ir.IntType(8).as_pointer()
    module = ir.Module(name)
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    # Numba's calling convention has pointers to a result and to an exception. These functions have neither.
    body = ir.Function(module, ir.FunctionType(half, [pointer, pointer] + [word] * count), inner)
    kernel = ir.Function(module, ir.FunctionType(ir.VoidType(), [word] * count), name)
    kernel.calling_convention = "ptx_kernel"
    builder = ir.IRBuilder(kernel.append_basic_block())

    def register(which: str) -> Any:
        read = ir.Function(module, ir.FunctionType(half, []), f"llvm.nvvm.read.ptx.sreg.{which}.x")
        return builder.zext(builder.call(read, []), word)

    thread = builder.add(builder.mul(register("ctaid"), register("ntid")), register("tid"))
    with builder.if_then(builder.icmp_unsigned("<", thread, kernel.args[0])):
        nothing = ir.Constant(pointer, None)
        result = builder.bitcast(builder.alloca(word), pointer)
        builder.call(body, [result, nothing, thread, *kernel.args[1:]])
    builder.ret_void()
    return str(module)


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(zlib.compress(compiled(), 9))
