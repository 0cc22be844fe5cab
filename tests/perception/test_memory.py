"""What is static is processed once; what appears, moves or comes back is found as without a memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.geometry import Box, Camera, Mesh, RgbdFrame, se3
from huepose.judge.region import prepare_crop
from huepose.model import ReferenceModel
from huepose.perception.clear_view import ClearView, clear_view
from huepose.perception.config import DetectorConfig
from huepose.perception.memory import FEWEST, MOST, KeptWindows, features_of, matched, next_look, until
from huepose.perception.stillness import TILE_PX, Tiles, changed_shares
from huepose.perception.view_detector import ViewDetector
from huepose.propose.features import Sift
from huepose.propose.view_images import Pyramid
from tests.conftest import TakePicture
from tests.perception.conftest import noisy


def plain() -> RgbdFrame:
    """A grey wall, one metre away."""
    camera = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
    return RgbdFrame(np.full((120, 160, 3), 120, np.uint8), np.full((120, 160), 1.0, np.float32), camera)


def test_tiles_change_where_colour_or_depth_does_and_not_with_noise() -> None:
    before = Tiles.of(noisy(plain(), 1))
    after = noisy(plain(), 2)
    assert not Tiles.of(after).changed(before).any()
    after.color[40:48, 80:88] += np.uint8(20)
    after.depth[80:88, 40:48] -= np.float32(0.03)
    after.depth[16:24, 16:24] = 0.0
    changed = Tiles.of(after).changed(before)
    assert set(zip(*np.nonzero(changed), strict=True)) == {(5, 10), (10, 5), (2, 2)}


def test_a_window_s_share_of_changed_tiles() -> None:
    changed = np.zeros((15, 20), bool)
    changed[5, 10] = True
    middles = np.array([[10.5, 5.5], [2.0, 2.0], [-50.0, 5.0]]) * TILE_PX
    shares = changed_shares(changed, middles, np.full(3, 4.0 * TILE_PX))
    assert np.allclose(shares, [1.0 / 25.0, 0.0, 1.0])


def test_places_are_matched_with_the_nearest_none_twice() -> None:
    kept = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    places = np.array([[0.01, 0.0, 0.0], [1.5, 0.0, 0.0], [1.02, 0.0, 0.0], [0.02, 0.0, 0.0]])
    mine, theirs = matched(places, kept)
    assert list(zip(mine, theirs, strict=True)) == [(0, 0), (2, 1)]
    assert len(matched(places[:0], kept)[0]) == len(matched(places, kept[:0])[0]) == 0


def test_static_windows_are_not_coded_again(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, coded: list[int]
) -> None:
    other = take_picture([(without_print(tea_box), standing)])
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(remembering=True))
    each = []
    for look in range(3):
        coded.clear()
        detector.detect(noisy(other, look), ["tea_box"])
        each.append(sum(coded))
    assert each[0] > 15
    assert max(each[1:]) < 0.4 * each[0]


def test_windows_are_kept_for_some_looks_where_nothing_changed() -> None:
    count = MOST - FEWEST + 1
    windows = KeptWindows(
        np.tile([80.0, 60.0], (count, 1)), np.ones(count), np.full(count, 40.0),
        np.zeros((count, 4), np.float32), np.zeros(count, np.int64), until(0, count),
    )  # fmt: skip
    memory = replace(next_look(None, plain()), windows={7: windows})
    left = []
    for _ in range(MOST + 1):
        memory = next_look(memory, plain())
        kept = memory.windows_of(7)
        assert kept is not None
        left.append(len(kept.look))
    assert left == [count] * FEWEST + list(range(count - 1, -1, -1))
    assert memory.windows_of(8) is None
    moved = plain()
    moved.color[50:70, 70:90] += np.uint8(40)
    kept = next_look(replace(next_look(None, plain()), windows={7: windows}), moved).windows_of(7)
    assert kept is not None
    assert len(kept.look) == 0


def test_an_object_that_appears_or_moves_is_found_at_once(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, beside: np.ndarray
) -> None:
    other = without_print(tea_box)
    scenes = [
        ([(other, standing)], None),
        ([(other, standing)], None),
        ([(other, standing), (tea_box.mesh, beside)], beside),
        ([(tea_box.mesh, standing)], standing),
        ([(other, standing)], None),
    ]
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(remembering=True))
    for look, (scene, place) in enumerate(scenes):
        found = [d for d in detector.detect(noisy(take_picture(scene), look), ["tea_box"]) if d.score > 0.6]
        if place is None:
            assert found == []
            continue
        best = found[0].T_cam_obj
        assert best is not None
        assert np.linalg.norm(se3.difference(place, best)[:3]) < 0.02


def test_features_are_kept_where_nothing_changed_and_sought_where_it_did(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, beside: np.ndarray
) -> None:
    first = take_picture([(tea_box.mesh, standing)])
    then = take_picture([(tea_box.mesh, standing), (tea_box.mesh, beside)])
    memory, source = next_look(None, first), Sift()
    kept = features_of(memory, *shown_in(first), source)
    memory = next_look(replace(memory, features=kept), first)
    again = features_of(memory, *shown_in(first), source).features
    assert np.array_equal(again.pixels, kept.features.pixels)
    memory = next_look(replace(memory, features=kept), then)
    merged = features_of(memory, *shown_in(then), source).features
    view, shown = shown_in(then)
    every = source.extract(view.crop.color, shown)
    pixels = every.pixels + np.array([view.crop.x0, view.crop.y0], np.float32)
    apart = np.linalg.norm(pixels[:, None] - merged.pixels[None], axis=2).min(1)
    assert len(every) > 1.5 * len(kept.features)
    assert (apart < 1.0).mean() > 0.9


def test_an_image_that_is_smaller_than_a_tile_is_processed_again() -> None:
    camera = Camera(300.0, 300.0, 79.5, 3.0, 160, TILE_PX - 1)
    color = np.random.default_rng(0).integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8)
    low = RgbdFrame(color, np.ones(color.shape[:2], np.float32), camera)
    crop = prepare_crop(low, Box(0.0, 0.0, 160.0, 7.0))
    view = ClearView(low, crop, ~crop.saturated, np.zeros((2, *color.shape), np.float32),
                     np.zeros((0, 4)), low.depth, Pyramid(color))  # fmt: skip
    memory = next_look(None, low)
    for _ in range(2):
        memory = next_look(replace(memory, features=features_of(memory, view, view.clear, Sift())), low)


def shown_in(frame: RgbdFrame) -> tuple[ClearView, np.ndarray]:
    """The clear view of a frame, and the mask of its objects."""
    view = clear_view(frame, 0.3)
    assert view is not None
    return view, view.clear


def without_print(model: ReferenceModel) -> Mesh:
    """The same shape, all grey."""
    return replace(model.mesh, texture=np.full_like(model.mesh.texture, 90))


def test_an_image_of_another_camera_is_not_remembered() -> None:
    memory = next_look(next_look(None, plain()), plain())
    assert memory.look == 1
    other = replace(plain(), camera=replace(plain().camera, fx=310.0))
    assert next_look(memory, other).look == 0
