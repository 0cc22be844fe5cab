import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from huepose.estimation.quality import MAX_MARGIN, QualityTerms, features, quality, quality_fits
from huepose.evaluation import calibration
from huepose.evaluation.calibration import Judged
from huepose.support.errors import InputError

PLAIN = QualityTerms(1.5, 0.1, 0.4, 0.8, 0.7, 0.7, 0.1, 0.1, 0.7, 2000.0)


def drawn(n: int, seed: int) -> tuple[Judged, np.ndarray]:
    """Poses whose chance to be right is logistic in margin and total alone, and these chances."""
    rng = np.random.default_rng(seed)
    margins, totals, seen = rng.uniform(0, MAX_MARGIN, n), rng.uniform(0.5, 2.5, n), rng.uniform(0, 1, n)
    chance = 1 / (1 + np.exp(-(-7.0 + 20.0 * margins + 4.0 * totals)))
    terms = [
        replace(PLAIN, margin=float(m), total=float(t), seen=float(s))
        for m, t, s in zip(margins, totals, seen, strict=True)
    ]
    right = rng.random(n) < chance
    return Judged(terms, right, [k // 5 for k in range(n)], chance, np.ones(n)), chance


def test_the_law_behind_constructed_data_is_found() -> None:
    judged, chance = drawn(6000, 0)
    fit = calibration.fit(judged, ("margin", "total", "seen"))
    assert fit.factors["margin"] == pytest.approx(20.0, rel=0.15)
    assert fit.factors["total"] == pytest.approx(4.0, rel=0.15)
    assert fit.factors["seen"] < 0.4
    np.testing.assert_allclose(calibration.stated_by(fit, judged), chance, atol=0.05)
    fresh, _ = drawn(4000, 1)
    worth = calibration.worth(calibration.stated_by(fit, fresh), fresh, fit.level)
    assert worth.ece is not None
    assert worth.ece < 0.02
    assert worth.precision == pytest.approx(0.99, abs=0.006)


def test_no_factor_is_negative_even_where_the_data_say_so() -> None:
    judged, _ = drawn(2000, 2)
    backwards = replace(judged, right=~judged.right)
    fit = calibration.fit(backwards, ("margin", "total"))
    assert fit.factors == {"margin": 0.0, "total": 0.0}


def test_the_level_is_where_the_share_of_right_ones_falls_under_the_wanted() -> None:
    quality_of = np.linspace(1.0, 0.0, 1001)
    right = quality_of > 0.6  # 400 right ones, then wrong ones only
    assert calibration.level_of(quality_of, right, share=0.8) == pytest.approx(0.5, abs=0.002)
    right[:] = True
    assert calibration.level_of(quality_of, right) == pytest.approx(0.01)
    right[:] = False
    assert calibration.level_of(quality_of, right) == pytest.approx(0.951)  # that of the 50 surest


def test_coverage_counts_what_got_no_pose() -> None:
    judged = Judged(
        [PLAIN] * 4, np.array([True, True, False, True]), [0, 0, 1, 1], np.zeros(4), np.ones(4), missed=4
    )
    worth = calibration.worth(np.array([0.9, 0.95, 0.97, 0.2]), judged, 0.9)
    assert (worth.poses, worth.right) == (8, 3)
    assert worth.coverage == pytest.approx(3 / 8)
    assert worth.precision == pytest.approx(2 / 3)


def test_a_frame_is_never_judged_by_itself() -> None:
    """Frames right and wrong in turn, without any law: a fit that saw them would agree with them, one that
    saw only the others leans the other way."""
    terms = [replace(PLAIN, pixels=10.0 ** (1 + k // 20)) for k in range(200)]
    right = np.array([k // 20 % 2 == 0 for k in range(200)])
    judged = Judged(terms, right, [k // 20 for k in range(200)], np.zeros(200), np.ones(200))
    stated = calibration.held_out(judged, ("size",))
    assert np.corrcoef(stated, right)[0, 1] < 0
    assert len(np.unique(np.round(stated, 6))) <= 10


def test_one_kind_of_outcome_cannot_be_fitted() -> None:
    judged = Judged([PLAIN] * 3, np.ones(3, bool), [0, 1, 2], np.zeros(3), np.ones(3))
    with pytest.raises(InputError, match="3 right of 3"):
        calibration.fit(judged, ("margin",))


def test_every_shipped_fit_rises_with_every_feature() -> None:
    better = replace(
        PLAIN, total=1.7, margin=0.2, color=0.5, box_iou=0.9, depth_fit=0.8, coverage=0.8,
        violation=0.05, occluded=0.05, seen=0.8, pixels=4000.0,
    )  # fmt: skip
    for name, fit in quality_fits().items():
        assert set(fit.factors) <= set(features(PLAIN))
        assert set(fit.factors) <= set(calibration.FEATURES[name])
        assert min(fit.factors.values()) > 0
        assert 0.5 < fit.level < 1.0
        assert quality(name, better) > quality(name, PLAIN)


def test_a_weight_counts_as_so_many_poses() -> None:
    judged, _ = drawn(400, 5)
    once = replace(judged, weights=np.where(judged.right, 3.0, 1.0))
    copies = [k for k in range(400) for _ in range(3 if judged.right[k] else 1)]
    often = Judged(
        [judged.terms[k] for k in copies], judged.right[copies], [judged.frames[k] for k in copies],
        judged.stated[copies], np.ones(len(copies)),
    )  # fmt: skip
    weighted = calibration.fit(once, ("margin", "total"))
    repeated = calibration.fit(often, ("margin", "total"))
    assert weighted.constant == pytest.approx(repeated.constant, rel=0.03)
    assert weighted.factors["margin"] == pytest.approx(repeated.factors["margin"], rel=0.03)


def test_of_what_only_looks_alike_no_pose_is_right(tmp_path: Path) -> None:
    row = {"scene": "a", "image": 1, "found": True, "right": True, "quality": 0.9, "terms": asdict(PLAIN)}
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"rows": [row, {**row, "found": False}], "false": [row]}))
    shown = calibration.read_judged(path)
    assert shown.right.tolist() == [True, False]
    assert shown.missed == 1
    alike = calibration.read_judged(path, absent=True)
    assert alike.right.tolist() == [False, False]
    assert alike.weights.tolist() == [calibration.FALSE_WEIGHT] * 2
    assert alike.missed == 0


def test_look_alikes_lower_quality_and_leave_the_level_to_the_others() -> None:
    judged, _ = drawn(2000, 3)
    names = ("margin", "total")
    alone = calibration.fit(judged, names)
    surest = [replace(PLAIN, margin=MAX_MARGIN, total=2.5)] * 300
    nothing = np.zeros(300)
    alike = Judged(surest, nothing > 0, [-k for k in range(300)], nothing, nothing + 0.2)
    both = calibration.fit(judged + alike, names, alike=300)
    assert both(surest[0]) < alone(surest[0]) - 0.01
    held_out = calibration.held_out(judged + alike, names)[:2000]
    assert both.level == calibration.level_of(held_out, judged.right)
    over = held_out >= both.level
    assert judged.right[over].mean() >= 0.99
