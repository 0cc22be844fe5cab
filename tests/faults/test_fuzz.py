"""Corrupted files and messages are read, or refused with the project's own error; soon, and without much
memory.

Each reader gets a few seconds of processor time; `HUEPOSE_FUZZ_S=30` sets more. An input that breaks a
reader is written to `found/`, into a folder of that reader, and is tested again from then on.
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
from huepose_services.runtime.config_file import load
from tests.onboarding import mesh_files as meshes
from tests.onboarding import solids
from tests.services.recording.conftest import KEY, parts, tiny_frame

SECONDS = float(os.environ.get("HUEPOSE_FUZZ_S", "2"))
SOON_S = 5.0
"""Processor time for one input: the largest allowed input takes far less."""
MEMORY = 2 * 2**30
"""More than the largest texture needs with all that is computed from it; less than a decompression bomb."""
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
    """good: makes valid files and gives their bytes by name; read: reads the folder with a corrupted file;
    corrupted: the files to corrupt; errors: those that it may raise; trees: files of JSON or MessagePack,
    whose values are replaced as well."""

    name: str
    good: Callable[[Path], dict[str, bytes]]
    read: Callable[[Path], object]
    corrupted: tuple[str, ...]
    errors: tuple[type[Exception], ...] = (InputError,)
    trees: tuple[str, ...] = ()


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


PRINTED = solids.printed_box((0.08, 0.06, 0.04), seed=3)


def mesh(form: str, write: Callable[[Path], None], corrupted: tuple[str, ...], main: str) -> Reader:
    def good(folder: Path) -> dict[str, bytes]:
        write(folder / main)
        return files_of(folder)

    def read(folder: Path) -> None:
        assert np.isfinite(read_mesh(folder / main).vertices).all()

    return Reader(form, good, read, corrupted)


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


def corrupted_bytes(data: bytes, draw: st.DataObject) -> bytes:
    """The data, cut or with difficult bytes in some places."""
    out = bytearray(data)
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(0, len(out)))
        end = at + draw.draw(st.sampled_from([0, 1, 4, 40, len(out)]))
        out[at:end] = draw.draw(st.one_of(st.sampled_from(TROUBLE), st.binary(max_size=8)))
    return bytes(out)


def corrupted_tree(tree: Any, draw: st.DataObject) -> Any:
    """The tree with one value replaced."""
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
        return {**tree, key: corrupted_tree(value, draw)}
    return [*tree[:key], corrupted_tree(value, draw), *tree[key + 1 :]]


def corrupted_file(reader: Reader, name: str, data: bytes, draw: st.DataObject) -> bytes:
    if name not in reader.trees or draw.draw(st.booleans()):
        return corrupted_bytes(data, draw)
    if reader.name == "messages":
        tree = corrupted_tree(msgspec.msgpack.decode(data), draw)
        with suppress(OverflowError, TypeError):  # values that MessagePack cannot hold
            return msgspec.msgpack.encode(tree)
        return data
    return json.dumps(corrupted_tree(json.loads(data), draw)).encode()


@contextmanager
def limited_memory() -> Iterator[None]:
    """Limits the memory to MEMORY more than is taken now."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def check(reader: Reader, folder: Path) -> None:
    """Reads the folder: in time, and with no errors but the reader's own."""
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
def test_corrupted_input_is_read_or_refused_with_a_reason(reader: Reader, folder: Path) -> None:
    good = reader.good(folder)
    for name, data in good.items():
        (folder / name).write_bytes(data)
    reader.read(folder)  # the valid files are read
    tried = 0

    @settings(deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(draw=st.data())
    def corrupt(draw: st.DataObject) -> None:
        nonlocal tried
        name = draw.draw(st.sampled_from(reader.corrupted))
        corrupted = corrupted_file(reader, name, good[name], draw)
        tried += 1
        (folder / name).write_bytes(corrupted)
        try:
            check(reader, folder)
        except BaseException:
            keep(reader, name, corrupted)
            raise
        finally:
            (folder / name).write_bytes(good[name])

    rng = random.Random(os.environ.get("HUEPOSE_FUZZ_SEED", "0"))
    until = time.process_time() + SECONDS
    with limited_memory():
        while time.process_time() < until:
            corrupt.hypothesis.fuzz_one_input(rng.randbytes(rng.choice((64, 256, 1024))))
    assert tried > 3


def keep(reader: Reader, name: str, data: bytes) -> None:
    """Writes the input to `found/`."""
    place = FOUND / reader.name.replace(" ", "-")
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{hashlib.sha256(data).hexdigest()[:8]}-{Path(name).name}").write_bytes(data)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("path", sorted(p for p in FOUND.rglob("*") if p.is_file()), ids=lambda p: p.name)
def test_an_input_that_once_broke_a_reader_is_read_or_refused(path: Path, folder: Path) -> None:
    reader = next(r for r in READERS if r.name.replace(" ", "-") == path.parent.name)
    good = reader.good(folder)
    for name, data in good.items():
        (folder / name).write_bytes(data)
    name = next(n for n in reader.corrupted if Path(n).name == path.name.split("-", 1)[1])
    (folder / name).write_bytes(path.read_bytes())
    with limited_memory():
        check(reader, folder)
