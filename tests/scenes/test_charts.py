"""Charts of blocks and of surfaces of revolution: areas, volumes, unmirrored textures."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.scenes.charts import Chart, blocks, revolved


def area(chart: Chart) -> float:
    c = chart.corners
    return float(np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum() / 2)


def flat_area(chart: Chart) -> float:
    a, b = chart.flat[:, 1] - chart.flat[:, 0], chart.flat[:, 2] - chart.flat[:, 0]
    return float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def volume(charts: list[Chart]) -> float:
    c = np.concatenate([chart.corners for chart in charts])
    return float((c[:, 0] * np.cross(c[:, 1], c[:, 2])).sum() / 6)


def test_an_open_box_has_eleven_faces_and_the_volume_of_its_walls() -> None:
    filled = np.ones((3, 3, 2), bool)
    filled[1, 1, 1] = False
    charts = blocks([0, 0.01, 0.09, 0.1], [0, 0.01, 0.05, 0.06], [0, 0.01, 0.04], filled)
    assert len(charts) == 11
    assert volume(charts) == pytest.approx(0.1 * 0.06 * 0.04 - 0.08 * 0.04 * 0.03)
    sizes = sorted(chart.size for chart in charts)
    assert sizes[-1] == pytest.approx((0.1, 0.06))
    rim = [c for c in charts if np.allclose(c.corners[..., 2], 0.04)]
    assert area(rim[0]) == pytest.approx(0.1 * 0.06 - 0.08 * 0.04)


def test_textures_on_blocks_are_true_to_scale_upright_and_not_mirrored() -> None:
    charts = blocks([0, 0.1], [0, 0.06], [0, 0.04], np.ones((1, 1, 1), bool))
    for chart in charts:
        # Counter-clockwise seen from outside is clockwise in image coordinates, where v points down.
        assert flat_area(chart) == pytest.approx(-area(chart))
    for chart in charts[:4]:
        top = chart.corners[chart.flat[..., 1] < 1e-9]
        np.testing.assert_allclose(top[:, 2], 0.04)


def test_a_cylinder_approaches_its_volume_and_its_label_its_circumference() -> None:
    r, h, n = 0.04, 0.1, 96
    charts = revolved([[(0, 0), (r, 0)], [(r, 0), (r, h / 2), (r, h)], [(r, h), (0, h)]], n)
    polygon = n / 2 * r**2 * np.sin(2 * np.pi / n)
    assert volume(charts) == pytest.approx(polygon * h)
    assert charts[1].size == pytest.approx((2 * np.pi * r, h))
    assert charts[0].size == pytest.approx((2 * r, 2 * r))
    for chart in charts:
        assert flat_area(chart) == pytest.approx(-area(chart), rel=2e-3)
    side = charts[1]
    left = side.corners[side.flat[..., 0] < 1e-9]
    np.testing.assert_allclose(left[:, :2], np.broadcast_to((r, 0.0), (len(left), 2)), atol=1e-12)
