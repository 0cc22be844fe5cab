"""The network of view codes is trained on the images that the detector makes, in the same order."""

import json
import math

import numpy as np
import pytest
import torch

from huepose.geometry import icosphere
from huepose.propose import view_images
from huepose.propose.templates import view_rotations
from huepose.training.network import info_nce, view_codes, window_codes
from huepose.training.object_buffer import ObjectBuffer
from huepose.training.sensing import network_input
from huepose.training.view_codes import ViewCodeTraining, train
from huepose.training.windows import Drawn, endless
from huepose_services.cli.main import main

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return next(endless(5, 1))


def test_views_equal_those_of_the_detector(drawn):
    colors, reliefs = view_images.turned(drawn.view_colors, drawn.view_reliefs.astype(np.float32))
    buffer = ObjectBuffer(1, "cpu")
    buffer.add(drawn)
    numbers = torch.tensor([0, 7, 12 * 20 + 3, 503])
    rgb, relief = buffer.views_of(torch.zeros_like(numbers), numbers)
    theirs = view_images.network_input(colors[numbers.numpy()], reliefs[numbers.numpy()], clean=True)
    ours = network_input(rgb, relief, clean=True).numpy()
    theirs = (theirs.astype(np.float32) - view_images.ZERO) * view_images.STEP
    # Both rotate images, with different libraries: only pixels at edges may differ.
    assert np.mean(np.abs(ours - theirs.transpose(0, 3, 1, 2)[:, :6]) > 0.05) < 0.02


def test_an_unmoved_window_is_the_middle_of_the_rendered_image(drawn):
    buffer = ObjectBuffer(1, "cpu")
    buffer.add(drawn)
    one = torch.zeros(1)
    rgb, relief = buffer.windows_of(one.long(), one.long(), torch.zeros(1, 2), one + 1.0, one)
    assert np.allclose(255.0 * rgb[0].permute(1, 2, 0).numpy(), drawn.colors[0, 32:96, 32:96], atol=0.6)
    middle = drawn.reliefs[0, 32:96, 32:96].astype(np.float32)
    assert np.array_equal(np.isnan(relief[0].numpy()), np.isnan(middle))


def test_view_rotations_are_directions_times_rolls():
    turns = view_rotations(icosphere.directions(view_images.LEVEL), view_images.ROLLS)
    assert turns.shape == (504, 3, 3)
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    roll = turns[1] @ turns[0].T
    assert np.degrees(np.arccos((np.trace(roll) - 1) / 2)) == pytest.approx(30.0)
    assert roll[1, 0] > 0  # clockwise in the image, whose y points down


def test_codes_have_unit_length_and_are_zero_in_uncovered_cells():
    codes, known = torch.randn(3, 16, 8, 8), torch.zeros(3, 64, 64, dtype=torch.bool)
    known[:, :32] = True
    views = view_codes(codes, known).reshape(3, 16, 8, 8)
    assert torch.allclose(views.flatten(1).norm(dim=1), torch.ones(3))
    assert (views[:, :, 4:] == 0).all()
    assert torch.allclose(window_codes(codes).norm(dim=1), torch.ones(3), atol=1e-5)


def test_the_loss_is_small_for_right_matches_and_large_for_wrong_ones():
    angles = torch.tensor([[5.0, math.inf], [math.inf, 5.0], [math.inf, math.inf]])
    targets, valid = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), torch.ones(2, dtype=torch.bool)
    right = torch.tensor([[20.0, 0.0], [0.0, 20.0], [0.0, 0.0]])
    assert info_nce(right, angles, targets, valid).item() < 1e-6
    assert info_nce(right.flip(1), angles, targets, valid).item() > 30.0
    # A window beside the object that also matches a view adds loss, though each window is right.
    beside = torch.tensor([[20.0, 0.0], [0.0, 20.0], [20.0, 20.0]])
    assert info_nce(beside, angles, targets, valid).item() == pytest.approx(math.log(2.0), abs=1e-3)


def test_the_buffer_of_a_training_needs_the_memory_stated_in_the_help(capsys):
    kept = [part for part in vars(ObjectBuffer(1, "cpu")).values() if isinstance(part, torch.Tensor)]
    bytes_each = sum(part.nbytes for part in kept)
    with pytest.raises(SystemExit):
        main(["train", "views", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    room = ViewCodeTraining().room
    assert f"{bytes_each / 1e6:.0f} MB each: {room} take {room * bytes_each / 1e9:.0f} GB of memory" in said
    assert f"({room})" in said


def test_a_training_writes_networks_that_run(tmp_path):
    import onnxruntime as ort

    config = ViewCodeTraining(
        steps=2, seed=3, validation=2, workers=0, objects=2, windows=2, beside=1, views=6, room=3, first=2
    )
    report = train(config, tmp_path)
    assert report["steps"] == 2
    assert json.loads((tmp_path / "views.json").read_text()) == report
    session = ort.InferenceSession(str(tmp_path / "views.onnx"), providers=["CPUExecutionProvider"])
    verifying = ort.InferenceSession(str(tmp_path / "verification.onnx"), providers=["CPUExecutionProvider"])
    for count in (1, 3):
        (codes,) = session.run(None, {"window": np.zeros((count, 64, 64, 8), np.uint8)})
        assert codes.shape == (count, 16, 8, 8)
        (log_odds,) = verifying.run(None, {"pair": np.zeros((count, 12, 64, 64), np.float32)})
        assert log_odds.shape == (count,)
