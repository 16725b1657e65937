"""Emit entries of the native library as object files, and check that Numba can be used for this.

`build.py` runs this file in separate processes:

    emit.py FOLDER LEVEL NUMBERS   work for one level, as some of several processes that share the work in a folder
    emit.py ... NICE GROUP ...     these groups can wait; lower the priority by NICE when all other objects are taken

NUMBERS name the processes, such as 0,1. With several numbers, this process imports Numba, and then copies itself.

The folder holds `groups.json`, which lists the entries of each group, and `sources`, the hash of the kernels' sources.
The processes write the code of each entry (`ENTRY.code`), which is the same for all levels, and an object file of each
group for each level (`LEVEL-GROUP.o`). Each process takes files that no other process has taken, in its own order
(`in_order`), because entries of one group share most of their code.

Numba reads the level from the environment when it is imported. The machine code is not run here, because this machine's
processor may be of a lower level.

All code is kept in the store (`loewner/_kernels/_store.py`), so that processes share the functions that several entries
call. After an edit, only the functions that may depend on it, and the groups that contain such a function, are compiled
again.
"""

import ctypes
import gc
import importlib
import json
import multiprocessing
import operator
import os
import re
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

# Numba imports SciPy if it is installed. No kernel needs SciPy, and pip may be writing its files at this moment.
if __name__ == "__main__":
    sys.modules["scipy"] = None
    BUILD = os.getppid()  # The imports take seconds, and the build may be killed meanwhile.

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import config, types

sys.path.insert(0, str(Path(__file__).parents[1] / "src"))

from loewner._kernels import _fused, _jit, _parts, _sealed, _sources, _store
from loewner._kernels._numba import (
    BaseFunction,
    CPUCodeLibrary,
    Inst,
    MemInfo,
    NRTContext,
    Var,
    base,
    cgutils,
    cpu_target,
    default_manager,
    event,
    meminfo_alloc,
    postproc,
)
from loewner._kernels.simd import vectors
from loewner._native.entries import ENTRIES, Entry, types_of

SLOT = ir.IntType(64)
PREFIX = "loewner_"
FIRST = 2  # the number of groups that are made first, by two processes


def remember_operators() -> None:
    """Let Numba find the type of an operator's result for given types once, not anew for each ``a + b``.

    The search takes a sixth of the time. Other operations, such as slicing, are left alone: the search for them
    compiles functions that they call, and records that these functions have to be linked.
    """
    search, call_types = BaseFunction.get_call_type, {}
    plain = types.Number | types.Boolean | types.IntegerLiteral | vectors.Lanes
    indexed = types.Array | types.BaseTuple

    def is_remembered(function, args):
        if function.key[0] in (operator.getitem, operator.setitem) and isinstance(args[0], indexed):
            at = args[1].types if isinstance(args[1], types.BaseTuple) else args[1:2]
            return all(isinstance(kind, types.Integer | types.IntegerLiteral) for kind in at)
        is_operator = getattr(function.key[0], "__module__", None) == "_operator" or function.key[0] is bool
        return is_operator and all(isinstance(kind, plain) for kind in args)

    def get_call_type(function, context, args, kws):
        if not is_remembered(function, args):
            return search(function, context, args, kws)
        key = function, tuple(args)
        if key not in call_types:
            call_types[key] = search(function, context, args, kws)
        return call_types[key]

    BaseFunction.get_call_type = get_call_type


def remember_sizes() -> None:
    """Let Numba get the size of a type from LLVM once, not for each variable; this saves a twentieth of the time."""
    measure, sizes = base.BaseContext.get_abi_sizeof, {}

    def get_abi_sizeof(context, kind):
        if id(kind) not in sizes:
            sizes[id(kind)] = kind, measure(context, kind)  # A type that is kept alive keeps its identity.
        return sizes[id(kind)][1]

    base.BaseContext.get_abi_sizeof = get_abi_sizeof


def count_only_arrays() -> None:
    """Let Numba look for counted references only in types that have one; this saves a twentieth of the time.

    Otherwise, Numba generates code that unpacks every tuple and array wherever it is passed on, and LLVM removes this
    code again.
    """

    @cache
    def is_counted(models, kind):
        return models[kind].contains_nrt_meminfo()

    def get_meminfos(context, builder, kind, value):
        models = context._context.data_model_manager
        if not is_counted(models, kind):
            return []
        model = models[kind]
        meminfos = [(kind, model.get_nrt_meminfo(builder, value))] if model.has_nrt_meminfo() else []
        for inner, field in model.traverse(builder):
            if is_counted(models, inner):
                meminfos += get_meminfos(context, builder, inner, field(value))
        return meminfos

    NRTContext.get_meminfos = get_meminfos


def list_variables_by_type() -> None:
    """Let Numba list a statement's variables without searching its numbers and names; this saves 3 % of the time."""
    search = Inst._rec_list_vars

    @cache
    def holds_variables(kind):
        return issubclass(kind, Var | Inst | list | tuple | dict)

    def _rec_list_vars(statement, value):
        if type(value) is not dict:
            return search(statement, value)
        held = [one for one in value.values() if holds_variables(type(one))]
        return [variable for one in held for variable in ([one] if type(one) is Var else search(statement, one))]

    Inst._rec_list_vars = _rec_list_vars


def find_lifetimes_once() -> None:
    """Let Numba find the last use of each variable only before it generates code; this saves a thirtieth of the time.

    Otherwise, Numba also searches for these last uses after four earlier passes over each function, where nothing needs
    them.
    """
    run = postproc.PostProcessor.run

    def run_at_end(processor, emit_dels=False, **options):
        function = processor.func_ir
        if emit_dels or function.is_generator:
            run(processor, emit_dels, **options)
        else:
            function.blocks = postproc.transforms.canonicalize_cfg(function.blocks)

    postproc.PostProcessor.run = run_at_end


def remember_parameters() -> None:
    """Let Numba read the parameters of each of its implementations only once; this saves a sixtieth of the time."""
    base._has_loc = cache(base._has_loc)


def look_once() -> None:
    """Let Numba import its own declarations once, not for every array; this saves a twentieth of the time.

    Later declarations are added to the first of its lists. Numba also sends no events, because nothing here listens to
    them.
    """
    code, kinds = cpu_target.target_context, cpu_target.typing_context
    code.refresh()
    first = next(iter(code._registries))
    code.load_additional_registries = lambda: code.install_registry(first)
    kinds.load_additional_registries = lambda: None
    event.start_event = event.end_event = lambda *_, **__: None


def compiled(entry: Entry):
    """Compile an entry down to intermediate code, or find it in the store."""
    kernel = getattr(importlib.import_module(f"loewner._kernels.{entry.module}"), entry.name)
    kernel.compile(types_of(entry.arguments))
    result = kernel.overloads[types_of(entry.arguments)]
    expected = list(types_of(entry.results))
    actual = result.signature.return_type
    listed = [] if actual == types.none else list(actual) if isinstance(actual, types.BaseTuple) else [actual]
    if [types.unliteral(kind) for kind in listed] != expected:
        raise SystemExit(f"{entry.name}: expected results {expected}, found {listed}")
    return result


def shim(module: ir.Module, entry: Entry, result) -> None:
    """Add ``int32 loewner_NAME(int64 *arguments, int64 *results)``, which calls an entry as Numba does.

    A number takes a slot. An array takes a slot for its address and one for each of its lengths. If the array is a
    result, another slot comes before these: the address of its memory's description, which the caller has to release.
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
    """Load one argument from slots."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder)
        itemsize = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        array.data = builder.inttoptr(load(), array.data.type)
        lengths = [load() for _ in range(kind.ndim)]
        strides, step = [], ir.Constant(SLOT, itemsize)
        for length in reversed(lengths):
            strides.insert(0, step)
            step = builder.mul(step, length)
        array.shape, array.strides = cgutils.pack_array(builder, lengths), cgutils.pack_array(builder, strides)
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
    """Store one result in slots."""
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


# Offsets, in the description of an array's memory, on which `runtime.c` relies: the count of references, and the
# address.
REFERENCES, DATA, MEMORY_SIZE = 0, 24, 32
FIELDS = ("meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides")


def check_numba() -> None:
    """Refuse a Numba whose arrays, or their memory, lack the layout on which `runtime.c` and the shims rely."""
    fields = tuple(default_manager.lookup(types.float64[::1])._fields)
    if fields != FIELDS:
        raise SystemExit(f"Numba {numba.__version__}: expected arrays of {FIELDS}, found {fields}")
    address = meminfo_alloc(size := 8000)
    memory = MemInfo(address)
    words = [ctypes.c_size_t.from_address(address + at).value for at in (REFERENCES, DATA, MEMORY_SIZE)]
    if words[0] < 1 or words[1] != memory.data or words[2] < size:
        raise SystemExit(f"Numba {numba.__version__}: memory is described otherwise than runtime.c expects ({words})")


def write_code(entry: Entry, to: Path) -> None:
    """Write the code of an entry: the key of its part in the store, and the text of a function that calls it."""
    result = compiled(entry)
    if not result.library.key:
        raise SystemExit(_jit.unwritten())
    shims = ir.Module("shims")
    shim(shims, entry, result)
    put(to, json.dumps({"key": result.library.key, "shim": str(shims)}).encode())


def write_object(codes: list[Path], before: list[Path], to: Path) -> None:
    """Write the object code of entries, from the store if nothing has changed.

    Functions that LLVM may not inline are in the object of the first group that calls them; `before` holds the codes of
    the groups before this group.
    """
    codegen = cpu_target.target_context.codegen()
    read, earlier = ([json.loads(path.read_text(encoding="utf-8")) for path in paths] for paths in (codes, before))
    own, others = ([_parts.library_of(codegen, one["key"]) for one in some] for some in (read, earlier))
    elsewhere = {part for part in _parts.everything_called(others) if apart_functions(part)}
    parts = _parts.everything_called(own, without=elsewhere)
    keys = sorted(part.key for part in parts if isinstance(part, _parts.PartLibrary))
    made_of = keys, [one["shim"] for one in read], codegen.magic_tuple(), Path(__file__).read_bytes(), _jit.MADE_WITH
    key = _store.key_of(to.name, made_of, frozenset())
    try:
        object_code = _store.read(key)
    except (OSError, _sealed.DamagedFileError):
        object_code = machine_code(parts, [one["shim"] for one in read])
        with suppress(OSError):
            _store.write(key, object_code)
    put(to, object_code)


def apart_functions(part: CPUCodeLibrary) -> list[str]:
    """Names of a part's functions that LLVM may not inline, and that other parts call."""
    if not isinstance(part, _parts.PartLibrary):
        return []  # The part is Numba's run time, which is in each object.
    defined = (one for one in part._final_module.functions if not one.is_declaration and one.linkage.name == "external")
    return [one.name for one in defined if any(b"noinline" in some for some in one.attributes)]


def put(to: Path, content: bytes) -> None:
    """Write a file that is complete as soon as it exists."""
    temporary = to.with_suffix(".part")
    temporary.write_bytes(content)
    temporary.replace(to)


def machine_code(parts: list[CPUCodeLibrary], shims: list[str]) -> bytes:
    """Position-independent object code of parts and shims, for the processor that the environment names."""
    codegen = cpu_target.target_context.codegen()
    library = codegen.create_library("loewner")
    apart = [name for part in parts for name in apart_functions(part)]
    linked = _parts.in_one([*(part._final_module.clone() for part in parts), *map(llvm.parse_assembly, shims)])
    library._final_module = module = llvm.parse_assembly(uncounted(str(linked)))
    hide(module, "linkonce_odr", apart)
    # Run the same passes as Numba runs for functions that Python calls, with everything linked in.
    CPUCodeLibrary._optimize_final_module(library)
    hide(module, "internal", apart)
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    module.verify()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=codegen._get_host_cpu_name(), features=codegen._tm_features, opt=config.OPT, reloc="pic", codemodel="small"
    )
    # Functions that Numba made for several types often have the same code.
    passes = llvm.create_new_module_pass_manager()
    passes.add_merge_functions_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return machine.emit_object(module)


FUNCTION, VALUE = _fused._FUNCTION, _fused._VALUE
COUNTED = re.compile(r'  (?:tail )?call void @NRT_(?:inc|dec)ref\(ptr (%(?:[-\w.$]+|"[^"]*"))\)')
HARMLESS = re.compile(r"  (?:%\S+ = )?(?:(?:tail )?call|icmp) ")


def uncounted(text: str) -> str:
    """Remove the counting of references to a function's arguments where the function only passes the arguments on.

    A caller keeps its references until the call has returned. Counting in between therefore changes nothing, unless the
    function stores a reference, returns it, or mixes it with other references. Numba counts all arguments, and removes
    too few pairs of counts: the remaining pairs are three quarters of all calls in the kernels.
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


def hide(module: llvm.ModuleRef, linkage: str, apart: list[str]) -> None:
    """Set a linkage that lets LLVM remove functions without a caller, except functions that are called from outside.

    Python calls the entries from outside, and objects of other groups call the functions that are apart.
    """
    for function in module.functions:
        if function.is_declaration or function.name.startswith(PREFIX):
            continue
        if function.name in apart:
            function.visibility = "hidden"
        else:
            function.linkage = linkage
        # No exception passes through a kernel, and tables for unwinding would be 3 % of the file.
        function.add_function_attribute("nounwind")


def expect_sources(folder: Path) -> None:
    """Import all kernels, and stop unless their sources are the ones with which the build began.

    From then on, an edit alters neither the code in memory nor its keys. Otherwise, the code of an edit that is undone
    before the build ends could be kept under the keys of the sources without this edit.
    """
    for entry in ENTRIES.values():
        importlib.import_module(f"loewner._kernels.{entry.module}")
    if _sources.source_hash.__wrapped__() != (folder / "sources").read_text(encoding="utf-8") or not _store.is_usable():
        raise SystemExit("the kernels' sources changed while they were compiled; build again")


def work(folder: Path, level: str, number: int, nice: int = 0, *later: str) -> None:
    """Write files that no other process has taken, until all are taken: objects whose codes exist, or else codes."""
    groups = json.loads((folder / "groups.json").read_text(encoding="utf-8"))
    objects = {folder / f"{level}-{group}.o": [folder / f"{name}.code" for name in groups[group]] for group in groups}
    codes = {folder / f"{name}.code": name for name in in_order(groups, number, later)}
    stages = {group: (group not in list(groups)[:FIRST]) + (group in later) for group in groups}
    stage_of_code = {name: stages[group] for group in groups for name in groups[group]}
    stage_of_object = dict(zip(objects, stages.values(), strict=True))
    before = list[Path]()  # Codes of the groups whose objects are taken.
    parent = os.getppid()

    def must_wait(name: str) -> bool:
        """Return whether an object of an earlier stage is not yet taken, because this process may have to make it."""
        return any(
            stage < stage_of_code[name] and not path.with_suffix(".taken").exists()
            for path, stage in stage_of_object.items()
        )

    # A parent that is killed cannot end its processes. Therefore, each process checks that the parent still runs.
    while (objects or codes) and os.getppid() == parent:
        to, needed = next(iter(objects.items()), (None, []))
        if to is not None and all(map(Path.exists, needed)):
            del objects[to]
            if is_mine(to):
                say(to.stem)
                write_object(needed, before, to)
            before += needed
        elif codes and not (number < 2 and must_wait(next(iter(codes.values())))):
            to = next(iter(codes))
            name = codes.pop(to)
            if is_mine(to):
                say(name)
                if nice and stage_of_code[name] == max(stages.values()) and not must_wait(name):
                    os.nice(nice)
                    nice = 0
                write_code(ENTRIES[name], to)
        else:
            time.sleep(0.05)
    _store.remove_unused()


def say(line: str) -> None:
    """Print a line in one piece, because copies of this process print to the same file."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def in_order(groups: dict[str, list[str]], number: int, later: tuple[str, ...]) -> list[str]:
    """Order the entries for a process: each of two processes begins with one of the first two groups.

    The second process takes all entries in reverse order, so that both processes meet as late as possible. Further
    processes begin at the other groups in turn. Processes that need the same functions at the same time would wait for
    each other.
    """
    step = -1 if number % 2 else 1
    if number < 2:
        early = [group for group in groups if group not in later]
        order = [*early[:FIRST][::step], *early[FIRST:][::step], *later[::step]]
    else:
        at = number % len(groups)
        backwards = list(groups)[::-1]
        order = backwards[at:] + backwards[:at]
    return [name for group in order for name in groups[group][::step]]


def is_mine(to: Path) -> bool:
    """Claim a file; return True unless another process has claimed it."""
    try:
        to.with_suffix(".taken").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def main(build: int, folder: Path, level: str, numbers: str, nice: str = "0", *later: str) -> None:
    """Do a share of the work, and print the keys of the functions that are done."""
    check_numba()
    _parts.PartLibrary.listener = say
    look_once()
    remember_operators()
    remember_sizes()
    count_only_arrays()
    list_variables_by_type()
    find_lifetimes_once()
    remember_parameters()
    # Numba makes millions of small objects that stay alive. Without garbage collection, the work takes a seventh less
    # time, and half a gigabyte more memory.
    gc.disable()
    expect_sources(folder)
    if os.getppid() != build:
        raise SystemExit("the build was killed")
    shares = [(folder, level, int(number), int(nice), *later) for number in numbers.split(",")]
    if len(shares) == 1:
        work(*shares[0])
    else:
        in_processes(build, shares)


def in_processes(build: int, shares: list[tuple]) -> None:
    """Work in copies of this process; end all of them when one fails, or when the build's process is killed."""
    copies = multiprocessing.get_context("fork")
    processes = [copies.Process(target=work, args=share, daemon=True) for share in shares]
    for process in processes:
        process.start()
    while None in (ended := [process.exitcode for process in processes]) and not any(ended) and os.getppid() == build:
        time.sleep(0.05)
    if any(process.exitcode != 0 for process in processes):
        found = ", ".join(str(status) for status in ended if status) or "none: the build was killed"
        raise SystemExit(f"a copy of the process has failed; its status: {found}")


if __name__ == "__main__":
    main(BUILD, Path(sys.argv[1]), *sys.argv[2:])
    os._exit(0)  # Python would take seconds to release what Numba holds; every file is complete, and all is printed.
