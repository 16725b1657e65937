"""Parts: functions that only kernels call, compiled only as far as their callers need.

Numba compiles every function to independent machine code, and also copies its intermediate code into each caller, where
it is optimised again. A part has only the intermediate code. The classes here are subclasses of Numba's own classes,
which have no public interface (`_numba`); `tests/test_kernel_cache.py` tests the behaviour on which they rely.
"""

import pickle
from collections.abc import Callable, Collection, Iterable
from functools import cache, partial
from typing import Any

import numba
from llvmlite.binding import Target, create_new_module_pass_manager, parse_bitcode
from numba import types

from loewner._kernels import _fused, _sealed, _store
from loewner._kernels._numba import (
    Compiler,
    FunctionIdentity,
    JITCodeLibrary,
    PassManager,
    compile_result,
    rtsys,
    typed_passes,
    untyped_passes,
)

_config: Any = numba.config  # Numba's settings are created at run time and have no type annotations.

# Numba's passes for features that kernels do not use: `with` blocks, closures, functions that are inlined before types
# are inferred, literals as types, and single loops for several operations on whole arrays. These passes are left out,
# so a kernel that used such a feature would not compile, or would be slower.
NOT_NEEDED = {
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.InlineOverloads,
    typed_passes.NopythonRewrites,
    typed_passes.AnnotateTypes,
    typed_passes.NoPythonSupportedFeatureValidation,
}


class _FusedLibrary(JITCodeLibrary):
    """Code in which products are fused with sums before anything is linked with it."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Run the passes over each function, fuse its products, and add the module."""
        codegen = self._codegen
        triple, cpu, features = codegen.magic_tuple()
        can_fuse = _fused.can_fuse(cpu, features)
        own, codegen._tm = codegen._tm, _usual_machine(triple) if can_fuse else codegen._tm
        try:
            self._optimize_functions(ll_module)
        finally:
            codegen._tm = own
        self._final_module.link_in(_fused.fused(ll_module, can_fuse))


@cache
def _usual_machine(triple: str) -> Any:
    """Return the processor whose costs simplify functions before their products are fused.

    Costs decide which branches become selections, and therefore which products and sums share a block. The costs must
    not depend on the actual processor, because parts are the same for all processors.
    """
    name = "x86-64-v3" if triple.startswith("x86_64") else ""
    return Target.from_triple(triple).create_target_machine(cpu=name, opt=int(_config.OPT))


class PartLibrary(_FusedLibrary):
    """Intermediate code of one part alone; each part that it calls is linked only once, together with all callers.

    Numba links a copy of every function into each of its direct and indirect callers. Here, only Numba's own functions
    are copied, and hidden, because their names differ between processes.
    """

    # Function that is called with the key of each part that is read from the store or written to it.
    listener: Callable[[str], None] | None = None

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.called: list[JITCodeLibrary] = []
        self.key = ""  # Key of the part in the store; empty for a part that is only in memory.
        self.home = ""  # Name of the kernel module that defines the part.

    def _optimize_functions(self, ll_module: Any) -> None:
        """Run Numba's passes over the functions of a module; Numba itself also prepares passes for each declaration."""
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager()
                passes.run(function, builder)

    def finalize(self) -> None:
        """Finish the part: link Numba's own functions into it, and list the parts that it calls."""
        self._raise_if_finalized()
        own = {function.name for function in self._final_module.functions if not function.is_declaration}
        for library in dict.fromkeys(self._linking_libraries):
            if isinstance(library, PartLibrary) or library is rtsys.library:
                self.called.append(library)
            else:
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        for function in self._final_module.functions:
            if not function.is_declaration and function.name not in own:
                function.linkage = "internal"
        passes = create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(self._final_module, self._codegen._pass_builder())
        self._final_module.verify()
        self._end()

    def _end(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return the part with everything that it calls, for a caller that Numba compiles in the usual way."""
        module = linked([self])
        for function in module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        return module

    def serialize_using_object_code(self) -> Any:
        """Return the content for the store: intermediate code, the keys of the parts that it calls, and its module."""
        self._ensure_finalized()
        keys = [library.key if isinstance(library, PartLibrary) else RUNTIME for library in self.called]
        return self.name, "part", (self._final_module.as_bitcode(), keys, self.home)

    @classmethod
    def restored(cls, codegen: Any, name: str, kept: tuple[bytes, list[str], str], key: str) -> "PartLibrary":
        """Return the part that was kept under a key, and read the parts that it calls."""
        part = cls(codegen, name)
        bitcode, keys, part.home = kept
        part._final_module = parse_bitcode(bitcode)
        part.called = [rtsys.library if one == RUNTIME else library_of(codegen, one) for one in keys]
        part.key = key
        part._end()
        return part


RUNTIME = "Numba's run time"

# Parts by key. There is only one object for each key, because two libraries that define the same functions cannot be
# linked together.
_read: dict[str, PartLibrary] = {}


def library_of(codegen: Any, key: str) -> PartLibrary:
    """Return the part with a key; the same key always gives the same object.

    Raises
    ------
    OSError, DamagedFileError
        If the part, or a part that it calls, is not in the store, or is damaged.
    """
    if key not in _read:
        stored_key, (name, _, kept), *_ = pickle.loads(_store.read(key))
        if stored_key != key:
            raise _sealed.DamagedFileError(_store.path_of(key))
        keep(key, PartLibrary.restored(codegen, name, kept, key))
    return _read[key]


def keep(key: str, part: PartLibrary) -> None:
    """Remember a part under its key."""
    part.key, _read[key] = key, part
    if PartLibrary.listener is not None:
        PartLibrary.listener(key)


def everything_called(
    libraries: Iterable[JITCodeLibrary], without: Collection[JITCodeLibrary] = ()
) -> list[JITCodeLibrary]:
    """Return libraries and all that they call, each once, except `without` and the parts that only `without` calls."""
    reached = dict.fromkeys(library for library in libraries if library not in without)
    waiting = list(reached)
    while waiting:
        for library in getattr(waiting.pop(), "called", ()):
            if library not in reached and library not in without:
                reached[library] = None
                waiting.append(library)
    return list(reached)


CHUNK = 32  # Number of modules that are linked at a time; linking to a larger module takes longer.


def in_one(modules: list[Any]) -> Any:
    """Link modules in chunks."""
    while len(modules) > 1:
        chunks = [modules[at : at + CHUNK] for at in range(0, len(modules), CHUNK)]
        for first, *others in chunks:
            for other in others:
                first.link_in(other)
        modules = [chunk[0] for chunk in chunks]
    return modules[0]


def linked(libraries: Iterable[JITCodeLibrary]) -> Any:
    """Return a module that contains libraries and everything that they call, each once."""
    return in_one([library._final_module.clone() for library in everything_called(libraries)])


class _CallableLibrary(_FusedLibrary):
    """Code that Python calls, with all parts that it needs."""

    def finalize(self) -> None:
        """Link all parts, then optimise and compile everything as Numba does."""
        own = {function.name for function in self._final_module.functions if not function.is_declaration}
        self._final_module.link_in(linked(self._linking_libraries))
        self._linking_libraries = []
        for function in self._final_module.functions:
            if not function.is_declaration and function.name not in own:
                function.linkage = "linkonce_odr"
        super().finalize()


def _key(library: Any, fndesc: Any, environment: Any) -> object:
    """A unique replacement for the function that Python would call; callers are compiled against it."""
    library._ensure_finalized()
    return object()


def _address(context: Any, builder: Any, address: int, info: str) -> Any:
    """Address of an object of this process; code that contains such an address cannot be kept on disk.

    If a kernel is passed to another kernel, its type identifies it, and no code reads its address.
    """
    if info == "_Kernel":
        return context.get_constant_null(types.voidptr)
    return type(context).add_dynamic_addr(context, builder, address, info)


class PartCompiler(Compiler):
    """Numba's compiler, for parts."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's pipeline without the passes that kernels do not need."""
        (pipeline,) = super().define_pipelines()
        needed = PassManager(pipeline.pipeline_name)
        for compiler_pass, description in pipeline.passes:
            if compiler_pass not in NOT_NEEDED:
                needed.add_pass(compiler_pass, description)
        needed.finalize()
        return [needed]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function with the library and key of a part."""
        context = self.state.targetctx  # The context is a copy made for this function.
        context.get_executable, context.add_dynamic_addr = _key, partial(_address, context)
        self.state.library = PartLibrary(context.codegen(), func.__qualname__)
        self.state.library.home = func.__module__
        # Proceed like Numba, but choose the function's name here: Numba's names contain numbers that may differ in each
        # process.
        identity = FunctionIdentity.from_function(func)
        identity.unique_id, identity.unique_name = 0, f"{func.__module__}.{func.__qualname__}"
        self.state.func_id = identity
        untyped_passes.ExtractByteCode().run_pass(self.state)
        self.state.lifted, self.state.lifted_from = (), None
        return self._compile_bytecode()


class CallableCompiler(Compiler):
    """Numba's compiler, for functions that Python calls."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function whose products are fused in the same way as in parts."""
        self.state.library = _CallableLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class ApartCompiler(PartCompiler):
    """Numba's compiler, for large parts that should not be copied into each of their callers."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function that LLVM may not inline."""
        result = super().compile_extra(func)
        module = result.library._final_module
        module.get_function(result.fndesc.mangled_name).add_function_attribute("noinline")
        return result


def restored(target_context: Any, key: str, *reduced: Any) -> Any:
    """Restore a part from the result of `CompileResult._reduce`."""
    (name, _, kept), fndesc, environment, signature, *_ = reduced
    codegen = target_context.codegen()
    if key not in _read:
        keep(key, PartLibrary.restored(codegen, name, kept, key))
    return result_of(target_context, _read[key], fndesc, environment, signature)


def result_of(target_context: Any, part: PartLibrary, fndesc: Any, environment: Any, signature: Any) -> Any:
    """Wrap a part as the result of compiling it."""
    return compile_result(
        target_context=target_context,
        typing_context=target_context.typing_context,
        library=part,
        fndesc=fndesc,
        environment=environment,
        entry_point=object(),
        signature=signature,
        objectmode=False,
    )
