"""The ROS 2 messages of a running sensor: a reading in, encoded messages (CDR) by topic out. Nothing here needs ROS or DDS.

Topics, types and units are those of recordings (`recording.topics_and_messages`), with points, compressed images and camera
information added. Lengths are in metres (REP 103). Frames of a sensor `my_sensor`, all right-handed:

    my_sensor_skin            origin in the middle of the untouched skin, x along image columns, y along rows, z outward
    my_sensor_gel             the same axes; origin where the gel is bonded to its base
    my_sensor_camera_optical  z forward along the view, x to the right, y down in the raw image (REP 103, suffix `_optical`)
    my_sensor_object          of what touches: where it touched first, origin in the middle of the contact, axes those of the skin

The tree has no parent of `skin`; who mounts the sensor publishes the transform from the robot's link to it.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array
from rosbags.serde import SerdeError
from scipy.spatial.transform import Rotation

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError
from ninedtact.quantities import Rectified, Wrench, skin_grid_mm
from ninedtact.reading import Reading
from ninedtact.recording.topics_and_messages import (
    MESSAGE_TYPES,
    Topic,
    encode_covariance,
    encode_height,
    encode_image,
    encode_message,
    encode_reference_grey,
    encode_warnings_as_diagnostics,
    encode_wrench,
    message_header,
    ros_name,
    type_store,
)
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.shape.surface import point_cloud
from ninedtact.tracking import ObjectMotion, SlipEstimate, TrackedContacts

TF, TF_STATIC = "/tf", "/tf_static"
STATUS, COMMAND, CONTACTS, SLIP = "status", "command", "contacts", "slip"
POINTS, COMPRESSED, CAMERA_INFO = "points", "image_raw/compressed", "camera_info"
STRING_TYPE, TF_TYPE = "std_msgs/msg/String", "tf2_msgs/msg/TFMessage"
_POINTS_TYPE, _COMPRESSED_TYPE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"
_CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
POINT_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "intensity")
_FLOAT32 = 7
"""`PointField.FLOAT32`."""
_FIT_ROWS = 30
"""About so many rows of the rectified grid, and columns as far apart, are points of the camera fit."""
_M_PER_MM = 1e-3


class QosProfile(StrEnum):
    """Named qualities of service, as in ROS 2."""

    SENSOR_DATA = "sensor_data"
    """Best effort, the last five: the newest data first, lost ones are not sent again."""
    RELIABLE = "reliable"
    """Lost messages are sent again; the last ten."""
    LATCHED = "latched"
    """Reliable, and who subscribes later still gets the last one (transient local)."""


LIVE_TOPICS: Mapping[str, tuple[str, QosProfile]] = {
    Topic.IMAGES: (MESSAGE_TYPES[Topic.IMAGES], QosProfile.RELIABLE),
    COMPRESSED: (_COMPRESSED_TYPE, QosProfile.RELIABLE),
    CAMERA_INFO: (_CAMERA_INFO_TYPE, QosProfile.RELIABLE),
    Topic.HEIGHTS: (MESSAGE_TYPES[Topic.HEIGHTS], QosProfile.RELIABLE),
    POINTS: (_POINTS_TYPE, QosProfile.RELIABLE),
    Topic.ESTIMATED: (MESSAGE_TYPES[Topic.ESTIMATED], QosProfile.RELIABLE),
    Topic.MEASURED: (MESSAGE_TYPES[Topic.MEASURED], QosProfile.RELIABLE),
    Topic.COVARIANCE: (MESSAGE_TYPES[Topic.COVARIANCE], QosProfile.RELIABLE),
    Topic.WARNINGS: (MESSAGE_TYPES[Topic.WARNINGS], QosProfile.RELIABLE),
    Topic.REFERENCE_GREY: (MESSAGE_TYPES[Topic.REFERENCE_GREY], QosProfile.LATCHED),
    CONTACTS: (STRING_TYPE, QosProfile.RELIABLE),
    SLIP: (STRING_TYPE, QosProfile.RELIABLE),
    STATUS: (STRING_TYPE, QosProfile.LATCHED),
}
"""Type and default quality of service of every topic that is published; a reliable topic serves `sensor_data` subscribers too."""


@dataclass(frozen=True)
class FittedPinholeCamera:
    """A pinhole camera with the distortion model `plumb_bob`, fitted to the calibrated map from skin to raw image."""

    focal_length_px: float
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    """k1, k2, p1, p2, k3."""
    roll_rad: float
    """Angle from the x axis of the camera to that of the skin about the common z axis."""
    distance_mm: float
    """Distance from the camera to the untouched skin: that of the design."""
    raw_shape: tuple[int, int]
    residual_px: float
    """Root mean square distance between the fitted and the calibrated pixels."""

    @property
    def matrix(self) -> Float64[Array, "3 3"]:
        """The matrix K, which maps points at unit distance to undistorted pixels."""
        (u, v), f = self.centre_px, self.focal_length_px
        return np.array([[f, 0, u], [0, f, v], [0, 0, 1]], float)

    @property
    def projection(self) -> Float64[Array, "3 4"]:
        """The matrix P = [K 0] of ROS."""
        return np.hstack([self.matrix, np.zeros((3, 1))])


class ChildFrame(NamedTuple):
    """A frame of the sensor, seen from that of the skin: a translation along the common z axis, and a rotation about it."""

    name: str
    z_m: float
    rotation_zw: tuple[float, float]
    """The quaternion's z and w; x and y are zero."""


def fit_pinhole_camera(rectification: Rectification, distance_mm: float) -> FittedPinholeCamera:
    """Return the pinhole camera at this distance that sees the skin as the calibration does.

    One plane does not tell focal length from distance, so that the distance is given, and the view is taken as perpendicular.
    Window and gel refract, which the distortion absorbs; `residual_px` says how well.
    """
    from scipy.optimize import least_squares

    shape = rectification.source_px.shape[:2]
    pick = (slice(None, None, max(1, shape[0] // _FIT_ROWS)),) * 2
    seen = rectification.height_source[pick].ravel() > 0
    x_mm, y_mm = (axis[pick].ravel()[seen].astype(float) for axis in skin_grid_mm(shape, rectification.mm_per_px))
    plane = np.stack([x_mm, y_mm], 1) / distance_mm
    pixels = rectification.source_px[pick].reshape(-1, 2)[seen].astype(float)
    tangent = np.linalg.lstsq(np.column_stack([plane, np.ones(len(plane))]), pixels, rcond=None)[0]
    focal_px, roll = float(np.sqrt(abs(np.linalg.det(tangent[:2])))), float(np.arctan2(tangent[0, 1], tangent[0, 0]))

    def miss(parameters: Float64[Array, "9"]) -> Float64[Array, " m"]:
        return np.asarray((_project(plane, parameters, focal_px) - pixels).ravel())

    found = least_squares(miss, [1.0, *tangent[2] / focal_px, roll, 0, 0, 0, 0, 0]).x
    residual_px = float(np.sqrt((miss(found).reshape(-1, 2) ** 2).sum(1).mean()))
    scale, u, v, roll, *distortion = found.tolist()
    centre = (u * focal_px, v * focal_px)
    return FittedPinholeCamera(
        scale * focal_px, centre, tuple(distortion), roll, distance_mm, rectification.raw_shape, residual_px
    )


def _project(plane: Float64[Array, "n 2"], parameters: Float64[Array, "9"], unit_px: float) -> Float64[Array, "n 2"]:
    """Return the pixels of points at unit distance: scale, centre, roll, then k1, k2, p1, p2, k3; lengths in `unit_px`."""
    scale, u, v, roll = parameters[:4] * (unit_px, unit_px, unit_px, 1.0)
    matrix, points = np.array([[scale, 0, u], [0, scale, v], [0, 0, 1]]), np.column_stack([plane, np.zeros(len(plane))])
    pixels = cv2.projectPoints(points, np.array([0.0, 0.0, roll]), np.array([0.0, 0.0, 1.0]), matrix, parameters[4:])[0]
    return np.asarray(pixels[:, 0])


@dataclass(frozen=True)
class SensorMessages:
    """The messages of one sensor."""

    folder: SensorFolder
    name: str
    """Name of the sensor in topics and frames."""
    points_every: int = 3
    """Points of every so many rows and columns of the height map."""

    def path(self, topic: str) -> str:
        """Return the full name of a topic."""
        return topic if topic.startswith("/") else f"/{ros_name(self.name)}/{topic}"

    def frame(self, part: str) -> str:
        """Return the name of a frame: of `skin`, `gel`, `camera_optical` or `object`."""
        return f"{ros_name(self.name)}_{part}"

    @cached_property
    def camera(self) -> FittedPinholeCamera:
        """The pinhole camera of `camera_info`, fitted once."""
        return fit_pinhole_camera(self.folder.shape.rectify, self.folder.record.design.camera.distance_mm)

    @property
    def child_frames(self) -> tuple[ChildFrame, ...]:
        """The frames of camera and gel below that of the skin."""
        half_roll = -self.camera.roll_rad / 2
        rotation_zw = float(np.sin(half_roll)), float(np.cos(half_roll))
        return (
            ChildFrame(self.frame("camera_optical"), -self.camera.distance_mm * _M_PER_MM, rotation_zw),
            ChildFrame(self.frame("gel"), -self.folder.gel.thickness_mm * _M_PER_MM, (0.0, 1.0)),
        )

    def encode(self, reading: Reading, wall_ns: int, topics: Collection[str]) -> dict[str, bytes]:
        """Return the messages of a reading on these topics; none on topics for which it has nothing (no wrench, no warning).

        wall_ns: wall time of the reading's image, which is the stamp of all messages.
        """
        skin, camera = self.frame("skin"), self.frame("camera_optical")
        centred = None if reading.force is None else reading.force.about_skin_centre()
        encoders: dict[str, Callable[[], bytes | None]] = {
            Topic.IMAGES: lambda: encode_image(reading.image, wall_ns, frame=camera),
            COMPRESSED: lambda: encode_message(
                _COMPRESSED_TYPE,
                header=message_header(wall_ns, camera),
                format="bgr8; jpeg compressed bgr8",
                data=cv2.imencode(".jpg", reading.image)[1].reshape(-1),
            ),
            CAMERA_INFO: lambda: self.encode_camera_info(wall_ns),
            Topic.HEIGHTS: lambda: encode_height(reading.height.visible_z_mm, wall_ns, frame=skin),
            POINTS: lambda: self._points(reading, wall_ns),
            Topic.ESTIMATED: lambda: None if centred is None else encode_wrench(centred.wrench, wall_ns, skin),
            Topic.COVARIANCE: lambda: None if centred is None else encode_covariance(centred.covariance),
            Topic.WARNINGS: lambda: (
                encode_warnings_as_diagnostics(reading.warnings, self.name, wall_ns, skin) if reading.warnings else None
            ),
        }
        messages = {topic: encode() for topic, encode in encoders.items() if topic in topics}
        return {topic: message for topic, message in messages.items() if message is not None}

    def encode_camera_info(self, wall_ns: int) -> bytes:
        """Return the camera information of the raw image."""
        camera, (rows, cols) = self.camera, self.camera.raw_shape
        region = type_store().types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        return encode_message(
            _CAMERA_INFO_TYPE,
            header=message_header(wall_ns, self.frame("camera_optical")),
            height=rows,
            width=cols,
            distortion_model="plumb_bob",
            d=np.array(camera.distortion),
            k=camera.matrix.ravel(),
            r=np.eye(3).ravel(),
            p=camera.projection.ravel(),
            binning_x=0,
            binning_y=0,
            roi=region,
        )

    def encode_static_transforms(self, wall_ns: int) -> bytes:
        """Return the transforms from the skin to the gel and to the camera."""
        return encode_message(
            TF_TYPE,
            transforms=[
                self._transform(child.name, (0.0, 0.0, child.z_m), (0.0, 0.0, *child.rotation_zw), wall_ns)
                for child in self.child_frames
            ],
        )

    def encode_object_transform(self, motion: ObjectMotion, wall_ns: int) -> bytes:
        """Return the transform from the skin to the object that is followed."""
        place_m = (_M_PER_MM * motion.position_mm).tolist()
        quaternion = Rotation.from_matrix(motion.motion.rotation).as_quat().tolist()
        return encode_message(TF_TYPE, transforms=[self._transform(self.frame("object"), place_m, quaternion, wall_ns)])

    def _transform(self, child: str, place_m: Sequence[float], quaternion_xyzw: Sequence[float], wall_ns: int) -> Any:
        types = type_store().types
        moved = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*place_m), types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw)
        )
        return types["geometry_msgs/msg/TransformStamped"](message_header(wall_ns, self.frame("skin")), child, moved)

    def point_values(self, reading: Reading) -> Float32[Array, "n 7"]:
        """Return `POINT_FIELDS` of every point: metres, outward unit normal, and the grey level of the rectified image."""
        every = (slice(None, None, self.points_every),) * 2
        cloud = point_cloud(reading.height, self.points_every)
        values = np.empty((len(cloud.points_mm), len(POINT_FIELDS)), "<f4")
        values[:, :3], values[:, 3:6] = cloud.points_mm * np.float32(_M_PER_MM), cloud.normals
        values[:, 6] = reading.rectified.grey[every][reading.height.in_view[every]]
        return values

    def _points(self, reading: Reading, wall_ns: int) -> bytes:
        values = self.point_values(reading)
        field = type_store().types["sensor_msgs/msg/PointField"]
        return encode_message(
            _POINTS_TYPE,
            header=message_header(wall_ns, self.frame("skin")),
            height=1,
            width=len(values),
            fields=[field(name, 4 * place, _FLOAT32, 1) for place, name in enumerate(POINT_FIELDS)],
            is_bigendian=False,
            point_step=values.strides[0],
            row_step=values.nbytes,
            data=values.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def encode_measured(self, wrench: Wrench, wall_ns: int) -> bytes:
        """Return the message of a wrench that a force/torque sensor measured."""
        return encode_wrench(wrench, wall_ns, self.frame("skin"))

    def encode_reference(self, reference: Rectified, wall_ns: int) -> bytes:
        """Return the message of the rectified reference image against which heights are computed from this time on."""
        return encode_reference_grey(reference.grey, wall_ns, self.frame("skin"))


def encode_ros2_contacts(found: TrackedContacts, wall_ns: int) -> bytes:
    """Return contacts, each with its slip, as JSON in a string message: metres, N, N·m about the skin centre; null where not known.

    wall_ns: wall time of the reading's image.
    """
    contacts = [
        {
            "number": contact.number,
            "centre_m": (_M_PER_MM * contact.centre_mm).tolist(),
            "area_m2": _M_PER_MM**2 * contact.area_mm2,
            "force_n": None if contact.force is None else contact.force.wrench.force_n.tolist(),
            "torque_nm": None if contact.force is None else contact.force.wrench.torque_nm.tolist(),
            "slip": _slip_fields(slip),
        }
        for contact, slip in zip(found.contacts, found.slips, strict=True)
    ]
    return encode_message(STRING_TYPE, data=json.dumps({"stamp_ns": wall_ns, "contacts": contacts}, allow_nan=False))


def encode_ros2_slip(slip: SlipEstimate, wall_ns: int) -> bytes:
    """Return the slip of the object as JSON in a string message, in metres; null where not known."""
    return encode_message(STRING_TYPE, data=json.dumps({"stamp_ns": wall_ns, **_slip_fields(slip)}, allow_nan=False))


def _slip_fields(slip: SlipEstimate) -> dict[str, Any]:
    numbers = {
        "p_incipient": slip.p_incipient,
        "p_gross": slip.p_gross,
        "sticking_share": slip.sticking_share,
        "speed_m_s": _M_PER_MM * slip.speed,
        "friction": slip.friction,
        "friction_std": slip.friction_std,
    }
    return {
        "state": str(slip.state),
        **{name: float(one) if np.isfinite(one) else None for name, one in numbers.items()},
    }


def encode_ros2_status(fields: Mapping[str, Any]) -> bytes:
    """Return a status as JSON in a string message."""
    return encode_message(STRING_TYPE, data=json.dumps(fields, ensure_ascii=False))


def decode_ros2_command(data: bytes) -> str:
    """Return the text of a command, without surrounding white space; raises `InputError`."""
    try:
        text: str = type_store().deserialize_cdr(data, STRING_TYPE).data
    except SerdeError as error:
        raise InputError(f"expected a command as a {STRING_TYPE} in UTF-8, got: {error}; send it as text") from error
    return text.strip()
