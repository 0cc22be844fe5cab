"""Windows of a view: shared by objects of one size, and coded once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel
from huepose.perception.clear_view import ClearView, clear_view
from huepose.perception.windows import SIZES, SPACING, Windows, WindowsBySize
from huepose.support.stages import listening


@pytest.fixture(scope="module")
def view(tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray) -> ClearView:
    seen = clear_view(take_picture([(tea_box.mesh, standing)]), 0.3)
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


def test_some_window_is_near_every_point_that_stands(view: ClearView) -> None:
    windows = Windows(view, 0.2)
    camera = view.crop.camera
    v, u = np.nonzero(view.clear)
    seen = camera.rays(np.stack([u, v], 1).astype(float)) * view.crop.depth[v, u][:, None]
    middles = camera.rays(windows.pixels) * windows.depth_m[:, None]
    nearest = np.linalg.norm(seen[::50, None] - middles[None], axis=2).min(1)
    assert nearest.max() < 2.0 * SPACING * 0.2
