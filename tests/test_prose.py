"""Prose is plain: no file gains a sentence of the ten kinds that CONTRIBUTING.md lists.

The law: the count of these patterns in a file never rises. `tests/prose_counts.json` holds the counts; files without a
pattern are left out. When a file has become plainer, the table is stale: `python tests/test_prose.py` rewrites it and
refuses to raise a number. Regular expressions find the patterns, so a count includes a few good sentences. Only its
direction has a meaning.
"""

import ast
import functools
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from site_pages import pages

ROOT = Path(__file__).parent.parent
TABLE = Path(__file__).parent / "prose_counts.json"
PAGES = sorted([*(path for path in ROOT.glob("*.md") if path.stem != "CHANGELOG"), *pages(ROOT / "docs")])
GENERATED = {"_build", "generated", "measured.md", "command.md"}
PAGES = [path for path in PAGES if not GENERATED & set(path.parts)]
SOURCES = sorted((ROOT / "src" / "loewner").rglob("*.py"))
WIDTH = 120

pytestmark = pytest.mark.light

# Each comment gives an example, and the words to write instead.
PATTERNS = {
    # "what it returned": a noun, "the result"
    "clause as a noun": r"(?i:\bwhat (?:is|was|are|were|has|had|can|may|must|needs|does|do|did|it|they|its|their|the|a"
    r"|an|each|every|no|this|that|these|those|lies|comes|remains|stays|leaves|hits|moves|touches|goes|follows|takes"
    r"|makes|costs)\b)",
    # "those of the hull": repeat the noun
    "those of": r"(?i:\bthose (?:of|that|which|who|with|in|on|at|from)\b|(?<!so )\bthat of\b)",
    # "the kernel is told": returns, reports, receives
    "code that talks": r"(?i:\b(?:tells?|told|asks?|asked|hears?|heard|knows?|speaks?|hopes?|wants?|says?|said)\b)",
    # "five pairs, of which two ...": a relative clause with a subject
    "of which": r"(?i:\bof (?:which|these|those|all that)\b)",
    # "Of a robot the links are checked": "For a robot ..."
    "Of at the start": r"\bOf\b",
    # "the body that stands": is static, is attached
    "stands": r"(?i:\b(?:stands?|stood|standing|hangs?|hung|hanging)\b(?! for\b))",
    # "a value that nobody reads": unused, the caller, any
    "nobody": r"(?i:\b(?:nobody|no one|whoever|whatever|whichever)\b)",
    # "looked at in steps": sampled, considered
    "looked at": r"(?i:\blook(?:s|ed|ing)? at\b)",
    # "The same for pairs.": name the thing
    "The same": r"(?<=[.:;] )(?:The same|Those)\b",
    # except, perpendicular, slightly, n, predicted, possible
    "dialect": r"(?i:\b(?:but for|square to|a hair|so many|so much|foretold|foretells?|to be had|is had)\b)",
}
FOUND = {name: re.compile(words.replace(" ", r"\s"), re.M) for name, words in PATTERNS.items()}


def blanked(match: re.Match[str]) -> str:
    """Spaces where the match is, its lines kept."""
    return re.sub(r"[^\n]", " ", match[0])


def page_text(text: str) -> str:
    """The prose of a page in its place: code, formulas and the targets of links are blank."""
    text = re.sub(r"^ *(```+|~~~+).*?^ *\1", blanked, text, flags=re.M | re.S)
    text = re.sub(r"(?<=\n\n)(?: {4}.*\n+)+", blanked, text)
    return re.sub(r"\$\$.*?\$\$|\$[^$\n]+\$|`[^`]*`|(?<=\])\([^)\s]*\)", blanked, text, flags=re.S)


def source_text(text: str) -> str:
    """Docstrings and comments of a Python file in their place, without code."""
    lines = [""] * (text.count("\n") + 2)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            string = node.body[0]
            shown = text.split("\n")[string.lineno - 1 : string.end_lineno]
            lines[string.lineno - 1 : string.end_lineno] = [re.sub(r"^ *(?:>>>|\.\.\.).*", "", line) for line in shown]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            lines[token.start[0] - 1] = token.string.lstrip("# ")
    return re.sub(r"`[^`]*`", blanked, "\n".join(lines), flags=re.S)


@functools.cache
def matches(path: Path) -> list[tuple[int, str, str]]:
    """Line, kind and words of each pattern in a file."""
    text = (page_text if path.suffix == ".md" else source_text)(path.read_text())
    return sorted(
        (text.count("\n", 0, match.start()) + 1, name, " ".join(match[0].split()))
        for name, pattern in FOUND.items()
        for match in pattern.finditer(text)
    )


def counts() -> dict[str, int]:
    """How many patterns each file has; files without any are left out."""
    found = {path.relative_to(ROOT).as_posix(): len(matches(path)) for path in [*PAGES, *SOURCES]}
    return {name: count for name, count in found.items() if count}


@functools.cache
def committed() -> dict[str, int]:
    """The table."""
    return json.loads(TABLE.read_text())


@pytest.mark.parametrize("path", [*PAGES, *SOURCES], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_file_gains_a_pattern(path):
    """A file has as many patterns as the table counts: more fails with their lines, fewer asks for a new table."""
    found, allowed = matches(path), committed().get(path.relative_to(ROOT).as_posix(), 0)
    lines = "\n".join(f"{path.relative_to(ROOT)}:{line}: {name}: {words}" for line, name, words in found)
    assert len(found) <= allowed, (
        f"{len(found)} patterns, {allowed} allowed; write these sentences in another way:\n{lines}"
    )
    assert len(found) == allowed, f"{len(found)} patterns, {allowed} in the table: run python tests/test_prose.py"


def test_table_names_files_that_exist():
    """The table has no file that is gone."""
    assert sorted(set(committed()) - set(counts())) == [], "run python tests/test_prose.py"


def test_patterns_are_found_in_prose_alone():
    """A pattern is found across the end of a line, in a docstring and in a comment, and not in code."""
    page = page_text("Free is what\nit says.\n\n    what is\n\n```\nwhat is\n```\n`what is` [those](of)\n")
    assert [len(FOUND[name].findall(page)) for name in ("clause as a noun", "code that talks", "those of")] == [1, 1, 0]
    source = source_text('"""What is free."""\na = "what is"  # those of b\n')
    assert [len(FOUND[name].findall(source)) for name in ("clause as a noun", "those of")] == [1, 1]


def prose_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines of a page that can be wrapped: no code, table, heading, image, or line that is one long word."""
    code = re.sub(r"^ *(```+|~~~+).*?^ *\1", blanked, text, flags=re.M | re.S)
    code = re.sub(r"(?<=\n\n)(?: {4}.*\n+)+", blanked, code)
    for number, line in enumerate(code.split("\n"), 1):
        if not re.match(r" *(?:\|.*\|$|#|!\[|\[.*\]: |<)", line) and " " in line[:WIDTH].strip() and "](" not in line:
            yield number, line


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_wrap(path):
    """No line of prose is longer than 120 characters, or begins with a percent sign, which MyST reads as a comment."""
    lines = list(prose_lines(path.read_text()))
    long = [number for number, line in lines if len(line) > WIDTH]
    assert long == [], f"{path.relative_to(ROOT)}: lines {long} are longer than {WIDTH} characters"
    assert [number for number, line in lines if line.startswith("%")] == []


def rewrite() -> str | None:
    """Lower the numbers of the table to what is found; a text if one would rise."""
    found, before = counts(), committed() if TABLE.exists() else None
    if before is not None:
        higher = [
            f"{name}: {count} > {before.get(name, 0)}" for name, count in found.items() if count > before.get(name, 0)
        ]
        if higher:
            return "no number is raised: " + ", ".join(higher)
    TABLE.write_text(json.dumps(dict(sorted(found.items())), indent=0) + "\n")
    return None


if __name__ == "__main__":
    sys.exit(rewrite())
