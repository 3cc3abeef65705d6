"""A real browser, controlled through two pipes in its own protocol, started once for all tests."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PROGRAM = next((b for name in ("chromium", "chromium-browser", "google-chrome") if (b := shutil.which(name))), None)
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--remote-debugging-pipe",
    "about:blank",
)
# What chromium says of canvases drawn without a graphics card: of speed, not of errors.
_OF_SPEED = ("GPU stall", "Multiple readback operations")
# How the browser refuses a question that meets a page on its way to another.
_OF_LEAVING = ("Inspected target navigated", "Execution context was destroyed", "Cannot find context")
_PATIENCE_S = 60.0
# Becomes the browser, with its two pipes where it looks for them; neither may be lost to the other's place.
_AT_3_AND_4 = """
import fcntl, os, sys
held = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
os.dup2(held[0], 3), os.dup2(held[1], 4)
[os.close(end) for end in held]
os.execv(sys.argv[3], sys.argv[3:])
"""


class BrowserError(Exception):
    """The browser does not start, does not answer, or refuses."""


class Browser:
    """Commands to a browser that listens at its descriptor 3 and answers at its descriptor 4, each ended by NUL."""

    def __init__(self, folder: Path) -> None:
        if PROGRAM is None:
            raise BrowserError("no chromium or chrome here")
        heard, self._to = os.pipe()
        self._from, text = os.pipe()
        arguments = [PROGRAM, f"--user-data-dir={folder / 'profile'}", *_FLAGS]
        self._log = (folder / "browser.log").open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-ISc", _AT_3_AND_4, str(heard), str(text), *arguments],
            pass_fds=(heard, text),
            stdout=self._log,
            stderr=self._log,
            stdin=subprocess.DEVNULL,
        )
        os.close(heard)
        os.close(text)
        self._unread, self._number = b"", 0
        self.events: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self.ask("Browser.close")
        except (BrowserError, OSError):
            self._process.kill()
        self._process.wait(timeout=_PATIENCE_S)
        os.close(self._to)
        os.close(self._from)
        self._log.close()

    def ask(self, method: str, session: str = "", **parameters: Any) -> dict[str, Any]:
        """Send one command and wait for its answer; other messages of the browser are kept in ``events``."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + _PATIENCE_S
        while (answer := self._next(until)).get("id") != self._number:
            self.events.append(answer)
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error']['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def wait_for(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first event that is wanted, received already or still to come."""
        until, k = time.monotonic() + _PATIENCE_S, 0
        while True:
            if k == len(self.events):
                self.events.append(self._next(until))
            if wanted(self.events[k]):
                return self.events[k]
            k += 1

    def _next(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._unread:
            if not select.select([self._from], [], [], max(0.0, until - time.monotonic()))[0]:
                raise BrowserError("the browser does not answer")
            if not (more := os.read(self._from, 1 << 20)):
                raise BrowserError("the browser has ended")
            self._unread += more
        first, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(first)
        return message


class Page:
    """One page of the browser, with what it has complained of so far."""

    def __init__(self, browser: Browser, address: str, width: int = 1200, height: int = 900, scheme: str = "light"):
        self._browser = browser
        target = browser.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = browser.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        self.resize(width, height)
        self.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.ask("Page.navigate", url=address)
        browser.wait_for(self._is("Page.loadEventFired"))

    def _is(self, method: str) -> Callable[[dict[str, Any]], bool]:
        return lambda event: event["method"] == method and event.get("sessionId") == self._session

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        return self._browser.ask(method, self._session, **parameters)

    def resize(self, width: int, height: int) -> None:
        """Give the page a view of the given size in px."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.ask("Emulation.setDeviceMetricsOverride", **size)

    def value(self, expression: str) -> Any:
        """Value of an expression of JavaScript, promises awaited."""
        reported = self.ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in reported:
            raise BrowserError(f"{expression[:80]}: {reported['exceptionDetails']}")
        return reported["result"].get("value")

    def becomes(self, expression: str) -> bool:
        """Return True if an expression becomes true soon, also on a page that is still loading."""
        until = time.monotonic() + _PATIENCE_S
        while True:
            try:
                if self.value(f"Boolean({expression})"):
                    return True
            except BrowserError as error:
                if not any(words in str(error) for words in _OF_LEAVING):
                    raise
            if time.monotonic() > until:
                return False
            time.sleep(0.01)

    def scroll_through(self) -> None:
        """Unfold the page, show every figure in turn and wait until it is drawn."""
        self.value(
            """(async () => {
              for (const folded of document.querySelectorAll("details")) folded.open = true;
              for (const plot of document.querySelectorAll(".plot")) {
                plot.scrollIntoView();
                for (let k = 0; k < 6000 && !plot.querySelector(".main-svg"); k++)
                  await new Promise((done) => setTimeout(done, 10));
              }
              scrollTo(0, 0);
            })()"""
        )

    def complaints(self) -> list[str]:
        """Errors and warnings of the page's scripts, and of whatever it tried to load."""
        own = [event for event in self._browser.events if event.get("sessionId") == self._session]
        text = []
        for event in own:
            reported = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                text.append(json.dumps(reported["exceptionDetails"]))
            elif event["method"] == "Runtime.consoleAPICalled" and reported["type"] in ("error", "warning", "assert"):
                text.append(json.dumps(reported["args"]))
            elif event["method"] == "Log.entryAdded" and reported["entry"]["level"] in ("error", "warning"):
                text.append(json.dumps(reported["entry"]))
        return [words for words in text if not any(hint in words for hint in _OF_SPEED)]

    def screenshot(self, whole: bool = False) -> bytes:
        """The page as PNG: what is in view, or all of it."""
        return base64.b64decode(self.ask("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def printed(self) -> bytes:
        """The page as PDF, of the size that its style asks for."""
        reported = self.ask("Page.printToPDF", preferCSSPageSize=True, printBackground=False)
        return base64.b64decode(reported["data"])

    def downloaded(self, click: str, folder: Path) -> Path:
        """The file that a click hands out; ``click``: JavaScript that clicks."""
        self._browser.ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder), eventsEnabled=True)
        seen = len(self._browser.events)
        self.value(click)
        begun = self._browser.wait_for(
            lambda e: e["method"] == "Browser.downloadWillBegin" and self._browser.events.index(e) >= seen
        )["params"]
        self._browser.wait_for(
            lambda e: (
                e["method"] == "Browser.downloadProgress"
                and e["params"]["guid"] == begun["guid"]
                and e["params"]["state"] == "completed"
            )
        )
        return folder / begun["suggestedFilename"]

    def close(self) -> None:
        self.ask("Page.close")
