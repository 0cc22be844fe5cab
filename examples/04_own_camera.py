"""A camera of your own in a pipeline: a file with `frames()`, named in pipeline.yaml.

    camera: {source: python, path: examples/04_own_camera.py}

This one gives the frame of `huepose new`, with new noise each time; put your driver in its place.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from huepose import RgbdFrame
from huepose.datasets.image_files import read_frame

FOLDER = Path(os.environ.get("FRAME_FOLDER", "tea_box"))


def frames() -> Iterator[RgbdFrame]:
    still = read_frame(FOLDER / "color.png", FOLDER / "depth.png", FOLDER / "camera.json")
    noise = np.random.default_rng()
    while True:
        time.sleep(1 / 30)  # your driver waits for its next picture here
        captured_ns = time.monotonic_ns()
        color = (still.color + noise.normal(0.0, 2.0, still.color.shape)).clip(0, 255).astype(np.uint8)
        yield RgbdFrame(color, still.depth, still.camera, stamp_ns=captured_ns)
