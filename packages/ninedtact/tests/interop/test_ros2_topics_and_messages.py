"""ROS 2 messages mean what they say: units, axes, frames, and a camera model that projects as the calibration does."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_sensor import RECORDED, SHAPE, SkinCamera, image_folder, sensor_folder, skin

from ninedtact import cli
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import LensModelTable
from ninedtact.errors import InputError
from ninedtact.interop.ros2_topics_and_messages import (
    CAMERA_INFO,
    COMPRESSED,
    CONTACTS,
    LIVE_TOPICS,
    POINTS,
    SLIP,
    TF_TYPE,
    SensorMessages,
    decode_ros2_command,
    encode_ros2_contacts,
    encode_ros2_slip,
)
from ninedtact.quantities import EstimateWarning, Frame, Wrench, WrenchEstimate, skin_grid_mm
from ninedtact.reading import Reading
from ninedtact.recording.topics_and_messages import Topic, decode_height_map, type_store
from ninedtact.reference_images import ReferenceImages
from ninedtact.sensor import Sensor
from ninedtact.shape.surface import point_cloud
from ninedtact.tracking import ContactTracker, ObjectMotion, RigidMotion, TrackState

WALL_NS = 1_790_000_000_123_456_789
WRENCH = WrenchEstimate(
    Wrench(np.array([0.1, 0.2, -2.0]), np.array([1e-3, 2e-3, 3e-3])), np.eye(6), True, (EstimateWarning.OUT_OF_RANGE,)
)
MESSAGES = SensorMessages(SensorFolder(Path(), RECORDED), "left-hand", points_every=2)


@pytest.fixture(scope="module")
def reading() -> Reading:
    camera = SkinCamera()
    sensor = Sensor(camera, SHAPE, ReferenceImages(SHAPE.depth_reader(Frame(skin(100)))))
    with sensor:
        camera.level = 60
        return sensor.read().with_force(WRENCH)


def decode(topic: str, data: bytes) -> Any:
    return type_store().deserialize_cdr(data, LIVE_TOPICS[topic][0])


def test_all_messages_of_a_reading_carry_its_stamp_and_the_frames_of_its_sensor(reading: Reading) -> None:
    encoded = MESSAGES.encode(reading, WALL_NS, LIVE_TOPICS)
    stamped = {topic: decode(topic, data) for topic, data in encoded.items() if topic != Topic.COVARIANCE}
    assert {message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in stamped.values()} == {
        WALL_NS
    }
    camera = {Topic.IMAGES.value, COMPRESSED, CAMERA_INFO}
    for topic, message in stamped.items():
        assert message.header.frame_id == ("left_hand_camera_optical" if topic in camera else "left_hand_skin")
    assert set(encoded) == set(LIVE_TOPICS) - {"status", CONTACTS, SLIP, Topic.MEASURED, Topic.REFERENCE_GREY}
    assert MESSAGES.path(POINTS) == "/left_hand/points"
    assert [status.message for status in stamped[Topic.WARNINGS].status] == [
        warning.value for warning in reading.warnings
    ]


def test_wrench_and_covariance_are_about_the_skin_centre_wherever_the_estimate_is(reading: Reading) -> None:
    errors = np.diag([0.1, 0.2, 0.3, 1e-3, 2e-3, 3e-3])
    elsewhere = replace(WRENCH, covariance=errors).about(np.array([2.0, 3.0, -5.0]))
    encoded = MESSAGES.encode(reading.with_force(elsewhere), WALL_NS, {Topic.ESTIMATED, Topic.COVARIANCE})
    torque = decode(Topic.ESTIMATED, encoded[Topic.ESTIMATED]).wrench.torque
    assert [torque.x, torque.y, torque.z] == pytest.approx([1e-3, 2e-3, 3e-3])
    found = decode(Topic.COVARIANCE, encoded[Topic.COVARIANCE]).data.reshape(6, 6)
    np.testing.assert_allclose(found, errors, atol=1e-12)


def test_lengths_are_metres_and_forces_newtons(reading: Reading) -> None:
    encoded = MESSAGES.encode(reading, WALL_NS, LIVE_TOPICS)
    cloud = decode(POINTS, encoded[POINTS])
    values = cloud.data.view("<f4").reshape(cloud.width, cloud.point_step // 4)
    named = {field.name: values[:, field.offset // 4] for field in cloud.fields}
    true = point_cloud(reading.height, 2)
    np.testing.assert_allclose(np.stack([named[axis] for axis in "xyz"], 1) * 1e3, true.points_mm, rtol=1e-5)
    np.testing.assert_array_equal(np.stack([named[f"normal_{axis}"] for axis in "xyz"], 1), true.normals)
    np.testing.assert_array_equal(named["intensity"], reading.rectified.grey[::2, ::2].ravel())
    assert named["z"].min() < -2e-4  # pressed in
    np.testing.assert_allclose(decode_height_map(encoded[Topic.HEIGHTS]), reading.height.z_mm, atol=1e-5)
    wrench = decode(Topic.ESTIMATED, encoded[Topic.ESTIMATED]).wrench
    assert (wrench.force.z, wrench.torque.y) == (-2.0, 2e-3)
    image = decode(COMPRESSED, encoded[COMPRESSED])
    assert np.abs(cv2.imdecode(image.data, cv2.IMREAD_COLOR).astype(float) - reading.image).mean() < 5


def test_contacts_are_json_in_metres_with_null_for_what_is_not_known(reading: Reading) -> None:
    found = ContactTracker().update(reading)
    said = json.loads(decode(CONTACTS, encode_ros2_contacts(found, WALL_NS)).data)
    (contact,) = said["contacts"]
    slip = json.loads(decode(SLIP, encode_ros2_slip(found.slip, WALL_NS)).data)
    assert said["stamp_ns"] == slip["stamp_ns"] == WALL_NS and slip["state"] == contact["slip"]["state"] == "static"
    assert slip["friction"] is None and contact["number"] == 1
    assert contact["centre_m"] == pytest.approx((1e-3 * found.contacts[0].centre_mm).tolist())
    assert contact["force_n"] is None, "the estimate has no tractions to cut"
    free = ContactTracker().update(replace(reading, force=None))
    assert json.loads(decode(SLIP, encode_ros2_slip(free.slip, 0)).data)["state"] == "unknown"


def test_the_frame_of_the_object_moves_its_first_contact_to_where_it_is_now() -> None:
    moved = RigidMotion().perturbed(np.zeros(3), np.array([1.0, -0.5, 0.1, 0.1, -0.05, 0.7]))
    first_mm = np.array([2.0, 1.0, -0.4])
    motion = ObjectMotion(TrackState.TRACKED, motion=moved, position_mm=moved(first_mm))
    (transform,) = type_store().deserialize_cdr(MESSAGES.encode_object_transform(motion, WALL_NS), TF_TYPE).transforms
    assert transform.child_frame_id.endswith("_object") and transform.header.frame_id.endswith("_skin")
    place, turn = transform.transform.translation, transform.transform.rotation
    assert [place.x, place.y, place.z] == pytest.approx((1e-3 * moved(first_mm)).tolist())
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    # Another point of the object is where this frame carries it.
    other_mm = np.array([3.0, -1.0, -0.2])
    assert motion.position_mm + rotation @ (other_mm - first_mm) == pytest.approx(moved(other_mm))


@pytest.mark.parametrize("turn_deg", [0, 90, -130])
def test_opencv_projects_the_skin_by_camera_info_and_tf_as_the_calibration_does(turn_deg: float) -> None:
    lens, turn = RECORDED.lens, np.radians(turn_deg)
    assert isinstance(lens, LensModelTable)
    scale = lens.homography[0] / 2  # so that the turned view stays in the image
    turned = [scale * np.cos(turn), -scale * np.sin(turn), 0.02, scale * np.sin(turn), scale * np.cos(turn), 0.01, 0, 0]
    changed = msgspec.structs.replace(lens, homography=tuple(map(float, turned)), radial=(-0.1,))
    bent = msgspec.structs.replace(RECORDED, lens=changed)
    folder = SensorFolder(Path(), bent)
    messages, rectify = SensorMessages(folder, "turned"), folder.shape.rectify

    transforms = type_store().deserialize_cdr(messages.encode_static_transforms(WALL_NS), TF_TYPE).transforms
    camera = {each.child_frame_id: each.transform for each in transforms}["turned_camera_optical"]
    q, t = camera.rotation, camera.translation
    angle = 2 * np.arctan2(q.z, q.w)
    to_skin = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    axes = skin_grid_mm(rectify.source_px.shape[:2], rectify.mm_per_px)
    skin_m = np.column_stack([axis.ravel() for axis in axes] + [np.zeros(axes[0].size)]) / 1e3
    in_camera = (skin_m - [t.x, t.y, t.z]) @ to_skin  # the inverse rotation, by rows
    np.testing.assert_allclose(in_camera[:, 2], bent.design.camera.distance_mm / 1e3)

    info = type_store().deserialize_cdr(messages.encode_camera_info(WALL_NS), LIVE_TOPICS[CAMERA_INFO][0])
    pixels = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), info.k.reshape(3, 3), info.d)[0][:, 0]
    off_px = np.hypot(*(pixels - rectify.source_px.reshape(-1, 2)).T)
    assert np.sqrt((off_px**2).mean()) == pytest.approx(messages.camera.residual_px, abs=0.02)
    assert off_px.max() < 0.1


@pytest.mark.parametrize("message", [b"", b"\0\1\0\0", b"\0\1\0\0\3\0\0\0\xff\xfe\0", b"\0\1\0\0\xff\0\0\0ab\0"])
def test_a_command_that_cannot_be_decoded_is_refused(message: bytes) -> None:
    with pytest.raises(InputError, match=r"in UTF-8, got: .*; send it as text"):
        decode_ros2_command(message)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--qos", "points=fast"], "expected --qos as TOPIC=PROFILE"),
        (["--qos", "pionts=reliable"], "expected --qos as TOPIC=PROFILE"),
        (["--points-every", "0"], "expected --points-every of at least 1, got 0"),
        (["--domain", "233"], "expected a DDS domain from 0 to 232, got 233"),
        (["--interface", "nosuch0"], "expected --interface to name one of"),
    ],
)
def test_what_ros2_cannot_do_is_refused_in_one_sentence(
    options: list[str],
    sentence: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    pytest.importorskip("cyclonedds", reason="the extra 'ros2' is not installed")
    folder, images = sensor_folder(tmp_path / "small"), image_folder(tmp_path / "images", 100)
    words = ["ros2", "--source", str(images), "--sensor", str(folder), "--force", "none", *options]
    assert cli.main(words) == 1
    assert sentence in capsys.readouterr().err.strip().splitlines()[-1]
    assert cli.main(["ros2", "--source", "left=0", "right=1", "--name", "hand"]) == 1
    assert "--name with a --source that has no name, got left, right; drop --name" in capsys.readouterr().err
