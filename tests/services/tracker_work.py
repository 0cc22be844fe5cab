"""The work of a tracker worker, with a tracker and a bus of known answers, and frames for it."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np

from huepose import tracking
from huepose.believe.state import State
from huepose.geometry import se3
from huepose.judge.terms import NOTHING
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.types import Applied, TrackedPose
from huepose_protos import decode, encode
from huepose_protos.buffers import pack
from huepose_protos.examples import example, images
from huepose_protos.messages import CorrectionMessage, FrameHeader, PoseMessage
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import CameraConfig, Config, TrackerConfig
from huepose_services.runtime.log import Log
from huepose_services.tracker import TrackerWork
from tests.services.fake_bus import FakeBus

HEADER = example(FrameHeader)
CORRECTION = example(CorrectionMessage)
MS = 1_000_000
CENTRE = np.array([0.0, 0.125, 4.5])
AHEAD = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))


class TrackerStandIn:
    """Gives for every frame one object, TRACKING at the given pose."""

    instances: tuple[tuple[str, int], ...] = ()
    objects: tuple[str, ...] = ("mug", CORRECTION.object)
    config = tracking.TrackerConfig()
    reach_s = 4.0

    def __init__(self, T_cam_obj):
        self.T_cam_obj, self.corrections = T_cam_obj, []
        self.answer = Applied.APPLIED

    def step(self, frame):
        return [
            TrackedPose(
                *("mug", 0, frame.epoch, frame.frame_id, frame.stamp_ns, State.TRACKING),
                *(self.T_cam_obj, None, 0.99, np.eye(6) * 1e-6, 0),
            )
        ]

    def poses(self):
        return []

    def surface(self, name):
        return SimpleNamespace(diameter_m=0.12, arrays=SimpleNamespace(centre=CENTRE))

    def doubt(self, name, instance):
        return None

    def hypotheses(self, name, instance):
        rotated = se3.make(se3.rotation_exp(np.array([0.0, 0.0, 1.0])), self.T_cam_obj[:3, 3])
        opinion = Hypothesis(self.T_cam_obj, NOTHING, np.eye(6), "flow", log_odds=np.log(3.0))
        return opinion, Hypothesis(rotated, NOTHING, np.eye(6), "turn", log_odds=0.0)

    def remove_instances(self, name):
        self.instances = tuple(key for key in self.instances if key[0] != name)

    def correct(self, correction):
        self.corrections.append(correction.instance)
        return self.answer


class Loser(TrackerStandIn):
    """Gives for every frame the object as LOST."""

    def step(self, frame):
        return [
            replace(pose, state=State.LOST, T_cam_obj=None, covariance=None) for pose in super().step(frame)
        ]


class BusStandIn(FakeBus):
    """Keeps the published messages, encoded and decoded."""

    def __init__(self):
        super().__init__("tracker")
        self.log = Log("tracker")
        self.heard, self.aside = set(), {}

    def frames(self):
        return SimpleNamespace(skipped=0)

    def is_heard(self, key):
        return key in self.heard

    def put(self, key, message):
        self.said.append(decode(encode(message), PoseMessage))

    def put_aside(self, key, message):
        self.aside[key] = decode(encode(message), type(message))

    def refuse(self, key, error):
        self.health.count("wire_errors")


class ObjectsStandIn:
    def __init__(self):
        self.next = []

    def changes(self):
        out, self.next = self.next, []
        return out


def worker(T_cam_obj=AHEAD, once=False, clock=now_ns):
    config = Config(tracker=TrackerConfig(max_age_ms=300.0), camera=CameraConfig(once=once))
    bus, objects = BusStandIn(), ObjectsStandIn()
    return TrackerWork(bus, TrackerStandIn(T_cam_obj), objects, config, clock), bus, objects


def frame_of_age(number, age_ms):
    specs, payload = pack(images())
    capture_ns = now_ns() - round(age_ms * MS)
    return msgspec.structs.replace(HEADER, frame_id=number, capture_ns=capture_ns, buffers=specs), payload


def changed_frame(number, color=0, depth=0, **intrinsics):
    """A frame with other pixels or intrinsics."""
    header, _ = frame_of_age(number, 0.0)
    pixels = images()
    pixels["color"] = pixels["color"] + np.uint8(color)
    pixels["depth"] = np.where(depth < 0, 0, pixels["depth"] + np.uint16(max(depth, 0))).astype(np.uint16)
    specs, payload = pack(pixels)
    changed = msgspec.structs.replace(header.intrinsics, **intrinsics)
    return msgspec.structs.replace(header, buffers=specs, intrinsics=changed), payload


def frame_at(distance_m):
    """A frame with this depth everywhere, and colour."""
    header, _ = frame_of_age(1, 0.0)
    pixels = images()
    pixels["color"] = np.random.default_rng(0).integers(40, 200, pixels["color"].shape, np.uint8)
    pixels["depth"] = np.full_like(pixels["depth"], 1000)
    specs, payload = pack(pixels)
    wide = msgspec.structs.replace(header.intrinsics, fx=6.0, fy=6.0, depth_scale_m=distance_m / 1000.0)
    return msgspec.structs.replace(header, buffers=specs, intrinsics=wide), payload
