"""Windows of a view: shared by objects of one size, and coded once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel
from huepose.perception.clear_view import ClearView, clear_view
from huepose.perception.window_table import APART, LIKE, compared, narrowed, promising, window_table
from huepose.perception.windows import SIZES, SPACING, Windows, WindowsBySize
from huepose.support.stages import listening


@pytest.fixture(scope="module")
def view(box_frame: RgbdFrame) -> ClearView:
    seen = clear_view(box_frame, 0.3)
    assert seen is not None
    return seen


def test_objects_of_nearly_one_size_share_their_windows(view: ClearView) -> None:
    windows = WindowsBySize(view)
    one = windows.of(0.2)
    assert windows.of(one.diameter_m * SIZES**0.49) is one
    assert windows.of(one.diameter_m * SIZES**0.51) is not one
    assert 1.0 / SIZES < one.diameter_m / 0.2 < SIZES


def test_a_window_is_coded_once_and_as_the_others_beside_it(view: ClearView) -> None:
    apart, together = Windows(view, 0.2), Windows(view, 0.2)
    some, every = np.arange(0, len(apart), 2), np.arange(len(apart))
    with listening() as clock:
        apart.codes(some)
        first = apart.codes(every)
        again = apart.codes(every)
    assert len(clock.spans["codes"]) == 2
    assert np.array_equal(first, again)
    assert np.allclose(first, together.codes(every), atol=1e-3)
    assert np.allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-3)


def test_some_window_is_near_every_clear_point(view: ClearView) -> None:
    windows = Windows(view, 0.2)
    camera = view.crop.camera
    v, u = np.nonzero(view.clear)
    seen = camera.rays(np.stack([u, v], 1).astype(float)) * view.crop.depth[v, u][:, None]
    middles = camera.rays(windows.pixels) * windows.depth_m[:, None]
    nearest = np.linalg.norm(seen[::50, None] - middles[None], axis=2).min(1)
    assert nearest.max() < 2.0 * SPACING * 0.2


def test_of_windows_beside_each_other_not_all_are_coded(view: ClearView, tea_box: ReferenceModel) -> None:
    windows, table = Windows(view, 0.05), window_table(tea_box)
    order, first = promising(table, windows), 3
    chosen, alike = narrowed(table, windows, order, first)
    assert first < len(chosen) < 0.8 * len(order)
    assert [k for k in order if k in set(chosen)] == list(chosen)
    assert set(order[:first]) <= set(chosen)
    assert set(range(windows.pieces)) <= set(chosen)
    coded, every = windows.places_diameters(chosen), windows.places_diameters(order)
    assert np.linalg.norm(every[:, None] - coded[None], axis=2).min(1).max() < APART
    assert np.allclose(alike, compared(table, windows, chosen), atol=1e-5)


def test_neighbours_of_windows_that_look_like_nothing_are_not_coded(
    view: ClearView, tea_box: ReferenceModel
) -> None:
    windows, table = Windows(view, 0.05), window_table(tea_box)
    order, first = promising(table, windows), 3

    def nearest_of_the_others(codes: np.ndarray) -> float:
        chosen, _ = narrowed(replace(table, codes=codes), windows, order, first)
        places = windows.places_diameters(chosen)
        away = np.linalg.norm(places[:, None] - places[None], axis=2) + 9.0 * np.eye(len(chosen))
        at_any_rate = np.isin(chosen, order[:first]) | (chosen < windows.pieces)
        return float(away[~at_any_rate].min())

    most = compared(table, windows, order).max()
    assert nearest_of_the_others(table.codes) < APART
    assert nearest_of_the_others(np.float32(0.99 * LIKE / most) * table.codes) >= APART


def test_few_windows_are_all_coded(view: ClearView, tea_box: ReferenceModel) -> None:
    windows, table = Windows(view, tea_box.diameter_m), window_table(tea_box)
    some = promising(table, windows)[:5]
    chosen, alike = narrowed(table, windows, some, len(some))
    assert np.array_equal(chosen, some)
    assert np.array_equal(alike, compared(table, windows, some))
    assert narrowed(table, windows, some[:0], 3)[1].shape == (len(table.codes), 0)
