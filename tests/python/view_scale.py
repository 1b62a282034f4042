"""Pages in Chromium; the scale of a view that can be turned, read from its scale bar (label over length), and sizes measured by that scale."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_MM = {"µm": 1e-3, "mm": 1.0, "m": 1e3}
#: Counts the columns and rows of the canvas in which something is drawn, in CSS pixels.
_DRAWN = """(canvas) => {
  const copy = Object.assign(document.createElement('canvas'), { width: canvas.clientWidth, height: canvas.clientHeight });
  const context = copy.getContext('2d');
  context.drawImage(canvas, 0, 0, copy.width, copy.height);
  const { data } = context.getImageData(0, 0, copy.width, copy.height), columns = new Set(), rows = new Set();
  for (let i = 0; i < copy.width * copy.height; ++i) {
    if (data[4 * i + 3] > 127) { columns.add(i % copy.width); rows.add(Math.floor(i / copy.width)); }
  }
  return [columns.size, rows.size];
}"""


@contextmanager
def page_in_browser(path: Path, width: int, height: int, *arguments: str) -> Iterator[Any]:
    """The page in a window of this size."""
    playwright = pytest.importorskip("playwright.sync_api")
    chromium = os.environ.get("MALUS_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", *arguments])
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(120_000)
        page.goto(path.resolve().as_uri())
        yield page
        browser.close()


@contextmanager
def turning_view(path: Path, name: str) -> Iterator[Any]:
    """The view `name` of the page at a phone's width, once it has been drawn."""
    drawing = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    with page_in_browser(path, 390, 844, *drawing) as page:
        page.locator(f"#{name}.ready .scale:not(:empty)").wait_for()
        yield page.locator(f"#{name}")


def pixel_mm(view: Any) -> float:
    """Size of a CSS pixel of the view by its scale bar, after the view has been redrawn."""
    view.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    bar = view.locator(".scale")
    value, unit = re.fullmatch(r"([\d.]+) (µm|mm|m)", bar.inner_text()).groups()  # type: ignore[union-attr]
    width = bar.evaluate("element => element.getBoundingClientRect().width")
    assert 20 < width <= 141
    return float(value) * _MM[unit] / float(width)


def drawn_mm(view: Any) -> list[float]:
    """Width and height of the object in the view, by its scale bar."""
    size = pixel_mm(view)
    return [count * size for count in view.locator("canvas").evaluate(_DRAWN)]
