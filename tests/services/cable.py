"""A network cable between two network namespaces, in software: it delays, loses, and can be cut.

python cable.py NAMESPACE ADDRESS NAMESPACE ADDRESS

makes a device `cable` with that address in each. Commands are lines on standard input: `delay MS`, `loss
SHARE` (of the packets, each way), `rate MBIT` (a second, each way), `cut`, `mend`. The answer to each is a
line with the bytes sent each way so far.
"""

import ctypes
import fcntl
import heapq
import os
import random
import selectors
import struct
import subprocess
import sys
import time
from contextlib import suppress

_MTU = 1500
_QUEUE_S = 0.1
"""A packet that would wait longer is lost."""


def _device(namespace, address):
    """The end of the cable in a namespace, as a file of Ethernet frames."""
    libc, own = ctypes.CDLL(None, use_errno=True), os.open("/proc/self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    if libc.setns(there, 0):
        raise OSError(ctypes.get_errno(), "setns")
    end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    tunsetiff, tap_without_header = 0x400454CA, 0x0002 | 0x1000
    fcntl.ioctl(end, tunsetiff, struct.pack("16sH22x", b"cable", tap_without_header))
    libc.setns(own, 0)
    for command in (f"addr add {address} dev cable", "link set cable up", "link set lo up"):
        subprocess.run(["ip", "-n", namespace, *command.split()], check=True)
    return end


def main():
    """Runs until standard input ends."""
    ends = [_device(sys.argv[1], sys.argv[2]), _device(sys.argv[3], sys.argv[4])]
    delay_s, loss, whole = 0.0, 0.0, True
    chance, order = random.Random(1), 0
    bytes_s, free = float("inf"), [0.0, 0.0]  # when each direction is free again
    sent = [0, 0]
    under_way = []  # arrival time, order, end, packet
    selector = selectors.DefaultSelector()
    for end in (*ends, 0):
        selector.register(end, selectors.EVENT_READ)
    print("there", flush=True)
    while True:
        wait_s = None if not under_way else max(0.0, under_way[0][0] - time.monotonic())
        for key, _ in selector.select(wait_s):
            if key.fd == 0:
                line = os.read(0, 4096).decode()
                if not line:
                    return
                for what, *value in map(str.split, line.splitlines()):
                    delay_s = 1e-3 * float(value[0]) if what == "delay" else delay_s
                    bytes_s = 1e6 / 8 * float(value[0]) if what == "rate" else bytes_s
                    loss = float(value[0]) if what == "loss" else loss
                    whole = what == "mend" or (whole and what != "cut")
                    print(*sent, flush=True)
                continue
            side = ends.index(key.fd)
            for _ in range(64):
                try:
                    packet = os.read(key.fd, _MTU + 100)
                except BlockingIOError:
                    break
                now = time.monotonic()
                if whole and chance.random() >= loss and free[side] - now < _QUEUE_S:
                    sent[side] += len(packet)
                    order += 1
                    free[side] = max(free[side], now) + len(packet) / bytes_s
                    heapq.heappush(under_way, (free[side] + delay_s, order, ends[1 - side], packet))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, end, packet = heapq.heappop(under_way)
            with suppress(OSError):  # its queue is full, as a switch's may be
                os.write(end, packet)


if __name__ == "__main__":
    main()
