from itertools import islice

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh
from huepose.perception.yolo_layouts import Candidates
from huepose.scenes.shapes import demo_objects
from huepose.training.backdrops import Backdrops
from huepose.training.detector_score import average_precision, score
from huepose.training.pictures import PictureRange, endless_pictures

SIZE = (256, 320)
ALONE = PictureRange(
    objects=(1, 1),
    others=(0, 0),
    exposure=(0.0, 0.1),
    tint=(0.0, 0.01),
    key=(0.7, 0.8),
    sky=(0.4, 0.5),
    blur_px=(1.0, 1.1),
    empty=0.0,
)


@pytest.fixture(scope="module")
def objects():
    return demo_objects(0)


def test_a_label_bounds_what_is_seen_of_the_object(objects):
    """A lone magenta thing: its colour reaches to the sides of the box."""
    mesh = objects["tea_box"]
    magenta = np.full((4, 4, 3), (255, 0, 255), np.uint8)
    painted = {"thing": [Mesh(mesh.vertices, mesh.faces, mesh.uv, magenta)]}
    labelled = 0
    for picture in islice(endless_pictures(painted, SIZE, 3, 1, ALONE), 8):
        assert picture.image.shape == (*SIZE, 3)
        assert (picture.image[:8] == 114).all(), "640 x 480 leaves eight rows above and below"
        assert (picture.image[-8:] == 114).all()
        for x0, y0, x1, y1 in picture.corners.astype(int):
            labelled += 1
            red, green, blue = picture.image[..., 0], picture.image[..., 1], picture.image[..., 2]
            rows, columns = np.nonzero((red > 2.0 * green + 20) & (blue > 2.0 * green + 20))
            inside = (columns >= x0 - 2) & (columns < x1 + 2) & (rows >= y0 - 2) & (rows < y1 + 2)
            tight = [columns[inside].min(), rows[inside].min(), columns[inside].max(), rows[inside].max()]
            assert np.abs(np.array(tight) - [x0, y0, x1 - 1, y1 - 1]).max() <= 2, "blurred by a pixel"
    assert labelled >= 6


def test_classes_are_those_of_the_things_and_hidden_things_have_no_label(objects):
    things = {name: [mesh] for name, mesh in objects.items()}
    crowd = PictureRange(objects=(6, 6), others=(0, 0), together_m=(0.01, 0.011), empty=0.0)
    pictures = list(islice(endless_pictures(things, SIZE, 0, 1, crowd), 6))
    counts = [len(p.classes) for p in pictures]
    assert all(len(p.corners) == n for p, n in zip(pictures, counts, strict=True))
    assert set(np.concatenate([p.classes for p in pictures])) <= set(range(5))
    assert any(n < 6 for n in counts), "of six things in one place some are behind the others"


def test_the_stream_repeats_itself_with_its_seed_only(objects):
    things = {"soup_can": [objects["soup_can"]]}

    def first(seed, stream):
        return next(endless_pictures(things, (64, 96), seed, stream)).image

    assert np.array_equal(first(1, 2), first(1, 2))
    assert not np.array_equal(first(1, 2), first(1, 3))
    assert not np.array_equal(first(1, 2), first(2, 2))


def test_a_backdrop_fills_the_picture():
    backdrops = Backdrops(np.random.default_rng(0))
    for _ in range(6):
        assert (backdrops.draw(Camera(60.0, 60.0, 31.5, 23.5, 64, 48)).depth > 0).all()


def test_precision_and_recall_are_known():
    """Two labels: one found twice (the second time overlapping, dropped), one with the wrong class."""
    corners = np.array([[10, 10, 50, 50], [60, 10, 90, 50]], float)
    seen = Candidates(
        np.array([[10, 10, 50, 48], [11, 10, 50, 50], [60, 10, 90, 50], [0, 60, 30, 90]], float),
        np.array([0.9, 0.8, 0.7, 0.1]),
        np.array([0, 0, 0, 1]),
    )
    got = score([seen], [corners], [np.array([0, 1])], 2)
    assert got.recall == 0.5
    assert got.false_boxes == 1.0, "the one with the wrong class; the last is not sure enough to count"
    assert got.precision == 0.5, "all of class 0, nothing of class 1"
    perfect = Candidates(corners, np.array([0.9, 0.8]), np.array([0, 1]))
    assert score([perfect], [corners], [np.array([0, 1])], 2).precision == 1.0
    assert average_precision(np.array([], bool), 3) == 0.0
