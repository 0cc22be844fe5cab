"""Contact sheets: every picture where it belongs, scaled without distortion."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.drawing.contact_sheet import GAP_PX, LABEL_PX, LINE_PX, PAPER, contact_sheet, fitted


def flat(height: int, width: int, value: int) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def test_pictures_stand_in_rows() -> None:
    page = contact_sheet([flat(20, 30, v) for v in (10, 20, 30, 40, 50)], 3)
    assert page.shape == (2 * 20 + 3 * GAP_PX, 3 * 30 + 4 * GAP_PX, 3)
    for k, value in enumerate((10, 20, 30, 40, 50)):
        y, x = GAP_PX + k // 3 * (20 + GAP_PX), GAP_PX + k % 3 * (30 + GAP_PX)
        assert (page[y : y + 20, x : x + 30] == value).all()
    assert (page[-20:, -30:] == PAPER).all()


def test_labels_have_their_strip() -> None:
    page = contact_sheet([flat(40, 120, 90)] * 2, 2, ["first", "a label that is too long for it"])
    assert page.shape == (40 + LABEL_PX + LINE_PX + 2 * GAP_PX, 2 * 120 + 3 * GAP_PX, 3)
    strip = page[GAP_PX + 40 : -GAP_PX]
    assert (strip < 128).any()
    assert (strip[:, -GAP_PX:] == PAPER).all()
    second = slice(GAP_PX + 40 + LABEL_PX, GAP_PX + 40 + LABEL_PX + LINE_PX)
    assert (page[second, :120] == PAPER).all(), "the first label has one line"
    assert (page[second, 120 + GAP_PX :] < 128).any(), "the other one goes on below instead of becoming small"
    with pytest.raises(ValueError, match="1 labels for 2 images"):
        contact_sheet([flat(4, 4, 0)] * 2, 2, ["one"])
    with pytest.raises(ValueError, match="at least one image"):
        contact_sheet([], 2)


def test_fitting_keeps_proportions_and_takes_grey() -> None:
    page = fitted(flat(10, 20, 7), 60, 60)
    rows, columns = np.nonzero((page == 7).all(-1))
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (30, 60)
    grey = fitted(np.full((100, 50), 9, np.uint8), 25, 25)
    assert (grey == 9).all(-1).sum() == 25 * 12
