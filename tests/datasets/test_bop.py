"""BOP scenes are read as they were written; errors name what is broken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose.datasets.types import Sample
from huepose.geometry import Box
from huepose.support.errors import InputError

from .conftest import color_of, depth_of, mask_of, pose_of, write


def edit(path: Path, change) -> None:
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def test_images_are_listed_in_numeric_order_and_only_those_on_disk(bop_scene: Path) -> None:
    scene = BopScene(bop_scene)
    assert scene.image_ids == (2, 10, 100)
    assert scene.name == "000003"


def test_a_scene_with_grey_images_is_refused(bop_scene: Path) -> None:
    (bop_scene / "rgb").rename(bop_scene / "gray")
    with pytest.raises(InputError, match=r"found grey images, gray/ and no rgb/; .*HuePose needs colour"):
        BopScene(bop_scene)


def test_a_frame_is_read_as_it_was_written(bop_scene: Path) -> None:
    sample = Sample.of(BopScene(bop_scene), 10)
    np.testing.assert_array_equal(sample.frame.color, color_of(10))
    np.testing.assert_allclose(sample.frame.depth, depth_of(10) * 1e-4, atol=1e-7)
    assert sample.frame.depth[0, 0] == 0
    assert sample.frame.depth.dtype == np.float32
    assert (sample.frame.camera.fx, sample.frame.camera.fy) == (30.0, 21.0)
    assert (sample.scene, sample.image, sample.frame.frame_id) == ("000003", 10, 10)


def test_labels_are_in_metres_with_their_masks(bop_scene: Path) -> None:
    truths = BopScene(bop_scene).truths(2)
    assert [t.object_id for t in truths] == [5, 7]
    for i, truth in enumerate(truths):
        np.testing.assert_allclose(truth.T_cam_obj, pose_of(2, i), atol=1e-9)
        np.testing.assert_array_equal(truth.mask(), mask_of(i) > 0)
        assert truth.box_visib == Box(3 + i, 2, 5, 4)
        assert truth.visib_fract == pytest.approx(0.5 + 0.1 * i)
        assert truth.visible
        assert not truth.gone


def test_the_error_lists_the_entries_of_a_long_scene_as_ranges(bop_scene: Path) -> None:
    path = bop_scene / "scene_camera.json"
    edit(path, lambda r: (r.update({str(i): r["2"] for i in range(1000)}), r.pop("10")))
    with pytest.raises(InputError) as error:
        BopScene(bop_scene).frame(10)
    assert str(error.value) == f"{path}: found keys 0 to 9, 11 to 999; expected the key '10'."


def test_an_image_without_an_entry_has_no_labels(bop_scene: Path) -> None:
    edit(bop_scene / "scene_gt.json", lambda r: (r.pop("2"), r.update({"10": []})))
    (bop_scene / "scene_gt_info.json").unlink()
    scene = BopScene(bop_scene)
    assert [scene.truths(image) for image in (2, 10)] == [(), ()]
    assert [scene.has_labels(image) for image in scene.image_ids] == [False, True, True]


def test_timestamps_are_those_of_the_scene_or_30_hz(bop_scene: Path) -> None:
    assert BopScene(bop_scene).stamp_ns(2) == round(2e9 / 30)
    stamp = 1581120424148532296  # more digits than a double holds
    edit(bop_scene / "scene_camera.json", lambda r: r["10"].update(timestamp_ns=stamp))
    assert BopScene(bop_scene).frame(10).stamp_ns == stamp


def test_jpeg_images_and_scenes_without_details_or_masks_are_read(bop_scene: Path) -> None:
    path = bop_scene / "rgb" / "000002.png"
    cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)), [cv2.IMWRITE_JPEG_QUALITY, 100])
    path.unlink()
    (bop_scene / "scene_gt_info.json").unlink()
    shutil.rmtree(bop_scene / "mask_visib")
    sample = Sample.of(BopScene(bop_scene), 2)
    assert np.abs(sample.frame.color.astype(int) - color_of(2)).mean() < 6
    assert sample.truths[0].box_visib is None
    assert sample.truths[0].visible
    assert sample.truths[0].mask() is None


def test_a_scene_without_labels_still_has_frames(bop_scene: Path) -> None:
    (bop_scene / "scene_gt.json").unlink()
    (bop_scene / "scene_gt_info.json").unlink()
    scene = BopScene(bop_scene)
    assert not scene.labelled
    assert scene.truths(2) == ()


def test_an_invisible_object_has_no_box(bop_scene: Path) -> None:
    gone = {"bbox_visib": [-1, -1, -1, -1], "visib_fract": 0.0}
    edit(bop_scene / "scene_gt_info.json", lambda r: r["2"].__setitem__(0, gone))
    truth = BopScene(bop_scene).truths(2)[0]
    assert truth.gone
    assert truth.box_visib is None


def remove(name: str):
    return lambda scene: (scene / name).unlink()


def overwrite(name: str, data: bytes):
    return lambda scene: (scene / name).write_bytes(data)


def edited(name: str, change):
    return lambda scene: edit(scene / name, change)


def in_metres(labels: dict) -> None:
    for label in (label for image in labels.values() for label in image):
        label["cam_t_m2c"] = [x / 1000.0 for x in label["cam_t_m2c"]]


def smaller_depth(scene: Path) -> None:
    cv2.imwrite(str(scene / "depth/000002.png"), np.ones((3, 4), np.uint16))


def depth_of_8_bits(scene: Path) -> None:
    cv2.imwrite(str(scene / "depth/000002.png"), np.ones((12, 16), np.uint8))


@pytest.mark.parametrize(
    ("breakage", "named"),
    [
        (remove("scene_camera.json"), "scene_camera.json"),
        (remove("depth/000002.png"), "depth/000002.png"),
        (overwrite("depth/000002.png", b"not a picture"), "depth/000002.png"),
        (overwrite("rgb/000002.png", b""), "rgb/000002.png"),
        (overwrite("scene_gt.json", b"{"), "scene_gt.json"),
        (overwrite("scene_gt.json", b"[]"), "scene_gt.json"),
        (smaller_depth, "depth/000002.png"),
        (depth_of_8_bits, "depth/000002.png"),
        (edited("scene_camera.json", lambda r: r.pop("2")), "scene_camera.json"),
        (edited("scene_camera.json", lambda r: r["2"].pop("cam_K")), "cam_K"),
        (edited("scene_camera.json", lambda r: r["2"].update(cam_K=[1, 2])), "cam_K"),
        (
            edited("scene_camera.json", lambda r: r["2"].update(cam_K=[30, 4, 8, 0, 21, 6, 0, 0, 1])),
            "skew of 4",
        ),
        (
            edited("scene_camera.json", lambda r: r["2"].update(cam_K=[30, 0, 0, 0, 21, 0, 8, 6, 1])),
            "last row",
        ),
        (edited("scene_camera.json", lambda r: r["2"].update(depth_scale="x")), "depth_scale"),
        (edited("scene_camera.json", lambda r: r["2"].update(depth_scale=0)), "depth_scale"),
        (edited("scene_camera.json", lambda r: r["2"].update(timestamp_ns=1.5)), "timestamp_ns"),
        (edited("scene_gt.json", lambda r: r["2"][0].update(cam_R_m2c=[1] * 9)), "scene_gt.json"),
        (edited("scene_gt.json", lambda r: r["2"][0].pop("obj_id")), "obj_id"),
        (edited("scene_gt.json", lambda r: r["2"].append("x")), "scene_gt.json"),
        (edited("scene_gt.json", in_metres), "expected cam_t_m2c in millimetres"),
        (edited("scene_gt.json", lambda r: r["2"][0].update(cam_t_m2c=[10**400, 0, 0])), "cam_t_m2c"),
        (edited("scene_gt_info.json", lambda r: r["2"].pop()), "scene_gt_info.json"),
    ],
)
def test_the_error_names_what_is_broken(bop_scene: Path, breakage, named: str) -> None:
    breakage(bop_scene)
    with pytest.raises(InputError, match=named.replace(".", r"\.")):
        Sample.of(BopScene(bop_scene), 2)


def test_the_scene_has_the_name_of_the_folder_as_given(
    bop_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "000048"
    link.symlink_to(bop_scene)
    assert BopScene(link).name == "000048"
    monkeypatch.chdir(bop_scene / "rgb")
    assert BopScene("..").name == "000003"


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        BopScene(tmp_path / "nowhere")


@pytest.mark.parametrize("place", ["000048", "test/000048"])
def test_the_error_for_a_folder_of_scenes_names_them(bop_scene: Path, tmp_path: Path, place: str) -> None:
    scene = tmp_path / "set" / place
    scene.parent.mkdir(parents=True)
    bop_scene.rename(scene)
    with pytest.raises(InputError) as raised:
        BopScene(tmp_path / "set")
    assert (raised.value.found, raised.value.expected) == (
        f"a folder of 1 scene: {place}",
        f"the folder of one scene, for example {scene}",
    )


def test_the_error_for_a_folder_without_cameras_says_what_to_write(bop_scene: Path) -> None:
    (bop_scene / "scene_camera.json").unlink()
    with pytest.raises(InputError, match=r'no such file\. The folder of a scene has rgb/.*"cam_K": \[fx, 0'):
        BopScene(bop_scene)


def test_gaps_name_the_first_image_that_is_incomplete(bop_scene: Path) -> None:
    assert BopScene(bop_scene).gaps() == [], "labels may name an image that is not on disk"
    for number in (10, 100):
        (bop_scene / "depth" / f"{number:06d}.png").unlink()
    write(bop_scene / "depth" / "000007.png", depth_of(7))
    edit(bop_scene / "scene_camera.json", lambda r: (r.pop("10"), r["100"].pop("cam_K"), r.update({"7": 3})))
    left = "they are left out when it is played"
    assert BopScene(bop_scene).gaps() == [
        f"{bop_scene}: rgb/ lacks 1 of 4 images, the first is number 7; {left}",
        f"{bop_scene}: depth/ lacks 2 of 4 images, the first is number 10; {left}",
        f"{bop_scene}: scene_camera.json with cam_K and depth_scale lacks 3 of 4 images, the first is "
        f"number 7; {left}",
    ]


def test_depth_with_another_file_name_than_colour_counts_as_missing(bop_scene: Path) -> None:
    (bop_scene / "depth" / "000010.png").rename(bop_scene / "depth" / "10.png")
    assert "depth/ lacks 1 of 3 images, the first is number 10" in BopScene(bop_scene).gaps()[0]
    with pytest.raises(InputError, match=r"000010\.png"):
        BopScene(bop_scene).frame(10)
