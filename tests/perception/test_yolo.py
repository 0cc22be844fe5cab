"""The YOLO detector on networks of every layout, whose boxes are known."""

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.perception.sessions import open_network
from huepose.perception.yolo import Letterbox, YoloDetector, layouts_of, places, suppress_overlaps
from huepose.support.errors import InputError
from tests.perception import networks

SIDE = 64
GRID = places((SIDE, SIDE))  # 64 + 16 + 4
# An image of 128 x 96: scale 0.5 in the input, 48 rows high, 8 rows from the top where it is in the middle.
WIDTH, HEIGHT = 128, 96
BOX = (20.0, 30.0, 40.0, 20.0)
CLASSES = 3


def _input_box(top):
    """Centre and size of BOX in pixels of the input."""
    x, y, w, h = BOX
    return [(x + w / 2) / 2, (y + h / 2) / 2 + top, w / 2, h / 2]


def _rows(count, top, objectness):
    """`count` places: BOX as class 2 with 0.8, nearly the same box with 0.6, BOX as class 1 with 0.7."""
    rows = np.zeros((count, 4 + objectness + CLASSES), np.float32)
    rows[:, :4] = [32, 32, 8, 8]
    scores = {5: (2, 0.8), 6: (2, 0.6), 70: (1, 0.7)}
    for place, (number, score) in scores.items():
        rows[place, :4] = _input_box(top)
        rows[place, 0] += place == 6
        rows[place, 4 + objectness + number] = score / (0.8 if objectness else 1.0)
        if objectness:
            rows[place, 4] = 0.8
    return rows


def _raw(rows):
    """The same boxes before YOLOX decodes them."""
    strides = np.repeat([8, 16, 32], [64, 16, 4]).astype(np.float32)
    columns = np.concatenate([np.tile(np.arange(n), n) for n in (8, 4, 2)])
    lines = np.concatenate([np.repeat(np.arange(n), n) for n in (8, 4, 2)])
    raw = rows.copy()
    raw[:, 0], raw[:, 1] = rows[:, 0] / strides - columns, rows[:, 1] / strides - lines
    raw[:, 2:4] = np.log(rows[:, 2:4] / strides[:, None])
    return raw


def _end2end():
    x, y, w, h = BOX
    corners = [x / 2, y / 2 + 8, (x + w) / 2, (y + h) / 2 + 8]
    rows = np.zeros((30, 6), np.float32)
    rows[3], rows[7] = [*corners, 0.8, 2], [*corners, 0.7, 1]
    return rows


OUTPUTS = {
    "v8": lambda: _rows(GRID, 8, 0).T,
    "v5": lambda: _rows(3 * GRID, 8, 1),
    "yolox": lambda: _rows(GRID, 0, 1),
    "yolox_raw": lambda: _raw(_rows(GRID, 0, 1)),
    "end2end": _end2end,
}


def _network(tmp_path, output, **more):
    return open_network(
        networks.constant_output(tmp_path / "net.onnx", output[None], (1, 3, SIDE, SIDE), **more)
    )


def _frame(color=(10, 20, 30)):
    image = np.full((HEIGHT, WIDTH, 3), color, np.uint8)
    return RgbdFrame(
        image, np.ones((HEIGHT, WIDTH), np.float32), Camera(99.0, 99.0, 64.0, 48.0, WIDTH, HEIGHT)
    )


@pytest.mark.parametrize("layout", OUTPUTS)
@pytest.mark.parametrize("named", [False, True])
def test_every_layout_gives_the_known_boxes(tmp_path, layout, named):
    network = _network(tmp_path, OUTPUTS[layout]())
    detector = YoloDetector(network, {"mug": [2], "can": [1]}, layout=layout if named else "auto")
    assert detector.layout == layout
    found = detector.detect(_frame(), ["mug", "can", "unknown"])
    # The second box of class 2 goes, the one of class 1 at the same place stays.
    assert [d.object for d in found] == ["mug", "can"]
    assert [d.score for d in found] == pytest.approx([0.8, 0.7], abs=1e-4)
    for detection in found:
        assert detection.box == pytest.approx(BOX, abs=1e-2)


def test_only_what_is_asked_for_and_sure_enough_is_given(tmp_path):
    network = _network(tmp_path, OUTPUTS["v8"]())
    detector = YoloDetector(network, {"mug": [2], "can": [1], "any": [0, 1, 2]}, confidence=0.75)
    assert [d.object for d in detector.detect(_frame(), ["can"])] == []
    assert [d.object for d in detector.detect(_frame(), ["any", "mug"])] == ["any", "mug"]


@pytest.mark.parametrize("layout", OUTPUTS)
def test_two_classes_of_one_object_at_one_place_are_one_instance(tmp_path, layout):
    detector = YoloDetector(_network(tmp_path, OUTPUTS[layout]()), {"mug": [1, 2], "can": [1]}, layout=layout)
    found = detector.detect(_frame(), ["mug", "can"])
    assert [(d.object, round(d.score, 2)) for d in found] == [("mug", 0.8), ("can", 0.7)]


@pytest.mark.parametrize("layout", ["v8", "v5", "end2end"])
def test_boxes_in_shares_of_the_image_are_refused(tmp_path, layout):
    """They would be boxes of one pixel in the corner, and nothing would ever be found. A network with a box
    at every place is refused at once, one that gives only what it finds at the first box."""
    output = OUTPUTS[layout]()
    boxes = output[:4] if layout == "v8" else output[:, :4]
    boxes /= SIDE
    network, said = (
        _network(tmp_path, output),
        r"net.onnx: found boxes within 0\.\d\d pixels .*not normalised",
    )
    if layout == "end2end":
        detector = YoloDetector(network, {"mug": [2]})
        with pytest.raises(InputError, match=said):
            detector.detect(_frame(), ["mug"])
    else:
        with pytest.raises(InputError, match=said):
            YoloDetector(network, {"mug": [2]}, layout=layout)


@pytest.mark.parametrize(
    "names",
    [
        "{0: 'box', 1: 'tin can', 2: 'mug'}",
        "{'0': 'box', '1': 'tin can', '2': 'mug'}",
        "['box', 'tin can', 'mug']",
    ],
)
def test_classes_by_name_come_from_the_file(tmp_path, names):
    network = _network(tmp_path, OUTPUTS["v8"](), metadata={"names": names})
    detector = YoloDetector(network, {"soup": ["tin can"]})
    assert [d.score for d in detector.detect(_frame(), ["soup"])] == pytest.approx([0.7])
    with pytest.raises(InputError, match=r"class 'cup' of mug: found 3 classes \(box, tin can, mug\)"):
        YoloDetector(network, {"mug": ["cup"]})
    for layout in ("v8", "end2end"):
        network = _network(tmp_path, OUTPUTS[layout](), metadata={"names": names})
        with pytest.raises(InputError, match=r"class '3' of mug: found 3 classes \(box, tin can, mug\)"):
            YoloDetector(network, {"mug": [3]})


@pytest.mark.parametrize(
    ("metadata", "found"),
    [
        # As exports for masks and keypoints have it: columns beside the scores would be classes.
        ({"names": "{0: 'box', 1: 'mug'}"}, "2 names of classes for 3 columns"),
        ({"names": "{0: 'box', 1: 'tin can', 2: 'mug'}", "task": "segment"}, "task segment"),
        ({"task": "pose"}, "task pose"),
    ],
)
def test_a_network_for_more_than_boxes_is_refused(tmp_path, metadata, found):
    network = _network(tmp_path, OUTPUTS["v8"](), metadata=metadata)
    with pytest.raises(InputError, match=rf"found {found}; expected a network for boxes alone"):
        YoloDetector(network, {"mug": [1]})
    named = {"names": "{0: 'box', 1: 'tin can', 2: 'mug'}", "task": "detect"}
    assert YoloDetector(_network(tmp_path, OUTPUTS["v8"](), metadata=named), {"mug": [1]}).layout == "v8"


def test_objects_without_a_class_are_named(tmp_path):
    detector = YoloDetector(_network(tmp_path, OUTPUTS["v8"]()), {"mug": [2], "can": []})
    assert detector.without_class(["mug", "can", "pan"]) == ["can", "pan"]


def test_a_network_of_80_classes_without_names_has_those_of_coco(tmp_path):
    rows = np.zeros((GRID, 84), np.float32)
    rows[5] = [*_input_box(8), *np.eye(80)[41] * 0.9]
    classes = {"mug": ["cup"], "bottle": ["bottle"]}
    with pytest.raises(InputError, match=r"cat, dog, [a-z ,]* and \d+ more\).*Did you mean 'book'\?"):
        YoloDetector(_network(tmp_path, rows.T), {"novel": ["bok"]}, layout="v8")
    detector = YoloDetector(_network(tmp_path, rows.T), classes, layout="v8")
    assert [d.object for d in detector.detect(_frame(), ["mug", "bottle"])] == ["mug"]


@pytest.mark.parametrize(
    ("layout", "expected"), [("v8", [255, 0, 0]), ("end2end", [255, 0, 0]), ("yolox", [0, 0, 255])]
)
def test_colours_have_the_order_and_range_of_the_layout(tmp_path, layout, expected):
    network = _network(tmp_path, OUTPUTS[layout]())
    detector, seen = YoloDetector(network, {"mug": [2]}), []
    run = network.run
    network.run = lambda feeds: seen.append(feeds["images"]) or run(feeds)
    detector.detect(_frame((255, 0, 0)), ["mug"])
    scale = 1 if layout == "yolox" else 255
    assert (seen[0][0, :, 20, 20] * scale).tolist() == expected
    grey_row = 60  # below the image in both
    assert seen[0][0, :, grey_row, 20] * scale == pytest.approx([114] * 3)


@pytest.mark.parametrize("shape", [(1, 7, 50), (1, 83, 6400), (4, 7), (1, 3, 8, 8, 7)])
def test_anything_else_is_refused_with_the_shapes(tmp_path, shape):
    path = networks.constant_output(tmp_path / "net.onnx", np.zeros(shape, np.float32), (1, 3, SIDE, SIDE))
    with pytest.raises(InputError) as error:
        YoloDetector(open_network(path), {"mug": [0]})
    assert " x ".join(map(str, shape)) in str(error.value)
    assert "v5, v8, yolox, yolox_raw, end2end" in str(error.value)


def test_a_shape_that_fits_two_layouts_has_to_be_named(tmp_path):
    # 84 places and 84 rows: 80 classes of v8, or 79 of YOLOX.
    square = np.zeros((GRID, GRID), np.float32)
    with pytest.raises(InputError, match=r"can be v8 and yolox.*detector\.layout: v8 or yolox"):
        YoloDetector(_network(tmp_path, square + 100), {"mug": [0]})
    assert YoloDetector(_network(tmp_path, square), {"mug": [0]}, layout="v8").layout == "v8"
    with pytest.raises(InputError, match="expected v5, which 1 x 84 x 84 is not"):
        YoloDetector(_network(tmp_path, square), {"mug": [0]}, layout="v5")


def test_a_network_of_another_kind_is_refused(tmp_path):
    path = networks.identity(tmp_path / "net.onnx", (1, 5))
    with pytest.raises(InputError, match="expected one input of float 1 x 3 x H x W"):
        YoloDetector(open_network(path), {"mug": [0]})


@pytest.mark.parametrize(("noted", "size"), [({"imgsz": "[64, 96]"}, (64, 96)), ({}, (640, 640))])
def test_an_input_of_free_size_gets_that_of_the_training(tmp_path, noted, size):
    output = np.zeros((1, 7, places(size)), np.float32)
    path = networks.constant_output(tmp_path / "net.onnx", output, (1, 3, "height", "width"), noted)
    detector = YoloDetector(open_network(path), {"mug": [2]})
    assert (detector.layout, detector._input_size) == ("v8", size)


def test_shapes_of_the_usual_sizes():
    assert (places((416, 416)), places((640, 640))) == (3549, 8400)
    assert layouts_of((1, 25200, 85), (640, 640)) == ("v5",)
    assert layouts_of((1, 3549, 85), (416, 416)) == ("yolox",)
    assert layouts_of((1, 8400, 6), (640, 640)) == ("yolox",)


@pytest.mark.parametrize("centered", [True, False])
def test_letterbox_and_back(centered):
    box = Letterbox.of((480, 640), (416, 416), centered)
    assert box == Letterbox(0.65, 0, 52 if centered else 0)
    corners = np.array([[0.0, 0.0, 640.0, 480.0]])
    inside = corners * box.scale + [box.left, box.top, box.left, box.top]
    assert box.back(inside) == pytest.approx(corners)
    image = box.apply(np.full((480, 640, 3), 7, np.uint8), (416, 416))
    assert (image[:, :, 0] == 7).sum() == 312 * 416
    assert (image[box.top] == 7).all()


def test_overlaps_are_suppressed_within_a_class_only():
    corners = np.array([[0, 0, 10, 10], [0, 0, 10, 9], [0, 0, 10, 10], [20, 0, 30, 10]], float)
    scores, classes = np.array([0.5, 0.9, 0.4, 0.1]), np.array([0, 0, 1, 0])
    assert suppress_overlaps(corners, scores, classes, 0.45).tolist() == [1, 2, 3]
    assert suppress_overlaps(corners, scores, classes, 0.95).tolist() == [1, 0, 2, 3]
