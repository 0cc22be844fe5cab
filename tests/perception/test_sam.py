"""The SAM segmenter on networks of the same interface whose right answer is known."""

import numpy as np
import pytest

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.perception.sam import SamSegmenter, mask_of, points_of, tensor_of
from huepose.perception.sessions import open_network
from huepose.support.errors import InputError
from tests.perception import networks


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sam")
    return networks.sam_encoder(folder / "encoder.onnx"), networks.sam_decoder(folder / "decoder.onnx")


@pytest.fixture(scope="module")
def segmenter(files):
    made = SamSegmenter(*(open_network(path) for path in files))
    made.warm_up()
    return made


def _frame(width, height, color=90):
    camera = Camera(500.0, 500.0, width / 2, height / 2, width, height)
    image = np.full((height, width, 3), color, np.uint8)
    return RgbdFrame(image, np.ones((height, width), np.float32), camera)


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (1280, 720), (500, 333)])
@pytest.mark.parametrize("box", [Box(100, 60, 80, 120), Box(0, 0, 40, 30), Box(37.5, 200.25, 301.0, 77.5)])
def test_the_mask_is_the_box_that_was_prompted(segmenter, size, box):
    (mask,) = segmenter.segment(_frame(*size), box, 0.1)
    assert mask.shape == size[::-1]
    assert mask.dtype == bool
    found, half = Box.of_mask(mask), 0.5 * max(size) / 1024  # the half pixel that is added inside
    edges = np.array([found.x, found.y, found.x1, found.y1])
    asked = np.array([box.x, box.y, box.x1, box.y1]) + half
    inner = edges > 0
    assert np.abs(edges - asked)[inner].max() < 0.76, "rounding to whole pixels"
    assert mask.sum() > 0.98 * found.area, "a filled box, its corners cut a little"


def test_a_box_beyond_the_image_is_cut_and_one_outside_gives_nothing(segmenter):
    frame = _frame(640, 480)
    (mask,) = segmenter.segment(frame, Box(600, 440, 100, 100), 0.1)
    assert Box.of_mask(mask).iou(Box(600, 440, 40, 40)) > 0.9
    (mask,) = segmenter.segment(frame, Box(700, 500, 10, 10), 0.1)
    assert not mask.any()


def test_of_several_masks_the_one_with_the_best_iou_is_taken(tmp_path, files):
    for ious, share in (((0.9, 0.3, 0.5), 1.0), ((0.1, 0.2, 0.5), 0.0)):
        decoder = open_network(networks.sam_decoder(tmp_path / "decoder.onnx", ious))
        (mask,) = SamSegmenter(open_network(files[0]), decoder).segment(
            _frame(64, 48), Box(8, 8, 16, 16), 0.1
        )
        assert mask.mean() == share


def test_colours_are_normalised_before_the_rest_is_filled_with_zeros():
    image = np.zeros((480, 640, 3), np.uint8)
    image[:] = (255, 128, 0)
    tensor = tensor_of(image)
    assert tensor.shape == (1, 3, 1024, 1024)
    inside = tensor[0, :, 767, 1023]
    assert inside == pytest.approx(
        [(255 - 123.675) / 58.395, (128 - 116.28) / 57.12, -103.53 / 57.375], abs=1e-5
    )
    assert not tensor[0, :, 768:, :].any(), "black would be -2 here"


def test_points_are_in_pixels_of_the_square():
    assert points_of(Box(10, 20, 30, 40), (480, 640)).tolist() == [[[16.0, 32.0], [64.0, 96.0]]]
    assert points_of(Box(10, 20, 30, 40), (2048, 1000)).tolist() == [[[5.0, 10.0], [20.0, 30.0]]]


def test_only_the_part_with_the_image_is_scaled_back():
    low = np.full((256, 256), -1.0, np.float32)
    low[192:] = 1.0  # below an image of 4 : 3
    assert not mask_of(low, (480, 640)).any()
    low[:96] = 1.0
    mask = mask_of(low, (480, 640))
    assert mask[:239].all()
    assert not mask[241:].any()


def test_the_encoder_runs_once_per_image(files):
    encoder, decoder = (open_network(path) for path in files)
    runs = []
    run = encoder.run
    encoder.run = lambda feeds: runs.append(1) or run(feeds)
    segmenter, first, second = SamSegmenter(encoder, decoder), _frame(64, 48), _frame(64, 48)
    for frame in (first, first, second, second, first):
        segmenter.segment(frame, Box(8, 8, 16, 16), 0.1)
    assert len(runs) == 3


def test_the_embedding_is_that_of_the_image(files):
    encoder = open_network(files[0])
    image = np.zeros((512, 1024, 3), np.uint8)
    image[:, 512:] = 255
    embedding = encoder.run({"image": tensor_of(image)})["image_embeddings"]
    dark, light = -123.675 / 58.395, (255 - 123.675) / 58.395
    assert embedding[0, 0, 5, [3, 60]] == pytest.approx([dark, light], abs=1e-4)
    assert embedding[0, 0, 40, 3] == 0.0


@pytest.mark.parametrize("half", ["encoder", "decoder", "both"])
def test_networks_of_different_precision_work_together(tmp_path, files, half):
    paths = dict(zip(("encoder", "decoder"), files, strict=True))
    for name in paths if half == "both" else (half,):
        paths[name] = networks.in_half_precision(paths[name], tmp_path / f"{name}.onnx")
    segmenter = SamSegmenter(*map(open_network, paths.values()))
    (mask,) = segmenter.segment(_frame(640, 480), Box(100, 60, 80, 120), 0.1)
    assert Box.of_mask(mask).iou(Box(100, 60, 80, 120)) > 0.97


def test_an_encoder_of_free_size_is_run_at_the_size_that_it_gets(tmp_path, files):
    encoder = networks.sam_encoder(tmp_path / "free.onnx", ("height", "width"))
    segmenter = SamSegmenter(open_network(encoder), open_network(files[1]))
    segmenter.warm_up()
    (mask,) = segmenter.segment(_frame(640, 480), Box(100, 60, 80, 120), 0.1)
    assert Box.of_mask(mask).iou(Box(100, 60, 80, 120)) > 0.97


def test_other_networks_are_refused_with_what_they_have(tmp_path, files):
    wrong = open_network(networks.identity(tmp_path / "other.onnx", (1, 3, 64, 64)))
    right = [open_network(path) for path in files]
    with pytest.raises(InputError, match=r"images float 1 x 3 x 64 x 64.*expected one input 1 x 3 x 1024"):
        SamSegmenter(wrong, right[1])
    with pytest.raises(InputError, match="expected inputs has_mask_input, image_embeddings"):
        SamSegmenter(right[0], wrong)
    with pytest.raises(InputError, match="expected one input 1 x 3 x 1024"):
        SamSegmenter(right[1], right[0])
