"""The live page is tested in a real browser, on the bench devices of the capture room and the known skins of the shape room."""

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

for room in ("capture", "shape", "simulation"):
    sys.path.append(str(Path(__file__).parents[1] / room))

WITHOUT_GRAPHICS_CARD = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

DRAW_RARELY = (
    "const draw = requestAnimationFrame.bind(window); "
    "window.requestAnimationFrame = (frame) => draw(() => setTimeout(() => draw(frame), 200));"
)
"""Lets pages draw about four frames a second: without a graphics card, a frame of the 3D view takes the processor from all else."""


TOLD_MOMENTS = "**/drawn/**"


@pytest.fixture(scope="module")
def started_browser() -> Iterator[Browser]:
    """One browser for all tests of a file."""
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        pytest.skip(f"expected a browser ({', '.join(names)}), got none; install Debian's package chromium")
    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=found, args=WITHOUT_GRAPHICS_CARD)
        open_page = browser.new_page

        def open_calm_page(**options: Any) -> Page:
            page = open_page(**options)
            page.add_init_script(DRAW_RARELY)
            # Such a page would be sent a moment every second. Only a test of just that lets it tell what it has drawn.
            page.route(TOLD_MOMENTS, lambda route: route.abort())
            return page

        browser.new_page = open_calm_page  # type: ignore[method-assign]
        yield browser
        browser.close()


@pytest.fixture
def browser(started_browser: Browser) -> Iterator[Browser]:
    """The browser, whose pages are closed after each test."""
    yield started_browser
    for context in started_browser.contexts:
        context.close()
