import socket
import tempfile
from pathlib import Path

import pytest

from huepose.support.errors import InputError
from huepose_services.runtime.config import ViewerConfig
from huepose_services.runtime.run_folder import free_ports, free_tcp_port, is_taken, make_folder
from huepose_services.viewer_ports import check_ports_free, free_port


def test_the_data_of_a_page_have_another_port_than_the_page():
    port = free_tcp_port()
    assert free_port(port, port) > port
    assert free_port(port, 9090) == port


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.2", "0.0.0.0"])
def test_the_page_needs_its_port_on_all_addresses(address):
    with socket.socket() as other:
        other.bind((address, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"viewer.web_port {port}: found Address already in use"):
            check_ports_free(ViewerConfig(web_port=port, grpc_port=free_tcp_port()))


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


@pytest.mark.parametrize(
    ("name", "said"),
    [("caf\udce9", "characters"), ("a?b", "characters"), ("a#b", "characters"), ("漢" * 30, "of 1.. bytes")],
)
def test_a_folder_whose_sockets_would_have_no_address_is_refused(name, said, monkeypatch):
    with tempfile.TemporaryDirectory() as folder:  # its path is short
        monkeypatch.setenv("HUEPOSE_RUN", str(Path(folder) / name))
        with pytest.raises(InputError, match=f"a path .*{said}"):
            make_folder()
        monkeypatch.setenv("HUEPOSE_RUN", str(Path(folder) / "é ü"))
        assert make_folder().is_dir()
