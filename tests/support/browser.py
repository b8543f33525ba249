"""A real Chromium without a window, driven by its own debugging protocol."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from live import HANG_S
from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_browser = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("CI"), reason="Chromium is not installed"
)
"""In CI it has to be there: .ci/run installs it."""


class Tab:
    """One page of the browser; what it logs and asks for is kept."""

    def __init__(self, address: str) -> None:
        self._socket = connect(address, max_size=None, legacy=True)
        self._number = 0
        self.problems: list[str] = []
        """Errors and warnings on its console, and requests that failed."""
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.does(f"{domain}.enable")

    def does(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(HANG_S))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, told = message.get("method"), message.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(told["url"])
        elif method == "Network.loadingFailed" and not told.get("canceled"):
            self.problems.append(f"request failed: {told.get('errorText')}")
        elif method == "Runtime.exceptionThrown":
            self.problems.append(str(told["exceptionDetails"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.problems.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            self.problems.append(str(told["args"]))

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression; of a promise what it gives."""
        found = self.does(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, expression: str) -> Any:
        """Wait until an expression is true in the page."""
        end_s = time.monotonic() + HANG_S
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < end_s, f"never true: {expression}"
            time.sleep(0.05)
        return value

    def open(self, address: str, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Go to an address on a screen of a size, with the colours that the user prefers."""
        self.does(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.does("Emulation.setEmulatedMedia", features=[scheme])
        self.does("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def picture(self, path: Path, whole: bool = True) -> None:
        """Save what it shows as PNG."""
        found = self.does("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))


@contextmanager
def browser(folder: Path) -> Iterator[Tab]:
    """A browser with an empty profile, ended at the end."""
    assert CHROMIUM is not None, "install chromium"
    command = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
        "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank",
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port = _port(folder, process)
        yield Tab(_page(port))
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(HANG_S)
        process.kill()
        process.wait()


def _port(folder: Path, process: subprocess.Popen[bytes]) -> int:
    found = folder / "DevToolsActivePort"
    end_s = time.monotonic() + HANG_S
    while not (found.exists() and found.read_text().strip()):
        assert process.poll() is None, "Chromium ended"
        assert time.monotonic() < end_s, "Chromium did not start"
        time.sleep(0.05)
    return int(found.read_text().split()[0])


def _page(port: int) -> str:
    import urllib.request

    end_s = time.monotonic() + HANG_S
    while True:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=HANG_S) as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        if pages:
            return str(pages[0]["webSocketDebuggerUrl"])
        assert time.monotonic() < end_s, "Chromium has no page"
        time.sleep(0.05)
