"""The pipelines that this user runs on this machine, so that `huepose poses` and other commands find them.

`huepose up`, and `huepose run` by hand, write a note of what they run into a folder that only the user can
write. A note whose process has ended is ignored and removed.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from huepose.support.errors import InputError
from huepose.support.files import whole
from huepose_protos.local import born_of, endpoint, perception_alone, run_folder, writer_runs
from huepose_services.runtime.config import WORKERS, BusConfig, Config
from huepose_services.runtime.config_file import DEFAULT_FILE, load_all
from huepose_services.runtime.run_folder import is_private, known_folders, make_folder
from huepose_services.runtime.text import encodable


class Pipeline(msgspec.Struct, frozen=True, kw_only=True):
    """A pipeline that may be running. site and camera are `*` if nothing is known of it."""

    base_port: int
    site: str = "*"
    camera: str = "*"
    workers: tuple[str, ...] = ()
    file: str = ""
    folder: str = ""
    """Where its sockets are; empty: in this user's folder, and no process has noted that it runs it."""
    far: tuple[str, ...] = ()
    """The workers of these that run on the other computer."""
    host: str = ""
    """The other computer's name."""
    frame_pool_mib: float = BusConfig().frame_pool_mib

    @property
    def name(self) -> str:
        """SITE/CAMERA."""
        return f"{self.site}/{self.camera}"

    @property
    def noted(self) -> bool:
        """Whether a process has noted that it runs it."""
        return bool(self.folder)

    @property
    def place(self) -> tuple[str, int, str]:
        """Where its workers listen, and the name in their keys."""
        return (self.folder or str(run_folder().absolute()), self.base_port, self.name)

    @property
    def played(self) -> bool:
        """Whether a recording is played in its place: no workers run."""
        return self.noted and not self.workers

    @property
    def recorded(self) -> bool:
        """Whether its file is a recording instead of a configuration."""
        return self.file.endswith(".mcap")

    @property
    def elsewhere(self) -> str:
        """If its camera is at another computer: a sentence on where poses and objects are; else empty."""
        if "downlink" not in self.workers or "downlink" in self.far:
            return ""
        return perception_alone(self.name)

    @property
    def absence(self) -> str:
        """The message if nothing comes from it."""
        if self.played:
            return f"{self.name} is a recording that is played, {self.file}: there is nothing to control"
        if self.noted:
            return f"{self.name} is being started or stopped, from {self.file}; its log says how far it is"
        return f"no pipeline runs at port {self.base_port}; `huepose up` starts one"

    @property
    def endpoints(self) -> list[str]:
        """Where its workers listen, if they run."""
        return [endpoint(self.base_port + place, self.folder) for place in range(len(WORKERS))]

    def key(self, tail: str) -> str:
        """The key of this pipeline with this end, or an expression for it."""
        return f"huepose/{self.name}/{tail}"


def described(config: Config, path: Path) -> Pipeline:
    """The pipeline of a configuration."""
    # At the camera's computer, the workers of the other one are reached as well.
    far = () if config.host is not None or not config.hosts else (*config.far, "downlink")
    return Pipeline(
        base_port=config.bus.base_port,
        site=config.site,
        camera=config.camera.name,
        workers=(*(worker for worker in config.workers if worker not in far), *far),
        far=far,
        host=(far and config.other_host) or "",
        frame_pool_mib=config.bus.frame_pool_mib,
        file=str(path.absolute()),
    )


@contextmanager
def noted(pipeline: Pipeline) -> Iterator[None]:
    """Keep a note while a pipeline runs in this process. If no note can be written, the pipeline runs all the
    same, and commands do not find it."""
    folder = run_folder()
    note = folder / f"{os.getpid()}-{pipeline.base_port}.json"
    with suppress(OSError, InputError):
        make_folder()
        with whole(note) as part:
            here = {"folder": str(folder.absolute()), "file": encodable(pipeline.file)}
            values = msgspec.structs.asdict(pipeline) | here | {"born": born_of(os.getpid())}
            part.write_bytes(msgspec.json.encode(values))
    try:
        yield
    finally:
        if is_private(folder):
            note.unlink(missing_ok=True)


def running(without_this: bool = False) -> list[Pipeline]:
    """The pipelines that run now, each once; without_this: leave out those that this process has noted."""
    found = {}
    for note in [note for folder in known_folders() for note in sorted(folder.glob("*.json"))]:
        if not writer_runs(note):
            with suppress(OSError):
                note.unlink(missing_ok=True)
            continue
        if without_this and note.stem.partition("-")[0] == str(os.getpid()):
            continue
        with suppress(OSError, msgspec.MsgspecError):
            pipeline = msgspec.json.decode(note.read_bytes(), type=Pipeline)
            found[pipeline.folder, pipeline.base_port, pipeline.name] = pipeline
    return list(found.values())


def namesake(pipeline: Pipeline) -> str | None:
    """The warning about another pipeline that runs here under the same name; None if there is none."""
    others = [p for p in running(without_this=True) if p.name == pipeline.name and p.workers]
    if not others:
        return None
    return (
        f"{_listed(others[:1])} has the same name: give one of them another `site` or `camera.name`, so that "
        "readers and --pipeline tell them apart"
    )


def occupant(config: Config, worker: str) -> str:
    """Who holds a worker's port that is taken, in words: a noted pipeline, else another program."""
    for other in running(without_this=True):
        place = config.port(worker) - other.base_port
        if not 0 <= place < len(WORKERS):
            continue
        if not other.workers:
            return f"a recording there that is played ({other.file})"
        if WORKERS[place] in other.workers and WORKERS[place] not in other.far:
            return f"the {WORKERS[place]} of {other.name} there, which runs already ({other.file})"
    return "another program there"


def port_taken(config: Config, worker: str, found: str = "") -> InputError:
    """The error for a worker's port that is taken; found: the reason, by default who holds it."""
    return InputError(
        f"port {config.port(worker)} of worker {worker}",
        found=found or occupant(config, worker),
        expected=f"that nobody listens there (in {run_folder()})",
        fix="Stop the other pipeline, or give a configuration with another bus.base_port, "
        f"{len(WORKERS)} or more away.",
    )


def pick(path: Path | None = None, which: str | None = None) -> Pipeline:
    """The pipeline for a command: that of a configuration, else the one that runs, else the `usual` one.

    which: SITE/CAMERA, or one of the two, or the first port. Raises InputError if several match, or none."""
    found = running()
    if path is not None:
        of_file = [described(config.at(None), path) for config in load_all(path)]
        meant = [p for p in of_file if which in (None, p.name, p.camera, str(p.base_port))]
        if len(meant) != 1:
            raise InputError(
                f"the camera of {path}",
                found=_listed(of_file) if which is None else f"--pipeline {which}, and {_listed(of_file)}",
                expected="one of them",
                fix=f"Say which: --pipeline {of_file[0].camera}.",
            )
        (wanted,) = meant
        same = [p for p in found if (p.base_port, p.name) == (wanted.base_port, wanted.name)]
        # It may run with its sockets in another folder than this user's.
        return msgspec.structs.replace(same[0], file=wanted.file) if same else wanted
    if which is not None:
        meant = [p for p in found if which in (p.name, p.site, p.camera, str(p.base_port))]
        if not meant:
            raise InputError(
                f"--pipeline {which}",
                found="no such pipeline here",
                expected=_listed(found) or "a pipeline that runs: none does",
                fix="Start it with `huepose up`, or name one that runs.",
            )
        found = meant
    if len(found) > 1:
        first = found[0]
        alone = "*" not in first.name and [p.name for p in found].count(first.name) == 1
        which = f"{first.base_port} (or {first.name})" if alone else f"{first.base_port}"
        one_file = len({p.file for p in found}) == 1  # a file of several cameras names none of them
        file = shlex.quote(first.file) if first.file else "PIPELINE.yaml"
        which += "" if one_file or first.recorded else f", or --config {file}"
        raise InputError(
            "the pipeline to attach to",
            found=f"{len(found)} that run here: {_listed(found)}",
            expected="one",
            fix=f"Say which: --pipeline {which}.",
        )
    return found[0] if found else usual()


def usual() -> Pipeline:
    """The pipeline of the configuration in this folder, else one at the default port."""
    default = Path(DEFAULT_FILE)
    if default.exists():
        return described(load_all(default)[0].at(None), default)
    return Pipeline(base_port=Config().bus.base_port)


def _listed(pipelines: list[Pipeline]) -> str:
    return ", ".join(f"{p.name} at port {p.base_port} ({p.file})" for p in pipelines)
