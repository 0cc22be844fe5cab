"""Does a window show an object in a pose? A small network compares the window with the object's clean view.

Codes compare a window with hundreds of views, so each image is encoded alone. Here the pose is known: the
two images are aligned, and the network sees where colours, relief and outline agree, and what is occluded
by something nearer. It was trained on procedurally generated objects and scenes
(`huepose.training.verification`) and knows none of a user's objects. A network that compares an image and a
rendering: Labbé et al., MegaPose (CoRL 2022).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.propose.view_codes import BATCH, packaged_session
from huepose.propose.view_images import CHANNELS, STEP, ZERO, network_input

WEIGHTS = Path(__file__).parent / "weights"
"""verification.onnx; verification.json beside it says how it was made."""

SUREST = 5.0
"""Largest absolute log-odds of a pair: beyond it, the network has seen too few examples."""

Images = tuple[UInt8, Float32]
"""Colours (N, 64, 64, 3) and relief (N, 64, 64), as `view_images` makes them."""


def verified(windows: Images, views: Images) -> Float64:
    """Log-odds (N,) that each window shows the object as its clean view does, from -SUREST to SUREST."""
    session = packaged_session(WEIGHTS / "verification.onnx")
    parts = []
    for k in range(0, len(windows[0]), BATCH):
        some = slice(k, k + BATCH)
        window = _numbers(windows[0][some], windows[1][some], clean=False)
        view = _numbers(views[0][some], views[1][some], clean=True)
        parts += session.run(None, {"pair": np.concatenate([window, view], 1)})
    logits = np.concatenate(parts) if parts else np.zeros(0)
    return np.clip(np.asarray(logits, np.float64), -SUREST, SUREST)


def _numbers(colors: UInt8, reliefs: Float32, *, clean: bool) -> Float32:
    """The network's input (N, 6, 64, 64) for images."""
    levels = network_input(colors, reliefs, clean=clean)[..., :CHANNELS].astype(np.float32) - np.float32(ZERO)
    return np.asarray((levels * STEP).transpose(0, 3, 1, 2), np.float32)
