"""A detector of the YOLO family, from an ONNX file that the user has trained.

Its classes are the user's: each object has a list of the classes that mean it. If a class means several
objects, each of them gets the box, and the estimator distinguishes them. An image is scaled to fit the
network's input, the rest is filled with grey, and boxes are mapped back (`Letterbox`).

The layout of the output is recognised by its shape, or named by the user. An input of H x W has G = sum of
(H/s)(W/s) grid places over the strides s = 8, 16, 32:

| layout      | output            | columns                                             |
|-------------|-------------------|-----------------------------------------------------|
| `v8`        | 1 x (4+nc) x G    | cx cy w h, scores                                   |
| `v5`        | 1 x 3G x (5+nc)   | cx cy w h, objectness, scores                       |
| `yolox`     | 1 x G x (5+nc)    | the same                                            |
| `yolox_raw` | 1 x G x (5+nc)    | offset in its place and logarithm of size, by stride |
| `end2end`   | 1 x n x 6         | x0 y0 x1 y1, score, class; overlaps already removed |

`yolox` and `yolox_raw` have the same shape, but decoded boxes are hundreds of pixels and raw ones small
numbers. With one or two classes some shapes fit two layouts: then the layout has to be named."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.perception.sessions import Network
from huepose.perception.types import Detection
from huepose.support.errors import InputError
from huepose.support.words import did_you_mean, listed

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

    classes: numbers or names of the classes of each object; layout: one of LAYOUTS, or `auto`. Raises
    InputError if the network does not belong to the family, or has no such class."""

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
        # The first run proves that the file works, and shows the output's shape if the file leaves it open.
        grey = np.full((1, 3, *self._input_size), 114.0 / 255.0, np.float32)
        output = network.run({network.inputs[0].name: grey})[network.outputs[0].name]
        self.layout = _layout(network, output, self._input_size, layout)
        count = classes_in(self.layout, output.shape)
        _check_it_only_detects(network, count)
        if self.layout in ("v8", "v5"):  # these have a box at every place, also where nothing is
            self._check_pixels(candidates(output, self.layout, self._input_size, -1.0))
        self._classes = self._numbers(classes, count)

    def without_class(self, names: Iterable[str]) -> list[str]:
        """Those of these objects that no class means: they never get a box."""
        return [name for name in names if not self._classes.get(name)]

    def _numbers(
        self, classes: Mapping[str, Sequence[Class]], count: int | None
    ) -> dict[str, frozenset[int]]:
        """The classes of each object as numbers."""
        names = class_names(self._network, count)
        count = len(names) or None if count is None else count
        numbers: dict[str, frozenset[int]] = {}
        for name, given in classes.items():
            for one in given:
                wrong = one not in names if isinstance(one, str) else count is not None and one >= count
                if wrong:
                    known = listed(names) or "no names in the file"
                    raise InputError(
                        f"{self._network.path}: class '{one}' of {name}",
                        found=f"{'any number of' if count is None else count} classes ({known})",
                        expected="a name of these, or a number from 0",
                        fix=did_you_mean(str(one), names),
                    )
            numbers[name] = frozenset(names.index(one) if isinstance(one, str) else one for one in given)
        return numbers

    def detect(self, frame: RgbdFrame, names: Sequence[str]) -> list[Detection]:
        """Boxes of the named objects, best first; several of one name are several instances. Raises
        InputError if the network's boxes are not in pixels."""
        box_of = Letterbox.of(frame.color.shape[:2], self._input_size, centered=not self._is_yolox)
        tensor = self._tensor(box_of.apply(frame.color, self._input_size))
        output = self._network.run({self._network.inputs[0].name: tensor})[self._network.outputs[0].name]
        found = candidates(output, self.layout, self._input_size, self._confidence)
        self._check_pixels(found)
        corners = box_of.back(found.corners)
        if self.layout == "end2end":
            kept = np.argsort(-found.scores, kind="stable")
        else:
            kept = suppress_overlaps(corners, found.scores, found.classes, self._overlap)
        height, width = frame.color.shape[:2]
        detections: list[Detection] = []
        given: list[tuple[str, int, Box]] = []
        for i in kept:
            x0, y0, x1, y1 = corners[i].tolist()
            box, number = Box(x0, y0, x1 - x0, y1 - y0).clipped(width, height), int(found.classes[i])
            if box.w >= 1.0 and box.h >= 1.0:
                for name in (n for n in names if number in self._classes.get(n, ())):
                    # Two classes of one object at one place are one instance.
                    if not any(n == name and c != number and box.iou(b) > self._overlap for n, c, b in given):
                        given.append((name, number, box))
                        detections.append(Detection(name, box, float(found.scores[i])))
        return detections

    def _check_pixels(self, found: Candidates) -> None:
        if len(found.corners) and 0.0 < found.corners.max() <= _SHARES:
            raise InputError(
                self._network.path,
                found=f"boxes within {found.corners.max():.2f} pixels of the corner: normalised boxes?",
                expected=f"corners, or centres and sizes, in pixels of its input ({self.layout})",
                fix="Export the network again, with boxes that are not normalised.",
            )

    @property
    def _is_yolox(self) -> bool:
        return self.layout in ("yolox", "yolox_raw")

    def _tensor(self, image: UInt8) -> Float32:
        """The network's input, channels first: BGR up to 255 for YOLOX, RGB up to 1 for the others."""
        if self._is_yolox:
            return np.ascontiguousarray(image[..., ::-1].transpose(2, 0, 1)[None], dtype=np.float32)
        return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)


def class_names(network: Network, count: int | None) -> tuple[str, ...]:
    """Names of the classes: from the file if it has them; else those of COCO if there are 80 classes."""
    text = network.metadata.get("names")
    if text is not None:
        try:
            names = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            names = {}
        if isinstance(names, list | tuple):
            names = dict(enumerate(names))
        numbered = (
            {int(k): v for k, v in names.items() if str(k).isdigit()} if isinstance(names, dict) else {}
        )
        if numbered:
            return tuple(str(numbered.get(i, i)) for i in range(max(numbered) + 1))
    return COCO_CLASSES if count == len(COCO_CLASSES) else ()


def _check_it_only_detects(network: Network, count: int | None) -> None:
    """Raises InputError if the file says that the network is for another task, or lists another number of
    classes than the output has: masks and keypoints are columns beside the scores."""
    task, names = network.metadata.get("task", "detect"), class_names(network, None)
    if task == "detect" and (not names or count in (None, len(names))):
        return
    found = f"task {task}" if task != "detect" else f"{len(names)} names of classes for {count} columns"
    raise InputError(
        network.path,
        found=found,
        expected="a network for boxes alone (task detect), whose output has a column for each class",
        fix="Export a detector: a network for masks, keypoints or rotated boxes cannot be used.",
    )


def _input_size(network: Network) -> tuple[int, int]:
    """Height and width of the input. If the file leaves them open: those of the training, as Ultralytics
    notes them, else 640."""
    shape = network.inputs[0].shape if len(network.inputs) == 1 else ()
    if len(shape) != 4 or shape[1] != 3 or network.inputs[0].kind != "tensor(float)":
        raise network.refused("one input of float 1 x 3 x H x W")
    noted = re.fullmatch(r"\[(\d+), (\d+)\]", network.metadata.get("imgsz", ""))
    trained = (640, 640) if noted is None else tuple(map(int, noted.groups()))
    height, width = (size if isinstance(size, int) else trained[k] for k, size in enumerate(shape[2:]))
    if height % 32 or width % 32:
        raise network.refused("an input whose sides are multiples of 32")
    return height, width


def _layout(network: Network, output: Float32, input_size: tuple[int, int], named: str) -> str:
    """The layout of an output. Raises InputError, showing the shapes, if none or several fit."""
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


_GREY = 114


@dataclass(frozen=True)
class Letterbox:
    """How an image lies in the network's input: its scale, and the pixels left of it and above it."""

    scale: float
    left: int
    top: int

    @staticmethod
    def of(image_size: tuple[int, int], input_size: tuple[int, int], centered: bool) -> Letterbox:
        """For an image (height, width) in an input (height, width): in its middle, or in its upper left
        corner."""
        scale = min(input_size[0] / image_size[0], input_size[1] / image_size[1])
        height, width = round(image_size[0] * scale), round(image_size[1] * scale)
        if not centered:
            return Letterbox(scale, 0, 0)
        # Half a pixel goes to the right and below, as in the networks' own training.
        left = round((input_size[1] - width) / 2 - 0.1)
        top = round((input_size[0] - height) / 2 - 0.1)
        return Letterbox(scale, left, top)

    def apply(self, image: UInt8, input_size: tuple[int, int]) -> UInt8:
        """The image (H, W, 3) in an input of that (height, width), the rest grey."""
        size = (round(image.shape[1] * self.scale), round(image.shape[0] * self.scale))
        resized = (
            image if size == image.shape[1::-1] else cv2.resize(image, size).astype(np.uint8, copy=False)
        )
        out = np.full((*input_size, 3), _GREY, np.uint8)
        out[self.top : self.top + size[1], self.left : self.left + size[0]] = resized
        return out

    def back(self, corners: Float) -> Float64:
        """Boxes (N, 4) x0 y0 x1 y1 of the input, in pixels of the image."""
        offset = np.array([self.left, self.top, self.left, self.top], dtype=np.float64)
        return np.asarray((np.asarray(corners, np.float64) - offset) / self.scale)


def suppress_overlaps(corners: Float, scores: Float, classes: np.ndarray, overlap: float) -> np.ndarray:
    """Indices of the boxes to keep, best first: of two boxes of one class whose IoU is higher than
    `overlap`, only the better one.

    corners (N, 4) x0 y0 x1 y1, scores (N,), classes (N,)."""
    order = np.argsort(-scores, kind="stable")
    areas = np.prod(np.maximum(corners[:, 2:] - corners[:, :2], 0.0), axis=1)
    kept: list[int] = []
    while len(order):
        best, order = int(order[0]), order[1:]
        kept.append(best)
        low = np.maximum(corners[best, :2], corners[order, :2])
        high = np.minimum(corners[best, 2:], corners[order, 2:])
        common = np.prod(np.maximum(high - low, 0.0), axis=1)
        iou = common / np.maximum(areas[best] + areas[order] - common, 1e-12)
        order = order[(iou <= overlap) | (classes[order] != classes[best])]
    return np.array(kept, dtype=np.intp)


STRIDES = (8, 16, 32)
LAYOUTS = ("v5", "v8", "yolox", "yolox_raw", "end2end")
_SHARES = 2.0
"""If no box reaches farther than this from the corner, boxes are shares of the image's width and height."""
# Decoded centres reach across the input; raw offsets and logarithms stay below this.
_RAW_LIMIT = 24.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """Boxes (N, 4) x0 y0 x1 y1 in pixels of the input, scores (N,), classes (N,)."""

    corners: Float64
    scores: Float64
    classes: np.ndarray


def places(input_size: tuple[int, int]) -> int:
    """How many places the grids of the three strides have in an input (height, width)."""
    return sum((input_size[0] // s) * (input_size[1] // s) for s in STRIDES)


def layouts_of(shape: tuple[int, ...], input_size: tuple[int, int]) -> tuple[str, ...]:
    """The layouts that an output shape (1, rows, columns) can have; `yolox` stands for `yolox_raw` too.

    >>> layouts_of((1, 84, 8400), (640, 640)), layouts_of((1, 300, 6), (640, 640))
    (('v8',), ('end2end',))
    """
    if len(shape) != 3 or shape[0] != 1:
        return ()
    _, rows, columns = shape
    grid, found = places(input_size), []
    if columns == grid and rows >= 5:
        found.append("v8")
    if rows == 3 * grid and columns >= 6:
        found.append("v5")
    if rows == grid and columns >= 6:
        found.append("yolox")
    if columns == 6 and rows not in (grid, 3 * grid):
        found.append("end2end")
    return tuple(found)


def classes_in(layout: str, shape: tuple[int, ...]) -> int | None:
    """How many classes an output of a layout has; None if its shape does not say."""
    if layout == "end2end":
        return None
    return shape[1] - 4 if layout == "v8" else shape[2] - 5


def is_raw(output: Float) -> bool:
    """Whether the boxes in an output (1, G, 5+nc) of YOLOX are still offsets and logarithms, not
    decoded."""
    return bool(np.abs(output[0, :, :4]).max() < _RAW_LIMIT)


def candidates(output: Float, layout: str, input_size: tuple[int, int], confidence: float) -> Candidates:
    """The boxes of an output (1, rows, columns) whose score is over `confidence`."""
    rows = np.asarray(output[0], dtype=np.float32)
    if layout == "end2end":
        rows = rows[rows[:, 4] > confidence]
        return Candidates(
            rows[:, :4].astype(np.float64), rows[:, 4].astype(np.float64), rows[:, 5].astype(int)
        )
    if layout == "v8":
        boxes, scores = rows[:4].T, rows[4:].T
    else:
        boxes, scores = rows[:, :4], rows[:, 5:] * rows[:, 4:5]
    classes = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), classes]
    keep = np.flatnonzero(best > confidence)
    kept = boxes[keep].astype(np.float64)
    if layout == "yolox_raw":
        kept = _decoded(kept, keep, input_size)
    half = kept[:, 2:] / 2.0
    corners = np.concatenate([kept[:, :2] - half, kept[:, :2] + half], axis=1)
    return Candidates(corners, best[keep].astype(np.float64), classes[keep])


def _decoded(boxes: Float64, index: np.ndarray, input_size: tuple[int, int]) -> Float64:
    """Raw boxes (N, 4) of the grid places `index`, decoded: centre (offset + place) stride, size exp(size)
    stride."""
    grids, strides = [], []
    for stride in STRIDES:
        height, width = input_size[0] // stride, input_size[1] // stride
        ys, xs = np.mgrid[0:height, 0:width]
        grids.append(np.stack([xs, ys], -1).reshape(-1, 2))
        strides.append(np.full((height * width, 1), stride))
    grid, stride_of = np.concatenate(grids)[index], np.concatenate(strides)[index]
    centres = (boxes[:, :2] + grid) * stride_of
    sizes = np.exp(np.minimum(boxes[:, 2:], 10.0)) * stride_of
    return np.asarray(np.concatenate([centres, sizes], axis=1))
