"""`huepose validate`: check whether a pipeline.yaml can be started."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.words import first_of
from huepose_services.cli.options import add_host, add_json, add_pipeline, print_result

if TYPE_CHECKING:
    from huepose_protos.messages import Mount
    from huepose_services.runtime.config import Config

_FAR_M = 20.0
"""Largest coordinate of a mount without a warning: larger numbers are probably millimetres."""
_NAMED = 5
"""Most objects of a folder that are named."""


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("validate", help="check a pipeline.yaml without starting anything")
    add_pipeline(parser)
    add_host(parser)
    add_json(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Read the file, check that what it names exists, print a summary."""
    from huepose_services.runtime.config_errors import read_yaml
    from huepose_services.runtime.config_file import as_written, for_each_camera, text_of
    from huepose_services.runtime.prepare import check, gaps

    path = arguments.config
    data = read_yaml(text_of(path), path)
    written = as_written(data, path)
    configs = [config.at(arguments.host) for config in for_each_camera(written, data, path)]
    for config in configs:
        check(config)
        if config.camera.source == "synthetic" and "camera" in config.workers:
            from huepose_services.camera.synthetic import check_source

            check_source(config)
    answers, summaries = zip(*(_described(config, written, path) for config in configs), strict=True)
    answer = answers[0] if len(answers) == 1 else {"file": str(path), "cameras": list(answers)}
    note = ["  NOTE     the file is empty: all defaults apply, with the built-in scene"]
    lines = [f"{path}: good", *(note if data is None else []), *summaries]
    lines += [f"  WARNING  {gap}" for config in configs for gap in gaps(config)]
    print_result(arguments, answer, "\n".join(lines))
    return 0


def _described(config: Config, written: Config, path: Path) -> tuple[dict[str, Any], str]:
    """A summary of a configuration, for programs and in words. written: the configuration of the file
    itself, before it is resolved for one camera and computer."""
    import msgspec

    from huepose_protos.local import run_folder
    from huepose_services.runtime.config_parts import listeners

    ports = {worker: config.port(worker) for worker in config.workers}
    answer: dict[str, Any] = {
        "file": str(path),
        "workers": list(config.workers),
        "camera": f"{config.camera.name}: {config.camera.source} {config.camera.path or ''}".rstrip(),
        "objects": [item.name for item in config.objects],
        "keys": f"huepose/{config.site}/{config.camera.name}/...",
        "run_folder": str(run_folder()),
        "ports": ports,
        "listens": dict(listeners(config)),
        "mount": None if config.camera.mount is None else msgspec.to_builtins(config.camera.mount),
        "frames": _way_of_frames(config),
        "hosts": {host: list(workers) for host, workers in config.hosts.items()},
    }
    summary = f"""  workers  {", ".join(config.workers)}
  camera   {answer["camera"]}
  objects  {", ".join(answer["objects"]) or _every(config)}
  keys     {answer["keys"]}
  ports    in {run_folder()}: {", ".join(f"{worker} {port}" for worker, port in ports.items())}
  frames   {answer["frames"]}"""
    if answer["listens"]:
        summary += f"\n  listens  {', '.join(f'{key} {place}' for key, place in answer['listens'].items())}"
    notes = (*_limited(config), *_never_boxed(config), *_never_found(config), *_unread(config))
    for note in (*notes, *_unused(config, written)):
        summary += f"\n  NOTE     {note}"
    if one_of_each := _drawn_once(config):
        summary += f"\n  scene    {one_of_each}"
    if config.camera.mount is not None:
        summary += f"\n  mount    {mount_in_words(config.camera.mount)}"
        if max(map(abs, config.camera.mount.translation)) > _FAR_M:
            summary += f"\n  WARNING  the mount is over {_FAR_M:g} m away: are its numbers millimetres?"
    if config.host is not None:
        summary += f"\n  link     to {config.link.connect} as {config.host}, by TLS ({config.link.secure})"
    elif config.hosts:
        there = f"{config.other_host}, which runs {', '.join(config.far)}"
        summary += f"\n  link     at {config.link.listen} for {there}, by TLS ({config.link.secure})"
    return answer, summary


def _every(config: Config) -> str:
    """The objects that are searched for if the configuration names none, in words."""
    if config.bundles is None:
        return "the built-in ones"
    from huepose.model.io import model_names

    names = model_names(config.bundles)
    if len(names) < 2:
        return ": ".join((f"all of {config.bundles}", *names))
    return f"all {len(names)} of {config.bundles}: {first_of(names, _NAMED)}"


def _limited(config: Config) -> list[str]:
    """The verdicts of onboarding on the objects that do not suit, or suit with limits."""
    if config.bundles is None or not config.uses_models:
        return []
    from huepose_services import models

    folder = models.bundles_folder(config)
    return [said for model in models.load(config).values() if (said := models.limits(folder, model))]


def _never_boxed(config: Config) -> list[str]:
    """A sentence if the detector's network does not know all objects; else nothing."""
    if "detector" not in config.network_workers:
        return []
    from huepose_services import models, networks

    detector, _ = networks.yolo(networks.on_processor(config))
    names = [item.name for item in config.objects] or ([] if config.bundles is None else models.load(config))
    said = networks.never_boxed(detector, names)
    return [said] if said else []


def _never_found(config: Config) -> list[str]:
    """A sentence if there is a tracker, but workers that find objects for it are missing; else nothing."""
    if "tracker" not in config.workers:
        return []
    there = (*config.workers, *config.far)
    missing = [worker for worker in ("reinit", "detector", "segmenter", "estimator") if worker not in there]
    return [f"no object is ever found: {', '.join(missing)} not among the workers"] if missing else []


def _unused(config: Config, written: Config) -> list[str]:
    """A sentence for each section of the file whose worker is not started, or whose second computer is
    missing."""
    from huepose_services.runtime.config import Config

    default = Config()
    there = {*written.workers, *config.far, *(("uplink", "downlink") if config.hosts else ())}
    unused = [
        (f"the section `{worker}`", worker)
        for worker in ("gateway", "viewer", "ros2")
        if getattr(written, worker) != getattr(default, worker)
    ]
    unused += [(f"cpus.{worker}", worker) for worker in written.cpus]
    notes = [
        f"{key} is set, but {name} is not among the workers" for key, name in unused if name not in there
    ]
    if written.link != default.link and not config.hosts:
        notes.append("the section `link` is set, but there are no `hosts`")
    return notes


def _unread(config: Config) -> list[str]:
    """A sentence for each key that is set, but not used with the chosen kind or source."""
    from huepose_services.runtime.config_perception import DRAWN_SOURCES

    camera, detector, segmenter = config.camera, config.detector, config.segmenter
    groups: list[tuple[str, Any, tuple[str, ...], str]] = []
    if detector.kind != "yolo":
        keys = ("model", "layout", "classes", "confidence", "overlap")
        groups.append(("detector", detector, keys, f"detector.kind is {detector.kind}; it is for yolo"))
    else:
        groups.append(("detector", detector, ("threads",), "detector.kind is yolo; it is for views"))
    if segmenter.kind != "sam":
        why = f"segmenter.kind is {segmenter.kind}; it is for sam"
        groups.append(("segmenter", segmenter, ("encoder", "decoder"), why))
    if camera.source not in DRAWN_SOURCES:
        why = f"camera.source is {camera.source}, which renders nothing"
        groups.append(("camera", camera, ("seed",), why))
    if not camera.once:
        groups.append(("camera", camera, ("first_frame_s",), "camera.once is false"))
    elif camera.source == "python":
        why = "camera.source is python; it is for recordings"
        groups.append(("camera", camera, ("first_frame_s",), why))
    if camera.source == "oak":
        why = "camera.source is oak; it is for realsense"
        groups.append(("camera.device", camera.device, ("align",), why))
    return [
        f"{name}.{key} is set, but {why}"
        for name, section, keys, why in groups
        for key in keys
        if getattr(section, key) != getattr(type(section)(), key)
    ]


def _drawn_once(config: Config) -> str:
    """A sentence if more instances of an object are configured than the rendered scene shows; else empty."""
    several = [item.name for item in config.objects if item.max_instances > 1]
    if config.camera.source != "synthetic" or not several:
        return ""
    return f"the rendered scene shows one of each: a second {several[0]} is searched for, but is not there"


def mount_in_words(mount: Mount) -> str:
    """The position and viewing direction of a camera, so that units and axes can be checked by eye.

    >>> from huepose_protos.messages import Mount
    >>> mount_in_words(Mount(parent="base", translation=(0.5, 0.0, 0.8), quaternion=(0.5, -0.5, 0.5, -0.5)))
    "at 0.50 0.00 0.80 m in base, looks along 1.00 0.00 0.00, the image's up is 0.00 0.00 1.00"
    """
    import numpy as np

    from huepose_protos.motion import rotation_matrix

    R_parent_cam = rotation_matrix(np.array(mount.quaternion))
    place, ahead, up = (
        " ".join(f"{x + 0.0:.2f}" for x in np.round(v, 2))
        for v in (mount.translation, R_parent_cam[:, 2], -R_parent_cam[:, 1])
    )
    return f"at {place} m in {mount.parent}, looks along {ahead}, the image's up is {up}"


def _way_of_frames(config: Config) -> str:
    from huepose_services.runtime.session import MIB, lock_limit, pool_fits, pool_size

    limit = lock_limit()
    pool = pool_size(config, limit) / MIB
    if pool == 0:
        return "over the socket, because bus.frame_pool_mib is 0"
    kib = "no limit" if limit is None else f"limit {limit // 1024} KiB"
    if pool_fits(int(pool * MIB), limit):
        return f"through shared memory, a pool of {pool:g} MiB (ulimit -l: {kib})"
    return f"over the socket: a pool of {pool:g} MiB exceeds the memory that may be locked (ulimit -l: {kib})"
