"""The viewer worker: shows images and poses to people. It only reads from the bus, in a process of its
own."""

import os

from huepose_services.viewer.work import make

__all__ = ["make"]

# Switches off the usage reports of rerun before its import: a robot must not use the internet.
os.environ.setdefault("RERUN_ANALYTICS", "0")
