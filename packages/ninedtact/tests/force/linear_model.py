"""A force model without any learning: the wrench is a linear function of the input, written with onnx alone."""

from pathlib import Path

import msgspec
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from ninedtact.force.network_input import InputChannels, NetworkInputSettings
from ninedtact.force.onnx_model import (
    INPUT_NAME,
    METADATA_KEY,
    MODEL_FORMAT,
    SCALE_NAME,
    WRENCH_NAME,
    ModelCard,
    TrainingProvenance,
)
from ninedtact.force.out_of_distribution import StatisticRange

SMALL = NetworkInputSettings(InputChannels.HEIGHTS, rows=6, cols=8, mm_per_px=3.0)
SUMMARY = TrainingProvenance(10, 2, 3, 1, 1, 1, 1.0, {}, {})


def a_card(settings: NetworkInputSettings = SMALL, about_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ModelCard:
    input_ranges: dict[str, StatisticRange] = {"max_indentation": (0.0, 0.1), "mean_change": (0.0, 0.1)}
    return ModelCard(
        format=MODEL_FORMAT,
        name="linear",
        network="none",
        input=settings,
        about_mm=about_mm,
        modulus_mpa=0.093,
        wrench_min=(-9.0,) * 6,
        wrench_max=(9.0,) * 6,
        input_ranges=input_ranges,
        training=SUMMARY,
        evaluation={"validation": {"skill": [0.5, None]}},
        licence="MIT",
    )


def linear_model(
    card: ModelCard, per_input: np.ndarray | None = None, scale: np.ndarray | None = None, keyed: bool = True
) -> onnx.ModelProto:
    """wrench = input · per_input (inputs, 6); the scale is the same for all."""
    shape = card.input.shape
    size = int(np.prod(shape))
    per_input = np.zeros((size, 6)) if per_input is None else per_input
    told = np.ones(6) if scale is None else scale
    weights = {"flat_shape": np.array([-1, size]), "w": per_input.astype(np.float32)}
    weights |= {"none": np.zeros((size, 6), np.float32), "b": told.astype(np.float32)}
    nodes = [
        helper.make_node("Reshape", [INPUT_NAME, "flat_shape"], ["flat"]),
        helper.make_node("MatMul", ["flat", "w"], [WRENCH_NAME]),
        helper.make_node("MatMul", ["flat", "none"], ["zero"]),
        helper.make_node("Add", ["zero", "b"], [SCALE_NAME]),
    ]
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 6]) for name in (WRENCH_NAME, SCALE_NAME)]
    start = helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["n", *shape])
    initial = [numpy_helper.from_array(array, name) for name, array in weights.items()]
    graph = helper.make_graph(nodes, "linear", [start], ends, initial)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    if keyed:
        helper.set_model_props(model, {METADATA_KEY: msgspec.json.encode(card).decode()})
    return model


def written(path: Path, model: onnx.ModelProto) -> Path:
    path.write_bytes(model.SerializeToString())
    return path
