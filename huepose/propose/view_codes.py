"""Codes of views: descriptors that compare views of a model with windows of a frame, in any light and for
any sensor.

One small network encodes a model's clean views and the windows of a frame (`view_images`). It gives 16
numbers to each of 8 x 8 cells. The likeness of a window and a view is the sum of products over the cells
that the view covers, so an occluded part costs only its own cells. The network was trained on procedurally
generated objects and scenes (`huepose.training.view_codes`) and knows none of a user's objects. Local codes
that are compared on the template's mask: Nguyen et al., Templates for 3D Object Pose Estimation Revisited
(CVPR 2022).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.mesh import Mesh
from huepose.propose.view_images import SIDE, network_input, turned, upright_views

CELLS = 8
"""Cells of a code along each side."""

NUMBERS = 16
"""Numbers of each cell."""

BATCH = 16
"""Windows per run of the network: the results of more do not stay in a core's cache."""

WEIGHTS = Path(__file__).parent / "weights"
"""views.onnx; views.json beside it says how it was made."""

_SMALLEST = 1e-6


def codes_of_views(mesh: Mesh, diameter_m: float) -> Float32:
    """Codes (N, D) of unit length of all views of a mesh at all rolls (0.3 s)."""
    return codes_of_images(*turned(*upright_views(mesh, diameter_m)))


def codes_of_images(colors: UInt8, reliefs: Float32) -> Float32:
    """Codes (N, D) of unit length of clean views: colours (N, 64, 64, 3) and relief (N, 64, 64)."""
    codes = _codes(colors, reliefs, clean=True) * in_cells(np.isfinite(reliefs))[:, None]
    return _of_unit_length(codes.reshape(len(codes), -1))


def in_cells(shares: np.ndarray) -> Float32:
    """Means (N, 8, 8) of images (N, 64, 64)."""
    each = SIDE // CELLS
    return np.asarray(shares.reshape(-1, CELLS, each, CELLS, each).mean((2, 4)), np.float32)


def codes_of_windows(colors: UInt8, reliefs: Float32) -> Float32:
    """Codes (W, D) of the windows of a frame: the likeness is the scalar product with a view's code."""
    codes = _codes(colors, reliefs, clean=False)
    length = np.maximum(np.linalg.norm(codes, axis=1, keepdims=True), np.float32(_SMALLEST))
    return np.asarray((codes / (CELLS * length)).reshape(len(codes), NUMBERS * CELLS**2), np.float32)


def _codes(colors: UInt8, reliefs: Float32, *, clean: bool) -> Float32:
    """The network's output (N, C, 8, 8)."""
    session, parts = packaged_session(WEIGHTS / "views.onnx"), []
    for k in range(0, len(colors), BATCH):
        some = slice(k, k + BATCH)
        parts += session.run(None, {"window": network_input(colors[some], reliefs[some], clean=clean)})
    return np.concatenate(parts) if parts else np.zeros((0, NUMBERS, CELLS, CELLS), np.float32)


def _of_unit_length(codes: Float32) -> Float32:
    length = np.maximum(np.linalg.norm(codes, axis=1, keepdims=True), np.float32(_SMALLEST))
    return np.asarray(codes / length, np.float32)


@cache
def packaged_session(file: Path) -> Any:
    """A network of this package, opened once per process; ONNX Runtime's sessions are thread-safe."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = 1, 1
    options.log_severity_level = 3
    return ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
