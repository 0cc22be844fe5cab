"""Which of the connected cameras is opened."""

from __future__ import annotations

import pytest

from huepose_services.camera.live import CameraError, the_one

TWO = {"048322071234": "left", "048322079999": "right"}


def test_the_camera_with_the_serial_number_or_the_only_one_is_opened() -> None:
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
def test_any_other_choice_is_an_error_with_what_to_do(
    connected: dict[str, str], serial: str | None, said: str
) -> None:
    with pytest.raises(CameraError, match=said):
        the_one(connected, serial, "plug one in")
