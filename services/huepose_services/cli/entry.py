# PYTHON_ARGCOMPLETE_OK
"""The command `huepose`: the command line, whose own imports Ctrl-C may meet as well."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the command line of this process. Returns the exit code."""
    try:
        from huepose_services.cli.main import main as run

        return run()
    except (KeyboardInterrupt, ImportError) as error:
        if not _by_ctrl_c(error):
            raise
    print("huepose: interrupted", file=sys.stderr)
    return 130


def _by_ctrl_c(error: BaseException) -> bool:
    """Whether Ctrl-C is behind it: a compiled module that is being imported turns it into an ImportError."""
    behind: BaseException | None = error
    while behind is not None and not isinstance(behind, KeyboardInterrupt):
        behind = behind.__cause__ or behind.__context__
    return behind is not None
