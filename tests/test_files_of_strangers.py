"""Files that cost memory or time, or are damaged where no checksum tells: read within limits, or refused in one sentence.

A case is handled well where the exit code is 0, or 1 with one sentence; where memory grows by at most ten times the file and
300 MB; and where it takes at most 10 s of processor time. NINEDTACT_DAMAGED_CASES is the number of cases of each kind;
`make damaged` prints the table of docs/reliability.md.
"""

import io
import os
import shutil
import struct
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import onnx
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
import torch
import trimesh
from hypothesis import HealthCheck, Phase, given, note, settings
from hypothesis import strategies as st
from linear_model import a_card, linear_model
from onnx import TensorProto, helper
from twin_folder import twin_folder

import ninedtact
from damage import Kind, Run, commands, damaged_bytes, damaged_text, printing, run_forked
from ninedtact import Frame
from ninedtact.calibration.sensor_folder import SENSOR_FILE
from ninedtact.design import design_to_toml, read_design_file
from ninedtact.force.estimator_and_scale import ForceScale, write_force_scale
from ninedtact.force.onnx_model import read_force_model
from ninedtact.quantities import Wrench
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.topics_and_messages import LabelledSpan, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.design_file import hardware_design_to_toml, read_hardware_design
from ninedtact_train.dataset.schema import DATASET_FORMAT, FORMAT_KEY
from ninedtact_train.evaluation.predictions import WrenchPredictions, write_predictions
from ninedtact_train.training.weights_file import load_weights
from strange_recordings import checked_toml, strange_images, strange_recordings

CASES = int(os.environ.get("NINEDTACT_DAMAGED_CASES", "1"))
MOST_S, MOST_BYTES, BYTES_PER_BYTE = 10.0, 300_000_000, 10
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is measured on Linux")
LONG_TEXTS = (
    ".".join(["a"] * 50_000) + " = 1",
    "a = " + "[" * 100_000,
    "a = " + "{b=" * 20_000,
    "a = 1\n" * 400_000,
    "".join(f"[a{at}]\n" for at in range(120_000)),
    "a = " + "9" * 900_000,
    'a = """' + "x" * 900_000,
    "a = 1e" + "9" * 10_000,
    "[[a]]\n" * 150_000,
    "".join(f"a{at} = {{ b.c.d = 1 }}\n" for at in range(40_000)),
    "\ufeff",
    "a = 0001-01-01T00:00:00Z",
    "x" * 30_000_000,
)


@st.composite
def strange_toml(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change a TOML file and its checksum with it, or make one that is hard to parse."""
    if draw(st.integers(0, 4)) == 0:
        at = draw(st.integers(0, len(LONG_TEXTS) - 1))
        alone = draw(st.booleans())
        return f"long text {at}", (b"" if alone else content) + LONG_TEXTS[at].encode()
    name, other = draw(damaged_text(content))
    for _ in range(draw(st.integers(0, 2))):
        also, other = draw(damaged_text(other))
        name = f"{name}; {also}"
    return name, checked_toml(other) if b"checksum" in content[:200] else other


def strange_texts(content: bytes) -> st.SearchStrategy[tuple[str, bytes]]:
    """Change a table, or make one with long lines, cells or numbers."""
    head = content.splitlines(keepends=True)[0]
    columns = head.count(b",") + 1
    texts = {
        "one cell of 15 MB": head + b"9" * 15_000_000,
        "2,000,000 columns": head + b"," * 2_000_000,
        "2,000,000 lines": head + b"\n" * 2_000_000,
        "quotes": head + b'"' * 1_000_001,
        "NUL": head + b"\0" * 100_000,
        "1e999": head + b",".join([b"1e999"] * columns) * 3,
        "-0, _": head + b",".join([b"1_0"] * columns),
        "19 MB of rows": content[: len(head)] + (content.splitlines(keepends=True)[1]) * (19_000_000 // 200),
        "UTF-16": content.decode().encode("utf-16"),
    }
    return st.one_of(damaged_text(content), damaged_bytes(content), st.sampled_from(list(texts.items())))


@st.composite
def strange_onnx(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change a graph: sizes, operators, loops, constants; or its bytes."""
    if draw(st.integers(0, 2)) == 0:
        return draw(damaged_bytes(content))
    model = onnx.load_from_string(content)
    graph, kind = (
        model.graph,
        draw(st.sampled_from(("size", "operator", "loop", "constant", "tile", "pad", "nested", "many"))),
    )
    number = draw(st.sampled_from((0, -1, 2**20, 2**30, 2**31 - 1, 2**40, 2**62)))
    if kind == "size":
        one = draw(st.sampled_from(list(graph.initializer)))
        at = draw(st.integers(0, len(one.dims) - 1))
        one.dims[at] = number
    elif kind == "operator":
        node = draw(st.sampled_from(list(graph.node)))
        node.op_type = draw(
            st.sampled_from(("Einsum", "ConvTranspose", "Resize", "Expand", "Gather", "Softmax", "NonZero", "X"))
        )
    elif kind == "many":
        last = graph.node[0].output[0]
        for at in range(20_000):
            graph.node.append(helper.make_node("Identity", [last], [f"i{at}"]))
            last = f"i{at}"
    else:
        counts = helper.make_tensor(
            "count", TensorProto.INT64, [1 if kind != "loop" else 0][: kind != "loop"], [number]
        )
        graph.initializer.append(counts)
        if kind == "loop":
            body = helper.make_graph(
                [helper.make_node("Identity", ["go"], ["went"])],
                "body",
                [
                    helper.make_tensor_value_info("turn", TensorProto.INT64, []),
                    helper.make_tensor_value_info("go", TensorProto.BOOL, []),
                ],
                [helper.make_tensor_value_info("went", TensorProto.BOOL, [])],
            )
            graph.initializer.append(helper.make_tensor("yes", TensorProto.BOOL, [], [True]))
            graph.node.append(helper.make_node("Loop", ["count", "yes"], [], body=body))
        elif kind == "constant":
            graph.node.append(helper.make_node("ConstantOfShape", ["count"], ["zeros"]))
            graph.node.append(helper.make_node("ReduceSum", ["zeros"], ["sum"], keepdims=0))
        else:
            graph.node.append(helper.make_node("Expand" if kind != "nested" else "Range", ["b", "count"], ["wide"]))
        graph.output.append(
            helper.make_tensor_value_info({"constant": "sum"}.get(kind, "wide"), TensorProto.FLOAT, None)
        )
        if kind == "loop" or draw(st.booleans()):
            del graph.output[-1]
    return f"{kind} {number}", model.SerializeToString()


@st.composite
def strange_weights(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change the parts of a file of weights, whose checksums are right again, or pack them."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged_bytes(content))
    name = draw(st.sampled_from(sorted(parts)))
    what, other = draw(damaged_bytes(parts[name]))
    megabytes = draw(st.sampled_from((0, 0, 0, 0, 1, 400)))
    method = zipfile.ZIP_DEFLATED if megabytes or draw(st.booleans()) else zipfile.ZIP_STORED
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method, compresslevel=1) as archive:
        for each, data in {**parts, name: other}.items():
            with archive.open(each, "w") as entry:
                entry.write(data)
                for _ in range(megabytes if each == name else 0):
                    entry.write(bytes(1 << 20))
    return f"{name.split('/')[-1]}: {what}", out.getvalue()


@st.composite
def strange_parquet(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change a column of a table and write it anew without checksums, or damage its bytes."""
    table = pq.read_table(io.BytesIO(content))
    if draw(st.integers(0, 2)) == 0:
        out = io.BytesIO()
        pq.write_table(
            table, out, write_page_checksum=False, compression=draw(st.sampled_from(("none", "snappy", "zstd")))
        )
        return draw(damaged_bytes(out.getvalue()))
    name, rows = draw(st.sampled_from(table.schema.names)), len(table)
    wide = "x" * 8_000_000
    columns: dict[str, Callable[[], Any]] = {
        "null": lambda: pa.nulls(rows),
        "no numbers": lambda: pa.array([float("nan")] * rows),
        "huge numbers": lambda: pa.array([2**63 - 1] * rows),
        "texts": lambda: pa.array(["\x1b[2J"] * rows),
        "bytes": lambda: pa.array([b"\xff" * 10] * rows),
        "nested": lambda: pa.array([[[1.0]]] * rows),
        "long lists": lambda: pa.array([[0.0] * 700_000] * rows),
        "empty lists": lambda: pa.array([[]] * rows, pa.list_(pa.float32())),
        "seven": lambda: pa.array([[float("nan")] * 7] * rows, pa.list_(pa.float32())),
        "one long text": lambda: pa.array([wide] * rows).dictionary_encode(),
        "long texts": lambda: pa.array([wide] * rows),
        "long bytes": lambda: pa.array([wide.encode()] * rows),
        "images": lambda: pa.array([{"bytes": draw(strange_images(_PNG))[1], "path": None}] * rows),
    }
    what = draw(st.sampled_from(sorted(columns)))
    times = draw(st.sampled_from((1, 1, 500 if what in ("one long text", "null", "no numbers", "seven") else 3)))
    table = pa.concat_tables([table.set_column(table.schema.names.index(name), name, columns[what]())] * times)
    table = table.replace_schema_metadata({FORMAT_KEY: str(DATASET_FORMAT).encode()})
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return f"{name}: {what}, {len(table)} rows", out.getvalue()


_PNG = bytes(cv2.imencode(".png", np.full((24, 24), 140, np.uint8))[1])


@st.composite
def strange_meshes(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change bytes or numbers of a mesh, or state another number of its parts."""
    is_text = all(byte < 128 for byte in content[:300])
    if draw(st.booleans()):
        return draw(damaged_text(content) if is_text else damaged_bytes(content))
    count = draw(st.sampled_from((0, 1, 2**31 - 1, 2**32 - 1, 10**8, 10**12, 10**30)))
    if content.startswith(b"glTF"):
        length = struct.unpack_from("<I", content, 12)[0]
        text = content[20 : 20 + length]
        name, other = draw(damaged_text(text))
        head = content[:8] + struct.pack("<I", len(content) + len(other) - len(text)) + struct.pack("<I", len(other))
        return f"glTF, {name}", head + content[16:20] + other + content[20 + length :]
    if content.startswith(b"ply"):
        kind = draw(st.sampled_from((b"vertex", b"face")))
        lines = [
            b"element %s %d" % (kind, count) if line.startswith(b"element " + kind) else line
            for line in content.split(b"\n")
        ]
        return f"{count} {kind.decode()}", b"\n".join(lines)
    if content.startswith(b"OFF"):
        lines = content.split(b"\n")
        at = next(at for at, line in enumerate(lines) if len(line.split()) == 3)
        lines[at] = b"%d %d 0" % (count, draw(st.sampled_from((count, 4))))
        return f"{count} in OFF", b"\n".join(lines)
    if is_text:
        line = draw(
            st.sampled_from(
                (
                    *(b"f -1 -2 -3\n", b"usemtl a\nf 1 2 3\n", b"o x\nf 1 2 3\n", b"g\n", b"f" + b" 1" * 3000 + b"\n"),
                    *(b"v 0 0 0\n", b"f 1/1/1 2/2/2 3/3/3\n", b"f 1000000000 2 3\n", b"vt 0 0\n", b"l 1 2\n", b"\\\n"),
                    b"f 1 2 3 4 5 6 7 8 9 1 2 3\n",
                )
            )
        )
        times = draw(st.sampled_from((3, 4000, 1_000_000)))
        return f"{line[:30]!r} x {times}", content + line * min(times, 12_000_000 // len(line))
    return f"{count} triangles", content[:80] + struct.pack("<I", count % 2**32) + content[84:]


def recording_kinds(sensor: Path, folder: Path) -> Iterator[tuple[str, Kind]]:
    """Yield recordings of raw images and of PNG."""
    skin = cv2.imread(str(sensor / "untouched.png"))
    assert skin is not None
    for images, name in (("zstd", "recording"), ("png", "recording, PNG")):
        path = folder / f"{images}.mcap"
        metadata = RecordingMetadata("twin", images=images, mm_per_px=0.05, wall_minus_monotonic_ns=10**18)  # type: ignore[arg-type]
        attached = {**sensor_folder_attachments(sensor), "spans.json": b'[{"begin_ns":1,"end_ns":2,"label":"x"}]'}
        with RecordingWriter(path, metadata, tuple(Topic), attached) as writer:
            for number in range(2):
                stamp_ns = 10**9 + number * 33_000_000
                writer.write_reference(Frame(skin, stamp_ns, 0), 0)
                writer.write_image(Frame(skin, stamp_ns, number))
                wrench = Wrench(np.array([0.1, 0.2, -number]), np.zeros(3), stamp_ns=stamp_ns)
                writer.write_measured(wrench)
                writer.write_estimated(ninedtact.WrenchEstimate(wrench, np.eye(6), True), number)
                writer.write_span(LabelledSpan(stamp_ns, stamp_ns + 1, "press"))
            writer.write_event(RecordingEvent(stamp_ns, RecordingEventKind.DROPPED, "3"))
        lines = f"info {path} --json", f"estimate --force none --json {path}", f"export {path} --out OUT --json"
        yield name, Kind(path, commands(*lines), strange_recordings)
        bare = f"info {path} --sensor {sensor} --json", f"estimate --force none --sensor {sensor} {path}"
        yield f"{name}, --sensor", Kind(path, commands(*bare), strange_recordings)


def file_kinds(sensor: Path, folder: Path) -> Iterator[tuple[str, Kind]]:
    """Yield the other files that strangers may hand over."""
    image = sensor / "untouched.png"
    read = f"reconstruct --sensor {sensor} --reference {image} --out OUT --formats npy --no-drawings --json {image}"
    yield "sensor.toml, checksum right", Kind(sensor / SENSOR_FILE, commands(read), strange_toml)
    scaled = folder / "scaled"
    shutil.copytree(sensor, scaled)
    write_force_scale(scaled, ninedtact.load_sensor(sensor).estimator("physics"), ForceScale(1.08, 0.04, 5))
    by_scale = commands(f"estimate --sensor {scaled} --reference {image} --json {image}")
    yield "force.toml, checksum right", Kind(scaled / "force.toml", by_scale, strange_toml)
    design, hardware = folder / "design.toml", folder / "hardware.toml"
    design.write_text(design_to_toml(ninedtact.load_sensor(sensor).record.design))
    hardware.write_text(hardware_design_to_toml(HardwareDesign()))
    yield "design, several edits", Kind(design, printing(lambda out: str(read_design_file(design))), strange_toml)
    read_hardware = printing(lambda out: str(read_hardware_design(hardware, "default")))
    yield "hardware design, several edits", Kind(hardware, read_hardware, strange_toml)
    for ending in ("png", "jpg"):
        path = folder / f"press.{ending}"
        cv2.imwrite(str(path), cv2.imread(str(image)))
        estimate = f"estimate --force none --sensor {sensor} --reference {image} --json {path}"
        yield f"image (.{ending}), checksums right", Kind(path, commands(estimate), strange_images)
    predictions, rng = folder / "predictions.csv", np.random.default_rng(0)
    truth = rng.normal(0, [1, 1, 4, 0.05, 0.05, 0.02], (40, 6)) - np.array([0, 0, 6, 0, 0, 0])
    write_predictions(predictions, WrenchPredictions(truth, truth * 1.1, np.abs(truth) + 1e-3))
    yield (
        "predictions (CSV), long",
        Kind(predictions, commands(f"evaluate --predictions {predictions} --json"), strange_texts),
    )
    model = folder / "model.onnx"
    model.write_bytes(linear_model(a_card()).SerializeToString())
    yield "force model, other graph", Kind(model, printing(lambda out: read_force_model(model).card.name), strange_onnx)
    weights = folder / "weights.pt"
    torch.save({"a": torch.ones(4, 5), "b": [torch.zeros(3)]}, weights)
    yield "weights (.pt)", Kind(weights, lambda out: _read_weights(weights), strange_weights)
    data = folder / "data"
    made = f"simulate dataset --out {data} --pairs 4 --sensors 1 --objects 1 --size 64 48 --pitch-mm 0.5 --workers 1 --json"
    assert commands(made)(folder) == 0
    check_data = commands(f"dataset show {data}", f"dataset check {data} --report OUT --workers 1 --json")
    for path in (*data.rglob("train*.parquet"), *data.rglob("references.parquet")):
        yield f"Parquet, {path.name.split('-')[0]}, written anew", Kind(path, check_data, strange_parquet)
    pyramid = trimesh.creation.cone(5, 6, sections=5)
    pyramid.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    for ending in ("stl", "obj", "ply", "off", "glb"):
        pyramid.export(path := folder / f"pyramid.{ending}")
        read_mesh = printing(lambda out, path=path: indenter_from_name(str(path)).heights_mm.shape)  # type: ignore[attr-defined]
        yield f"mesh, .{ending}, other counts", Kind(path, read_mesh, strange_meshes)


def _read_weights(path: Path) -> int:
    """Read weights as those do who call it, which make one sentence of any error."""
    try:
        print(len(load_weights(path)))
    except Exception as trouble:
        print(f"ninedtact: expected weights, got: {' '.join(str(trouble).split())[:300]}", file=sys.stderr)
        return 1
    return 0


def outcome(run: Run, file_bytes: int, usual: Run) -> str:
    """Return how a case was handled; raises AssertionError where it was handled badly."""
    said = [line for line in run.complaints.splitlines() if line.strip()]
    assert run.code in (0, 1) and "Traceback" not in run.complaints, f"exit code {run.code}: {said[-1:]}"
    assert run.code == 0 or (said and "expected" in said[-1]), f"no sentence: {said[-1:]}"
    most = max(MOST_BYTES + BYTES_PER_BYTE * file_bytes, usual.grown_bytes)
    assert run.grown_bytes <= most, f"{run.grown_bytes / 1e6:.0f} MB for {file_bytes / 1e6:.1f} MB: {said[-1:]}"
    assert run.cpu_s <= max(MOST_S, 2 * usual.cpu_s), f"{run.cpu_s:.1f} s for {file_bytes / 1e6:.1f} MB: {said[-1:]}"
    return ("read", "refused")[run.code]


@pytest.fixture(scope="module")
def kinds() -> Iterator[dict[str, Kind]]:
    """One file of every kind, with the work that reads it."""
    cv2.setNumThreads(1)
    with TemporaryDirectory(prefix="strangers_") as name:
        folder = Path(name)
        sensor = twin_folder(folder / "sensor", for_force=True)
        yield {**dict(recording_kinds(sensor, folder)), **dict(file_kinds(sensor, folder))}


@cache
def usual_run(work: Callable[[Path], int]) -> Run:
    """Work on whole files: here once, so that what is needed is imported once, and then as damaged ones are worked on."""
    with TemporaryDirectory(prefix="results_") as folder:
        code = work(Path(folder))
    assert code == 0
    with TemporaryDirectory(prefix="results_") as folder:
        return run_forked(work, Path(folder))


@pytest.mark.parametrize("part", range(4))
def test_files_of_strangers_are_read_or_refused_within_limits(
    part: int, kinds: dict[str, Kind], capsys: pytest.CaptureFixture[str]
) -> None:
    bad, rows = list[str](), dict[str, Counter[str]]()
    for name, kind in list(kinds.items())[part::4]:
        rows[name] = outcomes_of(name, kind, bad)
        if "NINEDTACT_DAMAGED_CASES" in os.environ:
            with capsys.disabled():
                found = rows[name]
                print(
                    f"| {name} | {found.total()} | {found['refused']} | {found['read']} | {found['badly']} |",
                    flush=True,
                )
    assert not bad, "\n".join(bad)


def outcomes_of(name: str, kind: Kind, bad: list[str]) -> Counter[str]:
    """Change the file of a kind again and again; return how often each outcome came, and add what was handled badly."""
    content, found, usual = kind.path.read_bytes(), Counter[str](), usual_run(kind.work)

    @settings(
        max_examples=CASES, phases=[Phase.generate], derandomize=CASES == 1, suppress_health_check=list(HealthCheck)
    )
    @given(kind.damage(content))
    def change_file(changed: tuple[str, bytes]) -> None:
        note(changed[0])
        try:
            kind.path.write_bytes(changed[1])
            with TemporaryDirectory(prefix="results_") as folder:
                run = run_forked(kind.work, Path(folder))
        finally:
            kind.path.write_bytes(content)
        try:
            found[outcome(run, len(changed[1]), usual)] += 1
        except AssertionError as failure:
            found["badly"] += 1
            bad.append(f"{name}, {changed[0]}: {failure}")
            if keep := os.environ.get("NINEDTACT_KEEP_BAD_FILES"):
                (Path(keep) / f"{len(list(Path(keep).iterdir()))}_{kind.path.name}").write_bytes(changed[1])

    change_file()
    return found
