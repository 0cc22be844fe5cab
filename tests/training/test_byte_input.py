"""A quantised network with byte input gives the same output as with its own quantisation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from huepose.propose.view_images import NEAR, SIDE, network_input
from huepose.training.byte_input import read_bytes


def _numbers(colors: np.ndarray, reliefs: np.ndarray) -> np.ndarray:
    x = np.ones((len(colors), 6, SIDE, SIDE), np.float32)
    x[:, :3] = (colors * np.float32(2.0 / 255.0) - np.float32(1.0)).transpose(0, 3, 1, 2)
    x[:, 3] = np.clip(reliefs, -np.float32(NEAR), np.float32(NEAR)) * np.float32(2.0)
    x[:, 5] = abs(reliefs) < NEAR
    return x


class _Windows(CalibrationDataReader):
    def __init__(self, numbers: np.ndarray) -> None:
        self._left: Iterator[np.ndarray] = iter(numbers[:, None])

    def get_next(self) -> dict[str, np.ndarray] | None:
        found = next(self._left, None)
        return None if found is None else {"window": found}


@pytest.mark.filterwarnings("ignore")
def test_a_network_with_byte_input_gives_the_same_output(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (3, SIDE, SIDE, 3)).astype(np.uint8)
    # Some values are clipped, so the whole range is used.
    reliefs = rng.normal(0.0, 0.5, (3, SIDE, SIDE)).astype(np.float32)
    weights = rng.normal(0.0, 0.1, (5, 6, 3, 3)).astype(np.float32)
    window = helper.make_tensor_value_info("window", onnx.TensorProto.FLOAT, ["n", 6, SIDE, SIDE])
    code = helper.make_tensor_value_info("code", onnx.TensorProto.FLOAT, ["n", 5, SIDE // 2, SIDE // 2])
    convolution = helper.make_node("Conv", ["window", "weights"], ["code"], strides=(2, 2), pads=(1, 1, 1, 1))
    graph = helper.make_graph(
        [convolution], "small", [window], [code], [numpy_helper.from_array(weights, "weights")]
    )
    exact, file = tmp_path / "exact.onnx", tmp_path / "small.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), exact)
    numbers = _numbers(colors, reliefs)
    kinds = {"weight_type": QuantType.QInt8, "activation_type": QuantType.QUInt8}
    quantize_static(
        str(exact), str(file), _Windows(numbers), quant_format=QuantFormat.QDQ, per_channel=True, **kinds
    )
    before = ort.InferenceSession(str(file)).run(None, {"window": numbers})[0]
    read_bytes(file)
    after = ort.InferenceSession(str(file)).run(
        None, {"window": network_input(colors, reliefs, clean=False)}
    )[0]
    assert np.ptp(before) > 1.0
    assert np.array_equal(before, after)
