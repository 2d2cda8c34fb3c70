"""What no table of a sensor's file may be, and what is not written where it is not there."""

import pytest

from ninedtact.calibration.sensor_toml_schema import (
    GridTable,
    LensCorrectionTable,
    PinMapTable,
)


def test_points_come_with_as_many_values() -> None:
    points = [(0.0, 1.0), (2.0, 3.0)]
    for make, name in ((lambda *lists: LensCorrectionTable(3.0, *lists), "weights_px"), (PinMapTable, "points_px")):
        make(points, points)
        with pytest.raises(ValueError, match=f"2 points_mm and 1 {name}"):
            make(points, points[:1])


@pytest.mark.parametrize(
    ("area", "sentence"),
    [((-1.0, 2.0, -3.0, 4.0), None), ((2.0, 2.0, -3.0, 4.0), "without area"), ((-1.0, 2.0, 4.0, 4.0), "without area")],
)
def test_a_calibrated_area_has_a_width_and_a_height(
    area: tuple[float, float, float, float], sentence: str | None
) -> None:
    if sentence is None:
        assert GridTable(0.05, 480, 640, area).camera_rotation_deg == 0
    else:
        with pytest.raises(ValueError, match=sentence):
            GridTable(0.05, 480, 640, area)
