"""A depth curve beyond the depth of the calibrating ball: it continues, marked and with a growing error."""

import msgspec
import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.quantities import HeightSource, Rectified
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import (
    FINE_SMOOTHING,
    CurveContinuation,
    DepthCurve,
    GlobalDimmingModel,
    Smoothing,
    mean_view_darkening,
)

BEYOND = CurveContinuation((0.35, 0.6), (1.3, 1.8), (0.06, 0.16))
CURVE = DepthCurve("ratio", (0.0, 0.1, 0.2), (0.0, 0.5, 1.0), (0.0, 0.01, 0.02), (0.0, 0.4), (0.0, 1.0), BEYOND)


def reader(curve: DepthCurve) -> DepthReader:
    reference = Rectified(np.full((4, 5), 200, np.float32), 0.05)
    return DepthReader(curve, reference, np.full((4, 5), HeightSource.MEASURED, np.uint8), Smoothing(0, 0))


@pytest.mark.parametrize(
    ("darker", "z_mm", "source"),
    [
        (-0.2, 0.5, HeightSource.MEASURED),
        (0.1, -0.5, HeightSource.MEASURED),
        (0.19, -0.95, HeightSource.MEASURED),
        (0.275, -1.15, HeightSource.EXTRAPOLATED),
        (0.475, -1.55, HeightSource.EXTRAPOLATED),
        (0.9, -1.8, HeightSource.EXTRAPOLATED),
    ],
)
def test_heights_follow_all_knots_and_those_beyond_the_ball_count_as_extrapolated(
    darker: float, z_mm: float, source: HeightSource
) -> None:
    height = reader(CURVE)(Rectified(np.full((4, 5), 200 * (1 - darker), np.float32), 0.05))
    np.testing.assert_allclose(height.z_mm, z_mm, atol=1e-3)
    assert (height.source == source).all()


def test_the_error_grows_beyond_the_ball_and_the_calibrated_range_stays() -> None:
    assert CURVE.max_indentation_mm == 1.0
    assert reader(CURVE).error_mm(1.0) == pytest.approx(0.02)
    assert reader(CURVE).error_mm(1.55) == pytest.approx(0.11)


@pytest.mark.parametrize(
    ("curve", "darker", "pixels", "clipped"),
    [
        (DepthCurve("ratio", (0.0, 0.2), (0.0, 1.0), (0.0, 0.02)), 0.25, 900, True),
        (DepthCurve("ratio", (0.0, 0.2), (0.0, 1.0), (0.0, 0.02)), 0.21, 1, False),  # as noise is
        (DepthCurve("difference", (0.0, 2.0), (0.0, 0.046), (0.0, 0.03)), 0.1, 900, True),
        (CURVE, 0.55, 900, False),
        (CURVE, 0.9, 900, True),
    ],
)
def test_skin_darker_than_the_end_of_the_curve_is_clipped(
    curve: DepthCurve, darker: float, pixels: int, clipped: bool
) -> None:
    grey = np.full(900, 200, np.float32)
    grey[:pixels] *= 1 - darker
    reference = Rectified(np.full((30, 30), 200, np.float32), 0.05)
    read = DepthReader(curve, reference, np.full((30, 30), HeightSource.MEASURED, np.uint8))
    assert read(Rectified(grey.reshape(30, 30), 0.05)).is_clipped == clipped


def test_a_continuation_is_stored_with_the_curve_and_must_rise() -> None:
    assert msgspec.convert(msgspec.to_builtins(CURVE), DepthCurve) == CURVE
    for wrong in (((0.15, 0.6), (1.3, 1.8), (0.1, 0.2)), ((0.35, 0.6), (1.3, 1.2), (0.1, 0.2))):
        with pytest.raises(InputError, match="rises"):
            DepthCurve("ratio", (0.0, 0.2), (0.0, 1.0), (0.0, 0.02), beyond=CurveContinuation(*wrong))
    with pytest.raises(InputError, match="expected 3 errors"):
        DepthCurve("ratio", (0.0, 0.2), (0.0, 1.0), (0.0, 0.02), beyond=CurveContinuation((0.4,), (1.4,), ()))


def test_deblurred_heights_equal_those_looked_up_at_every_pixel() -> None:
    y, x = np.mgrid[:345, :460] * 0.052
    dent = np.exp(-((x - 11) ** 2 + (y - 8) ** 2) / 4) - 0.1 * np.exp(-((x - 14) ** 2 + (y - 8) ** 2) / 8)
    curve = DepthCurve("ratio", (0.0, 0.1, 0.3), (0.0, 0.8, 2.0), (0.01,) * 3, (0.0, 0.1), (0.0, 0.3))
    before = Rectified(np.full(x.shape, 150, np.float32), 0.052)
    source = np.full(x.shape, HeightSource.MEASURED, np.uint8)
    reader = DepthReader(curve, before, source, FINE_SMOOTHING, deblurring=Deblurring(0.5))
    after = Rectified((150 * (1 - 0.25 * dent)).astype(np.float32), 0.052)
    index = reader.index(after.grey)
    read = reader(after)
    assert np.abs(read.z_mm - FINE_SMOOTHING(curve.look_up_mm(index))).max() < 0.015
    assert read.z_mm.min() < -1.5 and read.z_mm.max() > 0.02
    darker = Rectified((150 * (1 - 0.4 * dent)).astype(np.float32), 0.052)
    beyond = reader.index(darker.grey) < curve.darkest_index
    assert beyond.any() and np.array_equal(reader(darker).source == HeightSource.EXTRAPOLATED, beyond)
    assert not beyond[:, 300:].any() and (read.source == HeightSource.MEASURED).all()


def test_the_light_that_dark_skin_takes_from_the_whole_image_is_known_from_the_image() -> None:
    reference, pressed = np.full((100, 150), 160, np.float32), np.ones((100, 150), np.float32)
    pressed[20:50, 30:80] = 0.7
    share = 0.3 * 30 * 50 / 15_000
    lost = -0.8 * share
    assert GlobalDimmingModel(0.8)(reference * pressed * np.float32(1 + lost), reference) == pytest.approx(
        lost, rel=0.02
    )
    assert mean_view_darkening(reference * pressed * np.float32(1 + lost), reference, lost) == pytest.approx(
        share, rel=0.02
    )
    assert GlobalDimmingModel(0.0)(reference * pressed, reference) == 0
    assert mean_view_darkening(reference * np.float32(0.99), reference, 0.0) == 0  # as drift and noise darken it


def test_the_light_that_is_lost_is_restored_before_depths_are_read() -> None:
    spot = np.ones((40, 60), np.float32)
    spot[10:30, 20:40] = 0.85
    share = 0.15 * 400 / 2400
    reference = Rectified(np.full(spot.shape, 200, np.float32), 0.05)
    seen = Rectified((200 * spot * np.float32(1 - 0.8 * share)), 0.05)
    source = np.full(spot.shape, HeightSource.MEASURED, np.uint8)
    read = DepthReader(CURVE, reference, source, Smoothing(0, 0), loss=GlobalDimmingModel(0.8))(seen).z_mm
    np.testing.assert_allclose(read[10:30, 20:40], -0.75, atol=0.01)
    assert np.abs(read[spot == 1]).max() < 0.01
