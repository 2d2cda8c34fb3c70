"""A model at work on a twin that nobody saw: it calibrates itself, is pressed, dragged and twisted, and is read live."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.cli.force.model.recipe import SHOW_SEED
from ninedtact.design import SensorDesign

if TYPE_CHECKING:
    from ninedtact.simulation.press_simulation import PressSimulation
    from ninedtact.simulation.twin import Twin

OBJECT, DEPTH_MM, DRAG_MM, TWIST_DEG = "ball:5", 1.1, (0.8, 0.3), 8.0
DEEPEST_PART = 0.5
"""Of the gel's thickness."""
HZ, EVERY, IMAGES = 20.0, 8, 10
HEADINGS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


@dataclass(frozen=True)
class Shown:
    """True and estimated wrench of one moment, N and N·m."""

    seconds: float
    true: np.ndarray
    estimated: np.ndarray

    def line(self) -> str:
        """Both for a terminal, N and mN·m."""
        scale = np.array([1, 1, 1, 1e3, 1e3, 1e3])
        pairs = zip(self.true * scale, self.estimated * scale, strict=True)
        return f"{self.seconds:5.1f} s " + "".join(f"  {true:+7.2f} {found:+7.2f}" for true, found in pairs)


def live(model: Path, sensor_folder: Path, design: SensorDesign = SensorDesign()) -> Iterator[Shown]:
    """Some moments of a touch of a twin of this design, whose own calibration is left in the folder.

    Its gel is as stiff as a weighing would tell.
    """
    from ninedtact.calibration.sensor_folder import load_sensor
    from ninedtact.cli.force.estimators import gel_of, on_sensor
    from ninedtact.cli.force.own_sensors import calibrate_twin
    from ninedtact.quantities import Frame
    from ninedtact.sensor import Sensor
    from ninedtact.simulation.sensor_population import sample_sensor
    from ninedtact.simulation.simulated_sources import SimulatedCamera

    twin_of = sample_sensor(0, SHOW_SEED, design=design)
    calibrate_twin(twin_of, sensor_folder)
    folder, twin = load_sensor(sensor_folder), twin_of.twin()
    gel = replace(gel_of(folder), shear_modulus_mpa=twin_of.gel.shear_modulus_mpa)
    stage = touched(twin, min(DEPTH_MM, DEEPEST_PART * design.gel.thickness_mm))
    untouched = folder.shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-IMAGES, 0)))
    estimator = on_sensor(str(model), folder.shape, gel)
    with Sensor(SimulatedCamera(stage), folder.shape, depth_reader=untouched, estimator=estimator) as sensor:
        for reading in sensor:
            if reading.frame.index % EVERY == 0 and reading.force is not None:
                true = stage.contact(reading.frame.index).wrench().six
                yield Shown(reading.frame.index / HZ, true, reading.force.wrench.six)


def touched(twin: "Twin", depth_mm: float) -> "PressSimulation":
    """One touch, no step of which is skipped."""
    from ninedtact.mechanics.pose import Pose
    from ninedtact.simulation.objects.catalogue import indenter_from_name
    from ninedtact.simulation.press_simulation import ObjectTrajectory, PressSimulation
    from ninedtact.simulation.trajectory import press_trajectory

    motion = press_trajectory(Pose(depth_mm=depth_mm), drag_mm=DRAG_MM, twist_rad=radians(TWIST_DEG))
    return PressSimulation(
        twin, [ObjectTrajectory(indenter_from_name(OBJECT), motion)], hz=HZ, real_time=False, rounds=1
    )
