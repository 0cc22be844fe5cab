from __future__ import annotations

import json
import time
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
    for f in fields(a):  # type: ignore[arg-type]
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
    expected = replace(tea_box, object_id=4, frame_offset_m=np.array([0.1, 0.0, 1e-17]))
    assert_equal(expected, load_model(saved), "model")


def test_what_is_absent_comes_back_absent(tea_box: ReferenceModel, tmp_path: Path) -> None:
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


def rewritten(source: Path, target: Path, **changes: object) -> Path:
    """A copy with other values in its header."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "header.json":
                data = json.dumps(json.loads(data) | changes).encode()
            new.writestr(entry, data)
    return target


def test_another_version_is_refused(saved: Path, tmp_path: Path) -> None:
    other = rewritten(saved, tmp_path / "tea_box.huepose", version=io.VERSION + 1)
    with pytest.raises(InputError, match=rf"version {io.VERSION + 1}; expected .*Onboard the object again"):
        load_model(other)


def test_a_file_of_the_version_before_is_read(saved: Path, tmp_path: Path) -> None:
    """It had the tables of the paper's method among the pairs, and classes of the fine pairs as well."""
    path = tmp_path / "tea_box.huepose"
    with zipfile.ZipFile(saved) as new, zipfile.ZipFile(path, "w") as old:
        for entry in new.infolist():
            data, name = new.read(entry), entry.filename.replace("tables.", "pairs.")
            if name == "header.json":
                header = json.loads(data) | {"version": 1}
                header["pair_parameters"] |= header.pop("table_parameters")
                header["types"] = {k.replace("tables.", "pairs."): v for k, v in header["types"].items()}
                data = json.dumps(header).encode()
            old.writestr(name, data)
    before, now = load_model(path), load_model(saved)
    assert before.tables is not None
    assert now.tables is not None
    np.testing.assert_array_equal(before.pairs.colors, now.pairs.colors)
    np.testing.assert_array_equal(before.tables.triangles, now.tables.triangles)
    np.testing.assert_array_equal(before.tables.side_classes, now.tables.side_classes)
    assert before.tables.parameters["ppf_bin_m"] == now.tables.parameters["ppf_bin_m"]


def test_tables_are_kept_where_there_are_any(tea_box: ReferenceModel, saved: Path, tmp_path: Path) -> None:
    assert load_model(saved).tables is not None
    bare = replace(tea_box, tables=None)
    save_model(bare, tmp_path / "bare.huepose")
    assert load_model(tmp_path / "bare.huepose").tables is None
    assert (tmp_path / "bare.huepose").stat().st_size < saved.stat().st_size - 1e6


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


def test_empty_and_missing_folders_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no reference models"):
        load_models(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        load_models(tmp_path / "none")
    with pytest.raises(InputError, match="no such file"):
        load_model(tmp_path / "none.huepose")


def test_a_failed_write_leaves_the_old_file(saved: Path, tea_box: ReferenceModel, tmp_path: Path) -> None:
    path = tmp_path / "tea_box.huepose"
    path.write_bytes(b"the old one")
    broken = replace(tea_box, turns=np.array([object()]))
    with pytest.raises(ValueError, match="allow_pickle"):
        save_model(broken, path)
    assert path.read_bytes() == b"the old one"
    assert [p.name for p in tmp_path.iterdir()] == ["tea_box.huepose"]


@pytest.mark.parametrize("name", ["", "Cup", "a b", "../cup", "x" * 65])
def test_names_are_checked(tea_box: ReferenceModel, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="1 to 64 of a-z"):
        save_model(replace(tea_box, name=name), tmp_path / "m.huepose")
