"""Drive headless Chromium for tests through its debugging pipe, with the standard library only."""

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")


def program() -> str | None:
    """Find the path of the browser; None if it is not installed."""
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


class Page:
    """One open page: its events, and the actions of a reader."""

    def __init__(self, to_browser: int, from_browser: int):
        self._to, self._from = os.fdopen(to_browser, "wb", buffering=0), os.fdopen(from_browser, "rb")
        self._number, self._session = 0, ""
        self.events: list[dict[str, Any]] = []

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a DevTools command and get its result; events received meanwhile are stored."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        session = {"sessionId": self._session} if self._session else {}
        self._to.write(json.dumps(message | session).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        held = bytearray()
        while (byte := self._from.read(1)) != b"\0":
            assert byte, "the browser ended"
            held += byte
        return json.loads(held)

    def attach(self) -> None:
        """Open a tab and subscribe to its network, error and console events."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def open(self, path: Path, width: int = 1400, height: int = 900, *, scheme: str = "light") -> None:
        """Open a file in a window of the given size and colour scheme, and wait until it is loaded."""
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.events.clear()
        self.send("Page.navigate", url=path.resolve().as_uri())
        while not self.happened("Page.loadEventFired"):
            self.events.append(self._next())

    def happened(self, method: str) -> list[dict[str, Any]]:
        """Get the parameters of all events of one kind since the page was opened."""
        return [event["params"] for event in self.events if event.get("method") == method]

    def ask(self, expression: str) -> Any:
        """Evaluate a JavaScript expression."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def press(self, key: str) -> None:
        """Press a key."""
        code = {"Tab": 9, "Enter": 13, "Home": 36, "ArrowRight": 39}[key]
        for kind in ("keyDown", "keyUp"):
            extra = {"text": "\r"} if (key, kind) == ("Enter", "keyDown") else {}
            self.send("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **extra)

    def drag(self, element: str, begin: float, end: float) -> None:
        """Drag the mouse across an element, a JavaScript expression, from one share of its width to another."""
        box = self.ask(f"(r => [r.x, r.y, r.width, r.height])({element}.getBoundingClientRect())")
        y = box[1] + box[3] / 2.0
        moves = (("mouseMoved", begin), ("mousePressed", begin), ("mouseMoved", end), ("mouseReleased", end))
        for kind, share in moves:
            extra = {} if kind == "mouseMoved" and share == begin else {"button": "left", "buttons": 1, "clickCount": 1}
            self.send("Input.dispatchMouseEvent", type=kind, x=box[0] + share * box[2], y=y, **extra)

    def picture(self, path: Path, *, whole: bool = True) -> None:
        """Write a PNG of the whole page or of the window."""
        answer = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))


@contextmanager
def chromium(profile: Path) -> Iterator[Page]:
    """Start a browser with an empty profile, yield its page, and terminate it at the end of the block."""
    command_in, command_out = os.pipe()
    answer_in, answer_out = os.pipe()

    def as_the_protocol_asks() -> None:  # Chromium reads commands from descriptor 3 and writes answers to 4
        os.dup2(command_in, 103)
        os.dup2(answer_out, 104)
        os.dup2(103, 3)
        os.dup2(104, 4)

    found = program()
    assert found
    started = [found, *OPTIONS, "--remote-debugging-pipe", f"--user-data-dir={profile}"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running = subprocess.Popen(started, preexec_fn=as_the_protocol_asks, close_fds=False, **quiet)
    os.close(command_in)
    os.close(answer_out)
    page = Page(command_out, answer_in)
    try:
        page.attach()
        yield page
    finally:
        running.terminate()
        running.wait(20)
        page._to.close()
        page._from.close()
