"""Topics of ROS 2 on zenoh: keys, liveliness tokens and attachments of rmw_zenoh, or keys of
zenoh-bridge-ros2dds.

rmw_zenoh (ROS 2 Jazzy and later; its docs/design.md and liveliness_utils.cpp): a topic is the key
DOMAIN/TOPIC/TYPE/HASH, every message has an attachment (number, time, identifier of the publisher), and a
node and each of its publishers have a liveliness token, by which `ros2 topic list` knows them. For the
bridge, a topic is the key TOPIC, without an attachment.
"""

from __future__ import annotations

import hashlib
import struct
import time
from typing import Literal

import zenoh

from huepose_services.ros2.messages import type_hash
from huepose_services.runtime.inbox import Inbox, Place

Style = Literal["rmw_zenoh", "bridge"]

DEPTH = 10
"""Messages that a publisher keeps; the default of ROS 2."""
_QOS = f"::,{DEPTH}:,:,:,,"
"""Reliable, volatile, keep last: the defaults of rmw_zenoh, except for the depth."""
_KEPT_QOS = f":1:,{DEPTH}:,:,:,,"
"""The same, but transient local: a late subscriber gets the last messages."""
_NODE_ID = 0


def topic_key(topic: str, type_name: str, domain: int, style: Style) -> str:
    """The key of a topic, `/huepose/tea_box_0/pose` for example."""
    name = topic.strip("/")
    if style == "bridge":
        return name
    return f"{domain}/{name}/{dds_type(type_name)}/{type_hash(type_name)}"


def heard_key(topic: str, type_name: str, domain: int, style: Style) -> str:
    """The key to subscribe to a topic, whichever release of ROS 2 computed the hash of its type."""
    key = topic_key(topic, type_name, domain, style)
    return key if style == "bridge" else f"{key.rpartition('/')[0]}/*"


def dds_type(type_name: str) -> str:
    """The DDS name of a type such as `geometry_msgs/msg/PoseStamped`."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def node_token(domain: int, session: str, node: str) -> str:
    """The liveliness token of a node without a namespace of its own."""
    return f"@ros2_lv/{domain}/{session}/{_NODE_ID}/{_NODE_ID}/NN/%/%/{node}"


def endpoint_token(
    kind: Literal["MP", "MS"],
    domain: int,
    session: str,
    node: str,
    number: int,
    topic: str,
    type_name: str,
    kept: bool = False,
) -> str:
    """The liveliness token of a publisher (MP) or a subscriber (MS) of a node. number: from 1 on, different
    for each; kept: the publishers of the topic keep their last messages (transient local)."""
    mangled, qos = topic.replace("/", "%"), _KEPT_QOS if kept else _QOS
    where = f"@ros2_lv/{domain}/{session}/{_NODE_ID}/{number}/{kind}/%/%/{node}"
    return f"{where}/{mangled}/{dds_type(type_name)}/{type_hash(type_name)}/{qos}"


def attachment(number: int, unix_ns: int, token: str) -> bytes:
    """The attachment of rmw_zenoh: the message's number, its send time, and 16 bytes that identify the
    publisher."""
    gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
    return struct.pack("<qqB16s", number, unix_ns, len(gid), gid)


class Node:
    """A node of ROS 2. A publisher is made with its first message. Not thread-safe."""

    def __init__(self, session: zenoh.Session, name: str, domain: int, style: Style) -> None:
        self._session, self._name, self._domain, self._style = session, name, domain, style
        self._zid = str(session.info.zid())
        self._topics: dict[str, tuple[zenoh.Publisher, str]] = {}
        self._tokens: list[zenoh.LivelinessToken] = []
        self._sent: dict[str, int] = {}
        self._entities = 0
        if style == "rmw_zenoh":
            self._announce(node_token(domain, self._zid, name))

    @property
    def connected(self) -> bool:
        """Whether the router is connected now."""
        return bool(self._session.info.routers_zid())

    def _announce(self, token: str) -> None:
        self._tokens.append(self._session.liveliness().declare_token(token))

    def _token(self, kind: Literal["MP", "MS"], topic: str, type_name: str, kept: bool = False) -> str:
        self._entities += 1
        return endpoint_token(
            kind, self._domain, self._zid, self._name, self._entities, topic, type_name, kept
        )

    def listen(self, inbox: Inbox, topic: str, type_name: str, kept: bool) -> Place:
        """Subscribe to what others publish on a topic; kept: get also the last messages that they keep."""
        key = heard_key(topic, type_name, self._domain, self._style)
        if self._style == "rmw_zenoh":
            self._announce(self._token("MS", topic, type_name, kept))
        return (
            inbox.history(key, self._session) if kept else inbox.queue(key, session=self._session, own=False)
        )

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """Publish a message in CDR on a topic, `/tf` for example."""
        if topic not in self._topics:
            token = self._token("MP", topic, type_name)
            key = topic_key(topic, type_name, self._domain, self._style)
            # A reader that does not read loses messages; nobody waits for it.
            publisher = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
            self._topics[topic] = (publisher, token)
            if self._style == "rmw_zenoh":
                self._announce(token)
        publisher, token = self._topics[topic]
        if self._style == "bridge":
            publisher.put(payload)
            return
        self._sent[topic] = self._sent.get(topic, 0) + 1
        publisher.put(payload, attachment=attachment(self._sent[topic], time.time_ns(), token))
