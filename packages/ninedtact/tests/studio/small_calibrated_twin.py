"""A twin of 320 x 240 pixels, whose images cost a quarter, and its camera, whose cable can be pulled."""

from dataclasses import replace

from ninedtact.capture.frame_source import CameraLost
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame
from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
from ninedtact.simulation.gel_brightness import synthetic_reference_image
from ninedtact.simulation.pixel_to_skin_map import WideAngleLens
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import default_twin

_PIXELS = WideAngleLens().pixel_map((240, 320))
TWIN = replace(
    default_twin(),
    renderer=Renderer(
        _PIXELS,
        synthetic_reference_image(_PIXELS),
        default_twin().renderer.light,
        CameraNoise(shape=_PIXELS.raw_shape),
    ),
)


class PluggedCamera(SimulatedCalibrationCamera):
    """A simulated sensor whose cable can be pulled."""

    plugged_in = True

    def open(self) -> None:
        if not self.plugged_in:
            raise CameraError("expected the camera, got none; plug it in")
        super().open()

    def read(self) -> Frame:
        frame = super().read()
        if not self.plugged_in:
            raise CameraLost("expected an image, got none; plug the camera in")
        return frame
