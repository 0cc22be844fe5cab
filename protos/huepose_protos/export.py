"""Writes what readers in other languages need: `python -m huepose_protos.export protos`.

`schemas/NAME.json`: the JSON Schema of each message; `golden/NAME.bin` and `.json`: an example as it is on
the wire and the same in JSON; `golden/frame_payload.bin`: the payload of the example frame.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import msgspec

from huepose_protos.buffers import pack
from huepose_protos.codec import encode, to_json
from huepose_protos.examples import images, messages


def files() -> dict[str, bytes]:
    """The content of every file by its path under the folder."""
    out: dict[str, bytes] = {}
    for message in messages():
        name = type(message).__name__
        schema = json.dumps(msgspec.json.schema(type(message)), indent=2)
        out[f"schemas/{name}.json"] = schema.encode() + b"\n"
        out[f"golden/{name}.bin"] = encode(message)
        out[f"golden/{name}.json"] = to_json(message).encode() + b"\n"
    out["golden/frame_payload.bin"] = pack(images())[1]
    return out


def main() -> None:
    """Write all files."""
    folder = Path(sys.argv[1])
    for name, data in files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


if __name__ == "__main__":
    main()
