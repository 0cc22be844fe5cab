import numpy as np
import pytest

from huepose.geometry import se3
from huepose.scenes.heap import CELL_M, Heap, random_turn, resting_turns
from tests.meshes import demo_objects

OBJECTS = demo_objects(0)
MIDDLE = np.zeros((1, 2))


def test_objects_come_to_rest_on_the_table_and_on_each_other() -> None:
    heap = Heap()
    box = OBJECTS["tea_box"]  # 15 cm tall
    first = heap.drop(box, np.eye(3), MIDDLE)
    second = heap.drop(box, np.eye(3), MIDDLE)
    np.testing.assert_allclose(first[:3, 3], [0, 0, 0.075], atol=0.001)
    np.testing.assert_allclose(second[:3, 3], [0, 0, 0.225], atol=0.002)


def test_an_object_is_dropped_at_its_lowest_position_and_added_to_the_height_map() -> None:
    heap = Heap()
    heap.drop(OBJECTS["tea_box"], np.eye(3), MIDDLE)
    T = heap.drop(OBJECTS["soup_can"], np.eye(3), np.array([[0.0, 0.0], [0.2, 0.3]]))
    np.testing.assert_allclose(T[:3, 3], [0.2, 0.3, 0.055], atol=0.002)
    rows, columns = np.nonzero(heap.heights > 0.1525)  # nothing is higher than the box
    assert len(rows) == 0
    middle = heap.heights.shape[0] // 2
    can = heap.heights[middle - round(0.3 / CELL_M), middle + round(0.2 / CELL_M)]
    assert can == pytest.approx(0.107, abs=0.003)  # inside its rim


def test_an_object_comes_to_rest_inside_a_hollow_one() -> None:
    heap = Heap()
    heap.drop(OBJECTS["parts_tray"], np.eye(3), MIDDLE)  # a floor 9 mm thick
    T = heap.drop(OBJECTS["soup_can"], np.eye(3), MIDDLE)
    assert T[2, 3] == pytest.approx(0.009 + 0.055, abs=0.002)


def test_flat_sides_are_found_and_objects_rest_on_them() -> None:
    turns, areas = resting_turns(OBJECTS["tea_box"])
    assert len(turns) == 6
    np.testing.assert_allclose(sorted(areas), [0.0054] * 2 + [0.009] * 2 + [0.0135] * 2, rtol=1e-3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        R = random_turn(OBJECTS["tea_box"], rng, lying=1.0)
        height = np.ptp(se3.apply(se3.make(R, np.zeros(3)), OBJECTS["tea_box"].vertices)[:, 2])
        assert min(abs(height - side) for side in (0.06, 0.09, 0.15)) < 1e-4


def test_an_object_that_would_stick_out_is_moved_inside() -> None:
    heap = Heap(side_m=0.4)
    T = heap.drop(OBJECTS["tea_box"], np.eye(3), np.array([[0.3, -0.3]]))
    corners = se3.apply(T, OBJECTS["tea_box"].vertices)[:, :2]
    assert np.abs(corners).max() < 0.2
    assert T[0, 3] > 0.1 > -0.1 > T[1, 3], "still in the requested corner"


def test_an_object_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        Heap(side_m=0.08).drop(OBJECTS["tea_box"], np.eye(3), MIDDLE)
