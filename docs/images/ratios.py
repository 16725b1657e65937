"""Draws ratios.svg: how many times as fast as other libraries, from the table of docs/benchmarks.md.

python docs/images/ratios.py [benchmarks.md]

The page includes the picture as a part of itself, so that text and lines have the page's colours in the dark, too.
"""

import re
import sys
import textwrap
from math import log10
from pathlib import Path
from xml.sax.saxutils import escape

# Width of the picture; heights of a question's line, of a rival's line with its bar, and of the gap after a question.
WIDTH, LINE, ROW, GAP, TOP = 545, 19, 31, 12, 26
MARKS = (1, 2, 5, 10, 20, 50, 100)
LETTERS = 57  # that fit in a line


def main() -> None:
    """Write the picture beside this file."""
    page = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "benchmarks.md"
    parts, y = [], float(TOP)
    for question, rows in ratios(page.read_text(encoding="utf-8")):
        for line in textwrap.wrap(question, LETTERS):
            y += LINE
            parts.append(f'<text x="0" y="{y - 5:.0f}" font-weight="bold">{escape(line)}</text>')
        for rival, low, high in rows:
            times = f"{low:g}" if low == high else f"{low:g} to {high:g}"
            parts.append(f'<text x="0" y="{y + 13:.0f}">{escape(rival)}</text>')
            parts.append(f'<text x="{WIDTH}" y="{y + 13:.0f}" text-anchor="end">{times} ×</text>')
            for end, colour in ((high, "#99bbdd"), (low, "#4477aa")):
                bar = f'x="0" y="{y + 18:.0f}" width="{place(end):.0f}" height="8"'
                parts.append(f'<rect {bar} fill="{colour}"/>')
            y += ROW
        y += GAP
    marks = []
    for mark in MARKS:
        anchor = {1: "start", 100: "end"}.get(mark, "middle")
        marks.append(f'<line x1="{place(mark):.0f}" y1="{TOP - 6}" x2="{place(mark):.0f}" y2="{y:.0f}"/>')
        marks.append(f'<text x="{place(mark):.0f}" y="14" text-anchor="{anchor}" stroke="none">{mark}</text>')
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="ratios" viewBox="0 0 {WIDTH} {y:.0f}" role="img" '
        'aria-label="Ratios to other libraries, as in the table of this page" font-family="sans-serif" font-size="16" '
        'fill="currentColor"><g stroke="currentColor" stroke-opacity="0.2">'
    )
    text = "\n".join([head, *marks, "</g>", *parts, "</svg>", ""])
    Path(__file__).with_suffix(".svg").write_text(text, encoding="utf-8")


def place(ratio: float) -> float:
    """Where a ratio is across the picture: logarithms."""
    return WIDTH * log10(ratio) / 2


def ratios(text: str) -> list[tuple[str, list[tuple[str, float, float]]]]:
    """Return each question of the table, and for each rival its name and its smallest and largest ratio.

    A row with an empty first cell belongs to the question above it.
    """
    table = text[text.index("| Question |") :].split("\n\n")[0].splitlines()[2:]
    questions: list[tuple[str, list[tuple[str, float, float]]]] = []
    for line in table:
        question, _, rival, ratio, *_ = (cell.strip().replace("`", "") for cell in line.strip("|").split("|"))
        ends = [float(number) for number in re.findall(r"[\d.]+", ratio)]
        if question:
            questions.append((question, []))
        questions[-1][1].append((rival, ends[0], ends[-1]))
    return questions


if __name__ == "__main__":
    main()
