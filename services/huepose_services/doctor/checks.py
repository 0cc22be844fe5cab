"""All checks in the order in which they are printed."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from huepose.support.errors import InputError
from huepose.support.extras import install_command
from huepose_services.doctor import machine
from huepose_services.doctor.finding import Finding
from huepose_services.runtime.config import Config


def examine(configs: Sequence[Config]) -> list[Finding]:
    """What was found; with the configurations of a pipeline's cameras, also whether what they name is there:
    all but the cameras is the same in each."""
    config = configs[0] if configs else None
    wanted = config or Config()
    return [
        *machine.versions(),
        *providers(wanted),
        *machine.memory(wanted.bus.frame_pool_mib),
        *cameras({config.camera.source for config in configs if "camera" in config.workers}),
        *networks(config),
        *bundles(config),
        *machine.clock(),
        *machine.processor(),
    ]


def providers(config: Config) -> Iterator[Finding]:
    """What networks can run on here, and what they would."""
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
    """Which cameras are connected. needed: the sources that are bad when they are missing."""
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
            yield Finding(kind, "bad" if missing else "none", "no camera seen", fix if missing else "")


def _realsense() -> list[str]:
    import pyrealsense2 as rs

    info = rs.camera_info
    return [
        f"{d.get_info(info.name)} {d.get_info(info.serial_number)}"
        + (f" on USB {d.get_info(info.usb_type_descriptor)}" if d.supports(info.usb_type_descriptor) else "")
        for d in rs.context().query_devices()
    ]


def _oak() -> list[str]:
    # Without this, looking for a camera that is not there takes 11 s.
    os.environ.setdefault("DEPTHAI_SEARCH_TIMEOUT", "0")
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    import depthai as dai

    return [f"{info.name} {info.getDeviceId()}" for info in dai.Device.getAllAvailableDevices()]


def networks(config: Config | None) -> Iterator[Finding]:
    """Whether the networks that are known and here are right, and those of the configuration open."""
    from huepose.perception.sessions import check_file
    from huepose_services import catalogue

    here = [entry for entry in catalogue.entries() if entry.here]
    yield Finding("networks", "ok" if here else "none", f"{len(here)} in {catalogue.folder()}")
    for entry in here:
        yield from _refused(partial(check_file, entry.path, entry.network.sha256))
    if config is not None and config.uses_networks:
        from huepose_services.networks import check

        yield from _refused(partial(check, config))


def _refused(check: Callable[[], None]) -> Iterator[Finding]:
    """A finding when a check of networks raises."""
    try:
        check()
    except InputError as error:
        yield Finding("networks", "bad", str(error))


def bundles(config: Config | None) -> Iterator[Finding]:
    """Whether the reference models can be read."""
    if config is None or config.bundles is None:
        yield Finding("reference models", "none", "none named: the built-in scene brings its own")
        return
    from huepose.model import load_models

    try:
        models = load_models(Path(config.bundles), [item.name for item in config.objects] or None)
    except InputError as error:
        yield Finding("reference models", "bad", str(error))
        return
    yield Finding("reference models", "ok", f"{', '.join(sorted(models))} in {config.bundles}")
