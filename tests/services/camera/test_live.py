"""Which of the connected cameras is opened, and what is said of its stamps."""

from __future__ import annotations

import pytest

from huepose_services.camera.live import CameraError, the_one
from huepose_services.camera.live_ingest import stamps_off

TWO = {"048322071234": "left", "048322079999": "right"}


def test_the_camera_of_the_serial_number_or_the_only_one() -> None:
    assert the_one(TWO, "048322079999", "none") == "right"
    assert the_one({"048322071234": "left"}, None, "none") == "left"


@pytest.mark.parametrize(
    ("connected", "serial", "said"),
    [
        ({}, None, "plug one in"),
        ({}, "048322071234", "plug one in"),
        (TWO, None, "camera.device.serial to one of 048322071234, 048322079999"),
        (TWO, "1", "no camera with serial number 1; connected: 048322071234, 048322079999"),
    ],
)
def test_what_is_said_otherwise(connected: dict[str, str], serial: str | None, said: str) -> None:
    with pytest.raises(CameraError, match=said):
        the_one(connected, serial, "plug one in")


def test_stamps_of_the_future_are_named() -> None:
    assert stamps_off(0.5) is None
    assert stamps_off(-30.0) is None
    assert "63524.0 s behind" in (stamps_off(-63524.0) or ""), "as of seconds in the place of nanoseconds"
    said = stamps_off(3600.0)
    assert said is not None
    assert said.startswith("its time stamps are 3600.0 s ahead")
