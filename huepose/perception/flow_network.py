"""Optical flow by a network: NeuFlow v2 exported to ONNX, behind the same protocol as DIS.

Its inputs are two images, float 1 x 3 x H x W, BGR in 0..1, sides multiples of 16. Its output is the flow
from the first to the second in pixels of the input, 2 x H x W or 1 x 2 x H x W. The window is resized to
the input's size, so the flow's *values* are scaled back as well as its grid, each axis by its own ratio.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.box import Box
from huepose.perception.sessions import Network, Tensor
from huepose.propose.flow import MIN_SIDE, Flow, consistency

STEP = 16
OPEN_SIZE = (256, 320)
"""Height and width of the input if the file leaves them open."""


class NetworkFlow:
    """A FlowSource. Raises InputError if the network is not of this kind."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._size = _input_size(network)
        blank = np.zeros((1, 3, *self._size), np.float32)
        flow = network.run({tensor.name: blank for tensor in network.inputs})[network.outputs[0].name]
        if flow.shape not in ((2, *self._size), (1, 2, *self._size)):
            raise network.refused(f"one output 2 x {self._size[0]} x {self._size[1]}")

    def __call__(self, color_a: UInt8, color_b: UInt8, box: Box) -> Flow | None:
        """See FlowSource."""
        rows, columns = _shaped(box, self._size, color_a.shape).slices(color_a.shape[1], color_a.shape[0])
        height, width = rows.stop - rows.start, columns.stop - columns.start
        if height < MIN_SIDE or width < MIN_SIDE:
            return None
        a, b = (_tensor(color[rows, columns], self._size) for color in (color_a, color_b))
        forward, backward = self._flow(a, b, height, width), self._flow(b, a, height, width)
        if not (np.isfinite(forward).all() and np.isfinite(backward).all()):
            return None
        return Flow(forward, backward, consistency(forward, backward), columns.start, rows.start)

    def _flow(self, a: Float32, b: Float32, height: int, width: int) -> Float32:
        """Flow (height, width, 2) in pixels of a window of that size."""
        first, second = self._network.inputs
        out = self._network.run({first.name: a, second.name: b})[self._network.outputs[0].name]
        flow = np.ascontiguousarray(out.reshape(2, *self._size).transpose(1, 2, 0), dtype=np.float32)
        ratio = np.array([width / self._size[1], height / self._size[0]], np.float32)
        return np.asarray(cv2.resize(flow, (width, height)) * ratio, np.float32)


def _input_size(network: Network) -> tuple[int, int]:
    """Height and width of both inputs."""
    wanted = "two inputs of float 1 x 3 x H x W, sides multiples of 16"
    if len(network.inputs) != 2 or not all(_is_image(tensor) for tensor in network.inputs):
        raise network.refused(wanted, "Export NeuFlow v2 with two images as its inputs.")
    sizes = [
        tuple(side if isinstance(side, int) else OPEN_SIZE[k] for k, side in enumerate(tensor.shape[2:]))
        for tensor in network.inputs
    ]
    height, width = sizes[0]
    if sizes[0] != sizes[1] or height % STEP or width % STEP:
        raise network.refused(wanted)
    return height, width


def _is_image(tensor: Tensor) -> bool:
    return len(tensor.shape) == 4 and tensor.shape[1] == 3 and tensor.kind == "tensor(float)"


def _shaped(box: Box, size: tuple[int, int], image_shape: tuple[int, ...]) -> Box:
    """The box, made wider or higher as far as the image has room, so that resizing distorts it as little as
    possible."""
    width = max(box.w, box.h * size[1] / size[0])
    height = max(box.h, box.w * size[0] / size[1])
    width, height = min(width, image_shape[1]), min(height, image_shape[0])
    x = min(max(box.x - (width - box.w) / 2, 0.0), image_shape[1] - width)
    y = min(max(box.y - (height - box.h) / 2, 0.0), image_shape[0] - height)
    return Box(x, y, width, height)


def _tensor(window: UInt8, size: tuple[int, int]) -> Float32:
    """A window (H, W, 3) RGB as the network's input."""
    # If the window is larger, plain interpolation would skip pixels and displace small details.
    kind = cv2.INTER_AREA if window.shape[1] > size[1] else cv2.INTER_LINEAR
    scaled = cv2.resize(np.ascontiguousarray(window[..., ::-1]), (size[1], size[0]), interpolation=kind)
    return np.ascontiguousarray(scaled.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)
