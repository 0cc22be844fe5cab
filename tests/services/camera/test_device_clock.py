"""Times of the device's clock as times of this machine's: drift, jitter, jumps, restarts."""

import numpy as np
import pytest

from huepose_services.camera.device_clock import DeviceClock

FASTEST_NS = 5_000_000


def _play(clock, seconds, *, drift=0.0, device_from=10**9, host_from=987_654_321_000_000, seed=0):
    """Errors of the timestamps in ms, against capture plus the shortest delay; images come at 30 Hz."""
    rng = np.random.default_rng(seed)
    errors = []
    for i in range(round(30 * seconds)):
        captured = host_from + round(i / 30 * 1e9)
        device = device_from + round(i / 30 * 1e9 * (1 - drift))
        arrived = captured + FASTEST_NS + round(rng.exponential(3e6))
        stamp = clock.capture_ns(device, arrived)
        assert stamp <= arrived
        errors.append((stamp - captured - FASTEST_NS) * 1e-6)
    return np.array(errors)


@pytest.mark.parametrize("drift", [0.0, 7.5e-5, -7.5e-5])
def test_drift_of_a_real_camera_is_removed(drift):
    clock = DeviceClock()
    errors = _play(clock, 300, drift=drift)
    # Uncorrected timestamps would be off by 22 ms at the end.
    assert np.abs(errors[30 * 60 :]).max() < 0.1
    assert np.abs(errors[30 * 10 :]).max() < 3.0
    assert clock.drift == pytest.approx(drift, abs=1e-6)
    assert clock.restarts == 0


def test_timestamps_never_go_back_and_have_no_jitter():
    clock, rng = DeviceClock(), np.random.default_rng(1)
    stamps = [
        clock.capture_ns(round(i / 30 * 1e9), round(i / 30 * 1e9) + 10**12 + round(rng.exponential(20e6)))
        for i in range(900)
    ]
    gaps = np.diff(stamps)
    assert gaps.min() > 0
    assert np.abs(gaps[300:] - 1e9 / 30).max() < 2e6


def test_time_goes_on_if_timestamps_were_too_late():
    """The first image was late and a pause came after it, so the line is too high for six seconds. While it
    comes down, one image is delayed, and the images after it come in a burst."""
    captured = [0, *(3 * 10**9 + round(i / 30 * 1e9) for i in range(200))]
    arrived = [at + FASTEST_NS for at in captured]
    arrived[0] += 400_000_000
    arrived[85] += 400_000_000
    for i in range(86, len(arrived)):
        arrived[i] = max(arrived[i], arrived[i - 1] + 3_000_000)
    clock = DeviceClock()
    stamps = [clock.capture_ns(at, came) for at, came in zip(captured, arrived, strict=True)]
    assert np.diff(stamps).min() >= 3_000_000
    assert all(stamp <= came for stamp, came in zip(stamps, arrived, strict=True))
    assert np.abs(np.subtract(stamps, captured)[120:] - FASTEST_NS).max() < 1000


@pytest.mark.parametrize("device_from", [0, 10**15])
def test_a_device_clock_that_restarts_or_jumps_ahead_begins_a_new_line(device_from):
    clock = DeviceClock()
    _play(clock, 20, device_from=500 * 10**9)
    errors = _play(clock, 20, device_from=device_from, host_from=987_684_321_000_000, seed=3)
    assert clock.restarts == 1
    assert np.abs(errors[90:]).max() < 2.0


def test_a_delayed_image_has_the_timestamp_of_its_capture():
    clock = DeviceClock()
    _play(clock, 20)
    device, host = 10**9 + 20 * 10**9, 987_654_321_000_000 + 20 * 10**9
    stamp = clock.capture_ns(device, host + 400_000_000)
    assert abs(stamp - host - FASTEST_NS) < 2e6
    assert clock.restarts == 0
