"""The bounds that docs/certified.md derives are those that the code names, and no constant is less than its bound."""

import re
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "loewner"
PAGE = ROOT / "docs" / "certified.md"

UNITS = {"": 1.0, "u53": 2.0**-53, "u24": 2.0**-24}
QUANTITY = r"(\d[\d.e+-]*)(?: (?:u53|u24))?"
ROW = re.compile(rf"\| (B\d+) \| .* \| ({QUANTITY}) \| `(1 - )?([\w/]+)\.(\w+)( - 1)?` \| ({QUANTITY}) \|")
CITATION = re.compile(r"^([A-Z][A-Z0-9_]*) = .*  # certified\.md (B\d+(?:, B\d+)*)$", re.M)


class Row(NamedTuple):
    """One line of the page's table."""

    derived: str
    module: str
    constant: str
    excess: bool  # the bound is on what the constant has beyond 1
    lack: bool  # the bound is on what the constant lacks to 1
    value: str


def number(quantity: str) -> float:
    """The value of a quantity of the table, such as `17 u53`."""
    digits, _, unit = quantity.partition(" ")
    return float(digits) * UNITS[unit]


def rows(page: str) -> dict[str, Row]:
    """Bounds of the table, by number; every line that starts like one must be readable."""
    found = {}
    for line in re.findall(r"^\| B\d+ \|.*$", page, flags=re.M):
        match = ROW.fullmatch(line)
        assert match, line
        bound, derived, _, lack, module, constant, excess, value, _ = match.groups()
        assert bound not in found, bound
        found[bound] = Row(derived, module, constant, bool(excess), bool(lack), value)
    return found


def citations(source: str) -> list[tuple[str, str]]:
    """Constant and bound of each citation, which is the comment beside the constant's assignment."""
    found = [(constant, bound) for constant, bounds in CITATION.findall(source) for bound in bounds.split(", ")]
    assert len(CITATION.findall(source)) == source.count("# certified.md B"), "a bound beside no constant"
    return found


def all_citations() -> dict[str, tuple[str, str]]:
    """Module and constant of the whole package's citations, by bound."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = path.relative_to(PACKAGE).with_suffix("").as_posix().removeprefix("_kernels/")
        for constant, bound in citations(path.read_text()):
            assert bound not in found, f"{bound} is cited twice"
            found[bound] = module, constant
    return found


def disagreements(page: dict[str, Row], code: dict[str, tuple[str, str]]) -> list[str]:
    """What differs between the table, the comments of the code, and the constants it runs with."""
    faults = [f"{bound} is in one of table and code only" for bound in sorted(page.keys() ^ code.keys())]
    for bound in page.keys() & code.keys():
        row = page[bound]
        if code[bound] != (row.module, row.constant):
            faults.append(f"{bound}: code {code[bound]}, page {row}")
            continue
        inside = (PACKAGE / "_kernels" / f"{row.module}.py").exists()
        name = f"loewner.{'_kernels.' if inside else ''}{row.module.replace('/', '.')}"
        value = getattr(import_module(name), row.constant) - row.excess
        if row.lack:
            value = 1.0 - value
        # 1 less a small number has lost digits of it.
        if value != pytest.approx(number(row.value), rel=1e-9 if row.lack else 1e-12, abs=0.0):
            faults.append(f"{bound}: {row.constant} is {value / number(row.value):g} times {row.value}, its value here")
        if not value >= number(row.derived):
            faults.append(f"{bound}: {row.constant} is {value}, less than {row.derived}")
    return faults


def test_table_and_code_agree():
    """Every bound has a row and a citation, with the same constant, and the value the code runs with."""
    page, code = rows(PAGE.read_text()), all_citations()
    assert len(page) > 20
    assert disagreements(page, code) == []


def test_errors_of_positions_come_from_one_function():
    """Nothing multiplies a length by the constant itself: a term added to `position_error` reaches every proof."""
    users = {
        path.relative_to(PACKAGE / "_kernels").as_posix(): re.findall(
            r"(?:POSITION_ERROR|POSITION_ROUNDINGS) \*.*", text
        )
        for path in sorted((PACKAGE / "_kernels").rglob("*.py"))
        if re.search(r"(POSITION_ERROR|POSITION_ROUNDINGS) \*", text := path.read_text())
    }
    assert {name: len(uses) for name, uses in users.items()} == {
        "ellipsoids/contact.py": 1,  # the function
        "pipeline/distances.py": 1,  # not a proof, but how near to contact counts as a graze
        "tolerances.py": 1,  # B7, of bounds in single precision, derived apart
    }, users


def test_bounds_are_derived_in_the_text():
    """The page's text derives each bound of the table and no other; its name is bold and follows the table's number."""
    page = PAGE.read_text()
    derived = re.findall(r"([^*]{,80})\*\*(B\d+)\*\*", page)
    assert sorted(bound for _, bound in derived) == sorted(table := rows(page))
    numbers = {bound: re.findall(r"\d+(?:\.\d+)?(?:e-\d+)?", text) for text, bound in derived}
    assert {bound for bound in table if table[bound].derived.split()[0] not in numbers[bound]} == set()


@pytest.mark.parametrize(
    "change",
    [
        (r"(\| B10 .*)\| 35 \|", r"\1| 73 |"),
        (r"(\| B10 .*)\| 72 \|", r"\1| 71 |"),
        (r"(\| B10 .*)PRODUCT_ERROR", r"\1WIDTH_ERROR"),
        (r"\| B10 .*\n", ""),
        (r"(\| B1 .*\n)", r"\1| B99 | x | 1 | `narrow/simplex.FACE_ERROR` | 64 |\n"),
    ],
    ids=["derived", "value", "constant", "no row", "no citation"],
)
def test_a_changed_table_is_found(change):
    """Each kind of disagreement between page and code is seen."""
    text = PAGE.read_text()
    changed = re.sub(change[0], change[1], text, count=1)
    assert changed != text
    try:
        found = disagreements(rows(changed), all_citations())
    except AssertionError as error:
        found = [str(error)]
    assert found


def test_citations_need_a_constant():
    """A citation counts for the constant beside it; one beside none is a fault."""
    assert citations("A = 2.0  # certified.md B1, B2\n") == [("A", "B1"), ("A", "B2")]
    with pytest.raises(AssertionError, match="beside no constant"):
        citations("A = 2.0\n# certified.md B1\n")


def test_an_answer_is_correct_to_within_what_the_readme_promises():
    """Gaps that count as touching are a multiple of the slack of positions: both together are at most 1e-12."""
    touching = import_module("loewner._kernels.narrow.gjk_robust").TOUCH_ROUNDINGS
    assert touching * import_module("loewner._kernels.tolerances").POSITION_ROUNDINGS <= 1e-12
    assert "1e-12 times the size" in (ROOT / "README.md").read_text(encoding="utf-8")
