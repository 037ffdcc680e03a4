"""A headless Chromium that shows a page: what it looks like, what it asks for, what goes wrong in it."""

import io
import json
import os
import select
import shutil
import subprocess
import time
from base64 import b64decode
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--hide-scrollbars --force-device-scale-factor=1 --window-size=1000,700 --remote-debugging-pipe"
)
PATIENCE = 300.0  # seconds


class Shown(NamedTuple):
    """A page: its pixels, what went wrong, and the addresses it asked for."""

    pixels: np.ndarray
    errors: list[str]
    addresses: list[str]


def show(page: Path | str, ready: str, profile: Path, size: tuple[int, int] | None = None) -> Shown:
    """The page of a file or an address, when the JavaScript expression `ready` is true.

    `profile` is an empty folder of the browser's own; `size` is that of the picture in pixels.
    """
    address = page if isinstance(page, str) else page.resolve().as_uri()
    with _Pipe(profile) as pipe:
        target = pipe.call("Target.createTarget", {"url": "about:blank"})["targetId"]
        pipe.session = pipe.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        for domain in ("Runtime", "Network", "Page", "Log"):
            pipe.call(f"{domain}.enable", {})
        if size:
            metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
            pipe.call("Emulation.setDeviceMetricsOverride", metrics)
        pipe.call("Page.navigate", {"url": address})
        while not pipe.call("Runtime.evaluate", {"expression": ready})["result"].get("value"):
            time.sleep(0.2)
            assert time.monotonic() < pipe.end, f"the page is not ready: {pipe.events}"
        wait = {"expression": "new Promise(done => setTimeout(done, 1000))", "awaitPromise": True}
        pipe.call("Runtime.evaluate", wait)
        picture = b64decode(pipe.call("Page.captureScreenshot", {"format": "png"})["data"])
        errors = [str(e["params"]) for e in pipe.events if e["method"] == "Runtime.exceptionThrown"]
        logged = [e["params"]["entry"] for e in pipe.events if e["method"] == "Log.entryAdded"]
        errors += [entry["text"] for entry in logged if entry["level"] == "error"]
        requests = [e["params"] for e in pipe.events if e["method"] == "Network.requestWillBeSent"]
        addresses = [request["request"]["url"] for request in requests]
    return Shown(np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int), errors, addresses)


class _Pipe:
    """The browser's debugging protocol over its file descriptors 3 and 4."""

    def __init__(self, profile: Path):
        import fcntl  # where there is none the test is skipped

        (theirs_in, self.out), (self.back, theirs_out) = os.pipe(), os.pipe()
        # Above 3 and 4, so that neither takes the place of the other. A shell connects them: this process has threads.
        high = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (theirs_in, theirs_out)]
        command = ["bash", "-c", f'exec "$@" 3<&{high[0]} 4>&{high[1]}', "browser", str(BROWSER), *FLAGS.split()]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.process = subprocess.Popen([*command, f"--user-data-dir={profile}"], pass_fds=high, **quiet)
        for end in (theirs_in, theirs_out, *high):
            os.close(end)
        self.session, self.number, self.unread, self.events = "", 0, b"", []
        self.end = time.monotonic() + PATIENCE

    def __enter__(self):
        return self

    def __exit__(self, kind, value, traceback):
        self.process.terminate()
        self.process.wait(30)
        os.close(self.out)
        os.close(self.back)

    def call(self, method: str, parameters: dict) -> dict:
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        os.write(self.out, json.dumps(message | ({"sessionId": self.session} if self.session else {})).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.number:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def receive(self) -> dict:
        while b"\0" not in self.unread:
            assert select.select([self.back], [], [], max(0.0, self.end - time.monotonic()))[0], "no answer"
            piece = os.read(self.back, 1 << 16)
            assert piece, "the browser has ended"
            self.unread += piece
        message, _, self.unread = self.unread.partition(b"\0")
        return json.loads(message)
