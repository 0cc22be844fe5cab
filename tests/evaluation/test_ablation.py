"""The ablation of flow correspondences: known motions, known errors, the form of its results."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth, Sample
from huepose.evaluation import ablation
from huepose.evaluation.ablation import (
    CHOICES,
    chosen,
    endpoint_error_px,
    errors,
    evaluate_ablation,
    plain_kabsch,
    visible_within,
    with_networks,
)
from huepose.evaluation.ablation_rows import FILTERED, AblationResult, AblationRow
from huepose.evaluation.targets import Targets
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.paper.correspondences import Correspondences
from huepose.paper.relative_pose import LiftedMatches, lift_matches, robust_kabsch
from huepose.propose.flow import compute
from huepose.rendering import render
from huepose.support.errors import InputError

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
WHOLE = Box(0.0, 0.0, CAMERA.width, CAMERA.height)


def pose(k: int) -> np.ndarray:
    """Moves by 2 mm and 1.4 degrees a frame; static from frame 6 on."""
    k = min(k, 6)
    turn = se3.rotation_exp(np.array([0.0, 0.02 * k, 0.014 * k])) @ se3.rotation_exp(
        np.array([1.9, 0.3, 0.4])
    )
    return se3.make(turn, np.array([0.002 * k, 0.001 * k, 0.5]))


@dataclass(frozen=True)
class Film:
    """Nine frames of a printed box in front of a wall."""

    model: ReferenceModel
    name: str = "film"
    image_ids: tuple[int, ...] = tuple(range(9))

    def stamp_ns(self, image: int) -> int:
        return image * 33_000_000

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        return (GroundTruth(0, pose(image), object=self.model.name),)

    def frame(self, image: int) -> RgbdFrame:
        seen = render([(self.model.mesh, pose(image))], CAMERA)
        wall = np.kron(np.random.default_rng(4).integers(40, 200, (15, 20, 3)), np.ones((16, 16, 1)))
        there = seen.depth > 0
        color = np.where(there[..., None], seen.color, wall).astype(np.uint8)
        depth = np.where(there, seen.depth, 1.1).astype(np.float32)
        return RgbdFrame(color, depth, CAMERA, image, self.stamp_ns(image))


def test_every_variant_is_measured_on_every_pair_with_motion(tea_box, monkeypatch) -> None:
    monkeypatch.setattr(ablation, "GAP", 2)
    result = evaluate_ablation([Film(tea_box)], Targets({tea_box.name: tea_box}))
    assert (result.pairs, result.left_out) == (7, 1), "the last pair is static"
    record = result.as_json()
    names = "sequence frame object variant rotation_error_rel translation_error_rel epe_px"
    assert set(record["rows"][0]) >= set(names.split())
    variants = record["summary"]["variants"]
    assert set(variants) == {f"{c}/{e}" for c in CHOICES for e in ("kabsch", "robust")}
    assert len(record["rows"]) == 6 * 10
    alone = record["summary"]["filter_alone"]
    assert set(alone) == {f"{c}/{e}" for c in FILTERED for e in ("kabsch", "robust")}
    best, raw = variants["colorpair/robust"], variants["flow/kabsch"]
    assert best["no_motion"] == 0
    assert best["rotation_error_rel_median"] < 0.1
    assert best["translation_error_rel_median"] < 0.1
    assert best["epe_px_mean"] < 0.6
    assert best["rotation_error_rel_mean"] < raw["rotation_error_rel_mean"]
    assert best["epe_px_mean"] <= raw["epe_px_mean"]
    assert result.picture().shape[2] == 3
    monkeypatch.setattr(ablation, "GAP", 20)
    with pytest.raises(InputError, match="0 pairs"):
        evaluate_ablation([Film(tea_box)], Targets({tea_box.name: tea_box}))


def test_errors_are_relative_to_the_true_motion() -> None:
    T_a, T_b = pose(0), pose(5)
    exact = se3.compose(T_b, se3.inverse(T_a))
    np.testing.assert_allclose(errors(exact, T_a, T_b), (0.0, 0.0), atol=1e-7)
    np.testing.assert_allclose(errors(np.eye(4), T_a, T_b), (1.0, 1.0), atol=1e-9)


def test_the_endpoint_error_of_flow_with_a_known_offset(tea_box) -> None:
    surface = render([(tea_box.mesh, pose(0))], CAMERA, color=False).depth
    rows, columns = np.nonzero(surface[::9, ::9] > 0)
    a = np.stack([columns, rows], 1) * 9.0
    motion = se3.compose(pose(4), se3.inverse(pose(0)))
    ends = CAMERA.project(se3.apply(motion, CAMERA.backproject(a, surface[rows * 9, columns * 9])))
    ones = np.ones(len(a))
    off = Correspondences(a, ends + np.array([3.0, -4.0]), ones)
    assert endpoint_error_px(off, surface, CAMERA, motion) == pytest.approx(5.0, abs=1e-4)
    beside = Correspondences(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1))
    assert endpoint_error_px(beside, surface, CAMERA, motion) is None


def test_wrong_matches_disturb_only_the_fit_without_outlier_rejection(tea_box) -> None:
    film = Film(tea_box)
    a, b = Sample.of(film, 0), Sample.of(film, 2)
    flow = compute(a.frame.color, b.frame.color, WHOLE)
    assert flow is not None
    mask = visible_within(tea_box.mesh, pose(0), a.frame, WHOLE)
    matches = chosen("flow", a, b, mask, flow)
    pixels = matches.pixels_b.copy()
    pixels[::4] += [15.0, 9.0]
    lifted = lift_matches(a.frame, b.frame, replace(matches, pixels_b=pixels))
    plain, robust = plain_kabsch(lifted), robust_kabsch(lifted)
    assert plain is not None
    assert robust is not None
    plainly, robustly = (sum(errors(m, pose(0), pose(2))) for m in (plain, robust))
    assert robustly < 0.3 * plainly
    few = LiftedMatches(lifted.points_a[:7], lifted.points_b[:7], lifted.weights[:7])
    assert plain_kabsch(few) is None


def test_a_pair_without_an_estimated_motion_counts_as_zero_motion() -> None:
    rows = [
        AblationRow("s", 0, 3, "flow/kabsch", 0.5, 0.25, 2.0, 50),
        AblationRow("s", 1, 3, "flow/kabsch", None, None, None, 2),
    ]
    figures = AblationResult(rows, 3, 1).summary()
    assert (figures["pairs"], figures["pairs_left_out"], figures["gap"]) == (3, 1, 5)
    flow = figures["variants"]["flow/kabsch"]
    assert flow["rotation_error_rel_mean"] == 0.75
    assert flow["translation_error_rel_mean"] == 0.625
    assert (flow["epe_px_mean"], flow["no_motion"]) == (2.0, 1)


@pytest.mark.parametrize(("kind", "degrees"), [("residual", 0.5), ("direct", 1.5)])
def test_the_packaged_networks_find_the_rotation_of_true_matches(kind, degrees):
    rng = np.random.default_rng(0)
    aside = rng.uniform(-0.05, 0.05, (150, 2))
    bulge = np.sqrt(0.08**2 - (aside**2).sum(1))
    points = np.column_stack([0.05 + aside[:, 0], 0.02 + aside[:, 1], 0.7 - bulge])
    T = se3.make(se3.rotation_exp(np.array([0.05, -0.1, 0.08])), np.array([0.01, 0.0, 0.02]))
    moved = se3.apply(T, points)
    motion = with_networks()[kind](LiftedMatches(points, moved, np.ones(len(points))))
    assert np.degrees(se3.rotation_angle(motion, T)) < degrees
