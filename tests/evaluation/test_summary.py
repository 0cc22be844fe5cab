"""Means without unknown figures, ordered groups."""

from __future__ import annotations

from huepose.evaluation import summary


def test_groups_keep_their_order() -> None:
    assert summary.grouped([3, 1, 4, 1, 5], lambda v: v % 2) == {1: [3, 1, 1, 5], 0: [4]}


def test_means_of_nothing_are_none() -> None:
    assert summary.mean_of([None, None]) is None
    assert summary.mean_figures([{"a": None}, {"b": 2.0}]) == {"a": None, "b": 2.0}
    assert summary.largest([None, 2.0, 5.0]) == 5.0
    assert summary.largest([None]) is None
