"""The packaged network of view codes as a start for training: its first blocks are kept, the last are
trained.

The packaged file holds weights of 8 bits with batch norm folded in. Here they become a network again that
computes the same: each convolution gets its weights, and each batch norm the statistics of its inputs on some
pictures, with a scale and an offset that undo them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from huepose.geometry.arrays import Float32
from huepose.propose.view_codes import WEIGHTS
from huepose.training.view_code_network import DEPTHS, Block, ViewCodeNetwork

KEPT_MODULES = 6 + DEPTHS[0]
"""Of the network's body: two downsamplings of three modules each, and the blocks at 1/4 of the side."""


def packaged_network(pictures: Tensor) -> ViewCodeNetwork:
    """The packaged network, ready to be trained from the blocks at 1/8 of the side on. pictures (N, 6, 64,
    64): a batch like those of the training, for the statistics of batch norm."""
    net, weights = ViewCodeNetwork(), _weights(WEIGHTS / "views.onnx")
    for conv, norm in _convolutions(net):
        weight, bias = next(weights)
        conv.weight.data = torch.from_numpy(weight)
        if norm is None:
            assert conv.bias is not None
            conv.bias.data = torch.from_numpy(bias)
        else:
            norm.running_var.fill_(1.0 - norm.eps)
            norm.bias.data = torch.from_numpy(bias)
    net.eval()
    for _, norm in _convolutions(net):
        if norm is not None:
            _measure(net, norm, pictures)
    net.body[:KEPT_MODULES].requires_grad_(False)
    return net


def _measure(net: ViewCodeNetwork, norm: nn.BatchNorm2d, pictures: Tensor) -> None:
    """Give a batch norm the statistics of its inputs; what it computes stays the same."""
    inputs: list[Tensor] = []
    hook = norm.register_forward_pre_hook(lambda _, x: inputs.append(x[0]))
    with torch.no_grad():
        net(pictures)
    hook.remove()
    mean, variance = inputs[0].mean((0, 2, 3)), inputs[0].var((0, 2, 3))
    norm.bias.data = norm.bias.data + mean * norm.weight.data
    norm.weight.data = norm.weight.data * torch.sqrt(variance + norm.eps)
    norm.running_mean.copy_(mean)
    norm.running_var.copy_(variance)


def _convolutions(net: ViewCodeNetwork) -> Iterator[tuple[nn.Conv2d, nn.BatchNorm2d | None]]:
    """The convolutions of a network in the order of computation, each with the batch norm behind it."""
    modules = [*net.body, None]
    for module, following in pairwise(modules):
        if isinstance(module, Block):
            yield from ((module.depthwise, module.norm), (module.expand, None), (module.project, None))
        elif isinstance(module, nn.Conv2d):
            yield module, following if isinstance(following, nn.BatchNorm2d) else None


def _weights(file: Path) -> Iterator[tuple[Float32, Float32]]:
    """Weights and biases of the convolutions of a quantised ONNX file, in the order of computation."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(file).graph
    stored = {x.name: numpy_helper.to_array(x) for x in graph.initializer}
    producer = {name: node for node in graph.node for name in node.output}

    def value(name: str) -> Float32:
        node = producer[name]
        steps, scale, zero = (stored[x].astype(np.float32) for x in node.input)
        axis = next((a.i for a in node.attribute if a.name == "axis"), 0)
        shape = [-1 if k == axis and scale.size > 1 else 1 for k in range(steps.ndim)]
        return np.asarray((steps - zero.reshape(shape)) * scale.reshape(shape), np.float32)

    for node in graph.node:
        if node.op_type == "Conv":
            yield value(node.input[1]), value(node.input[2])
