"""ninedtact export: a recording as files of their own."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ninedtact.cli.terminal import print_result


@dataclass(frozen=True)
class Export:
    """Write a recording out: images as PNG, wrenches, pairs and times as CSV, heights as .npy, the sensor's folder."""

    recording: Annotated[Path, tyro.conf.Positional]
    """File that `ninedtact record` or `ninedtact collect` wrote."""
    out: Path
    """New or empty folder."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Write everything, and say how much."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from tqdm import tqdm

        from ninedtact.recording.export import export_recording
        from ninedtact.recording.reader import Recording
        from ninedtact.recording.ros_messages import Topic

        with Recording(self.recording) as episode:
            images = len(episode.places(Topic.IMAGES))
            with tqdm(total=images, unit="images", disable=self.json) as bar:
                written = export_recording(episode, self.out, on_image=bar.update)
        found = {"out": str(self.out), "written": written}
        return print_result(
            self.json, found, [f"{self.out}:", *(f"  {number:8d}  {what}" for what, number in written.items())]
        )
