"""Two hard moments, rendered and played: a track is given up in time, and a look-alike is not accepted."""

from __future__ import annotations

import numpy as np

from huepose.evaluation.states import report
from huepose.model import ReferenceModel
from huepose.tracking import Tracker
from studies.stress.play import play
from studies.stress.playing import Oracle
from tests.studies.moments import covered, swapped


def test_a_covered_object_is_lost_and_comes_back(tea_box: ReferenceModel) -> None:
    frames = covered(tea_box.mesh)
    assert max(seen.visib_fract for seen in frames[5:13]) < 0.1
    tracker = Tracker({tea_box.name: tea_box})
    moments = play(frames, tea_box, tracker, frames[0].T_cam_obj, perception=Oracle(tea_box))
    figures = report(moments)
    assert figures.false_tracking_frames == 0
    assert figures.declared_suspect_after_frames is not None
    assert figures.declared_suspect_after_frames <= 2
    assert figures.declared_lost_after_frames is not None
    assert figures.declared_lost_after_frames <= 5
    assert figures.reacquired_after_s is not None
    assert figures.reacquired_after_s <= 0.4 + 0.35 + 0.01


def test_a_look_alike_is_never_taken_for_the_object(tea_box: ReferenceModel) -> None:
    frames = swapped(tea_box.mesh)
    assert max(seen.visib_fract for seen in frames[6:]) < 0.1
    assert np.array_equal(frames[-1].T_cam_obj[:3, 3], [0.0, 0.0, -2.0]), "behind the camera"
    tracker = Tracker({tea_box.name: tea_box})
    moments = play(frames, tea_box, tracker, frames[0].T_cam_obj, perception=Oracle(tea_box))
    figures = report(moments)
    assert figures.tracking_frames == 6
    assert figures.false_tracking_frames == 0
