"""Shares and weights of pieces, and the refit of a plane: what is compiled against the plain formulas."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Box
from huepose.perception.depth_pieces import cut_pieces
from huepose.perception.support_plane import NEAR_M, _near_plane, _outside


def test_shares_and_weights_of_two_pieces_are_those_of_the_formula() -> None:
    depth = np.full((40, 60), 0.8, np.float32)
    depth[:, 30:] = 1.2  # a step: two pieces
    box = Box(12.5, 6.0, 30.0, 25.0)
    pieces = cut_pieces(depth, depth > 0, box)
    v, u = np.mgrid[:40, :60]
    inside = (u >= box.x) & (u < box.x1) & (v >= box.y) & (v < box.y1)
    near = np.exp(-0.5 * ((v - box.y - box.h / 2) / (0.45 * box.h)) ** 2)
    near = near * np.exp(-0.5 * ((u - box.x - box.w / 2) / (0.45 * box.w)) ** 2)
    assert len(pieces.weight) == 2
    for k in range(2):
        piece = pieces.labels == k
        np.testing.assert_allclose(pieces.share[k], inside[piece].mean(), rtol=1e-12)
        np.testing.assert_allclose(pieces.weight[k], near[piece].sum(), rtol=1e-12)


def test_the_ring_round_a_box_is_what_lies_outside_of_it_and_has_depth() -> None:
    depth = np.ones((21, 33), np.float32)
    depth[4, 6] = depth[0, 0] = 0.0
    box = (7.5, 6.0, 20.0, 15.5)
    v, u = np.mgrid[:21:2, :33:2]
    inside = (u > box[0]) & (u < box[2]) & (v > box[1]) & (v < box[3])
    expected = np.flatnonzero(~inside & (depth[::2, ::2] > 0))
    found = _outside(np.ascontiguousarray(depth[::2, ::2]), box[0], box[1], box[2], box[3])
    np.testing.assert_array_equal(found, expected)


def test_the_spread_of_a_plane_has_its_normal() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.3, -0.5, -0.81])
    normal /= np.linalg.norm(normal)
    points = rng.uniform(-0.3, 0.3, (400, 3))
    points -= np.outer(points @ normal + rng.normal(0.0, 0.004, 400), normal)
    point = np.zeros(3)
    near = points[np.abs((points - point) @ normal) < NEAR_M]
    count, mean, spread = _near_plane(points, normal, point)
    assert count == len(near) < 400
    np.testing.assert_allclose(mean, near.mean(0), atol=1e-12)
    found = np.linalg.eigh(spread)[1][:, 0]
    expected = np.linalg.svd(near - near.mean(0), full_matrices=False)[2][2]
    np.testing.assert_allclose(abs(found @ expected), 1.0, atol=1e-12)
