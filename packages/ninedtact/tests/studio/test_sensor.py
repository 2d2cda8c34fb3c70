"""A sensor without a page: when the reference is taken, what is counted, and what a reading offers."""

import numpy as np
import pytest
from small_sensor import MM_PER_PX, PRESSED_PX, SHAPE, UNTOUCHED, SkinCamera, skin

from ninedtact.capture.frame_source import CameraLost
from ninedtact.errors import CalibrationError
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.quantities import Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.reference_images import ReferenceImages
from ninedtact.sensor import Sensor

STD = np.array([0.1, 0.1, 0.2, 1e-3, 1e-3, 1e-4])


class ConstantForce(ForceEstimator):
    """Estimates 2 N of pressure for every reading."""

    name = "constant"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        return WrenchEstimate(Wrench(np.array([0.0, 0.0, -2.0]), np.zeros(3)), np.diag(STD**2), touching=True)

    def forget(self) -> None: ...


def test_opening_takes_the_reference_and_the_first_reading_counts_no_drops() -> None:
    camera = SkinCamera(period_s=0.02)
    with Sensor(camera, SHAPE, reference_frames=5) as sensor:
        assert sensor.frames_read == 5
        camera.level = 75
        first = sensor.read()
    assert first.dropped == 0 and first.frame.index == 5
    assert first.max_indentation_mm == pytest.approx(1.0, abs=0.01)
    assert first.stage_ms["depth"] < 5 * 20, "waiting for reference frames was booked as depth"


def test_every_opening_takes_a_new_reference() -> None:
    camera = SkinCamera()
    sensor = Sensor(camera, SHAPE, reference_frames=2)
    with sensor:
        assert sensor.read().max_indentation_mm == pytest.approx(0.0, abs=0.01)
    camera.level = 75
    with sensor:
        assert sensor.read().max_indentation_mm == pytest.approx(0.0, abs=0.01), "the reference of the last session"
    given = SHAPE.depth_reader(Frame(skin(UNTOUCHED)))
    kept = Sensor(camera, SHAPE, ReferenceImages(given))
    for _ in range(2):
        with kept:
            assert kept.read().max_indentation_mm == pytest.approx(1.0, abs=0.01), "not the reference that was given"
            kept.take_reference()
            assert kept.read().max_indentation_mm == pytest.approx(0.0, abs=0.01)


def test_a_reading_without_a_reference_is_refused() -> None:
    sensor = Sensor(SkinCamera(), SHAPE)
    sensor.open(take_reference=False)
    with pytest.raises(CalibrationError, match="take_reference"):
        sensor.read()
    sensor.close()


def test_a_reference_that_fails_leaves_the_source_closed() -> None:
    camera = SkinCamera()
    closed = []
    camera.close = lambda: closed.append(True)  # type: ignore[method-assign]
    sensor = Sensor(camera, SHAPE)
    camera.read = lambda: (_ for _ in ()).throw(CameraLost("expected an image, got none; plug it in"))  # type: ignore[method-assign]
    with pytest.raises(CameraLost), sensor:
        pytest.fail("it must not open")
    assert closed


def test_a_reading_offers_shape_and_force() -> None:
    camera = SkinCamera()
    with Sensor(camera, SHAPE, reference_frames=2, estimator=ConstantForce()) as sensor:
        camera.level = 75
        reading = sensor.read()
    assert reading.wrench is not None and reading.wrench.force_n[2] == -2
    assert reading.wrench_std == pytest.approx(STD) and reading.warnings == ()
    assert reading.image.shape == (48, 64, 3) and reading.stamp_ns == reading.frame.stamp_ns
    assert reading.contact_area_mm2 == pytest.approx((PRESSED_PX * MM_PER_PX) ** 2, rel=0.3)
    points = reading.points()
    assert points.points_mm[:, 2].min() == pytest.approx(-reading.max_indentation_mm)
