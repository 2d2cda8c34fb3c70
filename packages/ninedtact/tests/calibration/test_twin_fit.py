"""The twin that one ball press tells: of a twin whose numbers are known, and of real sensors whose are not."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from ninedtact.calibration.ball.ball_fit import TwinBallFit, fit_ball, fit_ball_by_physics
from ninedtact.calibration.ball.ball_press import BallFit, BallPress, find_usable_contact_circle
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.procedure import Calibration, CalibrationImages
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.calibration.twin.press_search import ParameterPrior
from ninedtact.calibration.twin.sensor_twin import assemble_twin
from ninedtact.design import SensingArea, SensorDesign
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball, Indenter, LyingCylinder
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Rectified, skin_grid_mm
from ninedtact.shape.depth import DepthMethod
from ninedtact.simulation.calibration_press_models import BallPressParameters
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid
from ninedtact.simulation.twin import Twin

DESIGN = SensorDesign()
GEL = replace(DESIGN.gel, thickness_mm=2.3)
LIGHT = BrightnessModel(
    darkening_per_mm=0.11,
    saturation=0.5,
    brightening_per_mm=0.33,
    point_spread_mm=0.5,
    global_dimming=0.8,
    inverse_distance_per_mm=0.05,
)
NOISE = 0.7


@pytest.fixture(scope="module")
def twin(calibrated_a: Calibration) -> Twin:
    """A twin with known numbers behind sensor A's lens, before sensor A's untouched image."""
    return assemble_twin("known", GEL, LIGHT, calibrated_a.rectify, calibrated_a.images.ball_reference, NOISE)


def pressed(twin: Twin, indenter: Indenter, at: Pose, drag_mm: tuple[float, float] = (0.0, 0.0)) -> Contact:
    start = replace(at, x_mm=at.x_mm - drag_mm[0], y_mm=at.y_mm - drag_mm[1])
    down = [replace(start, depth_mm=at.depth_mm * part) for part in (0.25, 0.5, 0.75, 1.0)]
    press = None
    for pose in (*down, at):
        press = twin.press(press, indenter, pose)
    return press.corrected


def press_in(before: Rectified, after: Rectified) -> BallPress:
    return BallPress(before, after, find_usable_contact_circle(before, after, DESIGN.ball, "physics"), DESIGN.ball)


@pytest.fixture(scope="module")
def known_press(twin: Twin) -> Contact:
    return pressed(twin, Ball(4.0), Pose(0.5, 0.4, 1.8), (0.4, -0.2))


@pytest.fixture(scope="module")
def fit_by_physics(twin: Twin, known_press: Contact, calibrated_a: Calibration) -> TwinBallFit:
    """What the image of the known press tells."""
    images = twin.renderer(None, 1), twin.renderer(known_press, 2)
    fit = fit_ball(calibrated_a.rectify, *images, DESIGN)
    assert isinstance(fit, TwinBallFit)
    return fit


def test_a_known_twin_is_found_again(fit_by_physics: TwinBallFit) -> None:
    fit = fit_by_physics.twin_fit
    assert fit.press.depth_mm == pytest.approx(1.8, abs=0.06)
    assert fit.press.drag_mm == pytest.approx((0.4, -0.2), abs=0.03)
    assert fit.press.centre_mm == pytest.approx((0.5, 0.4), abs=0.02)
    assert fit.press.thickness_mm == pytest.approx(2.3, abs=0.15)
    assert fit.press.point_spread_mm == pytest.approx(np.hypot(0.5, fit.problem.observed.blur_mm), abs=0.04)
    assert fit.parameters["brightening_per_mm"] == pytest.approx(0.33, rel=0.12)
    assert fit.image_rmse_grey_levels < 0.3 and fit.radial_rmse_grey_levels < 0.1
    true = {"depth_mm": 1.8, "drag_x_mm": 0.4, "drag_y_mm": -0.2, "thickness_mm": 2.3, "inverse_distance_per_mm": 0.05}
    true["gel_to_base_modulus_ratio"] = GEL.gel_to_base_modulus_ratio
    assert fit.relative_depth_std > 0.01
    off = {
        name: abs(fit.parameters[name] - value) / fit.uncertainty.standard_deviations[name]
        for name, value in true.items()
    }
    assert max(off.values()) < 4, off


def test_the_stated_error_covers_what_is_not_known_of_the_base(twin: Twin, calibrated_a: Calibration) -> None:
    ratio = 0.15
    gel = replace(GEL, gel_to_base_modulus_ratio=ratio)
    contact = pressed(replace(twin, gel=gel), Ball(4.0), Pose(0.0, 0.0, 1.5))
    before, after = (calibrated_a.rectify(Frame(twin.renderer(one, n))) for n, one in enumerate((None, contact)))
    fit = fit_twin_to_ball_press(press_in(before, after), DESIGN)
    assert fit.press.thickness_mm == pytest.approx(2.3, rel=0.07)
    true = {"depth_mm": 1.5, "gel_to_base_modulus_ratio": ratio}
    for name, value in true.items():
        # The softest base lies two standard deviations from what the prior and the image together say.
        assert abs(fit.parameters[name] - value) < 2.5 * fit.uncertainty.standard_deviations[name], name
    assert fit.relative_depth_std > 0.01
    assert fit.press.depth_mm == pytest.approx(1.5, rel=0.08)


def test_the_depth_curve_of_a_dragged_ball_on_a_soft_base_is_that_of_the_light(
    twin: Twin, calibrated_a: Calibration
) -> None:
    """There much skin lies low over gel that is thicker than before."""
    soft = replace(twin, gel=replace(GEL, gel_to_base_modulus_ratio=0.2))
    contact = pressed(soft, Ball(4.0), Pose(0.0, 0.0, 1.5), (0.4, -0.5))
    before, after = (calibrated_a.rectify(Frame(twin.renderer(one, n))) for n, one in enumerate((None, contact)))
    true = BallPressParameters(0.0, 0.0, 1.5, 0.4, -0.5, 2.3, 0.5, 0.5, 0.05, 0.2)
    of_board = ParameterPrior("inverse_distance_per_mm", 0.05, 0.001)
    fit = fit_ball_by_physics(press_in(before, after), DESIGN, (of_board,), (true,))
    assert fit.cross_validation_mae_mm < 0.03
    thinning_mm = np.array(fit.curve.indentation_mm)
    darkening = -np.asarray(fit.twin_fit.light.brightness_change(-thinning_mm))
    assert np.array(fit.curve.darkening) == pytest.approx(darkening, abs=0.006)


def test_a_base_that_is_rigid_by_design_stays_rigid(twin: Twin, calibrated_a: Calibration) -> None:
    rigid = replace(GEL, gel_to_base_modulus_ratio=0.0)
    contact = pressed(replace(twin, gel=rigid), Ball(4.0), Pose(0.0, 0.0, 1.2))
    before, after = (calibrated_a.rectify(Frame(twin.renderer(one, n))) for n, one in enumerate((None, contact)))
    fit = fit_twin_to_ball_press(press_in(before, after), replace(DESIGN, gel=rigid))
    assert fit.gel.has_rigid_base and fit.uncertainty.standard_deviations["gel_to_base_modulus_ratio"] < 1e-3
    assert fit.press.depth_mm == pytest.approx(1.2, rel=0.03)


def test_the_twin_of_gel_at_finite_strain_bears_more_load_at_the_same_depth(calibrated_a: Calibration) -> None:
    untouched, loads_n = calibrated_a.images.ball_reference, []
    for share in (0.0, 0.8):
        gel = replace(GEL, finite_strain=share)
        one = assemble_twin("rubber", gel, LIGHT, calibrated_a.rectify, untouched, NOISE)
        loads_n.append(one.press(None, Ball(4.0), Pose(depth_mm=1.2)).load_n)
    assert 1.05 < loads_n[1] / loads_n[0] < 1.3


def test_the_twin_of_a_wide_sensor_has_its_skin(sensor_a: SensorFolder) -> None:
    folder = sensor_a
    assert (folder.twin().area_mm, folder.twin().gel_mm) == ((24, 18), (29.5, 22.5))
    design = replace(folder.record.design, sensing_area=SensingArea(30, 22.5))
    wide = replace(folder, record=structs.replace(folder.record, design=design)).twin()
    assert wide.press(None, LyingCylinder(3, 12), Pose(10.0, 0.0, 0.5)).touches


@pytest.fixture(scope="module")
def fits(real_images: dict[str, CalibrationImages], calibrated_a: Calibration) -> dict[str, TwinFit]:
    """The real presses of sensors A and I."""
    images = real_images["i"]
    rectify = build_rectification(fit_board(images.board_reference, images.board, DESIGN.pin_board), DESIGN)
    before, after = (rectify(Frame(image)) for image in (images.ball_reference, images.ball))
    assert calibrated_a.fits.twin is not None
    return {"a": calibrated_a.fits.twin, "i": fit_twin_to_ball_press(press_in(before, after), DESIGN)}


def test_real_presses_are_explained(fits: dict[str, TwinFit]) -> None:
    assert fits["a"].radial_rmse_grey_levels < 0.6 and fits["a"].image_rmse_grey_levels < 0.8
    assert fits["i"].image_rmse_grey_levels < 1.3


def test_a_real_sheared_press_tells_its_drag(fits: dict[str, TwinFit]) -> None:
    assert np.hypot(*fits["a"].press.drag_mm) < 0.2
    x, y = fits["i"].press.drag_mm
    assert x > 0.2 and y > 0.5, "the bulge of sensor I is brighter at +x and +y"


def seen_mm(contact: Contact, rectify_shape: tuple[int, int], mm_per_px: float) -> np.ndarray:
    x, y = skin_grid_mm(rectify_shape, mm_per_px)
    height = np.asarray(contact.height_mm, np.float32)
    return SightlineGrid(x, y, LIGHT.inverse_distance_per_mm).sample(
        contact.skin.grid, contact.centre_mm, height, height
    )


def test_physics_reads_another_ball_better_than_the_rule(
    twin: Twin, known_press: Contact, calibrated_a: Calibration, fit_by_physics: TwinBallFit
) -> None:
    rectify = calibrated_a.rectify
    by_rule = fit_ball(rectify, twin.renderer(None, 1), twin.renderer(known_press, 2), DESIGN, "ratio")
    before = rectify(Frame(twin.renderer(None, 3)))
    contact = pressed(twin, Ball(5.0), Pose(-3.0, 1.5, 1.2))
    after, true = rectify(Frame(twin.renderer(contact, 4))), seen_mm(contact, before.grey.shape, rectify.mm_per_px)
    off = {}
    for fit in (fit_by_physics, by_rule):
        read = fit.reader(before, rectify.height_source)(after)
        off[fit.method] = float(np.abs(read.indentation_mm + np.minimum(true, 0))[true < -0.05].mean())
    assert off["physics"] < 0.035 < 0.06 < off["ratio"]


@pytest.mark.parametrize("method", ["physics", "ratio", "table"])
def test_every_fit_of_a_ball_knows_the_skin_and_reads_it_back(
    method: DepthMethod, twin: Twin, known_press: Contact, calibrated_a: Calibration, fit_by_physics: TwinBallFit
) -> None:
    fit: BallFit = fit_by_physics
    if method != "physics":
        fit = fit_ball(calibrated_a.rectify, twin.renderer(None, 1), twin.renderer(known_press, 2), DESIGN, method)
    assert fit.method == method
    assert -fit.height_mm.min() == pytest.approx(fit.max_indentation_mm, abs=0.02)
    assert (fit.thinning_mm[fit.disc] > 0).all()
    assert (fit.thinning_mm[fit.disc] <= -fit.height_mm[fit.disc] + 1e-6).all()
    read = fit.reader(fit.press.before, calibrated_a.rectify.height_source)(fit.press.after)
    in_view = fit.disc & read.in_view
    error_mm = np.abs(read.z_mm - fit.height_mm)[in_view].mean()
    assert error_mm == pytest.approx(fit.reconstruction_mae_mm, abs=1e-3)
    assert min(fit.curve.error_mm) >= fit.cross_validation_mae_mm > 0
    assert (fit.deblurring is not None, fit.loss.global_dimming > 0, fit.curve.knows_bulges) == (
        method == "physics",
    ) * 3


def test_bulges_are_read_and_nothing_is_read_from_nothing(
    twin: Twin, calibrated_a: Calibration, fit_by_physics: TwinBallFit
) -> None:
    rectify = calibrated_a.rectify
    before = rectify(Frame(twin.renderer(None, 3)))
    reader = fit_by_physics.reader(before, rectify.height_source)
    contact = pressed(twin, LyingCylinder(3.0, 8.0), Pose(1.0, 0.0, 1.0), (0.5, 0.0))
    read, true = (
        reader(rectify(Frame(twin.renderer(contact, 5)))).z_mm,
        seen_mm(contact, before.grey.shape, rectify.mm_per_px),
    )
    assert read.max() == pytest.approx(true.max(), abs=0.05)
    assert np.abs(reader(rectify(Frame(twin.renderer(None, 6)))).z_mm).mean() < 0.01


def test_a_short_roller_is_no_ball(twin: Twin, calibrated_a: Calibration) -> None:
    contact = pressed(twin, LyingCylinder(4.0, 5.0), Pose(0.0, 0.0, 1.5))
    with pytest.raises(BallPressUnusable, match="a ball explains"):
        fit_ball(calibrated_a.rectify, twin.renderer(None, 1), twin.renderer(contact, 2), DESIGN)
