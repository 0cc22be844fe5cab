import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose.paper.relative_pose import robust_kabsch
from huepose.paper.rotation_network import canonical_input, fixed_count
from huepose.rendering.render import is_closed, render_depth
from huepose.training.shapes import random_object, random_shape
from huepose.training.turns import endless, render_motions, sample_of
from huepose.training.views import Props, ViewRange, draw_views

CLEAN = ViewRange(occluded=0.0, flicker=0.0, stereo=0.0, turn_rad_s=(0.0, 2.0), speed_m_s=(0.0, 0.3))


@pytest.fixture(scope="module")
def turns():
    rng = np.random.default_rng(3)
    props = Props(rng)
    return [turn for _ in range(2) for turn in render_motions(rng, props, CLEAN)]


@pytest.mark.parametrize("seed", range(4))
def test_a_shape_is_centred_and_has_the_requested_size(seed):
    mesh = random_shape(np.random.default_rng(seed), 0.2)
    extent = mesh.vertices.max(0) - mesh.vertices.min(0)
    assert np.linalg.norm(extent) == pytest.approx(0.2, rel=1e-5)
    assert mesh.centre == pytest.approx(np.zeros(3), abs=1e-6)
    # The measured depth lies between the nearest and the farthest vertex.
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    depth = render_depth(mesh, T, Camera(500.0, 500.0, 159.5, 119.5, 320, 240))
    z = mesh.vertices[:, 2] + 0.6
    assert (depth > 0).sum() > 500
    seen = depth[depth > 0]
    assert z.min() - 1e-5 <= seen.min() <= seen.max() <= z.max() + 1e-5


def test_objects_are_textured_and_have_the_requested_size():
    rng = np.random.default_rng(0)
    for _ in range(12):
        mesh = random_object(rng, 0.15)
        assert np.linalg.norm(np.ptp(mesh.vertices, axis=0)) == pytest.approx(0.15, rel=1e-5)
        assert 0.0 <= mesh.uv.min() <= mesh.uv.max() <= 1.0
        assert mesh.texture.std() > 5.0
    packages = [mesh for mesh in (random_object(rng, 0.15) for _ in range(12)) if len(mesh.faces) < 100]
    assert packages
    assert all(is_closed(mesh.vertices, mesh.faces) for mesh in packages)


def test_views_show_the_object_at_its_pose():
    rng = np.random.default_rng(5)
    mesh = random_object(rng, 0.2)
    views = draw_views(rng, mesh, Props(rng), 1.0, CLEAN)
    assert len(views.frames) == len(views.masks) == len(views.T_cam_obj) == 6
    for frame, mask, T, box in zip(views.frames, views.masks, views.T_cam_obj, views.boxes, strict=True):
        alone = render_depth(mesh, T, frame.camera)
        np.testing.assert_allclose(frame.depth[mask], alone[mask], atol=1e-5)
        assert not (mask & (alone == 0)).any()
        assert (frame.depth[~mask & (alone > 0)] < alone[~mask & (alone > 0)]).all(), "an occluder is nearer"
        rows, columns = np.nonzero(alone)
        assert box.x - 1 <= columns.min() <= columns.max() <= box.x1 + 1
        assert box.y - 1 <= rows.min() <= rows.max() <= box.y1 + 1


def test_the_motion_from_flow_is_mostly_the_true_motion(turns):
    """Slow objects in noise-free images."""
    assert len(turns) > 40
    errors = []
    for turn in turns:
        off = np.linalg.norm(se3.apply(turn.T_b_a, turn.matches.points_a) - turn.matches.points_b, axis=1)
        T = robust_kabsch(turn.matches)
        turned = np.pi if T is None else se3.rotation_angle(T, turn.T_b_a)
        errors.append((np.median(off), np.degrees(turned)))
    off_m, off_deg = np.median(errors, 0)
    assert off_m < 3e-3
    assert off_deg < 2.5


def test_the_answer_is_the_rotation_that_the_closed_form_leaves(turns):
    """The answer in the canonical frame, transformed back, gives the true rotation."""
    turn = max(turns, key=lambda t: len(t.matches))
    first = robust_kabsch(turn.matches)[:3, :3]
    question = canonical_input(turn.matches, "residual")
    answer = sample_of(turn, "residual").R_canon.astype(np.float64)
    assert question.clouds.rotation(answer) @ first == pytest.approx(turn.T_b_a[:3, :3], abs=1e-6)
    direct = canonical_input(turn.matches, "direct")
    whole = sample_of(turn, "direct").R_canon.astype(np.float64)
    assert direct.clouds.rotation(whole) == pytest.approx(turn.T_b_a[:3, :3], abs=1e-6)


def test_the_stream_of_samples_depends_on_its_seed_and_number():
    def first(seed, stream):
        (sample,) = next(endless(seed, stream, ["residual"]))
        return sample.features

    assert np.array_equal(first(1, 2), first(1, 2))
    assert not np.array_equal(first(1, 2), first(1, 3))
    assert not np.array_equal(first(1, 2), first(2, 2))


def test_few_matches_are_repeated_and_of_many_the_largest_weights_are_kept():
    features = np.arange(300, dtype=np.float32)[:, None] * np.ones(15, np.float32)
    weights = np.linspace(0.0, 1.0, 300)
    rows, heavy = fixed_count(features, weights)
    assert rows[:, 0].tolist() == list(range(299, 171, -1))
    assert heavy.min() > 0.57
    rows, _ = fixed_count(features[:50], weights[:50])
    assert rows[:, 0].tolist() == [float(49 - k % 50) for k in range(128)]
