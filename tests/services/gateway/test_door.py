"""No reader can take the sessions of others, however often it connects."""

import select
import socket
import ssl
import time

import pytest
import zenoh

from huepose_protos import PoseClient
from huepose_protos.client import open_session
from huepose_services.gateway_door import BURST_BYTES, HANDSHAKE_S, RATE_BYTES_S, _Reader

from .conftest import credentials, tls

pytestmark = pytest.mark.live


def test_fifty_readers_with_one_certificate_lock_nobody_out(start, authority, wait_until):
    one = start(tls=tls(authority), sessions_per_reader=4)
    address = f"tls/localhost:{one.port}"
    greedy = [open_session([address], **credentials(authority, "robot2")) for _ in range(50)]
    wait_until(lambda: one.work._door.refused >= 46, 30.0)
    with PoseClient(address, **credentials(authority, "robot1")) as reader:
        one.say_until(lambda: reader.latest() is not None)
        wait_until(lambda: sum(bool(session.info.peers_zid()) for session in greedy) == 4)
        wait_until(lambda: len(one.work._outside.info.peers_zid()) == 5)
        for session in greedy:
            session.close()
        wait_until(lambda: len(one.work._outside.info.peers_zid()) == 1)
        with PoseClient(address, **credentials(authority, "robot2")) as again:
            one.say_until(lambda: again.latest() is not None)


def test_who_does_not_say_who_he_is_takes_no_place_for_long(start, authority):
    one = start(tls=tls(authority))
    silent = [socket.create_connection(("127.0.0.1", one.port)) for _ in range(60)]
    with PoseClient(f"tls/localhost:{one.port}", **credentials(authority, "robot1")) as reader:
        one.say_until(lambda: reader.latest() is not None, 15.0)
    for link in silent:
        link.close()


def test_connections_without_a_session_block_only_their_own_address_for_a_short_time(start, wait_until):
    one = start(host="0.0.0.0", sessions_per_reader=8)
    silent = [socket.create_connection(("127.0.0.1", one.port), 10.0, ("127.0.0.2", 0)) for _ in range(8)]
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as reader:
        wait_until(lambda: reader.connected, HANDSHAKE_S)
        assert not select.select(silent, [], [], 0.0)[0], "they were closed before"
    for link in silent:
        assert link.recv(1) == b"", "it is closed"
        link.close()


def test_a_reader_that_asks_without_end_is_slowed_and_the_others_are_not(start, authority, wait_until):
    one = start(tls=tls(authority))
    address = f"tls/localhost:{one.port}"
    with (
        PoseClient(address, **credentials(authority, "robot1")) as reader,
        open_session([address], **credentials(authority, "robot2")) as greedy,
    ):
        one.say_until(lambda: reader.latest() is not None and greedy.info.peers_zid())
        asked, started = one.work._asked, time.monotonic()
        while time.monotonic() - started < 3.0:
            for _ in range(50):
                greedy.get("huepose/*/*/remote/**", zenoh.handlers.RingChannel(1), timeout=0.5)
            pose = one.say(9000 + int(1000 * (time.monotonic() - started)))
            time.sleep(0.01)
        asked, took_s = one.work._asked - asked, time.monotonic() - started
        # A request takes about 30 bytes; without a limit there are three times as many.
        assert asked < (BURST_BYTES + (took_s + 1.0) * RATE_BYTES_S) / 25
        wait_until(lambda: reader.latest().frame_id == pose.frame_id, 2.0)


def test_all_sessions_of_a_reader_share_one_rate_limit():
    reader = _Reader()
    assert reader.wait_s(BURST_BYTES) == 0.0
    assert reader.wait_s(RATE_BYTES_S) == pytest.approx(1.0, abs=0.1)
    assert reader.wait_s(RATE_BYTES_S) == pytest.approx(2.0, abs=0.1)


def test_the_door_speaks_tls_of_today_alone(start, authority):
    one = start(tls=tls(authority))
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        old.maximum_version = ssl.TLSVersion.TLSv1_1
    with socket.create_connection(("127.0.0.1", one.port)) as link, pytest.raises(OSError):
        old.wrap_socket(link)
