"""The live page is tested in a real browser, on the bench devices of the capture room and the known skins of the shape room."""

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

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


@pytest.fixture
def browser() -> Iterator[Browser]:
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        pytest.skip(f"expected a browser ({', '.join(names)}), got none; install Debian's package chromium")
    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=found, args=WITHOUT_GRAPHICS_CARD)
        yield browser
        browser.close()
