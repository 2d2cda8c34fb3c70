"""The kinds of files that `mutated_files` mutates: a real one of each, and the commands that read it."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
from file_mutations import (
    PLACES,
    Mutation,
    Place,
    array_mutations,
    byte_mutations,
    model_card_mutations,
    place_mutations,
    text_mutations,
)
from mutated_data_and_objects import cache_files, foreign_data_files, generated_data_set_files, meshes, videos
from mutated_files import FileKind, command, quietly, refusing
from real_images import sensor_folders

from ninedtact import default_twin, load_estimator, load_sensor, read_image
from ninedtact.calibration.original_9dtact.folder_format import ORIGINAL_FILES
from ninedtact.calibration.original_9dtact.import_export import export_original_calibration
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.capture.camera_delay import (
    CameraDelay,
    read_camera_delay,
    resolve_camera_delay_ms,
    write_camera_delay,
)
from ninedtact.design import design_to_toml
from ninedtact.force.known_load_scale import ForceScale, write_force_scale
from ninedtact.force.onnx_model import (
    CHECKSUM_METADATA_KEY,
    CHECKSUM_PLACEHOLDER,
    METADATA_KEY,
    SHIPPED_MODEL,
    stamp_checksum,
)
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import sensor_folder_attachments
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact_hardware.design import default_hardware_design, hardware_design_to_toml
from ninedtact_train.dataset import load_dataset
from ninedtact_train.dataset.parquet_files import encode_png, write_pair_file, write_reference_images_file
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage
from ninedtact_train.evaluation.predictions import WrenchPredictions, write_predictions

SHARES = {
    "sensor.toml": 0.3,
    "design": 0.1,
    "hardware design": 0.05,
    "force.toml": 0.07,
    "camera.toml": 0.03,
    "force model": 0.1,
    "original calibration": 0.08,
    "recording": 0.1,
    "Parquet": 0.06,
    "predictions": 0.05,
    "image": 0.09,
    "data set (JSON)": 0.12,
    "data of others": 0.08,
    "cache": 0.04,
    "video": 0.08,
    "mesh": 0.12,
}
"""Cases of each kind of file, in parts of the number that is asked for; what lies in place of a file comes on top."""
PRESSES = ("board_reference", "board", "ball_reference", "ball")


def make_sensor(folder: Path) -> Path:
    """Calibrate a real sensor where its images are there, a simulated one elsewhere."""
    return save_sensor(folder, calibrate(calibration_images(), sensor_id="mutated")).path


def calibration_images() -> CalibrationImages:
    """Return those of a real sensor where they are there, of a simulated one elsewhere."""
    real = _real_sensor()
    if real is None:
        return CalibrationImages(**vars(simulate_calibration_images(default_twin())))
    return CalibrationImages(**{name: read_image(real / f"{name}.png") for name in PRESSES})


def _real_sensor() -> Path | None:
    """Return the folder of a real sensor's images; None where there are none."""
    try:
        return sensor_folders()[0]
    except SystemExit:
        return None


def file_kinds(
    sensor: Path, folder: Path, cases: int, seed: int = 0, places: Sequence[Place] = PLACES
) -> list[FileKind]:
    """Write one file of each kind into a folder, and return its mutations; `sensor` is changed while it is mutated.

    places: what is put in place of each file, on top of the number of cases.
    """
    count = {name: round(cases * share) for name, share in SHARES.items()}
    makers: list[Callable[[Path, Path, dict[str, int], int], list[FileKind]]] = [
        _sensor_files,
        _camera_delays,
        _designs,
        _force_models,
        _original_calibrations,
        _recordings,
        _data_sets,
        _predictions,
        _images,
        generated_data_set_files,
        foreign_data_files,
        cache_files,
        videos,
        meshes,
    ]
    kinds = [kind for make in makers for kind in make(sensor, folder, count, seed)]
    return [replace(kind, mutations=[*kind.mutations, *place_mutations(places)]) for kind in kinds]


def _measure(sensor: Path, reference: Path, press: Path, *more: str) -> list[Callable[[Path], int]]:
    """Return the commands that measure a press: its shape and its force."""
    given = ("--sensor", sensor, "--reference", reference)
    return [
        command("reconstruct", *given, "--out", "OUT", "--formats", "npy", "--no-drawings", "--json", "--", press),
        command("estimate", *given, *more, "--json", "--", press),
    ]


def _sensor_files(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return `sensor.toml` and `force.toml`."""
    commands = _measure(sensor, sensor / "images/ball_reference.png", sensor / "images/ball.png")
    record, scale = sensor / "sensor.toml", folder / "weighed" / "force.toml"
    shutil.copytree(sensor, scale.parent)
    physics = load_estimator("physics", load_sensor(sensor))
    write_force_scale(scale.parent, physics, ForceScale(1.08, -0.05, 2.1, 0.04, 5))
    weighed = _measure(scale.parent, sensor / "images/ball_reference.png", sensor / "images/ball.png")[1:]
    return [
        FileKind(
            "sensor.toml",
            record,
            text_mutations(record.read_bytes(), count["sensor.toml"], seed),
            commands,
        ),
        FileKind(
            "force.toml",
            scale,
            text_mutations(scale.read_bytes(), count["force.toml"], seed),
            weighed,
        ),
    ]


def _camera_delays(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return `camera.toml`, whose delay `record` and `collect` subtract."""

    def resolve(out: Path) -> int:
        kept = read_camera_delay(folder)
        print(
            json.dumps(
                {"delay_ms": resolve_camera_delay_ms("saved", folder, "camera usb:1-2"), "error_ms": kept.error_ms}
            )
        )
        return 0

    path = write_camera_delay(folder, CameraDelay(42.1, 1.3, "camera usb:1-2", 29.9, 0.98))
    mutations = text_mutations(path.read_bytes(), count["camera.toml"], seed)
    return [FileKind("camera.toml", path, mutations, [refusing(resolve)])]


def _designs(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return a sensor design, whose twin is pressed, and a hardware design, whose rules are checked."""
    design, hardware = folder / "design.toml", folder / "hardware.toml"
    design.write_text(design_to_toml(load_sensor(sensor).record.design))
    hardware.write_text(hardware_design_to_toml(default_hardware_design()))

    def press(out: Path) -> int:
        from ninedtact.design import read_design_file
        from ninedtact.simulation.twin import twin_from_design

        found = read_design_file(design)
        twin = twin_from_design(found)
        image = twin.renderer(None)
        print(json.dumps({"design": msgspec.to_builtins(found), "grey": float(image.mean())}))
        return 0

    def check(out: Path) -> int:
        from ninedtact_hardware.buildability import find_broken_rules
        from ninedtact_hardware.design import read_hardware_design

        found = read_hardware_design(hardware, "default")
        broken = [each.message for each in find_broken_rules(found)]
        print(json.dumps({"design": msgspec.to_builtins(found), "warnings": broken}))
        return 0

    contents = design.read_bytes(), hardware.read_bytes()
    return [
        FileKind(
            "design",
            design,
            text_mutations(contents[0], count["design"], seed),
            [refusing(press)],
            is_authored=True,
        ),
        FileKind(
            "hardware design",
            hardware,
            text_mutations(contents[1], count["hardware design"], seed),
            [refusing(check)],
            is_authored=True,
        ),
    ]


def _force_models(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return a copy of the shipped force model."""
    import onnx

    graph, model = onnx.load(str(SHIPPED_MODEL)), folder / "model.onnx"
    graph.metadata_props.add(key=CHECKSUM_METADATA_KEY, value=CHECKSUM_PLACEHOLDER)
    content = stamp_checksum(graph.SerializeToString())
    model.write_bytes(content)
    commands = _measure(
        sensor, sensor / "images/ball_reference.png", sensor / "images/ball.png", "--force", str(model)
    )[1:]
    mutations = model_card_mutations(content, METADATA_KEY, count["force model"], seed)
    return [FileKind("force model", model, mutations, commands)]


def _original_calibrations(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return the four files of a calibration of the original project."""
    given, original = _real_sensor(), folder / "original"
    if given is not None and (given / "upstream_layout").is_dir():
        shutil.copytree(given / "upstream_layout", original)
    else:
        quietly(lambda: export_original_calibration(load_sensor(sensor), original / "sensor_1"))
    press, reference = sensor / "images/ball.png", sensor / "images/ball_reference.png"

    def measure(out: Path) -> int:
        given = ("--sensor", out / "x", "--reference", reference, "--out", out / "r")
        imported = command("import-calibration", original, "--out", "OUT", "--json")(out)
        return imported or command("reconstruct", *given, "--formats", "npy", "--no-drawings", "--json", "--", press)(
            out
        )

    each = count["original calibration"] // len(ORIGINAL_FILES)
    paths = [original / "sensor_1" / file for file in ORIGINAL_FILES]
    return [
        FileKind(
            f"original calibration, {path.name}",
            path,
            array_mutations(path.read_bytes(), each, seed),
            [measure],
            is_authored="index" not in path.name,  # the maps follow from images alone
        )
        for path in paths
    ]


def _recordings(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return a recording of a press with measured forces, which carries its sensor."""
    path = folder / "press.mcap"
    topics = [Topic.IMAGES, Topic.MEASURED]
    images = [read_image(sensor / "images" / f"{name}.png") for name in PRESSES[2:]]
    metadata = RecordingMetadata("mutated", mm_per_px=0.05, software="0.1", id="one", wall_minus_monotonic_ns=10**18)
    with RecordingWriter(path, metadata, topics, sensor_folder_attachments(sensor)) as writer:
        for number in range(12):
            stamp_ns = 10**9 + number * 33_000_000
            writer.write_image(Frame(images[number // 10], stamp_ns, number))
            for sample in range(5):
                force = np.array([0.1, 0.2, -number])
                writer.write_measured(Wrench(force, np.zeros(3), stamp_ns=stamp_ns + sample * 5_000_000))
    content = path.read_bytes()
    heads = [
        replace(one, name=f"near the start, {one.name}")
        for one in _near_the_ends(content, count["recording"] // 2, seed)
    ]
    mutations = [*heads, *byte_mutations(content, count["recording"] - len(heads), seed)]
    commands = [
        command("info", path, "--json"),
        command("estimate", "--json", "--", path),
        command("export", path, "--out", "OUT", "--json"),
    ]
    return [FileKind("recording", path, mutations, commands)]


def _near_the_ends(content: bytes, count: int, seed: int) -> list[Mutation]:
    """Return mutations of the first and of the last bytes, where a file says what it holds."""
    size = min(len(content) // 3, 6000)
    first = byte_mutations(content[:size], count // 2, seed + 7)
    last = byte_mutations(content[-size:], count - count // 2, seed + 8)
    return [
        *(one if one.stop is not None else replace(one, stop=size) for one in first),
        *(_moved(one, len(content) - size, size) for one in last),
    ]


def _moved(mutation: Mutation, by: int, size: int) -> Mutation:
    """Return a mutation of a part of this size that begins so many bytes later."""
    stop = size if mutation.stop is None else mutation.stop
    return replace(mutation, name=f"{mutation.name} near the end", start=mutation.start + by, stop=stop + by)


def _data_sets(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return the two Parquet files of a small data set."""
    data, rng = folder / "pairs", np.random.default_rng(seed)
    (data / "data").mkdir(parents=True)
    (data / "README.md").write_text("pairs")
    rows = [
        DatasetRow(
            f"pair {number}",
            encode_png(rng.integers(90, 200, (24, 32), np.uint8)),
            "untouched",
            rng.normal(0, 1, 6).astype(np.float32) - np.array([0, 0, 3, 0, 0, 0], np.float32),
            "ball:4",
            f"contact {number // 4}",
            number % 4,
            10**9 * number,
            "mutated",
            "rule",
            None,
            0.05,
            1.0,
        )
        for number in range(12)
    ]
    pairs, references = data / "data" / "train-00000-of-00001.parquet", data / "references.parquet"
    write_pair_file(pairs, rows)
    write_reference_images_file(
        references, [ReferenceImage("untouched", encode_png(rng.integers(90, 200, (24, 32), np.uint8)), "mutated")]
    )

    def read(out: Path) -> int:
        found = load_dataset(data, (32, 24), out / "cache")
        batch = next(found.batches(100))
        columns = {name: getattr(found, name).values.tolist() for name in ("objects", "contacts", "sensors", "kinds")}
        sums = {"images": batch.images.sum((1, 2)).tolist(), "references": batch.references.sum((1, 2)).tolist()}
        print(json.dumps({"ids": found.ids.tolist(), "wrenches": found.wrenches.tolist(), **columns, **sums}))
        times = {"times": found.times_ns.tolist(), "mm_per_px": found.mm_per_px.tolist()}
        print(json.dumps(times))
        return 0

    commands = [
        command("dataset", "check", data, "--report", "OUT", "--workers", "1", "--json"),
        refusing(read),
    ]
    return [
        FileKind(
            f"Parquet, {path.name.split('-')[0].removesuffix('.parquet')}",
            path,
            [
                *byte_mutations(path.read_bytes(), count["Parquet"] // 4, seed),
                *_near_the_ends(path.read_bytes(), count["Parquet"] // 4, seed),
            ],
            commands,
        )
        for path in (pairs, references)
    ]


def _predictions(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return a table of predicted wrenches (CSV)."""
    path, rng = folder / "predictions.csv", np.random.default_rng(seed)
    truth = rng.normal(0, [1, 1, 4, 0.05, 0.05, 0.02], (40, 6)) - np.array([0, 0, 6, 0, 0, 0])
    errors = rng.normal(0, 0.1, (40, 6)) * np.abs(truth)
    write_predictions(path, WrenchPredictions(truth, truth + errors, np.abs(0.1 * truth) + 1e-3))
    content = path.read_bytes()
    return [
        FileKind(
            "predictions (CSV)",
            path,
            text_mutations(content, count["predictions"], seed, "csv"),
            [command("evaluate", "--predictions", path, "--json")],
            is_authored=True,
        )
    ]


def _images(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return the image of a press and its reference image, in the formats that are read."""
    kinds = []
    each = count["image"] // 4
    for name, ending in (("ball", "png"), ("ball_reference", "png"), ("ball", "jpg"), ("ball", "bmp")):
        path = folder / f"{name}.{ending}"
        cv2.imwrite(str(path), read_image(sensor / "images" / f"{name}.png"))
        press, reference = folder / f"ball.{ending}", folder / "ball_reference.png"
        content = path.read_bytes()
        mutations = [*byte_mutations(content, each // 2, seed), *_near_the_ends(content, each - each // 2, seed)]
        mutated = f"image, {name}.{ending}"
        kinds.append(FileKind(mutated, path, mutations, _measure(sensor, reference, press)))
    return kinds
