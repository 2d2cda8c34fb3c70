from ._version import __version__
from .calibration.procedure import CalibrationImages, calibrate
from .calibration.save import save_sensor
from .calibration.sensor_folder import SensorFolder, load_sensor
from .calibration.settings import CalibrationSettings
from .capture.frame_pacing import LatestFrameSource
from .capture.frame_source import FIXED_EXPOSURE, CameraSettings, FrameSource, SourceEnded
from .capture.strict_image_reading import read_image
from .capture.wrench_source import WrenchSource
from .design import SensorDesign
from .errors import NinedtactError
from .force.estimator_and_scale import ForceEstimator
from .mechanics.pose import Pose
from .open_sensor import open  # noqa: A004
from .quantities import (
    Deformation,
    EstimateWarning,
    Frame,
    HeightMap,
    HeightSource,
    Mesh,
    PointCloud,
    Rectified,
    Traction,
    Wrench,
    WrenchEstimate,
)
from .reading import Reading
from .recording.reader import Recording
from .recording.recorder import record
from .reference_images import ReferenceImages
from .sensor import Sensor
from .shape.coloured_height_map import draw_height_map_figure, render_relief
from .shape.export import export_shape, read_height_png
from .shape.orthorectification import orthorectify
from .shape.surface import point_cloud, summarise_shape, surface_mesh
from .simulation.objects.catalogue import indenter_from_name
from .simulation.press_sequence import ObjectTrajectory, PressSequence
from .simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque
from .simulation.trajectory import ScriptedPress, press_trajectory
from .simulation.twin import Twin, default_twin
from .source_addresses import source_for

__all__ = [
    "FIXED_EXPOSURE",
    "CalibrationImages",
    "CalibrationSettings",
    "CameraSettings",
    "Deformation",
    "EstimateWarning",
    "ForceEstimator",
    "Frame",
    "FrameSource",
    "HeightMap",
    "HeightSource",
    "LatestFrameSource",
    "Mesh",
    "NinedtactError",
    "ObjectTrajectory",
    "PointCloud",
    "Pose",
    "PressSequence",
    "Reading",
    "Recording",
    "Rectified",
    "ReferenceImages",
    "ScriptedPress",
    "Sensor",
    "SensorDesign",
    "SensorFolder",
    "SimulatedCamera",
    "SimulatedForceTorque",
    "SourceEnded",
    "Traction",
    "Twin",
    "Wrench",
    "WrenchEstimate",
    "WrenchSource",
    "__version__",
    "calibrate",
    "default_twin",
    "draw_height_map_figure",
    "export_shape",
    "indenter_from_name",
    "load_sensor",
    "open",
    "orthorectify",
    "point_cloud",
    "press_trajectory",
    "read_height_png",
    "read_image",
    "record",
    "render_relief",
    "save_sensor",
    "source_for",
    "summarise_shape",
    "surface_mesh",
]
