"""Networks that are known by name, and those that the user has added: their files and digests.

They are in one folder as NAME.onnx: fetched, added, or copied there by hand. An interrupted download goes
on where it stopped. The digests of known networks are those that other users of the same file publish. A
network without a digest is not fetched, because a damaged or wrong file could not be detected: the user
downloads and adds it.
"""

from __future__ import annotations

import http.client
import json
import os
import shutil
import sys
import urllib.error
import urllib.request
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from huepose.perception.sessions import NetworkSettings, check_file, digest, open_network
from huepose.support.errors import InputError
from huepose.support.files import home_folder, whole, write_text, writing
from huepose.support.progress import Status
from huepose_protos.fields import is_name

_NOTES, _FOLDER = "networks.json", "HUEPOSE_NETWORKS"
_BLOCK = 1 << 16
_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class KnownNetwork:
    """A network. role: what it is for; url: where `fetch` downloads it; size_bytes and sha256: None if
    nobody publishes them; half: whether it may run in half precision."""

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
    """A network of the list; `path` is its file, which may not exist."""

    network: KnownNetwork
    path: Path

    @property
    def here(self) -> bool:
        """Whether the file exists; its digest is checked when it is opened."""
        return self.path.is_file()


def folder() -> Path:
    """`$HUEPOSE_NETWORKS`, else `huepose/networks` in `$XDG_DATA_HOME` or `~/.local/share`. Raises
    InputError if there is no home folder either."""
    if own := os.environ.get(_FOLDER):
        return Path(own)
    base = os.environ.get("XDG_DATA_HOME")
    share = Path(base) if base else home_folder(_FOLDER) / ".local" / "share"
    return share / "huepose" / "networks"


def entries() -> list[Entry]:
    """All networks that are known or were added, and other files in the folder."""
    place, known = folder(), {network.name: network for network in KNOWN}
    noted = known | _added(place)
    more = (path.stem for path in sorted(place.glob("*.onnx")) if path.stem not in known)
    return [Entry(noted.get(name, _unknown(name)), place / f"{name}.onnx") for name in (*known, *more)]


def entry_of(name: str) -> Entry:
    """The network of a name. Raises InputError, with a list of the names, if there is none."""
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


def add(file: Path, name: str) -> Entry:
    """Copy a network into the folder, after it was opened and, for a known name, its digest was
    compared."""
    if not is_name(name):
        raise InputError(f"name '{name}'", expected="1 to 64 of a-z, 0-9, _ and -", fix="Give one by --name.")
    known = next((k for k in KNOWN if k.name == name), None)
    check_file(file, known.sha256 if known else None)
    open_network(file, NetworkSettings(providers=("cpu",)))
    place = folder()
    path = place / f"{name}.onnx"
    with _writing(place):
        place.mkdir(parents=True, exist_ok=True)
        if file.resolve() != path.resolve():
            with whole(path) as part:
                shutil.copyfile(file, part)
                _check_it_is_whole(file, part)
    network = replace(known or _unknown(name), size_bytes=path.stat().st_size, sha256=digest(path))
    notes = {n: asdict(k) for n, k in _added(place).items()} | {name: asdict(network)}
    write_text(place / _NOTES, json.dumps(notes, indent=1))
    return Entry(network, path)


def _check_it_is_whole(file: Path, copied: Path) -> None:
    """Raises InputError if the copy of a network cannot be opened, because its weights are in other files
    beside it."""
    try:
        open_network(copied, NetworkSettings(providers=("cpu",)))
    except InputError:
        raise InputError(
            file,
            found="a network whose weights are in another file beside it",
            expected="one file with everything, so that its digest is that of the weights, too",
            fix="Export it again with them inside: torch.onnx.export(..., external_data=False).",
        ) from None


def _writing(place: Path) -> AbstractContextManager[None]:
    """Turns a failure to write the folder into an InputError that says how to choose another folder."""
    return writing(place, "a folder that can be written", f"Set {_FOLDER} to one.")


def _unknown(name: str) -> KnownNetwork:
    return KnownNetwork(name, "yours", "not stated", "not stated")


def _added(place: Path) -> dict[str, KnownNetwork]:
    """The notes about added networks. Raises InputError for a file of notes that cannot be read."""
    path = place / _NOTES
    if not path.is_file():
        return {}
    try:
        return {name: KnownNetwork(**facts) for name, facts in json.loads(path.read_text()).items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(
            path, found=str(error)[:120], expected="notes that `huepose models add` wrote", fix="Delete it."
        ) from None


def fetch(entry: Entry, url: str | None = None) -> Path:
    """The file of a network, downloaded unless it exists already. `url` replaces the known one.

    Raises InputError if it cannot be downloaded, or has another digest: then it is deleted."""
    network, path = entry.network, entry.path
    if network.sha256 is None:
        raise InputError(
            f"network '{network.name}'",
            found="no digest, so a wrong file could not be detected",
            expected=f"a file of {network.source}",
            fix=f"Download or export it yourself, then: huepose models add FILE --name {network.name}",
        )
    if path.is_file():
        if digest(path) == network.sha256:
            return path
        raise InputError(
            path,
            found="another file of that name",
            expected=f"SHA-256 {network.sha256}",
            fix="Remove it, then fetch it again.",
        )
    url = url or network.url
    if url is None:
        raise InputError(
            f"network '{network.name}'",
            found="no address",
            fix="Give one: huepose models fetch NAME --from URL",
        )
    part = path.with_suffix(".part")
    with _writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        _download(url, part, network.size_bytes)
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise InputError(
            url,
            found=" ".join(str(error).split()) or type(error).__name__,
            expected=f"the network {network.name}",
            fix=f"Try again: the downloaded part is kept. Without internet, copy the file to {path}.",
        ) from None
    if (found := digest(part)) != network.sha256:
        part.unlink()
        raise InputError(
            url,
            found=f"SHA-256 {found}",
            expected=network.sha256,
            fix="It was damaged on the way, or replaced at the source; the download was deleted.",
        )
    part.replace(path)
    return path


def _download(url: str, part: Path, size_bytes: int | None) -> None:
    """Download the rest of a file, after what `part` has already."""
    have = part.stat().st_size if part.is_file() else 0
    if size_bytes is not None and have >= size_bytes:
        return
    # Any scheme is allowed: the file is used only with the right digest.
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})  # noqa: S310  # see above
    try:
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)  # noqa: S310  # see above
    except urllib.error.HTTPError as error:
        if error.code == 416 and have:  # nothing is left to send
            return
        raise
    with answer:
        # A server that does not support ranges sends the whole file.
        goes_on = have > 0 and answer.status == 206
        done = have if goes_on else 0
        total = size_bytes or done + int(answer.headers.get("Content-Length") or 0)
        name, status = part.stem, Status(sys.stderr)
        status.line(f"{name}: downloading {total / 1e6:.1f} MB" if total else f"{name}: downloading")
        with part.open("ab" if goes_on else "wb") as file:
            while block := answer.read(_BLOCK):
                file.write(block)
                done += len(block)
                share = f" of {total / 1e6:.1f} MB, {100 * done / total:.0f} %" if total else " MB"
                status.show(f"{name}: {done / 1e6:.1f}{share}")
    if total and done < total:
        raise OSError(f"the download stopped after {done} of {total} bytes")
    status.line(f"{name}: {done / 1e6:.1f} MB downloaded")
