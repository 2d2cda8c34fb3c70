"""The disc of a ball in drawn changes of light: where it is, how uneven its rim is, and from which limits on it is refused."""

import numpy as np
import pytest

from ninedtact.calibration.ball.ball_press import BallPress, simulate_height_noise_mm
from ninedtact.calibration.ball.contact_circle import (
    ContactCircle,
    find_contact_circle,
)
from ninedtact.design import BallGauge
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.depth import DepthCurve, Smoothing
from ninedtact.shape.lens_and_rectification import Rectification

SHAPE, RADIUS_PX = (160, 200), 30.0
ROW, COL = np.indices(SHAPE).astype(float)


def disc(drop: float, x: float = 105.0, y: float = 72.0, lean: float = 0.0, oval: float = 1.0) -> np.ndarray:
    """A dark disc of this radius in a bright rim, which is brighter towards +x by a part."""
    across, down = COL - x, (ROW - y) * oval
    r = np.hypot(across, down)
    field = -drop * (1 - (r / RADIUS_PX) ** 2) * np.exp(-1.5 * (r / RADIUS_PX) ** 2)
    return field * np.where(r > RADIUS_PX, 1 + lean * across / np.maximum(r, 1), 1)


def found(*fields: np.ndarray, noise: float = 0.05) -> ContactCircle:
    """The circle in the sum of fields."""
    noisy = sum(fields) + np.random.default_rng(0).normal(0, noise, SHAPE)
    return find_contact_circle(noisy.astype(np.float32))


def test_the_disc_is_found_where_it_is() -> None:
    circle = found(disc(40.0))
    assert circle.centre_px == pytest.approx((105, 72), abs=0.1)
    assert circle.radius_px == pytest.approx(RADIUS_PX, abs=0.3)
    assert circle.darkening_grey_levels == pytest.approx(40, rel=0.03)
    assert circle.edge_scatter_px < 0.3 and circle.asymmetry < 0.01
    np.testing.assert_allclose(circle.distance_px(SHAPE)[72, [105, 135]], [0, 30], atol=0.3)


def ball_press(radius_px: float = 32.0) -> BallPress:
    """A press of a pixel of a tenth of a millimetre, of which only the circle is asked."""
    before = Rectified(np.full(SHAPE, 80, np.float32), 0.1)
    after = np.full(SHAPE, 60, np.float32)
    return BallPress(
        before, Rectified(after, 0.1), ContactCircle((119.5, 69.5), radius_px, 0.1, 20, (0.0, 0.0)), BallGauge()
    )


def test_lines_of_sight_meet_the_ball_where_sphere_and_line_do() -> None:
    press = ball_press()
    depth_mm = press.rigid_ball_depth_mm(14.0)
    x, y = skin_grid_mm(SHAPE, 0.1)
    part = 1 - depth_mm / 14
    out_of_ball = np.sqrt((part * x - 2) ** 2 + (part * y + 1) ** 2 + (-depth_mm - 2.4) ** 2) - 4
    assert np.abs(out_of_ball[depth_mm > 0]).max() < 1e-5
    beside = np.hypot(x - 2, y + 1)
    assert (depth_mm[beside > 3.25] == 0).all() and (depth_mm[beside < 3.15] > 0).all()
    far_mm = press.rigid_ball_depth_mm(1e6)
    assert far_mm.max() == pytest.approx(4 - 2.4, abs=1e-3)


@pytest.mark.parametrize(
    ("curve", "grey_level_mm"),
    [
        (DepthCurve("difference", (0.0, 50.0), (0.0, 2.0), (0.0, 0.0)), 2 / 50),
        (DepthCurve("ratio", (0.0, 0.4), (0.0, 2.0), (0.0, 0.0)), 2 / 0.4 / 150),
    ],
)
def test_the_noise_of_heights_is_that_of_the_camera_over_the_slope(curve: DepthCurve, grey_level_mm: float) -> None:
    rows, cols = np.indices((60, 80), np.float32)
    rectify = Rectification(np.stack([cols, rows], axis=-1), 0.1, (60, 80), (-4, -3, 4, 3))

    def reader(before: Rectified) -> DepthReader:
        """One without smoothing."""
        return DepthReader(curve, before, rectify.height_source, Smoothing(0, 0))

    reference = np.full((60, 80, 3), 150, np.uint8)
    noise_mm = simulate_height_noise_mm(reader, rectify, reference, 0.5)
    assert noise_mm == pytest.approx(0.5 * grey_level_mm, rel=0.03)
    assert noise_mm == simulate_height_noise_mm(reader, rectify, reference, 0.5)
