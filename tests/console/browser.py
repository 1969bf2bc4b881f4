"""A real browser, driven over a pipe: headless Chromium and its DevTools protocol, no library between."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import time

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_PATIENCE_S = 30.0


class Browser:
    """One page in a browser of its own; frames are looked into by the number of their address's port.

    Args:
        profile: an empty folder.
        width, height: of the window, px.
        dark: whether the reader prefers dark.
    """

    def __init__(self, profile, width=1280, height=900, dark=False):
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()

        def place():
            os.dup2(to_browser, 13)
            os.dup2(from_browser, 14)
            os.dup2(13, 3)
            os.dup2(14, 4)

        self._process = subprocess.Popen(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
             "--disable-features=IsolateOrigins,site-per-process", f"--user-data-dir={profile}",
             "about:blank"],
            preexec_fn=place, close_fds=False, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._left, self._number, self._session = b"", 0, None
        self.told, self._worlds = [], {}
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._ask("Emulation.setEmulatedMedia", features=[scheme])

    def _ask(self, method, **parameters):
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            reply = self._next()
            if reply.get("id") == self._number:
                assert "error" not in reply, (method, reply)
                return reply["result"]

    def _next(self):
        while b"\0" not in self._left:
            part = os.read(self._in, 1 << 16)
            assert part, "the browser has ended"
            self._left += part
        line, _, self._left = self._left.partition(b"\0")
        message = json.loads(line)
        self._note(message.get("method"), message.get("params", {}))
        return message

    def _note(self, method, told):
        """Frames by their addresses, and everything that a console of a browser would show in red."""
        if method == "Runtime.executionContextCreated":
            context = told["context"]
            if context["auxData"].get("isDefault"):
                self._worlds[context["id"]] = context["origin"]
        elif method == "Runtime.executionContextDestroyed":
            self._worlds.pop(told["executionContextId"], None)
        elif method == "Runtime.executionContextsCleared":
            self._worlds.clear()
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.told.append(told["entry"]["text"] + " " + told["entry"].get("url", ""))
        elif method == "Runtime.exceptionThrown":
            self.told.append(told["exceptionDetails"]["text"])

    def open(self, url):
        """Go to an address."""
        self._ask("Page.navigate", url=url)

    def ask(self, code, frame=""):
        """The value of an expression in the page, or in its frame of an origin; None while there is none."""
        self._ask("Runtime.evaluate", expression="0")  # takes in what has happened since
        world = next((i for i, origin in self._worlds.items() if origin == frame), None) if frame else None
        if frame and world is None:
            return None
        where = {} if world is None else {"contextId": world}
        with contextlib.suppress(AssertionError):
            told = self._ask(
                "Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True, **where
            )
            return told["result"].get("value")
        return None

    def until(self, code, frame="", limit_s=_PATIENCE_S):
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

    def picture(self, path):
        """What is seen, as a file."""
        path.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"]))

    def close(self):
        """End the browser."""
        self._session = None
        with contextlib.suppress(AssertionError, OSError):
            self._ask("Browser.close")
        os.close(self._out)
        os.close(self._in)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
