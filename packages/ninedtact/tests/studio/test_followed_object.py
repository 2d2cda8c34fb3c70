"""The path on the page: that of a key on a twin is the true one, it is computed only while it is wanted, and begins anew; that of a
recording is the one that the sensor had."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_sensor import wait_until

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import EstimateWarning, Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.topics_and_messages import ESTIMATE_TOPICS, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press import Press
from ninedtact.studio.followed_object import FollowedObject, ObjectFollower
from ninedtact.studio.reading_view import full_range_colour_scale
from ninedtact.studio.recording_player import RecordedSensor


@pytest.fixture(scope="module")
def turned_key(physical_sensor: SensorFolder) -> list[tuple[Press, Reading]]:
    """A key that is pressed, then dragged by (0.6, 0.3) mm and turned by 12°."""
    twin, shape, estimator = physical_sensor.twin(), physical_sensor.shape, physical_sensor.estimator("physics")
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))
    pressed, last = [], None
    for number in range(7):
        pose = Pose(-0.3 + 0.1 * number, 0.05 * number, 0.5, np.radians(2.0 * number))
        last = twin.press(last, indenter_from_name("key_05"), pose)
        frame = Frame(twin.renderer(last.corrected, number), (number + 1) * 10**8, number)
        pressed.append((last, estimator.add_force(read_frame(frame, shape, reader))))
    return pressed


def test_path_and_turn_of_a_key_are_the_true_ones(turned_key: list[tuple[Press, Reading]]) -> None:
    presses = {reading.stamp_ns: press for press, reading in turned_key}
    follower = ObjectFollower(presses.get, is_wanted=True)
    for _, reading in turned_key:
        follower.add(reading)
    found = follower.at(turned_key[-1][1].stamp_ns)
    seen, true = found.seen, found.true
    assert seen is not None and true is not None and len(seen.places_mm) == len(true.places_mm) == 7
    assert np.degrees(true.turn_rad) == pytest.approx(12.0, abs=0.01)
    assert np.linalg.norm(seen.places_mm - true.places_mm, axis=1).max() < 0.08
    assert np.degrees(abs(seen.turn_rad - true.turn_rad)) < 1.0 and np.degrees(seen.turn_std_rad) < 1.5
    assert 0 <= true.sticking_share <= 1
    assert follower.at(turned_key[3][1].stamp_ns).stamp_ns == turned_key[3][1].stamp_ns


def test_a_path_goes_on_after_an_image_that_cannot_be_used(turned_key: list[tuple[Press, Reading]]) -> None:
    presses = {reading.stamp_ns: press for press, reading in turned_key}
    follower = ObjectFollower(presses.get, is_wanted=True)
    for number, (_, reading) in enumerate(turned_key):
        dark = replace(reading)
        vars(dark)["image_warnings"] = (EstimateWarning.IMAGE_DARK,)
        follower.add(dark if number in (3, 4) else reading)
    unseen, found = (follower.at(turned_key[number][1].stamp_ns) for number in (3, -1))
    assert unseen.seen is None and unseen.doubt
    assert found.seen is not None and found.true is not None and len(found.seen.places_mm) == 5 and not found.doubt
    assert np.linalg.norm(found.seen.moved_mm - found.true.moved_mm) < 0.08
    assert np.degrees(abs(found.seen.turn_rad - found.true.turn_rad)) < 1.0


def test_nothing_is_followed_while_nobody_looks_and_a_path_begins_when_somebody_does(
    turned_key: list[tuple[Press, Reading]],
) -> None:
    follower = ObjectFollower(is_wanted=True)
    follower.add(turned_key[0][1])
    follower.is_wanted = False
    follower.add(turned_key[1][1])
    assert follower.at(0) == FollowedObject()
    follower.is_wanted = True
    follower.add(turned_key[5][1])
    found = follower.at(turned_key[5][1].stamp_ns)
    assert found.seen is not None and len(found.seen.places_mm) == 1 and found.true is None


def test_a_recording_shows_the_path_that_the_sensor_had_computed_once_for_all_viewers(
    turned_key: list[tuple[Press, Reading]], physical_sensor: SensorFolder, tmp_path: Path
) -> None:
    readings, follower = [reading for _, reading in turned_key], ObjectFollower(is_wanted=True)
    path, topics = tmp_path / "key.mcap", {Topic.IMAGES, Topic.REFERENCE_GREY, Topic.HEIGHTS, *ESTIMATE_TOPICS}
    with RecordingWriter(path, RecordingMetadata(physical_sensor.id), topics) as recording:
        for reading in readings:
            recording.write_reading(reading)
            follower.add(reading)
    shape, scale = physical_sensor.shape, full_range_colour_scale(physical_sensor.shape)
    other, recorded = (RecordedSensor(path, shape, scale) for _ in range(2))
    try:
        assert other.course is recorded.course
        other.close()  # the course goes on for whom it is shown to still
        wait_until(lambda: recorded.course.followed_until_ns == readings[-1].stamp_ns)
        for reading in (readings[-1], readings[2]):
            recorded.seek(reading.stamp_ns)
            shown, live = (
                one.seen
                for one in (
                    recorded.moment(reading.stamp_ns, 0.0, "paused", 0.0).followed,
                    follower.at(reading.stamp_ns),
                )
            )
            assert shown is not None and live is not None
            np.testing.assert_allclose(shown.places_mm, live.places_mm, atol=0.01)
            assert shown.turn_rad == pytest.approx(live.turn_rad, abs=np.radians(0.3))
    finally:
        recorded.close()
    again = RecordedSensor(path, shape, scale)
    assert again.course is not recorded.course
    again.close()
