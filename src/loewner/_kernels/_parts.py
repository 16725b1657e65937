"""Parts: functions that only kernels call, compiled only as far as their callers need.

Numba compiles every function to independent machine code, and also copies its intermediate code into each caller, where
it is optimised again. A part only has the intermediate code. The classes here are subclasses of Numba's own classes,
which have no public interface; `tests/test_kernel_cache.py` tests the behaviour on which they rely.
"""

from typing import Any

from llvmlite.binding import parse_bitcode
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.compiler_machinery import PassManager

from loewner._kernels import _fused

# Numba's passes for features that kernels do not use: `with` blocks, closures, functions inlined before they are typed,
# literals as types. A kernel that needed one would not compile.
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
    typed_passes.AnnotateTypes,
    typed_passes.NoPythonSupportedFeatureValidation,
}


class _FusedLibrary(JITCodeLibrary):
    """Code in which products are fused with sums before anything is linked with it."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Run the passes over each function, fuse its products, and add the module."""
        self._optimize_functions(ll_module)
        _, cpu, features = self._codegen.magic_tuple()
        self._final_module.link_in(_fused.fused(ll_module, _fused.can_fuse(cpu, features)))


class _PartLibrary(_FusedLibrary):
    """Intermediate code of a part, to which only cheap passes were applied."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Run Numba's passes over the functions of a module; Numba also prepares them for each declaration."""
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager()
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        codegen = self._codegen
        passes, builder = codegen._module_pass_manager(
            loop_vectorize=codegen._loopvect, slp_vectorize=False, opt=codegen._opt_level, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> Any:
        """Content for the disk, without object code."""
        self._ensure_finalized()
        return self.name, "bitcode", self._final_module.as_bitcode()

    def load(self, bitcode: bytes) -> None:
        """Load the content from the disk."""
        self._final_module = parse_bitcode(bitcode)
        self._finalize_final_module()

    @classmethod
    def restored(cls, codegen: Any, name: str, kept: Any) -> Any:
        """Return the library that was kept on disk."""
        part = cls(codegen, name)
        part.load(kept)
        return part


def _key(library: Any, fndesc: Any, environment: Any) -> object:
    """A unique replacement for the function that Python would call, against which callers are compiled."""
    library._ensure_finalized()
    return object()


class PartCompiler(Compiler):
    """Numba's compiler, for parts."""

    library_class: type[_PartLibrary] = _PartLibrary

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
        context = self.state.targetctx  # a copy made for this function
        context.get_executable = _key
        self.state.library = self.library_class(context.codegen(), func.__qualname__)
        return super().compile_extra(func)


class CallableCompiler(Compiler):
    """Numba's compiler, for functions that Python calls."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function with products that are fused as in parts."""
        self.state.library = _FusedLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class ApartCompiler(PartCompiler):
    """Numba's compiler, for large parts with several callers, which should not be copied into each of them."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function that LLVM may not inline."""
        result = super().compile_extra(func)
        module = result.library._final_module
        module.get_function(result.fndesc.mangled_name).add_function_attribute("noinline")
        return result


def restored(target_context: Any, library: Any, fndesc: Any, environment: Any, signature: Any, *rest: Any) -> Any:
    """Restore a part, or a function for Python, from the result of `CompileResult._reduce`."""
    name, kind, code = library
    if kind != "bitcode":
        return CompileResult._rebuild(target_context, library, fndesc, environment, signature, *rest)
    part = PartCompiler.library_class.restored(target_context.codegen(), name, code)
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
