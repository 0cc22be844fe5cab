import pytest

from huepose_services.bus_bench import bench_bus

pytestmark = [pytest.mark.live, pytest.mark.pipeline]


def test_frames_cross_by_shared_memory_and_by_tcp():
    """A hop is not free, and is over well before the next frame is due."""
    stages = bench_bus(seconds=1.0)
    assert [s.name for s in stages] == ["bus/shared_memory", "bus/tcp"]
    for s in stages:
        assert 0.01 < s.wall_ms_p50 < 33.0
