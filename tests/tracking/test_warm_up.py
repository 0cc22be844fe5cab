"""After warm-up no kernel is compiled at the first real frame."""

from __future__ import annotations

from dataclasses import replace

from huepose.geometry import Box, Camera
from huepose.judge.open_region import open_region
from huepose.tracking import Tracker, refined, stages

PARTS = {"search": stages, "refine": refined, "terms_at": refined}


def test_warm_up_runs_every_part_and_leaves_no_track(tea_box, soup_can, monkeypatch) -> None:
    tried = set()

    def spied(name):
        real = getattr(PARTS[name], name)

        def call(*arguments, **more):
            tried.add(name)
            return real(*arguments, **more)

        return call

    for name in PARTS:
        monkeypatch.setattr(PARTS[name], name, spied(name))
    tracker = Tracker({"tea_box": tea_box, "soup_can": soup_can})
    tracker.warm_up()
    assert tried == set(PARTS)
    assert tracker.instances == ()
    assert tracker.poses() == []


def test_a_tracker_without_objects_can_warm_up() -> None:
    Tracker({}).warm_up()


def test_integer_intrinsics_compile_no_kernel_again(shoot) -> None:
    frame = replace(shoot([], 0), camera=Camera(420, 420, 160, 120, 320, 240))
    region = open_region(frame, Box(40, 40, 64, 64), 0.5, 0.1)
    assert region is not None
    arrays = region.arrays
    assert all(type(x) is float for x in (arrays.fx, arrays.fy, arrays.cx, arrays.cy))
