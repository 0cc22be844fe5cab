"""The programs in `examples`, and the pipeline that they read, played on a bus."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import zenoh

from huepose_protos import encode, examples
from huepose_protos.keys import Keys
from huepose_protos.messages import CameraMessage, Mount, ObjectEntry, ObjectsMessage, PoseMessage
from tests.services.repeating import repeating
from tests.services.sessions import listening

ROOT = Path(__file__).parents[2]
EXAMPLE = examples.example(PoseMessage)
CAMERA_MESSAGE = examples.example(CameraMessage)
MOUNT = Mount(parent="base_link", translation=(0.1, 0.2, 0.3), quaternion=(0.0, 0.0, 0.0, 1.0))


def example(name: str, *arguments: str | Path) -> list[str]:
    return [sys.executable, str(ROOT / "examples" / name), *map(str, arguments)]


@contextmanager
def published(
    endpoint: str,
    pose: Callable[[int], PoseMessage],
    camera_after: int | None = None,
    late_ns: Callable[[int], int] | None = None,
) -> Iterator[None]:
    """Publishes a pipeline's poses, thirty a second, at an endpoint, and after some of them the camera's
    mount. pose: gives the message of a number; late_ns: gives the age of a moving camera's mount at a
    number."""

    def publish(number: int) -> None:
        now = time.monotonic_ns()
        changes = {"frame_id": number, "capture_ns": now, "publish_ns": now}
        offset = time.time_ns() - now
        message = msgspec.structs.replace(pose(number), **changes, realtime_offset_ns=offset)
        keys = Keys("lab", "cam0")
        session.put(keys.pose(message.object, message.instance), encode(message))
        if camera_after is not None and number > camera_after:
            mount_ns = None if late_ns is None else now - late_ns(number)
            said = msgspec.structs.replace(
                CAMERA_MESSAGE, frame=message.frame, mount=MOUNT, mount_ns=mount_ns, publish_ns=now
            )
            session.put(keys.camera_info, encode(said))

    with zenoh.open(listening(endpoint)) as session, repeating(publish, 1 / 30):
        yield


def tracked(**changes: object) -> PoseMessage:
    return msgspec.structs.replace(EXAMPLE, **{"object": "tea_box", "state": "TRACKING", **changes})


@contextmanager
def listed(endpoint: str, outside: bool) -> Iterator[None]:
    """Publishes the list of objects and the camera of a pipeline, as outside or as inside."""
    keys = Keys("lab", "cam0")
    key = keys.outside(keys.objects) if outside else keys.objects
    said = ObjectsMessage(
        publish_ns=1,
        objects=[ObjectEntry(object=name, max_instances=1, searching=1) for name in ("tea_box", "carton")],
    )
    with zenoh.open(listening(endpoint)) as session:
        session.declare_queryable(key, lambda query: query.reply(key, encode(said)))

        def publish_camera(_: int) -> None:
            session.put(keys.camera_info, encode(CAMERA_MESSAGE))

        with repeating(publish_camera, 0.1):
            yield
