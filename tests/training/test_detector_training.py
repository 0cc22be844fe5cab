import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

from huepose.geometry import Camera, RgbdFrame  # noqa: E402
from huepose.perception.sessions import open_network  # noqa: E402
from huepose.perception.yolo import YoloDetector, class_names  # noqa: E402
from huepose.perception.yolo_layouts import places  # noqa: E402
from huepose.scenes.shapes import demo_objects  # noqa: E402
from huepose.support.errors import InputError  # noqa: E402
from huepose.training.detector import DetectorTraining, train  # noqa: E402
from huepose.training.detector_loss import assigned, detector_loss, overlaps  # noqa: E402
from huepose.training.detector_network import Exported, SmallYolo, grid  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")

SIZE = (64, 96)


@pytest.fixture(scope="module")
def things():
    objects = demo_objects(0)
    return {name: [objects[name]] for name in ("tea_box", "soup_can")}


def test_places_lie_in_the_middle_of_their_cells():
    centres, strides = grid(SIZE)
    assert len(centres) == places(SIZE)
    assert centres[0].tolist() == [4.0, 4.0]
    assert centres[1].tolist() == [12.0, 4.0]
    assert centres[-1].tolist() == [80.0, 48.0]
    assert strides[[0, 96, 120]].tolist() == [8.0, 16.0, 32.0]


def test_overlaps_are_known():
    a = torch.tensor([[0.0, 0.0, 2.0, 2.0]])
    iou, generalised = overlaps(a, torch.tensor([[1.0, 0.0, 3.0, 2.0], [4.0, 0.0, 6.0, 2.0]]))
    assert iou.tolist() == pytest.approx([1 / 3, 0.0])
    assert generalised.tolist() == pytest.approx([1 / 3, -1 / 3])


def test_an_object_is_given_to_places_in_it_and_each_place_to_one():
    network = SmallYolo(2, SIZE).eval()
    with torch.no_grad():
        corners, logits = network(torch.zeros(1, 3, *SIZE))
    true = torch.tensor([[8.0, 8.0, 40.0, 40.0], [30.0, 20.0, 60.0, 60.0], [90.0, 1.0, 93.0, 3.0]])
    got = assigned(corners[0], logits[0], network.centres, network.strides, true, torch.tensor([0, 1, 0]))
    assert len(set(got.chosen.tolist())) == len(got.chosen)
    assert set(got.objects.tolist()) == {0, 1, 2}, "the tiny one too"
    centres = network.centres[got.chosen[got.objects == 0]]
    assert ((centres > 8.0 - 16.0) & (centres < 40.0 + 16.0)).all()
    assert (got.scores <= 1.0).all()


def test_a_perfect_answer_costs_nothing_and_a_wrong_class_or_box_does():
    centres, strides = grid(SIZE)
    true, labels = torch.tensor([[10.0, 12.0, 50.0, 44.0]]), torch.tensor([1])
    corners = true.expand(1, len(centres), 4).contiguous()
    logits = torch.full((1, len(centres), 2), -20.0)
    chosen = assigned(corners[0], logits[0], centres, strides, true, labels).chosen
    logits[0, chosen, 1] = 20.0

    def loss(boxes, scores):
        return detector_loss(boxes, scores, centres, strides, [true], [labels]).item()

    assert loss(corners, logits) < 1e-3
    assert loss(corners, logits.flip(2)) > 5.0
    assert loss(corners + 30.0, logits) > 0.5
    empty = detector_loss(corners, torch.full_like(logits, -20.0), centres, strides, [true[:0]], [labels[:0]])
    assert empty.item() < 1e-3


def test_what_is_exported_is_a_yolo_v8_with_names_and_answers_as_what_was_trained(tmp_path, things):
    short = DetectorTraining(input_size=SIZE, steps=3, batch=4, every=2, validation=4, workers=0)
    first = train(things, short, tmp_path)
    names = {"detector.onnx", "detector.json", "curve.png", "checkpoint.pt"}
    assert {p.name for p in tmp_path.iterdir()} == names
    assert json.loads((tmp_path / "detector.json").read_text())["classes"] == list(things)
    again = train(things, replace(short, steps=5), tmp_path, True)
    assert (first["steps"], again["steps"]) == (3, 5)
    with pytest.raises(InputError, match="at 96x64"):
        train(things, replace(short, input_size=(64, 64)), tmp_path, True)

    network = open_network(tmp_path / "detector.onnx")
    assert class_names(network, 2) == tuple(things)
    classes = {name: [name] for name in things}
    detector = YoloDetector(network, classes, confidence=1e-6, overlap=0.99)
    assert detector.layout == "v8"
    frame = RgbdFrame(
        np.full((480, 640, 3), 90, np.uint8),
        np.ones((480, 640), np.float32),
        Camera(600.0, 600.0, 319.5, 239.5, 640, 480),
    )
    assert {d.object for d in detector.detect(frame, list(things))} <= set(things)

    kept = SmallYolo(2, SIZE)
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["mean"]
    kept.load_state_dict({k.removeprefix("module."): v for k, v in saved.items() if k != "n_averaged"})
    images = torch.rand(1, 3, *SIZE)
    with torch.no_grad():
        expected = Exported(kept).eval()(images).numpy()
    assert network.run({"images": images.numpy()})["output0"] == pytest.approx(expected, abs=1e-3)


def test_an_input_that_does_not_fit_the_grids_is_refused(tmp_path, things):
    with pytest.raises(InputError, match="multiples of 32"):
        train(things, DetectorTraining(input_size=(240, 320)), tmp_path)
    with pytest.raises(InputError, match="one mesh or more"):
        train({}, DetectorTraining(), tmp_path)
