"""For a frame in which nothing can be found there is a reason; for a good one there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.geometry.image_faults import (
    NO_COLOUR,
    all_grey,
    bad_image,
    camera_doubted,
    depth_doubted,
    depth_share,
    why_nothing_is_found,
)

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
DIAMETER_M = 0.12


@pytest.fixture
def good() -> RgbdFrame:
    rng = np.random.default_rng(0)
    color = rng.integers(20, 220, (120, 160, 3), dtype=np.uint8)
    return RgbdFrame(color, rng.uniform(0.6, 1.4, (120, 160)).astype(np.float32), CAMERA)


def test_a_good_frame_has_nothing_wrong_with_it(good: RgbdFrame) -> None:
    assert bad_image(good, DIAMETER_M) is None
    mostly_holes = np.where(np.arange(160) % 10 == 0, good.depth, np.float32(0.0))
    assert bad_image(replace(good, depth=mostly_holes), DIAMETER_M) is None


@pytest.mark.parametrize("period", [2, 3, 4])
@pytest.mark.parametrize("read", [0, 1])
def test_depth_in_every_second_row_or_column_is_depth(good: RgbdFrame, period: int, read: int) -> None:
    """As if the depth of a smaller image was registered to a larger one."""
    for axis in (0, 1):
        kept = np.zeros_like(good.depth)
        some = [slice(None), slice(None)]
        some[axis] = slice(read, None, period)
        kept[tuple(some)] = good.depth[tuple(some)]
        assert depth_share(kept) == pytest.approx(1.0 / period, abs=0.05)
        assert bad_image(replace(good, depth=kept), DIAMETER_M) is None


def test_no_depth_and_depth_of_another_unit_are_named(good: RgbdFrame) -> None:
    empty = bad_image(replace(good, depth=np.zeros_like(good.depth)), DIAMETER_M)
    far = bad_image(replace(good, depth=10.0 * good.depth), DIAMETER_M)
    near, nearer = (
        bad_image(replace(good, depth=good.depth / np.float32(k)), DIAMETER_M) for k in (10, 1000)
    )
    assert empty is not None
    assert empty.startswith("The frame has no depth")
    for said in (far, near, nearer):
        assert said is not None
        assert said.endswith("is the depth scale right?")


def test_depth_of_a_tenth_of_the_true_depth_is_doubted(good: RgbdFrame) -> None:
    assert depth_doubted(good) is None
    said = depth_doubted(replace(good, depth=good.depth / np.float32(10.0)))
    assert said is not None
    assert said.startswith("Half of all depth is nearer than 0.1 m: is this right")
    assert depth_doubted(replace(good, depth=np.zeros_like(good.depth))) is None


def test_what_concerns_some_objects_only_is_no_fault_of_the_frame(good: RgbdFrame) -> None:
    """At ten times the distance a chair still has a shape, a cup has none."""
    far = replace(good, depth=10.0 * good.depth)
    assert why_nothing_is_found(far, [0.12, 1.2]) is None
    said = why_nothing_is_found(far, [0.2, 0.12])
    assert said is not None
    assert said.startswith("All depth is 6.4 m away or farther")
    assert why_nothing_is_found(good, [0.12]) is None
    assert why_nothing_is_found(good, []) is None


def test_an_image_without_colour_is_distinguished_from_a_grey_scene_and_a_dark_one() -> None:
    rng = np.random.default_rng(0)
    grey = np.repeat(rng.integers(90, 200, (120, 160, 1), dtype=np.uint8), 3, axis=2)
    assert all_grey(grey)
    seen = np.clip(grey + rng.normal(0.0, 3.0, grey.shape), 0.0, 255.0).astype(np.uint8)
    assert not all_grey(seen), "the noise of a camera that measures colours differs in its channels"
    for blind in (0, 255):
        some = grey.copy()
        some[:104] = blind
        assert all_grey(some)
        some[104:106] = (200, 30, 40)  # an eighth of what is lit, less than a fiftieth of the image
        assert not all_grey(some)
        some[:112] = blind
        assert not all_grey(some), "too little is lit to decide"


def test_black_and_grey_images_are_named(good: RgbdFrame) -> None:
    black = bad_image(replace(good, color=good.color // np.uint8(40)), DIAMETER_M)
    grey = bad_image(replace(good, color=np.repeat(good.color[..., :1], 3, axis=2)), DIAMETER_M)
    assert black is not None
    assert black.startswith("The image is black")
    assert grey is not None
    assert grey == NO_COLOUR


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, None),
        ({"cx": 305.0, "cy": 250.0, "fy": 610.0}, None),
        ({"cx": 280.0}, "cx 280, cy 240, 40 px from the centre of 640 x 480"),
        ({"cy": 300.0}, "cx 320, cy 300, 60 px from the centre of 640 x 480"),
        ({"fx": 450.0}, "fx 450 and fy 600"),
    ],
)
def test_an_unlikely_camera_matrix_is_doubted(changed: dict[str, float], said: str | None) -> None:
    doubt = camera_doubted(replace(Camera(600.0, 600.0, 319.5, 239.5, 640, 480), **changed))
    assert (doubt is None) if said is None else (doubt is not None and said in doubt)
