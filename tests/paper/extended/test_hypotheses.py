"""Hypotheses from a rendered frame: plausibility, starts from shape, and the whole chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.types import ColorPairs
from huepose.geometry import RgbdFrame, se3
from huepose.model.types import ReferenceModel, reference_pairs
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.extended import hypotheses
from huepose.paper.extended.hypotheses import HypothesesConfig, hypotheses_of, read_scene
from huepose.paper.extended.plausible import plausible
from huepose.paper.extended.shape import shape_hypotheses
from huepose.paper.scene import classes_in_sight, extract_at_model_scale
from huepose.paper.votes import Votes
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture


@pytest.fixture(
    scope="module", params=[(1.0, 1.0, 1.0), (0.62, 0.55, 0.4)], ids=["white light", "dim warm light"]
)
def frame(
    request: pytest.FixtureRequest,
    tea_box: ReferenceModel,
    standing: np.ndarray,
    take_picture: TakePicture,
) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing)], light=request.param)


@pytest.fixture(scope="module")
def mask(tea_box: ReferenceModel, standing: np.ndarray, frame: RgbdFrame) -> np.ndarray:
    return render_depth(tea_box.mesh, standing, frame.camera) > 0


def from_pairs(
    model: ReferenceModel, pairs: ColorPairs, frame: RgbdFrame, mask: np.ndarray, config: HypothesesConfig
) -> np.ndarray:
    rng = np.random.default_rng(0)
    readings = read_scene(model, pairs, frame, mask, config, rng)
    return hypotheses_of(model, readings, frame, mask, config, rng)


def nearest(poses: np.ndarray, T: np.ndarray) -> tuple[int, float, float]:
    """Rank of the first hypothesis within 12 degrees and 2 cm, and its errors in degrees and metres."""
    for rank, pose in enumerate(poses):
        turn = np.degrees(se3.rotation_angle(pose, T))
        move = float(np.linalg.norm(pose[:3, 3] - T[:3, 3]))
        if turn < 12.0 and move < 0.02:
            return rank, turn, move
    return 999, 180.0, 1.0


@pytest.mark.parametrize("sources", ["all", "frames", "triangles", "ppf"])
def test_the_pose_is_among_the_first_hypotheses(
    tea_box: ReferenceModel, standing: np.ndarray, frame: RgbdFrame, mask: np.ndarray, sources: str
) -> None:
    config = HypothesesConfig(**{name: sources in ("all", name) for name in ("frames", "triangles", "ppf")})
    pairs = extract_at_model_scale(tea_box.pairs, frame, mask)
    found = from_pairs(tea_box, pairs, frame, mask, config)
    rank, _, _ = nearest(found, standing)
    assert rank < 3


def test_point_pairs_vote_if_fewer_than_three_classes_are_visible(
    tea_box: ReferenceModel,
    frame: RgbdFrame,
    mask: np.ndarray,
    painted: ClassifiedCloud,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert classes_in_sight(painted) == 5
    of_two = painted[painted.classes < 2]
    few = np.concatenate([np.flatnonzero(painted.classes == 2)[:29], np.flatnonzero(painted.classes < 2)])
    assert classes_in_sight(of_two) == classes_in_sight(painted[few]) == 2

    config, rng = HypothesesConfig(), np.random.default_rng(0)
    pairs = extract_at_model_scale(tea_box.pairs, frame, mask)
    readings = read_scene(tea_box, pairs, frame, mask, config, rng)
    poor = [replace(r, cloud=r.cloud[r.cloud.classes < 2]) for r in readings]
    asked = []
    real = hypotheses.ppf_votes
    monkeypatch.setattr(hypotheses, "ppf_votes", lambda *args: asked.append(1) or real(*args))
    for given, chosen, times in (
        (readings, config, 0),
        (poor, config, len(poor)),
        (poor, HypothesesConfig(ppf=False), 0),
    ):
        asked.clear()
        hypotheses_of(tea_box, given, frame, mask, chosen, rng)
        assert len(asked) == times


def test_the_light_is_estimated(tea_box: ReferenceModel, frame: RgbdFrame, mask: np.ndarray) -> None:
    pairs = extract_at_model_scale(tea_box.pairs, frame, mask)
    readings = read_scene(tea_box, pairs, frame, mask, HypothesesConfig(), np.random.default_rng(0))
    assert len(np.unique(readings[0].cloud.classes)) >= 3
    known = reference_pairs(tea_box.pairs).colors.reshape(-1, 3)
    read = readings[0].pairs.colors.reshape(-1, 3)
    # under the model's light, scene colours are model colours
    distance = np.linalg.norm(read[:, None] - known[None, ::5], axis=2).min(1)
    assert np.median(distance) < 8.0
    (as_seen,) = read_scene(
        tea_box, pairs, frame, mask, HypothesesConfig(light=False), np.random.default_rng(0)
    )
    seen = {tuple(pair) for pair in pairs.colors.reshape(-1, 6).round(2)}
    assert {tuple(pair) for pair in as_seen.pairs.colors.reshape(-1, 6).round(2)} <= seen


def test_the_same_seed_gives_the_same_poses(
    tea_box: ReferenceModel, frame: RgbdFrame, mask: np.ndarray
) -> None:
    pairs = extract_at_model_scale(tea_box.pairs, frame, mask)
    a, b = (from_pairs(tea_box, pairs, frame, mask, HypothesesConfig()) for _ in range(2))
    np.testing.assert_array_equal(a, b)


def test_poses_that_contradict_depth_are_rejected(
    tea_box: ReferenceModel, standing: np.ndarray, frame: RgbdFrame, mask: np.ndarray
) -> None:
    shifts = np.array([[0, 0, 0], [0, 0, -0.06], [0, 0, 0.06], [0.15, 0, 0]])
    poses = np.stack([se3.perturb(standing, np.concatenate([s, np.zeros(3)])) for s in shifts])
    votes = Votes(
        poses[:, :3, :3].astype(np.float32),
        poses[:, :3, 3].astype(np.float32),
        np.ones(4, np.float32),
        np.arange(4, dtype=np.int32),
    )
    kept = plausible(votes, tea_box.surface, frame.depth, mask, frame.camera, tea_box.diameter_m)
    assert kept.features.tolist() == [0]  # poses in front, behind and beside are rejected
    assert kept.weights[0] > 0.9


def test_a_start_from_shape_is_near_a_near_symmetric_rotation(
    tea_box: ReferenceModel, standing: np.ndarray, frame: RgbdFrame, mask: np.ndarray
) -> None:
    starts = shape_hypotheses(tea_box, frame, mask, 20)
    assert len(starts) == 20
    likes = [standing @ turn for turn in tea_box.near_symmetries]
    turns = [min(np.degrees(se3.rotation_angle(start, T)) for T in likes) for start in starts]
    assert min(turns) < 20.0
    assert not len(shape_hypotheses(tea_box, frame, np.zeros_like(mask), 20))


def test_without_pairs_there_are_no_hypotheses(
    tea_box: ReferenceModel, frame: RgbdFrame, mask: np.ndarray
) -> None:
    assert not len(from_pairs(tea_box, ColorPairs.empty(), frame, mask, HypothesesConfig()))
    nothing = np.zeros_like(mask)
    assert len(extract_at_model_scale(tea_box.pairs, frame, nothing)) == 0
