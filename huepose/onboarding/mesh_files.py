"""Reads a mesh file and the files that it names (materials, textures, buffers), with limits.

A mesh may come from an untrusted source. So only regular files under the mesh's folder are read, and sizes
are checked before memory is allocated: that of a file before it is read, that of an image before it is
decoded.
"""

from __future__ import annotations

import os
import stat
import unicodedata
import warnings
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from huepose.geometry.arrays import UInt8
from huepose.onboarding.kinds import check_fetched
from huepose.support.errors import InputError

LARGEST_BYTES = 2**30
"""Most bytes of all files of one mesh; a scan of five million triangles as OBJ text has a third of it."""
LARGEST_TEXTURE = 2**26
"""Most texels of one texture: 8192 x 8192. Decoded it takes 200 MB; the reference model keeps 1024 x
1024."""
LARGEST_TEXTURES = 2**28
"""Most texels of all textures of one mesh: 0.8 GB."""
_LONGEST_NAME = 1000  # characters of a file name that are used
_PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP")


class MeshFiles:
    """Reads a mesh file and the files that it names, and counts their bytes and texels.

    textured: whether textures are decoded. If not, only their size is checked, and they become one black
    texel; a texture that may be transparent becomes an image with transparent texels white and the others
    black."""

    def __init__(self, mesh: Path, textured: bool) -> None:
        self.mesh, self.textured = mesh, textured
        self._bytes_left, self._texels_left = LARGEST_BYTES, LARGEST_TEXTURES
        self._textures: dict[Path, UInt8] = {}

    def read_mesh(self) -> bytes:
        """Content of the mesh file. Raises InputError."""
        return self._read(self.mesh, "mesh", None)

    def read(self, name: str, role: str, named_in: Path) -> tuple[Path, bytes]:
        """Path and content of a file that `named_in` names. Raises InputError that says which file names it.

        name: as written there, relative to the folder of `named_in`. Another case of letters is accepted, and
        accents may be decomposed, as macOS does. If the name leads out of the mesh's folder (to a folder of
        the machine that exported the mesh), only its last part counts.
        """
        path = self._find(name, role, named_in)
        return path, self._read(path, role, named_in)

    def has(self, name: str, role: str, named_in: Path) -> bool:
        """Whether `read` would find a file that `named_in` names."""
        try:
            self._find(name, role, named_in)
        except InputError:
            return False
        return True

    def texture(self, name: str, named_in: Path) -> UInt8:
        """Texture (H, W, 3) uint8 RGB of an image file that `named_in` names. Raises InputError."""
        path = self._find(name, "texture", named_in)
        if path not in self._textures:
            self._textures[path] = self.picture(self._read(path, "texture", named_in), str(path))
        return self._textures[path]

    def picture(self, data: bytes, what: str) -> UInt8:
        """Decode a PNG, JPEG and so on to (H, W, 3) uint8 RGB. Raises InputError naming `what`."""
        texels, may_be_clear = _header(data, what)
        self._texels_left -= texels
        if self._texels_left < 0:
            raise InputError(
                what,
                found="too many texels for one mesh",
                expected=f"at most {LARGEST_TEXTURES / 1e6:.0f} million texels in all",
                fix="Make the textures smaller.",
            )
        if not (self.textured or may_be_clear):
            return np.zeros((1, 1, 3), np.uint8)
        kind = cv2.IMREAD_COLOR if self.textured else cv2.IMREAD_UNCHANGED
        flags = kind | cv2.IMREAD_IGNORE_ORIENTATION
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            image = None
        if image is None:
            raise _no_picture(data, what)
        if not self.textured:
            return _clear(image)
        return np.ascontiguousarray(image[..., ::-1])

    def _find(self, name: str, role: str, named_in: Path) -> Path:
        """Path of a named file. Raises InputError unless it exists under the mesh's folder."""
        written = name.replace("\\", "/")[:_LONGEST_NAME]
        path = named_in.parent / written
        inside = Path(os.path.abspath(path)).is_relative_to(os.path.abspath(self.mesh.parent))
        if not (inside and os.path.exists(path)):
            *through, last = os.path.relpath(path, named_in.parent).split("/")
            folder = named_in.parent
            for one in through if inside else ():
                folder = next(iter(_alike(folder, one)), folder / one)
            alike = [*_alike(folder, last), *_alike(named_in.parent, last)]
            if not alike and inside:
                raise InputError(
                    path,
                    found="no such file",
                    expected=f"the {role}, which {named_in.name} names",
                    fix=f"Put the {role} beside {named_in.name}, or correct the name in it.",
                )
            if not alike:
                raise self._outside(named_in, f"the {role} {written[:80]}", role)
            path = alike[0]
        # A link may lead into the folder of the mesh file itself: some data sets are folders of links.
        homes = (self.mesh.parent.resolve(), self.mesh.resolve().parent)
        if not any(path.resolve().is_relative_to(home) for home in homes):
            raise self._outside(path, f"a link to {path.resolve()}", role)
        return path

    def _outside(self, where: Path, what: str, role: str) -> InputError:
        return InputError(
            where,
            found=f"{what}, outside of the mesh's folder",
            expected=f"a {role} under {self.mesh.parent}",
            fix=f"Copy the {role} there, and name it without a path.",
        )

    def _read(self, path: Path, role: str, named_in: Path | None) -> bytes:
        expected = f"the {role}" if named_in is None else f"the {role}, which {named_in.name} names"
        try:
            status = path.stat()
            if not stat.S_ISREG(status.st_mode):
                raise InputError(path, found="no regular file", expected=expected)
            if status.st_size > self._bytes_left:
                raise InputError(
                    path,
                    found=f"{status.st_size / 1e6:.0f} MB",
                    expected=f"at most {LARGEST_BYTES / 1e6:.0f} MB for a mesh and all that it names",
                    fix="Simplify the mesh or make its textures smaller.",
                )
            self._bytes_left -= status.st_size
            with path.open("rb") as file:
                data = file.read(status.st_size)
        except FileNotFoundError:
            raise InputError(path, found="no such file", expected=expected, fix="Check the path.") from None
        except OSError as error:
            found = error.strerror or str(error)
            raise InputError(path, found=found, expected=f"a readable {role}") from None
        check_fetched(data, path, expected)
        return data


def decoded(data: bytes) -> str:
    """Text of a mesh or material file: UTF-8 or, by its first bytes, UTF-16; if it is neither, Latin-1, which
    older exporters write."""
    try:
        return data.decode("utf-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _header(data: bytes, what: str) -> tuple[int, bool]:
    """Texels of an image by its header, and whether it may be transparent. Raises InputError if it is not
    an image or too large."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(BytesIO(data), formats=_PICTURE_FORMATS) as header:
                width, height = header.size
                may_be_clear = "A" in header.mode or "transparency" in header.info
    except Image.DecompressionBombError as error:
        raise _too_large(what, str(error)) from None
    except (OSError, ValueError, SyntaxError):
        raise _no_picture(data, what) from None
    if width * height > LARGEST_TEXTURE:
        raise _too_large(what, f"{width} x {height} texels")
    return width * height, may_be_clear


def _clear(image: NDArray[Any]) -> UInt8:
    """An image (H, W, 3), white where the decoded `image` is transparent, black elsewhere."""
    if image.ndim != 3 or image.shape[2] != 4:
        return np.zeros((1, 1, 3), np.uint8)
    clear = image[..., 3:] < np.iinfo(image.dtype).max // 2
    return np.repeat(255 * clear.astype(np.uint8), 3, axis=2)


def _too_large(what: str, found: str) -> InputError:
    return InputError(
        what,
        found=found,
        expected=f"at most {LARGEST_TEXTURE / 1e6:.0f} million texels (8192 x 8192)",
        fix="Make the texture smaller; HuePose keeps 1024 x 1024 texels of it.",
    )


def _no_picture(data: bytes, what: str) -> InputError:
    return InputError(
        what,
        found="a DDS texture" if data.startswith(b"DDS ") else f"{len(data)} bytes that are not an image",
        expected="a PNG or JPEG texture",
        fix="Open the texture in an image editor and save it again as PNG.",
    )


def _plain(name: str) -> str:
    return unicodedata.normalize("NFC", name).lower()


def _alike(folder: Path, name: str) -> list[Path]:
    """What is in a folder under this name, the case of letters and the form of accents apart."""
    try:
        return sorted(path for path in folder.iterdir() if _plain(path.name) == _plain(name))
    except (OSError, ValueError):
        return []
