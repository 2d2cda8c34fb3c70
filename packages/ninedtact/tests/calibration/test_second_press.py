"""A second press, of a ball or a flat end: what it would tell, what the joint fit finds, and what a sensor keeps of it."""

import json
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from ninedtact.calibration.ball.ball_fit import fit_ball
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.ball.second_press import find_second_presses
from ninedtact.calibration.certificate.checks import compute_certificate_checks
from ninedtact.calibration.fits_to_sensor_toml import make_second_press_quality
from ninedtact.calibration.guidance import guided_capture_steps
from ninedtact.calibration.procedure import second_image_names
from ninedtact.calibration.save import save_images_beside, to_sensor_toml
from ninedtact.calibration.second_press_plan import known_press_of_design, plan_second_press
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.calibration.sensor_toml_schema import Certificate, StoredCalibrationImage
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.calibration.twin.ball_press_fit import prior_of_base
from ninedtact.calibration.twin.fit_parameters import (
    model_error_share,
    parameters_of_press,
)
from ninedtact.calibration.twin.observed_presses import ObservedRoundPress
from ninedtact.cli import main
from ninedtact.cli.press_plan_table import format_press_plan
from ninedtact.design import SECOND_KINDS, BallGauge, DesignImpossible, FlatEndGauge, Gel, SensorDesign
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.quantities import BgrImage, Rectified
from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
from ninedtact.simulation.calibration_images import CALIBRATION_SOLVER_SETTINGS
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import default_twin


def test_a_base_far_from_the_usual_one_is_rare_and_not_excluded() -> None:
    prior = prior_of_base(Gel())
    near, slope = prior.residual(0.06)
    assert near == pytest.approx(0.25, rel=0.02) and slope == pytest.approx(12.5, rel=0.05)
    far, slope = prior.residual(0.333)
    assert 2.0 < far < 2.5, "nearly four standard deviations of a normal prior would outweigh many an image"
    assert slope == pytest.approx((prior.residual(0.334)[0] - far) / 1e-3, rel=0.01)
    assert prior.residual(0.0)[0] == -prior.residual(0.08)[0]


def test_the_error_of_the_model_stays_with_one_press_and_halves_where_two_say_the_same() -> None:
    rng = np.random.default_rng(0)
    alone = rng.normal(size=(60, 10))
    assert model_error_share(alone, [slice(0, 60)]) == 1
    unrelated = np.zeros((120, 15))
    unrelated[:60, parameters_of_press(0)], unrelated[60:, parameters_of_press(1)] = alone, alone
    share = model_error_share(unrelated, [slice(0, 60), slice(60, 120)])
    assert share == pytest.approx(1 / np.sqrt(2), rel=0.15), "two presses alike say what one says, twice"


_BALL_NAMES = second_image_names("second_ball")


@pytest.fixture(scope="module")
def plan():
    return plan_second_press(known_press_of_design(SensorDesign()))


def test_no_press_makes_anything_less_certain_and_the_best_comes_first(plan) -> None:
    alone = vars(plan.alone)
    for candidate, errors in plan.candidates:
        assert all(left <= alone[name] * 1.001 for name, left in vars(errors).items()), candidate
    left_mm = [errors.depth_mm for _, errors in plan.candidates]
    assert left_mm == sorted(left_mm) and left_mm[0] < 0.5 * plan.alone.depth_mm
    by_name = {candidate.name: errors for candidate, errors in plan.candidates}
    other, same = by_name["ball of radius 2.4 mm"], by_name["the same ball, as deep"]
    assert other.depth_mm < 0.6 * same.depth_mm, "another radius tells more than the same image again"
    weighed = by_name["the same ball on a kitchen scale"]
    assert weighed.relative_load < 0.05 < 0.2 < same.relative_load
    assert weighed.depth_mm == pytest.approx(same.depth_mm, rel=0.05), "a load alone does not tell the depth"


def test_the_plan_is_printed_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--plan", "--json", "--out", str(tmp_path / "new")]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["subject"] == "the design" and len(said["candidates"]) >= 8
    assert said["best"] in [candidate["name"] for candidate in said["candidates"][:2]], (
        "the best can be given to the command"
    )
    assert not (tmp_path / "new").exists()


def test_a_flat_end_is_among_the_best_two_that_calibrate(plan, capsys: pytest.CaptureFixture[str]) -> None:
    kinds = [candidate.second.kind for candidate in plan.calibrating]
    assert sorted(kinds) == sorted(SECOND_KINDS)
    flat = next(
        errors for candidate, errors in plan.candidates if candidate.second and candidate.second.kind == "flat_end"
    )
    assert flat.depth_mm < 0.4 * plan.alone.depth_mm and flat.modulus_ratio < 0.5 * plan.alone.modulus_ratio
    (said,) = list(format_press_plan("the design", plan))[-1:]
    assert "--flat-end IMAGE --flat-end-radius-mm 3 --flat-end-depth-mm 0.6" in said


@pytest.fixture(scope="module")
def with_second_ball(physical_sensor: SensorFolder, tmp_path_factory: pytest.TempPathFactory) -> SensorFolder:
    """The sensor with images of a second ball, 1 mm deep, before it is calibrated with them."""
    twin = default_twin()
    contact = ScriptedPress(1.0, at_mm=(0.8, -0.5), drag_mm=(0.1, -0.1)).simulate(
        twin, Ball(2.5), CALIBRATION_SOLVER_SETTINGS
    )
    path = tmp_path_factory.mktemp("second") / "my_sensor"
    shutil.copytree(physical_sensor.path, path)
    images = dict(zip(_BALL_NAMES, (twin.renderer(None, 50), twin.renderer(contact, 51)), strict=True))
    saved = save_images_beside(path, images)
    entries = {}
    for name in images:
        shutil.move(saved / f"{name}.png", path / "images" / f"{name}.png")
        digest = sha256((path / "images" / f"{name}.png").read_bytes()).hexdigest()
        entries[name] = StoredCalibrationImage(f"images/{name}.png", digest)
    record = structs.replace(physical_sensor.record, images=physical_sensor.record.images | entries)
    (path / "sensor.toml").write_bytes(to_sensor_toml(record))
    return load_sensor(path)


def test_a_second_ball_tells_the_depth_and_is_kept(
    with_second_ball: SensorFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    before = with_second_ball.record.twin
    assert main(["simulate", "fit", "--sensor", str(with_second_ball.path)]) == 0
    sensor = load_sensor(with_second_ball.path)
    second = sensor.record.certificate.second_ball
    assert second is not None and second.radius_mm == 2.5
    assert second.max_indentation_mm == pytest.approx(1.0, rel=0.03)
    by_image = before.fit.parameters["depth_mm"]
    assert (second.first_alone_mm, second.first_std_alone_mm) == pytest.approx((by_image.value, by_image.std), rel=0.1)
    assert second.first_std_mm < second.first_std_alone_mm
    assert abs(second.likely_mm - 2.5) < 2 * second.likely_std_mm < 0.4
    ball = sensor.record.certificate.ball
    assert ball.max_indentation_mm == pytest.approx(1.8, rel=0.03)
    now = sensor.record.twin
    depth = now.fit.parameters["depth_mm"]
    assert depth.std < by_image.std and abs(depth.value - 1.8) < 2.5 * depth.std
    assert {*_BALL_NAMES} <= sensor.record.images.keys()
    assert "second ball, depth" in (sensor.path / "certificate.html").read_text()


def test_a_second_ball_of_another_radius_than_stated_is_noticed(with_second_ball: SensorFolder) -> None:
    sensor, larger = with_second_ball, replace(SensorDesign(), ball=BallGauge(second_radius_mm=2.9))
    pair = [sensor.stored_image(name).image for name in ("ball_reference", "ball")]
    second = [sensor.stored_image(name).image for name in _BALL_NAMES]
    pairs = {"second_ball": (second[0], second[1])}
    further = find_second_presses(sensor.rectification, pairs, larger, "physics")
    ball = fit_ball(sensor.rectification, pair[0], pair[1], larger, further=further)
    found = make_second_press_quality(ball.twin_fit, ball.twin_fit)
    assert abs(found.likely_mm - 2.5) < 0.2
    (check,) = compute_certificate_checks(Certificate(second_ball=found))
    assert check.level == "warn" and "2.9 mm" in check.text and "calliper" in check.text


FLAT_END_MM, TILT_RAD = 0.55, (0.02, -0.012)


@pytest.fixture(scope="module")
def flat_end_pair() -> tuple[BgrImage, BgrImage]:
    """The untouched skin, and under a tilted flat end that was dragged a little and stands 0.05 mm higher than its stop says."""
    twin = default_twin()
    press = ScriptedPress(FLAT_END_MM, at_mm=(0.8, -0.5), drag_mm=(0.05, -0.1), tilt_rad=TILT_RAD)
    contact = press.simulate(twin, FlatPunch(3.0, 0.3), CALIBRATION_SOLVER_SETTINGS)
    return twin.renderer(None, 60), twin.renderer(contact, 61)


def test_a_flat_end_at_a_known_depth_tells_the_depth(
    physical_sensor: SensorFolder, flat_end_pair: tuple[BgrImage, BgrImage]
) -> None:
    sensor, design = physical_sensor, SensorDesign(flat_end=FlatEndGauge(3.0, 0.6, 0.03))
    ball = [sensor.stored_image(name).image for name in ("ball_reference", "ball")]
    (flat,) = find_second_presses(sensor.rectification, {"flat_end": flat_end_pair}, design, "physics")
    stop_mm, stop_error_mm = flat.object.known_depth
    assert 0.6 - stop_mm == pytest.approx(3.0 * np.hypot(*TILT_RAD) / 2, rel=0.4), "the rim touches before the middle"
    assert stop_error_mm > 0.03
    fit = fit_ball(sensor.rectification, ball[0], ball[1], design, further=(flat,)).twin_fit
    by_image = sensor.record.twin.fit.parameters["depth_mm"]
    std = fit.uncertainty.standard_deviations["depth_mm"]
    assert std < by_image.std and abs(fit.press.depth_mm - 1.8) < 2 * std
    (pressed,) = fit.further
    assert abs(pressed.implied.mm - FLAT_END_MM) < 2 * pressed.implied.std_mm < 0.15
    quality = make_second_press_quality(fit, fit)
    (check,) = compute_certificate_checks(Certificate(flat_end=quality))
    assert check.level == "pass" and quality.stated_mm == stop_mm
    (check,) = compute_certificate_checks(Certificate(flat_end=structs.replace(quality, stated_mm=0.9)))
    assert check.level == "warn" and "the stop says 0.90 ± 0.04 mm" in check.text


def test_what_a_tilt_changes_is_taken_out_of_the_image_of_a_flat_end_alone() -> None:
    rows, cols = np.indices((200, 240)).astype(np.float32)
    lit = np.full((200, 240), 150, np.float32)
    x, y = (cols - 119.5) * 0.1, (rows - 99.5) * 0.1
    disc = np.where(np.hypot(x, y) < 3, 1.0, 0.0)
    slopes = np.zeros_like(x), 0.02 * x - 0.01 * y
    level, tilted = (Rectified((lit * (1 - disc * (0.1 + slope))).astype(np.float32), 0.1) for slope in slopes)
    flat = [ObservedRoundPress(Rectified(lit, 0.1), after, (0.0, 0.0), 3.0) for after in (level, tilted)]
    seen = [one.without_tilt(one.relative_brightness) for one in flat]
    assert np.abs(flat[0].relative_brightness - flat[1].relative_brightness).max() > 0.03
    assert np.abs(seen[0] - seen[1]).max() < 1e-3, "the rim, where smoothing would leave a trace, is not fitted"
    ball = ObservedRoundPress(Rectified(lit, 0.1), tilted, (0.0, 0.0))
    assert ball.without_tilt(ball.relative_brightness) is ball.relative_brightness


def test_a_flat_end_that_cannot_be_used_is_named(
    physical_sensor: SensorFolder, flat_end_pair: tuple[BgrImage, BgrImage]
) -> None:
    sensor, (reference, pressed) = physical_sensor, flat_end_pair
    twin = default_twin()
    tilted = ScriptedPress(0.6, tilt_rad=(0.11, 0.0)).simulate(twin, FlatPunch(3.0, 0.2), CALIBRATION_SOLVER_SETTINGS)
    ball, usual = sensor.stored_image("ball").image, FlatEndGauge()
    for image, gauge, said in (
        (reference, usual, "of the flat end a dark disc.*no contact"),
        (ball, usual, "as under a ball.*--second-ball"),
        (
            pressed,
            FlatEndGauge(radius_mm=4.5),
            "of the flat end a disc of 4.1 to 5.9 mm, for its radius of 4.5 mm.*calliper",
        ),
        (twin.renderer(tilted, 3), usual, "that lies flat.*tilt of about [567].*guide the rod"),
        (pressed, FlatEndGauge(depth_mm=2.4), "at most 1.8 mm deep in a gel of 2.5 mm, got 2.4 mm"),
    ):
        design = SensorDesign(flat_end=gauge)
        with pytest.raises((BallPressUnusable, InputError), match=said):
            find_second_presses(sensor.rectification, {"flat_end": (reference, image)}, design, "physics")
    with pytest.raises(BallPressUnusable, match="of the second ball"):
        find_second_presses(sensor.rectification, {"second_ball": flat_end_pair}, SensorDesign(), "physics")


def test_a_second_ball_that_cannot_be_used_is_named(
    with_second_ball: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = with_second_ball.path / "images"
    four = ["--out", str(tmp_path / "new"), "--images", str(images)]
    out = ["--out", str(tmp_path / "new")]
    board = ["--board-reference", str(images / "board_reference.png"), "--board", str(images / "board.png")]
    kept = ["--out", str(with_second_ball.path)]
    ball = ["--ball-reference", str(images / "ball_reference.png"), "--ball", str(images / "ball.png")]
    flat = ["--flat-end", str(images / "ball.png")]
    for options, said in (
        ([*four, "--method", "ratio"], "the method physics for a second ball"),
        ([*four, "--second-ball-radius-mm", "1.5"], "of the second ball a disc smaller than the ball"),
        ([*out, *board, "--second-ball", str(images / "second_ball.png")], "--ball beside --second-ball"),
        ([*four, "--with-second-ball"], "--source or --page beside --with-second-ball"),
        ([*four, "--second-ball-radius-mm", "0"], "second_radius_mm"),
        (
            [*four, *flat, "--flat-end-depth-mm", "0.6"],
            "--flat-end-depth-mm beside an image of a flat end, got the depth alone",
        ),
        ([*four, *flat, "--flat-end-radius-mm", "3"], "got the radius alone; measure the rod"),
        ([*four, *flat, "--flat-end-radius-mm", "14", "--flat-end-depth-mm", "0.6"], "flat_end.radius_mm"),
        ([*four, *flat, "--flat-end-radius-mm", "3", "--flat-end-depth-mm", "2"], "at most 1.8 mm deep"),
        ([*kept, *ball, *flat, "--design.flat-end.depth-mm", "2"], "at most 1.8 mm deep"),
        ([*four, "--with-flat-end"], "give the image with --flat-end"),
        ([*out, "--source", "sim", *flat], "--with-flat-end beside --source"),
    ):
        assert main(["calibrate", *options]) == 1
        assert said in capsys.readouterr().err, said
    assert not (tmp_path / "new").exists()


def test_a_person_is_guided_through_second_presses_too() -> None:
    design, settings = SensorDesign(), CalibrationSettings(method="ratio")
    taken: dict[str, BgrImage] = {}
    with SimulatedCalibrationCamera(default_twin(), design, rate_hz=1000.0) as camera:
        for step in guided_capture_steps(design, settings, SECOND_KINDS):
            camera.follow(step.name)
            watch = step.watch(taken)
            kept = (watch(camera.read().image).image for _ in range(60))
            taken[step.name] = next(image for image in kept if image is not None)
    second = (name for kind in SECOND_KINDS for name in second_image_names(kind))
    assert list(taken) == ["board_reference", "board", "ball_reference", "ball", *second]


@pytest.mark.parametrize(("ratio", "said"), [(1.2, "softer than the gel"), (1e-6, "stiffer than glass")])
def test_a_base_that_no_sensor_has_is_refused(ratio: float, said: str) -> None:
    with pytest.raises(DesignImpossible, match=said):
        SensorDesign(gel=Gel(gel_to_base_modulus_ratio=ratio))
    with pytest.raises(DesignImpossible, match="a gel without a layer below it has"):
        Gel(base_thickness_mm=0.0)
