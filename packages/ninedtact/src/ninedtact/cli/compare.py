"""ninedtact compare: calibrated sensors side by side, as a table and as a page."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from ninedtact.cli.result_and_interrupt import print_notices, print_result
from ninedtact.cli.shared_options import JsonOption

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_comparison import SensorComparison


@dataclass(frozen=True)
class CompareCommand:
    """Put calibrated sensors side by side: scale, lens, light, depth curve, noise, gel and force.

    A line is marked with * where two sensors differ by more than twice the error of their difference. Without an error there is no
    mark.
    """

    sensors: tyro.conf.Positional[tuple[Path, ...]]
    """Sensor folders that `ninedtact calibrate` wrote, two or more."""
    out: Path | None = None
    """New HTML page to write, with the curves and the reference images beside the table."""
    json: JsonOption = False

    def run(self) -> int:
        """Compare, write the page if one is asked for, and print the table."""
        from ninedtact.atomic_write import require_new_file, write_file_atomically
        from ninedtact.calibration.sensor_comparison import compare_sensors

        require_new_file(self.out)
        comparison = compare_sensors(self.sensors)
        for sensor in comparison.sensors:
            print_notices(sensor.notices)
        if self.out is not None:
            from ninedtact.calibration.certificate.comparison_page import render_comparison_html

            write_file_atomically(self.out, render_comparison_html(comparison).encode())
        return print_result(self.json, _to_json_dict(comparison), self._format(comparison))

    def _format(self, comparison: "SensorComparison") -> Iterator[str]:
        width = max(16, *(len(name) + 2 for name in comparison.names))
        yield f"{'(± is one standard deviation)':66}" + "".join(f"{name:>{width}}" for name in comparison.names)
        group = ""
        for row in comparison.quantities:
            heading, group = ("" if row.group == group else row.group), row.group
            label = f"{'*' if row.differs else ' '} {row.label}"
            yield f"{heading:8}{label:58}" + "".join(f"{text:>{width}}" for text in row.texts)
        if any(row.differs for row in comparison.quantities):
            yield "* two sensors differ by more than twice the error of their difference"
        if self.out is not None:
            yield f"open {self.out} in a browser"


def _to_json_dict(comparison: "SensorComparison") -> dict[str, Any]:
    return {
        "sensors": [{"folder": str(sensor.path), "id": sensor.id} for sensor in comparison.sensors],
        "quantities": [{**asdict(row), "differs": row.differs} for row in comparison.quantities],
    }
