"""Rendered frames in the layouts of the official data sets are read back as they were rendered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.fast_ycb import FastYcbSequence, labelled_sequences
from huepose.datasets.types import Sample
from huepose.datasets.ycbv_folder import open_ycbv
from huepose.onboarding.bop_folder import bop_models
from huepose.onboarding.meshes import read_geometry, read_mesh
from huepose.rendering import render_depth
from huepose.scenes.official_sets import SetObject
from huepose.support.errors import InputError
from tests.scenes.stand_ins import stand_in_objects, write_stand_ins


@pytest.fixture(scope="module")
def objects() -> list[SetObject]:
    return stand_in_objects(3)


@pytest.fixture(scope="module")
def root(objects, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    write_stand_ins(folder, objects, images=2, sequences=2, frames=8, seed=3)
    return folder


def test_the_stand_in_for_the_bop_download_has_images_meshes_and_model_frames(root: Path, objects) -> None:
    (scene,) = open_ycbv(root / "ycbv").scenes
    assert (scene.name, scene.image_ids) == ("000048", (0, 1))
    assert all(len(scene.truths(image)) >= 2 for image in scene.image_ids)
    for listed, made in zip(bop_models(root / "ycbv" / "models"), objects, strict=True):
        assert (listed.object_id, listed.name) == (made.object_id, made.name)
        np.testing.assert_allclose(listed.frame_offset_m, made.offset_m)
        written = read_mesh(listed.mesh_path, "mm")
        np.testing.assert_allclose(written.vertices.min(0), made.mesh.vertices.min(0), atol=1e-5)
        assert listed.info["symmetries_discrete"] == made.info["symmetries_discrete"]
        bare = root / "ycbv" / "models_eval" / listed.mesh_path.name
        shape = read_geometry(bare, "mm")
        assert (shape.vertices.shape, shape.faces.shape) == (made.mesh.vertices.shape, made.mesh.faces.shape)
        np.testing.assert_allclose(shape.vertices, made.mesh.vertices, atol=1e-6)
        with pytest.raises(InputError, match="colours per vertex"):
            read_mesh(bare, "mm")
    info = json.loads((root / "ycbv" / "models_eval" / "models_info.json").read_text())
    tea_box = info["1"]  # 9 x 6 x 15 cm
    assert tea_box["diameter"] == pytest.approx(np.linalg.norm([90, 60, 150]), abs=0.1)


def test_labels_of_sequences_agree_with_the_rendered_object(root: Path, objects) -> None:
    found, notes = labelled_sequences(root / "fast")
    assert ([p.name for p in found], notes) == (
        [o.name for o in sorted(objects[:2], key=lambda o: o.name)],
        [],
    )
    for made in objects[:2]:
        sequence = FastYcbSequence(root / "fast" / made.name, made.offset_m)
        sample = Sample.of(sequence, 5)
        (truth,) = sample.truths
        drawn = render_depth(made.mesh, truth.T_cam_obj, sample.frame.camera)
        mask = truth.mask()
        assert mask.sum() > 500
        np.testing.assert_allclose(drawn[mask], sample.frame.depth[mask], atol=2e-3)
