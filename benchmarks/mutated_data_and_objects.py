"""More kinds of files for `mutated_files`: JSON files and caches of data sets, data of other projects, videos, meshes."""

import io
import json
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import trimesh
from file_mutations import Mutation, array_mutations, byte_mutations, text_mutations
from mutated_files import FileKind, command, quietly, refusing

from ninedtact import read_image
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact_train.dataset import load_dataset
from ninedtact_train.dataset.folder import REPORT_FILE, SENSORS_FILE, SETTINGS_FILE
from ninedtact_train.dataset.image_cache import load_or_decode_images
from ninedtact_train.workflows.dataset_calibrations import load_simulated_sensors

_ORIGIN_N, _RANGE_N = np.array([-3, -3, -12, -0.2, -0.2, -0.05]), np.array([6, 6, 12, 0.4, 0.4, 0.1])
"""Lower ends and widths of the ranges by which the original project normalises wrenches."""


def generated_data_set_files(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return settings and sensors of a generated data set, and the report of one that is built from it."""
    data, built, each = folder / "generated", folder / "built", count["data set (JSON)"] // 3
    size = ("--pairs", "4", "--sensors", "1", "--objects", "1", "--size", "64", "48", "--pitch-mm", "0.5")
    generate = command("simulate", "dataset", "--out", data, *size, "--workers", "1", "--json")
    build = command("dataset", "build", data, "--out", built, "--workers", "1", "--json")
    quietly(lambda: (generate(folder), build(folder)))

    def read_sensors(out: Path) -> int:
        found = load_simulated_sensors(data)
        print(json.dumps({name: member.to_json_dict() for name, member in found.items()}))
        return 0

    rebuild = command("dataset", "build", data, "--out", "OUT", "--workers", "1", "--json")
    commands: dict[Path, list[Callable[[Path], int]]] = {
        data / SETTINGS_FILE: [generate, rebuild],
        data / SENSORS_FILE: [refusing(read_sensors)],
        built / REPORT_FILE: [build],
    }
    return [
        FileKind(f"data set, {path.name}", path, text_mutations(path.read_bytes(), each, seed, "json"), run)
        for path, run in commands.items()
    ]


def foreign_data_files(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return an episode of the tactile transformer (.npz), and a wrench of the original project's data set (.npy)."""
    rng, each = np.random.default_rng(seed), count["data of others"] // 2
    episode, pairs = folder / "episode.npz", folder / "Dataset"
    skin = rng.integers(130, 150, (24, 24, 3), np.uint8)
    images = np.array([skin - np.uint8(3 * load) for load in range(5)])
    force = -np.arange(5.0)[:, None] * [0.1, 0, 1, 0, 0, 0] + 1.5
    arrays = {"tactile_img": images, "ref_frame": skin, "6d_force": force, "ref_force": np.full(6, 1.5)}
    np.savez_compressed(episode, **{**arrays, "probe": np.array(3)})  # type: ignore[arg-type]
    for number in range(4):
        wrench = np.array([0.2, -0.1, -1.0 - number, 0.01, 0.02, 0.001])
        for name, numbers in ((f"{number}", wrench), (f"{number}_norm", (wrench - _ORIGIN_N) / _RANGE_N)):
            path = pairs / "wrench" / "1" / f"{name}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, numbers)
        path = pairs / "image" / "1" / f"{number}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), skin - np.uint8(number))
    cv2.imwrite(str(folder / "skin.png"), skin)
    wrench_file, content = pairs / "wrench" / "1" / "2.npy", episode.read_bytes()
    in_array = [
        Mutation(f"6d_force, {one.name}", _replace_member(content, "6d_force.npy", one))
        for one in array_mutations(_read_member(content, "6d_force.npy"), each // 2, seed)
    ]
    mutations = [*in_array, *byte_mutations(content, each - len(in_array), seed)]
    return [
        FileKind("episode (.npz)", episode, mutations, _build_and_read(episode), is_authored=True),
        FileKind(
            "wrench (.npy)",
            wrench_file,
            array_mutations(wrench_file.read_bytes(), each, seed),
            _build_and_read(pairs, "--reference", folder / "skin.png"),
            is_authored=True,
        ),
    ]


def _read_member(content: bytes, name: str) -> bytes:
    """Return one file of a ZIP archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read(name)


def _replace_member(content: bytes, name: str, mutation: Mutation) -> bytes:
    """Return a ZIP archive in which one file is mutated."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(written, "w") as changed:
        for each in archive.namelist():
            part = archive.read(each)
            if each == name:
                end = b"" if mutation.stop is None else part[mutation.stop :]
                part = part[: mutation.start] + mutation.part + end
            changed.writestr(each, part)
    return written.getvalue()


def _build_and_read(source: Path, *more: str | Path) -> list[Callable[[Path], int]]:
    """Return commands that build a data set from a source, and print the pairs of it."""

    def read(out: Path) -> int:
        found = load_dataset(out / "x", (32, 24), out / "cache")
        batch = next(found.batches(100))
        print(json.dumps({"ids": found.ids.tolist(), "wrenches": found.wrenches.tolist()}))
        print(json.dumps({"images": batch.images.sum((1, 2)).tolist(), "objects": found.objects.values.tolist()}))
        return 0

    return [command("dataset", "build", source, *more, "--out", "OUT", "--workers", "1", "--json"), refusing(read)]


def cache_files(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return the heads of the files of decoded images; a flipped bit in the pixels of a cache is not found."""
    data, cache = folder / "generated", folder / "cache"
    load_or_decode_images(data, (32, 24), cache)
    each = count["cache"] // 3

    def read(out: Path) -> int:
        found = load_or_decode_images(data, (32, 24), cache)
        print(json.dumps({name: np.asarray(part).tolist() for name, part in vars(found).items()}))
        return 0

    kinds = []
    for path in sorted(cache.glob("*/*.npy")):
        content = path.read_bytes()
        inside = [one for one in byte_mutations(content[:128], 2 * each, seed) if one.stop is not None]
        cuts = [Mutation("empty", b""), Mutation("cut", content[:-1]), Mutation("cut in the head", content[:60])]
        kinds.append(FileKind(f"cache, {path.name}", path, [*cuts, *inside][:each], [refusing(read)]))
    return kinds


def videos(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return videos of a press: separate images (MJPEG), predicted ones (MPEG-4), and lossless ones (FFV1)."""
    kinds = []
    images = [read_image(sensor / "images" / f"{name}.png") for name in ("ball_reference", "ball")]
    for name, codec in (("press.avi", "MJPG"), ("press.mp4", "mp4v"), ("press.mkv", "FFV1")):
        path = folder / name
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 30.0, images[0].shape[1::-1])
        for number in range(5):
            writer.write(images[number // 2 % 2])
        writer.release()
        reference = ("--reference", sensor / "images/ball_reference.png")
        run = command("estimate", "--sensor", sensor, *reference, "--json", "--", path)
        mutations = byte_mutations(path.read_bytes(), count["video"] // 3, seed)
        kinds.append(FileKind(f"video, {name}", path, mutations, [run]))
    return kinds


def meshes(sensor: Path, folder: Path, count: dict[str, int], seed: int) -> list[FileKind]:
    """Return a pyramid in five formats, and meshes that no sensor can be pressed with."""
    each = count["mesh"] // 6
    pyramid = trimesh.creation.cone(5, 6, sections=5)
    pyramid.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    kinds = []
    for ending in ("stl", "obj", "ply", "off", "glb"):
        path = folder / f"pyramid.{ending}"
        pyramid.export(path)
        content = path.read_bytes()
        is_text = ending in ("obj", "off")
        mutations = text_mutations(content, each, seed, "csv") if is_text else byte_mutations(content, each, seed)
        kinds.append(FileKind(f"mesh, .{ending}", path, mutations, [refusing(_read_object(path))], is_authored=True))
    strange = folder / "strange.obj"
    strange.write_bytes((folder / "pyramid.obj").read_bytes())
    press = command("simulate", "press", "--object", strange, "--depth-mm", "0.5", "--out", "OUT", "--json")
    chosen = _strange_meshes(folder)
    mutations = [chosen[at] for at in np.random.default_rng(seed).permutation(len(chosen))[: max(each, 2)]]
    return [*kinds, FileKind("mesh, strange", strange, mutations, [press], is_authored=True)]


def _read_object(path: Path) -> Callable[[Path], int]:
    """Return work that reads a mesh as an object, and prints its heights with the warnings about it."""

    def read(out: Path) -> int:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            heights = indenter_from_name(str(path)).heights_mm  # type: ignore[attr-defined]
        finite = heights[np.isfinite(heights)]
        figures = {"shape": heights.shape, "sum": float(finite.sum()), "warnings": [str(each.message) for each in said]}
        print(json.dumps(figures))
        return 0

    return read


def _strange_meshes(folder: Path) -> list[Mutation]:
    """Return meshes (.obj) that are huge, microscopic, broken, or no solids."""

    def mesh(vertices: np.ndarray, faces: np.ndarray, more: str = "") -> bytes:
        corners = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices)
        return (more + corners + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)).encode()

    vertices, faces = (
        np.array([[-5.0, -5, 3], [5, -5, 3], [0, 6, 3], [0, 0, 0]]),
        np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]),
    )
    grid = np.stack(np.meshgrid(np.arange(0, 30, 0.1), np.arange(0, 30, 0.1)), -1).reshape(-1, 2)
    noise = np.column_stack([grid, np.random.default_rng(0).normal(0, 3, len(grid))])
    square = np.array([[0, 1, 300], [1, 301, 300]])
    surface = (square + np.arange(0, 300 * 298, 7)[:, None, None]).reshape(-1, 3)
    sheets = np.array([[-25.0, -25, 0], [25, -25, 0], [-25, 25, 0], [25, 25, 0]])
    return [
        *(Mutation(f"x {scale:g}", mesh(vertices * scale, faces)) for scale in (1e-9, 1e-3, 0.2, 12, 1e3, 1e30, 1e300)),
        Mutation("one triangle", mesh(vertices, faces[1:2])),
        Mutation("one upright triangle", mesh(vertices[:, [2, 1, 0]] * [0, 1, 1], faces[:1])),
        Mutation("one point", mesh(vertices * 0, faces)),
        Mutation("one line", mesh(vertices * [1, 0, 0], faces)),
        Mutation("flat", mesh(vertices * [1, 1, 0], faces)),
        Mutation("needle", mesh(vertices * [0.03, 0.03, 2000], faces)),
        Mutation("tall", mesh(vertices * [1, 1, 1e6], faces)),
        Mutation("every triangle three times", mesh(vertices, np.repeat(faces, 3, 0))),
        Mutation("inside out", mesh(vertices, faces[:, ::-1])),
        Mutation("open", mesh(vertices, faces[:-1])),
        Mutation("upside down", mesh(vertices * [1, 1, -1], faces)),
        Mutation("no triangle", mesh(vertices, faces[:0])),
        Mutation("missing corner", mesh(vertices, faces + 5)),
        Mutation("negative corner", mesh(vertices, faces - 9)),
        Mutation("corner nobody uses at infinity", mesh(np.vstack([vertices, [np.inf, 0, 0]]), faces)),
        Mutation("corner nobody uses far away", mesh(np.vstack([vertices, [1e12, 0, 0]]), faces)),
        Mutation("NaN", mesh(vertices * [1, 1, np.nan], faces)),
        Mutation("rough surface", mesh(noise, surface)),
        Mutation("20,000 sheets upon each other", mesh(sheets, np.tile([[0, 1, 2], [1, 3, 2]], (10_000, 1)))),
        Mutation("far from the origin", mesh(vertices + 1e7, faces)),
        Mutation("material from a device", mesh(vertices, faces, "mtllib /dev/zero\nusemtl one\n")),
    ]
