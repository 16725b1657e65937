"""Chromium for tests of what people see; tests are skipped where it is missing, unless LOEWNER_BROWSER=required."""

import os
import shutil
from contextlib import contextmanager

import pytest

REQUIRED = os.environ.get("LOEWNER_BROWSER") == "required"


def missing(what):
    """Skip a test for want of something, or fail it where browsers are required."""
    if REQUIRED:
        pytest.fail(f"{what}; LOEWNER_BROWSER=required asks for it (.ci/run installs it where it can)")
    pytest.skip(what)


@contextmanager
def chromium(**options):
    """Start Chromium without a window."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("no playwright: pip install -r requirements/dev.txt")
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        missing("no Chromium: apt-get install chromium")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, headless=True, **options)
        yield browser
        browser.close()
