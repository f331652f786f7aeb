"""Looks at the pages of a site in headless Chromium, for the tests of the documentation."""

import json
import shutil
import subprocess
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread

SCRIPT = Path(__file__).with_suffix(".js")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def find_browser():
    """Return the path of Chromium, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def layout_faults(browser, site, pages, widths, profile, timeout_s=600):
    """Return what does not fit on `pages` of folder `site` at `widths` in pixels: [width, page, fault, text]."""
    answers = Queue()
    script = f"const PAGES = {json.dumps(pages)}, WIDTHS = {json.dumps(widths)};\n{SCRIPT.read_text(encoding='utf-8')}"
    start = f"<!doctype html><meta charset=utf-8><body><script>{script}</script>".encode()

    class Handler(SimpleHTTPRequestHandler):
        def do_GET(self):
            if self.path != "/layout-check":
                return super().do_GET()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            return self.wfile.write(start)

        def do_POST(self):
            answers.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=site)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/layout-check"
        command = [browser, *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return answers.get(timeout=timeout_s)
        finally:
            process.terminate()
            process.wait()
            server.shutdown()
