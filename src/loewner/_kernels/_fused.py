"""Fuse products with sums in each function separately, so that the last bits of a result depend on nothing else.

LLVM may fuse a product with a sum if both carry the flag ``contract``. By default, LLVM does so at the very end, after
functions have been copied into their callers. Its choice then depends on the callers, the order of linking and the
processor. Here, each function is rewritten as soon as its own passes have run, before it is linked with any other. A
product that is used once, by a sum of the same block, becomes a call of ``llvm.fma``, and the flag is dropped
everywhere. A fused product has one rounding fewer, so every error bound holds either way.

A processor without a fused instruction rounds every product, so the last bits of its answers differ.
"""

import re
from collections import Counter
from functools import cache
from typing import Any

import llvmlite.binding as llvm

_FUNCTION = re.compile(r"^define .*?^\}$", re.MULTILINE | re.DOTALL)
_VALUE = re.compile(r'%(?:[-\w.$]+|"[^"]*")')
_OPERATION = re.compile(r"  (%\S+) = (fmul|fadd|fsub) ([a-z ]*?)((?:<\d+ x )?(double|float)>?) (.*?)((?:, !.*)?)$")
_MARK = "contract"


@cache
def can_fuse(cpu: str, features: str) -> bool:
    """Return whether a processor can multiply and add in one instruction; on others, LLVM would call a function."""
    probe = llvm.parse_assembly(
        "declare double @llvm.fma.f64(double, double, double)\n"
        "define double @probe(double %x) {\n"
        "  %y = call double @llvm.fma.f64(double %x, double %x, double %x)\n"
        "  ret double %y\n}"
    )
    target = llvm.Target.from_triple(llvm.get_process_triple())
    assembly = target.create_target_machine(cpu=cpu, features=features).emit_assembly(probe)
    return re.search(r"\bfma\b", assembly) is None


def fused(module: Any, can_fuse: bool) -> Any:
    """Return an LLVM module with its products fused with sums, function by function, and without ``contract`` flags."""
    text = str(module)
    if f" {_MARK} " not in text:
        return module
    used = set[str]()
    if can_fuse:
        text = _FUNCTION.sub(lambda found: _of_function(found[0], used), text)
    declared = [
        f"declare {kind} {name}({kind}, {kind}, {kind})"
        for kind, name in sorted((kind, _name(kind)) for kind in used)
        if f"{name}(" not in _FUNCTION.sub("", text)
    ]
    fused_module = llvm.parse_assembly("\n".join([text.replace(f" {_MARK} ", " "), *declared]))
    fused_module.name = module.name
    return fused_module


def _name(kind: str) -> str:
    """Name of the intrinsic for a kind of number: ``double``, ``float``, or a vector of either."""
    count, _, element = kind.strip("<>").rpartition(" x ")
    return f"@llvm.fma.{f'v{count}' if count else ''}f{64 if element == 'double' else 32}"


def _of_function(text: str, used: set[str]) -> str:
    """Rewrite the text of a function; add the kinds of numbers in its fused products to `used`."""
    lines = text.split("\n")
    uses = Counter(_VALUE.findall(text))  # The count of a name includes its definition.
    products = dict[str, tuple[int, str, str]]()  # Line and factors of each product in the current block.
    for at, line in enumerate(lines):
        if not line.startswith(" "):
            products.clear()  # A new block begins here.
        match = _OPERATION.match(line)
        if match is None or _MARK not in match[3]:
            continue
        name, operation, kind = match[1], match[2], match[4]
        first, second = _operands(match[6])
        if operation == "fmul":
            products[name] = at, first, second
            continue
        product = next((one for one in (first, second) if one in products and uses[one] == 2), None)
        if product is None:
            continue
        # The fused forms: x y + z, x y - z = x y + (-z), and z - x y = (-x) y + z. Changing a sign is exact.
        place, x, y = products.pop(product)
        z = second if product == first else first
        before = []
        if operation == "fsub":
            negative = f'%"minus.{name.strip("%").strip(chr(34))}"'
            before = [f"  {negative} = fneg {kind} {z if product == first else x}"]
            x, z = (x, negative) if product == first else (negative, z)
        call = f"  {name} = call {kind} {_name(kind)}({kind} {x}, {kind} {y}, {kind} {z})"
        lines[place], lines[at] = "", "\n".join([*before, call])
        used.add(kind)
    return "\n".join(lines)


def _operands(text: str) -> tuple[str, str]:
    """Split the text of two operands at the comma between them; a constant vector contains commas, too."""
    depth = 0
    for at, letter in enumerate(text):
        depth += (letter in "<([{") - (letter in ">)]}")
        if letter == "," and not depth:
            return text[:at], text[at + 2 :]
    raise ValueError(f"expected two operands, found {text!r}")
