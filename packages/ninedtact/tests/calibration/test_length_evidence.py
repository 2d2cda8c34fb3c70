"""Wrong lengths: what sensors of one design share says of them, and right ones are left in peace."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.certificate.checks import LENGTH_CHECKS, compute_certificate_checks
from ninedtact.calibration.certificate.length_evidence import (
    LengthClue,
    ball_clues,
    board_clues,
    probabilities_of_wrong_lengths,
)
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.sensor_toml_schema import LengthPlausibility
from ninedtact.cli import main
from ninedtact.design import PUBLISHED_MM_PER_PX, SensorDesign
from ninedtact.simulation.gel_brightness import FITTED_PARAMETERS, BrightnessModel

DESIGN = SensorDesign()
LIMIT = LENGTH_CHECKS[0].limit.good
USUAL = {name: one.median for name, one in FITTED_PARAMETERS.items() if name != "relative_thickness"}
MIDDLE = [
    *board_clues(PUBLISHED_MM_PER_PX, 640, 0.63, 0.48, DESIGN),
    *ball_clues(
        BrightnessModel(**USUAL),
        replace(DESIGN.gel, thickness_mm=DESIGN.gel.thickness_mm * FITTED_PARAMETERS["relative_thickness"].median),
        DESIGN,
    ),
]
"""The clues of a sensor in the middle of all."""


def seen_with(pitch: float = 1.0, radius: float = 1.0, clues: list[LengthClue] = MIDDLE) -> LengthPlausibility:
    """What is said where the stated lengths are these times the true ones."""
    shifted = [
        replace(one, log_ratio=one.log_ratio + one.per_pitch * np.log(pitch) + one.per_radius * np.log(radius))
        for one in clues
    ]
    return probabilities_of_wrong_lengths(shifted, DESIGN)


def test_the_middle_of_all_sensors_is_the_least_suspected() -> None:
    assert all(abs(one.log_ratio) < 0.01 for one in MIDDLE)
    middle = seen_with()
    assert middle.wrong_probability < 0.06 and middle.likely_pitch_mm == pytest.approx(2.5, rel=0.01)


@pytest.mark.parametrize("factor", [0.8, 0.85, 0.9, 1.1, 1.15, 1.2])
def test_a_wrong_pitch_is_noticed_and_the_true_one_named(factor: float) -> None:
    found = seen_with(pitch=factor)
    assert found.pitch_wrong_probability > LIMIT > found.ball_radius_wrong_probability
    assert found.likely_pitch_mm == pytest.approx(2.5 / factor, rel=0.03)


@pytest.mark.parametrize("one", range(len(MIDDLE)))
@pytest.mark.parametrize("far", [-8.0, 8.0])
def test_one_clue_alone_however_far_is_a_sensor_unlike_others(one: int, far: float) -> None:
    clues = [
        replace(clue, log_ratio=clue.log_ratio + (far * clue.spread if n == one else 0))
        for n, clue in enumerate(MIDDLE)
    ]
    assert probabilities_of_wrong_lengths(clues, DESIGN).wrong_probability < 0.25


@pytest.mark.parametrize("sensor", ["a", "j"])
def test_a_real_board_tells_a_wrong_pitch_without_a_ball(
    sensor: str, real_images: dict[str, CalibrationImages]
) -> None:
    board = replace(real_images[sensor], ball_reference=None, ball=None)

    def level(factor: float) -> str:
        design = replace(DESIGN, pin_board=replace(DESIGN.pin_board, pitch_mm=2.5 * factor))
        certificate = calibrate(board, design).record.certificate
        assert certificate is not None
        lines = compute_certificate_checks(certificate)
        return next(line.level for line in lines if line.text.startswith("Lengths"))

    assert [level(factor) for factor in (0.85, 1.0, 1.2)] == ["warn", "pass", "warn"]


def test_the_command_says_that_a_pitch_is_wrong_and_what_it_affects(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = real_data / "sensor_i"
    pair = ["--board-reference", str(images / "board_reference.png"), "--board", str(images / "board.png")]
    wrong = ["--design.pin-board.pitch-mm", "3.1", "--out", str(tmp_path / "sensor")]
    assert main(["calibrate", *pair, *wrong]) == 0
    said = capsys.readouterr().out
    assert "1 of 6 checks warned (affects shape, force and twin)" in said
    assert "warn (affects shape, force and twin): Lengths: " in said and "a pitch of 2.5 mm fits better" in said
    assert "This affects shape, force and twin." in (tmp_path / "sensor" / "certificate.html").read_text()
