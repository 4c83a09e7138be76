"""A real browser, Chromium, driven through its DevTools protocol by a WebSocket."""

import base64
import contextlib
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

from websockets.sync.client import connect

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-extensions", "--disable-background-networking", "--disable-component-update", "--no-proxy-server"),
    *("--disable-sync", "--disable-default-apps", "--mute-audio", "--hide-scrollbars"),
)


class Page:
    """A tab of the browser."""

    def __init__(self, socket) -> None:
        self._socket = socket
        self._number = 0
        self.said: list[str] = []  # errors and warnings of the page: none is right

    def do(self, method: str, **parameters):
        """Answer of the browser to a command."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(30.0))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message) -> None:
        content = message.get("params", {})
        if message.get("method") == "Log.entryAdded" and content["entry"]["level"] in ("error", "warning"):
            self.said.append(f"{content['entry']['text']} {content['entry'].get('url', '')}")
        elif message.get("method") == "Runtime.exceptionThrown":
            self.said.append(json.dumps(content["exceptionDetails"]))

    def open(self, url: str) -> None:
        for domain in ("Page", "Runtime", "Log"):
            self.do(f"{domain}.enable")
        self.do("Page.navigate", url=url)

    def get(self, expression: str):
        """Value of an expression of JavaScript in the page; of a promise, what it comes to."""
        found = self.do("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, expression: str, timeout_s: float = 120.0):
        """Wait until an expression is true; its value."""
        end_s = time.monotonic() + timeout_s
        while not (value := self.get(expression)):
            assert time.monotonic() < end_s, (expression, self.get("document.body.innerText"), self.said)
            time.sleep(0.05)
        return value

    def resize(self, width: int, *, is_dark: bool = False) -> None:
        self.do("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        features = [{"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}]
        self.do("Emulation.setEmulatedMedia", features=features)

    def picture(self, path: Path) -> None:
        """Save what the whole page looks like, as PNG."""
        shot = self.do("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))


@contextlib.contextmanager
def browser(folder: Path):
    """A page of a browser of its own, which ends with the test."""
    profile = folder / "profile"
    command = [PROGRAM, *_FLAGS, "--remote-debugging-port=0", f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        ready, end_s = profile / "DevToolsActivePort", time.monotonic() + 60.0
        while not (ready.exists() and "\n" in ready.read_text()):
            assert process.poll() is None, "the browser ended"
            assert time.monotonic() < end_s
            time.sleep(0.05)
        port = ready.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            [target] = [each for each in json.load(answer) if each["type"] == "page"]
        with connect(target["webSocketDebuggerUrl"], max_size=1 << 26) as socket:
            yield Page(socket)
    finally:
        process.kill()
        process.wait()
