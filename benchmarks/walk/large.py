"""Measures how smoothly Studio runs with images of 18 megapixels (the enlarged relief) in real Chromium.

    python benchmarks/walk/large.py -o PICTURES [--megapixels 18]

Prints the seconds until the folder, the preview and the image to draw on are shown, and the time between two frames (median, 95th
percentile, largest, ms) while a person does nothing, paints, zooms, moves, undoes, saves and finds the edge.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from browser import chromium
from matplotlib.image import imread
from scipy import ndimage
from studio import ROOT, served

#: Script that stores the time of every frame in window.frames.
_WATCH = "() => { window.frames = []; const note = (now) => { window.frames.push(now); requestAnimationFrame(note); }; requestAnimationFrame(note); }"


def large_folder(folder: Path, megapixels: float) -> Path:
    """The relief's images, enlarged, with new noise. Smooth images would compress better and be sent faster than photographs."""
    (folder / "pol").mkdir(parents=True)
    random = np.random.default_rng(0)
    for path in sorted((ROOT / "examples" / "relief" / "pol").glob("*.png")):
        image = imread(path)
        image = ndimage.zoom(image, float(np.sqrt(megapixels * 1e6 / image.size)), order=1)
        image *= 1 + 0.01 * random.standard_normal(image.shape, np.float32)
        tifffile.imwrite(folder / "pol" / f"{path.stem}.tif", (65535 * np.clip(image, 0, 1)).astype(np.uint16))
    return folder


def told(page: Any, name: str, since: float) -> None:
    """Print the times between the frames since the last call."""
    page.wait_for_timeout(500)
    gaps = np.diff(page.evaluate("() => { const all = window.frames; window.frames = []; return all; }"))
    print(f"{name:10} {time.monotonic() - since:6.1f} s  frames {len(gaps):4}: {np.median(gaps):5.0f} {np.percentile(gaps, 95):5.0f} {gaps.max():5.0f} ms", flush=True)  # fmt: skip


def draw(page: Any) -> None:
    """All actions with the pointer, and actions that wait for the server."""
    tools, box = page.locator("#tools"), page.locator("#draw-stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.evaluate(_WATCH)

    def dragged(tool: str) -> None:
        page.locator(f"[data-tool={tool}]").click()
        page.mouse.move(x - 200, y)
        page.mouse.down()
        for k in range(60):
            page.mouse.move(x - 200 + 6 * k, y + 40 * np.sin(k / 6))
        page.mouse.up()

    steps: dict[str, Any] = {
        "nothing": lambda: page.wait_for_timeout(1000),
        "painting": lambda: (tools.get_by_label("width [px]").fill("300"), dragged("brush")),
        "zooming": lambda: [tools.get_by_role("button", name="Zoom in").click() for _ in range(4)],
        "moving": lambda: dragged("move"),
        "undo, redo": lambda: [tools.get_by_role("button", name=name, exact=True).click() for name in ("Undo", "Redo")],
        "saving": lambda: (
            tools.get_by_role("button", name="Save", exact=True).click(),
            page.locator("#draw-state", has_text="Saved").wait_for(),
        ),
        "the edge": lambda: (
            tools.get_by_role("button", name="Find the edge").click(),
            # The relief has no edge to find, but the waiting time is the same.
            page.locator("#draw-state", has_text="Finding").wait_for(),
            page.locator("#draw-state", has_not_text="Finding").wait_for(state="attached"),
        ),
    }
    for name, step in steps.items():
        start = time.monotonic()
        step()
        told(page, name, start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PICTURES")
    parser.add_argument("--megapixels", type=float, default=18)
    args = parser.parse_args()
    folder = args.output / "folders" / "large"
    if not folder.exists():
        large_folder(folder, args.megapixels)
    (folder / "station.toml").unlink(missing_ok=True)
    with served(folder) as address, chromium() as browser:
        page = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
        page.set_default_timeout(300_000)
        start = time.monotonic()
        page.goto(address)
        page.get_by_role("button", name="pol (6 images)").click()
        page.locator("#angles tbody tr").first.wait_for()
        print(f"table of the images after {time.monotonic() - start:.1f} s")
        page.get_by_alt_text("Phase in a circle of colors").wait_for()
        print(f"preview after {time.monotonic() - start:.1f} s")
        page.get_by_role("button", name="Create the station").click()
        page.locator("#plan", has_text="expected").wait_for()
        start = time.monotonic()
        page.get_by_role("banner").get_by_role("button", name="Draw", exact=True).click()
        page.locator("[data-tool=brush]").wait_for()
        page.wait_for_load_state("networkidle")
        print(f"image to draw on after {time.monotonic() - start:.1f} s", flush=True)
        draw(page)
        page.screenshot(path=args.output / "large_draw.png")


if __name__ == "__main__":
    main()
