import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import write_models_folder
from huepose.geometry import Camera, se3
from huepose.rendering import render, render_depth
from huepose.scenes.frame import silhouette
from huepose.scenes.rendered import SceneRanges, rendered_frame, write_rendered_set
from huepose.support.errors import InputError
from tests.meshes import demo_objects

MESHES = {name: mesh for name, mesh in demo_objects(3).items() if name in ("tea_box", "soup_can")}
IDS = {"soup_can": 5, "tea_box": 2}
RANGES = SceneRanges(others=(1, 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sets") / "heaps"
    write_rendered_set(path, MESHES, IDS, 2, 7, RANGES)
    return path


def test_a_rendered_set_is_read_back_as_it_was_rendered(folder: Path) -> None:
    scene = BopScene(folder)
    assert scene.image_ids == (0, 1)
    for image in scene.image_ids:
        drawn = rendered_frame(MESHES, 7, image, RANGES)
        frame, truths = scene.frame(image), scene.truths(image)
        assert [t.object_id for t in truths] == [IDS[name] for name in drawn.names]
        np.testing.assert_allclose(frame.depth, np.clip(drawn.shot.depth, 0, 6.5535), atol=6e-5)
        difference = frame.color.astype(int) - drawn.shot.color.astype(int)
        assert np.abs(difference).mean() < 6  # JPEG of a noisy image
        np.testing.assert_allclose(frame.camera.K, drawn.camera.K, atol=1e-9)
        for k, truth in enumerate(truths):
            assert truth.T_cam_obj is not None
            np.testing.assert_allclose(truth.T_cam_obj, drawn.shot.labels.T_cam_obj[k], atol=1e-9)
            mask = truth.mask()
            assert mask is not None
            np.testing.assert_array_equal(mask, drawn.shot.owner == k)
            assert truth.visib_fract == pytest.approx(drawn.shot.labels.visib_fract[k])


def test_labels_agree_with_depth(folder: Path) -> None:
    """In the mask of an object, depth is that of the object at its pose."""
    scene = BopScene(folder)
    for truth in scene.truths(1):
        frame, mask = scene.frame(1), truth.mask()
        mesh = MESHES["tea_box" if truth.object_id == 2 else "soup_can"]
        assert truth.T_cam_obj is not None
        assert mask is not None
        seen = mask & (frame.depth > 0)
        true = render_depth(mesh, truth.T_cam_obj, frame.camera)
        assert (true[mask] > 0).all()
        assert np.median(np.abs(frame.depth[seen] - true[seen])) < 0.004


def test_an_interrupted_set_continues_and_a_different_set_is_refused(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "heaps"
    write_rendered_set(path, MESHES, IDS, 1, 7, RANGES)
    stamp = (path / "depth" / "000000.png").stat().st_mtime_ns
    write_rendered_set(path, MESHES, IDS, 2, 7, RANGES)
    assert (path / "depth" / "000000.png").stat().st_mtime_ns == stamp
    for name in ("scene_gt.json", "scene_gt_info.json", "scene_camera.json"):
        assert json.loads((path / name).read_text()) == json.loads((folder / name).read_text())
    for part in ("rgb/000001.jpg", "depth/000001.png"):
        assert (path / part).read_bytes() == (folder / part).read_bytes()
    with pytest.raises(InputError, match="other settings"):
        write_rendered_set(path, MESHES, IDS, 2, 8, RANGES)
    alike = {name: demo_objects(4)[name] for name in MESHES}
    larger = {name: replace(mesh, vertices=1.1 * mesh.vertices) for name, mesh in MESHES.items()}
    for meshes in (alike, larger):
        with pytest.raises(InputError, match="other settings"):
            write_rendered_set(path, meshes, IDS, 2, 7, RANGES)
    with pytest.raises(InputError, match="other files"):
        write_rendered_set(tmp_path, MESHES, IDS, 2, 7, RANGES)


def test_the_outline_counts_pixels_beyond_the_image() -> None:
    mesh = MESHES["tea_box"]
    camera = Camera(500.0, 500.0, 99.5, 99.5, 200, 200)
    inside = se3.make(np.eye(3), np.array([0.0, 0.0, 1.0]))
    beyond = se3.make(np.eye(3), np.array([-0.2, 0.0, 1.0]))
    count, box = silhouette(mesh, inside, camera)
    assert count == np.count_nonzero(render_depth(mesh, inside, camera))
    count_beyond, box_beyond = silhouette(mesh, beyond, camera)
    assert count_beyond >= 0.9 * count
    assert box_beyond.x < 0 < box_beyond.x1
    assert np.count_nonzero(render_depth(mesh, beyond, camera)) < 0.7 * count


def test_meshes_written_as_a_models_folder_are_read_back(tmp_path: Path) -> None:
    from huepose.onboarding.bop_folder import bop_models
    from huepose.onboarding.meshes import read_mesh

    write_models_folder(tmp_path / "models", MESHES, IDS)
    models = {m.name: m for m in bop_models(tmp_path / "models")}
    assert {name: m.object_id for name, m in models.items()} == IDS
    camera, T = Camera(400.0, 400.0, 79.5, 79.5, 160, 160), se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    for name, mesh in MESHES.items():
        again = read_mesh(models[name].mesh_path, "mm")
        np.testing.assert_allclose(np.ptp(again.vertices, axis=0), np.ptp(mesh.vertices, axis=0), atol=1e-6)
        was, now = render([(mesh, T)], camera), render([(again, T)], camera)
        np.testing.assert_allclose(now.depth, was.depth, atol=1e-4)
        assert np.abs(now.color.astype(int) - was.color.astype(int)).mean() < 1.0


def test_the_error_names_a_mesh_that_is_too_large() -> None:
    mesh = MESHES["tea_box"]
    large = type(mesh)(mesh.vertices * 4, mesh.faces, mesh.uv, mesh.texture)
    with pytest.raises(InputError, match="object 'house'"):
        rendered_frame({"house": large}, 0, 0)
