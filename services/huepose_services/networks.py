"""The networks of a deployment: from names and paths in pipeline.yaml to opened sessions and adapters."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

import msgspec

from huepose.perception.flow_network import NetworkFlow
from huepose.perception.sam import SamSegmenter
from huepose.perception.sessions import Network, NetworkSettings, open_network, providers_here
from huepose.perception.yolo import YoloDetector, class_names
from huepose.propose.flow import FlowSource
from huepose.support.errors import InputError
from huepose.support.files import cache_folder
from huepose.support.words import did_you_mean, listed
from huepose_services.catalogue import entry_of
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import is_network_file

SAM_ENCODER, SAM_DECODER = "nanosam-encoder", "nanosam-decoder"
"""Names of `huepose models`: the networks of the segmenter `sam` if none is configured."""


def settings(config: Config) -> NetworkSettings:
    """How the networks are run, from the configuration."""
    own = config.networks
    cache = Path(own.cache) if own.cache is not None else cache_folder() / "engines"
    return NetworkSettings(providers=own.providers, threads=own.threads, fp16=own.fp16, cache=cache)


def opened(config: Config, named: str, *, half: bool = True) -> Network:
    """The network of a path or a name of `huepose models`. Its file must have the digest of the
    configuration, or else the known one. Raises InputError."""
    sha256 = None
    if is_network_file(named):
        path = Path(named)
    else:
        entry = entry_of(named)
        path, sha256 = entry.path, entry.network.sha256
        half = half and entry.network.half
        if not entry.here:
            by_hand = f"`huepose models list` shows where; then `huepose models add FILE --name {named}`."
            fix = f"`huepose models fetch {named}` fetches it." if entry.network.url else by_hand
            raise InputError(f"network {named}", found=f"no file {path}", expected="the network", fix=fix)
    return open_network(
        path, settings(config), sha256=config.networks.sha256.get(path.name, sha256), half=half
    )


def check(config: Config) -> None:
    """Raises InputError if a network that a worker will open is missing, damaged, or of the wrong kind, if a
    digest is of no network, or if no allowed provider that could run it is installed.

    The networks are opened on the CPU here: building engines for a GPU takes minutes, and the worker does
    it."""
    for worker in config.network_workers:
        (yolo if worker == "detector" else sam)(on_processor(config))
    if config.network_workers:
        _check_digests(config)
        providers_here(settings(config))


def _check_digests(config: Config) -> None:
    """Raises InputError if a digest has another name than the file of a network: it would not be compared."""
    segmenter = config.segmenter
    named = (config.detector.model, segmenter.encoder or SAM_ENCODER, segmenter.decoder or SAM_DECODER)
    files = [Path(one).name if is_network_file(one) else f"{one}.onnx" for one in named if one]
    for name in config.networks.sha256:
        if name not in files:
            raise InputError(
                "networks.sha256",
                found=name,
                expected=f"a file name without its folder: {', '.join(files)}",
                fix=did_you_mean(Path(name).name, files),
            )


def on_processor(config: Config) -> Config:
    """The same configuration with networks that run on the CPU only."""
    return msgspec.structs.replace(
        config, networks=msgspec.structs.replace(config.networks, providers=("cpu",))
    )


def yolo(config: Config) -> tuple[YoloDetector, Network]:
    """The detector of the configuration, warmed up."""
    detector = config.detector
    assert detector.model is not None  # checked when the configuration was read
    network = opened(config, detector.model)
    classes = {
        name: given if isinstance(given, list) else [given] for name, given in detector.classes.items()
    }
    found = YoloDetector(
        network,
        classes or _by_name(network, [item.name for item in config.objects]),
        layout=detector.layout,
        confidence=detector.confidence,
        overlap=detector.overlap,
    )
    return found, network


def never_boxed(detector: YoloDetector, names: Iterable[str]) -> str:
    """A sentence about the objects to which a detector never gives a box; empty if there are none."""
    missing = detector.without_class(names)
    if not missing:
        return ""
    return (
        f"The detector's network has no class for {', '.join(missing)}, so it never gives a box for that. "
        "Name one in detector.classes, or give a box (huepose objects reset NAME --box X Y W H)."
    )


def _by_name(network: Network, wanted: list[str]) -> dict[str, list[int | str]]:
    """Each class for the object of the same name, also for objects that are added later. Raises InputError
    if a wanted object has no such class."""
    names = class_names(network, None)
    missing = [name for name in wanted if name not in names]
    if missing or not names:
        one = missing[0] if missing else "cereal_box"
        meant = difflib.get_close_matches(one, names, 1)
        raise InputError(
            f"{network.path}: classes",
            found=f"none called {', '.join(missing)}, but {listed(names)}"
            if names
            else "no names in the file",
            expected="for each object a class of the same name",
            fix="Say in detector.classes what the network calls it, for example "
            f"{{{one}: {meant[0] if meant else 0}}}.",
        )
    return {name: [name] for name in names}


def sam(config: Config) -> tuple[SamSegmenter, Network]:
    """The segmenter of the configuration, warmed up. Its decoder never runs in half precision."""
    segmenter = config.segmenter
    encoder = opened(config, segmenter.encoder or SAM_ENCODER)
    made = SamSegmenter(encoder, opened(config, segmenter.decoder or SAM_DECODER, half=False))
    made.warm_up()
    return made, encoder


def flow(named: str) -> FlowSource:
    """Optical flow by the network of a path or a name of `huepose models`. Raises InputError."""
    return NetworkFlow(opened(Config(), named))
