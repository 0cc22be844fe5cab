"""Whatever a file or a message holds: it is read, or the project's own error says what is wrong; soon, and
without taking much memory.

A few seconds of the processor for each reader; `HUEPOSE_FUZZ_S=30` takes longer. What once broke a reader
lies in `found/`, in a folder by its reader, and is read first. What breaks one now is written there.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from huepose.datasets.bop import BopScene
from huepose.datasets.image_files import read_frame
from huepose.model.io import load_model, model_path
from huepose.onboarding.meshes import read_mesh
from huepose.support.errors import InputError
from huepose_protos import WireError, decode, encode
from huepose_protos.buffers import frame_images, pack
from huepose_protos.examples import example, images, messages
from huepose_protos.messages import FrameHeader, PoseMessage
from huepose_services.builtin import builtin_bundles
from huepose_services.camera.recording import RecordedScene
from huepose_services.recording.read import Recording
from huepose_services.runtime.config import load
from tests.onboarding import mesh_files as meshes
from tests.onboarding import solids
from tests.services.recording.conftest import KEY, parts, tiny_frame

SECONDS = float(os.environ.get("HUEPOSE_FUZZ_S", "2"))
SOON_S = 5.0
"""Of the processor, for one input: the largest that a reader may take are far from as slow."""
MEMORY = 2 * 2**30
"""More than the largest texture with what is made of it; less than a bomb wants."""
FOUND = Path(__file__).parent / "found"
ROOT = Path(__file__).parents[2]

TROUBLE = [
    *(
        b"-1",
        b"1e999",
        b"nan",
        b"99999999999999999999",
        b"\n",
        b" ",
        b"/",
        b"{",
        b"[",
        b'"',
        b"\xff",
        b"\0\0\0\0",
    ),
    *(b"&a ", b"*a", b"!!int ", b"\t", b": ", b"- ", b"../", b"\x7f\xff\xff\xff", b"\xdf\xff\xff\xff\xff"),
]
VALUES: list[Any] = [
    *(
        None,
        True,
        -1,
        0,
        2**63,
        10**400,
        1e308,
        float("inf"),
        float("nan"),
        "",
        "x",
        "\0",
        "../x",
        [],
        {},
        [[]],
    ),
    *([0] * 100, {"a": {"a": []}}, "9" * 400),
]


@dataclass(frozen=True)
class Reader:
    """good: what it reads well, by file name; read: with the folder that has the spoilt files; errors: those
    that it may raise; trees: files that are JSON, whose values are replaced as well."""

    name: str
    good: Callable[[Path], dict[str, bytes]]
    read: Callable[[Path], object]
    spoilt: tuple[str, ...]
    errors: tuple[type[Exception], ...] = (InputError,)
    trees: tuple[str, ...] = ()


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


PRINTED = solids.printed_box((0.08, 0.06, 0.04), seed=3)


def mesh(form: str, write: Callable[[Path], None], spoilt: tuple[str, ...], main: str) -> Reader:
    def good(folder: Path) -> dict[str, bytes]:
        write(folder / main)
        return files_of(folder)

    def read(folder: Path) -> None:
        assert np.isfinite(read_mesh(folder / main).vertices).all()

    return Reader(form, good, read, spoilt)


def _write_ply(path: Path, binary: bool, lists: bool) -> None:
    meshes.write_ply(path, PRINTED, binary=binary, lists=lists)


def _model(folder: Path) -> dict[str, bytes]:
    return {"box.huepose": model_path(builtin_bundles(0), "tea_box").read_bytes()}


def _pictures(folder: Path) -> dict[str, bytes]:
    rng = np.random.default_rng(1)
    meshes.write_png(folder / "000001.png", rng.integers(0, 256, (24, 32, 3)).astype(np.uint8))
    assert cv2.imwrite(str(folder / "depth.png"), rng.integers(400, 900, (24, 32)).astype(np.uint16))
    camera = {
        "fx": 30.0,
        "fy": 30.0,
        "cx": 15.5,
        "cy": 11.5,
        "width": 32,
        "height": 24,
        "depth_scale_m": 0.001,
    }
    camera |= {"distortion_model": "brown_conrady", "distortion": [0.01, 0.0, 0.0, 0.0, 0.0]}
    (folder / "camera.json").write_text(json.dumps(camera))
    return files_of(folder)


def _bop(folder: Path) -> dict[str, bytes]:
    for name in ("rgb", "depth", "mask_visib"):
        (folder / name).mkdir(exist_ok=True)
    rng = np.random.default_rng(2)
    meshes.write_png(folder / "rgb" / "000003.png", rng.integers(0, 256, (24, 32, 3)).astype(np.uint8))
    for place in ("depth/000003.png", "mask_visib/000003_000000.png"):
        assert cv2.imwrite(str(folder / place), rng.integers(400, 900, (24, 32)).astype(np.uint16))
    K = [30.0, 0.0, 15.5, 0.0, 30.0, 11.5, 0.0, 0.0, 1.0]
    trees = {
        "scene_camera.json": {"3": {"cam_K": K, "depth_scale": 1.0, "timestamp_ns": 5}},
        "scene_gt.json": {
            "3": [{"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 500.0], "obj_id": 5}]
        },
        "scene_gt_info.json": {"3": [{"visib_fract": 0.9, "bbox_visib": [1, 2, 3, 4]}]},
    }
    for name, tree in trees.items():
        (folder / name).write_text(json.dumps(tree))
    return files_of(folder)


def _read_bop(folder: Path) -> None:
    scene = BopScene(folder)
    for image in scene.image_ids:
        scene.stamp_ns(image)
        scene.frame(image)
        for truth in scene.truths(image):
            truth.mask()


def _configuration(folder: Path) -> dict[str, bytes]:
    shown = (ROOT / "pipeline.yaml").read_bytes()
    return {"pipeline.yaml": b"\n".join(line.split(b" #")[0].rstrip() for line in shown.splitlines() if line)}


def _read_messages(folder: Path) -> None:
    for kind, path in ((type(m), folder / type(m).__name__) for m in messages()):
        with suppress(WireError):
            message = decode(path.read_bytes(), kind)
            assert decode(encode(message), kind) == message
            if isinstance(message, FrameHeader):
                frame_images(message, (folder / "payload").read_bytes())


def _messages(folder: Path) -> dict[str, bytes]:
    specs, payload = pack(images())
    examples = {type(m).__name__: m for m in messages()}
    examples["FrameHeader"] = msgspec.structs.replace(examples["FrameHeader"], buffers=specs)
    return {name: encode(m) for name, m in examples.items()} | {"payload": payload}


def _recording(folder: Path) -> dict[str, bytes]:
    out = parts(folder / "r.mcap")
    for number in (3, 4):
        out.frame(*tiny_frame(number), KEY + "frame")
        out.message(KEY + "pose/x/1", example(PoseMessage))
    out.close()
    return files_of(folder)


def _read_recording(folder: Path) -> None:
    list(Recording(folder / "r.mcap").events())
    scene = RecordedScene(folder / "r.mcap")
    scene.frame(scene.image_ids[0])


_NAMES = tuple(type(m).__name__ for m in messages())
READERS = (
    Reader("messages", _messages, _read_messages, (*_NAMES, "payload"), (WireError,), _NAMES),
    Reader(
        "configuration", _configuration, lambda folder: load(folder / "pipeline.yaml"), ("pipeline.yaml",)
    ),
    mesh("obj", lambda path: meshes.write_obj(path, PRINTED), ("m.obj", "m.mtl", "m.png"), "m.obj"),
    mesh("ply ascii", partial(_write_ply, binary=False, lists=True), ("m.ply",), "m.ply"),
    mesh("ply binary", partial(_write_ply, binary=True, lists=False), ("m.ply",), "m.ply"),
    mesh("glb", lambda path: meshes.write_glb(path, PRINTED), ("m.glb",), "m.glb"),
    Reader(
        "pictures",
        _pictures,
        lambda f: read_frame(f / "000001.png", f / "depth.png", f / "camera.json"),
        ("000001.png", "depth.png", "camera.json"),
        trees=("camera.json",),
    ),
    Reader("recording", _recording, _read_recording, ("r.mcap",)),
    Reader("model", _model, lambda folder: load_model(folder / "box.huepose"), ("box.huepose",)),
    Reader(
        "bop",
        _bop,
        _read_bop,
        ("scene_camera.json", "scene_gt.json", "scene_gt_info.json", "rgb/000003.png", "depth/000003.png"),
        trees=("scene_camera.json", "scene_gt.json", "scene_gt_info.json"),
    ),
)


def spoilt_bytes(data: bytes, draw: st.DataObject) -> bytes:
    """Cut, filled, or with trouble in some places."""
    out = bytearray(data)
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(0, len(out)))
        end = at + draw.draw(st.sampled_from([0, 1, 4, 40, len(out)]))
        out[at:end] = draw.draw(st.one_of(st.sampled_from(TROUBLE), st.binary(max_size=8)))
    return bytes(out)


def spoilt_tree(tree: Any, draw: st.DataObject) -> Any:
    """With another value at one place."""
    inner = (
        list(tree.items())
        if isinstance(tree, dict)
        else list(enumerate(tree))
        if isinstance(tree, list)
        else []
    )
    if not inner or draw.draw(st.integers(0, 4)) == 0:
        return draw.draw(st.sampled_from(VALUES))
    key, value = draw.draw(st.sampled_from(inner))
    if isinstance(tree, dict):
        return {**tree, key: spoilt_tree(value, draw)}
    return [*tree[:key], spoilt_tree(value, draw), *tree[key + 1 :]]


def spoilt_file(reader: Reader, name: str, data: bytes, draw: st.DataObject) -> bytes:
    if name not in reader.trees or draw.draw(st.booleans()):
        return spoilt_bytes(data, draw)
    if reader.name == "messages":
        tree = spoilt_tree(msgspec.msgpack.decode(data), draw)
        with suppress(OverflowError, TypeError):  # what MessagePack cannot hold either
            return msgspec.msgpack.encode(tree)
        return data
    return json.dumps(spoilt_tree(json.loads(data), draw)).encode()


@contextmanager
def little_memory() -> Iterator[None]:
    """No more than MEMORY beyond what there is."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def check(reader: Reader, folder: Path) -> None:
    """Reads what is there: in time, with nothing but the reader's own errors."""
    started = time.process_time()
    with suppress(*reader.errors):
        reader.read(folder)
    assert time.process_time() - started < SOON_S


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "x").mkdir()
    return tmp_path / "x"


# Numbers that are too large are refused where they are used; numpy warns of them on the way.
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.timeout(400 + 10 * SECONDS)
@pytest.mark.parametrize("reader", READERS, ids=lambda one: one.name)
def test_whatever_is_spoilt_is_read_or_refused_in_words(reader: Reader, folder: Path) -> None:
    good = reader.good(folder)
    for name, data in good.items():
        (folder / name).write_bytes(data)
    reader.read(folder)  # what is good is read
    tried = 0

    @settings(deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(draw=st.data())
    def spoil(draw: st.DataObject) -> None:
        nonlocal tried
        name = draw.draw(st.sampled_from(reader.spoilt))
        spoilt = spoilt_file(reader, name, good[name], draw)
        tried += 1
        (folder / name).write_bytes(spoilt)
        try:
            check(reader, folder)
        except BaseException:
            keep(reader, name, spoilt)
            raise
        finally:
            (folder / name).write_bytes(good[name])

    rng = random.Random(os.environ.get("HUEPOSE_FUZZ_SEED", "0"))
    until = time.process_time() + SECONDS
    with little_memory():
        while time.process_time() < until:
            spoil.hypothesis.fuzz_one_input(rng.randbytes(rng.choice((64, 256, 1024))))
    assert tried > 3


def keep(reader: Reader, name: str, data: bytes) -> None:
    """For the tests of tomorrow."""
    place = FOUND / reader.name.replace(" ", "-")
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{hashlib.sha256(data).hexdigest()[:8]}-{Path(name).name}").write_bytes(data)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("path", sorted(p for p in FOUND.rglob("*") if p.is_file()), ids=lambda p: p.name)
def test_what_once_broke_a_reader_is_refused(path: Path, folder: Path) -> None:
    reader = next(r for r in READERS if r.name.replace(" ", "-") == path.parent.name)
    good = reader.good(folder)
    for name, data in good.items():
        (folder / name).write_bytes(data)
    name = next(n for n in reader.spoilt if Path(n).name == path.name.split("-", 1)[1])
    (folder / name).write_bytes(path.read_bytes())
    with little_memory():
        check(reader, folder)
