"""The paper's tables beside measured rows with known figures."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.instances import Place, PublishedPose
from huepose.evaluation.result_files import plain
from huepose.evaluation.tables import assemble
from huepose.evaluation.tables.assemble_tracks import tracking_tables
from huepose.evaluation.tables.figures import Unseen, rows_of
from huepose.evaluation.tables.journal import Journal, models_digest, run_images, run_tracks
from huepose.evaluation.tables.published import published
from huepose.evaluation.tables.report import page
from huepose.evaluation.tables.table import Head, Table
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_rows import TrackResult, rows_of_frame
from huepose.geometry import se3
from huepose.support.errors import InputError
from tests.disk import full_disk

from .conftest import MemoryScene, ScriptedEstimator, estimate_of, pose_at, reference_model, truth

NAMES = {"5": "006_mustard_bottle", "7": "008_pudding_box", "30": "tea_box"}


@pytest.fixture
def models():
    return {name: reference_model(name, int(i)) for i, name in NAMES.items()}


@pytest.fixture
def scene() -> MemoryScene:
    """Ids 5 and 7 in two images, 30 in one."""
    return MemoryScene(
        "000048",
        {
            1: (truth(0, 5, pose_at(-0.1)), truth(1, 7, pose_at(0.1))),
            2: (truth(0, 5, pose_at(-0.1)), truth(1, 7, pose_at(0.1)), truth(2, 30, pose_at(0.0))),
        },
    )


def moved(scene: MemoryScene, shift_m: float) -> ScriptedEstimator:
    """Returns the label shifted by `shift_m`; finds no pudding box in image 2."""

    def answer(frame, query):
        T = scene.truths(frame.frame_id)[query.instance].T_cam_obj
        lost = query.object == "008_pudding_box" and frame.frame_id == 2
        return estimate_of(query, None if lost else se3.make(T[:3, :3], T[:3, 3] + [shift_m, 0, 0]))

    return ScriptedEstimator(answer)


def entries_of(models, scene, folder: Path, method: str, shift_m: float):
    setup = EstimateSetup(Targets(models), moved(scene, shift_m), EstimateOptions("paper"))
    return run_images(Journal(folder / f"{method}.jsonl", {}), [scene], setup, method)


def rows_by_name(table: Table) -> dict[str, dict[tuple[str, str], object]]:
    return {
        name: {(h.method, h.figure): v for h, v in zip(table.heads, cells, strict=True)}
        for name, cells in table.rows
    }


def test_published_averages_equal_the_means_of_their_columns() -> None:
    """The exception is FoundationPose's ADD-S."""
    for key, within in (("table1", 0.06), ("table2", 0.11)):
        for head, values, average in published(key).columns:
            apart = abs(np.mean(list(values.values())) - average)
            assert apart < within or (head.method, head.figure) == ("FoundationPose", "ADD-S")
    first = published("table1")
    assert (len(first.rows), len(first.heads)) == (15, 16)
    assert first.cells("040_large_marker")[-2:] == (34.0, 82.7)
    assert published("table2").cells("009_gelatin_box")[2] == 11.32


def test_table_one_has_the_papers_rows_and_ours_beside_them(models, scene, tmp_path: Path) -> None:
    near, far = (entries_of(models, scene, tmp_path, m, x) for m, x in (("near", 0.01), ("far", 0.05)))
    table, everything = assemble.single_frame_tables(
        {"near": near, "far": far}, NAMES, {"006_mustard_bottle": 150, "008_pudding_box": 75}, ["a note"]
    )
    rows = rows_by_name(table)
    assert list(rows)[:2] == ["002_master_chef_can", "003_cracker_box"]
    assert list(rows)[-3:] == ["tea_box", "Average of objects", "All labels"]
    mustard, pudding = rows["006_mustard_bottle"], rows["008_pudding_box"]
    assert (mustard["Ours (published)", "ADD"], mustard["", "n"], mustard["near", "ADD"]) == (
        77.3,
        "2 of 150",
        100.0,
    )
    assert (pudding["near", "ADD"], pudding["near", "ADD-S"], pudding["far", "ADD"]) == (50.0, 50.0, 0.0)
    assert (rows["tea_box"]["Ours (published)", "ADD"], rows["002_master_chef_can"]["near", "ADD"]) == (
        None,
        None,
    )
    assert rows["Average of objects"]["near", "ADD"] == pytest.approx((100 + 50 + 100) / 3)
    assert rows["All labels"]["near", "ADD"] == pytest.approx(80.0)
    assert table.notes[-1] == "a note"
    assert "near, equivalent poses count" not in rows_by_name(everything)
    whole = rows_by_name(everything)["near, all labels"]
    assert (whole["AUC", "ADD"], whole["BOP", "AR"]) == (pytest.approx(0.8 * 90.0), None)


def test_unseen_objects_have_rows_and_averages_of_their_own(models, scene, tmp_path: Path) -> None:
    ours, theirs = (entries_of(models, scene, tmp_path, m, x) for m, x in (("full", 0.05), ("apart", 0.01)))
    unseen = Unseen({"full": theirs}, {}, {"5": "duck", "7": "cup", "30": "boat"}, {"duck"}, ["by code"])
    (table, everything), (alone, _) = (
        assemble.single_frame_tables({"full": ours}, NAMES, {}, [], family) for family in (unseen, None)
    )
    rows = rows_by_name(table)
    adds = {name: (rows[name]["", "n"], rows[name]["full", "ADD"]) for name in list(rows)[-8:]}
    assert adds == {
        "boat": (1, 100.0),
        "cup": (2, 50.0),
        "duck": (2, 100.0),
        "Average of unseen objects": (5, pytest.approx(250 / 3)),
        "Average of unseen, textured": (3, 75.0),
        "Average of unseen, little texture": (2, 100.0),
        "All labels of unseen, textured": (3, pytest.approx(200 / 3)),
        "All labels of unseen objects": (5, 80.0),
    }
    assert rows["duck"]["Ours (published)", "ADD"] is None
    assert table.rows[: len(alone.rows)] == alone.rows  # the data set's own figures do not change
    assert table.notes[-1] == "by code"
    everything = rows_by_name(everything)
    assert everything["full, all labels of unseen objects"]["recall", "ADD"] == 80.0
    assert everything["full, unseen objects, 95 % of draws"]["recall", "ADD"] == "67 to 100"
    assert everything["full, all labels of unseen, textured"]["", "n"] == 3


def test_labels_at_least_a_quarter_visible_have_rows_of_their_own(models, tmp_path: Path) -> None:
    """Of four labels, the two below a quarter are not found; the visibility of one is unknown."""
    shares = (0.1, 0.24, 0.25, None)
    labels = tuple(truth(k, 5, pose_at(0.0), visib) for k, visib in enumerate(shares))
    seen = MemoryScene("000048", {1: labels})

    def answer(frame, query):
        return estimate_of(query, labels[query.instance].T_cam_obj if query.instance > 1 else None)

    setup = EstimateSetup(Targets(models), ScriptedEstimator(answer), EstimateOptions("paper"))
    entries = run_images(Journal(tmp_path / "v.jsonl", {}), [seen], setup, "")
    unseen = Unseen({"full": entries}, {}, {"5": "duck"}, set())
    table, everything = assemble.single_frame_tables({"full": entries}, NAMES, {}, [], unseen)
    figures = {
        name: (cells["", "n"], cells["recall", "ADD"]) for name, cells in rows_by_name(everything).items()
    }
    assert figures["full, all labels"] == (4, 50.0)
    for family in ("", " of unseen objects", " of unseen, textured"):
        assert figures[f"full, all labels{family}, a quarter visible"] == (2, 100.0)
    assert not any("quarter" in name for name, _ in table.rows)


def track_of(model, sequence: str, errors_m: list[float | None]) -> TrackResult:
    targets, T = Targets({model.name: model}), pose_at(0.0)
    rows = []
    for i, error in enumerate(errors_m):
        pose = None if error is None else se3.make(T[:3, :3], T[:3, 3] + [error, 0, 0])
        state = "LOST" if pose is None else "TRACKING"
        place = Place(model, 0, truth(0, model.object_id, T))
        said = PublishedPose(model.name, 0, pose, state, 0.9)
        rows += rows_of_frame(sequence, i, i * 33_000_000, [place], [said], targets, 0.01)[0]
    return TrackResult(rows, {}, {"protocol": "free", "every": 1, "init": "gt", "delayed": None})


def test_table_two_averages_sequences_and_all_frames(models, tmp_path: Path) -> None:
    scenes = [MemoryScene("006_mustard_bottle_real", {0: ()}), MemoryScene("tea_box", {0: ()})]
    tracks = {
        "006_mustard_bottle_real": track_of(
            models["006_mustard_bottle"], "006_mustard_bottle_real", [0.02] * 4
        ),
        "tea_box": track_of(models["tea_box"], "tea_box", [0.01, None]),
    }
    inputs = dict.fromkeys(tracks, "")
    journal = Journal(tmp_path / "t.jsonl", {})
    entries = run_tracks(journal, scenes, 1, lambda scene: tracks[scene.name], inputs)
    table, everything = tracking_tables({("full", 1): entries, ("full", 5): entries}, [])
    rows = rows_by_name(table)
    # Four equal errors: the toolbox takes the accuracy of the first, then 80 mm at that height.
    first = 100 / 0.1 * (0.02 * 0.25 + 0.08 * 1.0)
    bottle = rows["006_mustard_bottle"]
    assert (bottle["Ours (published)", "AUC ADD"], bottle["", "frames"]) == (95.41, 4)
    assert bottle["full", "AUC ADD"] == pytest.approx(first)
    assert rows["004_sugar_box"]["full, every 5th", "AUC ADD"] is None
    second = 100 / 0.1 * (0.01 * 0.5 + 0.09 * 0.5)
    assert rows["Average"]["full", "AUC ADD"] == pytest.approx((first + second) / 2)
    assert rows["All frames"]["", "frames"] == 6
    errors = rows_by_name(everything)["full, average"]
    assert errors["RMSE", "cm"] == pytest.approx((2.0 + 1.0) / 2)  # the missing pose is held
    # 20 mm is more than a tenth of the diameter, so the first track is never confirmed.
    assert errors["state", "TRACKING"] == pytest.approx((0 + 50) / 2)
    drawn = rows_by_name(everything)["full, all frames, 95 % of draws of half seconds"]
    assert drawn["recall", "ADD"] == "0 to 50"

    # The second track as one of unseen objects: in rows below, and not in the averages.
    runs = {("full", 1): [entries[0]]}
    unseen = Unseen({}, {("full", 1): [entries[1]]}, {}, {"tea_box"})
    rows = rows_by_name(tracking_tables(runs, [], unseen)[0])
    assert rows["Average"]["full", "AUC ADD"] == pytest.approx(first)
    assert rows["tea_box"]["full", "AUC ADD"] == pytest.approx(second)
    assert rows["Average of unseen, little texture"]["full", "AUC ADD"] == pytest.approx(second)
    assert rows["Average of unseen, textured"]["full", "AUC ADD"] is None
    assert rows["All frames of unseen objects"]["", "frames"] == 2


def test_two_sequences_of_an_object_both_count(models, tmp_path: Path) -> None:
    scenes = [MemoryScene(name, {0: ()}) for name in ("tea_box", "tea_box_real")]
    errors = {"tea_box": [0.01] * 3, "tea_box_real": [None] * 2}
    entries = run_tracks(
        Journal(tmp_path / "t.jsonl", {}),
        scenes,
        1,
        lambda scene: track_of(models["tea_box"], scene.name, errors[scene.name]),
        dict.fromkeys(errors, ""),
    )
    table, everything = tracking_tables({("full", 1): entries}, [])
    row = rows_by_name(table)["tea_box"]
    assert row["", "frames"] == 5
    assert row["full", "AUC ADD"] == pytest.approx(100 / 0.1 * (0.01 / 3 + 0.09) / 2)
    assert rows_by_name(everything)["full, average"]["", "n"] == 2


def test_with_other_inputs_a_sequence_is_tracked_again(models, tmp_path: Path) -> None:
    tracked = []

    def track(scene) -> TrackResult:
        tracked.append(scene.name)
        return track_of(models["tea_box"], scene.name, [0.01])

    scenes = [MemoryScene(name, {0: ()}) for name in ("tea_box", "008_pudding_box")]
    for inputs in ("ab", "ab", "ac"):  # of each sequence
        own = dict(zip(("tea_box", "008_pudding_box"), inputs, strict=True))
        run_tracks(Journal(tmp_path / "t.jsonl", {}), scenes, 1, track, own)
    assert tracked == ["tea_box", "008_pudding_box", "008_pudding_box"]


def test_reference_models_of_other_files_have_another_digest(models) -> None:
    first, *others = models.values()
    again = models_digest([*others, first])
    assert models_digest([first, *others]) == again
    assert models_digest([replace(first, digest="another"), *others]) != again
    assert models_digest(others) != again


def test_unreadable_images_are_recorded_with_the_reason_and_tried_again(
    models, scene, tmp_path: Path
) -> None:
    class Broken(MemoryScene):
        def frame(self, image):
            if image == 2:
                raise InputError("000048/rgb/000002.png", found="no picture that can be decoded")
            return super().frame(image)

    path = tmp_path / "j.jsonl"
    setup = EstimateSetup(Targets(models), moved(scene, 0.0), EstimateOptions("paper"))
    journal = Journal(path, {"seed": 0})
    first, second = run_images(journal, [Broken(scene.name, scene.labels)], setup, "")
    assert "000002.png" in second["error"]
    assert len(first["rows"]) == 2
    estimator = moved(scene, 0.0)
    whole = run_images(
        Journal(path, {"seed": 0}), [scene], EstimateSetup(Targets(models), estimator, setup.options), ""
    )
    assert {image for image, _ in estimator.asked} == {2}
    assert [len(entry["rows"]) for entry in whole] == [2, 3]


def test_a_truncated_journal_is_read_and_other_settings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "j.jsonl"
    journal = Journal(path, {"boxes": "paper"})
    journal.add("a", {"x": np.float64(1.5)})
    journal.add("b", {"x": np.inf})
    with path.open("a") as file:
        file.write('{"key": "c", "x"')
    again = Journal(path, {"boxes": "paper"})
    assert {key: entry["x"] for key, entry in again.entries.items()} == {"a": 1.5, "b": None}
    again.add("c", {"x": 2})
    assert Journal(path, {"boxes": "paper"}).entries["c"]["x"] == 2
    with pytest.raises(InputError, match=r"another place \(--out"):
        Journal(path, {"boxes": "gt"})
    found = r'found results with the settings \{\}; expected the settings \{"models": "0a"\}'
    with pytest.raises(InputError, match=found):
        Journal(path, {"boxes": "paper", "models": "0a"})


TABLE = Table(
    "t",
    "A title",
    (Head("Theirs", "ADD", "AUC", measured=False), Head("ours_x", "ADD", "recall"), Head("ours_x", "n", "")),
    (("001_box", (50.0, 99.96, "1 of 2")), ("Average", (None, 0.0, 3))),
    ("50 % & more",),
)


def test_a_table_is_written_in_all_formats() -> None:
    assert TABLE.text().splitlines()[2:6] == [
        "         Theirs         ours_x",
        "            ADD    ADD       n",
        "001_box    50.0  100.0  1 of 2",
        "Average       -    0.0       3",
    ]
    assert "| 001_box | 50.0 | 100.0 | 1 of 2 |" in TABLE.markdown()
    rows = list(csv.reader(io.StringIO(TABLE.csv())))
    assert rows[2] == ["metric", "AUC", "recall", ""]
    assert rows[3:] == [["001_box", "50.0", "99.96", "1 of 2"], ["Average", "", "0.0", "3"]]
    assert '<td class="published">50.0</td>' in TABLE.html()
    assert "50 % &amp; more" in TABLE.html()
    assert Table.of_json(plain(TABLE.as_json())) == TABLE


def test_the_page_has_tables_and_plots_and_no_external_links(models, scene, tmp_path: Path) -> None:
    entries = entries_of(models, scene, tmp_path, "full", 0.01)
    track = plain(track_of(models["tea_box"], "tea_box", [0.01, None, 0.02]).as_json())["rows"]
    tables = assemble.single_frame_tables({"full": entries}, NAMES, {}, [])
    text = page(tables, {"date": "today"}, ["all"], {"full": rows_of(entries)}, {("full", 1): track}, NAMES)
    assert text.count("<table>") == 3  # in short, Table I, all figures
    assert text.count("data:image/png;base64,") == 6  # two curves, objects, quality; a curve, a sequence
    assert "http" not in text.replace("https://", "")
    assert 'src="data:' in text


def test_the_error_on_a_full_disk_names_the_journal(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "j.jsonl", {})
    with full_disk(10), pytest.raises(InputError, match=r"j\.jsonl: found File too large"):
        journal.add("a", {"rows": [1.0] * 100})
