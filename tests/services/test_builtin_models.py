"""The reference models of the built-in scene: those of old versions are deleted when new ones are made."""

import fcntl
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from huepose.support.kept import UNUSED_DAYS
from huepose_services import builtin


def folder(home: Path, name: str, days: float) -> Path:
    """A folder of models that was last used so many days ago."""
    place = home / "huepose" / "builtin" / name
    place.mkdir(parents=True)
    for file in ("tea_box.huepose", ".lock"):
        (place / file).touch()
        os.utime(place / file, (time.time() - days * 86400,) * 2)
    return place


@pytest.mark.timeout(60)
def test_unused_models_are_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = builtin.builtin_bundles(0)
    monkeypatch.setattr(builtin, "cache_folder", lambda: tmp_path / "huepose")
    old, young = folder(tmp_path, "old", UNUSED_DAYS + 1), folder(tmp_path, "young", UNUSED_DAYS - 1)
    now = folder(tmp_path, there.name, UNUSED_DAYS + 1)
    # Another process makes the models, so that this one makes none.
    with (now / ".lock").open("r+") as other, ThreadPoolExecutor(1) as pool:
        fcntl.flock(other, fcntl.LOCK_EX)
        asked = pool.submit(builtin.builtin_bundles.__wrapped__, 0)
        while old.exists() and not asked.done():
            time.sleep(0.05)
        for path in there.glob("*.huepose"):
            (now / path.name).unlink(missing_ok=True)
            (now / path.name).symlink_to(path)
        fcntl.flock(other, fcntl.LOCK_UN)
        assert asked.result() == now
    assert [old.exists(), young.exists()] == [False, True]

    os.utime(now / ".lock", (0, 0))
    builtin.builtin_bundles.__wrapped__(0)
    assert (now / ".lock").stat().st_mtime > time.time() - 600


def test_the_name_of_the_folder_depends_on_all_code_that_makes_models() -> None:
    """But not on `support`, which is about files and messages, or on packages without code of their own."""
    code = "import sys, huepose.onboarding.reference as _; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name for name in done.stdout.split() if name.startswith("huepose.")}
    makers = [maker.removesuffix(".py").replace("/", ".") for maker in (*builtin._MAKERS, "support")]
    covered = tuple(f"huepose.{maker}." for maker in makers)
    left = {name for name in loaded if not f"{name}.".startswith(covered)}
    assert left == {"huepose.propose", "huepose.refine"}
