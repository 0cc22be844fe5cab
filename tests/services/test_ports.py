import socket

from huepose_services.runtime.run_folder import free_ports, is_taken, make_folder


def test_ports_in_use_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    first = free_ports(3)
    with socket.socket(socket.AF_UNIX) as taken:
        taken.bind(str(make_folder() / str(first + 1)))
        taken.listen()
        assert is_taken(make_folder(), first + 1)
        second = free_ports(3)
        assert second > first
    assert free_ports(3) == first, "the port of a socket whose process has ended is free"
