"""Of many missing objects, those that something new looks like are searched for first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel
from huepose.perception.attention import CODED, EACH, EARNED, Attention, attended
from huepose.perception.clear_view import clear_view
from huepose.perception.config import PICKED, DetectorConfig
from huepose.perception.memory import next_look
from huepose.perception.view_detector import ViewDetector
from huepose.perception.window_table import LIKE, window_table
from huepose.perception.windows import SIZES, WindowsBySize
from tests.conftest import TakePicture
from tests.meshes import demo_objects
from tests.perception.conftest import noisy


def test_the_likeliest_come_first_and_few_at_once() -> None:
    likeness = {f"o{k}": LIKE + 0.01 * k for k in range(8)} | {"unlike": LIKE - 0.01}
    picked = Attention(likeness=likeness).picked([*likeness, "never_compared"])
    assert picked == ["o7", "o6", "o5", "o4"]
    assert len(picked) == PICKED
    assert Attention(likeness=likeness).picked(["o1", "unlike"]) == ["o1"]


def test_a_failed_search_is_repeated_only_if_the_likeness_has_grown() -> None:
    seen = Attention(likeness={"can": 0.3, "cup": 0.25}).after(["can"], ["can", "cup"])
    assert seen.picked(["can", "cup"]) == ["cup"]
    assert replace(seen, likeness={"can": 0.29}).picked(["can"]) == []
    assert replace(seen, likeness={"can": 0.31}).picked(["can"]) == ["can"]
    found = seen.after([], ["cup"])
    assert replace(found, likeness={"can": 0.2}).picked(["can"]) == ["can"], "it was found and is lost again"


@pytest.fixture
def watching(tea_box: ReferenceModel, soup_can: ReferenceModel) -> ViewDetector:
    """A detector of two objects, with a memory."""
    models = {"tea_box": tea_box, "soup_can": soup_can}
    return ViewDetector(models, DetectorConfig(remembering=True))


BOTH = ("soup_can", "tea_box")


def test_a_new_object_is_searched_for_in_the_same_call(
    watching: ViewDetector, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    beside = standing.copy()
    beside[0, 3] += 0.16
    empty, there = take_picture([]), take_picture([(tea_box.mesh, beside)])
    for look in range(3):
        watching.detect(noisy(empty, look), [], waiting=BOTH)
    found = watching.detect(noisy(there, 3), [], waiting=BOTH)
    assert found[0].object == "tea_box"
    assert found[0].T_cam_obj is not None
    assert np.linalg.norm(found[0].T_cam_obj[:3, 3] - beside[:3, 3]) < 0.02
    assert watching.detect(noisy(there, 4), [], waiting=BOTH) == [], "nothing is new any more"


def test_static_windows_are_compared_once(
    watching: ViewDetector, box_frame: RgbdFrame, coded: list[int]
) -> None:
    watching.detect(noisy(box_frame, 0), [], waiting=BOTH)
    assert sum(coded) > 10
    coded.clear()
    for look in range(1, 4):
        assert watching.detect(noisy(box_frame, look), [], waiting=BOTH) == []
    assert sum(coded) == 0


def test_if_everything_moves_objects_are_compared_one_size_after_another(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, coded: list[int]
) -> None:
    table, scene = window_table(tea_box), [(mesh, standing) for mesh in demo_objects(1).values()]
    missing = [(f"o{k}", 0.06 * SIZES**k, table) for k in range(16)]
    frame, memory, seen, each = take_picture(scene), None, Attention(), []
    for look in range(14):
        shift = (look % 5) * 24
        moved = replace(
            frame, color=np.roll(frame.color, shift, axis=1), depth=np.roll(frame.depth, shift, axis=1)
        )
        memory, view = next_look(memory, moved), clear_view(moved, 0.6)
        assert view is not None
        coded.clear()
        seen = attended(seen, memory, WindowsBySize(view, memory), missing)
        each.append(sum(coded))
    assert CODED <= each[0] < CODED + EACH
    assert np.mean(each[1:]) < EARNED + EACH
    assert len(seen.looks) == 16
    assert min(seen.looks.values()) >= 14 - 8, "every size in turn"


def test_without_a_memory_nothing_is_new(tea_box: ReferenceModel, box_frame: RgbdFrame) -> None:
    assert ViewDetector({"tea_box": tea_box}).detect(box_frame, [], waiting=["tea_box"]) == []
