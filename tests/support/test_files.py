"""Files are written whole or not at all, and an error of the disk names the file."""

import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from huepose.support.errors import InputError
from huepose.support.files import check_place, whole, write_picture, write_text
from tests.disk import full_disk


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_text(path, "x" * 100),
        lambda path: write_picture(path, np.zeros((9, 9, 3), np.uint8)),
    ],
)
@pytest.mark.parametrize("before", [b"", b"what was there"])
def test_on_a_full_disk_the_file_is_named_and_stays_as_it_was(write, before, tmp_path: Path) -> None:
    path = tmp_path / "out.png"
    if before:
        path.write_bytes(before)
    with full_disk(), pytest.raises(InputError) as error:
        write(path)
    assert str(error.value) == f"{path}: found File too large; expected a place that can be written."
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([before] if before else [])


def test_an_error_in_an_open_file_names_the_file_too(tmp_path: Path) -> None:
    path = tmp_path / "model"
    too_large = pytest.raises(OSError, match="File too large")
    with full_disk(), too_large as error, whole(path) as part, zipfile.ZipFile(part, "w") as archive:
        archive.writestr("a", b"x" * 100)
    assert error.value.filename == str(path)
    assert not list(tmp_path.iterdir())


def test_an_error_of_another_file_names_that_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="other") as error, whole(tmp_path / "out"):
        (tmp_path / "other").read_bytes()
    assert error.value.filename == str(tmp_path / "other")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for text in ("first", "second"):
        write_text(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "file").read_text() == text
    write_text("/dev/null", "nothing")
    assert Path("/dev/null").is_char_device()


@contextmanager
def _another_user() -> Iterator[None]:
    if os.getuid() != 0:
        pytest.skip("only root can be another user")
    nobody = 65534
    os.setresuid(nobody, nobody, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


def test_a_place_that_the_disk_refuses_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found File name too long; expected a place that can be written"):
        check_place(tmp_path / ("x" * 300))
    (tmp_path / "private").mkdir(mode=0o700)
    with _another_user(), pytest.raises(InputError, match="found Permission denied; expected a place"):
        check_place(tmp_path / "private" / "out.json")


def test_a_writable_file_in_a_read_only_folder_is_written() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), Path(name) / "out.json"
        path.write_text("before")
        path.chmod(0o666)
        folder.chmod(0o755)
        with _another_user():
            check_place(path)
            write_text(path, "after")
            with pytest.raises(InputError, match="cannot be written"):
                check_place(folder / "another.json")
        assert path.read_text() == "after"
