"""Take pictures of a page with a headless browser."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from loewner._base import _validate
from loewner._base._files import write_atomically
from loewner.errors import FileError, InputError, MissingExtraError, imported
from loewner.viewer.page import Viewer

# The system's browsers, which are preferred to Playwright's own, and options for drawing without a graphics card.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

# Longest wait for the page to be drawn, and the pause after the page's last message [ms].
PATIENCE, SETTLED = 60_000, 3_000


def save_screenshot(page: Viewer, path: str | os.PathLike[str], *, width: int = 1280, height: int = 720) -> None:
    """Save a picture of an open page as a browser shows it, without the handles for dragging bodies.

    Parameters
    ----------
    page : PairViewer or RobotViewer
        An open page.
    path : path
        A path that ends in ``.png``. An existing file is replaced.
    width, height : int
        Size of the browser's window, in pixels.

    Raises
    ------
    InputError
        If the path does not end in ``.png``, or a size is outside 200 to 4,000 pixels.
    MissingExtraError
        If Playwright, or a browser that it can use, is not installed.
    FileError
        If the page was not drawn within a minute, or the file cannot be written.

    Examples
    --------
    >>> from loewner import Body, viewer
    >>> page = viewer.show_pair(Body.box([1, 1, 1]), None, Body.sphere(0.5), None, block=False)
    >>> page.close()
    >>> viewer.save_screenshot(page, "picture.jpg")
    Traceback (most recent call last):
        ...
    loewner.errors.InputError: path: expected a name that ends in .png, found picture.jpg
    """
    if not isinstance(page, Viewer):
        raise InputError(f"page: expected an open page of loewner.viewer, found {_validate.short(page)}")
    file = _validate.path(path, "path")
    if file.suffix.lower() != ".png":
        raise InputError(f"path: expected a name that ends in .png, found {file}")
    sizes = {"width": width, "height": height}
    for name, size in sizes.items():
        if isinstance(size, bool) or not isinstance(size, int) or not 200 <= size <= 4000:
            raise InputError(f"{name}: expected pixels from 200 to 4000, found {_validate.short(size)}")
    playwright = imported("playwright.sync_api", "screenshots need Playwright", "screenshots")
    # Use a separate thread, since Playwright refuses a thread that runs an event loop, as the caller's thread does in a
    # notebook.
    with ThreadPoolExecutor(1) as thread, page._without_gizmos():
        picture = thread.submit(_picture, page.url, sizes, playwright.sync_playwright, playwright.Error).result()
    write_atomically(file, picture)


def _picture(url: str, sizes: dict[str, int], start: Any, error: type[Exception]) -> bytes:
    with start() as driver:
        browser = _browser(driver, error)
        try:
            tab = browser.new_page(viewport=sizes)
            tab.goto(url, timeout=PATIENCE)
            tab.locator('[data-loewner="verdict"]').wait_for(timeout=PATIENCE)
            tab.add_style_tag(content=".mantine-Notification-root { display: none }")  # warnings about slow drawing
            tab.wait_for_timeout(SETTLED)
            return bytes(tab.screenshot(timeout=PATIENCE))
        except error as found:
            raise FileError(f"{url}: expected a page that is drawn, found {str(found).splitlines()[0]}") from None
        finally:
            browser.close()


def _browser(driver: Any, error: type[Exception]) -> Any:
    """Start a browser of the system, or Playwright's own."""
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    flags = list(FLAGS)
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        flags.append("--no-sandbox")  # with a sandbox, Chromium does not start for root
    try:
        return driver.chromium.launch(executable_path=path, args=flags)
    except error as found:
        why = str(found).splitlines()[0]
        raise MissingExtraError(f"screenshots need a browser: playwright install chromium ({why})") from None
