"""The wire contract of HuePose: key expressions, message types, codec, pixel buffers, and a client for poses.

Knows nothing of vision. `protos/README.md` describes all of it for readers in other languages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from huepose_protos.codec import decode, encode, to_json
from huepose_protos.fields import VERSION, WireError

if TYPE_CHECKING:
    from huepose_protos.pose_client import PoseClient

__all__ = ["VERSION", "PoseClient", "WireError", "decode", "encode", "to_json"]


def __getattr__(name: str) -> Any:
    # Imported on use: it imports zenoh, which a program that only encodes and decodes does not need.
    if name == "PoseClient":
        from huepose_protos.pose_client import PoseClient

        return PoseClient
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
