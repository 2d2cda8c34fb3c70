"""ninedtact export: a recording as images, tables and heights in files of their own."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ninedtact.cli.result_and_interrupt import print_result


@dataclass(frozen=True)
class Export:
    """Export a recording: images as PNG, wrenches, pairs and times as CSV, heights as .npy, and the sensor folder."""

    recording: Annotated[Path, tyro.conf.Positional]
    """File that `ninedtact record` or `ninedtact collect` wrote."""
    out: Path
    """New or empty folder."""
    json: bool = False
    """Print the result as one JSON object."""

    def run(self) -> int:
        """Export everything and print how many files and rows were written."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from tqdm import tqdm

        from ninedtact.recording.export import export_recording
        from ninedtact.recording.reader import Recording
        from ninedtact.recording.ros_messages import Topic

        with Recording(self.recording) as recording:
            images = len(recording.positions(Topic.IMAGES))
            with tqdm(total=images, unit="images", disable=self.json) as bar:
                written = export_recording(recording, self.out, on_image=bar.update)
        figures = {"out": str(self.out), "written": written}
        return print_result(
            self.json, figures, [f"{self.out}:", *(f"  {number:8d}  {kind}" for kind, number in written.items())]
        )
