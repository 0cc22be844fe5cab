"""The viewer: what the pipeline sees and believes, for people. One more reader, in a process of its own."""

import os

from huepose_services.viewer.work import make

__all__ = ["make"]

# Nothing is reported to anyone, from the import of rerun on: a robot has no business on the internet.
os.environ.setdefault("RERUN_ANALYTICS", "0")
