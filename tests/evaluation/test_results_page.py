"""The page of results, and where a result comes from."""

from __future__ import annotations

import pytest

from huepose.evaluation.origin import origin
from huepose.evaluation.results_page import results_page
from huepose.evaluation.tables.table import Head, Table
from huepose.support.errors import InputError

ORIGIN = {"command": "huepose eval estimate", "date": "2026-01-02", "machine": "m", "versions": "v"}


def test_the_origin_names_the_command_without_folders() -> None:
    facts = origin(
        ["eval", "tables", "--ycbv", "/home/me/data/ycbv", "--boxes=a/b.json", "--note", "two words"]
    )
    assert facts["command"] == "huepose eval tables --ycbv ycbv --boxes=b.json --note 'two words'"
    assert "cores" in facts["machine"]
    assert "numpy " in facts["versions"]


def test_results_of_all_kinds_are_shown_with_their_origin() -> None:
    table = Table("table1", "Table I", (Head("full", "ADD"),), (("Average", (98.76,)),), ("a note",))
    estimate = {
        "origin": ORIGIN,
        "summary": {
            "instances": 27, "recall_add": 100.0, "auc_add": 97.12, "boxes": "paper", "seed": 0, "ar": None,
            "interval95": {"recall_add": [97.0, 100.0]}, "per_object": {5: {"recall_add": 99.0}},
        },
    }  # fmt: skip
    page = results_page(
        {
            "tables": {"origin": ORIGIN, "coverage": ["all is there"], "tables": [table.as_json()]},
            "real": estimate,
        }
    )
    assert page.count("`huepose eval estimate`") == 2
    assert page.count("2026-01-02; m; v.") == 2
    for line in (
        "- all is there", "### Table I", "| Average | 98.8 |", "- a note", "### boxes paper, seed 0",
        "| all | 27 | 100.0 | 97.1 |", "| 95 % of draws |  | 97.0 to 100.0 |  |", "| 5 | - | 99.0 | - |",
    ):  # fmt: skip
        assert line in page.splitlines()


def test_a_result_without_origin_is_refused() -> None:
    with pytest.raises(InputError, match="no origin"):
        results_page({"old": {"summary": {}}})
