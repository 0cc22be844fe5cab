"""Poses, qualities and states are those of the files beside this one, within the tolerances of `answers`.

After a change that is meant to move them, `python -m tests.golden.write` writes them again and says how far.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import se3
from tests.golden import builtin, recorded
from tests.golden.answers import Answer, Answers, ImageMeans, differences, read, write

# The kernels are compiled at their first use, which takes a minute or two.
slow_at_first = pytest.mark.timeout(900)


@slow_at_first
@pytest.mark.parametrize("question", builtin.QUESTIONS)
def test_builtin(question: str) -> None:
    expected = read(builtin.FILE).of(question)
    assert expected.answers
    assert differences(expected, builtin.QUESTIONS[question](question)) == []


@slow_at_first
@pytest.mark.parametrize("question", recorded.QUESTIONS)
def test_recorded(question: str) -> None:
    if reason := recorded.missing():
        pytest.skip(f"not asked, {reason}")
    expected = read(recorded.FILE).of(question)
    assert expected.answers
    assert differences(expected, recorded.QUESTIONS[question](question)) == []


def test_the_sequences_show_occlusion_large_and_small_steps() -> None:
    """Occluded objects are LOST and come back; after large steps an object is SUSPECT for a while, after
    small ones never."""
    answers = read(builtin.FILE)
    states = [a.state for a in answers.of("every frame").answers]
    assert set(states) == {"TRACKING"}
    states = [a.state for a in answers.of("every fifth frame").answers]
    assert (set(states), set(states[-4:])) == ({"TRACKING", "SUSPECT"}, {"TRACKING"})
    for name in ("juice_bottle 0", "tea_box 0"):
        states = [a.state for a in answers.of("hidden for a while").answers if a.object == name]
        assert (states[0], states[-1], "LOST" in states) == ("TRACKING", "TRACKING", True)


POSE = se3.make(se3.rotation_exp([0.3, -0.2, 0.5]), [0.1, 0.0, 0.7])
ANSWER = Answer("heap", 3, "box 0", "TRACKING", 0.9, POSE)
IMAGE = ImageMeans("heap", 3, (100.0, 110.0, 120.0), 700.0)


def changed(**parts: object) -> list[str]:
    """The differences if these parts of the one answer change."""
    return differences(Answers([ANSWER], [IMAGE]), Answers([replace(ANSWER, **parts)], [IMAGE]))


def moved(mm: float, deg: float) -> np.ndarray:
    return se3.perturb(POSE, np.array([1e-3 * mm, 0.0, 0.0, 0.0, np.radians(deg), 0.0]))


def test_within_the_tolerances_is_no_difference() -> None:
    assert changed(T_cam_obj=moved(0.9, 0.4), quality=0.915) == []


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({"T_cam_obj": moved(1.2, 0.0)}, "moved by 1.20 mm"),
        ({"T_cam_obj": moved(0.0, 0.6)}, "0.60 degrees"),
        ({"T_cam_obj": moved(np.nan, 0.0)}, "moved by nan mm"),
        ({"T_cam_obj": None}, "a pose before"),
        ({"quality": 0.87}, "quality 0.900 before, 0.870 now"),
        ({"quality": float("nan")}, "nan now"),
        ({"state": "SUSPECT"}, "state TRACKING before, SUSPECT now"),
        ({"object": "can 0"}, "no answer"),
    ],
)
def test_beyond_them_is_named(parts: dict[str, object], named: str) -> None:
    assert any(named in line for line in changed(**parts))


def test_another_image_is_named_instead_of_its_answers() -> None:
    other = replace(IMAGE, depth_mm=702.0)
    lines = differences(Answers([ANSWER], [IMAGE]), Answers([replace(ANSWER, state="LOST")], [other]))
    assert len(lines) == 1
    assert "another image" in lines[0]


def test_written_answers_are_read_again(tmp_path) -> None:
    path = tmp_path / "golden.json"
    lost = replace(ANSWER, object="can 0", state="LOST", T_cam_obj=None, quality=0.0)
    answers = Answers([ANSWER, lost], [IMAGE])
    write(path, answers)
    again = read(path)
    assert differences(answers, again) == []
    np.testing.assert_allclose(again.answers[0].T_cam_obj, POSE, atol=1e-5)
    assert (again.answers[1].T_cam_obj, again.images) == (None, [IMAGE])
