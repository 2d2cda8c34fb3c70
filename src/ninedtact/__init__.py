"""The software of the 9DTact tactile sensor: images in, calibrated millimetres out.

    shape    light ──capture──▶ Frame ──rectify──▶ Rectified ──depth──▶ HeightMap ──cloud──▶ PointCloud / mesh
    fit      board pressed ──▶ Rectification      ball pressed ──▶ DepthCurve
    press    object ──contact mechanics──▶ Contact ──light──▶ Frame, Wrench      (a twin: SimulatedCamera)

`sensor.py` is the file to read first. Names are loaded when they are first used, so that importing the package costs
nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ninedtact.calibration.procedure import CalibrationImages, CalibrationSettings, calibrate
    from ninedtact.calibration.save import write_sensor
    from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
    from ninedtact.capture.frame_source import FIXED_EXPOSURE, CameraSettings, FrameSource, SourceEnded
    from ninedtact.capture.image_file import read_image
    from ninedtact.capture.latest_frame import LatestFrameSource
    from ninedtact.capture.source_address import source_for
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.design import SensorDesign
    from ninedtact.errors import NinedtactError
    from ninedtact.mechanics.pose import Pose
    from ninedtact.quantities import Coverage, Frame, HeightMap, Mesh, PointCloud, Reading, Rectified, Wrench
    from ninedtact.sensor import Sensor
    from ninedtact.shape.cloud import point_cloud
    from ninedtact.shape.export import export
    from ninedtact.shape.height_png import read_height_png
    from ninedtact.shape.image import height_image, shaded_image
    from ninedtact.shape.measures import summarise
    from ninedtact.shape.mesh import surface_mesh
    from ninedtact.shape.sightlines import from_straight_below
    from ninedtact.simulation.camera import SimulatedCamera
    from ninedtact.simulation.force_torque import SimulatedForceTorque
    from ninedtact.simulation.motion import touch
    from ninedtact.simulation.objects.named import object_for
    from ninedtact.simulation.press import Press
    from ninedtact.simulation.stage import Act, Stage
    from ninedtact.simulation.twin import Twin, default_twin

HOMES = {
    "Wrench": "quantities",
    "WrenchSource": "capture.wrench_source",
    "SimulatedCamera": "simulation.camera",
    "SimulatedForceTorque": "simulation.force_torque",
    "Stage": "simulation.stage",
    "Act": "simulation.stage",
    "Twin": "simulation.twin",
    "default_twin": "simulation.twin",
    "Pose": "mechanics.pose",
    "Press": "simulation.press",
    "touch": "simulation.motion",
    "object_for": "simulation.objects.named",
    "read_height_png": "shape.height_png",
    "shaded_image": "shape.image",
    "height_image": "shape.image",
    "from_straight_below": "shape.sightlines",
    "SourceEnded": "capture.frame_source",
    "CameraSettings": "capture.frame_source",
    "FIXED_EXPOSURE": "capture.frame_source",
    "Coverage": "quantities",
    "CalibrationImages": "calibration.procedure",
    "CalibrationSettings": "calibration.procedure",
    "Frame": "quantities",
    "FrameSource": "capture.frame_source",
    "LatestFrameSource": "capture.latest_frame",
    "HeightMap": "quantities",
    "Mesh": "quantities",
    "NinedtactError": "errors",
    "PointCloud": "quantities",
    "Reading": "quantities",
    "Rectified": "quantities",
    "Sensor": "sensor",
    "SensorDesign": "design",
    "SensorFolder": "calibration.sensor_folder",
    "calibrate": "calibration.procedure",
    "export": "shape.export",
    "load_sensor": "calibration.sensor_folder",
    "point_cloud": "shape.cloud",
    "read_image": "capture.image_file",
    "source_for": "capture.source_address",
    "summarise": "shape.measures",
    "surface_mesh": "shape.mesh",
    "write_sensor": "calibration.save",
}

__all__ = [
    "FIXED_EXPOSURE",
    "Act",
    "CalibrationImages",
    "CalibrationSettings",
    "CameraSettings",
    "Coverage",
    "Frame",
    "FrameSource",
    "HeightMap",
    "LatestFrameSource",
    "Mesh",
    "NinedtactError",
    "PointCloud",
    "Pose",
    "Press",
    "Reading",
    "Rectified",
    "Sensor",
    "SensorDesign",
    "SensorFolder",
    "SimulatedCamera",
    "SimulatedForceTorque",
    "SourceEnded",
    "Stage",
    "Twin",
    "Wrench",
    "WrenchSource",
    "calibrate",
    "default_twin",
    "export",
    "from_straight_below",
    "height_image",
    "load_sensor",
    "object_for",
    "point_cloud",
    "read_height_png",
    "read_image",
    "shaded_image",
    "source_for",
    "summarise",
    "surface_mesh",
    "touch",
    "write_sensor",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its room."""
    if name not in HOMES:
        raise AttributeError(f"module 'ninedtact' has no attribute {name!r}")
    return getattr(import_module(f"ninedtact.{HOMES[name]}"), name)
