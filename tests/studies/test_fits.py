import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.believe.logistic import Logistic
from huepose.believe.quality import TIE, features, quality_fits
from huepose.evaluation.calibration import Judged, worth
from huepose.model.io import model_path
from huepose.support.errors import InputError
from studies import frame_belief
from studies.quality import __main__ as quality
from studies.quality import fit as quality_fit
from studies.quality.fit import FEATURES, Names
from tests.evaluation.judged import PLAIN, judged

NAMES = Names(("total",), ("texture_complete",), ("same_size",), ("total",), ())


def drawn(n: int, seed: int) -> tuple[Judged, np.ndarray]:
    """Poses with one rival each, and the probability of each first pose. The probability that one of the
    two is right is logistic in the total; 40 times the gap divides it between them."""
    rng = np.random.default_rng(seed)
    totals, gaps = rng.uniform(0.5, 2.5, n), rng.uniform(0.0, 0.3, n)
    listed = 1 / (1 + np.exp(-(-3.0 + 4.0 * totals)))
    first = 1 / (1 + np.exp(-40.0 * gaps))
    which = np.where(rng.random(n) < listed, np.where(rng.random(n) < first, 0, 1), -1)
    terms = [replace(PLAIN, total=float(t), gaps=(float(g),)) for t, g in zip(totals, gaps, strict=True)]
    return judged(terms, which), listed * first


def test_the_fit_recovers_the_law_of_constructed_data() -> None:
    labels, chance = drawn(6000, 0)
    fitted = quality_fit.fit(labels, NAMES)

    def stated(judged: Judged) -> np.ndarray:
        return np.array([fitted.fit.probabilities(terms)[0] for terms in judged.terms])

    assert fitted.fit.listed.factors["total"] == pytest.approx(4.0, rel=0.1)
    assert fitted.fit.sharpness["constant"] == pytest.approx(40.0, rel=0.1)
    assert fitted.fit.handicap < 0.15
    np.testing.assert_allclose(stated(labels), chance, atol=0.05)
    fresh, _ = drawn(4000, 1)
    known = worth(stated(fresh), fresh, fitted.fit.level)
    assert known.ece is not None
    assert known.ece < 0.02
    assert known.precision == pytest.approx(0.99, abs=0.008)


def test_in_an_exact_tie_the_first_has_no_advantage_and_a_clear_second_has_a_handicap() -> None:
    rng = np.random.default_rng(8)
    n = 6000
    gaps = rng.choice([0.0, 0.002, 0.02, 0.05, 0.1], n)
    first = 1 / (1 + np.exp(-20.0 * gaps - 1.5 * np.tanh(gaps / TIE)))
    which = np.where(rng.random(n) < 0.9, np.where(rng.random(n) < first, 0, 1), -1)
    labels = judged([replace(PLAIN, gaps=(float(g),)) for g in gaps], which)
    fit = quality_fit.fit(labels, NAMES).fit
    assert fit.handicap == pytest.approx(1.5, abs=0.3)
    assert fit.sharpness["constant"] == pytest.approx(20.0, abs=6.0)
    tied = fit.probabilities(replace(PLAIN, gaps=(0.0,)))
    assert tied[0] == tied[1]


def test_absent_objects_are_not_present_and_look_alikes_have_low_quality() -> None:
    labels, _ = drawn(2000, 4)
    rng = np.random.default_rng(5)
    others = judged([replace(PLAIN, total=float(t)) for t in rng.uniform(-1.0, 0.2, 300)], np.full(300, -1))
    foreign = [replace(PLAIN, total=2.5, missing=float(m)) for m in rng.uniform(0.45, 0.7, 300)]
    alike = judged(foreign, np.full(300, -1))
    fitted = quality_fit.fit(labels, NAMES, others, alike)
    assert (fitted.present_others >= fitted.fit.found).mean() < 0.05
    lost = fitted.present_labels[labels.right] < fitted.fit.found
    assert lost.mean() == pytest.approx(quality_fit.LOST_SHARE, abs=0.003)
    assert (fitted.alike >= fitted.fit.level).mean() < 0.05
    own = replace(PLAIN, total=2.5)
    assert fitted.fit.probabilities(own)[0] > 2 * fitted.fit.probabilities(foreign[0])[0]
    without = quality_fit.fit(labels, NAMES)
    assert without.fit.found == 0.0
    assert without.fit.this_texture(features(foreign[0])) > 0.97


def test_the_level_is_where_the_share_of_right_poses_falls_below_the_target() -> None:
    quality_of = np.linspace(1.0, 0.0, 1001)
    right = quality_of > 0.6  # 400 right poses, then only wrong ones
    each = np.ones(1001)
    assert quality_fit.level_of(quality_of, right, each, share=0.8) == pytest.approx(0.5, abs=0.003)
    right[:] = True
    assert quality_fit.level_of(quality_of, right, each) == pytest.approx(0.01)
    right[:] = False
    # the quality of the 50th pose
    assert quality_fit.level_of(quality_of, right, each) == pytest.approx(0.951)


def test_a_frame_is_never_scored_by_a_fit_that_includes_it() -> None:
    """Frames are right and wrong in turn, without a law. A fit that includes a frame would agree with it; a
    fit to the other frames tends the other way."""
    terms = [replace(PLAIN, pixels=10.0 ** (1 + k // 20)) for k in range(200)]
    right = np.array([k // 20 % 2 == 0 for k in range(200)])
    labels = judged(terms, np.where(right, 0, -1), per_frame=20)
    stated = quality_fit.fit(labels, replace(NAMES, listed=("size",))).labels
    assert np.corrcoef(stated, right)[0, 1] < 0
    assert len(np.unique(np.round(stated, 6))) <= 10


def test_data_with_only_right_poses_cannot_be_fitted() -> None:
    with pytest.raises(InputError, match="3 right of 3"):
        quality_fit.fit(judged([PLAIN] * 3, np.zeros(3)), NAMES)


def test_every_shipped_fit_increases_with_every_feature() -> None:
    better = replace(
        PLAIN, total=1.7, gaps=(0.2, 0.3), color=0.5, box_iou=0.9, depth_fit=0.8, coverage=0.8,
        violation=0.05, occluded=0.05, seen=0.8, missing=0.1, foreign=5.0, detail=0.6, pixels=4000.0,
        turned=0.05, otherwise=0.1, agreed=1.1,
    )  # fmt: skip
    for name, fit in quality_fits().items():
        for part in ("presence", "this_texture", "this_size", "listed"):
            factors = getattr(fit, part).factors
            assert set(factors) <= set(getattr(FEATURES[name], part)) <= set(features(PLAIN))
            assert all(factor > 0 for factor in factors.values())
        assert 0.5 < fit.level < 1.0
        assert 0.0 <= fit.found < 0.5
        assert fit.probabilities(PLAIN).sum() <= 1.0
        assert fit.present(better) > fit.present(PLAIN)
        assert fit.probabilities(better)[0] > fit.probabilities(PLAIN)[0]


def test_the_tracking_page_names_the_data_of_its_fit() -> None:
    root = Path(__file__).parents[2]
    origin = json.loads((root / "huepose" / "believe" / "fits.json").read_text())["frame"]["origin"]
    page = " ".join((root / "docs" / "tracking_measured.md").read_text().split())
    for said in origin.values():
        assert " ".join(said.split()) in page


def test_the_fit_ends_if_its_data_are_not_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it would go on with the scenes and reference models that are there."""
    asked = []

    def interrupted(words: list[str]) -> int:
        asked.append(words[0])
        return 130

    monkeypatch.setattr(quality, "run_huepose", interrupted)
    with pytest.raises(SystemExit, match="130"):
        quality.rendered_scene(tmp_path / "scene", "builtin", 3, 0)
    monkeypatch.setattr(quality, "bop_models", lambda _: [SimpleNamespace(name=name) for name in "ab"])
    (tmp_path / "bundles").mkdir()
    model_path(tmp_path / "bundles", "a").touch()
    with pytest.raises(SystemExit, match="130"):
        quality.bundles_of(tmp_path, None, tmp_path)
    model_path(tmp_path / "bundles", "b").touch()
    assert quality.bundles_of(tmp_path, None, tmp_path) == tmp_path / "bundles"
    assert asked == ["render-scenes", "onboard-bop"]


def test_the_rows_of_a_fit_are_written_into_a_new_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "new" / "fit.json"
    monkeypatch.setattr(sys, "argv", ["frame_belief", "--bundles", "bundles", "--json", str(out)])
    rows = [frame_belief.Row("film", 2, "step 1", "still", {"total": 1.0}, e, e) for e in (0.01, 0.5)]
    monkeypatch.setattr(frame_belief, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(frame_belief, "collect", lambda job: rows)
    monkeypatch.setattr(frame_belief, "fitted", lambda rows, only: Logistic(0.5, {"total": 1.0}))
    frame_belief.main()
    record = json.loads(out.read_text())
    assert record["fit"] == {"constant": 0.5, "factors": {"total": 1.0}}
    assert len(record["rows"]["fit"]) == record["report"]["fit"]["rows"] == 2 * (15 + 24 + 8)
