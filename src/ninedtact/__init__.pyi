from ._version import __version__
from .calibration.procedure import CalibrationImages, CalibrationSettings, calibrate
from .calibration.save import save_sensor
from .calibration.sensor_folder import SensorFolder, load_sensor
from .capture.frame_source import FIXED_EXPOSURE, CameraSettings, FrameSource, SourceEnded
from .capture.image_file import read_image
from .capture.latest_frame import LatestFrameSource
from .capture.source_address import source_for
from .capture.wrench_source import WrenchSource
from .design import SensorDesign
from .errors import NinedtactError
from .mechanics.pose import Pose
from .quantities import (
    Coverage,
    Deformation,
    Doubt,
    Frame,
    HeightMap,
    Mesh,
    PointCloud,
    Rectified,
    Traction,
    Wrench,
    WrenchEstimate,
)
from .reading import Reading
from .sensor import Sensor
from .shape.cloud import point_cloud
from .shape.export import export
from .shape.height_png import read_height_png
from .shape.image import height_image, shaded_image
from .shape.measures import summarise
from .shape.mesh import surface_mesh
from .shape.sightlines import from_straight_below
from .simulation.objects.catalogue import indenter_from_name
from .simulation.press_simulation import ObjectTrajectory, PressSimulation
from .simulation.scripted_press import ScriptedPress
from .simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque
from .simulation.trajectory import press_trajectory
from .simulation.twin import Twin, default_twin

__all__ = [
    "FIXED_EXPOSURE",
    "CalibrationImages",
    "CalibrationSettings",
    "CameraSettings",
    "Coverage",
    "Deformation",
    "Doubt",
    "Frame",
    "FrameSource",
    "HeightMap",
    "LatestFrameSource",
    "Mesh",
    "NinedtactError",
    "ObjectTrajectory",
    "PointCloud",
    "Pose",
    "PressSimulation",
    "Reading",
    "Rectified",
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
    "export",
    "from_straight_below",
    "height_image",
    "indenter_from_name",
    "load_sensor",
    "point_cloud",
    "press_trajectory",
    "read_height_png",
    "read_image",
    "save_sensor",
    "shaded_image",
    "source_for",
    "summarise",
    "surface_mesh",
]
