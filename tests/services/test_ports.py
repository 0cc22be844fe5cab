import socket

from huepose_services.runtime.ports import free_ports


def test_ports_that_somebody_has_are_passed_over():
    first = free_ports(3)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", first + 1))
        second = free_ports(3)
        assert second > first
        for place in range(3):
            with socket.socket() as mine:
                mine.bind(("127.0.0.1", second + place))
