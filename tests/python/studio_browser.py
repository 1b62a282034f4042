"""Helpers for the tests of Studio: its server for a folder, and its page in real Chromium."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from conftest import EXAMPLE

CHROMIUM = next((path for path in (os.environ.get("MALUS_CHROMIUM"), shutil.which("chromium"), shutil.which("google-chrome")) if path), None)  # fmt: skip
needs_studio = pytest.mark.skipif(
    any(find_spec(name) is None for name in ("starlette", "uvicorn", "tomlkit")),
    reason="the extra studio is not installed",
)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None or find_spec("playwright") is None or find_spec("axe_playwright_python") is None,
    reason="Chromium, playwright or axe-playwright-python is not installed",
)
#: How long an answer of the page and a run may take on a busy machine.
PATIENCE_MS, RUN_MS = 180_000, 900_000
#: Folder for screenshots of the browser, to look at.
PICTURES = Path(os.environ.get("MALUS_PICTURES", ""))


@dataclass
class Served:
    """A Studio that runs for a folder."""

    folder: Path
    entrance: str
    process: subprocess.Popen[str]

    @property
    def host(self) -> str:
        return urlsplit(self.entrance).netloc

    def ask(
        self, method: str, address: str, headers: dict[str, str], body: str | bytes = ""
    ) -> tuple[int, dict[str, str], str]:
        content = body if isinstance(body, bytes) else body.encode()
        with closing(HTTPConnection(self.host, timeout=120)) as connection:
            connection.putrequest(method, address, skip_host=True)
            for name, value in {"Host": self.host, "Content-Length": str(len(content)), **headers}.items():
                connection.putheader(name, value)
            connection.endheaders(content)
            response = connection.getresponse()
            said = {name.lower(): value for name, value in response.getheaders()}
            return response.status, said, response.read().decode(errors="replace")

    def asked(self, address: str) -> Any:
        """The answer to a page's request for data."""
        return json.loads(self.ask("GET", f"/api/{address}", {"Cookie": self.cookie()})[2])

    def tell(self, name: str, body: object, method: str = "POST") -> tuple[int, Any]:
        """Status and answer to a page's request that changes something."""
        cookie = self.cookie()
        own = {"Cookie": cookie, "Origin": f"http://{self.host}", "X-Malus-Page": self.page_token(cookie)}
        sent = body if isinstance(body, str | bytes) else json.dumps(body)
        status, _, text = self.ask(method, f"/api/{name}", own, sent)
        return status, json.loads(text) if text.startswith(("{", "[")) else text

    def cookie(self) -> str:
        _, headers, _ = self.ask("GET", "/?" + urlsplit(self.entrance).query, {})
        return headers["set-cookie"].split(";")[0]

    def page_token(self, cookie: str) -> str:
        found = re.search(r'name="malus-page" content="([^"]+)"', self.ask("GET", "/", {"Cookie": cookie})[2])
        assert found
        return found[1]


@contextmanager
def studio(folder: Path) -> Iterator[Served]:
    """Run `malus studio` for the folder; it must end without an error."""
    process = subprocess.Popen(
        [sys.executable, "-m", "malus", "studio", str(folder), "--no-browser"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        entrance = next((line.strip() for line in process.stdout if "token=" in line), None)
        assert entrance, "malus studio printed no address"
        yield Served(folder, entrance, process)
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        try:
            code = process.wait(timeout=180)
        finally:
            process.kill()
    assert code == 0


def brought(source: Path, folder: Path) -> Path:
    """A folder as a user prepares it: polarized images, photos, cameras and cloud of a station, but no station file."""
    shutil.copytree(source, folder)
    (folder / "station.toml").unlink()
    (folder / "views").mkdir()
    for name in ("view_00.jpg", "view_04.jpg", "view_08.jpg"):
        shutil.copy(EXAMPLE / "views" / name, folder / "views")
    return folder


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, served: Served) -> Iterator[Any]:
    """A page of this Studio; it must meet no unexpected error."""
    page = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on(
        "console",
        lambda line: (
            problems.append(line.text)
            if line.type == "error" and not re.search("status of 40[09]", line.text)
            else None
        ),
    )
    page.set_default_timeout(PATIENCE_MS)
    page.goto(served.entrance)
    yield page
    page.context.close()
    assert not problems


def hurry(page: Any, name: str) -> None:
    """Press the button of a part of the page, without waiting until the part is open."""
    page.get_by_role("banner").get_by_role("button", name=name, exact=True).click()


def go(page: Any, name: str) -> None:
    """Open a part of the page."""
    hurry(page, name)
    page.locator("main:not([aria-busy])").wait_for()


def draw(page: Any, what: str) -> None:
    """Open Draw for a kind of thing."""
    go(page, "Draw")
    page.locator("#draw-what").select_option(what)
    page.locator("#draw-stage:not([inert])").wait_for()


def pictured(page: Any, name: str) -> None:
    if PICTURES.name:
        page.screenshot(path=PICTURES / f"{name}.png")


def require_accessible(page: Any) -> None:
    from axe_playwright_python.sync_playwright import Axe

    found = [v for v in Axe().run(page).response["violations"] if v["impact"] in ("serious", "critical")]
    assert not found, [(v["id"], [node["html"] for node in v["nodes"]][:3]) for v in found]


def wait_for(page: Any, said: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not said():
        assert time.monotonic() < deadline
        page.wait_for_timeout(50)


def held(page: Any, name: str) -> list[Any]:
    """Hold back the first request of this name until `let_go`; later requests are not held back."""
    kept: list[Any] = []
    page.route(f"**/api/{name}*", lambda route: route.continue_() if kept else kept.append(route))
    return kept


def let_go(page: Any, kept: list[Any]) -> None:
    """Send the held request and wait for its answer.

    The route stays: if it were removed while the next request is under way, that request would be sent but not told
    to `page.on("request")`.
    """
    wait_for(page, lambda: bool(kept))
    with page.expect_response(kept[0].request.url):
        kept[0].continue_()


@contextmanager
def paused(served: Served) -> Iterator[None]:
    """Stop the current run once it has reported the time left: otherwise it may end before a busy browser has looked."""
    process = _run_with_time_left(served)
    try:
        yield
    finally:
        _signal(process, signal.SIGCONT)


def _run_with_time_left(served: Served) -> int:
    deadline = time.monotonic() + RUN_MS / 1000
    while time.monotonic() < deadline:
        for process in _programs_of(served.process.pid):
            _signal(process, signal.SIGSTOP)
            try:
                told = any(
                    run["state"] == "running" and run["seconds_left"] is not None for run in served.asked("runs")
                )
            except BaseException:
                _signal(process, signal.SIGCONT)
                raise
            if told:
                return process
            _signal(process, signal.SIGCONT)
        time.sleep(0.05)
    raise AssertionError("no run told how much time is left")


def _programs_of(parent: int) -> list[int]:
    """Programs that a process has started. A child that is still being started has its parent's command line and is left out:
    its parent waits for it while it holds Python's lock. If that child were stopped, Studio would never answer again."""
    found = []
    for children in Path(f"/proc/{parent}/task").glob("*/children"):
        with suppress(OSError):  # ended meanwhile
            found += [
                child for child in map(int, children.read_text().split()) if _words(child) not in ("", _words(parent))
            ]
    return found


def _words(process: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_text()
    return ""


def _signal(process: int, name: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, name)
