"""Writes the files for subscribers in other languages: `python -m huepose_protos.export protos`.

`schemas/NAME.json`: the JSON Schema of each message; `huepose_protos/golden/NAME.bin`: the example of
`NAME.json` beside it, as sent. New fields of a message are added to that JSON.
"""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from typing import Any

import msgspec

from huepose_protos.codec import encode, to_json
from huepose_protos.examples import messages


def json_schema(kind: type) -> dict[str, Any]:
    """The JSON Schema of a message. Its regular expressions are those of ECMA 262, where `$` means what `\\Z`
    means in Python. Descriptions lose the indents of the docstrings, which msgspec before 0.23 keeps."""
    text = json.dumps(msgspec.json.schema(kind)).replace(r"\\Z", "$")
    return dict(json.loads(text, object_hook=_without_indents))


def _without_indents(schema: dict[str, Any]) -> dict[str, Any]:
    text = schema.get("description")
    return schema if not isinstance(text, str) else schema | {"description": inspect.cleandoc(text)}


def files() -> dict[str, bytes]:
    """The content of every file by its path under the folder."""
    out: dict[str, bytes] = {}
    for message in messages():
        name = type(message).__name__
        out[f"schemas/{name}.json"] = json.dumps(json_schema(type(message)), indent=2).encode() + b"\n"
        out[f"huepose_protos/golden/{name}.bin"] = encode(message)
        out[f"huepose_protos/golden/{name}.json"] = to_json(message).encode() + b"\n"
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
