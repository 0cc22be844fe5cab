"""Checks of this machine, and of what a pipeline names. The checks of a camera are in `pictures`."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from huepose.support.errors import InputError
from huepose.support.extras import install_command, installed_version
from huepose_services.runtime.config import Config
from huepose_services.runtime.session import MIB, SHM, lock_limit, pool_fits, shared_memory_free

_PACKAGES = (
    *("huepose", "eclipse-zenoh", "numpy", "msgspec", "opencv-python-headless", "numba", "scipy"),
    *("onnxruntime", "onnxruntime-gpu", "open3d-cpu", "open3d", "rerun-sdk", "pyrealsense2", "depthai"),
)
_CPUS = Path("/sys/devices/system/cpu")
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")


State = Literal["ok", "none", "note", "bad"]
_MARKS = {"ok": "OK  ", "none": "-   ", "note": "NOTE", "bad": "BAD "}


@dataclass(frozen=True)
class Finding:
    """One line of the result. state `none`: missing, but not needed; `note`: works, but could be better."""

    subject: str
    state: State
    found: str
    fix: str = ""

    @property
    def bad(self) -> bool:
        """Whether something does not work."""
        return self.state == "bad"

    def line(self) -> str:
        """The finding as it is printed."""
        text = f"{_MARKS[self.state]} {self.subject:16s} {self.found}"
        return f"{text}\n{'':22s}-> {self.fix}" if self.fix else text


def examine(configs: Sequence[Config]) -> list[Finding]:
    """The findings. configs: one for each camera of a pipeline; what they name is checked, too. They differ
    only in their cameras."""
    config = configs[0] if configs else None
    wanted = config or Config()
    return [
        *versions(),
        *providers(wanted),
        *memory(wanted.bus.frame_pool_mib),
        *cameras({config.camera.source for config in configs if "camera" in config.workers}),
        *networks(config),
        *bundles(config),
        *clock(),
        *processor(),
    ]


def providers(config: Config) -> Iterator[Finding]:
    """Which execution providers for networks there are, and which one the configuration chooses."""
    if find_spec("onnxruntime") is None:
        yield Finding("providers", "none", "no onnxruntime: networks cannot be run")
        return
    import onnxruntime as ort

    from huepose.perception.sessions import PROVIDERS

    have = [key for key, name in PROVIDERS.items() if name in ort.get_available_providers()]
    chosen = [key for key in config.networks.providers if key in have]
    found = f"onnxruntime {ort.__version__} has {', '.join(have)}"
    if chosen:
        yield Finding("providers", "ok", f"{found}; networks run on {chosen[0]}")
    else:
        fix = "Add cpu to networks.providers, or install the onnxruntime that has them."
        yield Finding("providers", "bad", f"{found}, none of {', '.join(config.networks.providers)}", fix)


def cameras(needed: Collection[str]) -> Iterator[Finding]:
    """Which cameras are connected. needed: the sources whose absence is BAD."""
    for kind, package, look in (("realsense", "pyrealsense2", _realsense), ("oak", "depthai", _oak)):
        if find_spec(package) is None:
            fix = install_command(kind) if kind in needed else ""
            yield Finding(kind, "bad" if kind in needed else "none", f"{package} is not installed", fix)
            continue
        try:
            seen = look()
        except (ImportError, RuntimeError, OSError) as error:
            fix = "It needs libusb-1.0-0 and libudev1: apt-get install them."
            yield Finding(kind, "bad" if kind in needed else "note", " ".join(str(error).split())[:120], fix)
            continue
        if seen:
            slow = any("on USB 2" in one for one in seen)
            fix = "USB 2 offers few modes: use a USB 3 cable and port." if slow else ""
            yield Finding(kind, "note" if slow else "ok", ", ".join(seen), fix)
        else:
            fix = "Plug it into a USB 3 port; udev rules: sudo deploy/jetson/install.sh --udev"
            missing = kind in needed
            yield Finding(kind, "bad" if missing else "none", "no camera found", fix if missing else "")


def _realsense() -> list[str]:
    import pyrealsense2 as rs

    info = rs.camera_info
    return [
        f"{d.get_info(info.name)} {d.get_info(info.serial_number)}"
        + (f" on USB {d.get_info(info.usb_type_descriptor)}" if d.supports(info.usb_type_descriptor) else "")
        for d in rs.context().query_devices()
    ]


def _oak() -> list[str]:
    # Without this, searching for a camera takes 11 s if there is none.
    os.environ.setdefault("DEPTHAI_SEARCH_TIMEOUT", "0")
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    import depthai as dai

    return [f"{info.name} {info.getDeviceId()}" for info in dai.Device.getAllAvailableDevices()]


def networks(config: Config | None) -> Iterator[Finding]:
    """Whether the installed known networks are intact, and those of the configuration can be opened."""
    from huepose.perception.sessions import check_file
    from huepose_services import catalogue

    here = [entry for entry in catalogue.entries() if entry.here]
    yield Finding("networks", "ok" if here else "none", f"{len(here)} in {catalogue.folder()}")
    for entry in here:
        yield from _refused(partial(check_file, entry.path, entry.network.sha256))
    if config is not None and config.network_workers:
        from huepose_services.networks import check

        yield from _refused(partial(check, config))


def _refused(check: Callable[[], None]) -> Iterator[Finding]:
    """A finding if a check of networks raises InputError."""
    try:
        check()
    except InputError as error:
        yield Finding("networks", "bad", str(error))


def bundles(config: Config | None) -> Iterator[Finding]:
    """Whether the reference models can be read."""
    if config is None or config.bundles is None:
        yield Finding("reference models", "none", "none configured: the built-in scene brings its own")
        return
    from huepose_services import models

    try:
        names = sorted(models.load(config))
    except InputError as error:
        yield Finding("reference models", "bad", str(error))
        return
    yield Finding("reference models", "ok", f"{', '.join(names)} in {config.bundles}")


def versions() -> Iterator[Finding]:
    """The versions of Python and of packages."""
    right = (3, 10) <= sys.version_info[:2] <= (3, 12)
    yield Finding(
        "python",
        "ok" if right else "bad",
        f"{platform.python_version()} on {platform.machine()}, {os.cpu_count()} processors",
        "" if right else "Use Python 3.10, 3.11 or 3.12.",
    )
    have = {name: version for name in _PACKAGES if (version := installed_version(name))}
    yield Finding("packages", "ok", ", ".join(f"{name} {version}" for name, version in have.items()))
    if "onnxruntime" in have and "onnxruntime-gpu" in have:
        fix = "They are one module and overwrite each other: pip uninstall both, then install one."
        yield Finding("onnxruntime", "bad", "both onnxruntime and onnxruntime-gpu are installed", fix)
    if "numba" not in have:
        fix = f"To run a pipeline here: {install_command('edge')}."
        yield Finding("pipeline", "note", "only what subscribers need is installed", fix)


def memory(pool_mib: float) -> Iterator[Finding]:
    """Whether shared memory, and how much of it may be locked, suffice for the pool of frames."""
    limit, pool = lock_limit(), int(pool_mib * MIB)
    text = "no limit" if limit is None else f"{limit // 1024} KiB"
    fits = pool == 0 or pool_fits(pool, limit)
    yield Finding(
        "locked memory",
        "ok" if fits else "note",
        f"{text}; frames need a pool of {pool_mib:g} MiB"
        + ("" if fits else ", so they are sent over the socket"),
        "" if fits else "Raise it (ulimit -l unlimited, LimitMEMLOCK=infinity), or lower bus.frame_pool_mib.",
    )
    if not os.access(SHM, os.W_OK):
        fix = "Mount it: without it, frames are sent over the socket. In a container: --shm-size=256m."
        yield Finding("shared memory", "note", f"{SHM} is not there, or not writable", fix)
        return
    free = shared_memory_free() / MIB
    enough = free > 4 * pool_mib
    fix = "" if enough else "Free space in it, or enlarge it: mount -o remount,size=256M /dev/shm."
    yield Finding("shared memory", "ok" if enough else "bad", f"{free:.0f} MiB free in {SHM}", fix)


def clock() -> Iterator[Finding]:
    """The monotonic clock, which gives all timestamps."""
    resolution_ns = time.clock_getres(time.CLOCK_MONOTONIC) * 1e9
    source = _read(_CLOCK_SOURCE) or "unknown source"
    slow = source in ("hpet", "acpi_pm", "jiffies")
    fix = f"Reading {source} is slow and coarse; see the kernel's clocksource= option." if slow else ""
    yield Finding("clock", "note" if slow else "ok", f"{source}, resolution {resolution_ns:.0f} ns", fix)


def processor() -> Iterator[Finding]:
    """Whether the processor runs as fast as it can."""
    governors = {text for path in _CPUS.glob("cpu[0-9]*/cpufreq/scaling_governor") if (text := _read(path))}
    if not governors:
        yield Finding("governor", "none", "the system does not name the processor's frequency governor")
    elif governors & {"powersave", "conservative"}:
        fix = "For even times: sudo cpupower frequency-set -g performance (on a Jetson: sudo jetson_clocks)."
        yield Finding("governor", "note", ", ".join(sorted(governors)), fix)
    else:
        yield Finding("governor", "ok", ", ".join(sorted(governors)))
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    busy = load > 1.5 * cores
    fix = "Other programs use the processors: latency will be long and uneven." if busy else ""
    yield Finding("load", "note" if busy else "ok", f"{load:.1f} on {cores} processors", fix)


def _read(path: Path) -> str | None:
    try:
        return path.read_text().strip()
    except OSError:
        return None
