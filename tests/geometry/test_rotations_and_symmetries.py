import numpy as np
import pytest

from huepose.geometry import se3, symmetry
from huepose.geometry.icosphere import directions, look_at


def test_angles_are_those_of_the_rotation_between() -> None:
    poses = np.stack([se3.exp(np.array([s, 0, 0, 0, 0, s])) for s in (-0.5, 0.5)])
    np.testing.assert_allclose(se3.angles_to(poses[:, :3, :3], np.eye(3)), [0.5, 0.5])


@pytest.mark.parametrize(("level", "count"), [(0, 12), (1, 42), (2, 162), (3, 642)])
def test_icosphere_is_even(level, count):
    d = directions(level)
    assert d.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1)
    np.testing.assert_allclose(d.mean(0), 0, atol=1e-12)
    nearest = np.sort(d @ d.T, axis=1)[:, -2]
    assert np.degrees(np.arccos(nearest)).max() / np.degrees(np.arccos(nearest)).min() < 1.3


def test_look_at_makes_a_direction_face_the_camera():
    for d in directions(1):
        R = look_at(d)
        assert se3.is_rigid(se3.make(R, np.zeros(3)))
        np.testing.assert_allclose(R @ d, [0, 0, -1], atol=1e-12)


def test_continuous_symmetry_about_an_offset_axis():
    turns = symmetry.sampled(
        {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [10, 0, 0]}]}, step_rad=np.pi / 2
    )
    assert len(turns) == 4
    np.testing.assert_allclose(se3.apply(turns[1], np.array([0.02, 0, 0.3])), [0.01, 0.01, 0.3], atol=1e-12)


def test_discrete_symmetries_compose_with_continuous_ones():
    entry = {
        "symmetries_discrete": [np.diag([1.0, -1, -1, 1]).ravel().tolist()],
        "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
    }
    turns = symmetry.sampled(entry, step_rad=np.pi / 4)
    assert len(turns) == 16
    np.testing.assert_array_equal(turns[0], np.eye(4))


def test_mahalanobis_counts_standard_deviations():
    cov = np.diag([0.01**2] * 3 + [0.1**2] * 3)
    T = se3.exp(np.array([0, 0, 1, 0.1, 0.2, 0.3]))
    assert se3.mahalanobis(T, se3.perturb(T, np.array([0.02, 0, 0, 0, 0, 0])), cov) == pytest.approx(2)
    assert se3.mahalanobis(T, se3.perturb(T, np.array([0, 0, 0, 0.3, 0, 0])), cov) == pytest.approx(3)


def test_uncertainty_grows_with_time():
    grown = se3.grown(np.zeros((6, 6)), 0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(grown)), [0.02] * 3 + [0.1] * 3)


@pytest.mark.parametrize("offset", [[0.0, 0.0, 0.0], [0.3, -0.2, 0.1]])
def test_of_equivalent_poses_the_one_with_the_smallest_rotation_is_taken(offset: list[float]) -> None:
    """For a bottle, whose axis need not go through its origin, it is also the nearest one point by point."""
    turns = np.array([symmetry.rotation_about([0.0, 0.0, 1.0], k * np.pi / 36, offset) for k in range(72)])
    T = se3.make(se3.rotation_exp([0.4, -0.3, 0.2]), [0.1, 0.0, 0.7])
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (40, 3)) + offset
    for k in (0, 1, 35, 71):
        near = T @ turns[k] @ symmetry.rotation_about([0.6, -0.3, 0.8], 0.03, offset)
        apart = [np.linalg.norm(se3.apply(T @ E, points) - se3.apply(near, points), axis=1) for E in turns]
        assert np.argmin(np.mean(apart, axis=1)) == k
        np.testing.assert_array_equal(symmetry.nearest_alike(T, turns, near), (T @ turns)[k])
