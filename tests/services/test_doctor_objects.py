"""What the doctor reports about objects in an image: found, absent, or there with exchanged colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame
from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
from huepose.model.types import ReferenceModel
from huepose_services.doctor import pictures
from huepose_services.doctor.pictures import objects_in
from tests.conftest import TakePicture


def test_objects_are_found_or_reported_with_a_fix(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    (found,) = objects_in(frame, {"tea_box": tea_box})
    assert (found.state, found.found[:17]) == ("ok", "tea_box TRACKING ")
    (none,) = objects_in(take_picture([]), {"tea_box": tea_box})
    assert (none.state, none.fix) == ("none", IF_IN_PLAIN_VIEW)
    blue_first = replace(frame, color=np.ascontiguousarray(frame.color[:, :, ::-1]))
    exchanged, seen = objects_in(blue_first, {"tea_box": tea_box})
    assert exchanged.bad
    assert seen.state != "ok"
    assert "red and blue exchanged" in exchanged.fix
    camera = replace(frame.camera, fx=0.9 * frame.camera.fx, fy=0.9 * frame.camera.fy)
    size, seen = objects_in(replace(frame, camera=camera), {"tea_box": tea_box})
    assert size.bad
    assert "fx and fy" in size.fix
    assert (seen.state, "BAD above" in seen.fix) == ("note", True)


def test_a_suspect_pose_is_not_ok(
    soup_can: ReferenceModel, larger_box: Callable[[float], RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A can with a wrong camera matrix, without the check of sizes."""
    monkeypatch.setattr(pictures, "doubted_in", lambda *_: (None, {}))
    frame = larger_box(1.0)
    camera = replace(frame.camera, fx=0.88 * frame.camera.fx, fy=0.88 * frame.camera.fy)
    (unsure,) = objects_in(replace(frame, camera=camera), {"soup_can": soup_can})
    assert unsure.found.startswith("soup_can SUSPECT ")
    assert (unsure.state, unsure.fix.endswith(IF_IN_PLAIN_VIEW)) == ("note", True)


def test_of_several_objects_the_one_of_another_size_is_named(
    box_and_can: dict[str, ReferenceModel], larger_box: Callable[[float], RgbdFrame]
) -> None:
    bad, seen = objects_in(larger_box(1.15), box_and_can)
    assert (bad.subject, bad.state, bad.found) == ("objects", "bad", "tea_box does not fit")
    assert "larger than its mesh" in bad.fix
    assert seen.state == "ok"


def test_if_depth_is_misaligned_no_object_is_ok(tea_box: ReferenceModel, box_frame: RgbdFrame) -> None:
    (found,) = objects_in(box_frame, {"tea_box": tea_box}, misaligned=True)
    assert (found.state, found.found[:17]) == ("note", "tea_box TRACKING ")
    assert "BAD above" in found.fix
