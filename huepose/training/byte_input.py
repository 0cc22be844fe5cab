"""Lets the network of view codes read the bytes of `propose.view_images.network_input`.

A quantised network converts its input to bytes with the channels last, which takes an eighth of its time. The
caller can write the input in this form at once.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.propose.view_images import CHANNELS, PLACES, SIDE, STEP, ZERO


def read_bytes(file: Path) -> None:
    """Change a quantised network (QDQ format) in a file so that its input `window`, which a convolution
    reads, has bytes (N, 64, 64, 8) instead of numbers (N, 6, 64, 64). Its outputs stay the same if its own
    quantisation had the same step and zero."""
    import onnx
    from onnx import helper, numpy_helper

    model = onnx.load(str(file))
    graph, arrays = model.graph, {array.name: array for array in model.graph.initializer}
    quantised = next(node for node in graph.node if "window" in node.input)
    read = next(node for node in graph.node if quantised.output[0] in node.input)
    first = next(node for node in graph.node if read.output[0] in node.input)
    weights = next(node.input[0] for node in graph.node if first.input[1] in node.output)
    plain = numpy_helper.to_array(arrays[weights])
    padded = np.zeros((len(plain), PLACES, *plain.shape[2:]), plain.dtype)
    padded[:, :CHANNELS] = plain
    for name, value in ((weights, padded), (read.input[1], STEP), (read.input[2], np.uint8(ZERO))):
        arrays[name].CopyFrom(numpy_helper.from_array(np.asarray(value), name))
    graph.node.remove(quantised)
    graph.node.insert(0, helper.make_node("Transpose", ["window"], [quantised.output[0]], perm=(0, 3, 1, 2)))
    shape = ["n", SIDE, SIDE, PLACES]
    graph.input[0].CopyFrom(helper.make_tensor_value_info("window", onnx.TensorProto.UINT8, shape))
    onnx.checker.check_model(model)
    onnx.save(model, str(file))
