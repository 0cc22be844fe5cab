"""Scenes of objects that look the same all round hold those objects alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.datasets.bop import BopScene
from huepose.geometry import se3
from huepose.model import load_models
from studies import all_round


def test_only_what_looks_the_same_is_drawn(tea_box, tmp_path, monkeypatch) -> None:
    half_turn = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    both = replace(tea_box, equivalents=np.stack([np.eye(4), half_turn]))
    monkeypatch.setattr(
        all_round, "household_meshes", lambda seed: {"one": tea_box.mesh, "other": tea_box.mesh}
    )
    monkeypatch.setattr(all_round, "learned", lambda meshes, folder: {"one": tea_box, "other": both})
    monkeypatch.setattr(all_round, "FRAMES", 1)
    assert all_round.drawn(tmp_path, [3]) == ["others3"]
    (model,) = load_models(tmp_path / "bundles").values()
    assert (model.name, len(model.equivalents)) == ("others3", 2)
    for name in ("apart", "heaps"):
        scene = BopScene(tmp_path / name)
        assert {label.object_id for label in scene.truths(scene.image_ids[0])} == {model.object_id}
