"""Pieces of a mask as stretches of rows are the components of OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.perception.stretches import connected, write_values


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.6, 0.95, 1.0])
def test_pieces_are_those_of_opencv_in_the_order_of_their_first_pixels(share: float) -> None:
    rng = np.random.default_rng(0)
    mask = (rng.random((61, 83)) < share).astype(np.uint8)
    right, labels = cv2.connectedComponents(mask, connectivity=4, ltype=cv2.CV_32S)
    stretches, count = connected(mask)
    pieces = np.full(mask.shape, -1)
    for v, first, last, piece in stretches:
        assert (pieces[v, first:last] == -1).all()
        pieces[v, first:last] = piece
    assert count == right - 1
    assert np.array_equal(pieces >= 0, mask > 0)
    pairs = np.unique(np.stack([labels[mask > 0], pieces[mask > 0]], 1), axis=0)
    assert len(pairs) == count  # one to one
    numbers, places = np.unique(pieces[mask > 0], return_index=True)
    assert np.array_equal(numbers, np.arange(count))
    assert (np.diff(places) > 0).all()


def test_arms_that_meet_below_are_one_piece_and_each_piece_gets_its_value() -> None:
    mask = np.zeros((5, 9), np.uint8)
    mask[:, [0, 2, 4]] = 1
    mask[4, :5] = 1
    mask[2, 7] = 1
    stretches, count = connected(mask)
    assert count == 2
    out = np.full(mask.shape, -1, np.int32)
    write_values(stretches, np.array([5, 8], np.int32), out)
    assert out[2, 7] == 8
    assert (out == 5).sum() == mask.sum() - 1
    assert (out == -1).sum() == (mask == 0).sum()
