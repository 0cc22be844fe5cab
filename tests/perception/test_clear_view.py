"""The objects in an image form pieces, each with its middle, depth and size."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry import Camera, RgbdFrame
from huepose.perception.clear_view import clear_view


def test_pieces_are_the_connected_parts_without_a_step_in_depth() -> None:
    camera = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
    depth = np.zeros((240, 320), np.float32)
    depth[60:120, 40:100], depth[60:120, 100:140], depth[150:190, 200:290] = 0.6, 0.8, 1.0
    view = clear_view(RgbdFrame(np.full((240, 320, 3), 90, np.uint8), depth, camera), 10.0)
    assert view is not None
    _, _, stats, middles = cv2.connectedComponentsWithStats(
        ((depth == np.float32(0.6)) | (depth == 1.0)).view(np.uint8), connectivity=4
    )
    near_px = view.pieces[np.argsort(view.pieces[:, 2])]
    assert np.round(near_px[:, 2], 3).tolist() == [0.6, 0.8, 1.0]
    for piece, (left, top, width, height, _), middle in zip(
        near_px[[0, 2]], stats[1:], middles[1:], strict=True
    ):
        in_frame = piece[:2] + np.array([view.crop.x0, view.crop.y0])
        np.testing.assert_allclose(in_frame, middle, atol=0.6)
        np.testing.assert_allclose(piece[3], max(width, height) * piece[2] / camera.fx, rtol=0.04)
        assert view.clear[top - view.crop.y0 + 2, left - view.crop.x0 + 2]
    np.testing.assert_array_equal(view.depth[view.depth > 0], depth[depth > 0])
