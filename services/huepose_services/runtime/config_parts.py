"""Parts of a configuration: of each camera if there are several, of each computer if there are two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from huepose_services.runtime.config import PERCEPTION, Config
from huepose_services.runtime.config_perception import Refuse

_LAST_PORT = 65_535

_ANY = ("0.0.0.0", "[::]")  # noqa: S104  # every address of the computer

PORTS_OF_A_CAMERA = 20
"""Between the first ports of two cameras of a file; more than there are workers, for later ones."""


def of_cameras(config: Config, has_camera: bool, refuse: Refuse) -> list[Config]:
    """A configuration for each camera, as if it were alone: with its own ports, and its own namespace in
    ROS 2. has_camera: whether the file has the key `camera`, which is not allowed beside `cameras`."""
    if not config.cameras:
        return [config]
    names = [camera.name for camera in config.cameras]
    if config.hosts:
        fix = "Give each camera whose workers run on two computers a file of its own."
        refuse("cameras", "`cameras` and `hosts`", "one of them", fix)
    if has_camera:
        refuse("cameras", "`camera` and `cameras`", "one of them", "Leave `camera` out.")
    if len(set(names)) != len(names):
        refuse(
            "cameras", f"the names {', '.join(names)}", "every name once", "Give each a `name` of its own."
        )
    replace = msgspec.structs.replace
    host, port = config.gateway.listen.rsplit(":", 1)
    return [
        replace(
            config,
            camera=camera,
            cameras=[],
            gateway=replace(config.gateway, listen=f"{host}:{int(port) + k}"),
            viewer=replace(
                config.viewer, web_port=config.viewer.web_port + k, grpc_port=config.viewer.grpc_port + k
            ),
            ros2=replace(
                config.ros2,
                namespace=f"{config.ros2.namespace}/{ros_token(camera.name, 'camera')}",
                frame_prefix=f"{config.ros2.frame_prefix}{camera.name}/",
            ),
            bus=replace(config.bus, base_port=config.bus.base_port + k * PORTS_OF_A_CAMERA),
        )
        for k, camera in enumerate(config.cameras)
    ]


def ros_token(name: str, kind: str) -> str:
    """A name of ours as part of a topic's name, for which ROS 2 allows letters, digits and underscores, and
    no digit first: `tea-box` becomes tea_box, and the object (kind) `003_box` object_003_box."""
    plain = name.replace("-", "_")
    return f"{kind}_{plain}" if plain[0].isdigit() else plain


def check_ports(config: Config, refuse: Refuse) -> None:
    """Check that each address has a port, and that the gateway does not listen at the port of the ROS 2
    router: both have 7447 by default."""
    addresses = {
        "gateway.listen": config.gateway.listen,
        "link.listen": config.link.listen,
        "link.connect": config.link.connect,
    }
    if "viewer" in config.workers:
        addresses["viewer.web_port"] = str(config.viewer.web_port)
        addresses["viewer.grpc_port"] = str(config.viewer.grpc_port)
    for key, address in addresses.items():
        if address is not None and not 0 < int(address.rpartition(":")[2]) <= _LAST_PORT:
            fix = "Give another one; of several cameras each further one gets the next."
            refuse(key, address, f"a port of 1 to {_LAST_PORT}", fix)
    router = config.ros2.connect.partition("/")[2]
    host, _, port = router.rpartition(":")
    here = host in ("localhost", "127.0.0.1", "[::1]")
    if {"gateway", "ros2"} <= set(config.workers) and here and config.gateway.listen.endswith(f":{port}"):
        refuse(
            "gateway.listen",
            config.gateway.listen,
            f"another port than the router's of ROS 2 (ros2.connect: {config.ros2.connect})",
            "Give the gateway one of its own: {listen: 127.0.0.1:7457}, for example.",
        )


def check_listeners(configs: Sequence[Config], refuse: Refuse) -> None:
    """Check that no two workers of all cameras of a file listen at the same address."""
    taken: list[tuple[str, str]] = []
    for config in configs:
        of_which = f" of {config.camera.name}" if len(configs) > 1 else ""
        for key, address in listeners(config):
            for other, there in taken:
                if _meet(address, there):
                    fix = "Each needs a port of its own; of several cameras each gets the next ones."
                    expected = f"another port than that of {other}"
                    refuse(f"{key}{of_which}", address.rpartition(":")[2], expected, fix)
            taken.append((key + of_which, address))


def listeners(config: Config) -> Iterator[tuple[str, str]]:
    """The keys that say where workers listen, with their addresses."""
    if "gateway" in config.workers:
        yield "gateway.listen", config.gateway.listen
    if "viewer" in config.workers:
        # rerun serves the page's program at every address, whatever `bind` is.
        yield "viewer.web_port", f"{_ANY[0]}:{config.viewer.web_port}"
        yield "viewer.grpc_port", f"{config.viewer.bind}:{config.viewer.grpc_port}"
    if config.hosts:
        yield "link.listen", config.link.listen


def _meet(one: str, other: str) -> bool:
    """Whether two addresses exclude each other: the same port, and a common host address."""
    (host, port), (other_host, other_port) = (
        address.replace("localhost", "127.0.0.1").rsplit(":", 1) for address in (one, other)
    )
    same_host = host == other_host or not {host, other_host}.isdisjoint(_ANY)
    return same_host and int(port) == int(other_port)


def check_ros2(config: Config, refuse: Refuse) -> None:
    """Check that the router has a port, and that the objects' names differ in ROS 2."""
    port = config.ros2.connect.rpartition(":")[2]
    if port.isdigit() and not 0 < int(port) <= _LAST_PORT:
        fix = "rmw_zenoh's router listens on 7447."
        refuse("ros2.connect", config.ros2.connect, f"a port of 1 to {_LAST_PORT}", fix)
    tokens: dict[str, str] = {}
    for one in config.objects if "ros2" in config.workers else ():
        other = tokens.setdefault(ros_token(one.name, "object"), one.name)
        if other != one.name:
            fix = "Their poses would be on one topic of ROS 2."
            refuse("objects", f"{other} and {one.name}", "names that differ by more than - and _", fix)


def check_hosts(config: Config, refuse: Refuse) -> None:
    """Check `hosts` against other keys."""
    perception = tuple(worker for worker in PERCEPTION if worker in config.workers)
    if linked := {"uplink", "downlink"} & set(config.workers):
        refuse("workers", ", ".join(sorted(linked)), "other workers", "They run where `hosts` says so.")
    for host, workers in config.hosts.items():
        if not workers or workers != perception[-len(workers) :]:
            ends = " or ".join(", ".join(perception[i:]) for i in range(len(perception)))
            fix = "The workers after the first of them run there too, so that pixels are sent there once."
            refuse(f"hosts.{host}", ", ".join(workers) or "none", ends or "perception in `workers`", fix)
        if config.link.connect is None:
            expected = f"address and port by which {host} reaches the camera's computer"
            refuse("link.connect", "null", expected, "Set it: robot.local:7448.")
        elif config.link.connect.startswith("["):
            fix = "zenoh cannot connect to an IPv6 address by TLS: give the computer's name."
            refuse("link.connect", config.link.connect, "a name, or an address of IPv4", fix)
