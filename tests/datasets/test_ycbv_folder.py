"""Downloads of YCB-Video and Fast-YCB, complete and in part."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.fast_ycb import FastYcbSequence, labelled_sequences
from huepose.datasets.types import GroundTruth
from huepose.datasets.ycbv_folder import TargetImages, open_ycbv, spread
from huepose.support.errors import InputError

from .conftest import OFFSET_M


@pytest.fixture
def bop_download(tmp_path: Path, bop_scene: Path) -> Path:
    """Scene 3 of two scenes in the targets, with images 2, 10 and 100 of four; object 7 in image 2 only."""
    root = tmp_path / "ycbv"
    (root / "test").mkdir(parents=True)
    bop_scene.rename(root / "test" / "000003")
    asked = [(3, 2, 5), (3, 2, 7), (3, 10, 5), (3, 50, 5), (4, 1, 5)]
    targets = [{"scene_id": s, "im_id": i, "obj_id": o, "inst_count": 1} for s, i, o in asked]
    (root / "test_targets_bop19.json").write_text(json.dumps(targets))
    (root / "models").mkdir()
    return root


def test_the_targets_say_which_images_and_labels_count(bop_download: Path) -> None:
    folder = open_ycbv(bop_download)
    (scene,) = folder.scenes
    assert (scene.name, scene.image_ids) == ("000003", (2, 10))
    assert [[t.object_id for t in scene.truths(i)] for i in scene.image_ids] == [[5, 7], [5]]
    assert (folder.models, folder.info) == (bop_download / "models", None)
    assert folder.coverage.lines() == [
        "2 of 4 images of test_targets_bop19.json are there, 3 of 5 labels",
        "missing scenes: 000004",
        "missing images: 000003 (1 of 3)",
    ]


def test_grey_images_are_refused(bop_download: Path) -> None:
    scene = bop_download / "test" / "000003"
    (scene / "rgb").rename(scene / "gray")
    with pytest.raises(InputError, match=r"000003: found grey images, gray/ and no rgb/; .*needs colour"):
        open_ycbv(bop_download)


def test_of_several_instances_the_most_visible_count() -> None:
    """Two of three instances are requested; 30, 90 and 60 % of them are visible."""

    class Three:
        name, image_ids, stamp_ns = "000048", (1,), None

        def truths(self, image: int) -> tuple[GroundTruth, ...]:
            shares = enumerate((0.3, 0.9, 0.6))
            return tuple(GroundTruth(k, np.eye(4), 5, visib_fract=share) for k, share in shares)

    assert [t.instance for t in TargetImages(Three(), {1: {5: 2, 7: 1}}).truths(1)] == [1, 2]


def test_without_targets_all_images_count(bop_download: Path) -> None:
    (bop_download / "test_targets_bop19.json").unlink()
    folder = open_ycbv(bop_download / "test")
    assert folder.scenes[0].image_ids == (2, 10, 100)
    assert folder.coverage.lines()[0].startswith("no list of test images: all 3 images of 1 scenes")


def test_the_error_names_a_wrong_folder(tmp_path: Path, bop_download: Path) -> None:
    (tmp_path / "other" / "images").mkdir(parents=True)
    with pytest.raises(InputError, match="images"):
        open_ycbv(tmp_path / "other")
    (bop_download / "test_targets_bop19.json").write_text('[{"scene_id": 3}]')
    with pytest.raises(InputError, match=r"test_targets_bop19\.json"):
        open_ycbv(bop_download)
    elsewhere = [{"scene_id": 48, "im_id": 1, "obj_id": 5, "inst_count": 1}]
    (bop_download / "test_targets_bop19.json").write_text(json.dumps(elsewhere))
    with pytest.raises(InputError, match="no image that test_targets"):
        open_ycbv(bop_download)


def test_a_sample_is_spread_evenly_over_and_within_scenes(bop_download: Path) -> None:
    (bop_download / "test_targets_bop19.json").unlink()
    shutil.copytree(bop_download / "test" / "000003", bop_download / "test" / "000007")
    scenes = open_ycbv(bop_download).scenes
    assert [(s.name, s.image_ids) for s in spread(scenes, 2)] == [("000003", (10,)), ("000007", (10,))]
    assert [s.image_ids for s in spread(scenes, 4)] == [(2, 100)] * 2
    assert [s.image_ids for s in spread(scenes, 100)] == [(2, 10, 100)] * 2


def test_fast_ycb_is_found_below_a_folder_and_missing_parts_are_named(fast_sequence: Path) -> None:
    root = fast_sequence.parent
    unlabelled = root / "003_cracker_box_real"
    shutil.copytree(fast_sequence, unlabelled)
    (unlabelled / "gt" / "poses_ycb.txt").unlink()
    (fast_sequence / "depth" / "1.float").unlink()
    found, notes = labelled_sequences(root)
    assert found == [fast_sequence]
    assert "not labelled" in notes[0]
    assert notes[1] == "006_mustard_bottle_real: 3 colour images and 2 depth files of 3 frames are there"
    assert FastYcbSequence(fast_sequence, OFFSET_M).with_depth == (0, 2)
    with pytest.raises(InputError, match="not labelled"):
        labelled_sequences(unlabelled)
