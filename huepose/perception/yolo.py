"""A detector of the YOLO family, from an ONNX file that its user has trained.

Its classes are the user's: each object is told which of them mean it. A class that means several objects
gives each of them the box; the estimator tells them apart.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence

import numpy as np

from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.perception.letterbox import Letterbox, suppress_overlaps
from huepose.perception.sessions import Network
from huepose.perception.types import Detection
from huepose.perception.yolo_layouts import LAYOUTS, candidates, classes_in, is_raw, layouts_of
from huepose.support.errors import InputError

_NAMES = """
person, bicycle, car, motorcycle, airplane, bus, train, truck, boat, traffic light, fire hydrant, stop sign,
parking meter, bench, bird, cat, dog, horse, sheep, cow, elephant, bear, zebra, giraffe, backpack, umbrella,
handbag, tie, suitcase, frisbee, skis, snowboard, sports ball, kite, baseball bat, baseball glove,
skateboard, surfboard, tennis racket, bottle, wine glass, cup, fork, knife, spoon, bowl, banana, apple,
sandwich, orange, broccoli, carrot, hot dog, pizza, donut, cake, chair, couch, potted plant, bed,
dining table, toilet, tv, laptop, mouse, remote, keyboard, cell phone, microwave, oven, toaster, sink,
refrigerator, book, clock, vase, scissors, teddy bear, hair drier, toothbrush
"""
COCO_CLASSES = tuple(name.strip() for name in _NAMES.split(","))


Class = int | str


class YoloDetector:
    """Finds objects by the classes of a network.

    classes: by object, the numbers or names of its classes; layout: one of LAYOUTS, or `auto`. Raises
    InputError when the network is none of the family, or has no such class."""

    def __init__(
        self,
        network: Network,
        classes: Mapping[str, Sequence[Class]],
        *,
        layout: str = "auto",
        confidence: float = 0.25,
        overlap: float = 0.45,
    ) -> None:
        self._network, self._confidence, self._overlap = network, confidence, overlap
        self._input_size = _input_size(network)
        # The first run proves that the file works, and shows the shape where the file leaves it open.
        grey = np.full((1, 3, *self._input_size), 114.0 / 255.0, np.float32)
        output = network.run({network.inputs[0].name: grey})[network.outputs[0].name]
        self.layout = _layout(network, output, self._input_size, layout)
        self._classes = self._numbers(classes, classes_in(self.layout, output.shape))

    def _numbers(
        self, classes: Mapping[str, Sequence[Class]], count: int | None
    ) -> dict[str, frozenset[int]]:
        """The classes of each object as numbers."""
        names = class_names(self._network, count)
        numbers: dict[str, frozenset[int]] = {}
        for name, given in classes.items():
            for one in given:
                wrong = one not in names if isinstance(one, str) else count is not None and one >= count
                if wrong:
                    known = ", ".join(names) if names else "no names in the file"
                    raise InputError(
                        f"{self._network.path}: class '{one}' of {name}",
                        found=f"{'any number of' if count is None else count} classes ({known:.200})",
                        expected="a name of these, or a number from 0",
                    )
            numbers[name] = frozenset(names.index(one) if isinstance(one, str) else one for one in given)
        return numbers

    def detect(self, frame: RgbdFrame, names: Sequence[str]) -> list[Detection]:
        """Boxes of the named objects, best first; several of one name are several instances."""
        box_of = Letterbox.of(frame.color.shape[:2], self._input_size, centered=not self._is_yolox)
        tensor = self._tensor(box_of.apply(frame.color, self._input_size))
        output = self._network.run({self._network.inputs[0].name: tensor})[self._network.outputs[0].name]
        found = candidates(output, self.layout, self._input_size, self._confidence)
        corners = box_of.back(found.corners)
        if self.layout == "end2end":
            kept = np.argsort(-found.scores, kind="stable")
        else:
            kept = suppress_overlaps(corners, found.scores, found.classes, self._overlap)
        height, width = frame.color.shape[:2]
        detections = []
        for i in kept:
            x0, y0, x1, y1 = corners[i].tolist()
            box = Box(x0, y0, x1 - x0, y1 - y0).clipped(width, height)
            if box.w >= 1.0 and box.h >= 1.0:
                mine = (n for n in names if int(found.classes[i]) in self._classes.get(n, ()))
                detections += [Detection(name, box, float(found.scores[i])) for name in mine]
        return detections

    @property
    def _is_yolox(self) -> bool:
        return self.layout in ("yolox", "yolox_raw")

    def _tensor(self, image: UInt8) -> Float32:
        """YOLOX takes BGR up to 255, the others RGB up to 1; all channel by channel."""
        if self._is_yolox:
            return np.ascontiguousarray(image[..., ::-1].transpose(2, 0, 1)[None], dtype=np.float32)
        return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)


def class_names(network: Network, count: int | None) -> tuple[str, ...]:
    """Names of the classes: from the file where it has them, those of COCO where it has 80 classes."""
    text = network.metadata.get("names")
    if text is not None:
        try:
            names = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            names = {}
        if isinstance(names, dict) and names:
            return tuple(str(names.get(i, i)) for i in range(max(names) + 1))
    return COCO_CLASSES if count == len(COCO_CLASSES) else ()


def _input_size(network: Network) -> tuple[int, int]:
    """Height and width of the input; 640 where the file leaves them open."""
    shape = network.inputs[0].shape if len(network.inputs) == 1 else ()
    if len(shape) != 4 or shape[1] != 3 or network.inputs[0].kind != "tensor(float)":
        raise network.refused("one input of float 1 x 3 x H x W")
    height, width = (size if isinstance(size, int) else 640 for size in shape[2:])
    if height % 32 or width % 32:
        raise network.refused("an input whose sides are multiples of 32")
    return height, width


def _layout(network: Network, output: Float32, input_size: tuple[int, int], named: str) -> str:
    """The layout of an output. Raises InputError, showing the shapes, when it is none or several."""
    possible = layouts_of(output.shape, input_size)
    if "yolox" in possible and named in ("auto", "yolox_raw") and (named == "yolox_raw" or is_raw(output)):
        possible = tuple("yolox_raw" if p == "yolox" else p for p in possible)
    if named != "auto" and named in possible:
        return named
    if named == "auto" and len(possible) == 1:
        return possible[0]
    shape = " x ".join(map(str, output.shape))
    if possible and named == "auto":
        fix = f"Name it: detector.layout: {' or '.join(possible)}."
        raise network.refused(f"one layout; {shape} can be {' and '.join(possible)}", fix)
    fits = (
        f"{named}, which {shape} is not" if named != "auto" else f"one of {', '.join(LAYOUTS)}; got {shape}"
    )
    raise network.refused(fits, "docs/networks.md shows the layouts; export it without other heads.")
