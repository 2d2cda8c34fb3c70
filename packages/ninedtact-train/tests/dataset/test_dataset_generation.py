"""Data sets: rows that mean what they say, the same bytes whoever makes them, and refusals in one sentence."""

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh
import tyro
from built_sets import TWINS, decoded, references_in, rows_in

from ninedtact.checked_reading import mapping_checksum
from ninedtact.errors import InputError, OutputError
from ninedtact.mechanics.indenter import Ball
from ninedtact.recording.attached_sensor import read_folder_files
from ninedtact_train.batched.session_requests import run_session_on_cpu
from ninedtact_train.cli.simulate_dataset import SimulateDatasetCommand
from ninedtact_train.collecting.training_pair_rule import PairKindShares
from ninedtact_train.dataset.dataset_card import (
    DatasetStatistics,
    compute_dataset_statistics,
)
from ninedtact_train.dataset.generation.generate import generate_dataset, make_simulated_sensor
from ninedtact_train.dataset.generation.press_session import RandomPress, session_quotas
from ninedtact_train.dataset.generation.settings import PressSettings, PressTarget
from ninedtact_train.population.mechanics_shares import MechanicsShares
from ninedtact_train.population.sensor_population import sample_sensor, sampled_sensor_from_json

MAKE = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from built_sets import TWINS
from ninedtact_train.dataset.generation.generate import generate_dataset
if __name__ == "__main__":
    generate_dataset(Path(sys.argv[1]), TWINS, int(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def rows(twins: Path) -> list[dict[str, Any]]:
    return rows_in(twins)


def test_all_pairs_are_there_in_their_shares(twins: Path, rows: list[dict[str, Any]]) -> None:
    kinds = compute_dataset_statistics(sorted((twins / "data").iterdir())).kinds
    assert kinds == {"light_touch": 2, "no_contact": 2, "rule": 14}
    assert len(rows) == len({row["id"] for row in rows}) == TWINS.pairs
    assert {row["sensor"] for row in rows} == {"twin_0_000", "twin_0_001"}
    assert {row["object"] for row in rows} == {*TWINS.object_names, "none"}


@pytest.mark.parametrize(
    ("shares", "per_session"),
    [((0.5, 0.5), 1), ((0.25, 0.3), 1), ((0.05, 0.05), 1), ((0.5, 0.5), 3), ((0.03, 0.05), 50)],
)
def test_every_session_makes_its_number_of_pairs_and_all_together_the_shares(
    shares: tuple[float, float], per_session: int
) -> None:
    settings = replace(TWINS, pairs=203, sensors=1, session_pairs=per_session, shares=PairKindShares(*shares))
    quotas = [session_quotas(number, settings) for number in range(settings.sessions)]
    assert [sum(one.values()) for one in quotas] == [per_session] * (203 // per_session) + [203 % per_session] * (
        per_session > 1
    )
    assert min(min(one.values()) for one in quotas) >= 0
    totals = {kind: sum(one[kind] for one in quotas) for kind in quotas[0]}
    assert totals["no_contact"] == pytest.approx(203 * shares[0], abs=0.5)
    assert totals["light_touch"] == pytest.approx(203 * shares[1], abs=1.6)


def test_kinds_mean_what_they_say(rows: list[dict[str, Any]]) -> None:
    by_kind = {
        kind: np.array([row["wrench"] for row in rows if row["kind"] == kind]) for kind in PairKindShares().__dict__
    }
    assert not by_kind["no_contact"].any()
    assert (np.abs(by_kind["light_touch"][:, 2]) < 0.3).all()
    assert (by_kind["light_touch"][:, 2] < 0).all()
    assert all(row["wrench"][2] < -0.3 for row in rows if row["kind"] == "rule")
    assert all((row["object"] == "none") == (row["kind"] == "no_contact") for row in rows)


def test_pairs_of_one_contact_differ_as_the_rule_wants(rows: list[dict[str, Any]]) -> None:
    contacts: dict[object, list[np.ndarray]] = {}
    for row in rows:
        if row["kind"] == "rule":
            contacts.setdefault(row["contact_id"], []).append(np.array(row["wrench"]))
    assert len(contacts) > 3
    for six in contacts.values():
        apart = [np.abs(a - b) @ (1 / 6, 1 / 6, 1 / 12, 0, 0, 10) for k, a in enumerate(six) for b in six[:k]]
        assert min(apart, default=1) > 0.25


def test_images_show_what_the_wrench_says(twins: Path, rows: list[dict[str, Any]]) -> None:
    untouched = {name: image.astype(float) for name, image in references_in(twins).items()}
    change: dict[str, list[float]] = {kind: [] for kind in ("no_contact", "light_touch", "rule")}
    for row in rows:
        image = decoded(row["image"]).astype(float)
        assert image.shape == (48, 64)
        change[row["kind"]].append(np.abs(image - untouched[row["reference_id"]]).max())
    assert max(change["no_contact"]) <= 3
    assert np.median(change["rule"]) > 6


def test_everything_to_make_it_again_is_beside_it(twins: Path) -> None:
    kept = json.loads((twins / "settings.json").read_text())
    assert kept["seed"] == 0
    assert kept["object_names"] == list(TWINS.object_names)
    sensors = json.loads((twins / "sensors.json").read_text())
    wanted = json.loads(json.dumps(sample_sensor(1).to_json_dict()))
    assert sensors[1] == {**wanted, "checksum": mapping_checksum(wanted)}
    card = (twins / "README.md").read_text()
    assert "data/train-*.parquet" in card
    assert "2 no_contact" in card


def test_a_killed_job_goes_on_with_any_number_of_workers_and_ends_with_the_same_bytes(
    twins: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "killed"
    job = subprocess.Popen([sys.executable, "-c", MAKE, str(folder), "1"])
    first, until = folder / "data" / "train-00000-of-00003.parquet", monotonic() + 60
    while not first.is_file() and job.poll() is None and monotonic() < until:
        sleep(0.01)
    job.send_signal(signal.SIGKILL)
    job.wait()
    (folder / "data" / ".abc.partial").write_bytes(b"half")
    assert 1 <= len(list((folder / "data").glob("train-*"))) < TWINS.files
    subprocess.run([sys.executable, "-c", MAKE, str(folder), "2"], check=True)
    assert read_folder_files(folder) == read_folder_files(twins)


def test_another_mesh_in_the_same_file_is_another_data_set(tmp_path: Path) -> None:
    part = tmp_path / "part.stl"
    settings = replace(TWINS, pairs=2, sensors=1, object_names=(f"{part}@+z",))
    trimesh.creation.icosphere(radius=3).export(part)
    made = [generate_dataset(tmp_path / "ball", settings)]
    assert generate_dataset(tmp_path / "ball", settings).new_files == 0
    trimesh.creation.box((6, 6, 6)).export(part)
    with pytest.raises(OutputError, match="mesh_digests"):
        generate_dataset(tmp_path / "ball", settings)
    made.append(generate_dataset(tmp_path / "box", settings))
    ball, box = (pq.read_table(next((one.folder / "data").iterdir()))["image"].to_pylist() for one in made)
    assert ball != box


@pytest.mark.parametrize(
    "wrong",
    [
        {"pairs": -5},
        {"sensors": 0},
        {"objects": 0},
        {"seed": -1},
        {"objects_seed": -1},
        {"size": (4, 3)},
        {"pitch_mm": 0.0},
        {"pitch_mm": float("nan")},
        {"light_below_n": 0.0},
    ],
    ids=str,
)
def test_settings_that_make_no_data_set_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected"):
        replace(TWINS, **wrong)


def test_shares_objects_and_workers_are_checked_before_work_begins(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="shares"):
        PairKindShares(0.8, 0.3)
    with pytest.raises(InputError, match="expected"):
        generate_dataset(tmp_path / "a", replace(TWINS, object_names=("unicorn_01",)))
    with pytest.raises(InputError, match="worker"):
        generate_dataset(tmp_path / "b", TWINS, workers=0)
    assert not list(tmp_path.iterdir())


def test_a_hand_reaches_its_load_and_leans_as_it_wants() -> None:
    for kinds in (MechanicsShares(0, 0), MechanicsShares(1, 0), MechanicsShares(0, 1)):
        touch = RandomPress(
            make_simulated_sensor(6, replace(TWINS, pitch_mm=0.3, mechanics=kinds)),
            Ball(),
            PressSettings(),
            np.random.default_rng(0),
        )
        aim = PressTarget(6.0, np.array([1.0, -0.6]), 0.05, np.array([0.03, -0.04]))
        for _ in range(6):
            felt = run_session_on_cpu(touch.step_towards(aim))
        assert felt is not None
        assert felt.wrench.force_n == pytest.approx([1.0, -0.6, -6.0], rel=0.06, abs=0.03)


def test_a_design_of_its_own_is_pressed_seen_and_written_down(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "wide.toml").write_text("[sensing_area]\nwidth_mm = 36\nheight_mm = 27\n[camera]\ndistance_mm = 21\n")
    options = "--pairs 4 --sensors 1 --size 36 27 --object-names ball:4 --pitch-mm 0.5 --workers 1 --json"
    folder = ["--out", str(tmp_path / "wide"), "--design", str(tmp_path / "wide.toml")]
    assert tyro.cli(SimulateDatasetCommand, args=[*folder, *options.split()]).run() == 0
    told = json.loads(capsys.readouterr().out)
    assert told["pairs"] == 4 and len(told["percentiles"]["Fz"]) == 3
    rows = pq.read_table(next((tmp_path / "wide" / "data").iterdir())).to_pylist()
    assert {round(row["mm_per_px"], 2) for row in rows} == {1.0}
    assert "36 mm across" in (tmp_path / "wide" / "README.md").read_text()
    (sensor,) = json.loads((tmp_path / "wide" / "sensors.json").read_text())
    assert sampled_sensor_from_json(sensor).design.sensing_area.width_mm == 36


def test_torques_move_to_the_paper_s_sensor() -> None:
    """T_y ≈ +0.033 m F_x and T_x ≈ −0.037 m F_y: FACTS, from the real wrenches."""
    moved = DatasetStatistics({}, {}, {}, np.array([[1.0, 2.0, -7.0, 0.0, 0.0, 0.001]])).percentiles
    assert moved[:, 1] == pytest.approx([1, 2, -7, -0.07, 0.035, 0.001])
