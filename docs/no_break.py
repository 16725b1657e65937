"""A number and its unit stay on one line: the space between them becomes one that does not break."""

import re

from docutils import nodes
from sphinx.transforms.post_transforms import SphinxPostTransform

UNITS = "% ° µs ms ns s min h m mm cm µm nm km rad mrad kB MB GB KiB MiB GiB bytes Hz kHz GHz kg N px"
UNITS += " rad/s m/s rad/s² m/s²"
SPACE = re.compile(rf"(?<=\d)[ \n](?=(?:{'|'.join(sorted(UNITS.split(), key=len, reverse=True))})(?![\w/]))")
KEPT = (nodes.literal, nodes.FixedTextElement, nodes.raw, nodes.math)


class NoBreak(SphinxPostTransform):
    """Replace these spaces in all text but code."""

    default_priority = 900

    def run(self, **kwargs: object) -> None:
        """Join the lines of each text, which are separate nodes, and look at the whole."""
        for element in list(self.document.findall(nodes.TextElement)):
            if isinstance(element, KEPT):
                continue
            children: list[nodes.Node] = []
            for child in element.children:
                if isinstance(child, nodes.Text) and children and isinstance(children[-1], nodes.Text):
                    children[-1] = nodes.Text(children[-1] + child)
                else:
                    children.append(child)
            element.children = []
            element += [nodes.Text(SPACE.sub("\u00a0", x)) if isinstance(x, nodes.Text) else x for x in children]
