from __future__ import annotations

import json
import os
import struct
import time
import tracemalloc
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from huepose.model import io, load_model, load_models, save_model
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError


@pytest.fixture(scope="module")
def saved(tea_box: ReferenceModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bundles") / "tea_box.huepose"
    model = replace(tea_box, object_id=4, frame_offset_m=np.array([0.1, 0.0, 1e-17]))
    save_model(model, path)
    return path


def assert_equal(a: object, b: object, where: str) -> None:
    for f in fields(a):
        x, y, name = getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}"
        if isinstance(x, np.ndarray):
            assert x.dtype == y.dtype, name
            np.testing.assert_array_equal(x, y, err_msg=name)
        elif hasattr(x, "__dataclass_fields__"):
            assert type(x) is type(y)
            assert_equal(x, y, name)
        else:
            assert x == y, name


def test_a_model_comes_back_bit_for_bit(tea_box: ReferenceModel, saved: Path) -> None:
    loaded = load_model(saved)
    mesh = replace(tea_box.mesh, digest=loaded.digest)
    offset = np.array([0.1, 0.0, 1e-17])
    expected = replace(tea_box, object_id=4, frame_offset_m=offset, mesh=mesh, digest=loaded.digest)
    assert_equal(expected, loaded, "model")


def test_the_digest_is_of_the_content(saved: Path, tea_box: ReferenceModel, tmp_path: Path) -> None:
    (tmp_path / "copy.huepose").write_bytes(saved.read_bytes())
    save_model(replace(tea_box, diameter_m=tea_box.diameter_m + 1e-9), tmp_path / "other.huepose")
    copy, other = (load_model(tmp_path / f"{name}.huepose") for name in ("copy", "other"))
    assert copy.digest == copy.mesh.digest == load_model(saved).digest
    assert other.digest not in (None, copy.digest)


def test_absent_fields_come_back_absent(tea_box: ReferenceModel, tmp_path: Path) -> None:
    save_model(tea_box, tmp_path / "b.huepose")
    model = load_model(tmp_path / "b.huepose")
    assert model.object_id is None
    assert model.frame_offset_m is None


def test_equal_models_give_equal_bytes(saved: Path, tmp_path: Path) -> None:
    save_model(load_model(saved), tmp_path / "again.huepose")
    assert (tmp_path / "again.huepose").read_bytes() == saved.read_bytes()


def test_files_are_small_and_quick(saved: Path) -> None:
    assert saved.stat().st_size < 20e6
    seconds = []
    for _ in range(5):
        start = time.process_time()
        load_model(saved)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.1


def test_large_arrays_are_mapped_and_writing_to_them_stays_private(saved: Path) -> None:
    before = saved.read_bytes()
    planes = load_model(saved).templates.planes
    assert isinstance(planes.base.base, memoryview), "a view of the file, not a copy"
    assert planes.flags.aligned
    planes[0] = 1.0
    assert saved.read_bytes() == before
    assert (load_model(saved).templates.planes[0] != 1.0).any()


def test_one_wrong_byte_is_noticed(saved: Path, tmp_path: Path) -> None:
    content = bytearray(saved.read_bytes())
    content[content.index(b"templates.planes.npy") + 100_000] ^= 1
    other = tmp_path / "tea_box.huepose"
    other.write_bytes(content)
    with pytest.raises(InputError, match=r"templates\.planes\.npy is damaged"):
        load_model(other)


def rewritten(source: Path, target: Path, **changes: object) -> Path:
    """A copy with other values in its header."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "header.json":
                data = json.dumps(json.loads(data) | changes).encode()
            new.writestr(entry, data)
    return target


def test_one_damaged_file_of_a_folder_is_named_with_both_remedies(saved: Path, tmp_path: Path) -> None:
    (tmp_path / "tea_box.huepose").write_bytes(saved.read_bytes())
    (tmp_path / "mug.huepose").write_bytes(b"nothing")
    with pytest.raises(InputError) as error:
        load_models(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'mug.huepose'}: found a damaged or foreign file")
    assert str(error.value).endswith("onboard-bop`, or take the file out of the folder.")
    (tmp_path / "mug.huepose").unlink()
    assert list(load_models(tmp_path)) == ["tea_box"]


def test_another_version_is_refused(saved: Path, tmp_path: Path) -> None:
    other = rewritten(saved, tmp_path / "tea_box.huepose", version=io.VERSION + 1)
    with pytest.raises(InputError, match=rf"version {io.VERSION + 1}; expected .*Onboard the object again"):
        load_model(other)


def test_tables_are_kept_if_there_are_any(tea_box: ReferenceModel, saved: Path, tmp_path: Path) -> None:
    assert load_model(saved).tables is not None
    bare = replace(tea_box, tables=None)
    save_model(bare, tmp_path / "bare.huepose")
    assert load_model(tmp_path / "bare.huepose").tables is None
    assert (tmp_path / "bare.huepose").stat().st_size < saved.stat().st_size - 1e6


def test_keypoints_are_kept(tea_box: ReferenceModel, saved: Path) -> None:
    kept = load_model(saved).keypoints
    assert kept.source == tea_box.keypoints.source
    np.testing.assert_array_equal(kept.descriptors, tea_box.keypoints.descriptors)
    np.testing.assert_array_equal(kept.points, tea_box.keypoints.points)


@pytest.mark.parametrize("content", [b"", b"no zip", None])
def test_damaged_files_are_refused(saved: Path, tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "tea_box.huepose"
    path.write_bytes(saved.read_bytes()[:1_000_000] if content is None else content)
    with pytest.raises(InputError, match=r"tea_box.huepose: found a damaged or foreign file"):
        load_model(path)


def test_flipped_bits_are_noticed(saved: Path, tmp_path: Path) -> None:
    data = bytearray(saved.read_bytes())
    data[len(data) // 2] ^= 16
    (tmp_path / "tea_box.huepose").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        load_model(tmp_path / "tea_box.huepose")


def test_a_missing_array_is_noticed(saved: Path, tmp_path: Path) -> None:
    kinds = json.loads(zipfile.ZipFile(saved).read("header.json"))["types"]
    kinds.pop("turns")
    with pytest.raises(InputError, match="damaged"):
        load_model(rewritten(saved, tmp_path / "tea_box.huepose", types=kinds))


def test_models_are_found_by_name(saved: Path, tea_box: ReferenceModel, tmp_path: Path) -> None:
    for name in ("b_two", "a_one"):
        save_model(replace(tea_box, name=name), tmp_path / f"{name}.huepose")
    (tmp_path / "notes.txt").write_text("not a model")
    (tmp_path / ".c_three.huepose.12.part").write_text("left by a power cut")
    assert list(load_models(tmp_path)) == ["a_one", "b_two"]
    assert list(load_models(tmp_path, ["b_two"])) == ["b_two"]
    with pytest.raises(InputError, match=r"object 'cup'.*expected one of a_one, b_two"):
        load_models(tmp_path, ["a_one", "cup"])


def test_a_file_that_was_renamed_is_refused_with_both_remedies(saved: Path, tmp_path: Path) -> None:
    (tmp_path / "my_part.huepose").write_bytes(saved.read_bytes())
    with pytest.raises(InputError) as error:
        load_models(tmp_path)
    assert str(error.value) == (
        f"{tmp_path / 'my_part.huepose'}: found the model 'tea_box'; expected the model 'my_part', as the "
        "file is named. Rename the file to tea_box.huepose, or onboard the object under the new name."
    )


def test_empty_and_missing_folders_are_distinguished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no reference models"):
        load_models(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        load_models(tmp_path / "none")
    with pytest.raises(InputError, match="no such file"):
        load_model(tmp_path / "none.huepose")


def test_the_folder_that_is_meant_is_named(saved: Path, tmp_path: Path) -> None:
    (tmp_path / "kettle" / "bundles").mkdir(parents=True)
    model = tmp_path / "kettle" / "bundles" / "kettle.huepose"
    model.write_bytes(saved.read_bytes())
    with pytest.raises(InputError, match=r"found no reference models; .* Did you mean .*kettle/bundles[?]"):
        load_models(tmp_path / "kettle")
    with pytest.raises(InputError, match=r"found a file; .* Give its folder: .*kettle/bundles[.]"):
        load_models(model)


def test_a_failed_write_leaves_the_old_file(saved: Path, tea_box: ReferenceModel, tmp_path: Path) -> None:
    path = tmp_path / "tea_box.huepose"
    path.write_bytes(b"the old one")
    broken = replace(tea_box, near_symmetries=np.array([object()]))
    with pytest.raises(ValueError, match="allow_pickle"):
        save_model(broken, path)
    assert path.read_bytes() == b"the old one"
    assert [p.name for p in tmp_path.iterdir()] == ["tea_box.huepose"]


@pytest.mark.parametrize("name", ["", "Cup", "a b", "../cup", "x" * 65])
def test_names_are_checked(tea_box: ReferenceModel, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="1 to 64 of a-z"):
        save_model(replace(tea_box, name=name), tmp_path / "m.huepose")


def packed(source: Path, target: Path, compression: int = zipfile.ZIP_STORED, **entries: bytes) -> Path:
    """A copy with other bytes in some entries."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", compression) as new:
        for entry in old.infolist():
            new.writestr(
                entry.filename, entries[entry.filename] if entry.filename in entries else old.read(entry)
            )
    return target


def npy(shape: str, kind: str = "<f4", data: bytes = b"") -> bytes:
    """The bytes of an array as its header states it."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (118 - len(header)) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


def png(width: int, height: int) -> bytes:
    """The beginning of a PNG image of that size."""
    return (
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + struct.pack(">II", width, height) + b"\x08\x02\x00\x00\x00"
    )


def peak_bytes(path: Path, reason: str) -> int:
    """The most memory that Python took to refuse a file."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=reason):
            load_model(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_compressed_file_is_refused_before_it_is_unpacked(saved: Path, tmp_path: Path) -> None:
    large = {"surface.lab.npy": npy("(2, 40000000, 3)", data=bytes(240_000_000))}
    path = packed(saved, tmp_path / "tea_box.huepose", zipfile.ZIP_DEFLATED, **large)
    assert path.stat().st_size < 20e6
    assert peak_bytes(path, "compressed entries") < 10e6


@pytest.mark.parametrize(
    ("entry", "data", "reason"),
    [
        ("surface.lab.npy", npy("(2, 1000000000000, 3)"), "not have the size that it states"),
        ("surface.lab.npy", npy("(2, 3, 3)", "|O", bytes(72)), "not a plain array"),
        ("surface.lab.npy", npy("(2, 0, 3"), "damaged"),  # tokenize's own error
        ("surface.lab.npy", npy("(" * 100), "damaged"),
        ("surface.lab.npy", b"\x93NUMPY\x07\x00", "damaged"),
        ("surface.lab.npy", b"", "damaged"),
        ("surface.lab.npy", npy("(2, 5, 3)", data=bytes(120)), "surface.lab has the shape"),
        ("header.json", b"[" * 100_000, "damaged"),
        ("header.json", b"[]", "not a JSON object"),
        ("header.json", b'{"a": ' + b"9" * 5000 + b"}", "damaged"),
    ],
)
def test_whatever_is_wrong_in_a_file_it_is_an_input_error(
    saved: Path, tmp_path: Path, entry: str, data: bytes, reason: str
) -> None:
    path = packed(saved, tmp_path / "tea_box.huepose", **{entry: data})
    assert peak_bytes(path, reason) < 100e6


def test_a_texture_of_too_many_pixels_is_refused(saved: Path, tmp_path: Path) -> None:
    data = png(16384, 16384)
    entry = {"mesh.texture_png.npy": npy(f"({len(data)},)", "|u1", data)}
    path = packed(saved, tmp_path / "tea_box.huepose", **entry)
    assert peak_bytes(path, "16384 x 16384 pixels") < 100e6


@pytest.mark.parametrize("name", ["mesh.faces", "surface.visible", "grid.nearest", "tables.ppf"])
def test_an_index_that_points_at_nothing_is_refused(
    tea_box: ReferenceModel, saved: Path, tmp_path: Path, name: str
) -> None:
    room, field = name.split(".")
    array = getattr(getattr(tea_box, room), field).copy()
    array.flat[-1] = np.iinfo(array.dtype).max
    data = npy(str(array.shape), array.dtype.str, array.tobytes())
    with pytest.raises(InputError, match=f"{name} has an index out of range"):
        load_model(packed(saved, tmp_path / "tea_box.huepose", **{f"{name}.npy": data}))


def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "tea_box.huepose")
    with pytest.raises(InputError, match="it is not a file"):
        load_model(tmp_path / "tea_box.huepose")
