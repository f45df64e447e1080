"""A headless Chromium, driven through its DevTools protocol: what a page shows, asks for and complains of."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

PROGRAM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
MISSING = "there is no chromium on this machine"
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--remote-debugging-port=0"]  # fmt: skip
PATIENCE = 60


class Chromium:
    """A browser with one tab at a time; use it in a `with` block."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._process = subprocess.Popen([PROGRAM, *FLAGS, f"--user-data-dir={folder}", "about:blank"], stderr=subprocess.DEVNULL)
        port = folder / "DevToolsActivePort"
        end = time.monotonic() + PATIENCE
        while not (port.exists() and port.read_text().count("\n")):
            assert time.monotonic() < end and self._process.poll() is None, "chromium did not start"
            time.sleep(0.05)
        self.port = int(port.read_text().split()[0])

    def __enter__(self):
        return self

    def __exit__(self, *reason):
        self._process.terminate()
        self._process.wait(20)

    def tab(self, address, size=(1280, 900), dark=False, mobile=False):
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}/json/new?about:blank", method="PUT")
        told = json.loads(urllib.request.urlopen(request, timeout=PATIENCE).read())
        return Tab(told["webSocketDebuggerUrl"], address, size, dark, mobile)


class Tab:
    """One page: `asked` are the addresses that it asked for, `said` what it complained of."""

    def __init__(self, socket, address, size, dark, mobile):
        from websockets.sync.client import connect

        self._opened = ExitStack()
        self._socket = self._opened.enter_context(connect(socket, max_size=None, compression=None))
        self._number, self.asked, self.said = 0, [], []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.does(f"{domain}.enable")
        self.does("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=mobile)
        self.does("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])
        self.does("Page.navigate", url=address)

    def does(self, method, **parameters):
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            told = json.loads(self._socket.recv(timeout=PATIENCE))
            if told.get("id") == self._number:
                assert "error" not in told, told
                return told["result"]
            self._noted(told)

    def _noted(self, told):
        method, about = told.get("method"), told.get("params", {})
        if method == "Network.requestWillBeSent":
            self.asked.append(about["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.asked.append(about["url"])
        elif method == "Runtime.exceptionThrown":
            self.said.append(str(about["exceptionDetails"])[:500])
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning", "assert"):
            self.said.append(str(about["args"])[:500])
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            self.said.append(f"{about['entry']['text']} {about['entry'].get('url', '')}")

    def tells(self, code):
        found = self.does("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def waits(self, code, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not (found := self.tells(code)):
            assert time.monotonic() < end, f"never true: {code}; said {self.said}; text {self.tells('document.body.innerText')[:600]}"
            time.sleep(0.05)
        return found

    def presses(self, key, code=None):
        written = key if len(key) == 1 else ""
        self.does("Input.dispatchKeyEvent", type="keyDown", key=key, code=code or key, text=written)
        self.does("Input.dispatchKeyEvent", type="keyUp", key=key, code=code or key)

    def picture(self, path, whole=False):
        found = self.does("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(found["data"]))

    def stalls(self, seconds):
        """Let the page do nothing for a while, as one that hangs."""
        self._number += 1
        code = f"const end = performance.now() + {1e3 * seconds}; while (performance.now() < end) {{}}"
        self._socket.send(json.dumps({"id": self._number, "method": "Runtime.evaluate", "params": {"expression": code}}))

    def close(self):
        self._opened.close()
