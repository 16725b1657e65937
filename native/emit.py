"""Kernels as one object file: what Numba makes of them, without Numba, Python or NumPy.

Run by `build.py`, in processes of its own:

    emit.py                           check Numba itself, for this machine
    emit.py code TO NUMBER NAMES      intermediate code of entries, which is the same for all levels of processors
    emit.py object TO NUMBER CODES    machine code of that, for one level

Numba reads the level from the environment when it is imported. Machine code does not run there, since this machine's
processor may be of a lower level.

Processes that run at the same time share the intermediate code of the functions that several entries call: each writes
what it compiles to a folder, the cache of the kernels, and looks there first. Numba gives functions numbers, and their
names contain them; so each process numbers from a start of its own, and no two functions have the same name.
"""

import ctypes
import gc
import importlib
import itertools
import pickle
import re
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import config, types
from numba.core.bytecode import FunctionIdentity
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.datamodel import default_manager
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime import rtsys
from numba.core.types.functions import BaseFunction
from numba.extending import intrinsic

sys.path.insert(0, str(Path(__file__).parents[1] / "src"))

from loewner._kernels import _fused, _jit, _parts
from loewner._native.entries import ENTRIES, Entry, types_of

SLOT = ir.IntType(64)
PREFIX = "loewner_"


class _OwnLibrary(_parts._PartLibrary):
    """Intermediate code of one function alone: what it calls is linked once, and optimised with all others.

    Numba links copies of all that a function calls into it, and of what these call.
    """

    finished = 0  # in this process

    def finalize(self):
        self._raise_if_finalized()
        self._finalize_final_module()
        _OwnLibrary.finished += 1
        report(_OwnLibrary.finished)

    def serialize_using_object_code(self):
        return self.name, "bitcode", Exchange.of_process.write(self)

    @classmethod
    def restored(cls, codegen, name, kept):
        return Exchange.of_process.read(kept)


class Exchange:
    """Intermediate code that processes hand to each other: a file for each library, with the names of what it calls.

    The libraries of a function's callees are stored once, however many functions call them.
    """

    of_process: "Exchange"

    def __init__(self, folder: Path, number: int) -> None:
        self._folder, self._number = folder, number
        rtsys.initialize(cpu_target.target_context)  # its functions have the same names in all processes
        self._names: dict[JITCodeLibrary, str] = {rtsys.library: "runtime"}
        self._libraries: dict[str, JITCodeLibrary] = {"runtime": rtsys.library}
        folder.mkdir(parents=True, exist_ok=True)

    def write(self, library: JITCodeLibrary) -> str:
        """Store a library and what it calls, unless they are stored; return its name."""
        if library not in self._names:
            called = [self.write(one) for one in library._linking_libraries]
            name = f"{self._number}-{len(self._names)}"
            content = library.name, library._final_module.as_bitcode(), called
            (self._folder / name).write_bytes(pickle.dumps(content))
            self._names[library], self._libraries[name] = name, library
        return self._names[library]

    def read(self, name: str) -> JITCodeLibrary:
        """Return a stored library, always the same object: its functions may be linked only once."""
        if name not in self._libraries:
            title, bitcode, called = pickle.loads((self._folder / name).read_bytes())
            library = _OwnLibrary(cpu_target.target_context.codegen(), title)
            library.load(bitcode)
            for one in called:
                library.add_linking_library(self.read(one))
            self._names[library], self._libraries[name] = name, library
        return self._libraries[name]


def report(done: int) -> None:
    """Print how many functions, or steps, are done; `build.py` reads this."""
    print(done, flush=True)


def remember_operators() -> None:
    """Let Numba find the type of an operator's result for given numbers once; it searches anew for each ``a + b``.

    That is a tenth of the time. Calls with arrays are left alone: their search also notes what has to be linked.
    """
    search, known = BaseFunction.get_call_type, {}

    def get_call_type(function, context, args, kws):
        operator_of_numbers = getattr(function.key[0], "__module__", None) == "_operator" and all(
            isinstance(kind, types.Number | types.Boolean) for kind in args
        )
        if not operator_of_numbers:
            return search(function, context, args, kws)
        key = function, tuple(args)
        if key not in known:
            known[key] = search(function, context, args, kws)
        return known[key]

    BaseFunction.get_call_type = get_call_type


def compiled(entry: Entry):
    """Compile an entry down to intermediate code."""
    kernel = getattr(importlib.import_module(f"loewner._kernels.{entry.module}"), entry.name)
    options = {**kernel.targetoptions, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = CPUDispatcher(kernel.py_func, targetoptions=options, pipeline_class=_parts.PartCompiler)
    result = dispatcher._compiler.compile(types_of(entry.arguments), None)
    expected = list(types_of(entry.results))
    found = result.signature.return_type
    listed = [] if found == types.none else list(found) if isinstance(found, types.BaseTuple) else [found]
    if [types.unliteral(kind) for kind in listed] != expected:
        raise SystemExit(f"{entry.name}: expected results {expected}, found {listed}")
    return result


def shim(module: ir.Module, entry: Entry, result) -> None:
    """Add ``int32 loewner_NAME(int64 *arguments, int64 *results)``, which calls an entry as Numba does.

    A number takes a slot. An array takes its address, then its lengths; as a result also, before these, the address of
    its memory's description, which the caller has to release.
    """
    context, signature = result.target_context, result.signature
    pointer = SLOT.as_pointer()
    outer = ir.Function(module, ir.FunctionType(ir.IntType(32), [pointer, pointer]), PREFIX + entry.name)
    outer.storage_class = "dllexport" if sys.platform == "win32" else ""
    builder = ir.IRBuilder(outer.append_basic_block())
    inner = context.declare_function(module, result.fndesc)
    at = iter(range(1000))

    def load():
        return builder.load(builder.gep(outer.args[0], [ir.Constant(SLOT, next(at))]))

    arguments = [_loaded(context, builder, kind, load) for kind in signature.args]
    status, value = context.call_conv.call_function(builder, inner, signature.return_type, signature.args, arguments)
    with builder.if_then(status.is_ok):
        to = iter(range(1000))

        def store(number):
            builder.store(number, builder.gep(outer.args[1], [ir.Constant(SLOT, next(to))]))

        kind = signature.return_type
        if isinstance(kind, types.BaseTuple):
            for n, part in enumerate(kind):
                _stored(context, builder, part, builder.extract_value(value, n), store)
        elif kind != types.none:
            _stored(context, builder, kind, value, store)
    builder.ret(status.code)


def _loaded(context, builder, kind, load):
    """One argument, from slots."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder)
        itemsize = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        array.data = builder.inttoptr(load(), array.data.type)
        lengths = [load() for _ in range(kind.ndim)]
        strides, step = [], ir.Constant(SLOT, itemsize)
        for length in reversed(lengths):
            strides.insert(0, step)
            step = builder.mul(step, length)
        array.shape, array.strides = _tuple_of(builder, lengths), _tuple_of(builder, strides)
        array.itemsize = ir.Constant(SLOT, itemsize)
        array.nitems = builder.udiv(step, array.itemsize)
        array.meminfo, array.parent = array.meminfo.type(None), array.parent.type(None)
        return array._getvalue()
    number = load()
    if isinstance(kind, types.Float):
        return builder.bitcast(number, ir.DoubleType())
    if kind == types.boolean:
        return builder.trunc(number, ir.IntType(1))
    return number


def _stored(context, builder, kind, value, store):
    """One result, to slots."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        store(builder.ptrtoint(array.meminfo, SLOT))
        store(builder.ptrtoint(array.data, SLOT))
        for axis in range(kind.ndim):
            store(builder.extract_value(array.shape, axis))
    elif isinstance(kind, types.Float):
        store(builder.bitcast(value, SLOT))
    elif kind == types.boolean:
        store(builder.zext(value, SLOT))
    else:
        store(value)


def _tuple_of(builder, values):
    result = ir.Constant(ir.ArrayType(SLOT, len(values)), ir.Undefined)
    for n, value in enumerate(values):
        result = builder.insert_value(result, value, n)
    return result


# Offsets in the description of an array's memory that `runtime.c` relies on: the count of references, and the address.
REFERENCES, DATA, MEMORY_SIZE = 0, 24, 32
FIELDS = ("meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides")


@intrinsic
def _memory_of(typingctx, array):
    """Address of the description of an array's memory."""

    def generate(context, builder, signature, arguments):
        return builder.ptrtoint(context.make_array(array)(context, builder, arguments[0]).meminfo, SLOT)

    return types.int64(array), generate


@njit
def _memory_and_array(size):
    array = np.zeros(size)
    return _memory_of(array), array


def check_numba() -> None:
    """Refuse a Numba whose arrays, or their memory, are laid out otherwise than `runtime.c` and the shims rely on."""
    fields = tuple(default_manager.lookup(types.float64[::1])._fields)
    if fields != FIELDS:
        raise SystemExit(f"Numba {numba.__version__}: expected arrays of {FIELDS}, found {fields}")
    address, array = _memory_and_array(1000)
    found = [ctypes.c_size_t.from_address(address + at).value for at in (REFERENCES, DATA, MEMORY_SIZE)]
    if found[0] < 1 or found[1] != array.ctypes.data or found[2] < array.nbytes:
        raise SystemExit(f"Numba {numba.__version__}: memory is described otherwise than runtime.c expects ({found})")


def intermediate(entries: list[Entry]) -> bytes:
    """Intermediate code of entries: names of libraries that were handed over, and the functions that call them."""
    shims = ir.Module("shims")
    results = []
    for entry in entries:
        print(entry.name, flush=True)
        results.append(compiled(entry))
        shim(shims, entry, results[-1])
    return pickle.dumps(([Exchange.of_process.write(result.library) for result in results], str(shims)))


def machine_code(codes: list[bytes]) -> bytes:
    """Object code of intermediate code, position-independent, for the processor that the environment names."""
    codegen = cpu_target.target_context.codegen()
    library = codegen.create_library("loewner")
    read = [pickle.loads(code) for code in codes]
    print("linking", flush=True)
    parts = parts_of([Exchange.of_process.read(name) for names, _ in read for name in names])
    shims = [llvm.parse_assembly(shims) for _, shims in read]
    library._final_module = in_one([part._final_module for part in parts] + shims)
    hide(library._final_module, "linkonce_odr")
    print("optimising", flush=True)
    report(1)
    # The same passes that Numba runs over what Python calls, with everything linked in.
    CPUCodeLibrary._optimize_final_module(library)
    print("instructions", flush=True)
    report(2)
    module = llvm.parse_assembly(uncounted(str(library._final_module)))
    hide(module, "internal")
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    module.verify()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=codegen._get_host_cpu_name(), features=codegen._tm_features, opt=config.OPT, reloc="pic", codemodel="small"
    )
    # Functions that Numba made for several types are often the same code.
    passes = llvm.create_new_module_pass_manager()
    passes.add_merge_functions_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return machine.emit_object(module)


FUNCTION, VALUE = _fused._FUNCTION, _fused._VALUE
NAME = re.compile(r'@(?:"([^"]*)"|([-\w.$]+))\(')
CHUNK = 32  # modules linked at a time


def in_one(modules: list[llvm.ModuleRef]) -> llvm.ModuleRef:
    """Link modules in chunks, then restore the order that linking them in a line would give their functions.

    Each link takes as long as all that is linked into. The order decides what LLVM inlines, and so the speed.
    """
    order = dict.fromkeys(one.name for module in modules for one in module.functions if not one.is_declaration)
    while len(modules) > 1:
        chunks = [modules[at : at + CHUNK] for at in range(0, len(modules), CHUNK)]
        for first, *others in chunks:
            for other in others:
                first.link_in(other)
        modules = [chunk[0] for chunk in chunks]
    defined = dict[str, str]()

    def taken(found: re.Match[str]) -> str:
        name = NAME.search(found[0])
        defined[name[1] or name[2]] = found[0]
        return ""

    rest = FUNCTION.sub(taken, str(modules[0]))
    return llvm.parse_assembly("\n".join([rest, *(defined.pop(name) for name in order), *defined.values()]))


COUNTED = re.compile(r'  (?:tail )?call void @NRT_(?:inc|dec)ref\(ptr (%(?:[-\w.$]+|"[^"]*"))\)')
HARMLESS = re.compile(r"  (?:%\S+ = )?(?:(?:tail )?call|icmp) ")


def uncounted(text: str) -> str:
    """Remove the counting of references to a function's arguments where the function only passes them on.

    A caller keeps what it passes until the call has returned, so counting in between changes nothing unless the
    function hands the reference to someone else: stores it, returns it, or mixes it with others. Numba counts all
    arguments, and removes too few of these pairs: they are three quarters of all calls in the kernels.
    """

    def of_function(found: re.Match[str]) -> str:
        first, *lines = found[0].split("\n")
        arguments = set(VALUE.findall(first))
        for line in lines:
            if not HARMLESS.match(line):
                arguments.difference_update(VALUE.findall(line))
        counts = (COUNTED.match(line) for line in lines)
        kept = [line for line, at in zip(lines, counts, strict=True) if at is None or at[1] not in arguments]
        return "\n".join([first, *kept])

    return FUNCTION.sub(of_function, text)


def hide(module: llvm.ModuleRef, linkage: str) -> None:
    """Give all functions but those that Python calls a linkage that lets them go if nobody calls them."""
    for function in module.functions:
        if not function.is_declaration and not function.name.startswith(PREFIX):
            function.linkage = linkage
            function.add_function_attribute("nounwind")  # no exception passes; tables for unwinding are 3 % of the file


def parts_of(libraries: list) -> list:
    """The libraries, and all that they call, each once."""
    found, waiting = dict.fromkeys(libraries), list(libraries)
    while waiting:
        for part in waiting.pop()._linking_libraries:
            if part not in found:
                found[part] = None
                waiting.append(part)
    return list(found)


def main(what: str, to: Path, number: int, arguments: list[str]) -> None:
    """Write intermediate code, or machine code, to a file; `number` differs between processes that share a cache."""
    FunctionIdentity._unique_ids = itertools.count(1 + number * 1_000_000)
    Exchange.of_process = Exchange(_jit.CACHE_FOLDER / "libraries", number)
    _parts.PartCompiler.library_class = _OwnLibrary
    remember_operators()
    gc.disable()  # a seventh of the time, for half a gigabyte: Numba makes millions of small objects that stay
    if what == "code":
        to.write_bytes(intermediate([ENTRIES[name] for name in arguments]))
    else:
        to.write_bytes(machine_code([Path(name).read_bytes() for name in arguments]))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4:]) if sys.argv[1:] else check_numba()
