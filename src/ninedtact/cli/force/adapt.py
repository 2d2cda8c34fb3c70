"""ninedtact adapt: a few presses of known weight → newtons of one's own sensor."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.cli.force.estimators import BOTH
from ninedtact.cli.terminal import print_result
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.force.estimator import ForceEstimator
    from ninedtact.force.force_scale import ForceScaleFit, KnownLoadPress
    from ninedtact.shape.calibrated_shape import CalibratedShape


class NothingWeighed(NinedtactError):
    """An estimator that cannot be adapted."""


@dataclass(frozen=True)
class Adapt:
    """Adapt the force of a sensor to its own gel, by images of presses whose weight is known.

    A kitchen scale is enough: put the sensor on it, take an image of the untouched skin, set the scale to zero, then
    press with something blunt and note the grams of each image. Four presses from 50 g to 800 g do well.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote; what is found is kept there, in force.toml."""
    reference: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Untouched skin of the same session; given more than once, the images are averaged."""
    press: tyro.conf.UseAppendAction[tuple[tuple[Path, float], ...]]
    """An image and its grams, as --press five.png 512; once for every press."""
    force: str = BOTH
    """What is adapted: both (network and physics), network, physics, or a force model (.onnx)."""
    dry_run: bool = False
    """Say what would be found, and keep nothing."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Adapt, show by presses left out what it gains, and keep it."""
        from ninedtact.calibration.sensor_folder import load_sensor
        from ninedtact.cli.force.estimators import NONE, unadapted
        from ninedtact.force.force_scale import fit_force_scale, write_force_scale

        if self.force == NONE:
            raise NothingWeighed(f"expected an estimator to adapt, got --force {NONE}; name {BOTH} or a force model")
        folder = load_sensor(self.sensor)
        estimator = unadapted(self.force, folder)
        presses = [*self.weighed(folder.shape, estimator)]
        judged = fit_force_scale(presses)
        kept = None if self.dry_run else str(write_force_scale(self.sensor, estimator.name, judged.adaptation))
        figures = {
            "estimator": estimator.name,
            **asdict(judged),
            "presses": [asdict(one) for one in presses],
            "file": kept,
        }
        return print_result(self.json, figures, lines(presses, judged, kept))

    def weighed(self, shape: "CalibratedShape", estimator: "ForceEstimator") -> "Iterator[KnownLoadPress]":
        """Every press as the estimator reads it; raises `ForceScaleImpossible`, naming the image."""
        from ninedtact.capture.image_and_video_files import ImageList
        from ninedtact.capture.image_file import read_image
        from ninedtact.force.force_scale import ForceScaleImpossible, KnownLoadPress, weight_of_grams_n
        from ninedtact.quantities import Frame
        from ninedtact.sensor import Sensor

        depth = shape.depth_reader(*[Frame(read_image(path)) for path in self.reference])
        images = ImageList([path for path, _ in self.press])
        with Sensor(images, shape, depth_reader=depth, estimator=estimator) as sensor:
            for (path, grams), reading in zip(self.press, sensor, strict=True):
                estimator.forget()
                assert reading.force is not None
                try:
                    yield KnownLoadPress(max(0.0, -float(reading.force.wrench.force_n[2])), weight_of_grams_n(grams))
                except ForceScaleImpossible as refusal:
                    raise ForceScaleImpossible(f"{path}: {refusal}") from refusal


def lines(presses: "list[KnownLoadPress]", judged: "ForceScaleFit", kept: str | None) -> Iterator[str]:
    """For a person."""
    found = judged.adaptation
    for press in presses:
        corrected = press.estimated_n * found.at(press.estimated_n)
        yield f"{press.weighed_n:6.2f} N weighed, {press.estimated_n:6.2f} N estimated, {corrected:6.2f} N adapted"
    bend = f", times (load / {found.about_n:.1f} N)^{found.curve:+.2f}" if found.curve else ""
    yield f"forces times {found.factor:.3f}{bend}"
    yield (
        f"error of a press left out: {judged.unadapted:.1%} without, {judged.by_factor:.1%} with a factor"
        + ("" if judged.by_curve is None else f", {judged.by_curve:.1%} with a curve")
    )
    yield "nothing kept" if kept is None else f"kept in {kept}"
