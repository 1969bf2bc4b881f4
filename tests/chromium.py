"""A headless Chromium that tests talk to over a pipe, in its own protocol: no network, no further package."""

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_LIMIT_S, _PATIENCE_S = 60.0, 30.0


class Browser:
    """One page of one browser; frames are looked into by the origin of their address.

    Args:
        profile: an empty folder.
        width, height: of the window, px.
        dark: whether the reader prefers dark.

    Attributes:
        complaints: what the page said on the console, and exceptions of its scripts.
        requests: addresses that the page asked for, its own and `data:` left out.
    """

    def __init__(self, profile: Path, width: int = 1280, height: int = 900, dark: bool = False):
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()

        def hand_over():
            for number, end in [
                (n, fcntl.fcntl(e, fcntl.F_DUPFD, 10)) for n, e in ((3, to_browser), (4, from_browser))
            ]:
                os.dup2(end, number)

        # the copies are made in the child, which has no threads yet: file numbers 3 and 4 are the protocol's
        self._process = subprocess.Popen(
            [
                CHROMIUM,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                "--disable-features=IsolateOrigins,site-per-process",
                "--remote-debugging-pipe",
                f"--user-data-dir={profile}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=hand_over,
            close_fds=False,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._text, self._number, self._session = b"", 0, None
        self.complaints, self.requests, self._loaded = [], [], False
        self._url, self._worlds = "", {}
        page = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(width, height, dark=dark)

    def call(self, method, **parameters):
        """One command of the protocol; returns its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def _next(self):
        end = time.monotonic() + _LIMIT_S
        while b"\0" not in self._text:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            assert ready, "the browser is silent"
            part = os.read(self._in, 1 << 20)
            assert part, "the browser has ended"
            self._text += part
        one, _, self._text = self._text.partition(b"\0")
        message = json.loads(one)
        self._note(message.get("method"), message.get("params"))
        return message

    def _note(self, method, reported):
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.executionContextCreated":
            context = reported["context"]
            if context["auxData"].get("isDefault"):
                self._worlds[context["id"]] = context["origin"]
        elif method == "Runtime.executionContextDestroyed":
            self._worlds.pop(reported["executionContextId"], None)
        elif method == "Runtime.executionContextsCleared":
            self._worlds.clear()
        elif method == "Log.entryAdded":
            self.complaints.append(reported["entry"]["text"] + " " + reported["entry"].get("url", ""))
        elif method == "Runtime.consoleAPICalled":
            self.complaints.append(str(reported["args"]))
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(reported["exceptionDetails"]))
        elif method == "Network.requestWillBeSent":
            url = reported["request"]["url"]
            self.requests += [] if url == self._url or url.startswith("data:") else [url]

    def resize(self, width: int, height: int = 900, *, dark: bool = False, mobile: bool = False):
        """The window, and what its reader prefers."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, url: str):
        """Go to an address, without waiting for it."""
        self._loaded, self._url = False, url
        self.call("Page.navigate", url=url)

    def show(self, page: Path, width: int, *, dark: bool = False, height: int = 900):
        """Open a page of this host of that size, until it has loaded; earlier complaints are forgotten."""
        self.complaints, self.requests = [], []
        self.resize(width, height, dark=dark, mobile=width < 600)
        self.open(page.as_uri())
        while not self._loaded:
            self._next()

    def run(self, script: str):
        """Value of a JavaScript expression in the page."""
        reported = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in reported, reported
        return reported["result"].get("value")

    def ask(self, code: str, frame: str = ""):
        """The value of an expression in the page, or in its frame of an origin; None while there is none."""
        self.call("Runtime.evaluate", expression="0")  # takes in what has happened since
        world = next((i for i, origin in self._worlds.items() if origin == frame), None) if frame else None
        if frame and world is None:
            return None
        where = {} if world is None else {"contextId": world}
        with contextlib.suppress(AssertionError):
            reported = self.call(
                "Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True, **where
            )
            return reported["result"].get("value")
        return None

    def until(self, code: str, frame: str = "", limit_s: float = _PATIENCE_S):
        """Wait until an expression is true; returns its value."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            value = self.ask(code, frame)
            if value:
                return value
            time.sleep(0.1)
        raise AssertionError(
            f"never true: {code}; the page says {self.ask('document.body.innerText', frame)!r}"
        )

    def mouse(self, kind: str, x: float, y: float, **more):
        """An event of the mouse."""
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)

    def picture(self, path: Path):
        """What is seen, as a file."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self):
        """End the browser."""
        self._session = None
        with contextlib.suppress(AssertionError, OSError):
            self.call("Browser.close")
        os.close(self._out)
        os.close(self._in)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
