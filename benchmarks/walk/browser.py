"""A simulated person at Chromium, with a mouse or with the keyboard alone, who presses buttons, takes pictures of pages and examines them."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: A control that does not get the focus after so many presses of Tab counts as unreachable.
_MOST_TABS = 400


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    program = os.environ.get("MALUS_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


class Person:
    """A person in front of a page. keyboard: does not use the mouse. Stores the time, a picture and the findings of axe for every step."""

    def __init__(self, page: Any, pictures: Path, name: str, *, keyboard: bool = False) -> None:
        self.page, self.keyboard = page, keyboard
        self.steps: list[tuple[str, float]] = []
        self.serious: list[str] = []
        self._pictures, self._name = pictures, name
        self._start = time.monotonic()
        page.set_default_timeout(900_000)
        page.on("pageerror", lambda error: self.serious.append(f"script error: {error}"))

    def press(self, what: Any) -> None:
        """Press a button, by a click or by Tab and Enter."""
        if self.keyboard:
            self.reach(what)
            self.page.keyboard.press("Enter")
        else:
            what.click()

    def choose(self, what: Any, value: str) -> None:
        """Choose the entry of a list with this value, with the mouse or by arrow keys."""
        if not self.keyboard:
            what.select_option(value)
            return
        self.reach(what)
        values = what.evaluate("list => [...list.options].map(option => option.value)")
        down = values.index(value) - values.index(what.input_value())
        for _ in range(abs(down)):
            self.page.keyboard.press("ArrowDown" if down > 0 else "ArrowUp")

    def reach(self, what: Any) -> None:
        """Press Tab until this element has the focus."""
        what.wait_for()
        for _ in range(_MOST_TABS):
            if what.evaluate("element => element === document.activeElement"):
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"{what} is not reached by {_MOST_TABS} presses of Tab")

    def pictured(self, step: str, *, whole: bool = False) -> None:
        """Note the time, then take a picture of the page and examine it."""
        self.steps.append((step, time.monotonic() - self._start))
        self.page.screenshot(path=self._pictures / f"{self._name}_{len(self.steps):02d}_{step}.png", full_page=whole)
        self.serious += [f"{step}: {words}" for words in serious_findings(self.page)]


def serious_findings(page: Any) -> list[str]:
    """Findings of axe-core that are serious or critical."""
    from axe_playwright_python.sync_playwright import Axe

    found = [one for one in Axe().run(page).response["violations"] if one["impact"] in ("serious", "critical")]
    return [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in found]


def unreached(page: Any) -> list[str]:
    """Controls of a page that Tab does not reach."""
    controls = "a[href], button, input, select, textarea, summary, [tabindex='0']"
    page.evaluate(
        "controls => { window.left = new Set([...document.querySelectorAll(controls)].filter(one => one.checkVisibility({visibilityProperty: true})"
        " && !one.disabled && !one.closest('[inert]') && one.tabIndex >= 0 && one.type !== 'radio')); document.body.focus(); scrollTo(0, 0); }",
        controls,
    )
    for _ in range(_MOST_TABS):
        page.keyboard.press("Tab")
        if not page.evaluate("() => { window.left.delete(document.activeElement); return window.left.size; }"):
            return []
    return list(page.evaluate("() => [...window.left].map(one => one.outerHTML.slice(0, 120))"))
