"""Assignment of estimates to instances: optimal, gated, and independent of the order of either."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.geometry.se3 import carrying
from huepose.reinit.judge import assign, displacement_m, near
from huepose.reinit.types import ObjectSlot, Prior

SLOT = ObjectSlot("mug", 3, 0.2)


def at(x: float, turn_deg: float = 0.0) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0.0, np.radians(turn_deg), 0.0])), np.array([x, 0.0, 0.7]))


def prior(x: float, sigma_m: float = 0.001, turn_deg: float = 0.0) -> Prior:
    return Prior(at(x, turn_deg), None, np.diag([sigma_m**2] * 3 + [1e-3] * 3), 0)


def test_the_sum_counts_not_the_nearest_pair() -> None:
    """The first estimate is nearest to the first instance, but the second can only be that instance."""
    assert assign([at(0.01), at(-0.06)], [prior(0.0), prior(0.08)], 0, SLOT) == [1, 0]


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_order_does_not_matter(order: tuple[int, ...]) -> None:
    places = [-0.2, 0.0, 0.2]
    priors = [prior(x) for x in places]
    estimates = [at(places[i] + 0.01) for i in order]
    assert assign(estimates, priors, 0, SLOT) == list(order)


def test_the_gate_follows_the_covariance() -> None:
    assert assign([at(0.15)], [prior(0.0, 0.001)], 0, SLOT) == [None]
    assert assign([at(0.15)], [prior(0.0, 0.06)], 0, SLOT) == [0]
    assert assign([at(0.5)], [prior(0.0, 1.0)], 0, SLOT) == [None], "never farther than two diameters"


def test_rotations_decide_between_equal_distances() -> None:
    priors = [prior(0.0, 0.05, 0.0), prior(0.0, 0.05, 90.0)]
    assert assign([at(0.0, 80.0), at(0.0, 5.0)], priors, 0, SLOT) == [1, 0]


def test_the_position_of_the_origin_changes_nothing() -> None:
    off = np.array([0.0, 0.0, 4.0])
    far = ObjectSlot("mug", 3, 0.2, (), np.array([off - 0.1, off + 0.1]))

    def moved(T: np.ndarray) -> np.ndarray:
        return T @ se3.make(np.eye(3), -off)

    tracked = prior(0.0, 0.001, 0.0)
    lever = carrying(moved(tracked.T_cam_obj)[:3, 3] - tracked.T_cam_obj[:3, 3])
    priors = [Prior(moved(tracked.T_cam_obj), None, lever @ tracked.covariance @ lever.T, 0)]
    for x, turn_deg in ((0.01, 0.0), (0.09, 0.0), (0.11, 0.0), (0.02, 20.0), (0.15, 0.0)):
        near_origin = assign([at(x, turn_deg)], [tracked], 0, SLOT)
        assert assign([moved(at(x, turn_deg))], priors, 0, far) == near_origin, (x, turn_deg)
        assert displacement_m(moved(at(x, turn_deg)), moved(at(0.0)), far) == pytest.approx(
            displacement_m(at(x, turn_deg), at(0.0), SLOT)
        )


def test_an_object_that_rotates_in_place_is_expected_there_wherever_its_origin_is() -> None:
    """Its published velocity is that of its origin."""
    off, spin, seconds = np.array([0.3, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]), 0.3
    far = ObjectSlot("mug", 3, 0.2, (), np.array([off - 0.1, off + 0.1]))
    to_origin = se3.make(np.eye(3), -off)
    there = at(0.0, np.degrees(2.0 * seconds)) @ to_origin
    now = at(0.0) @ to_origin
    lever = now[:3, 3] - at(0.0)[:3, 3]
    velocity = np.concatenate([np.cross(spin, lever), spin])
    tracked = Prior(now, velocity, None, 0)
    np.testing.assert_allclose(tracked.predicted(round(seconds * 1e9), far.middle_obj), there, atol=1e-12)
    assert assign([there], [tracked], round(seconds * 1e9), far, [True]) == [0]


FLAT = ObjectSlot("book", 3, 0.26, (), np.array([[-0.1, -0.08, 0.0], [0.1, 0.08, 0.03]]))


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "same"),
    [
        ((0.0, 0.0, 0.035), (0.0, 0.0, 0.0), False),  # on top of it
        ((0.0, 0.0, 0.015), (0.0, 0.0, 0.0), True),
        ((0.12, 0.0, 0.1), (0.0, 90.0, 0.0), False),  # it leans on its side
        ((0.0, 0.0, 0.03), (180.0, 0.0, 0.0), True),  # turned over in place
        ((0.09, 0.0, 0.0), (0.0, 0.0, 0.0), True),  # slid along it
        ((0.21, 0.0, 0.0), (0.0, 0.0, 40.0), False),
    ],
)
def test_two_instances_do_not_intersect(
    shift_m: tuple[float, ...], turn_deg: tuple[float, ...], same: bool
) -> None:
    one = at(0.1, 30.0)
    other = one @ se3.make(se3.rotation_exp(np.radians(turn_deg)), np.array(shift_m))
    assert near(one, other, FLAT) == near(other, one, FLAT) == same


def test_an_estimate_beside_a_sure_instance_is_another_one() -> None:
    beside = at(0.0)
    beside[2, 3] += 0.035
    assert assign([beside], [prior(0.0)], 0, FLAT) == [0], "it may have moved there"
    assert assign([beside], [prior(0.0)], 0, FLAT, [True]) == [None]
    assert assign([at(0.01)], [prior(0.0)], 0, FLAT, [True]) == [0]


def test_nothing_to_assign() -> None:
    assert assign([], [prior(0.0)], 0, SLOT) == []
    assert assign([at(0.0)], [], 0, SLOT) == [None]


def test_displacement_counts_no_equivalent_rotations() -> None:
    flip = se3.make(se3.rotation_exp(np.array([0.0, np.pi, 0.0])), np.zeros(3))
    symmetric = ObjectSlot("box", 1, 0.2, (np.eye(4), flip))
    assert displacement_m(at(0.0), at(0.0) @ flip, symmetric) == pytest.approx(0.0, abs=1e-9)
    assert displacement_m(at(0.0), at(0.0) @ flip, SLOT) > 0.1
    assert displacement_m(at(0.0), at(0.03), SLOT) == pytest.approx(0.03)
