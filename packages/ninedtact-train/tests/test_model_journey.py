"""From nothing to a force model of one's own design with one command, as small as it can be; and what a model's card says."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.force.onnx_model import read_force_model

MAKE_SMALLEST = """
import sys
from itertools import islice
from pathlib import Path
import ninedtact
from ninedtact.cli import main
from ninedtact_train.workflows.force_model_from_simulation import RECIPES, ForceModelRecipe
if __name__ == "__main__":
    RECIPES["small"] = ForceModelRecipe(
        24, 1, 1, 20, 1, held_out="standard", pitch_mm=0.4, validation_pitch_mm=0.4
    )
    code = main(["model", "make", "--out", sys.argv[1], "--design", sys.argv[2], "--workers", "1", "--json"])
    (sensor,) = (Path(sys.argv[1]) / "validation_data" / "sensors").iterdir()
    with ninedtact.open(sensor, "sim", str(Path(sys.argv[1]) / "model.onnx")) as live:
        is_estimated = any(reading.force.touching and reading.force.wrench.six.any() for reading in islice(live, 100))
        sys.exit(code or not is_estimated)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a model was made, and tried on a twin, in a process without type checks, which would take minutes."""
    folder = tmp_path_factory.mktemp("model")
    (folder / "wider.toml").write_text("[sensing_area]\nwidth_mm = 27\nheight_mm = 20\n[camera]\ndistance_mm = 15.5\n")
    command = [sys.executable, "-c", MAKE_SMALLEST, str(folder / "made"), str(folder / "wider.toml")]
    subprocess.run(command, check=True)
    return folder / "made"


def test_the_model_is_that_of_the_design_and_its_card_tells_what_it_was_judged_on(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    card = read_force_model(made / "model.onnx").card
    assert card.input.mm_per_px == pytest.approx(0.3 * 27 / 24)
    (sensor,) = (made / "validation_data" / "sensors").iterdir()
    assert load_sensor(sensor).record.design.sensing_area.width_mm == 27
    table = card.evaluation["all"]
    assert table["pairs"] == 20 and len(table["skill"]) == len(table["skill_35_mm_below"]) == 6
    assert table["no_contact"]["largest_force_n"] == 0
    assert card.evaluation["all, by physics"]["pairs"] == table["pairs"]
    page = (made / "model_card.md").read_text()
    assert "Not yet tested against a real force/torque sensor" in page and f"{table['skill'][0]:.3f}" in page
    assert main(["model", "card", "--model", str(made / "model.onnx")]) == 0
    assert capsys.readouterr().out.strip() == page.strip()


def test_physics_is_evaluated_on_the_same_pairs_by_the_sensors_that_were_calibrated(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def evaluated(*words: object) -> dict:
        assert main(["evaluate", *map(str, words), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    data, report = made / "validation_data", tmp_path / "report"
    found = evaluated("--data", data, "--workers", "1", "--out", report)
    assert found["pairs"] == 20 and found["skill"][2] > 0.4 and found["no_contact"]["largest_force_n"] == 0
    by_physics = read_force_model(made / "model.onnx").card.evaluation["all, by physics"]
    assert min(found["skill"][2], by_physics["skill"][2]) > 0.7, (
        "with the assumed modulus, and with that of known loads"
    )
    assert by_physics["skill"] != found["skill"]
    again = evaluated("--predictions", report / "predictions.csv", "--trust-units")
    assert again["skill"] == pytest.approx(found["skill"])
    assert main(["evaluate", "--data", str(data), "--predictions", "some.csv"]) == 1
    assert main(["evaluate"]) == 1
    assert "got neither" in capsys.readouterr().err


def test_what_is_judged_on_was_never_learnt(made: Path) -> None:
    learnt, judged = (
        (
            {sensor["name"] for sensor in json.loads((made / name / "sensors.json").read_text())},
            {
                name.rsplit("_", 1)[0]
                for name in json.loads((made / name / "settings.json").read_text())["object_names"]
            },
        )
        for name in ("training_data", "validation_data")
    )
    assert not learnt[0] & judged[0] and not learnt[1] & judged[1]


def test_what_a_model_command_cannot_do_is_said(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model", "card", "--model", str(made / "lost.onnx")]) == 1
    assert "lost.onnx" in capsys.readouterr().err
    assert main(["evaluate", "--data", str(made / "validation_data"), "--without-contact-detection"]) == 1
    assert "drop --without-contact-detection" in capsys.readouterr().err
