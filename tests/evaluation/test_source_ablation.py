"""The ablation by source: what each variant leaves out, and changes that are known beforehand."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from huepose.estimation.config import EstimatorConfig
from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.source_ablation import picture, run_variants, source_rows, variants
from huepose.evaluation.targets import Targets
from huepose.support.errors import InputError
from huepose_services.cli.main import main

from .conftest import MemoryScene, ScriptedEstimator, estimate_of, pose_at, truth

WORSE = "colorpair-without-light"


def test_each_variant_leaves_out_what_its_name_says() -> None:
    known = variants(EstimatorConfig(seed=7))
    votes = {name: config.colorpair.hypotheses for name, config in known.items() if config.colorpair}
    off = {
        name: {f.name for f in fields(chosen) if getattr(chosen, f.name) is None}
        | ({"shape"} if known[name].colorpair.shapes == 0 else set())
        for name, chosen in votes.items()
    }
    assert off == {
        "colorpair": set(),
        "colorpair-again": set(),
        "colorpair-without-triangles": {"triangles"},
        "colorpair-without-ppf": {"ppf"},
        "colorpair-without-frames": {"frames"},
        "colorpair-without-shape": {"shape"},
        "colorpair-without-light": {"light"},
        "colorpair-triangles-alone": {"ppf", "frames", "shape"},
        "colorpair-ppf-alone": {"triangles", "frames", "shape"},
        "colorpair-frames-alone": {"triangles", "ppf", "shape"},
        "colorpair-shape-alone": {"triangles", "ppf", "frames"},
    }
    assert known["colorpair-again"].seed == 8
    assert known["paper-triangles-alone"].paper.ppf is None
    assert known["paper-ppf-alone"].paper.triangles is None
    assert {config.method for config in known.values()} == {"paper", "colorpair"}


def scene(name: str, images: int) -> MemoryScene:
    """Two labels an image."""
    return MemoryScene(
        name, {i: (truth(0, 5, pose_at(-0.1), 0.9), truth(1, 7, pose_at(0.1), 0.9)) for i in range(images)}
    )


def setups(models, shown: MemoryScene) -> tuple[dict[str, EstimateSetup], ScriptedEstimator]:
    """Every variant is right, but one finds nothing of the first label."""

    def answer(frame, query, worse=False):
        T = shown.truths(frame.frame_id)[query.instance].T_cam_obj
        return estimate_of(query, None if worse and query.instance == 0 else T)

    right = ScriptedEstimator(answer)
    wrong = ScriptedEstimator(lambda frame, query: answer(frame, query, worse=True))
    options = EstimateOptions(seeds=(0, 1))
    return {
        name: EstimateSetup(Targets(models), wrong if name == WORSE else right, options)
        for name in variants(EstimatorConfig())
    }, right


def test_known_changes_over_sets_and_all_of_them(models, tmp_path: Path) -> None:
    for name, images in (("near", 2), ("far", 3)):
        shown = scene("000001", images)
        given, right = setups(models, shown)
        run_variants([shown], given, tmp_path, name, {"seed": [0, 1]})
        asked = len(right.asked)
        run_variants([shown], given, tmp_path, name, {"seed": [0, 1]})
        assert len(right.asked) == asked, "what is done is not asked again"
    rows = {(row.name, row.variant): row for row in source_rows(tmp_path)}
    assert {name for name, _ in rows} == {"near", "far", "all"}
    for name, n in (("near", 8), ("far", 12), ("all", 20)):
        whole, worse = rows[name, "colorpair"], rows[name, WORSE]
        assert (whole.n, worse.n) == (n, n)
        assert (whole.figures["recall_add"], whole.changes) == (100.0, None)
        assert worse.changes["recall_add"] == -50.0
        assert (worse.won, worse.lost) == (0, n // 2)
        low, high = worse.intervals["recall_add"]
        assert -100.0 <= low < -50.0 < high <= 0.0
        same = rows[name, "colorpair-without-ppf"]
        assert (same.changes["auc_add"], same.intervals["auc_add"]) == (0.0, (0.0, 0.0))
    assert np.ptp(picture(list(rows.values()))) > 0

    file = tmp_path / WORSE / "near.json"
    record = json.loads(file.read_text())
    file.write_text(json.dumps({**record, "rows": record["rows"][1:]}))
    with pytest.raises(InputError, match="other questions"):
        source_rows(tmp_path)


def test_single_frames_need_a_folder(tmp_path: Path, capsys) -> None:
    command = ["eval", "ablation", "--bop", str(tmp_path), "--bundles", str(tmp_path)]
    assert main([*command, "--json", str(tmp_path / "x.json")]) == 2
    assert "--runs" in capsys.readouterr().err
