"""Prose is plain: no file gains a sentence of the ten kinds that CONTRIBUTING.md lists.

The law: the count of these patterns in a file never rises. Sentences with five or more numbers and paragraphs of more
than 110 words count as well. `tests/prose_counts.json` holds the counts; files without a pattern are left out. When a
file has become plainer, the table is stale: `python tests/test_prose.py` rewrites it and refuses to raise a number.
Regular expressions find the patterns, so a count includes a few good sentences. Only its direction has a meaning.
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
NATIVE = [path for path in (ROOT / "native").rglob("*") if path.suffix in (".c", ".h", ".py")]
SOURCES = sorted([*(ROOT / "src" / "loewner").rglob("*.py"), *NATIVE])
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
MOST_NUMBERS, MOST_WORDS = 4, 110  # of a sentence, and of a paragraph


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
            shown = "\n".join(text.split("\n")[string.lineno - 1 : string.end_lineno])
            shown = re.sub(r"^ *>>>.*(?:\n.*\S.*)*", blanked, shown, flags=re.M)  # with their output
            lines[string.lineno - 1 : string.end_lineno] = shown.split("\n")
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            is_alone = token.line.lstrip().startswith("#")
            lines[token.start[0] - 1] = token.string.lstrip("# ") + ("" if is_alone else ".")
    return re.sub(r"`[^`]*`", blanked, "\n".join(lines), flags=re.S)


def c_text(text: str) -> str:
    """Comments of a C file in their place, each with an end like that of a sentence."""
    comments = re.sub(r"(?:\A|\*/).*?(?:/\*|\Z)", lambda code: "." + blanked(code)[1:], text, flags=re.S)
    return re.sub(r"`[^`]*`", blanked, comments, flags=re.S)


def paragraphs(text: str, is_page: bool) -> Iterator[tuple[int, str]]:
    """First lines and words of paragraphs: of the items of a list, and in sources of lines with one indentation."""
    words, first, before = list[str](), 0, 0
    for number, line in enumerate([*text.split("\n"), ""], 1):
        shown = line.strip()
        indentation = len(line) - len(line.lstrip())
        is_prose = bool(shown) and not re.match(r"[|#:]|---", shown)
        is_other = not is_prose or re.match(r"[-*] |\d+\. ", shown) or (not is_page and indentation != before)
        if words and is_other:
            yield first, " ".join(words)
            words = []
        if is_prose:
            first = first if words else number
            words += shown.split()
        before = indentation


def crowded(text: str, is_page: bool) -> Iterator[tuple[int, str, str]]:
    """Line, kind and first words of sentences with too many numbers, and of paragraphs with too many words."""
    for line, paragraph in paragraphs(text, is_page):
        for sentence in re.split(r"(?<=[.!?])\s+", paragraph):
            if len(re.findall(r"(?<![\w.^-])\d[\d,.]*", sentence)) > MOST_NUMBERS:
                yield line, "many numbers", sentence[:60]
        if len(paragraph.split()) > MOST_WORDS:
            yield line, "long paragraph", paragraph[:60]


def text_of(path: Path) -> str:
    """The prose of a file."""
    return {".md": page_text, ".py": source_text}.get(path.suffix, c_text)(path.read_text())


@functools.cache
def matches(path: Path) -> list[tuple[int, str, str]]:
    """Line, kind and words of each pattern in a file."""
    text = text_of(path)
    found = [
        (text.count("\n", 0, match.start()) + 1, name, " ".join(match[0].split()))
        for name, pattern in FOUND.items()
        for match in pattern.finditer(text)
    ]
    return sorted([*found, *crowded(text, path.suffix == ".md")])


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
    comment = c_text('/* What is free. */ int what_is = 1; /* `what is` that of b */ char *a = "what is";\n')
    assert [len(FOUND[name].findall(comment)) for name in ("clause as a noun", "those of")] == [1, 1]


def test_crowded_sentences_and_paragraphs_are_found():
    """Five numbers in one sentence, not in two, in a table or in code; and 111 words, not in two items of a list."""
    many = "It takes 1, 2, 3.5, 4,000 and 5 s."
    words = "word " * 60
    for text, kinds in (
        (many, ["many numbers"]),
        ("It takes 1, 2 and\n3 s. Or 4 and 5 s in B6 and v7.", []),
        (f"| {many} |\n\n    {many}\n", []),
        (f"{words}\n{words}", ["long paragraph"]),
        (f"- {words}\n- {words}\n\n{words}", []),
    ):
        assert [kind for _, kind, _ in crowded(page_text(f"\n\n{text}"), is_page=True)] == kinds
    for text, found in ((f"/* {many} */ 6 /* 7 */", 1), ("a(1, 2); /* 3 */ b(4) /* 5 and 6 */", 0)):
        assert len(list(crowded(c_text(text), is_page=False))) == found
    assert (
        list(crowded(source_text(f'"""Free.\n\n>>> a\n{many}\n"""\na = 1  # 2, 3\nb = 4  # 5, 6 and 7\n'), False)) == []
    )


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
