"""The press of a second ball on the same gel, which is fitted together with the first by the method `physics`. In: two raw images.
Out: the press (`find_second_press`), and after the fit what it added, in figures and in words.
"""

from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.sensor_toml_schema import SecondBallQuality
from ninedtact.calibration.twin.ball_press_fit import FurtherPress, TwinFit
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.quantities import BgrImage
from ninedtact.shape.depth import DepthMethod
from ninedtact.shape.lens_and_rectification import Rectification

_LITTLE_GAIN = 0.8
"""Share of the error of the depth that is left, above which a second press adds little."""


def find_second_press(
    rectify: Rectification, pair: tuple[BgrImage, BgrImage] | None, design: SensorDesign, method: DepthMethod
) -> tuple[FurtherPress, ...]:
    """Return the press of the second ball, none where there are no images of it.

    pair: the skin before it and under it. Raises `BallPressUnusable`, whose message names the second ball, and `InputError` for
    another method than `physics`.
    """
    if pair is None:
        return ()
    if method != "physics":
        raise InputError(
            expected="the method physics for a second ball, which is fitted together with the first",
            got=f"the method {method}",
            remedy="leave out the second ball, or choose physics",
        )
    ball = design.ball.second
    try:
        press = find_ball_press(rectify, *pair, ball, "physics")
    except BallPressUnusable as refusal:
        raise BallPressUnusable(
            expected=f"of the second ball {refusal.expected}", got=refusal.got, remedy=refusal.remedy
        ) from refusal
    return (FurtherPress(press, ball),)


def second_ball_quality(twin: TwinFit | None) -> SecondBallQuality | None:
    """Return the quality of the press of the second ball; None where there is none."""
    if twin is None or not twin.further:
        return None
    second, deviations = twin.further[0], twin.uncertainty.standard_deviations
    return SecondBallQuality(
        second.ball.radius_mm,
        second.press.depth_mm,
        deviations["press_2_depth_mm"],
        second.residual_rms_grey_levels,
        deviations["depth_mm"],
        deviations["depth_mm"] / twin.depth_std_share,
        second.implied_radius.mm,
        second.implied_radius.std_mm,
    )


def little_gain_warnings(second: SecondBallQuality | None) -> list[str]:
    """Return a warning where the second press tells hardly more than the first."""
    if second is None or second.first_std_mm <= _LITTLE_GAIN * second.first_std_alone_mm:
        return []
    return [
        f"the second ball (radius {second.ball_radius_mm:g} mm, pressed {second.max_indentation_mm:.2f} mm deep) adds little: "
        f"the depth of the first is known to {second.first_std_mm:.2g} mm with it and to {second.first_std_alone_mm:.2g} mm "
        "without; press a ball of another radius (ninedtact calibrate --plan says which)"
    ]
