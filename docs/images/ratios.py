"""Draws ratios.svg: how many times as fast as other libraries, from the table of README.md.

python docs/images/ratios.py [README.md]
"""

import re
import sys
from math import log10
from pathlib import Path
from xml.sax.saxutils import escape

LEFT, ACROSS, ROW, TOP = 440, 420, 22, 46  # of the bars, in pixels
MARKS = (1, 2, 5, 10, 20, 50, 100)


def main() -> None:
    """Write the picture beside this file."""
    readme = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "README.md"
    bars = ratios(readme.read_text(encoding="utf-8"))
    height = TOP + sum(ROW * len(rows) + 10 for _, rows in bars)
    parts, y = [], float(TOP)
    for mark in MARKS:
        x = place(mark)
        parts.append(f'<line x1="{x:.0f}" y1="{TOP - 10}" x2="{x:.0f}" y2="{height}" stroke="#dddddd"/>')
        parts.append(f'<text x="{x:.0f}" y="{TOP - 16}" text-anchor="middle">{mark}</text>')
    parts.append(f'<text x="{LEFT + ACROSS / 2:.0f}" y="14" text-anchor="middle">times as fast as</text>')
    for question, rows in bars:
        parts.append(f'<text x="{LEFT - 12}" y="{y + 14:.0f}" text-anchor="end">{escape(question)}</text>')
        for rival, low, high in rows:
            for end, colour in ((high, "#99bbdd"), (low, "#4477aa")):
                width = place(end) - LEFT
                parts.append(
                    f'<rect x="{LEFT}" y="{y + 3:.0f}" width="{width:.0f}" height="{ROW - 8}" fill="{colour}"/>'
                )
            parts.append(f'<text x="{place(high) + 8:.0f}" y="{y + 14:.0f}">{escape(rival)}</text>')
            y += ROW
        y += 10
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1180 {height}" width="1180" '
        'font-family="sans-serif" font-size="13" fill="#333333"><rect width="100%" height="100%" fill="#ffffff"/>'
    )
    Path(__file__).with_suffix(".svg").write_text(head + "\n".join(parts) + "</svg>\n", encoding="utf-8")


def place(ratio: float) -> float:
    """Where a ratio is across the picture: logarithms."""
    return LEFT + ACROSS * log10(ratio) / 2


def ratios(text: str) -> list[tuple[str, list[tuple[str, float, float]]]]:
    """Of each row of the table the question, and each rival with its least and largest ratio."""
    table = text[text.index("| Question |") :].split("\n\n")[0].splitlines()[2:]
    found = []
    for line in table:
        question, _, named, ratio, *_ = (cell.strip().replace("`", "") for cell in line.strip("|").split("|"))
        rows = []
        for rival, numbers in zip(named.split(";"), ratio.split(";"), strict=True):
            ends = [float(number) for number in re.findall(r"[\d.]+", numbers)]
            rows.append((rival.strip(), ends[0], ends[-1]))
        found.append((question, rows))
    return found


if __name__ == "__main__":
    main()
