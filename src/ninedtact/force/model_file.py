"""A force model: one ONNX file that says all about itself.

The graph takes `input` (n, channels, rows, cols) float32 and gives `wrench` (n, 6), N and N·m, and, where the network tells it,
`scale` (n, 6) of the wrench's Laplace distribution. The metadata's one key `ninedtact` holds the card as JSON.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.force.card import FORMAT, Card

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

KEY = "ninedtact"
INPUT, WRENCH, SCALE = "input", "wrench", "scale"
FATAL = 4


class ModelUnusable(NinedtactError):
    """A file that is no force model, or one that this program cannot use."""


@dataclass(frozen=True)
class Prediction:
    """Wrenches of many images."""

    wrench: Float64[Array, "n 6"]
    scale: Float64[Array, "n 6"]
    """Of a Laplace distribution; infinite from networks that tell none."""


@dataclass(frozen=True)
class ForceModel:
    """A model that is ready to answer, on one thread."""

    card: Card
    session: "InferenceSession"

    def __call__(self, inputs: Float32[Array, "n channels rows cols"]) -> Prediction:
        """As the graph says, for a gel of `card.modulus_mpa` and about `card.about_mm`."""
        found = [np.asarray(array, np.float64) for array in self.session.run(None, {INPUT: inputs})]
        return Prediction(found[0], found[1] if len(found) > 1 else np.full_like(found[0], np.inf))


def read_model(path: Path | str) -> ForceModel:
    """Read and check a model; raises `ModelUnusable`."""
    try:
        content = Path(path).read_bytes()
    except OSError as trouble:
        raise ModelUnusable(f"expected a force model, got: {trouble}; give the .onnx file of one") from trouble
    return model_from(content, str(path))


def model_from(content: bytes, name: str) -> ForceModel:
    """The model in a file's bytes; raises `ModelUnusable`, which calls it by this name."""
    session = session_of(content, name)
    card = card_of(session, name)
    require_graph(session, card, name)
    return ForceModel(card, session)


def session_of(content: bytes, name: str) -> "InferenceSession":
    """ONNX Runtime on one thread; raises `ModelUnusable`."""
    try:
        from onnxruntime import InferenceSession, SessionOptions
    except ImportError as trouble:
        raise ModelUnusable(
            f"expected ONNX Runtime to run the network in {name}, got: {trouble}; pip install 'ninedtact[force]', or estimate "
            "without a network: --force physics"
        ) from trouble

    options = SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = FATAL
    try:
        return InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as trouble:  # ONNX Runtime's own exceptions have no base but this
        said = (str(trouble).splitlines() or [""])[0]
        raise ModelUnusable(
            f"expected a whole ONNX model in {name}, got {len(content)} bytes that are none ({said}); copy or train it again"
        ) from trouble


def card_of(session: "InferenceSession", name: str) -> Card:
    """What the model says about itself; raises `ModelUnusable`."""
    text = session.get_modelmeta().custom_metadata_map.get(KEY)
    if text is None:
        raise ModelUnusable(
            f"expected a model that ninedtact wrote in {name}, got an ONNX file without its card; give one that 'ninedtact "
            "train' made"
        )
    try:
        table = msgspec.json.decode(text, type=dict[str, Any])
        if table.get("format") != FORMAT:
            raise ModelUnusable(
                f"expected {name} in format {FORMAT}, got format {table.get('format')}; update ninedtact, or train again"
            )
        return msgspec.convert(table, Card)
    except (msgspec.MsgspecError, NinedtactError) as trouble:
        if isinstance(trouble, ModelUnusable):
            raise
        raise ModelUnusable(
            f"expected the card of {name} as the program wrote it, got: {trouble}; copy or train it again"
        ) from trouble


def require_graph(session: "InferenceSession", card: Card, name: str) -> None:
    """Refuse a graph that takes or gives something else than its card says."""
    taken = [(one.name, tuple(one.shape[1:])) for one in session.get_inputs()]
    given = [(one.name, tuple(one.shape[1:])) for one in session.get_outputs()]
    expected = [(INPUT, card.input.shape)]
    if taken != expected or given not in ([(WRENCH, (6,))], [(WRENCH, (6,)), (SCALE, (6,))]):
        raise ModelUnusable(
            f"expected a graph in {name} from {expected[0][1]} to {WRENCH} and {SCALE}, got {told(taken)} to {told(given)}; "
            "train it again"
        )


def told(ends: list[tuple[str, tuple[Any, ...]]]) -> str:
    """Names and sizes in words."""
    return ", ".join(f"{name} {size}" for name, size in ends)
