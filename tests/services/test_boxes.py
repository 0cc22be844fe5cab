"""Where the detectors tell to look."""

import numpy as np
import pytest

from huepose.geometry import Box, Camera, se3
from huepose_protos.examples import messages
from huepose_protos.messages import (
    FrameHeader,
    Intrinsics,
    PerceptionRequest,
    Prior,
    RequestedObject,
    TruthMessage,
    TruthObject,
)
from huepose_services.boxes import FirstBoxes, TruthBoxes
from huepose_services.convert import pose_to_wire
from huepose_services.models import Outline

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)], np.float32)
OUTLINES = {"cube": Outline("cube", 7, CUBE, 0.1732)}
SECOND = 1_000_000_000
T_LEFT, T_RIGHT = (se3.make(np.eye(3), np.array([x, 0.0, 0.8])) for x in (-0.2, 0.2))


def _header(frame_id=1, capture_ns=10 * SECOND):
    import msgspec

    example = next(m for m in messages() if isinstance(m, FrameHeader))
    camera = Intrinsics(fx=600.0, fy=600.0, cx=319.5, cy=239.5, width=640, height=480, depth_scale_m=1e-4)
    changes = {"frame_id": frame_id, "capture_ns": capture_ns, "intrinsics": camera, "camera_epoch": 5}
    return msgspec.structs.replace(example, **changes)


def _request(*objects):
    return PerceptionRequest(publish_ns=1, seq=1, camera_epoch=5, deadline_ns=2, objects=list(objects))


def _prior(T_cam_obj, stamp_ns=10 * SECOND, velocity_linear=(0.0, 0.0, 0.0)):
    translation, quaternion = pose_to_wire(T_cam_obj)
    return Prior(
        stamp_ns=stamp_ns,
        translation=translation,
        quaternion=quaternion,
        velocity_linear=velocity_linear,
        velocity_angular=(0.0, 0.0, 0.0),
    )


def _truth(*poses, visib_fract=None, frame_id=1):
    objects = []
    for i, T_cam_obj in enumerate(poses):
        translation, quaternion = pose_to_wire(T_cam_obj)
        objects.append(
            TruthObject(
                object=None,
                object_id=7,
                instance=i,
                translation=translation,
                quaternion=quaternion,
                visib_fract=visib_fract,
                box=None,
            )
        )
    return TruthMessage(
        publish_ns=1, camera_epoch=5, frame_id=frame_id, capture_ns=1, scene="s", image=1, objects=objects
    )


NEW = RequestedObject(object="cube", instance=None)


class TestTruth:
    def test_the_box_is_the_projected_object_within_a_tenth(self):
        finder = TruthBoxes(OUTLINES, 0)
        finder.learn(_truth(T_LEFT))
        (found,) = finder.find(_header(), _request(NEW), None)
        assert Box(*found.box).iou(OUTLINES["cube"].box(T_LEFT, CAMERA)) > 0.6
        assert found.request == NEW

    def test_without_the_truth_of_that_very_frame_there_is_no_box(self):
        finder = TruthBoxes(OUTLINES, 0)
        finder.learn(_truth(T_LEFT, frame_id=2))
        assert finder.find(_header(frame_id=1), _request(NEW), None) == []

    def test_a_hidden_object_gets_no_box(self):
        finder = TruthBoxes(OUTLINES, 0)
        finder.learn(_truth(T_LEFT, visib_fract=0.05))
        assert finder.find(_header(), _request(NEW), None) == []

    def test_a_known_instance_gets_its_own_and_a_new_one_the_other(self):
        finder = TruthBoxes(OUTLINES, 0)
        finder.learn(_truth(T_LEFT, T_RIGHT))
        known = RequestedObject(object="cube", instance=4, prior=_prior(T_RIGHT))
        first, second = finder.find(_header(), _request(known, NEW), None)
        assert Box(*first.box).iou(OUTLINES["cube"].box(T_RIGHT, CAMERA)) > 0.6
        assert Box(*second.box).iou(OUTLINES["cube"].box(T_LEFT, CAMERA)) > 0.6

    def test_no_more_boxes_than_are_wanted(self):
        finder = TruthBoxes(OUTLINES, 0)
        finder.learn(_truth(T_LEFT, T_RIGHT))
        assert len(finder.find(_header(), _request(NEW), None)) == 1

    def test_the_same_seed_gives_the_same_boxes(self):
        found = []
        for seed in (3, 3, 4):
            finder = TruthBoxes(OUTLINES, seed)
            finder.learn(_truth(T_LEFT))
            found.append(finder.find(_header(), _request(NEW), None)[0].box)
        assert found[0] == found[1] != found[2]


class TestFirstBox:
    GIVEN = Box(10.0, 20.0, 50.0, 60.0)

    def _finder(self):
        return FirstBoxes(OUTLINES, {"cube": self.GIVEN})

    def test_the_given_box_holds_until_the_object_is_acquired(self):
        finder = self._finder()
        for _ in range(3):
            assert finder.find(_header(), _request(NEW), None)[0].box == tuple(self.GIVEN)

    def test_then_the_prediction_is_followed(self):
        prior = _prior(T_LEFT, stamp_ns=9_900_000_000, velocity_linear=(4.0, 0.0, 0.0))
        known = RequestedObject(object="cube", instance=1, prior=prior)
        (found,) = self._finder().find(_header(), _request(known), None)
        assert Box(*found.box).iou(OUTLINES["cube"].box(T_RIGHT, CAMERA).grown(0.08)) > 0.999

    def test_after_a_loss_the_last_box_grows_to_the_image(self):
        finder = self._finder()
        known = RequestedObject(object="cube", instance=1, prior=_prior(T_LEFT))
        finder.find(_header(), _request(known), None)
        areas = []
        for lost_s in (1, 2, 4):
            header = _header(capture_ns=(10 + lost_s) * SECOND)
            (found,) = finder.find(header, _request(known), None)
            areas.append(Box(*found.box).area)
        assert areas == sorted(areas)
        assert areas[-1] == 640 * 480

    @pytest.mark.parametrize("what", ["remove", "forget_where"])
    def test_a_search_anew_begins_with_the_given_box(self, what):
        finder = self._finder()
        known = RequestedObject(object="cube", instance=1, prior=_prior(T_LEFT))
        finder.find(_header(), _request(known), None)
        getattr(finder, what)("cube")
        assert finder.find(_header(), _request(NEW), None)[0].box == tuple(self.GIVEN)
        if what == "forget_where":
            assert finder.find(_header(), _request(known), None)[0].box != tuple(self.GIVEN)

    def test_an_object_without_a_box_is_left_out(self):
        finder = FirstBoxes(OUTLINES, {})
        assert finder.find(_header(), _request(NEW), None) == []


@pytest.mark.parametrize("z", [-0.8, 0.0])
def test_an_object_behind_the_camera_has_no_outline(z):
    assert OUTLINES["cube"].box(se3.make(np.eye(3), np.array([0.0, 0.0, z])), CAMERA) is None
