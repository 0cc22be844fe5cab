import numpy as np
import pytest

from huepose.geometry import kabsch, se3

T = se3.exp(np.array([0.3, -0.2, 0.9, 0.7, -1.1, 0.4]))


def test_exact_transform_is_recovered():
    p = np.random.default_rng(0).normal(size=(10, 3))
    np.testing.assert_allclose(kabsch.fit(p, se3.apply(T, p)), T, atol=1e-12)


def test_never_a_reflection():
    p = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.2, 0]])
    q = p * [1, 1, -1] + [0, 0, 1e-9]
    assert se3.is_rigid(kabsch.fit(p, q))


def test_zero_weight_is_ignored():
    p = np.random.default_rng(1).normal(size=(8, 3))
    q = se3.apply(T, p)
    q[0] += 100
    np.testing.assert_allclose(kabsch.fit(p, q, np.r_[0.0, np.ones(7)]), T, atol=1e-9)


def test_too_few_pairs_are_refused():
    with pytest.raises(ValueError, match="three weighted pairs"):
        kabsch.fit(np.zeros((2, 3)), np.zeros((2, 3)))


def test_half_of_the_pairs_may_be_wrong():
    rng = np.random.default_rng(2)
    p = rng.uniform(-0.1, 0.1, (200, 3))
    q = se3.apply(T, p) + rng.normal(0, 0.0005, p.shape)
    q[:100] = rng.uniform(-0.2, 0.2, (100, 3)) + T[:3, 3]
    found = kabsch.motion(p, q)
    assert found is not None
    assert np.linalg.norm(found[:3, 3] - T[:3, 3]) < 0.0005
    assert se3.rotation_angle(found, T) < np.radians(0.3)


def test_few_pairs_and_pairs_that_do_not_agree_have_no_motion():
    rng = np.random.default_rng(3)
    p = rng.uniform(-0.1, 0.1, (40, 3))
    assert kabsch.motion(p[:2], p[:2]) is None
    assert kabsch.motion(p[:7], p[:7]) is None
    assert kabsch.motion(p, rng.uniform(-0.1, 0.1, (40, 3))) is None
