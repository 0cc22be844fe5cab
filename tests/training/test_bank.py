import numpy as np
import torch

from huepose.geometry import se3
from huepose.paper.canonical import canonical
from huepose.training.rotation import Bank, exchanged, varied


def asked(rng):
    """Exact features of a rotating cloud, of the inverse motion, and the canonical rotation."""
    points = rng.uniform(-0.1, 0.1, (128, 3)) + np.array([0.1, 0.05, 0.7])
    R = se3.rotation_exp(rng.normal(0.0, 0.3, 3))
    moved = (points - points.mean(0)) @ R.T + points.mean(0)
    there, back = canonical(points, moved), canonical(moved, points)
    return there.features, back.features, there.canonical_rotation(R).astype(np.float32)


def test_the_answer_of_a_varied_sample_is_still_true():
    torch.manual_seed(0)
    made = [asked(np.random.default_rng(k)) for k in range(64)]
    features = torch.from_numpy(np.array([m[0] for m in made]))[:, None]
    answers = torch.from_numpy(np.array([m[2] for m in made]))[:, None]
    changed, told = varied(features, answers)
    assert torch.allclose(changed[..., 3:6], changed[..., :3] @ told.transpose(2, 3), atol=1e-4)
    assert torch.allclose(changed[..., 10:13], changed[..., 3:6] - changed[..., :3], atol=1e-5)
    assert torch.allclose(changed[..., 13:], changed[..., 8:10] - changed[..., 6:8], atol=1e-5)
    assert torch.allclose(torch.linalg.det(told), torch.ones(64, 1), atol=1e-5)
    # near points stay near: their depths do not change
    assert torch.allclose(changed[..., [2, 5]].sort(-1)[0], features[..., [2, 5]].sort(-1)[0], atol=1e-5)
    assert (changed[..., 0] - features[..., 0]).abs().mean() > 0.1


def test_exchanged_samples_have_the_features_of_the_inverse_motion():
    there, back, _ = asked(np.random.default_rng(1))
    assert torch.allclose(exchanged(torch.from_numpy(there)), torch.from_numpy(back), atol=1e-5)


def test_new_samples_replace_the_oldest():
    bank = Bank(4, 1, "cpu")
    for k in range(3):
        bank.add((torch.full((2, 1, 128, 15), k), torch.full((2, 128), k), torch.full((2, 1, 3, 3), k)))
    assert bank.drawn == 6
    assert sorted(bank.weights[:, 0].tolist()) == [1.0, 1.0, 2.0, 2.0]
    assert bank.batch(7)[0].shape == (7, 1, 128, 15)
