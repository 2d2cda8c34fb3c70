"""Export of a trained network with its model card to one ONNX file."""

from pathlib import Path

import msgspec
import numpy as np
import onnx
import torch

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import OutputError
from ninedtact.force.onnx_model import (
    CHECKSUM_METADATA_KEY,
    CHECKSUM_PLACEHOLDER,
    INPUT_NAME,
    METADATA_KEY,
    SCALE_NAME,
    WRENCH_NAME,
    ForceModel,
    ModelCard,
    parse_force_model,
    read_force_model,
    stamp_checksum,
)
from ninedtact_train.training.networks import WrenchNetwork
from ninedtact_train.training.training_loop import silence_loggers

_PARITY_TOLERANCE = 1e-3
"""Largest difference between ONNX Runtime and torch, relative to the labels' unit plus the predicted value."""
_PARITY_INPUTS = 3


def export_model(path: Path, network: WrenchNetwork, card: ModelCard) -> ForceModel:
    """Write the network as an ONNX file, atomically, after comparing it with the network.

    Raises `OutputError`, `FileNotWritten`.
    """
    content = _serialise_with_card(_build_onnx_graph(network, card), card)
    model = parse_force_model(content, str(path))
    _require_onnx_parity(network, model)
    write_file_atomically(path, content)
    return model


def rewrite_card(path: Path, card: ModelCard, out: Path) -> None:
    """Write a model file with another card and the same graph; `out` may be `path`.

    Raises `ForceModelUnusable`, `FileNotWritten`.
    """
    read_force_model(path)
    write_file_atomically(out, _serialise_with_card(onnx.load(str(path)), card))


def _build_onnx_graph(network: WrenchNetwork, card: ModelCard) -> onnx.ModelProto:
    network.cpu().eval()
    shown = torch.zeros(2, *card.input.shape)
    with silence_loggers("torch.onnx", warnings_of=""), torch.no_grad():
        outputs = [WRENCH_NAME, SCALE_NAME][: len(network(shown))]
        program = torch.onnx.export(
            network,
            (shown,),
            dynamo=True,
            verbose=False,
            input_names=[INPUT_NAME],
            output_names=outputs,
            dynamic_shapes={"x": {0: torch.export.Dim("n")}},
        )
        assert program is not None
    return program.model_proto


def _serialise_with_card(graph: onnx.ModelProto, card: ModelCard) -> bytes:
    card_text = msgspec.json.encode(card).decode()
    onnx.helper.set_model_props(graph, {METADATA_KEY: card_text, CHECKSUM_METADATA_KEY: CHECKSUM_PLACEHOLDER})
    _remove_traces(graph)
    return stamp_checksum(graph.SerializeToString())


def _remove_traces(graph: onnx.ModelProto) -> None:
    """Remove what torch notes of the source of every node: paths of the machine on which the network was trained."""
    parts = graph.graph
    for part in (parts, *parts.node, *parts.value_info, *parts.input, *parts.output, *parts.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")


def _require_onnx_parity(network: WrenchNetwork, model: ForceModel) -> None:
    shown = torch.rand(_PARITY_INPUTS, *model.card.input.shape)
    with torch.no_grad():
        expected = [part.double().numpy() for part in network(shown)]
    given = model(shown.numpy())
    unit = network.unit.double().numpy()
    pairs = zip(expected, (given.wrench, given.scale), strict=False)
    difference = max(float((np.abs(a - b) / (unit + np.abs(a))).max()) for a, b in pairs)
    if not difference <= _PARITY_TOLERANCE:
        raise OutputError(
            expected="the exported graph to predict what the network predicts",
            got=f"a relative difference of {difference:.2g}",
            remedy="update torch and onnx",
        )
