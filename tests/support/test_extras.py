"""The command that installs an extra names the place that the package came from."""

import json
from importlib import metadata

import pytest

from huepose.support.extras import install_command


class Installed:
    """What pip records of an installation."""

    def __init__(self, origin: object) -> None:
        self.origin = origin

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self.origin is None else json.dumps(self.origin)


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        (None, "pip install 'huepose[edge]'"),
        ({"url": "file:///home/me/my%20clone", "dir_info": {}}, "pip install '/home/me/my clone[edge]'"),
        (
            {"url": "file:///home/me/clone", "dir_info": {"editable": True}},
            "pip install -e '/home/me/clone[edge]'",
        ),
        (
            {"url": "file:///tmp/huepose-0.1.0-py3-none-any.whl", "archive_info": {}},
            "pip install '/tmp/huepose-0.1.0-py3-none-any.whl[edge]'",
        ),
    ],
)
def test_an_extra_is_installed_from_where_the_package_came_from(
    origin: object, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata, "distribution", lambda name: Installed(origin))
    assert install_command("edge") == command
