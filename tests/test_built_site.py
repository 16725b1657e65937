"""The built site: short ways, readable links, text that keeps together, no fault of accessibility, no foreign request.

`make test-docs` builds the site and names its folder in LOEWNER_SITE; without this variable the tests are skipped. They
also take screenshots, into the folder `screenshots` beside the site.
"""

import os
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urldefrag

import pytest

from browsers import chromium, missing

SITE = Path(os.environ.get("LOEWNER_SITE", "nowhere")).resolve()
pytestmark = pytest.mark.skipif("LOEWNER_SITE" not in os.environ, reason="make test-docs builds the site")

# Pages in a browser, and the sizes of its window.
SHOWN = [
    "index",
    "gallery",
    "benchmarks",
    "motions",
    "verdicts",
    "howto/gradients",
    "howto/first-use",
    "howto/two-robots",
]
SHOWN += ["reference/queries", "sections/robots", "howto/mobile-bases", "howto/sensor-data", "howto/covers"]
SHOWN += ["howto/judge", "howto/questions", "howto/limits", "assumptions", "answers/drake-24964"]
WIDTHS = (1280, 400)

# What people look for: words that links to it contain, and the page.
SOUGHT = {
    "plan to a pose": ("pose", "howto/inverse-kinematics.html"),
    "two robots": ("two robots", "howto/two-robots.html"),
    "a point cloud": ("point cloud", "howto/sensor-data.html"),
    "gradients": ("gradient", "howto/gradients.html"),
    "what FREE means": ("free means", "verdicts.html"),
    "how fast beside Coal": ("coal", "benchmarks.html"),
}

UNITS = r"(?:%|µs|ms|ns|s|m|mm|cm|µm|rad|kB|MB|GB)"


class Page(HTMLParser):
    """Links of a page with their texts, and its text without code."""

    UNREAD = frozenset({"pre", "code", "script", "style", "svg"})

    def __init__(self, html):
        super().__init__()
        self.links, self.text, self.within, self.target = [], [], 0, None
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.within += tag in self.UNREAD
        if tag == "a":
            self.target, self.words = dict(attrs).get("href", ""), []

    def handle_endtag(self, tag):
        self.within -= tag in self.UNREAD
        if tag == "a" and self.target is not None:
            self.links.append((" ".join("".join(self.words).split()), self.target))
            self.target = None

    def handle_data(self, data):
        if self.target is not None:
            self.words.append(data)
        if not self.within:
            self.text.append(data)


@cache
def pages():
    """All pages that are written by hand or made from docstrings, by their path on the site."""
    found = {path.relative_to(SITE).as_posix(): Page(path.read_text()) for path in SITE.rglob("*.html")}
    assert len(found) > 50
    return found


def leads_to(name):
    """Links of a page to other pages of the site: text and page."""
    for words, target in pages()[name].links:
        address = urldefrag(target)[0]
        if address and ":" not in address:
            page = os.path.normpath(os.path.join(os.path.dirname(name), address))
            if page in pages():
                yield words.lower(), page


@pytest.mark.parametrize("sought", SOUGHT)
def test_two_clicks_lead_to_what_people_look_for(sought):
    """From the front page, at most two links lead there, and the text of the last one contains the words."""
    words, page = SOUGHT[sought]
    near = {"index.html"} | {target for _, target in leads_to("index.html")}
    assert any(words in text and target == page for start in near for text, target in leads_to(start))


def test_links_have_titles():
    """No text of a link is the name of a source file of a page."""
    named = [(page, text) for page, found in pages().items() for text, _ in found.links if re.search(r"\w\.md\b", text)]
    assert named == []


def test_few_entries_stand_in_the_sidebar():
    """The first level has a dozen entries at most, and each of the other pages is below one that opens."""
    html = (SITE / "index.html").read_text()
    tree = html[html.index('class="sidebar-tree"') :].split("</div>\n</div>")[0]
    assert 5 < len(re.findall(r'<li class="toctree-l1', tree)) <= 12
    assert len(re.findall(r'<li class="toctree-l1[^"]*has-children', tree)) > 5


def test_numbers_keep_their_units():
    """No line breaks between a number and its unit."""
    loose = re.compile(rf"\d[ \n]{UNITS}(?![\w/])")
    broken = [(page, found) for page, read in pages().items() for found in loose.findall(" ".join(read.text))]
    assert broken == [], broken


# -- in a browser -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser():
    """Chromium, and axe's checks as a function of a page."""
    try:
        from axe_playwright_python.sync_playwright import Axe
    except ImportError:
        missing("no axe: pip install -r requirements/dev.txt")
    with chromium(args=["--no-sandbox"], ignore_default_args=["--hide-scrollbars"]) as browser:
        yield browser, Axe()


# Code whose column cuts it off without a bar to scroll it, and pages that are wider than the window.
CUT_OFF = """() => {
  const cut = [...document.querySelectorAll('article pre')].filter(pre => {
    if (pre.scrollWidth <= pre.clientWidth + 1) return false;
    return getComputedStyle(pre).overflowX !== 'auto' || pre.offsetHeight - pre.clientHeight < 5;
  });
  return [cut.length, document.documentElement.scrollWidth - window.innerWidth];
}"""


# Until a page has loaded [s]: half a minute, Playwright's own, is too short on a busy machine.
LONGEST_WAIT = 300


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_pages_can_be_read_by_all(browser, width, scheme):
    """axe finds no fault; no code is cut off without a bar; the page fits the window; nothing foreign is loaded."""
    opened, axe = browser
    page = opened.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.set_default_timeout(1000 * LONGEST_WAIT)
    requests, faults = [], []
    page.on("request", lambda request: requests.append(request.url))
    for name in SHOWN:
        page.goto((SITE / f"{name}.html").as_uri())
        found = axe.run(page, options={"resultTypes": ["violations"]}).response["violations"]
        faults += [(name, fault["id"], fault["nodes"][0]["html"][:200]) for fault in found]
        cut, wider = page.evaluate(CUT_OFF)
        faults += [(name, "code is cut off")] * (cut > 0) + [(name, f"{wider} pixels too wide")] * (wider > 0)
        picture = SITE.parent / "screenshots" / f"{name.replace('/', '-')}-{width}-{scheme}.png"
        page.screenshot(path=picture)
    page.close()
    assert faults == [], "\n".join(map(str, faults))
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []


def test_each_page_has_a_twin_in_markdown():
    """llms.txt lists the pages, and each link in it leads to a file."""
    links = re.findall(r"\]\((.+?)\)", (SITE / "llms.txt").read_text())
    assert len(links) > 80
    assert [link for link in links if not (SITE / link).is_file()] == []
