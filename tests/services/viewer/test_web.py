"""The viewer's page in a browser, for a frame with objects at known poses."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zenoh

from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Float64, UInt8
from huepose.model import ReferenceModel, save_model
from huepose_protos import encode
from huepose_protos.examples import example
from huepose_protos.messages import (
    FrameHeader,
    HeldHypothesis,
    HeldObject,
    HypothesesMessage,
    Message,
    PoseMessage,
)
from huepose_services.convert import pose_to_wire
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_file import load
from huepose_services.viewer.show import OTHER, STATE_COLOURS
from tests.conftest import TakePicture, standing_pose
from tests.services.fake_bus import sent
from tests.services.repeating import repeating
from tests.services.sessions import listening
from tests.services.viewer import browser

pytestmark = [
    pytest.mark.live,
    pytest.mark.pipeline,
    pytest.mark.timeout(240),
    pytest.mark.skipif(browser.PROGRAM is None, reason="there is no Chromium: apt-get install chromium"),
]
RATE_HZ = 2.0
# Rows and columns of the view "Camera and poses" in a page of 1400 x 840 pixels.
VIEW = (slice(66, 588), slice(0, 699))
SURE, DOUBTED = standing_pose(0.6, -0.15, 0.0), standing_pose(-0.4, 0.15, 0.0)
ROTATED = se3.compose(DOUBTED, se3.make(se3.rotation_exp(np.array([0.0, 0.0, 0.8])), np.zeros(3)))


@pytest.fixture
def config(tea_box: ReferenceModel, tmp_path: Path, base_port: int) -> Config:
    """The configuration of a camera and a tracker; the test publishes in their place."""
    save_model(tea_box, tmp_path / "bundles" / "tea_box.huepose")
    path = tmp_path / "pipeline.yaml"
    said = {"workers": ["camera", "tracker"], "bundles": "bundles", "bus": {"base_port": base_port}}
    path.write_text(json.dumps({**said, "viewer": {"image_rate_hz": RATE_HZ}}))
    return load(path)


def messages_of(frame: RgbdFrame, frame_id: int) -> tuple[FrameHeader, bytes, list[Message]]:
    """A frame as the camera sends it, and the tracker's messages about it: one box TRACKING, one SUSPECT."""
    now = time.monotonic_ns()
    stamps = {"publish_ns": now, "capture_ns": now, "frame_id": frame_id, "camera_epoch": 7}
    header, payload = sent(frame, **stamps)

    def pose(instance: int, T_cam_obj: Float64, state: str, reason: str) -> PoseMessage:
        translation, quaternion = pose_to_wire(T_cam_obj)
        where = {"translation": translation, "quaternion": quaternion, "state": state, "reason": reason}
        offset = time.time_ns() - now
        return msgspec.structs.replace(
            example(PoseMessage),
            **stamps,
            **where,
            object="tea_box",
            instance=instance,
            realtime_offset_ns=offset,
        )

    possible = [
        HeldHypothesis(translation=t, quaternion=q, share=share, source=source)
        for (t, q), share, source in (
            (pose_to_wire(DOUBTED), 0.7, "velocity"),
            (pose_to_wire(ROTATED), 0.3, "turn"),
        )
    ]
    held = HypothesesMessage(
        **stamps, objects=[HeldObject(object="tea_box", instance=1, hypotheses=possible)]
    )
    poses = [pose(0, SURE, "TRACKING", ""), pose(1, DOUBTED, "SUSPECT", "It is mostly covered.")]
    return header, payload, [*poses, held]


@contextmanager
def published(config: Config, frame: RgbdFrame) -> Iterator[None]:
    """Publishes the frame repeatedly, at the endpoints of the camera and the tracker."""
    keys = config.keys
    places = [config.endpoint(worker) for worker in config.workers]
    Path(places[0].removeprefix("unixsock-stream/")).parent.mkdir(mode=0o700, parents=True, exist_ok=True)

    def publish(number: int) -> None:
        header, payload, said = messages_of(frame, number)
        session.put(keys.frame, payload, attachment=encode(header))
        for message in said:
            if isinstance(message, PoseMessage):
                session.put(keys.pose(message.object, message.instance), encode(message))
            else:
                session.put(keys.hypotheses, encode(message))

    with zenoh.open(listening(*places)) as session, repeating(publish, 1.0 / RATE_HZ):
        tokens = [session.liveliness().declare_token(keys.live(worker)) for worker in config.workers]
        yield
        del tokens


def columns_of(picture: UInt8, colour: tuple[int, int, int]) -> np.ndarray:
    """The column of each pixel in the view that has about this colour."""
    view = picture[VIEW].astype(int)
    return np.nonzero((np.abs(view - colour) < 24).all(-1))[1]


def shows_all(picture: UInt8) -> bool:
    colours = (STATE_COLOURS["TRACKING"], STATE_COLOURS["SUSPECT"], OTHER)
    return all(len(columns_of(picture, colour)) > 150 for colour in colours)


def test_a_browser_shows_frame_states_and_hypotheses(
    config: Config,
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    tmp_path: Path,
    base_port: int,
    huepose,
) -> None:
    frame = take_picture([(tea_box.mesh, SURE), (tea_box.mesh, DOUBTED)])
    view = ("view", "--config", tmp_path / "pipeline.yaml", "--web", base_port + 5, "--hypotheses")
    with published(config, frame):
        process = huepose(*view)
        address = re.search(r"http\S+", process.stderr.readline())
        assert address is not None
        # Software graphics have no WebGPU everywhere.
        with browser.opened(f"{address[0]}&renderer=webgl", tmp_path / "browser") as page:
            picture = page.picture_when(shows_all, 120.0)
    browser.save(picture, tmp_path / "page.png")
    assert picture[VIEW].std() > 30.0, "the view is blank"
    assert shows_all(picture), f"look at {tmp_path / 'page.png'}"
    middle = picture[VIEW].shape[1] / 2
    assert np.median(columns_of(picture, STATE_COLOURS["TRACKING"])) < middle
    assert np.median(columns_of(picture, STATE_COLOURS["SUSPECT"])) > middle
    assert np.median(columns_of(picture, OTHER)) > middle
