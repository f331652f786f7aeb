"""Drives headless Chromium by the DevTools protocol over a pipe, for tests of pages."""

import base64
import itertools
import json
import os
import subprocess
import time
from pathlib import Path

from tests.page_layout import FLAGS, find_browser

__all__ = ["Browser", "find_browser"]

_READS, _WRITES = 3, 4
"""File descriptors of the pipes in Chromium."""


class Browser:
    """A page in headless Chromium. `errors` are what its console and its loader complained of."""

    def __init__(self, binary, profile):
        """Start `binary` with the folder `profile` for its data."""
        reads, self._to = os.pipe()
        self._from, writes = os.pipe()

        # bash moves the pipes to their places: a function for that would run between fork and exec, beside threads.
        places = f'exec 9>&{writes} {_READS}<&{reads} {_WRITES}>&9 9>&-; exec "$0" "$@"'
        command = [binary, *FLAGS, "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(
            ["bash", "-c", places, *command],
            pass_fds=(reads, writes),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(reads)
        os.close(writes)
        self._numbers, self._text, self._session = itertools.count(1), b"", None
        self.errors, self.requests = [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method, **parameters):
        """Return the result of a method of the protocol."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def _receive(self):
        """Return the next message; note it if it is of an error or of a request."""
        while b"\0" not in self._text:
            part = os.read(self._from, 1 << 20)
            assert part, "Chromium has ended"
            self._text += part
        message, _, self._text = self._text.partition(b"\0")
        found = json.loads(message)
        method, content = found.get("method"), found.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(content["exceptionDetails"]["exception"]["description"])
        elif method == "Runtime.consoleAPICalled" and content["type"] in ("error", "warning", "assert"):
            self.errors.append(str(content["args"]))
        elif method == "Log.entryAdded":
            self.errors.append(content["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(content["request"]["url"])
        return found

    def open(self, path, width=1280, height=900, *, is_dark=False):
        """Open the file at `path` in a window of this size and scheme."""
        self.resize(width, height)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call("Page.navigate", url=Path(path).as_uri())
        self.wait_for("document.readyState === 'complete'")

    def resize(self, width, height):
        """Change the size of the window."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def evaluate(self, expression):
        """Return the value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait_for(self, expression, within_s=30):
        """Return the first true value of a JavaScript expression."""
        end = time.monotonic() + within_s
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < end, f"not within {within_s} s: {expression}"
            time.sleep(0.05)
        return value

    def mouse(self, kind, x, y, **buttons):
        """Send a mouse event: `Moved`, `Pressed` or `Released`."""
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **buttons)

    def drag(self, start, end):
        """Press the left button at `start`, move to `end`, and release it."""
        left = {"button": "left", "clickCount": 1}
        self.mouse("Moved", *start)
        self.mouse("Pressed", *start, buttons=1, **left)
        for part in (0.25, 0.5, 0.75, 1.0):
            self.mouse("Moved", *(a + part * (b - a) for a, b in zip(start, end, strict=True)), buttons=1)
        self.mouse("Released", *end, **left)

    def screenshot(self, path):
        """Write a picture of the window."""
        Path(path).write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
