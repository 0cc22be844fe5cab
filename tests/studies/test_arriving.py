"""An object that arrives is TRACKING soon, among seventeen objects. A request names two of them; there are
five requests a second."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth
from studies import arriving
from studies.arriving import SECONDS_BEFORE, Row, film, report, watched
from studies.live import HZ


def test_an_object_that_arrives_after_six_seconds_is_found_soon_among_many(
    tea_box, soup_can, box_frame, standing, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    label = GroundTruth(0, standing, 1, visib_fract=1.0)
    frames = film(box_frame, label, tea_box, 2, np.random.default_rng(0))
    assert len(frames) == HZ * (SECONDS_BEFORE + 2)
    changed = np.abs(frames[-1].frame.depth - frames[0].frame.depth) > 0.02
    assert 0.02 < changed.mean() < 0.3
    # With a digest, what is derived from the can is computed once for all of them.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    models = {f"a{k:02d}": replace(soup_can, name=f"a{k:02d}", digest="can") for k in range(16)}
    found_s, _, count = watched(frames, {**models, "tea_box": tea_box}, {"tea_box": standing}, "tea_box")
    assert found_s is not None
    assert found_s < 0.9
    assert count == round((SECONDS_BEFORE + found_s) * HZ) + 1


def test_an_object_is_absent_until_it_appears(tea_box, standing, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is TRACKING in the last ten frames without it, too."""
    first = HZ * SECONDS_BEFORE - 10
    poses = [SimpleNamespace(object="tea_box", state="TRACKING", T_cam_obj=standing)]
    played = [(None, poses if number >= first else []) for number in range(first + 20)]
    monkeypatch.setattr(arriving, "followed", lambda *_: played)
    for name in ("Tracker", "ReinitLoop", "Sight"):
        monkeypatch.setattr(arriving, name, lambda *_, **__: None)
    monkeypatch.setattr(arriving, "State", SimpleNamespace(TRACKING=poses[0].state))
    assert watched([], {"tea_box": tea_box}, {"tea_box": standing}, "tea_box") == (0.0, 10, first + 11)


def test_the_report_counts_objects_found_soon() -> None:
    times = (0.5, 1.5, None)
    text = report([Row("1", 0, "can", t, k, 100) for k, t in enumerate(times)])
    assert text.startswith("2 of 3 TRACKING and right, within 1 s, 2 s: 1, 2; median, 90 %: 1.0 s, 1.4 s")
    assert text.endswith("3 of 300 frames")
