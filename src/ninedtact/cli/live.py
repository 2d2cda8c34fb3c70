"""ninedtact live: a sensor in the browser, as it is touched."""

import sys
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.capture.source import FrameSource
    from ninedtact.sensor import Sensor
    from ninedtact.shape.calibrated import CalibratedShape

FASTEST_SCREEN_HZ = 120.0


class StudioMissing(NinedtactError):
    """The library that serves the page is not installed."""


class LiveImpossible(NinedtactError):
    """An option with a value that no page can have."""


@dataclass(frozen=True)
class Live:
    """Watch a sensor in the browser: camera picture, heights, 3D surface, rates and costs. Ctrl-C ends it."""

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote."""
    source: str
    """Camera (0, /dev/video0, csi:0), stream (http://…, rtsp://…), video file or folder of pictures."""
    reference: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Untouched skin of this session; given more than once, the pictures are averaged. Without any, the first pictures
    of the source are the untouched skin."""
    out: Path = Path("readings")
    """Folder for the readings that are saved from the page."""
    automatic: bool = False
    """Leave the camera's automatic exposure and white balance on, for one that cannot switch them off; heights then drift."""
    loop: bool = False
    """Play a recording again and again. Without it, its last picture stays."""
    display_hz: float = 15.0
    """Readings shown per second at most; the sensor is read as fast as it delivers."""
    host: str = "127.0.0.1"
    """Address to serve the page on. With 0.0.0.0 everybody on the network can look and press the buttons."""
    port: int = 8080
    """Port to serve the page on."""

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        require_studio()
        from ninedtact.calibration.sensor_folder import load_sensor
        from ninedtact.studio.loop import SensorLoop
        from ninedtact.studio.page import Page
        from ninedtact.studio.ruler import block_under
        from ninedtact.studio.server import serving
        from ninedtact.studio.studio import Studio

        self.require_rate()
        folder = load_sensor(self.sensor)
        sensor = self.sensor_at_source(folder.shape)
        with suppress(KeyboardInterrupt), serving(self.host, self.port) as server, SensorLoop(sensor) as loop:
            studio = Studio(loop, self.out)
            page = Page(server, studio, block_under(folder.shape, folder.record.design.gel), folder.id)
            print(
                f"{sensor.source.name}: open http://{self.host}:{server.get_port()} in a browser; Ctrl-C ends",
                flush=True,
            )
            studio.run(page, self.display_hz)
        print(f"stopped after {sensor.frames_read} pictures")
        return 0

    def require_rate(self) -> None:
        """Refuse a rate that shows nothing, or more than a screen can."""
        if not 0 < self.display_hz <= FASTEST_SCREEN_HZ:
            raise LiveImpossible(
                f"expected --display-hz above 0 and at most {FASTEST_SCREEN_HZ:g}, got {self.display_hz:g}; drop it"
            )

    def sensor_at_source(self, shape: "CalibratedShape") -> "Sensor":
        """The sensor on its source, not yet opened."""
        from ninedtact.capture.freshest import Freshest
        from ninedtact.capture.pictures import read_picture
        from ninedtact.capture.reconnecting import Reconnecting
        from ninedtact.quantities import Frame
        from ninedtact.sensor import Sensor

        references = [Frame(read_picture(path)) for path in self.reference]
        source = Reconnecting(
            self.named_source(),
            on_lost=lambda loss: say(f"{loss}; waiting for it"),
            on_back=lambda: say("it is back"),
        )
        return Sensor(Freshest(source), shape, depth=shape.depth_reader(*references) if references else None)

    def named_source(self) -> "FrameSource":
        """The source that was named, over and over if so wished."""
        from ninedtact.capture.address import source_for
        from ninedtact.capture.settings import AS_SENSOR, STEADY
        from ninedtact.studio.repeating import Repeating

        source = source_for(self.source, AS_SENSOR if self.automatic else STEADY)
        return Repeating(source) if self.loop else source


def require_studio() -> None:
    """Refuse at once where the page cannot be served; raises `StudioMissing`."""
    if find_spec("viser") is None:
        raise StudioMissing(
            "expected viser, which serves the live page, got no such package; run pip install 'ninedtact[studio]'"
        )


def say(sentence: str) -> None:
    """One line about how it goes."""
    print(f"ninedtact: {sentence}", file=sys.stderr, flush=True)
