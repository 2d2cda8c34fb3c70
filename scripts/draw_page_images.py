"""Take the pictures of the page in docs/images in a browser without a window: `make docs-images`.

Each command is started as a person starts it, and its page is used as a person uses it. With --sensor the twin of that sensor is
pressed, without it that of the published design, which is calibrated first.
"""

import re
import shutil
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory

import cv2
import trimesh
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, sync_playwright

import ninedtact

sys.path.insert(0, str(Path(__file__).parents[1] / "packages/ninedtact/tests/capture"))
from mjpeg_camera import MjpegCamera

IMAGES = Path(__file__).parents[1] / "docs" / "images"
MOST_BYTES = 150_000
DESK, WIDE_DESK, PHONE = (1360, 860), (1480, 900), (390, 844)
TALL_PX = 940
"""Height of a window that shows all checks of a certificate."""
PATIENCE_MS = 300_000
SETTLE_MS = 4000
"""Time for a browser without a graphics card to draw what has arrived."""
CURVES_MS = 20_000
"""Time over which curves show what has happened."""
SOFTWARE_GRAPHICS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
HIDE_NOTICES = ".mantine-Notifications-root { display: none !important; }"


class Visitor:
    """One browser on a page, with what a person does there."""

    def __init__(self, browser: Browser, address: str, size: tuple[int, int] = DESK) -> None:
        self.tab: Page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.tab.set_default_timeout(PATIENCE_MS)
        self.tab.goto(address)

    def until_shown(self, *texts: str) -> None:
        """Wait until the page shows texts, all at the same time."""
        shown = "texts => texts.every(text => document.body.innerText.includes(text))"
        self.tab.wait_for_function(shown, arg=list(texts), timeout=PATIENCE_MS)

    def press(self, name: str) -> None:
        """Press a button."""
        self.tab.get_by_role("button", name=name, exact=True).first.dispatch_event("click")

    def open_tab(self, name: str) -> None:
        """Open a panel by its tab, which reacts to the mouse alone."""
        label = self.tab.get_by_role("tab", name=name)
        label.evaluate("label => label.scrollIntoView({block: 'center'})")
        box = label.bounding_box()
        assert box is not None
        self.tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def type(self, label: str, value: str) -> None:
        """Type a value into the field of a label."""
        field = self._field(label)
        field.fill(value)
        field.press("Enter")

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a menu."""
        self._field(label).click()
        self.tab.get_by_role("option", name=option).first.click()

    def take(self, name: str, *texts: str) -> None:
        """Write a picture of the page, scrolled to its top, into docs/images while it shows texts; exits where it is too large."""
        self.tab.add_style_tag(content=HIDE_NOTICES)
        self.tab.evaluate("document.querySelectorAll('*').forEach(each => { each.scrollTop = 0; })")
        self.tab.wait_for_timeout(SETTLE_MS)
        shown = Image.open(BytesIO(self._screenshot_with(texts))).convert("RGB")
        path = IMAGES / f"{name}.png"
        _with_few_colours(shown).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)
        if path.stat().st_size > MOST_BYTES:
            sys.exit(f"expected {path} to be at most {MOST_BYTES / 1e3:.0f} kB, got more; make the window smaller")

    def _screenshot_with(self, texts: tuple[str, ...]) -> bytes:
        """Return a picture before and after which the page shows texts, which a busy computer changes meanwhile."""
        while True:
            self.until_shown(*texts)
            picture = self.tab.screenshot()
            if all(text in self.tab.inner_text("body") for text in texts):
                return picture

    def _field(self, label: str) -> Locator:
        named = self.tab.locator(f"label:text-is('{label}')").first
        return named.locator("xpath=ancestor::*[.//input][1]//input[not(@type='hidden')]").last


def _with_few_colours(shown: Image.Image) -> Image.Image:
    """Return an image of 256 colours: the usual ones of its areas, and some of all hues that occur, which lines and text have."""
    usual = shown.quantize(192, method=Image.Quantize.MEDIANCUT).getpalette() or []
    rare = shown.quantize(64, method=Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(usual[: 192 * 3] + rare[: 64 * 3])
    return shown.quantize(palette=palette, dither=Image.Dither.NONE)


@contextmanager
def page_of(folder: Path, *command: str) -> Iterator[str]:
    """Run a command that serves a page in a folder, and yield the address of it."""
    words = [sys.executable, "-m", "ninedtact", *command, "--port", "0"]
    running = subprocess.Popen(words, stdout=PIPE, text=True, cwd=folder)
    assert running.stdout is not None
    try:
        address = next(found[1] for line in running.stdout if (found := re.search(r"open (\S+) in a browser", line)))
        yield address
    finally:
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=60)


def calibrate_twin(out: Path) -> Path:
    """Calibrate the twin of the published design from its own images."""
    from ninedtact.calibration.procedure import CalibrationImages, calibrate
    from ninedtact.calibration.save import save_sensor
    from ninedtact.simulation.calibration_images import simulate_calibration_images
    from ninedtact.simulation.twin import default_twin

    images = CalibrationImages(**vars(simulate_calibration_images(default_twin(), frames=8)))
    return save_sensor(out, calibrate(images, sensor_id="twin")).path


def take_live_pages(browser: Browser, folder: Path) -> None:
    """Press the twin by hand; record it and open the recording."""
    with page_of(folder, "live", "--sensor", "my_sensor", "--source", "sim", "--force", "physics") as address:
        desk = Visitor(browser, address)
        desk.until_shown("estimated")
        desk.type("depth (mm)", "1.1")
        desk.until_shown("1.10 mm deep")
        desk.type("drag x (mm)", "1.6")
        desk.until_shown("slips")
        desk.take("twin_page", "live, ")
        desk.open_tab("Record")
        desk.press("Record")
        desk.until_shown("Stop recording")
        desk.tab.wait_for_timeout(SETTLE_MS)
        desk.press("Stop recording")
        desk.until_shown("recorded recording_")
        desk.open_tab("View")
        desk.choose("image 1", "gel flow, orange and blue")
        desk.choose("image 2", "pressure")
        desk.choose("surface colouring", "pressure")
        desk.tab.get_by_label("shear as arrows").check()
        desk.take("page_views", "live, ")
        desk.tab.close()
        phone = Visitor(browser, address, PHONE)
        phone.until_shown("live, ")
        phone.take("twin_page_phone", "live, ")
        phone.tab.close()
    (recording,) = (folder / "readings").glob("recording_*.mcap")
    with page_of(folder, "play", str(recording)) as address:
        desk = Visitor(browser, address)
        desk.until_shown("recorded, ")
        desk.open_tab("Record")
        desk.type("time (s)", "3")
        desk.take("recording_page", "recorded, ")
        desk.tab.close()
        phone = Visitor(browser, address, PHONE)
        phone.until_shown("recorded, ")
        phone.take("recording_page_phone", "recorded, ")
        phone.tab.close()


def take_state_pages(browser: Browser, folder: Path) -> None:
    """A page that is frozen, dark with a profile, pressed with one's own mesh, exported, and one whose camera is lost."""
    mesh = folder / "hex_nut.stl"
    trimesh.creation.annulus(3.0, 6.0, 4.0, sections=6).export(mesh)
    with page_of(folder, "live", "--sensor", "my_sensor", "--source", "sim", "--force", "physics") as address:
        desk = Visitor(browser, address)
        desk.until_shown("estimated")
        desk.tab.locator("input[type=file]").first.set_input_files(mesh)
        desk.until_shown("hex_nut, 0.60 mm deep")
        desk.take("page_own_mesh", "live, ")
        desk.press("Freeze")
        desk.type("depth (mm)", "0.2")  # the object moves, what is shown does not
        desk.take("page_frozen", "frozen: ")
        desk.press("Resume")
        desk.until_shown("0.20 mm deep")
        desk.type("depth (mm)", "0.7")
        desk.until_shown("0.70 mm deep")
        desk.open_tab("Record")
        desk.press("This moment as a web page")
        desk.tab.wait_for_timeout(SETTLE_MS)
        desk.open_tab("View")
        desk.tab.get_by_role("checkbox", name="dark", exact=True).check()
        desk.open_tab("Profile")
        desk.tab.get_by_role("checkbox", name="line on the skin", exact=True).check()
        desk.take("page_dark_profile", "live, ")
        desk.tab.close()
    (moment,) = (folder / "readings").glob("moment_*.html")
    exported = Visitor(browser, moment.as_uri())
    exported.until_shown("indentation")
    exported.take("exported_moment")
    exported.tab.close()
    live = ("live", "--sensor", "my_sensor", "--force", "physics", "--source")
    with TwinOnNetwork(folder / "my_sensor") as camera, page_of(folder, *live, camera.url) as address:
        desk = Visitor(browser, address)
        desk.until_shown("live, ")
        camera.unplug()
        desk.take("page_camera_lost", "no image for ")
        desk.tab.close()


class TwinOnNetwork(MjpegCamera):
    """A network camera that sends images of a sensor's untouched twin until it is unplugged."""

    def __init__(self, sensor: Path) -> None:
        super().__init__(period_s=0.05)
        self._render = ninedtact.load_sensor(sensor).twin().renderer

    def jpegs(self) -> Iterator[bytes]:
        """Yield images that differ by their noise."""
        while self.plugged_in.is_set():
            image = self._render(None, self.served)
            yield cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 98))[1].tobytes()
            self.served += 1
            time.sleep(self.period_s)


def take_gripper_page(browser: Browser, folder: Path) -> None:
    """Close two twins on a ball, which is dragged."""
    sensors = ("--sensor", "left=my_sensor", "right=my_sensor", "--source", "left=sim", "right=sim")
    with page_of(folder, "live", *sensors, "--force", "physics") as address:
        desk = Visitor(browser, address, WIDE_DESK)
        desk.until_shown("grip force left and right, estimated")
        desk.choose("kind", "primitives")
        desk.type("depth (mm)", "0.8")
        desk.until_shown("0.80 mm deep")
        desk.type("drag x (mm)", "1.5")
        desk.until_shown("slips")
        desk.tab.wait_for_timeout(CURVES_MS)
        desk.take("gripper_page", "left: live, ", "right: live, ")
        desk.tab.close()


def take_calibration_pages(browser: Browser, folder: Path) -> None:
    """Calibrate a simulated sensor on the page, with a board that is held badly at first."""
    with page_of(folder, "calibrate", "--page", "--source", "sim", "--out", "new_sensor") as address:
        desk, phone = Visitor(browser, address), Visitor(browser, address, PHONE)
        desk.until_shown("Choose the camera")
        phone.take("calibration_page_camera")
        desk.tab.get_by_label("press automatically").uncheck()
        desk.press("Start")
        desk.until_shown("Press the pin board")
        desk.press("board")
        desk.until_shown("the board is held")
        desk.type("tilt about x (°)", "3.5")
        desk.type("depth (mm)", "0.45")
        desk.until_shown("missing, crossed in the image")
        desk.take("calibration_page")
        desk.tab.get_by_label("press automatically").check()
        desk.until_shown("Press the ball")
        phone.take("calibration_page_phone")
        shutil.copytree(folder / "my_sensor", folder / "new_sensor")  # another sensor appears at the folder to write
        desk.until_shown("This calibration is refused.")
        desk.take("calibration_page_refused")
        desk.tab.get_by_label("replace the sensor").check()
        desk.press("Calibrate again from the images")
        desk.until_shown("Saved in")
        desk.tab.set_viewport_size({"width": DESK[0], "height": TALL_PX})
        desk.take("calibration_result_page", "This sensor is ready to measure.")
        desk.tab.close()
        phone.tab.close()


def take_force_calibration_pages(browser: Browser, folder: Path) -> None:
    """Calibrate the force of a twin with known loads."""
    with page_of(folder, "adapt", "--sensor", "my_sensor", "--page", "--source", "sim") as address:
        desk, phone = Visitor(browser, address), Visitor(browser, address, PHONE)
        desk.until_shown("Choose the camera")
        desk.press("Start")
        desk.until_shown("with 200 g")
        desk.tab.get_by_label("load automatically").uncheck()
        desk.until_shown("nothing touches")
        desk.type("place of the ball, x (mm)", "5")
        desk.type("load on the ball (g)", "200")
        desk.until_shown("press in the middle")
        phone.take("force_calibration_phone")
        desk.tab.get_by_label("load automatically").check()
        desk.until_shown("with 400 g")
        desk.tab.get_by_label("load automatically").uncheck()
        desk.take("force_calibration_page")
        desk.tab.close()
        phone.tab.close()


def main() -> None:
    """Take all pictures, or those that are named."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--sensor", type=Path, help="sensor folder whose twin is pressed")
    parser.add_argument(
        "--only", choices=("live", "states", "gripper", "calibrate", "adapt"), help="take these pictures alone"
    )
    options = parser.parse_args()
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        sys.exit(f"expected a browser ({', '.join(names)}), got none; install Debian's package chromium")
    with TemporaryDirectory() as scratch, sync_playwright() as player:
        browser = player.chromium.launch(executable_path=found, args=list(SOFTWARE_GRAPHICS))
        sensor = options.sensor or calibrate_twin(Path(scratch) / "twin")
        shutil.copytree(sensor, Path(scratch) / "my_sensor")
        if options.only in (None, "live"):
            take_live_pages(browser, Path(scratch))
        if options.only in (None, "states"):
            take_state_pages(browser, Path(scratch))
        if options.only in (None, "gripper"):
            take_gripper_page(browser, Path(scratch))
        if options.only in (None, "calibrate"):
            take_calibration_pages(browser, Path(scratch))
        if options.only in (None, "adapt"):
            take_force_calibration_pages(browser, Path(scratch))
        browser.close()


if __name__ == "__main__":
    main()
