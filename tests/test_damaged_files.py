"""Damaged, edited and missing files of every kind that is read: refused in one sentence, or nothing is silently different.

A case is handled well where the file is refused in one sentence with exit code 1, where the result carries a warning that the
result for the original file does not carry, or where the result is the same: within three of its stated standard deviations, or
exactly where none is stated. What an author states (a design, a mesh, a table) has no checksum: another possible value in it is
another design. NINEDTACT_DAMAGED_CASES is the number of cases of each kind; `make damaged` prints the table of docs/reliability.md.
"""

import io
import json
import os
import shutil
import sys
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, Phase, given, note, settings
from hypothesis import strategies as st
from linear_model import a_card, linear_model

import ninedtact
from damage import (
    PLACES,
    Kind,
    Run,
    commands,
    damaged_array,
    damaged_bytes,
    damaged_text,
    printing,
    put,
    restore,
    run_forked,
)
from ninedtact import Frame, SensorFolder, Wrench
from ninedtact.calibration.original_9dtact.folder_format import ORIGINAL_FILES
from ninedtact.calibration.original_9dtact.import_export import export_original_calibration
from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE
from ninedtact.capture.camera_delay import CameraDelay, read_camera_delay, write_camera_delay
from ninedtact.design import design_to_toml, read_design_file
from ninedtact.force.estimator_and_scale import ForceScale, write_force_scale
from ninedtact.force.onnx_model import (
    CHECKSUM_METADATA_KEY,
    CHECKSUM_PLACEHOLDER,
    METADATA_KEY,
    stamp_checksum,
)
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.deblurring import Deblurring
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.design_file import hardware_design_to_toml, read_hardware_design
from ninedtact_train.dataset import load_dataset
from ninedtact_train.evaluation.predictions import WrenchPredictions, write_predictions

CASES = int(os.environ.get("NINEDTACT_DAMAGED_CASES", "1"))
OUTCOMES = ("refused", "warned", "same result", "taken as written")
VOLATILE = ("image", "time_ns", "files", "folder", "report", "sensor", "out")
"""Keys whose values are paths or the time of day."""
STATED_ERRORS = {"max_indentation_mm": "max_indentation_error_mm", **{f"F{axis}_N": f"eF{axis}" for axis in "xyz"}}
STATED_ERRORS |= {f"T{axis}_Nm": f"eT{axis}" for axis in "xyz"}
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="cases run in forked processes")


def sensor_kinds(sensor: Path, folder: Path) -> Iterator[tuple[str, Kind]]:
    """Yield the files of sensors and designs, and images and recordings of a press."""
    ball, reference = sensor / "images/ball.png", sensor / "images/ball_reference.png"
    estimate = f"estimate --sensor {sensor} --reference {reference} --json"
    reconstruct = f"reconstruct --sensor {sensor} --reference {reference} --out OUT --formats npy --no-drawings --json"
    yield (
        "sensor.toml",
        Kind(sensor / SENSOR_FILE, commands(f"{reconstruct} {ball}", f"{estimate} {ball}"), damaged_text),
    )
    scaled = folder / "scaled"
    shutil.copytree(sensor, scaled)
    physics = ninedtact.load_sensor(sensor).estimator("physics")
    write_force_scale(scaled, physics, ForceScale(1.08, 0.04, 5))
    weighed = commands(f"estimate --sensor {scaled} --reference {reference} --json {ball}")
    yield "force.toml", Kind(scaled / "force.toml", weighed, damaged_text)
    delay = write_camera_delay(folder, CameraDelay(42.1, 1.3, "camera usb:1-2", 29.9, 0.98))
    yield "camera.toml", Kind(delay, printing(lambda out: msgspec.to_builtins(read_camera_delay(folder))), damaged_text)
    design, hardware = folder / "design.toml", folder / "hardware.toml"
    design.write_text(design_to_toml(ninedtact.load_sensor(sensor).record.design))
    hardware.write_text(hardware_design_to_toml(HardwareDesign()))
    read_design = printing(lambda out: msgspec.to_builtins(read_design_file(design)))
    yield "design", Kind(design, read_design, damaged_text, is_authored=True)
    check = commands(f"hardware check --design {hardware} --json")
    if CASES == 1:  # the check builds all solids
        check = printing(lambda out: asdict(read_hardware_design(hardware, "default")))
    yield "hardware design", Kind(hardware, check, damaged_text, is_authored=True)
    model = folder / "model.onnx"
    model.write_bytes(with_card(None))
    by_model = commands(f"{estimate} --force {model} {ball}")
    yield "force model", Kind(model, by_model)
    yield "force model, card", Kind(model, by_model, damaged_text, card_of(model.read_bytes()), with_card)
    original = folder / "original"
    export_original_calibration(ninedtact.load_sensor(sensor), original / "sensor_1")
    imported = commands(
        f"import-calibration {original} --out OUT --json",
        f"reconstruct --sensor OUT --reference {reference} --out OUTr --formats npy --no-drawings --json {ball}",
    )
    for file in ORIGINAL_FILES:
        authored = "index" not in Path(file).name  # the maps follow from images alone
        yield (
            f"original {Path(file).name}",
            Kind(original / "sensor_1" / file, imported, damaged_array, is_authored=authored),
        )
    for name, ending in (("ball", "png"), ("ball_reference", "png"), ("ball", "jpg"), ("ball", "bmp")):
        path = folder / f"{name}.{ending}"
        cv2.imwrite(str(path), cv2.imread(str(sensor / "images" / f"{name}.png")))
        pair = f"--reference {folder / 'ball_reference.png'} --json {folder / f'ball.{ending}'}"
        yield f"image {path.name}", Kind(path, commands(f"estimate --sensor {sensor} {pair}"))
    images = [cv2.imread(str(path)) for path in (reference, ball)]
    for name, codec in (("press.avi", "MJPG"), ("press.mp4", "mp4v"), ("press.mkv", "FFV1")):
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter.fourcc(*codec), 30.0, images[0].shape[1::-1])
        for number in range(5):
            writer.write(images[number // 2 % 2])
        writer.release()
        yield f"video {name}", Kind(folder / name, commands(f"{estimate} {folder / name}"))
    recording = folder / "press.mcap"
    metadata = RecordingMetadata("damaged", mm_per_px=0.05, software="0.1", id="one", wall_minus_monotonic_ns=10**18)
    topics = [Topic.IMAGES, Topic.MEASURED]
    with RecordingWriter(recording, metadata, topics, sensor_folder_attachments(sensor)) as writer:
        for number in range(12):
            writer.write_image(Frame(images[number // 10], 10**9 + number * 33_000_000, number))
            writer.write_measured(
                Wrench(np.array([0.1, 0.2, -number]), np.zeros(3), stamp_ns=10**9 + number * 33_000_000)
            )
    read = commands(f"info {recording} --json", f"estimate --json {recording}", f"export {recording} --out OUT --json")
    yield "recording", Kind(recording, read)


def card_of(model: bytes) -> bytes:
    """Return the card in an ONNX file, with line breaks."""
    import onnx

    entries = onnx.load_from_string(model).metadata_props
    return json.dumps(json.loads(next(one.value for one in entries if one.key == METADATA_KEY)), indent=1).encode()


def with_card(card: bytes | None) -> bytes:
    """Return a force model with a checksum, and with another card under the same checksum if one is given."""
    import onnx

    graph = linear_model(a_card())
    graph.metadata_props.add(key=CHECKSUM_METADATA_KEY, value=CHECKSUM_PLACEHOLDER)
    stamped = stamp_checksum(graph.SerializeToString())
    if card is None:
        return stamped
    graph = onnx.load_from_string(stamped)
    next(one for one in graph.metadata_props if one.key == METADATA_KEY).value = card.decode(errors="replace")
    return bytes(graph.SerializeToString())


def data_kinds(folder: Path) -> Iterator[tuple[str, Kind]]:
    """Yield the files of data sets, those of other projects, caches, predictions and meshes."""
    data, built, cache = folder / "generated", folder / "built", folder / "cache"
    size = "--pairs 4 --sensors 1 --objects 1 --size 64 48 --pitch-mm 0.5"
    generate = f"simulate dataset --out {data} {size} --workers 1 --json"
    build = f"dataset build {data} --out {built} --workers 1 --json"
    assert commands(generate, build)(folder) == 0
    rebuild = commands(generate, build.replace(str(built), "OUT"))

    def read(path: Path, cache: Path) -> Any:
        found = load_dataset(path, (32, 24), cache)
        batch = next(found.batches(100))
        return [
            found.ids.tolist(),
            found.wrenches.tolist(),
            batch.images.sum((1, 2)).tolist(),
            found.objects.tolist(),
        ]

    for name in ("settings.json", "sensors.json"):
        (path,) = data.rglob(name)
        yield f"data set, {name}", Kind(path, rebuild, damaged_text)
    (report,) = built.rglob("report.json")
    yield "data set, report.json", Kind(report, commands(build), damaged_text)
    check = commands(f"dataset check {data} --report OUT --workers 1 --json")
    reading = printing(lambda out: read(data, out / "cache"))
    for path in (*data.rglob("train*.parquet"), *data.rglob("references.parquet")):
        yield f"Parquet, {path.name.split('-')[0]}", Kind(path, lambda out: check(out) or reading(out))
    read(data, cache)
    for path in sorted(cache.glob("*/*.npy")):
        head = partial(lambda tail, head: head + tail, path.read_bytes()[128:])  # damage of the pixels is not found
        yield (
            f"cache, {path.name}",
            Kind(path, printing(lambda out: read(data, cache)), damaged_bytes, path.read_bytes()[:128], head),
        )
    rng = np.random.default_rng(0)
    truth = rng.normal(0, [1, 1, 4, 0.05, 0.05, 0.02], (40, 6)) - np.array([0, 0, 6, 0, 0, 0])
    predictions = folder / "predictions.csv"
    write_predictions(predictions, WrenchPredictions(truth, truth * 1.1, np.abs(0.1 * truth) + 1e-3))
    evaluate = commands(f"evaluate --predictions {predictions} --json")
    yield "predictions (CSV)", Kind(predictions, evaluate, damaged_text, is_authored=True)
    skin, episode = rng.integers(130, 150, (24, 24, 3), np.uint8), folder / "episode.npz"
    force = -np.arange(5.0)[:, None] * [0.1, 0, 1, 0, 0, 0] + 1.5
    arrays = {"6d_force": force, "ref_force": np.full(6, 1.5), "ref_frame": skin, "probe": np.array(3)}
    np.savez_compressed(episode, tactile_img=np.array([skin - np.uint8(3 * load) for load in range(5)]), **arrays)  # type: ignore[arg-type]
    with zipfile.ZipFile(episode) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def zipped(force_file: bytes) -> bytes:
        written = io.BytesIO()
        with zipfile.ZipFile(written, "w") as changed:
            for name, content in {**members, "6d_force.npy": force_file}.items():
                changed.writestr(name, content)
        return written.getvalue()

    load = commands(f"dataset build {episode} --out OUT --workers 1 --json")
    yield "episode (.npz)", Kind(episode, load, is_authored=True)
    yield "episode, wrenches", Kind(episode, load, damaged_array, members["6d_force.npy"], zipped, is_authored=True)
    pairs = folder / "Dataset"
    for number in range(4):
        wrench = np.array([0.2, -0.1, -1.0 - number, 0.01, 0.02, 0.001])
        normalised = (wrench + np.array([3, 3, 12, 0.2, 0.2, 0.05])) / [6, 6, 12, 0.4, 0.4, 0.1]
        for name, numbers in ((f"{number}", wrench), (f"{number}_norm", normalised)):
            (pairs / "wrench/1").mkdir(parents=True, exist_ok=True)
            np.save(pairs / f"wrench/1/{name}.npy", numbers)
        (pairs / "image/1").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(pairs / f"image/1/{number}.png"), skin - np.uint8(number))
    cv2.imwrite(str(folder / "skin.png"), skin)
    load = commands(f"dataset build {pairs} --reference {folder / 'skin.png'} --out OUT --workers 1 --json")
    yield "wrench (.npy)", Kind(pairs / "wrench/1/2.npy", load, damaged_array, is_authored=True)
    pyramid = trimesh.creation.cone(5, 6, sections=5)
    pyramid.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    for ending in ("stl", "obj", "ply", "off", "glb"):
        pyramid.export(path := folder / f"pyramid.{ending}")
        damage = damaged_text if ending in ("obj", "off") else damaged_bytes
        yield (
            f"mesh, .{ending}",
            Kind(path, printing(lambda out, path=path: heights_of(path)), damage, is_authored=True),
        )
    strange = folder / "strange.obj"
    strange.write_bytes((folder / "pyramid.obj").read_bytes())
    yield "mesh, strange", Kind(strange, printing(lambda out: heights_of(strange)), strange_meshes, is_authored=True)


def heights_of(path: Path) -> dict[str, Any]:
    """Return what is read of a mesh as an object, with the warnings about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        heights = indenter_from_name(str(path)).heights_mm  # type: ignore[attr-defined]
    return {"sum": float(heights[np.isfinite(heights)].sum()), "warnings": [str(each.message) for each in said]}


def strange_meshes(content: bytes) -> st.SearchStrategy[tuple[str, bytes]]:
    """Draw meshes (.obj) that are huge, microscopic, flat, open, inside out, far away, of one triangle, or name a device."""
    corners, faces = (
        np.array([[-5.0, -5, 3], [5, -5, 3], [0, 6, 3], [0, 0, 0]]),
        np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]),
    )
    shapes = {f"x {scale:g}": (corners * scale, faces) for scale in (1e-9, 1e-3, 0.2, 12, 1e3, 1e30, 1e300)}
    shapes |= {
        "one triangle": (corners, faces[1:2]),
        "flat": (corners * [1, 1, 0], faces),
        "needle": (corners * [0.03, 0.03, 2000], faces),
        "thrice": (corners, np.repeat(faces, 3, 0)),
        "inside out": (corners, faces[:, ::-1]),
        "open": (corners, faces[:-1]),
        "no triangle": (corners, faces[:0]),
        "missing corner": (corners, faces + 5),
        "negative corner": (corners, faces - 9),
        "unused corner at infinity": (np.vstack([corners, [np.inf, 0, 0]]), faces),
        "NaN": (corners * [1, 1, np.nan], faces),
        "20,000 sheets": (corners * [5, 5, 0], np.tile(faces[:2], (10_000, 1))),
        "far away": (corners + 1e7, faces),
    }
    texts = {
        name: "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in c)
        + "".join(f"f {a} {b} {d}\n" for a, b, d in f + 1)
        for name, (c, f) in shapes.items()
    }
    texts["material from a device"] = "mtllib /dev/zero\nusemtl one\n" + texts["x 0.2"]
    return st.sampled_from([(name, text.encode()) for name, text in texts.items()])


def outcome(run: Run, usual: Run, is_authored: bool) -> str:
    """Return how a case was handled; raises AssertionError where it was handled badly."""
    said = [line for line in run.complaints.splitlines() if line.strip()]
    if run.code == 1:
        assert said and "expected" in said[-1] and "Traceback" not in run.complaints, f"no sentence: {said[-1:]}"
        return "refused"
    assert run.code == 0, f"exit code {run.code}: {said[-1:]}"
    if warnings_of(run) - warnings_of(usual):
        return "warned"
    if is_same(values_of(run), values_of(usual)):
        return "same result"
    assert is_authored, f"another result without a warning: {run.printed} in place of {usual.printed}"
    return "taken as written"


def values_of(run: Run) -> list[Any]:
    """Return the JSON values that a process printed."""
    values, text = [], run.printed.strip()
    while text:
        value, end = json.JSONDecoder().raw_decode(text)
        values, text = [*values, value], text[end:].lstrip()
    return values


def warnings_of(run: Run) -> Counter[str]:
    """Return all that is said on standard error and under keys of warnings, and whether a source ended before its end."""
    found = Counter(line for line in run.complaints.splitlines() if line.startswith("ninedtact: "))
    rest = values_of(run)
    while rest:
        value = rest.pop()
        if isinstance(value, dict):
            found["cut short"] += value.get("finished") is False
            for key in ("warnings", "notices", "findings", "faults"):
                found.update(map(str, value.get(key) or ()))
            rest += value.values()
        elif isinstance(value, list):
            rest += value
    return found


def is_same(one: Any, other: Any) -> bool:
    """Return whether results are the same: within three stated deviations, or exactly where none is stated."""
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(is_same, one, other))
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return bool(one == other) or (one != one and other != other)
    stated = {key: error for key, error in STATED_ERRORS.items() if error in one and error in other}
    if stated:
        sizes = {key: (one[error] or np.inf, other[error] or np.inf) for key, error in stated.items()}
        near = (
            abs(one[key] - other[key]) <= 3 * size[0] and size[1] / 2 <= size[0] <= 2 * size[1]
            for key, size in sizes.items()
        )
        return all(near)
    return one.keys() == other.keys() and all(is_same(one[key], other[key]) for key in one if key not in VOLATILE)


@pytest.fixture(scope="module")
def kinds(twin_sensor: SensorFolder) -> Iterator[dict[str, Kind]]:
    """One file of every kind, with the work that reads it."""
    cv2.setNumThreads(1)
    with TemporaryDirectory(prefix="damaged_") as name:  # other users may enter it, unlike the folders of pytest
        folder = Path(name)
        sensor = write_sensor_with_physics(twin_sensor, folder / "sensor")
        yield {**dict(sensor_kinds(sensor, folder)), **dict(data_kinds(folder))}


def write_sensor_with_physics(twin_sensor: SensorFolder, sensor: Path) -> Path:
    """Write a sensor with the bulges and the point spread that force by physics needs."""
    usual = twin_sensor.record.depth
    curve = replace(usual.curve, brightening=(0.0, 0.36), bulge_mm=(0.0, 1.0))
    depth = msgspec.structs.replace(usual, curve=curve, deblurring=Deblurring(0.45))
    (sensor / "images").mkdir(parents=True)
    for image in (twin_sensor.path / "images").iterdir():
        (sensor / "images" / image.name).write_bytes(image.read_bytes())
    (sensor / SENSOR_FILE).write_bytes(to_sensor_toml(msgspec.structs.replace(twin_sensor.record, depth=depth)))
    return sensor


@pytest.mark.parametrize("part", range(4))
def test_damaged_files_are_refused_or_change_nothing_silently(
    part: int, kinds: dict[str, Kind], capsys: pytest.CaptureFixture[str]
) -> None:
    rows = {name: outcomes_of(name, kind) for name, kind in list(kinds.items())[part::4]}
    with capsys.disabled():
        if "NINEDTACT_DAMAGED_CASES" in os.environ:
            for name, found in rows.items():
                counts = (found.total(), *(found[each] for each in OUTCOMES))
                print(f"| {name} | {' | '.join(map(str, counts))} |")


@cache
def usual_run(work: Callable[[Path], int]) -> Run:
    """Work on whole files, in this process, so that what is needed is imported once."""
    said, complained = io.StringIO(), io.StringIO()
    with TemporaryDirectory(prefix="results_") as folder, redirect_stdout(said), redirect_stderr(complained):
        code = work(Path(folder))
    return Run(code, said.getvalue(), complained.getvalue())


def outcomes_of(name: str, kind: Kind) -> Counter[str]:
    """Damage the file of a kind again and again; return how often each outcome came."""
    content, found, usual = kind.path.read_bytes(), Counter[str](), usual_run(kind.work)
    assert usual.code == 0, (name, usual)

    def judge(damage: str, change: Callable[[], object]) -> None:
        try:
            change()
            with TemporaryDirectory(prefix="results_") as folder:
                run = run_forked(kind.work, Path(folder), unprivileged=damage == "unreadable")
        finally:
            restore(kind.path, content)
        try:
            found[outcome(run, usual, kind.is_authored)] += 1
        except AssertionError as bad:
            raise AssertionError(f"{name}, {damage}: {bad}") from None

    @settings(
        max_examples=CASES, phases=[Phase.generate], derandomize=CASES == 1, suppress_health_check=list(HealthCheck)
    )
    @given(kind.damage(content if kind.part is None else kind.part))
    def damage_bytes(damaged: tuple[str, bytes]) -> None:
        note(damaged[0])
        judge(damaged[0], lambda: kind.path.write_bytes(kind.whole(damaged[1])))

    damage_bytes()
    for place in PLACES if CASES > 1 else ():
        judge(place, lambda place=place: put(kind.path, place))
    return found
