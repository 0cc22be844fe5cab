"""Detections in BOP's format."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from huepose.datasets.bop_detections import read_detections
from huepose.geometry import Box
from huepose.support.errors import InputError

ENTRY = {"scene_id": 48, "image_id": 1, "category_id": 5, "bbox": [10, 20, 30, 40], "score": 0.4}


def test_detections_are_sorted_by_score(tmp_path: Path) -> None:
    path = tmp_path / "cnos.json"
    path.write_text(json.dumps([ENTRY, {**ENTRY, "category_id": 7, "score": 0.9, "time": 0.2}]))
    detections = read_detections(path)
    assert [(d.object_id, d.score) for d in detections.of("000048", 1)] == [(7, 0.9), (5, 0.4)]
    assert detections.of("000048", 1)[1].box == Box(10, 20, 30, 40)
    assert detections.of("000049", 1) == ()
    assert detections.of("table", 1) == ()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{}", "a list"),
        ("[", "JSON"),
        (json.dumps([ENTRY, {**ENTRY, "bbox": [1, 2, 3]}]), "entry 1"),
        (json.dumps([{**ENTRY, "score": float("nan")}]), "score"),
        (json.dumps([{k: v for k, v in ENTRY.items() if k != "category_id"}]), "category_id"),
    ],
)
def test_the_error_names_what_is_broken(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "boxes.json"
    path.write_text(text)
    with pytest.raises(InputError, match=named):
        read_detections(path)


def test_a_missing_file_is_not_reported_as_broken_json(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.json: found no such file\. Check the path\.$"):
        read_detections(tmp_path / "nowhere.json")
