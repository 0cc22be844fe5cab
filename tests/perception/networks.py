"""Small networks whose answers are known, written as ONNX files."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

_OPSET, _IR = 17, 9


def save(path, nodes, inputs, outputs, constants=None, metadata=None):
    """inputs and outputs: {name: shape}, all float; constants: {name: array}."""
    graph = helper.make_graph(
        nodes,
        "known",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in inputs.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in (constants or {}).items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = _IR
    if metadata:
        helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


def constant_output(path, output, input_shape=(1, 3, 64, 64), metadata=None):
    """The same array for every image."""
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["answer", "nothing"], ["output"]),
    ]
    constants = {"zero": np.float32(0.0), "answer": np.asarray(output, np.float32)}
    return save(path, nodes, {"images": input_shape}, {"output": np.shape(output)}, constants, metadata)


def identity(path, shape):
    return save(
        path, [helper.make_node("Identity", ["images"], ["output"])], {"images": shape}, {"output": shape}
    )


def in_half_precision(source, path):
    """The same network, all its floats in half precision."""
    model = onnx.load(str(source))
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.elem_type = TensorProto.FLOAT16
    for tensor in model.graph.initializer:
        array = numpy_helper.to_array(tensor)
        if array.dtype == np.float32:
            tensor.CopyFrom(numpy_helper.from_array(array.astype(np.float16), tensor.name))
    for attribute in (a for node in model.graph.node for a in node.attribute if a.name == "to"):
        attribute.i = TensorProto.FLOAT16
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


def sam_encoder(path, size=(1024, 1024)):
    """The embedding's first channels are the image's colours, averaged over 16 x 16 pixels; the rest 0. It
    works at 1024 x 1024 only; size: as the file states it."""
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[16, 16], strides=[16, 16]),
        helper.make_node("Reshape", ["pooled", "cells"], ["inner"]),
        helper.make_node("Pad", ["inner", "pads"], ["image_embeddings"]),
    ]
    constants = {
        "cells": np.array([1, 3, 64, 64], np.int64),
        "pads": np.array([0, 0, 0, 0, 0, 253, 0, 0], np.int64),
    }
    return save(path, nodes, {"image": (1, 3, *size)}, {"image_embeddings": (1, 256, 64, 64)}, constants)


def sam_decoder(path, ious=(0.3, 0.9, 0.5)):
    """The second mask is the prompted box, as the distance to its nearest side in pixels of the square.

    A point labelled 2 is its upper left corner, 3 its lower right one; any other labels give nothing. As in
    the real one, half a pixel is added to the points. The first mask is everything, the third nothing."""
    centres = np.arange(256, dtype=np.float32) * 4 + 2
    ys, xs = np.meshgrid(centres, centres, indexing="ij")
    labels = {"two": np.array([[2.0]], np.float32), "three": np.array([[3.0]], np.float32)}
    nodes = [helper.make_node("Add", ["point_coords", "half"], ["points"])]
    for name in labels:  # the point with that label: the sum of points times (label is it)
        nodes += [
            helper.make_node("Equal", ["point_labels", name], [f"{name}_is"]),
            helper.make_node("Cast", [f"{name}_is"], [f"{name}_weight"], to=TensorProto.FLOAT),
            helper.make_node("Unsqueeze", [f"{name}_weight", "last"], [f"{name}_column"]),
            helper.make_node("Mul", ["points", f"{name}_column"], [f"{name}_points"]),
            helper.make_node("ReduceSum", [f"{name}_points", "second"], [f"{name}_point"], keepdims=0),
            helper.make_node("Split", [f"{name}_point"], [f"{name}_x", f"{name}_y"], axis=1),
        ]
    nodes += [
        helper.make_node("Sub", ["xs", "two_x"], ["from_left"]),
        helper.make_node("Sub", ["three_x", "xs"], ["from_right"]),
        helper.make_node("Sub", ["ys", "two_y"], ["from_top"]),
        helper.make_node("Sub", ["three_y", "ys"], ["from_bottom"]),
        helper.make_node("Min", ["from_left", "from_right", "from_top", "from_bottom"], ["inside"]),
        helper.make_node("Reshape", ["inside", "as_mask"], ["box"]),
        # As in the real one, every input has an effect, or its place in the interface would not be tested.
        helper.make_node("ReduceSum", ["mask_input"], ["mask_sum"], keepdims=0),
        helper.make_node("Mul", ["mask_sum", "has_mask_input"], ["from_mask"]),
        helper.make_node("ReduceMax", ["image_embeddings"], ["brightest"], keepdims=0),
        helper.make_node("Mul", ["brightest", "zero"], ["from_image"]),
        helper.make_node("Sum", ["box", "from_mask", "from_image"], ["second_mask"]),
        helper.make_node("Concat", ["all", "second_mask", "none"], ["low_res_masks"], axis=1),
        helper.make_node("Identity", ["scores"], ["iou_predictions"]),
    ]
    constants = {
        **labels,
        "half": np.float32(0.5),
        "last": np.array([2], np.int64),
        "second": np.array([1], np.int64),
        "xs": xs,
        "ys": ys,
        "as_mask": np.array([1, 1, 256, 256], np.int64),
        "zero": np.float32(0.0),
        "all": np.ones((1, 1, 256, 256), np.float32),
        "none": -np.ones((1, 1, 256, 256), np.float32),
        "scores": np.array([ious], np.float32),
    }
    inputs = {
        "image_embeddings": (1, 256, 64, 64),
        "point_coords": (1, "num_points", 2),
        "point_labels": (1, "num_points"),
        "mask_input": (1, 1, 256, 256),
        "has_mask_input": (1,),
    }
    outputs = {"iou_predictions": (1, 3), "low_res_masks": (1, 3, 256, 256)}
    return save(path, nodes, inputs, outputs, constants)


def blue_follower(path, height, width):
    """NeuFlow's interface. The flow is everywhere the motion of the middle of the first channel (blue, in
    BGR), in pixels of the input; zero if values of an image exceed 1."""
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    constants = {"xs": xs[None], "ys": ys[None], "first": np.array([0], np.int64), "one": np.float32(1.0)}
    nodes = []
    for k in (1, 2):
        nodes += [
            helper.make_node("Gather", [f"img{k}", "first"], [f"blue{k}"], axis=1),
            helper.make_node("Squeeze", [f"blue{k}", "first_axis"], [f"plane{k}"]),
            helper.make_node("ReduceSum", [f"plane{k}"], [f"mass{k}"], keepdims=0),
            helper.make_node("Max", [f"mass{k}", "small"], [f"weight{k}"]),
            helper.make_node("ReduceMax", [f"img{k}"], [f"most{k}"], keepdims=0),
        ]
        for axis in ("x", "y"):
            nodes += [
                helper.make_node("Mul", [f"plane{k}", f"{axis}s"], [f"{axis}_by{k}"]),
                helper.make_node("ReduceSum", [f"{axis}_by{k}"], [f"{axis}_sum{k}"], keepdims=0),
                helper.make_node("Div", [f"{axis}_sum{k}", f"weight{k}"], [f"{axis}_at{k}"]),
            ]
    nodes += [
        helper.make_node("Max", ["most1", "most2"], ["most"]),
        helper.make_node("LessOrEqual", ["most", "one"], ["in_range"]),
        helper.make_node("Cast", ["in_range"], ["valid"], to=TensorProto.FLOAT),
    ]
    for axis in ("x", "y"):
        nodes += [
            helper.make_node("Sub", [f"{axis}_at2", f"{axis}_at1"], [f"d{axis}"]),
            helper.make_node("Mul", [f"d{axis}", "valid"], [f"moved_{axis}"]),
            helper.make_node("Add", ["plane_of_zeros", f"moved_{axis}"], [f"flow_{axis}"]),
        ]
    nodes.append(helper.make_node("Concat", ["flow_x", "flow_y"], ["flow"], axis=0))
    constants |= {
        "first_axis": np.array([0], np.int64),
        "small": np.float32(1e-6),
        "plane_of_zeros": np.zeros((1, height, width), np.float32),
    }
    inputs = {name: (1, 3, height, width) for name in ("img1", "img2")}
    return save(path, nodes, inputs, {"flow": (2, height, width)}, constants)
