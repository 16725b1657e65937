"""Draws the pictures of docs/gallery.md: each is made by the code below it on the page.

python docs/images/gallery.py [FOLDER]     needs the packages of requirements/dev.txt and data.txt, and Pillow
"""

import ast
import io
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image, ImageOps

PAGE = Path(__file__).parents[1] / "gallery.md"
BLOCK = r"(?:!\[[^\]]*\]\(images/gallery/([^)]*)\){.picture}\n\n)?```python\n(.*?)^```"
COLOURS = 48


def pictures(text: str) -> dict[str, Any]:
    """Objects at the end of the blocks with pictures, by the names of the pictures; blocks run in order."""
    shown, names = {}, {}
    for name, code in re.findall(BLOCK, text, flags=re.M | re.S):
        *lines, last = ast.parse(code).body
        exec(compile(ast.Module([*lines] if name else [*lines, last], []), name or "start", "exec"), names)
        if name:
            shown[name] = eval(compile(ast.Expression(last.value), name, "eval"), names)
    return shown


def write(shown: Any, path: Path) -> None:
    """Write the picture in a notebook, or a figure of matplotlib."""
    if path.suffix == ".svg":
        (drawn,) = re.findall(r"<svg.*?</svg>", shown._repr_html_(), flags=re.S)
        path.write_text(drawn.replace("currentColor", "#222222") + "\n", encoding="utf-8")
        return
    figure = getattr(shown, "figure", shown)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=130, bbox_inches="tight")
    picture = Image.open(buffer).convert("RGB")
    drawn = ImageOps.invert(picture).getbbox()  # 3-D axes have wide margins
    picture.crop(drawn).quantize(COLOURS).save(path, optimize=True)


def main(folder: Path) -> None:
    """Write all pictures into a folder."""
    for name, shown in pictures(PAGE.read_text(encoding="utf-8")).items():
        write(shown, folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "gallery")
