"""The page in a real browser, on the port that was asked for, and gone without a trace when it ends."""

import socket
import threading
from pathlib import Path

import pytest
from page_client import LOCAL, served_small_page
from page_walk import find_layout_faults
from playwright.sync_api import Browser
from reading_clients import open_panel, page_errors
from small_press_simulation import PRESSED, TWIN
from small_sensor import SkinCamera, wait_until

from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.errors import DeviceError
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.studio.page_server import page_server
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.saved_files import SaveQuota

PATIENCE_S = 90.0


def test_a_browser_shows_the_skin_and_its_buttons_reach_the_sensor(
    browser: Browser, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before = set(threading.enumerate())
    camera, tab, asked = SkinCamera(), browser.new_page(viewport={"width": 900, "height": 500}), set()
    errors = page_errors(tab)
    tab.unroute("**/drawn/**")
    tab.set_default_timeout(PATIENCE_S * 1000)
    tab.on("request", lambda request: asked.add(request.url.split("/")[2] if "//" in request.url else ""))
    source = ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0)
    with served_small_page(tmp_path, camera=source, quota=SaveQuota(per_minute=1)) as served:
        sensor, address = served.controller.sensors[0].poller.sensor, f"127.0.0.1:{served.server.port}"

        def until_shown(*texts: str) -> None:
            def shown() -> bool:
                served.refresh()
                said = tab.inner_text("body")
                return all(text in said for text in texts)

            wait_until(shown, PATIENCE_S, pause_s=0.05)

        def images() -> list[str | None]:
            return [image.get_attribute("src") for image in tab.locator("img[src^=blob]").all()]

        tab.goto(f"http://{address}")
        until_shown("live, ", "0.00 mm", "nothing touches")
        banner = "getComputedStyle(document.querySelector('[role=status]'), '::after').content"
        assert tab.evaluate(banner) == "none"
        tab.wait_for_function(f"{banner}.startsWith('\"no news for ')")  # nobody refreshes: the program hangs
        assert not tab.get_by_text("live, ").is_visible()
        until_shown("live, ")
        untouched = images()
        name = tab.locator("[data-moment]").get_attribute("data-moment").split("/")[0]
        wait_until(lambda: served.refresh() and served.server.drawn_moments.last(name) > 2)
        assert len(untouched) == 2 and tab.locator("canvas").count() > 0
        camera.level = 75
        until_shown("live, ", "1.00 mm", "centre at x 0.0, y 0.0 mm")
        assert not set(untouched) & set(images())
        first_reference = sensor.current_depth_reader
        open_panel(tab, "Sensor")
        tab.get_by_role("button", name="Take reference").dispatch_event("click")
        until_shown("live, ", "0.00 mm")
        assert sensor.current_depth_reader is not first_reference
        tab.get_by_role("button", name="Save this reading").dispatch_event("click")
        until_shown("Saved", "5 files in")
        tab.get_by_role("button", name="Save this reading").dispatch_event("click")
        until_shown("Not saved", "at most 1 saves a minute")
        assert len(list(tmp_path.glob("reading_*"))) == 5
        camera.plugged_in = False
        until_shown("no image for ", "unplugged?")
        served.controller.show_final_state(served.page)
    wait_until(lambda: "stopped: the program has ended" in tab.inner_text("body"), PATIENCE_S, pause_s=0.05)
    wait_until(lambda: set(threading.enumerate()) <= before)
    assert errors == [] and caplog.messages == []
    assert asked <= {address, ""}


PLACES = """() => Object.fromEntries([...document.querySelectorAll('button, [role=tab], [role=slider]')]
  .filter(each => !each.closest('.mantine-Notifications-root'))
  .map((each, number) => [`${number} ${each.role || each.getAttribute('role') || ''} ${each.innerText}`,
    ['x', 'y'].map(axis => Math.round(each.getBoundingClientRect()[axis]))]))"""


@pytest.mark.parametrize("size", [(1440, 900), (1280, 720), (390, 844)])
def test_no_control_moves_with_what_is_said_and_nothing_is_cut(
    browser: Browser, tmp_path: Path, size: tuple[int, int]
) -> None:
    camera, tab = SkinCamera(), browser.new_page(viewport={"width": size[0], "height": size[1]})
    tab.set_default_timeout(PATIENCE_S * 1000)
    press = TwinPressController(PressSequence(TWIN, [PRESSED]))
    source = ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0)
    with served_small_page(tmp_path, camera=source, press=press) as served:
        tab.goto(f"http://127.0.0.1:{served.server.port}")

        def places_of_controls(said: str) -> dict[str, list[float]]:
            """Where all controls stand, once the page says something and nothing moves any more."""
            wait_until(lambda: served.refresh() and said in tab.inner_text("body"), PATIENCE_S, pause_s=0.05)
            before, now = {}, tab.evaluate(PLACES)
            while now != before:
                tab.wait_for_timeout(800)
                served.refresh()
                before, now = now, tab.evaluate(PLACES)
            return dict(now)

        alive = places_of_controls("nothing touches")
        tops = [y for name, (x, y) in alive.items() if "tab" in name and (size[0] < 600 or x > size[0] / 2)]
        assert len(tops) >= 4 and max(tops) - min(tops) < 2, "tabs stand in one row"
        notices = [one.bounding_box() for one in tab.locator(".mantine-Notification-root").all()]
        assert all(one["y"] > 0.6 * size[1] for one in notices if one), "they cover neither instructions nor the skin"
        assert find_layout_faults(tab) == []
        cut = "[...document.querySelectorAll('img[src^=blob]')].filter(image => image.getBoundingClientRect().bottom > "
        assert (
            size[0] < 600
            or tab.evaluate(f"{cut} image.closest('.mantine-ScrollArea-root').getBoundingClientRect().bottom).length")
            == 0
        )
        camera.plugged_in = False
        assert places_of_controls("unplugged?") == alive


def test_a_port_in_use_is_refused_and_not_replaced_by_another() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        pytest.raises(DeviceError, match=r"free for the page, got one in use; choose another with --port"),
        page_server(LOCAL, other.getsockname()[1]),
    ):
        pass
