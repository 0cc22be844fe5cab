"""Your own camera in a pipeline: a file with `frames()`, named in pipeline.yaml.

    camera: {source: python, path: ../examples/04_own_camera.py}   # in tea_box/pipeline.yaml

This one gives the frame of `huepose new` thirty times a second, each time with new noise; replace it with
your driver. The frame is read from the folder `tea_box` beside `examples`, or from $FRAME_FOLDER.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from huepose import RgbdFrame
from huepose.datasets.image_files import read_frame

FOLDER = Path(os.environ.get("FRAME_FOLDER", Path(__file__).parents[1] / "tea_box"))


def frames() -> Iterator[RgbdFrame]:
    still = read_frame(FOLDER / "color.png", FOLDER / "depth.png", FOLDER / "camera.json")
    rng = np.random.default_rng()
    due_s = time.monotonic()
    while True:
        due_s += 1 / 30
        time.sleep(max(0.0, due_s - time.monotonic()))  # your driver waits for its next image here
        captured_ns = time.monotonic_ns()
        noise = rng.integers(-3, 4, still.color.shape, np.int16)
        color = (still.color + noise).clip(0, 255).astype(np.uint8)
        yield RgbdFrame(color, still.depth, still.camera, stamp_ns=captured_ns)
