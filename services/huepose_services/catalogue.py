"""Networks that are known by name, and those that the user has added: where they are, that they are right.

They lie in one folder as NAME.onnx: fetched, added, or put there by hand. Digests of known networks are those
that users of the same file state; a network without one is not fetched, because nothing would tell a damaged
or another file: it is downloaded by hand and added.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from huepose.perception.sessions import NetworkSettings, check_file, digest, open_network
from huepose.support.errors import InputError
from huepose.support.files import whole, write_text
from huepose_protos.fields import is_name

_NOTES = "networks.json"


@dataclass(frozen=True)
class KnownNetwork:
    """A network: what it is for, whose it is, and how to know it. url: where `fetch` takes it from;
    size_bytes and sha256 are None where nobody states them; half: it may run in half precision."""

    name: str
    role: str
    licence: str
    source: str
    url: str | None = None
    size_bytes: int | None = None
    sha256: str | None = None
    half: bool = True


_YOLOX = "https://github.com/Megvii-BaseDetection/YOLOX"
_NANOSAM = "https://github.com/NVIDIA-AI-IOT/nanosam"
KNOWN = (
    KnownNetwork(
        "yolox-nano",
        "detector, the 80 classes of COCO, 416 x 416",
        "Apache-2.0",
        _YOLOX,
        f"{_YOLOX}/releases/download/0.1.1rc0/yolox_nano.onnx",
        3_659_407,
        "c789161ed43c8269fcd4e67c67eeeb4e80c622da2eb296a20bc6007bd18a0b7d",
    ),
    KnownNetwork(
        "nanosam-encoder",
        "encoder of the segmenter sam (ResNet-18)",
        "Apache-2.0",
        _NANOSAM,
        "https://raw.githubusercontent.com/johnnynunez/nanosam/main/data/resnet18_image_encoder.onnx",
        None,
        "d266fcdc9e4f0182b59946cd3cf1be331641f1d0d1de2415c4fd94e7a1c9cf0a",
    ),
    KnownNetwork(
        "nanosam-decoder",
        "decoder of the segmenter sam, for both encoders",
        "Apache-2.0",
        f"{_NANOSAM}#4-export-the-mask-decoder (nanosam.tools.export_sam_mask_decoder_onnx)",
        half=False,
    ),
    KnownNetwork(
        "mobilesam-encoder",
        "encoder of the segmenter sam (TinyViT)",
        "Apache-2.0",
        "https://github.com/ChaoningZhang/MobileSAM (export the image encoder to ONNX)",
        half=False,
    ),
    KnownNetwork(
        "neuflow-v2",
        "optical flow",
        "Apache-2.0",
        "https://github.com/ibaiGorordo/ONNX-NeuFlowV2-Optical-Flow/releases/tag/0.1.0 (neuflow_mixed.onnx)",
    ),
)


@dataclass(frozen=True)
class Entry:
    """A network of the list; `path` is where it lies or would lie."""

    network: KnownNetwork
    path: Path
    known: bool

    @property
    def here(self) -> bool:
        """Whether there is a file; that it is right is checked when it is opened."""
        return self.path.is_file()


def folder() -> Path:
    """`$HUEPOSE_NETWORKS`, else `huepose/networks` in `$XDG_DATA_HOME` or `~/.local/share`."""
    if own := os.environ.get("HUEPOSE_NETWORKS"):
        return Path(own)
    base = os.environ.get("XDG_DATA_HOME")
    return (Path(base) if base else Path.home() / ".local" / "share") / "huepose" / "networks"


def entries() -> list[Entry]:
    """All that are known or were added, and files that lie in the folder besides."""
    place = folder()
    added = _added(place)
    found = [Entry(added.get(k.name, k), place / f"{k.name}.onnx", True) for k in KNOWN]
    names = {entry.network.name for entry in found}
    more = (path for path in sorted(place.glob("*.onnx")) if path.stem not in names)
    return [*found, *(Entry(added.get(p.stem, _unknown(p.stem)), p, False) for p in more)]


def entry_of(name: str) -> Entry:
    """The network of a name. Raises InputError that lists the names."""
    every = entries()
    for entry in every:
        if entry.network.name == name:
            return entry
    raise InputError(
        f"network '{name}'",
        found="no such name",
        expected=f"one of {', '.join(e.network.name for e in every)}, or the path of an ONNX file",
        fix="`huepose models add FILE --name NAME` adds one of yours.",
    )


def add(file: Path, name: str, *, licence: str = "", source: str = "") -> Entry:
    """Copy a network into the folder, once it opens and has the digest that a known one must have."""
    if not is_name(name):
        raise InputError(f"name '{name}'", expected="1 to 64 of a-z, 0-9, _ and -", fix="Give one by --name.")
    known = next((k for k in KNOWN if k.name == name), None)
    check_file(file, known.sha256 if known else None)
    open_network(file, NetworkSettings(providers=("cpu",)))
    place = folder()
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{name}.onnx"
    if file.resolve() != path.resolve():
        with whole(path) as part:
            shutil.copyfile(file, part)
    network = known or _unknown(name)
    network = replace(
        network,
        licence=licence or network.licence,
        source=source or network.source,
        size_bytes=path.stat().st_size,
        sha256=digest(path),
    )
    notes = {n: asdict(k) for n, k in _added(place).items()} | {name: asdict(network)}
    write_text(place / _NOTES, json.dumps(notes, indent=1))
    return Entry(network, path, known is not None)


def _unknown(name: str) -> KnownNetwork:
    return KnownNetwork(name, "yours", "not stated", "not stated")


def _added(place: Path) -> dict[str, KnownNetwork]:
    """What was noted when networks were added. A file of notes that cannot be read is an InputError."""
    path = place / _NOTES
    if not path.is_file():
        return {}
    try:
        return {name: KnownNetwork(**facts) for name, facts in json.loads(path.read_text()).items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(
            path, found=str(error)[:120], expected="notes that `huepose models add` wrote", fix="Delete it."
        ) from None
