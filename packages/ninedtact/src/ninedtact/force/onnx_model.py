"""Force model files: reading, checking and running one ONNX file that holds a network together with its model card.

The graph takes `input` (n, channels, rows, cols) float32 and returns `wrench` (n, 6) in N and N·m. Networks that predict their own
errors also return `scale` (n, 6), the scale of the wrench's Laplace distribution. The metadata key `ninedtact` holds the card
(`ModelCard`) as JSON, and `ninedtact_checksum` the checksum of the whole file, computed with zeros in its own place.
"""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta, Struct
from numpy import ndarray as Array

from ninedtact._version import installation_command
from ninedtact.checked_reading import convert_tables_to_class, read_regular_file
from ninedtact.errors import FileFormatError, NinedtactError
from ninedtact.force.network_input import NetworkInputSettings
from ninedtact.force.out_of_distribution import StatisticRange
from ninedtact.limited_process import FileTooCostly, run_limited

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


MODEL_FORMAT = 2
"""Format number, raised when older versions of this package can no longer use the file."""
_MOST_BYTES = 2_000_000_000
"""Largest size of a file; ONNX stores no more in one."""
_Load = Annotated[float, Meta(ge=-1e4, le=1e4)]
"""Force in N or torque in N·m."""
SixNumbers = tuple[_Load, _Load, _Load, _Load, _Load, _Load]
_PointMm = Annotated[float, Meta(ge=-1000, le=1000)]
_Count = Annotated[int, Meta(ge=0, le=10**12)]


class TrainingProvenance(Struct, frozen=True, forbid_unknown_fields=True):
    """Data, epochs, settings and package versions of the training that a model comes from."""

    pairs: _Count
    validation_pairs: _Count
    objects: _Count
    """Number of different objects; the absence of an object is not counted."""
    sensors: _Count
    epochs: _Count
    best_epoch: _Count
    seconds: Annotated[float, Meta(ge=0, le=1e9)]
    settings: dict[str, Any]
    versions: dict[str, str]


class ModelCard(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Description of a force model: its input, units, ranges, training and evaluation; stored in the model file."""

    format: int
    name: str
    network: str
    input: NetworkInputSettings
    about_mm: tuple[_PointMm, _PointMm, _PointMm]
    """Point of the graph's torques."""
    modulus_mpa: Annotated[float, Meta(ge=0.003, le=3)]
    """Shear modulus of the gel that the graph's wrench is for; the wrench is proportional to a sensor's own modulus."""
    wrench_min: SixNumbers
    """Smallest of the training's wrenches on each axis, about the skin's centre."""
    wrench_max: SixNumbers
    """Largest of them."""
    input_ranges: dict[str, StatisticRange]
    """Ranges of the statistics of the training's inputs (`out_of_distribution`)."""
    training: TrainingProvenance
    evaluation: dict[str, Any]
    """Tables of `WrenchEvaluation.to_json_dict`, by the name of the evaluated data."""
    licence: str

    def __post_init__(self) -> None:
        """Refuse ranges whose lower end is above their upper end."""
        wrenches = (("wrench_min", pair) for pair in zip(self.wrench_min, self.wrench_max, strict=True))
        for name, (low, high) in (*wrenches, *self.input_ranges.items()):
            if not low <= high:
                raise ValueError(f"{name} from {low:g} to {high:g}, a range that falls")


METADATA_KEY, CHECKSUM_METADATA_KEY = "ninedtact", "ninedtact_checksum"
CHECKSUM_PLACEHOLDER = "0" * 64
"""Value of the checksum while it is computed."""
INPUT_NAME, WRENCH_NAME, SCALE_NAME = "input", "wrench", "scale"
FATAL = 4


class ForceModelUnusable(FileFormatError):
    """A file is no force model, or one that this version cannot use."""


@dataclass(frozen=True)
class WrenchPrediction:
    """Predicted wrenches of n images, with their scales."""

    wrench: Float64[Array, "n 6"]
    scale: Float64[Array, "n 6"]
    """Scale of each wrench component's Laplace distribution; infinite for networks that predict none."""


@dataclass(frozen=True)
class ForceModel:
    """A loaded force model, which runs on one thread."""

    card: ModelCard
    session: "InferenceSession"
    file: str = "a force model"
    """Name of the file, for messages."""
    is_edited: bool = False
    """Whether the content of the file differs from what was written."""
    sha256: str = ""
    """SHA-256 of the file."""

    @property
    def notices(self) -> tuple[str, ...]:
        """A sentence where the file was edited or damaged since it was written."""
        edited = (
            f"{self.file} was edited or damaged after it was written: its checksum is not that of its content; copy or train it "
            "again if you did not edit it"
        )
        return (edited,) if self.is_edited else ()

    def __call__(self, inputs: Float32[Array, "n channels rows cols"]) -> WrenchPrediction:
        """Return the predictions for a gel of `card.modulus_mpa`, with torques about `card.about_mm`.

        Raises `ForceModelUnusable` where the graph cannot be run, or where its answer is not a number.
        """
        try:
            found = [np.asarray(array, np.float64) for array in self.session.run(None, {INPUT_NAME: inputs})]
        except Exception as trouble:  # the exceptions of ONNX Runtime have no other common base class
            raise ForceModelUnusable(
                f"expected the graph in {self.file} to run, got: {_first_line(trouble)}; copy or train it again"
            ) from trouble
        prediction = WrenchPrediction(found[0], found[1] if len(found) > 1 else np.full_like(found[0], np.inf))
        if not np.isfinite(prediction.wrench).all() or np.isnan(prediction.scale).any():
            raise ForceModelUnusable(
                expected=f"finite weights in {self.file}",
                got="a network whose wrench is not a number",
                remedy="copy or train it again",
            )
        return prediction


def read_force_model(path: Path | str) -> ForceModel:
    """Read and check a model; raises `ForceModelUnusable`."""
    try:
        content = read_regular_file(path, _MOST_BYTES)
    except OSError as trouble:
        raise ForceModelUnusable(f"expected a force model, got: {trouble}; give the .onnx file of one") from trouble
    return parse_force_model(content, str(path))


def parse_force_model(content: bytes, name: str) -> ForceModel:
    """Return the model in a file's bytes; raises `ForceModelUnusable` with this name in its message.

    It is loaded and run in a process of its own first, because a graph may take any time and memory.
    """
    try:
        run_limited(_try_force_model, content, name, file_bytes=len(content))
    except FileTooCostly as error:
        raise ForceModelUnusable(
            expected=f"a network in {name}",
            got="a graph that takes too long or too much memory",
            remedy="give one that 'ninedtact train' made",
        ) from error
    return _load_force_model(content, name)


def _try_force_model(content: bytes, name: str) -> None:
    model = _load_force_model(content, name)
    model(np.zeros((1, *model.card.input.shape), np.float32))


def _load_force_model(content: bytes, name: str) -> ForceModel:
    session = build_onnx_session(content, name)
    try:
        card = read_model_card(session, name)
        require_graph_matches_card(session, card, name)
        is_edited = not _has_own_checksum(session, content)
    except UnicodeDecodeError as trouble:  # of any text in the file
        raise ForceModelUnusable(
            f"expected readable text in {name}, got: {trouble}; copy or train it again"
        ) from trouble
    return ForceModel(card, session, name, is_edited, sha256(content).hexdigest())


def _first_line(trouble: Exception) -> str:
    """Return the first line of an exception's message."""
    return (str(trouble).splitlines() or [""])[0]


def stamp_checksum(content: bytes) -> bytes:
    """Return a file with its checksum in place of `CHECKSUM_PLACEHOLDER`, the value of its metadata key."""
    start = content.index(CHECKSUM_PLACEHOLDER.encode(), content.rindex(CHECKSUM_METADATA_KEY.encode()))
    end = start + len(CHECKSUM_PLACEHOLDER)
    return content[:start] + sha256(content).hexdigest().encode() + content[end:]


def _has_own_checksum(session: "InferenceSession", content: bytes) -> bool:
    """Return whether a file is as `stamp_checksum` returned it."""
    stated = session.get_modelmeta().custom_metadata_map.get(CHECKSUM_METADATA_KEY, "").encode()
    if len(stated) != len(CHECKSUM_PLACEHOLDER) or content.count(stated) != 1:
        return False
    blank = content.replace(stated, CHECKSUM_PLACEHOLDER.encode())
    return sha256(blank).hexdigest().encode() == stated


def build_onnx_session(content: bytes, name: str) -> "InferenceSession":
    """Return an ONNX Runtime session of the model that uses one thread; raises `ForceModelUnusable`."""
    try:
        from onnxruntime import InferenceSession, SessionOptions
    except ImportError as trouble:
        raise ForceModelUnusable(
            f"expected ONNX Runtime to run the network in {name}, got: {trouble}; {installation_command('force')}, or estimate "
            "without a network: --force physics"
        ) from trouble

    options = SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = FATAL
    try:
        return InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as trouble:  # the exceptions of ONNX Runtime have no other common base class
        raise ForceModelUnusable(
            expected=f"a whole ONNX model in {name}",
            got=f"{len(content)} bytes that are none ({_first_line(trouble)})",
            remedy="copy or train it again",
        ) from trouble


def read_model_card(session: "InferenceSession", name: str) -> ModelCard:
    """Return the model card from the session's metadata; raises `ForceModelUnusable`."""
    text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
    if text is None:
        raise ForceModelUnusable(
            expected=f"a model that ninedtact wrote in {name}",
            got="an ONNX file without its card",
            remedy="give one that 'ninedtact train' made",
        )
    try:
        table = msgspec.json.decode(text, type=dict[str, Any])
        if table.get("format") != MODEL_FORMAT:
            raise ForceModelUnusable(
                expected=f"{name} in format {MODEL_FORMAT}",
                got=f"format {table.get('format')}",
                remedy="update ninedtact, or train again",
            )
        return convert_tables_to_class(table, ModelCard)
    except (ValueError, RecursionError, NinedtactError) as trouble:
        if isinstance(trouble, ForceModelUnusable):
            raise
        raise ForceModelUnusable(
            f"expected the card of {name} as the program wrote it, got: {trouble}; copy or train it again"
        ) from trouble


def require_graph_matches_card(session: "InferenceSession", card: ModelCard, name: str) -> None:
    """Raise `ForceModelUnusable` for a graph whose inputs or outputs differ from what its card describes."""
    taken = [(one.name, tuple(one.shape[1:])) for one in session.get_inputs()]
    given = [(one.name, tuple(one.shape[1:])) for one in session.get_outputs()]
    expected = [(INPUT_NAME, card.input.shape)]
    if taken != expected or given not in ([(WRENCH_NAME, (6,))], [(WRENCH_NAME, (6,)), (SCALE_NAME, (6,))]):
        raise ForceModelUnusable(
            expected=f"a graph in {name} from {expected[0][1]} to {WRENCH_NAME} and {SCALE_NAME}",
            got=f"{format_tensor_names(taken)} to {format_tensor_names(given)}",
            remedy="train it again",
        )


def format_tensor_names(ends: list[tuple[str, tuple[Any, ...]]]) -> str:
    """Return the names and sizes of a graph's inputs or outputs as text."""
    return ", ".join(f"{name} {size}" for name, size in ends)
