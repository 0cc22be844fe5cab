"""Headless Chromium for tests: pictures of a page, requested through a pipe; graphics by software."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import UInt8

PROGRAM = next(
    filter(
        None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"))
    ),
    None,
)
"""The browser of this machine, or None."""

_ANSWERS_WITHIN_S = 60.0
_SWITCHES = (
    "--headless=new",
    # Root may not use the sandbox, and the page is our own.
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-first-run",
    # No name but this machine's is resolved: the page must work without the internet.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-pipe",
)


class NotYetError(RuntimeError):
    """The page is opening another address, in a process that has not started yet."""


class Page:
    """One page of a browser, controlled by the DevTools protocol: JSON that ends with a zero byte."""

    def __init__(self, write: int, read: int) -> None:
        self._write, self._read = write, read
        self._number, self._rest = 0, b""
        self._session: str | None = None

    def attach(self) -> None:
        """Attaches to the browser's first page."""
        while not (pages := self._pages()):
            time.sleep(0.1)
        target = pages[0]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def _pages(self) -> list[str]:
        targets = self.ask("Target.getTargets")["targetInfos"]
        return [target["targetId"] for target in targets if target["type"] == "page"]

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; RuntimeError if it is an error. Events are skipped."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = json.loads(self._line())
            if answer.get("id") == self._number:
                if "error" in answer:
                    said = f"{method}: {answer['error']}"
                    raise NotYetError(said) if "active page" in said else RuntimeError(said)
                result: dict[str, Any] = answer["result"]
                return result

    def _line(self) -> bytes:
        while b"\0" not in self._rest:
            if not select.select([self._read], [], [], _ANSWERS_WITHIN_S)[0]:
                raise TimeoutError(f"the browser did not answer for {_ANSWERS_WITHIN_S:.0f} s")
            more = os.read(self._read, 1 << 20)
            if not more:
                raise RuntimeError("the browser ended")
            self._rest += more
        line, self._rest = self._rest.split(b"\0", 1)
        return line

    def picture(self) -> UInt8:
        """What the page shows now, (H, W, 3) RGB."""
        data = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None
        return decoded[..., ::-1].astype(np.uint8)

    def picture_when(self, shown: Callable[[UInt8], bool], timeout_s: float) -> UInt8:
        """The first picture of which `shown` is true, or the last one before the time is over."""
        end = time.monotonic() + timeout_s
        while True:
            try:
                picture = self.picture()
            except NotYetError:
                assert time.monotonic() < end, "the page never became active"
            else:
                if shown(picture) or time.monotonic() > end:
                    return picture
            time.sleep(1.0)


@contextmanager
def opened(address: str, folder: Path, width: int = 1400, height: int = 840) -> Iterator[Page]:
    """A page of headless Chromium at an address. folder: for the browser's own files."""
    assert PROGRAM is not None
    to_read, to_write = os.pipe()
    from_read, from_write = os.pipe()
    # The browser reads commands from its file 3, and answers in its file 4.
    command = ["bash", "-c", f'exec "$@" 3<&{to_read} 4>&{from_write}', "bash", PROGRAM, *_SWITCHES]
    process = subprocess.Popen(
        [*command, f"--user-data-dir={folder}", "about:blank"],
        pass_fds=(to_read, from_write),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.close(to_read)
    os.close(from_write)
    try:
        page = Page(to_write, from_read)
        page.attach()
        page.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        page.ask("Page.navigate", url=address)
        yield page
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        os.close(to_write)
        os.close(from_read)


def save(picture: UInt8, path: Path) -> None:
    """Writes a picture to a file, for people."""
    cv2.imwrite(str(path), picture[..., ::-1])
