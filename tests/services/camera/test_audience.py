"""A recording that is played once stands on its first frame until the objects have poses, and ends when its
last frame was read: with real sessions, the tracker's end of the bus being the test's own."""

import time

import pytest

from huepose_protos.examples import messages
from huepose_protos.messages import FrameHeader, PoseMessage
from huepose_services.camera.ingest import make
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.config import BusConfig, Config, ObjectConfig
from huepose_services.runtime.config_perception import CameraConfig
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.session import open_worker_session

pytestmark = pytest.mark.live
POSE = next(m for m in messages() if isinstance(m, PoseMessage))


def test_it_waits_for_poses_and_for_its_last_reader(scene, base_port, wait_until):
    config = Config(
        workers=("camera", "tracker"),
        objects=[ObjectConfig(name=POSE.object)],
        bundles=str(scene),
        camera=CameraConfig(source="bop", path=str(scene), rate="recorded", once=True, first_frame_s=60.0),
        bus=BusConfig(base_port=base_port),
    )
    sessions = {worker: open_worker_session(config, worker)[0] for worker in config.workers}
    camera, tracker = (Bus(s, config.keys, w, Log(w), Health(w)) for w, s in sessions.items())
    frames = tracker.inbox.queue(config.keys.frame)
    ingest, seen = make(camera, config), []

    def step():
        ingest.step()
        time.sleep(0.005)
        while (taken := tracker.take_with_payload(frames, FrameHeader)) is not None:
            seen.append(taken[0])
        return seen

    for _ in range(20):
        assert step() == [], "the tracker is not there yet"
    token = sessions["tracker"].liveliness().declare_token(config.keys.live("tracker"))
    wait_until(lambda: len(step()) >= 3)
    assert {h.frame_id for h in seen} == {3}, "it stands on its first frame"
    tracker.put(config.keys.pose(POSE.object, 0), POSE)
    wait_until(lambda: step()[-1].frame_id == 14)
    assert list(dict.fromkeys(h.frame_id for h in seen)) == list(range(3, 15))
    for _ in range(10):
        step()
    assert not ingest.finished, "nobody has said that the last frame was read"
    tracker.health.camera_epoch, tracker.health.frame_id = seen[-1].camera_epoch, 14
    tracker.say_health()
    wait_until(lambda: step() and ingest.finished)
    token.undeclare()
    for bus in (camera, tracker):
        bus.close()
    for session in sessions.values():
        session.close()
