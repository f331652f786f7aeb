"""Drives headless Chromium by the DevTools protocol over a pipe, for tests of pages."""

import itertools
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

LAYOUT = Path(__file__).with_name("page_layout.js")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
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

    def open(self, path, width=1280):
        """Open the file at `path` in a window of this width."""
        self.resize(width)
        self.call("Page.navigate", url=Path(path).as_uri())
        self.wait_for("document.readyState === 'complete'")

    def resize(self, width):
        """Change the width of the window."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)

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


def find_browser():
    """Return the path of Chromium, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def layout_faults(binary, site, pages, widths, profile):
    """Return what does not fit on `pages` of folder `site` at `widths` in pixels: [width, page, fault, text]."""
    faults = []
    with Browser(binary, profile) as browser:
        for page in pages:
            browser.open(Path(site) / page)
            for width in widths:
                browser.resize(width)
                browser.evaluate("new Promise((done) => setTimeout(done, 50))")  # for scripts that listen to the width
                found = browser.evaluate(LAYOUT.read_text(encoding="utf-8"))
                faults += [[width, page, *fault] for fault in found]
    return faults
