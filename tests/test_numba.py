"""Names of Numba that are not documented: each with what it is for and its parameters, which a new Numba may change.

Behaviour on which the compiling of kernels relies is tested in `test_kernel_cache.py` and `test_native.py`.
"""

import ast
import inspect
from pathlib import Path

import pytest
from numba.core.funcdesc import FunctionDescriptor

import loewner
from loewner._kernels import _numba, _parts

pytestmark = pytest.mark.light

SOURCES = Path(loewner.__file__).parent
EMIT = Path(__file__).parents[1] / "native" / "emit.py"

codegen = type(_numba.cpu_target.target_context.codegen())
context = type(_numba.cpu_target.target_context)
library, compiler, dispatcher = _numba.JITCodeLibrary, _numba.Compiler, _numba.CPUDispatcher

# Functions: their parameters, and what each is for.
FUNCTIONS = {
    "compile a kernel": [
        (compiler.define_pipelines, "self", "passes, of which some are left out"),
        (compiler.compile_extra, "self func", "replaced: the library and the name of a part"),
        (compiler._compile_bytecode, "self", "the rest of `compile_extra`"),
        (_numba.PassManager, "pipeline_name", "the passes that remain"),
        (_numba.PassManager.add_pass, "self pss description", "likewise"),
        (_numba.PassManager.finalize, "self", "likewise"),
        (_numba.FunctionIdentity.from_function, "pyfunc", "given a name that is the same in all processes"),
        (_numba.untyped_passes.ExtractByteCode.run_pass, "self state", "the first step of `compile_extra`"),
        (_numba.compile_result, "entries", "what a caller gets of a part from the store"),
        (context.get_executable, "self library fndesc env", "replaced: no machine code for parts"),
        (context.add_dynamic_addr, "self builder intaddr info", "replaced: no address of a kernel in a part"),
        (context.get_constant_null, "self ty", "stands for that address"),
        (context.refresh, "self", "before code from the store is used"),
    ],
    "code of a kernel": [
        (library.add_llvm_module, "self ll_module", "replaced: products are fused"),
        (library._optimize_functions, "self ll_module", "replaced: no passes for declarations"),
        (library.finalize, "self", "replaced: a part holds its own code alone"),
        (library._raise_if_finalized, "self", "of Numba's `finalize`"),
        (library._finalize_dynamic_globals, "self", "of Numba's `finalize`"),
        (library._ensure_finalized, "self", "before code is written to the store"),
        (library._get_module_for_linking, "self", "Numba's own functions, which are copied into parts"),
        (library.serialize_using_object_code, "self", "replaced: parts in the store have no machine code"),
        (library.enable_object_caching, "self", "machine code of what Python calls is kept"),
        (codegen.magic_tuple, "self", "name and features of the processor"),
        (codegen._function_pass_manager, "self kwargs", "passes over a function"),
        (codegen._pass_builder, "self kwargs", "passes over a part: what is not called goes"),
        (_numba.CompileResult._reduce, "self", "content for the store"),
        (_numba.CompileResult._rebuild, "target_context libdata fndesc env signature objectmode lifted typeann "
         "reload_init referenced_envs", "what Python calls, from the store"),
        (_numba.dumps, "obj", "content as bytes"),
    ],
    "calls of kernels": [
        (dispatcher.compile, "self sig", "replaced: one process at a time compiles a kernel"),
        (dispatcher.add_overload, "self cres", "replaced: Python cannot call a part"),
        (dispatcher.get_call_template, "self args kws", "replaced: literals are integers"),
        (dispatcher._compile_for_args, "self args kws", "replaced: Python calls the other form"),
        (_numba.NullCache.load_overload, "self sig target_context", "replaced by the store"),
        (_numba.NullCache.save_overload, "self sig cres", "replaced by the store"),
        (_numba.normalize_signature, "sig", "types of the arguments"),
        (_numba.event.register, "kind listener", "says that kernels are being compiled"),
    ],
    "the native library": [
        (_numba.BaseFunction.get_call_type, "self context args kws", "replaced: operators are remembered"),
        (_numba.base.BaseContext.get_abi_sizeof, "self ty", "replaced: sizes are remembered"),
        (_numba.NRTContext.get_meminfos, "self builder ty val", "replaced: numbers are not taken out of arrays"),
        (_numba.Inst._rec_list_vars, "self val", "replaced: no search in names and numbers"),
        (_numba.postproc.PostProcessor.run, "self emit_dels extend_lifetimes", "replaced: lifetimes are found once"),
        (_numba.postproc.transforms.canonicalize_cfg, "blocks", "what remains of it"),
        (_numba.base._has_loc, "fn", "replaced: remembered"),
        (context.load_additional_registries, "self", "replaced: what is declared is imported once"),
        (type(_numba.cpu_target.typing_context).load_additional_registries, "self", "likewise"),
        (context.install_registry, "self registry", "finds what is declared later"),
        (_numba.event.start_event, "kind data", "replaced: nothing listens"),
        (_numba.event.end_event, "kind data exc_details", "likewise"),
        (_numba.CPUCodeLibrary._optimize_final_module, "self", "passes over everything"),
        (codegen._get_host_cpu_name, "self", "the processor of machine code"),
        (context.declare_function, "self module fndesc", "what a shim calls"),
    ],
    "own instructions": [
        (_numba.signature, "return_type args kws", "type of an intrinsic"),
        (_numba.infer_global, "val typ kwargs", "operators of vectors"),
        (_numba.populate_array, "array data shape strides itemsize meminfo parent", "arrays in scratch memory"),
        (_numba.cgutils.unpack_tuple, "builder tup count", "elements of a tuple"),
        (_numba.cgutils.get_or_insert_function, "module fnty name", "functions of LLVM"),
        (context.make_array, "self typ", "fields of an array"),
        (context.make_tuple, "self builder typ values", "results"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("function", "parameters"),
    [
        pytest.param(function, names, id=f"{task}: {why}")
        for task, of in FUNCTIONS.items()
        for function, names, why in of
    ],
)
def test_functions_have_the_parameters_that_are_relied_on(function, parameters):
    """A name that is gone stops this file; one that takes something else is named by the case."""
    found = inspect.signature(function, follow_wrapped=True).parameters
    assert " ".join(found) == parameters


def test_attributes_are_there():
    """Fields of objects, which have no parameters: what was written down when they were read."""
    part = library(codegen_of(), "a part")
    assert not part._finalized
    assert {"_final_module", "_linking_libraries", "_codegen"} <= vars(part).keys()
    assert {"_data_layout", "_tm", "_tm_features"} <= set(dir(codegen_of()))
    assert {"mangled_name", "llvm_func_name"} <= set(dir(FunctionDescriptor))
    assert isinstance(type(_numba.rtsys).library, property)
    assert all(inspect.isclass(one) for one in _parts.NOT_NEEDED)
    assert hasattr(_numba.default_manager, "lookup")
    assert _numba.MemInfo(_numba.meminfo_alloc(8)).data  # where the build looks for an array's memory
    assert hasattr(_numba.cpu_target.target_context, "_registries")
    assert hasattr(_numba.global_compiler_lock, "__enter__")
    assert issubclass(_numba.errors.LoweringError, Exception)


def codegen_of():
    return _numba.cpu_target.target_context.codegen()


def test_nothing_else_of_numba_is_used():
    """Private modules are imported in one place, and everything there is used."""
    used = set()
    for path in [*SOURCES.rglob("*.py"), EMIT]:
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module == "loewner._kernels._numba":
                used.update(alias.name for alias in node.names)
            elif (
                isinstance(node, ast.ImportFrom) and (node.module or "").startswith("numba.") and path.stem != "_numba"
            ):
                assert node.module in ("numba.core", "numba.extending"), path
                assert node.module == "numba.extending" or [one.name for one in node.names] == ["types"], path
    assert used == set(_numba.__all__)
