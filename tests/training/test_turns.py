import numpy as np
import pytest

from huepose.geometry import Camera, kabsch, se3
from huepose.paper.rotation_network import fixed_count, posed
from huepose.propose.relative_pose import RobustKabsch
from huepose.rendering.render import render_depth
from huepose.training.shapes import random_shape
from huepose.training.turns import TurnRange, draw_turns, endless, sample_of

PERFECT = TurnRange(depth_noise=(0.0, 0.0), jitter_px=(1e-9, 2e-9), drift_px=(0.0, 0.0), wrong=(0.0, 0.0))


@pytest.mark.parametrize("seed", range(4))
def test_a_shape_is_closed_centred_and_as_large_as_asked(seed):
    mesh = random_shape(np.random.default_rng(seed), 0.2)
    extent = mesh.vertices.max(0) - mesh.vertices.min(0)
    assert np.linalg.norm(extent) == pytest.approx(0.2, rel=1e-5)
    assert mesh.centre == pytest.approx(np.zeros(3), abs=1e-6)
    # What the camera sees lies between the nearest and the farthest vertex.
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    depth = render_depth(mesh, T, Camera(500.0, 500.0, 159.5, 119.5, 320, 240))
    z = mesh.vertices[:, 2] + 0.6
    assert (depth > 0).sum() > 500
    seen = depth[depth > 0]
    assert z.min() - 1e-5 <= seen.min() <= seen.max() <= z.max() + 1e-5


def test_without_errors_matches_are_the_true_motion():
    """All but the few that went out of sight and that a check of flow would have missed."""
    turns = [t for seed in range(6) for t in draw_turns(np.random.default_rng(seed), PERFECT, draws=1)]
    assert len(turns) >= 4
    for turn in turns:
        off = np.linalg.norm(se3.apply(turn.T_b_a, turn.matches.points_a) - turn.matches.points_b, axis=1)
        assert np.median(off) < 2e-3
        T, _, _ = kabsch.robust_fit(
            turn.matches.points_a, turn.matches.points_b, inlier_m=0.004, rng=np.random.default_rng(0)
        )
        assert np.degrees(se3.rotation_angle(T[:3, :3], turn.T_b_a[:3, :3])) < 1.0


def test_the_answer_turns_what_the_closed_form_left():
    """Asked and answered in the canonical frame, and taken back, it is the true motion."""
    turn = draw_turns(np.random.default_rng(3), TurnRange(), draws=1)[0]
    first = RobustKabsch().estimate(turn.matches).T_b_a[:3, :3]
    question = posed(turn.matches, "residual", RobustKabsch())
    answer = sample_of(turn, "residual").R_canon.astype(np.float64)
    assert question.seen.rotation(answer) @ first == pytest.approx(turn.T_b_a[:3, :3], abs=1e-6)
    direct = posed(turn.matches, "direct", RobustKabsch())
    whole = sample_of(turn, "direct").R_canon.astype(np.float64)
    assert direct.seen.rotation(whole) == pytest.approx(turn.T_b_a[:3, :3], abs=1e-6)


def test_the_stream_repeats_itself_with_its_seed_only():
    def first(seed, stream):
        return next(endless(seed, stream, "residual")).features

    assert np.array_equal(first(1, 2), first(1, 2))
    assert not np.array_equal(first(1, 2), first(1, 3))
    assert not np.array_equal(first(1, 2), first(2, 2))


def test_few_matches_are_repeated_and_of_many_the_heaviest_stay():
    features = np.arange(300, dtype=np.float32)[:, None] * np.ones(15, np.float32)
    weights = np.linspace(0.0, 1.0, 300)
    rows, heavy = fixed_count(features, weights)
    assert rows[:, 0].tolist() == list(range(299, 171, -1))
    assert heavy.min() > 0.57
    rows, _ = fixed_count(features[:50], weights[:50])
    assert rows[:, 0].tolist() == [float(49 - k % 50) for k in range(128)]
