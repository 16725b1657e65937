"""The viewer's pages in tests: a page of two boxes, and what the browser shows of a page."""

import time

from families import translation
from loewner import Body, viewer

# Software rendering on a busy machine takes seconds for what a graphics card does at once.
PATIENCE = 120_000

# Software draws small windows sooner; the panel must leave room for the bodies.
WINDOW = {"width": 1000, "height": 500}


def eventually(condition, seconds=20.0):
    """Wait for the page's own thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the page did not follow"
        time.sleep(0.01)


def two_boxes(**options):
    return viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5), **options)


def shown(tab, name):
    """Wait until the page's bar says so."""
    tab.locator('[data-loewner="verdict"]', has_text=name).wait_for()
    return tab.locator('[data-loewner="verdict"]').inner_text()


def panel(tab):
    """What the page's block of answers says, by row."""
    rows = "() => [...document.querySelectorAll('[data-loewner]')].map(e => [e.dataset.loewner, e.innerText])"
    return dict(tab.evaluate(rows))
