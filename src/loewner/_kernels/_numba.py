"""The undocumented names of Numba that the kernels and their build use; no other module imports them.

A new Numba may rename the objects imported here, or change their parameters. `tests/test_numba.py` lists each object
with its purpose, and fails with the name that has changed.
"""

from numba.core import base, cgutils, errors, event, postproc, typed_passes, untyped_passes
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import NullCache
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.datamodel.registry import default_manager
from numba.core.ir import Inst, Var
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime._nrt_python import _MemInfo as MemInfo
from numba.core.runtime._nrt_python import meminfo_alloc
from numba.core.runtime.context import NRTContext
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.np.arrayobj import populate_array

__all__ = [
    "AbstractTemplate", "BaseFunction", "CPUCodeLibrary", "CPUDispatcher", "CompileResult", "Compiler",
    "FunctionIdentity", "Inst", "JITCodeLibrary", "MemInfo", "NRTContext", "NullCache", "PassManager", "Var", "base",
    "cgutils", "compile_result", "cpu_target", "default_manager", "dumps", "errors", "event", "global_compiler_lock",
    "infer_global", "meminfo_alloc", "normalize_signature", "populate_array", "postproc", "rtsys", "signature",
    "typed_passes", "untyped_passes",
]  # fmt: skip
