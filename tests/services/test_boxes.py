"""Where the detectors tell to look."""

import numpy as np
import pytest

from huepose.geometry import Box, Camera, se3
from huepose_protos.examples import messages
from huepose_protos.messages import FrameHeader, Intrinsics, PerceptionRequest, Prior, RequestedObject
from huepose_services.boxes import FirstBoxes
from huepose_services.convert import pose_to_wire
from huepose_services.models import Outline

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)], np.float32)
OUTLINES = {"cube": Outline(CUBE, 0.1732)}
SECOND = 1_000_000_000
T_LEFT, T_RIGHT = (se3.make(np.eye(3), np.array([x, 0.0, 0.8])) for x in (-0.2, 0.2))


def _header(capture_ns=10 * SECOND):
    import msgspec

    example = next(m for m in messages() if isinstance(m, FrameHeader))
    camera = Intrinsics(fx=600.0, fy=600.0, cx=319.5, cy=239.5, width=640, height=480, depth_scale_m=1e-4)
    changes = {"capture_ns": capture_ns, "intrinsics": camera, "camera_epoch": 5}
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


NEW = RequestedObject(object="cube", instance=None)


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
