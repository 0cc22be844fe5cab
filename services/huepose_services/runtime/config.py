"""pipeline.yaml as typed, frozen values. Read and checked once, when a process starts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta

from huepose.support.errors import InputError
from huepose_protos.fields import Name
from huepose_protos.keys import Keys
from huepose_protos.local import BASE_PORT, endpoint
from huepose_services.runtime.config_errors import explain, read_yaml
from huepose_services.runtime.config_parts import (
    PERCEPTION,
    Hosts,
    check_hosts,
    check_listeners,
    check_ports,
    check_ros2,
    of_cameras,
)
from huepose_services.runtime.config_perception import (
    DRAWN_SOURCES,
    CameraConfig,
    DetectorConfig,
    NetworksConfig,
    Rate,
    Refuse,
    Section,
    SegmenterConfig,
    absolute,
    check_camera,
    check_detector,
    check_segmenter,
)

DEFAULT_FILE = "pipeline.yaml"
_MAX_BYTES = 1024 * 1024
_ROS_PART = "[a-zA-Z_][a-zA-Z0-9_]*"
"""A part of the name of a ROS 2 topic, between slashes."""
_NO_FILE: dict[type[Exception], str] = {
    FileNotFoundError: "no such file",
    IsADirectoryError: "a folder",
    UnicodeDecodeError: "no text",
}

WorkerName = Literal[
    "camera",
    "tracker",
    "reinit",
    "detector",
    "segmenter",
    "estimator",
    "gateway",
    "viewer",
    "ros2",
    "uplink",
    "downlink",
]
# The workers that are needed for poses; the others only read.
CHAIN: tuple[WorkerName, ...] = ("camera", "tracker", "reinit", *PERCEPTION)
# The order gives each worker its port: base_port plus its index. New workers go to the end.
WORKERS: tuple[WorkerName, ...] = get_args(WorkerName)


class ObjectConfig(Section, frozen=True, kw_only=True):
    """An object to search for, by the name of its reference model."""

    name: Name
    max_instances: Annotated[int, Meta(ge=1, le=64)] = 1


class EstimatorConfig(Section, frozen=True, kw_only=True):
    """How poses are found in a single frame."""

    method: Literal["full", "colorpair"] = "full"
    threads: Annotated[int, Meta(ge=1, le=64)] = 2


class TrackerConfig(Section, frozen=True, kw_only=True):
    """How late a correction may come, how old a `TRACKING` pose may be, and whether fast motion of the
    camera is measured if its pose is not given."""

    history_frames: Annotated[int, Meta(ge=2, le=300)] = 20
    older_frames: Annotated[int, Meta(ge=0, le=300)] = 24
    max_age_ms: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 300.0
    odometry: bool = True


class ReinitConfig(Section, frozen=True, kw_only=True):
    """How often perception examines objects again."""

    rate_hz: Annotated[float, Meta(gt=0.0, le=30.0)] = 5.0
    objects_per_tick: Annotated[int, Meta(ge=1, le=16)] = 2
    deadline_ms: Annotated[int, Meta(ge=50, le=10_000)] = 600


class TlsConfig(Section, frozen=True, kw_only=True):
    """PEM files: the authority that signed the readers' certificates, the gateway's own certificate and
    key. `readers`: common names of the certificates that may read; empty: all that the authority signed.
    `revoked`: the list of revoked certificates. The files are read again when they change."""

    authority: str
    certificate: str
    key: str
    revoked: str | None = None
    readers: list[Annotated[str, Meta(min_length=1, max_length=64)]] = msgspec.field(default_factory=list)


Address = Annotated[str, Meta(pattern=r"^[^/\s]+:\d{1,5}$", description="ADDRESS:PORT")]
Router = Annotated[
    str,
    Meta(
        pattern=r"^((tcp|udp|tls|quic)/\S+:\d{1,5}|unixsock-stream/\S+)$",
        description="tcp/HOST:PORT (or udp, tls, quic), or unixsock-stream/PATH",
    ),
]
Namespace = Annotated[
    str,
    Meta(
        pattern=rf"^{_ROS_PART}(/{_ROS_PART})*$",
        max_length=128,
        description="names of letters, digits and _ with / between them, none with a digit first",
    ),
]
FramePrefix = Annotated[
    str,
    Meta(pattern=r"^[a-zA-Z0-9_/-]{0,128}$", description="at most 128 letters, digits, _, / and -"),
]


class GatewayConfig(Section, frozen=True, kw_only=True):
    """The access of other machines: how often they get messages, and which readers are allowed."""

    listen: Address = "127.0.0.1:7447"
    max_rate_hz: Rate = 60.0
    max_sessions: Annotated[int, Meta(ge=1, le=1000)] = 32
    sessions_per_reader: Annotated[int, Meta(ge=1, le=1000)] = 8
    tls: TlsConfig | None = None


class ViewerConfig(Section, frozen=True, kw_only=True):
    """The viewer's page: its ports and address, images a second, and memory."""

    web_port: Annotated[int, Meta(ge=1024, le=65_535)] = 9090
    grpc_port: Annotated[int, Meta(ge=1024, le=65_535)] = 9876
    bind: Literal["127.0.0.1", "0.0.0.0"] = "127.0.0.1"  # noqa: S104  # only who asks for it gets it
    image_rate_hz: Annotated[float, Meta(gt=0.0, le=30.0)] = 10.0
    memory_mib: Annotated[int, Meta(ge=16, le=16_384)] = 64


class Ros2Config(Section, frozen=True, kw_only=True):
    """Poses as ROS 2 messages: router, domain, form of the keys, namespace of the topics, and prefix of
    the objects' names in /tf."""

    connect: Router = "tcp/localhost:7447"
    domain: Annotated[int, Meta(ge=0, le=232)] = 0
    keys: Literal["rmw_zenoh", "bridge"] = "rmw_zenoh"
    namespace: Namespace = "huepose"
    frame_prefix: FramePrefix = ""


class LinkConfig(Section, frozen=True, kw_only=True):
    """The connection between the two computers of `hosts`: the address on the camera's computer, its
    address for the other one, and the folder with the certificates of `huepose secure`."""

    listen: Address = "0.0.0.0:7448"
    connect: Address | None = None
    secure: str = "secure"


class BusConfig(Section, frozen=True, kw_only=True):
    """How the workers are connected: by sockets in a folder that only their user can open."""

    base_port: Annotated[int, Meta(ge=1024, le=65_000)] = BASE_PORT
    frame_pool_mib: Annotated[float, Meta(ge=0.0, le=1024.0)] = 6.0


class RestartConfig(Section, frozen=True, kw_only=True):
    """How often a worker that died is restarted, and when it counts as hung."""

    limit: Annotated[int, Meta(ge=0, le=1000)] = 5
    window_s: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 60.0
    start_within_s: Annotated[float, Meta(ge=1.0, le=3600.0)] = 300.0
    hung_after_s: Annotated[float, Meta(ge=0.5, le=600.0)] = 2.0

    def patience_s(self, worker: str) -> float:
        """How long a worker may be silent. Workers other than these three take longer for one message."""
        return self.hung_after_s * (1.0 if worker in ("camera", "tracker", "reinit") else 3.0)


Processors = Annotated[list[Annotated[int, Meta(ge=0, le=1023)]], Meta(min_length=1)]


class Config(Section, frozen=True, kw_only=True):
    """A whole deployment. cpus: the processors that a worker runs on; workers that are not named run on any.
    hosts: which workers run on another computer. cameras: several instead of `camera`; each gets a
    configuration and workers of its own."""

    site: Name = "local"
    workers: tuple[WorkerName, ...] = CHAIN
    cpus: dict[WorkerName, Processors] = msgspec.field(default_factory=dict)
    hosts: Hosts = msgspec.field(default_factory=dict)
    link: LinkConfig = LinkConfig()
    bundles: str | None = None
    profile: Literal["live", "patient"] = "live"
    objects: list[ObjectConfig] = msgspec.field(default_factory=list)
    camera: CameraConfig = CameraConfig()
    cameras: list[CameraConfig] = msgspec.field(default_factory=list)
    detector: DetectorConfig = DetectorConfig()
    segmenter: SegmenterConfig = SegmenterConfig()
    networks: NetworksConfig = NetworksConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    tracker: TrackerConfig = TrackerConfig()
    reinit: ReinitConfig = ReinitConfig()
    gateway: GatewayConfig = GatewayConfig()
    viewer: ViewerConfig = ViewerConfig()
    ros2: Ros2Config = Ros2Config()
    bus: BusConfig = BusConfig()
    restarts: RestartConfig = RestartConfig()

    @property
    def keys(self) -> Keys:
        """The keys of this deployment."""
        return Keys(self.site, self.camera.name)

    @property
    def other_host(self) -> str | None:
        """The name of the second computer, if there is one."""
        return next(iter(self.hosts), None)

    @property
    def far(self) -> tuple[WorkerName, ...]:
        """The workers that run on the second computer, beside the downlink."""
        return next(iter(self.hosts.values()), ())

    @property
    def host(self) -> str | None:
        """The computer whose part this is; None: the camera's, or the only one."""
        return self.other_host if "downlink" in self.workers else None

    def at(self, host: str | None) -> Config:
        """The part of one computer; None: the camera's. Raises InputError for a host that is not in
        `hosts`."""
        if host is not None and host not in self.hosts:
            known = ", ".join(self.hosts) or "none: `hosts` is empty"
            raise InputError("--host", found=host, expected=f"one of: {known}")
        if not self.hosts:
            return self
        mine = self.far if host is not None else tuple(w for w in self.workers if w not in self.far)
        return msgspec.structs.replace(self, workers=(*mine, "uplink" if host is None else "downlink"))

    def beside(self, worker: str) -> Config:
        """The part of the computer on which that worker runs."""
        return self.at(self.other_host if worker in (*self.far, "downlink") else None)

    @property
    def uses_models(self) -> bool:
        """Whether any of the workers needs reference models."""
        return not {"camera", "gateway", "uplink", "downlink"}.issuperset(self.workers)

    @property
    def network_workers(self) -> list[WorkerName]:
        """Those of the workers that run a network."""
        runs = {"detector": self.detector.kind == "yolo", "segmenter": self.segmenter.kind == "sam"}
        return [worker for worker in self.workers if runs.get(worker)]

    def port(self, worker: str) -> int:
        """The port of a worker: the name of its socket."""
        return self.bus.base_port + WORKERS.index(worker)

    def endpoint(self, worker: str) -> str:
        """The zenoh endpoint of a worker."""
        return endpoint(self.port(worker))


def load(path: Path, camera: str | None = None) -> Config:
    """The configuration of a file; of the named camera, if the file has several. Raises InputError that names
    the key, the value and what is allowed."""
    configs = load_all(path)
    of_camera = [config for config in configs if config.camera.name == camera]
    if len(configs) == 1 or of_camera:
        return (of_camera or configs)[0]
    names = ", ".join(config.camera.name for config in configs)
    raise InputError(
        f"{path}: cameras" if camera is None else f"{path}: camera {camera}",
        found=f"the cameras {names}",
        expected="one camera" if camera is None else "one of them",
        fix="Name one: with --pipeline or --camera, or as CAMERA.WORKER; else give a file with one `camera`.",
    )


def load_all(path: Path) -> list[Config]:
    """The configurations of a file: one for each camera. Raises InputError as `load` does."""
    return parse_all(text_of(path), path)


def text_of(path: Path) -> str:
    """The text of a file. Raises InputError if it cannot be read, or is too long."""
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise ValueError(f"over {_MAX_BYTES} bytes")
        return data.decode()
    except (OSError, ValueError) as error:
        found = _NO_FILE.get(type(error)) or getattr(error, "strerror", None) or str(error)[:200]
        inside = path / DEFAULT_FILE
        fix = "Give the path of one, as in: huepose up PIPELINE.yaml; `huepose new` makes one."
        raise InputError(
            f"configuration {path}",
            found=found,
            expected="a YAML file that describes a pipeline",
            fix=f"Did you mean {inside}?" if inside.is_file() else fix,
        ) from None


def parse_all(text: str, path: Path) -> list[Config]:
    """The configurations in a text, one for each camera; `path` names it in errors, and relative paths are
    relative to its folder."""
    data = read_yaml(text, path)
    return for_each_camera(as_written(data, path), data, path)


def for_each_camera(written: Config, data: Any, path: Path) -> list[Config]:
    """The checked configurations of a file, one for each camera. written: `as_written` of `data`. Raises
    InputError."""

    def refuse(key: str, found: str, expected: str, fix: str) -> None:
        raise InputError(f"{path}: {key}", found=found, expected=expected, fix=fix)

    of_each = of_cameras(written, isinstance(data, dict) and "camera" in data, refuse)
    try:
        configs = [absolute(one, path.absolute().parent) for one in of_each]
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{path}: a path in it", found=str(error)[:200], expected="a path") from None
    for one in configs:
        _check(one, refuse)
    check_listeners(configs, refuse)
    return configs


def as_written(data: Any, path: Path) -> Config:
    """The values of a file as they are written: before each camera gets ports of its own, and paths become
    absolute. Raises InputError for a key or a value that is wrong by itself."""
    try:
        return msgspec.convert(data if data is not None else {}, Config)
    except msgspec.ValidationError as error:
        raise explain(error, data, Config, path) from None
    except RecursionError:
        raise InputError(f"configuration {path}", found="values that are nested too deeply") from None


def _check(config: Config, refuse: Refuse) -> None:
    """Check keys against each other."""
    names = [o.name for o in config.objects]
    camera, detector = config.camera, config.detector
    if len(set(names)) != len(names):
        refuse("objects", ", ".join(names), "every name once", "Use max_instances for several of a kind.")
    if not config.workers:
        fix = f"Name one, or leave `workers` out: then {', '.join(CHAIN)} are started."
        refuse("workers", "none", "one worker or more", fix)
    if len(set(config.workers)) != len(config.workers):
        refuse("workers", ", ".join(config.workers), "each worker at most once", "Name each once.")
    check_hosts(config, refuse)
    check_ports(config, refuse)
    check_ros2(config, refuse)
    check_camera(camera, config.workers, refuse)
    if (
        camera.source not in DRAWN_SOURCES
        and config.bundles is None
        and (config.uses_models or config.objects)
    ):
        expected = f"the folder of your reference models (the source {camera.source} brings none)"
        refuse("bundles", "null", expected, "Make them: huepose onboard MESH --name NAME --out DIR.")
    check_detector(detector, names, refuse)
    check_segmenter(config.segmenter, refuse)
