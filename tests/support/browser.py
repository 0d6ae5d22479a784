"""A headless Chromium for the tests of pages, driven over a pipe by the DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# Of all texts that are shown, in HTML and in SVG; what is behind is the nearest background that is opaque.
_LEAST_CONTRAST = """(() => {
  const linear = c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const parts = colour => (colour.match(/[\\d.]+/g) || []).map(Number);
  const luminance = c => 0.2126 * linear(c[0] / 255) + 0.7152 * linear(c[1] / 255) + 0.0722 * linear(c[2] / 255);
  const behind = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = parts(getComputedStyle(at).backgroundColor);
      if (colour.length && (colour.length < 4 || colour[3] === 1)) return colour;
    }
    return [255, 255, 255];
  };
  let least = [99, ''];
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = texts.nextNode());) {
    const element = node.parentElement, style = getComputedStyle(element), box = element.getBoundingClientRect();
    if (!node.data.trim() || !box.width || style.visibility === 'hidden' || element.closest('script, style, option')) continue;
    const colour = parts(element.closest('svg') ? style.fill : style.color);
    const [a, b] = [luminance(colour), luminance(behind(element))].sort((p, q) => q - p);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < least[0]) least = [ratio, node.data.trim().slice(0, 60)];
  }
  return least;
})()"""  # noqa: E501
PATIENCE = 60.0  # s for an answer, on a machine that does other things besides


def program() -> str | None:
    """The browser of this machine."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One tab: it opens files, evaluates JavaScript, clicks and types.

    It lists its requests, the windows that it would open, its errors, and all messages of its console.
    """

    def __init__(self, to: int, back: int) -> None:
        self._to, self._back, self._buffer, self._number = to, back, b"", 0
        self._session: str | None = None
        self.requests: list[str] = []
        self.windows: list[str] = []
        self.errors: list[str] = []
        self.messages: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol, and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._heard(answer)
        raise TimeoutError(method)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            part = os.read(self._back, 1 << 20)
            if not part:
                raise EOFError("The browser has ended.")
            self._buffer += part
        text, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(text)

    def _heard(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        if event.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif event.get("method") == "Page.windowOpen":
            self.windows.append(params["url"])
        elif event.get("method") == "Runtime.consoleAPICalled":
            self.messages.append(" ".join(str(each.get("value", each["type"])) for each in params["args"]))
        elif event.get("method") == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif event.get("method") == "Log.entryAdded":
            self.messages.append(params["entry"]["text"])
            if params["entry"]["level"] == "error":
                self.errors.append(params["entry"]["text"])

    def size(self, width: int, height: int, scale: float = 1.0) -> None:
        """Set the size of the window, in CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=scale, mobile=width < 600,
        )  # fmt: skip
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < 600)

    def scheme(self, name: str) -> None:
        """Set the colour scheme that the reader prefers, light or dark."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def _of_browser(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method that answers for the whole browser."""
        session, self._session = self._session, None
        answer = self.call(method, **params)
        self._session = session
        return answer

    def cpu_time(self) -> float:
        """CPU time of all processes of the browser so far, s."""
        return sum(each["cpuTime"] for each in self._of_browser("SystemInfo.getProcessInfo")["processInfo"])

    def downloaded(self, folder: Path, script: str) -> Path:
        """The file that an expression makes the page offer, saved in an empty folder."""
        self._of_browser("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
        self.evaluate(script)
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            files = list(folder.iterdir())
            if files and files[0].suffix != ".crdownload":
                return files[0]
            time.sleep(0.02)
        raise TimeoutError(f"{script}; errors: {self.errors}")

    def open(self, path: Path, fragment: str = "") -> None:
        """Open a file and wait until the page says that it is ready."""
        self.call("Page.navigate", url="about:blank")
        for heard in (self.requests, self.windows, self.errors, self.messages):
            heard.clear()
        self.call("Page.navigate", url=path.resolve().as_uri() + fragment)
        self.wait("document.documentElement?.dataset.ready")

    def evaluate(self, script: str) -> Any:
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"]["description"])
        return answer["result"].get("value")

    def wait(self, condition: str) -> Any:
        """Wait until an expression in the page is true, and return its value."""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            if found := self.evaluate(condition):
                return found
            time.sleep(0.02)
        raise TimeoutError(f"{condition}; errors: {self.errors}")

    def least_contrast(self) -> tuple[float, str]:
        """The least contrast of a text with its background (WCAG 2.2), and that text."""
        ratio, text = self.evaluate(_LEAST_CONTRAST)
        return ratio, text

    def click(self, x: float, y: float) -> None:
        """Click at a place of the window, CSS pixels."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str) -> None:
        """Press and release a key."""
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code="Space" if key == " " else key, **text
            )

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what the window shows, or the whole page, as PNG."""
        options: dict[str, Any] = {}
        if whole:
            size = self.call("Page.getLayoutMetrics")["cssContentSize"]
            options = {"captureBeyondViewport": True, "clip": {**size, "scale": 1}}
        picture = self.call("Page.captureScreenshot", format="png", **options)["data"]
        path.write_bytes(base64.b64decode(picture))


@contextlib.contextmanager
def browser() -> Iterator[Page]:
    """A browser with one page, without any profile of the user's."""
    executable = program()
    assert executable is not None
    out, to = os.pipe()
    back, into = os.pipe()
    with tempfile.TemporaryDirectory(prefix="gaitsweep_browser_", ignore_cleanup_errors=True) as profile:
        # the browser reads from 3 and writes to 4; a function of ours between fork and exec could deadlock
        pipes = f'exec "$@" 3</proc/self/fd/{out} 4>/proc/self/fd/{into}'
        command = [
            "sh", "-c", pipes, "sh", executable,
            "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu",
            "--no-first-run", "--disable-extensions", "--disable-dev-shm-usage", f"--user-data-dir={profile}",
            "--disable-background-networking", "--hide-scrollbars",
        ]  # fmt: skip

        process = subprocess.Popen(
            command, pass_fds=(out, into), stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        os.close(out)
        os.close(into)
        try:
            yield Page(to, back)
        finally:
            process.kill()
            process.wait()
            os.close(to)
            os.close(back)
