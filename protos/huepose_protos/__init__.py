"""The wire contract of HuePose: key expressions, message types, codec, pixel buffers.

Knows nothing of vision. `protos/README.md` describes all of it for readers in other languages.
"""

from huepose_protos.codec import decode, encode, to_json
from huepose_protos.errors import WireError
from huepose_protos.fields import VERSION

__all__ = ["VERSION", "WireError", "decode", "encode", "to_json"]
