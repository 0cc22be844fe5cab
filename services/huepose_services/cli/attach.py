"""What all verbs have in common that look at a running pipeline: which one is meant."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from huepose_services.cli.options import add_path

if TYPE_CHECKING:
    from huepose_services.runtime.config import Config
    from huepose_services.runtime.running import Pipeline


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a pipeline."""
    parser.add_argument(
        "--pipeline", metavar="NAME", help="where several run here: SITE/CAMERA of one, or its first port"
    )
    add_path(parser, "--config", "PIPELINE", "the pipeline's configuration, for its ports")


def chosen(arguments: argparse.Namespace) -> Pipeline:
    """The pipeline that is meant. Raises InputError where that is not clear."""
    from huepose_services.runtime.running import pick

    return pick(arguments.config, arguments.pipeline)


def chosen_config(arguments: argparse.Namespace) -> Config:
    """The configuration of the pipeline that is meant; names and ports alone where its file is not known."""
    from huepose_protos.local import FOLDER
    from huepose_services.runtime.config import BusConfig, Config, load
    from huepose_services.runtime.config_perception import CameraConfig

    pipeline = chosen(arguments)
    if pipeline.folder:
        # Its sockets may be in another folder than those that this user's own pipelines would have.
        os.environ[FOLDER] = pipeline.folder
    if pipeline.file:
        return load(Path(pipeline.file), pipeline.camera)
    return Config(
        site=pipeline.site,
        camera=CameraConfig(name=pipeline.camera),
        bus=BusConfig(base_port=pipeline.base_port),
    )
