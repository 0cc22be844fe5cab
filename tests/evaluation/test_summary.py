"""Means that leave unknown figures out, groups in order, tables; and the examples in the docstrings."""

from __future__ import annotations

import doctest

import pytest

from huepose.datasets import fast_ycb
from huepose.evaluation import bootstrap, metrics, result_files, summary


@pytest.mark.parametrize("module", [bootstrap, metrics, result_files, summary, fast_ycb])
def test_examples_in_docstrings(module) -> None:
    result = doctest.testmod(module)
    assert (result.failed, result.attempted > 0) == (0, True)


def test_groups_keep_their_order() -> None:
    assert summary.grouped([3, 1, 4, 1, 5], lambda v: v % 2) == {1: [3, 1, 1, 5], 0: [4]}


def test_means_of_nothing_are_none() -> None:
    assert summary.mean_of([None, None]) is None
    assert summary.mean_figures([{"a": None}, {"b": 2.0}]) == {"a": None, "b": 2.0}
    assert summary.largest([None, 2.0, 5.0]) == 5.0
    assert summary.largest([None]) is None
