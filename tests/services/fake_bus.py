"""A bus without a session, for the steps of one worker."""

from collections import defaultdict
from types import SimpleNamespace

import msgspec

from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader, ObjectEntry, ObjectsMessage
from huepose_services.camera.publish import packed
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health


def sent(frame, depth_scale_m=1e-4, **fields):
    """Header and payload of a frame, as a camera sends them."""
    picture = packed(frame, depth_scale_m)
    said = {"intrinsics": picture.intrinsics, "buffers": picture.buffers, **fields}
    return msgspec.structs.replace(example(FrameHeader), **said), picture.payload


def listed(*names):
    """The list of objects with these names."""
    return ObjectsMessage(
        publish_ns=1, objects=[ObjectEntry(object=n, max_instances=1, searching=1) for n in names]
    )


def _nothing(*_, **__):
    return None


class FakeBus:
    """Gives the messages in `arriving`, by their kind, and the workers in `begun`; keeps the published
    messages, the log and the health messages."""

    frames = staticmethod(_nothing)

    def __init__(self, worker, keys=None):
        self.keys, self.health = keys or Config().keys, Health(worker)
        self.arriving, self.said, self.healths, self.logged = defaultdict(list), [], [], defaultdict(list)
        self.inbox = SimpleNamespace(queue=_nothing, ring=_nothing, liveliness=_nothing, serve=_nothing)
        self.begun, self.forgotten = [], []
        self.session = SimpleNamespace(declare_queryable=_nothing)
        self.log = SimpleNamespace(
            say=_nothing, seldom=lambda kind, text, **_: self.logged[kind].append(text)
        )

    def take(self, place, kind):
        return self.arriving[kind].pop(0) if self.arriving[kind] else None

    take_with_payload = take

    def take_begun(self, tokens):
        return self.begun.pop(0) if self.begun else None

    def put(self, key, message, payload=b""):
        self.said.append(message)

    put_control = put_pixels = put

    def forget(self, under):
        self.forgotten.append(under)

    def say_health(self):
        self.healths.append(self.health.message())

    @property
    def headers(self):
        """The headers of the published frames."""
        return [message for message in self.said if isinstance(message, FrameHeader)]
