"""Text on paper: broken where it has to be, and where it is told to be."""

from __future__ import annotations

from huepose.drawing.canvas import LINE_PX, MARGIN_PX, PAPER, paragraph


def test_text_is_broken_into_lines_that_fit() -> None:
    one, two = paragraph("short", 300), paragraph("short\nshort", 300)
    assert one.shape == (LINE_PX + MARGIN_PX, 300, 3)
    assert two.shape[0] == 2 * LINE_PX + MARGIN_PX
    long = paragraph("word " * 60, 300)
    assert long.shape[0] > 6 * LINE_PX
    assert (long[:, -MARGIN_PX + 1 :] == PAPER).all()  # nothing reaches the right margin


def test_a_word_wider_than_the_paper_stands_alone() -> None:
    assert paragraph("a " + "m" * 200 + " b", 100).shape == (3 * LINE_PX + MARGIN_PX, 100, 3)
