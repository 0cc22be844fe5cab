"""Of many objects that are missing, those that something new looks like are searched for first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.model import ReferenceModel
from huepose.perception import windows
from huepose.perception.attention import Attention
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.config import PICKED, DetectorConfig
from huepose.perception.window_table import LIKE
from huepose.propose.view_codes import codes_of_windows

TakePicture = Callable[..., RgbdFrame]


def noisy(frame: RgbdFrame, seed: int) -> RgbdFrame:
    """The same view with other noise."""
    noise = np.random.default_rng(seed).normal(0.0, 2.0, frame.color.shape)
    return replace(frame, color=np.clip(frame.color + noise, 0, 255).astype(np.uint8))


def test_the_likeliest_come_first_and_few_at_once() -> None:
    likeness = {f"o{k}": LIKE + 0.01 * k for k in range(8)} | {"unlike": LIKE - 0.01}
    picked = Attention(likeness=likeness).picked([*likeness, "never_compared"])
    assert picked == ["o7", "o6", "o5", "o4"]
    assert len(picked) == PICKED
    assert Attention(likeness=likeness).picked(["o1", "unlike"]) == ["o1"]


def test_what_was_searched_for_in_vain_is_so_again_only_where_something_is_liker() -> None:
    seen = Attention(likeness={"can": 0.3, "cup": 0.25}).after(["can"], ["can", "cup"])
    assert seen.picked(["can", "cup"]) == ["cup"]
    assert replace(seen, likeness={"can": 0.29}).picked(["can"]) == []
    assert replace(seen, likeness={"can": 0.31}).picked(["can"]) == ["can"]
    found = seen.after([], ["cup"])
    assert replace(found, likeness={"can": 0.2}).picked(["can"]) == ["can"], "it was found, and is lost again"


@pytest.fixture
def watching(tea_box: ReferenceModel, soup_can: ReferenceModel) -> ColorPairDetector:
    """It knows two objects, and remembers what it saw."""
    models = {"tea_box": tea_box, "soup_can": soup_can}
    return ColorPairDetector(models, DetectorConfig(remembering=True))


BOTH = ("soup_can", "tea_box")


def test_what_is_put_there_is_searched_for_in_the_same_look(
    watching: ColorPairDetector, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    beside = standing.copy()
    beside[0, 3] += 0.16
    before, after = take_picture([(tea_box.mesh, beside)]), take_picture([(tea_box.mesh, beside)])
    hidden = take_picture([])
    for look in range(3):
        watching.detect(noisy(hidden, look), [], waiting=BOTH)
    found = watching.detect(noisy(before, 3), [], waiting=BOTH)
    assert found[0].object == "tea_box"
    assert found[0].T_cam_obj is not None
    assert np.linalg.norm(found[0].T_cam_obj[:3, 3] - beside[:3, 3]) < 0.02
    assert watching.detect(noisy(after, 4), [], waiting=BOTH) == [], "nothing is new any more"


def test_what_stands_still_is_compared_once(
    watching: ColorPairDetector,
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    coded: list[int] = []

    def counted(colors: np.ndarray, reliefs: np.ndarray) -> np.ndarray:
        coded.append(len(colors))
        return codes_of_windows(colors, reliefs)

    monkeypatch.setattr(windows, "codes_of_windows", counted)
    picture = take_picture([(tea_box.mesh, standing)])
    watching.detect(noisy(picture, 0), [], waiting=BOTH)
    assert sum(coded) > 10
    coded.clear()
    for look in range(1, 4):
        assert watching.detect(noisy(picture, look), [], waiting=BOTH) == []
    assert sum(coded) == 0


def test_before_a_camera_that_moves_it_is_done_once(
    watching: ColorPairDetector, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    found = []
    for look in range(4):
        moved = se3.make(se3.rotation_exp(np.array([0.0, 0.1 * look, 0.0])), np.zeros(3)) @ standing
        frame = take_picture([(tea_box.mesh, moved)])
        color = np.roll(frame.color, 60 * look, axis=1) // np.uint8(1 + look)
        found.append(watching.detect(replace(frame, color=color), [], waiting=BOTH))
    assert found[0]
    assert found[2:] == [[], []]


def test_without_a_memory_nothing_is_new(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    picture = take_picture([(tea_box.mesh, standing)])
    assert ColorPairDetector({"tea_box": tea_box}).detect(picture, [], waiting=["tea_box"]) == []
