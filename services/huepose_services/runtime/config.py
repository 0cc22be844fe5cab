"""The keys of pipeline.yaml as typed, frozen values."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from huepose.support.errors import InputError
from huepose_protos.fields import Name
from huepose_protos.keys import Keys
from huepose_protos.local import BASE_PORT, endpoint
from huepose_services.runtime.config_perception import (
    CameraConfig,
    DetectorConfig,
    NetworksConfig,
    Rate,
    Section,
    SegmenterConfig,
)

_ROS_PART = "[a-zA-Z_][a-zA-Z0-9_]*"
"""A part of the name of a ROS 2 topic, between slashes."""

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

Far = Literal["detector", "segmenter", "estimator"]
Hosts = Annotated[dict[Name, tuple[Far, ...]], Meta(max_length=1)]

PERCEPTION: tuple[Far, ...] = get_args(Far)
"""The workers that may run on a second computer, each after the one whose results it needs."""

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
