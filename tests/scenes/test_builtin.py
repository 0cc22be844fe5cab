"""The built-in scene: labels agree with the images, the loop closes, a broken cache is rendered again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose.rendering import render_depth
from huepose.scenes.builtin import SyntheticScene
from huepose.scenes.camera import CAMERA, COLOR, STEREO
from huepose.scenes.frame import Stage, labels, shoot, silhouette
from huepose.scenes.light import Light
from huepose.scenes.plan import plan
from huepose.scenes.room import sheet
from huepose.support.errors import InputError
from tests.meshes import demo_objects

SMALL, TINY = CAMERA.scaled(0.4), CAMERA.scaled(0.1)
OBJECTS = demo_objects(0)
THREE = {name: OBJECTS[name] for name in ("tea_box", "soup_can", "corner_bracket")}
ONE = {"tea_box": OBJECTS["tea_box"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def scene(folder: Path) -> SyntheticScene:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("huepose.scenes.plan._ATTEMPTS", 1)  # the first plan instead of the best of twelve
        return SyntheticScene(3, 1.0, THREE, SMALL, cache=folder)


@pytest.fixture
def tiny(folder: Path, monkeypatch: pytest.MonkeyPatch) -> SyntheticScene:
    """A scene that is rendered fast, by the first plan, for tests that do not need its images."""
    monkeypatch.setattr("huepose.scenes.plan._ATTEMPTS", 1)
    return SyntheticScene(3, 1.0, ONE, TINY, cache=folder)


def test_frames_have_numbers_timestamps_and_labels_and_repeat(scene: SyntheticScene) -> None:
    assert len(scene) == 30
    samples = list(scene)
    assert [s.frame.frame_id for s in samples] == list(range(30))
    assert samples[3].frame.stamp_ns == 100_000_000
    assert samples[0].frame.camera == SMALL == scene.camera
    assert [t.object for t in samples[0].truths] == list(THREE) == list(scene.meshes)
    again = scene.frame(30 + 4)
    assert again.frame_id == 34
    assert np.array_equal(again.color, samples[4].frame.color)
    assert np.array_equal(again.depth, samples[4].frame.depth)
    assert samples[0].frame.color.std() > 20


def test_depth_agrees_with_the_ground_truth(scene: SyntheticScene) -> None:
    for i in (0, 13, 29):
        frame, truths = scene.frame(i), scene.truths(i)
        for truth in truths:
            mask = truth.mask()
            assert mask is not None
            assert truth.T_cam_obj is not None
            assert truth.visib_fract is not None
            assert truth.box_visib is not None
            assert mask.sum() > 150
            drawn = render_depth(scene.meshes[str(truth.object)], truth.T_cam_obj, SMALL)
            seen = mask & (frame.depth > 0)
            error = (frame.depth - drawn)[seen]
            assert seen.sum() > 0.6 * mask.sum()
            assert abs(np.median(error)) < 0.002
            assert np.median(np.abs(error)) < 0.004  # half the image size has twice the noise
            share = mask.sum() / (drawn > 0).sum()
            assert truth.visib_fract <= share + 1e-9
            rows, columns = np.nonzero(mask)
            assert truth.box_visib.x == columns.min()
            assert truth.box_visib.y1 == rows.max() + 1


def test_a_second_opening_reads_the_file_and_a_broken_file_is_rendered_again(
    tiny: SyntheticScene, folder: Path
) -> None:
    color, file = tiny.frame(7).color, tiny.path.stat().st_ino
    other = SyntheticScene(3, 1.0, ONE, TINY, cache=folder)
    assert other.path == tiny.path
    assert other.path.stat().st_ino == file
    assert np.array_equal(other.frame(7).color, color)
    assert not list(folder.glob("*.part"))

    data = bytearray(tiny.path.read_bytes())
    data[len(data) // 2] ^= 1
    copy = folder / "copy"
    copy.mkdir()
    (copy / tiny.path.name).write_bytes(data)
    remade = SyntheticScene(3, 1.0, ONE, TINY, cache=copy)
    assert np.array_equal(remade.frame(7).color, color)
    assert np.array_equal(remade.frame(7).depth, other.frame(7).depth)
    np.testing.assert_array_equal(remade.truths(7)[0].T_cam_obj, other.truths(7)[0].T_cam_obj)


def test_other_parameters_have_other_files(tiny: SyntheticScene, folder: Path) -> None:
    exact = SyntheticScene(3, 1.0, ONE, TINY, None, cache=folder)
    assert exact.path != tiny.path
    truth = exact.truths(5)[0]
    assert truth.T_cam_obj is not None
    drawn = render_depth(ONE["tea_box"], truth.T_cam_obj, TINY)
    mask = truth.mask()
    assert mask is not None
    assert np.abs(exact.frame(5).depth - drawn)[mask].max() <= 0.00006


def test_wrong_requests_are_explained(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 1 s"):
        SyntheticScene(0, 0.2, cache=folder)
    with pytest.raises(InputError, match="one mesh or more"):
        SyntheticScene(0, 1.0, {}, cache=folder)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="XDG_CACHE_HOME"):
        SyntheticScene(3, 1.0, ONE, TINY, cache=tmp_path / "file")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_plan_of_the_demo_shows_all_objects_first_and_occludes_them_later(seed: int) -> None:
    stage = plan(OBJECTS, seed, 240, CAMERA)
    rough = CAMERA.scaled(0.25)
    seen = np.array([labels(stage, i, rough).visib_fract for i in range(0, 240, 6)])
    assert seen[:8].min() > 0.9
    assert (seen >= 0.3).mean() > 0.97
    assert seen.min() < 0.6
    distances = stage.T_room_mesh[: stage.labelled, :, 2, 3]
    assert distances.min() > 0.5
    assert distances.max() < 1.1


def test_motion_blur_is_centred_on_the_true_pose() -> None:
    """A white square that moves 12 px a frame: its blurred edges are symmetric about its true position."""
    camera = Camera(600.0, 600.0, 159.5, 119.5, 320, 240)
    white, grey = (np.full((8, 8, 3), v, np.uint8) for v in (230, 60))
    turn = se3.rotation_exp(np.array([np.pi, 0, 0]))
    step = 12 / 600
    moving = np.array([se3.make(turn, np.array([k * step, 0.0, 1.0])) for k in (-1, 0, 1)])
    still = np.array([se3.make(turn, np.array([0.0, 0.0, 1.5]))] * 3)
    light = Light(np.array([0, 0, -1.0]), 0.0, 0.9, np.ones(3))
    stage = Stage(
        (sheet(0.1, 0.1, white), sheet(3.0, 3.0, grey)),
        1,
        np.array([moving, still]),
        np.tile(np.eye(4), (3, 1, 1)),
        (light,) * 3,
        camera,
    )
    shot = shoot(stage, 1, 0, COLOR, None)
    row = ((shot.color[100:140].mean((0, 2)) / 255.0) ** 2.2).astype(float)
    row -= row[60:100].mean()
    assert (np.arange(320) * row).sum() / row.sum() == pytest.approx(159.5, abs=0.15)
    edges = (row > 0.1 * row.max()) & (row < 0.9 * row.max())
    assert 4 <= edges.sum() <= 8
    assert shot.labels.visib_fract[0] == 1.0
    assert shot.labels.box_visib[0] is not None
    assert shot.labels.box_visib[0].w == 60


def test_the_silhouette_counts_pixels_outside_the_image() -> None:
    mesh = OBJECTS["soup_can"]
    half_out = se3.make(np.eye(3), CAMERA.backproject(np.array([0.0, 240.0]), np.array(0.7)))
    inside = se3.make(np.eye(3), CAMERA.backproject(np.array([320.0, 240.0]), np.array(0.7)))
    wide = CAMERA.cropped(-320, -240, 1280, 960)
    assert silhouette(mesh, half_out, CAMERA)[0] == np.count_nonzero(render_depth(mesh, half_out, wide))
    assert silhouette(mesh, half_out, CAMERA)[0] > 1.5 * np.count_nonzero(
        render_depth(mesh, half_out, CAMERA)
    )
    assert silhouette(mesh, inside, CAMERA)[0] == np.count_nonzero(render_depth(mesh, inside, CAMERA))


def test_an_object_that_reaches_to_the_camera_has_no_silhouette() -> None:
    """An image of all of its outline would need more memory than there is."""
    mesh = OBJECTS["soup_can"]
    for nearest_m in (1e-6, -0.01):
        T = se3.make(np.eye(3), np.array([0.2, 0.2, nearest_m - float(mesh.vertices[:, 2].min())]))
        assert silhouette(mesh, T, CAMERA) == (0, (-1, -1, -1, -1))


def test_rms_of_the_stereo_sensor_at_a_metre() -> None:
    assert STEREO.rms_m(1.0, CAMERA) == pytest.approx(0.0026, abs=0.0001)
