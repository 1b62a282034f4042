"""Walks from a folder to the report in Malus Studio in real Chromium, with the time and a picture of every step.

    python benchmarks/walk/studio.py -o PICTURES [--folders relief coin raw] [--fusion grid]

The relief and the coin of the examples are processed with a mouse. The folder of RAW files is the relief as DNG files of a Bayer sensor
with a table of angles; it is processed with the keyboard alone, and its pages are finally shown in dark colors at 200 %. Prints the
seconds since the folder was opened and the serious findings of axe-core. The folders stay in PICTURES/folders. The exit code is 1 if
there are findings.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from browser import Person, chromium
from matplotlib.image import imread

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))
PAGES = ("Images", "Station", "Draw", "Options", "Run", "Results")


def folder_of(kind: str, parent: Path) -> Path:
    """Creates a folder as a new user has it: images, cameras and cloud, but no station file."""
    from test_raw import write_dng

    source, folder = ROOT / "examples" / ("coin" if kind == "coin" else "relief"), parent / kind
    folder.mkdir(parents=True)
    for part in ("sparse", "dense") if kind == "raw" else ("sparse", "dense", "pol"):
        shutil.copytree(source / part, folder / part)
    if kind != "raw":
        return folder
    (folder / "pol").mkdir()
    lines = ["image,angle"]
    for number, path in enumerate(sorted((source / "pol").glob("*.png"))):
        name = f"IMG_{7301 + number}.dng"
        write_dng(folder / "pol" / name, np.clip(imread(path) * 65535 / 16383, 0, 1))
        lines.append(f"{name},{int(path.stem[-3:])}")
    (folder / "pol" / "angles.csv").write_text("\n".join(lines) + "\n")
    return folder


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Runs Studio for the folder; gives its address."""
    words = [sys.executable, "-m", "malus", "studio", str(folder), "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield next(line.strip() for line in process.stdout if "token=" in line)
        finally:
            process.send_signal(signal.SIGINT)


def go(person: Person, name: str) -> None:
    person.press(person.page.get_by_role("banner").get_by_role("button", name=name, exact=True))
    person.page.locator("main:not([aria-busy])").wait_for()


def create(person: Person) -> None:
    page = person.page
    person.pictured("folder")
    person.press(page.get_by_role("button", name="pol (6 images)"))
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    person.pictured("images", whole=True)
    person.press(page.get_by_role("button", name="Create the station"))
    person.press(page.get_by_role("button", name="Use them"))
    page.locator("#plan", has_text="Ready").wait_for()
    person.press(page.get_by_role("button", name="Show the coarse surface on the image"))
    page.locator("#overlay-note", has_text="Yellow is near").wait_for()
    person.press(page.get_by_role("button", name="Compare direction and zero of the scale with the coarse surface"))
    page.get_by_alt_text("Phase as the coarse surface expects it").wait_for()
    person.pictured("station", whole=True)


def mask_of_the_coin(person: Person) -> None:
    """Paints the coin roughly, then cuts it out along its edge."""
    page = person.page
    go(person, "Draw")
    person.press(page.locator("[data-tool=polygon]"))
    box = page.locator("#draw-stage").bounding_box()
    width = min(box["width"], box["height"] * 1.5)
    for turn in np.linspace(0, 2 * np.pi, 13):
        page.mouse.click(box["x"] + box["width"] / 2 + 0.3 * width * np.cos(turn), box["y"] + box["height"] / 2 + 0.3 * width * np.sin(turn))  # fmt: skip
    person.pictured("painted")
    person.press(page.get_by_role("button", name="Find the edge"))
    page.locator("#draw-state", has_text="The edge was found").wait_for()
    person.pictured("edge")
    person.press(page.locator("#tools").get_by_role("button", name="Save", exact=True))
    page.locator("#draw-state", has_text="Saved").wait_for()


def profile(person: Person) -> None:
    """Draws a line across the middle of the image."""
    page = person.page
    go(person, "Draw")
    person.choose(page.locator("#draw-what"), "profile")
    person.press(page.locator("[data-tool=line]"))
    if person.keyboard:
        person.reach(page.locator("#draw-stage"))
        for key in ["ArrowLeft"] * 15 + ["Enter"] + ["ArrowRight"] * 30 + ["Enter"]:
            page.keyboard.press(key)
    else:
        box = page.locator("#draw-stage").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x - 150, y)
        page.mouse.down()
        page.mouse.move(x + 150, y + 5)
        page.mouse.up()
    page.get_by_role("group", name="profile 1").wait_for()
    person.pictured("profile")


def run(person: Person, fusion: str) -> None:
    page = person.page
    go(person, "Run")
    if fusion != "refined":
        person.choose(page.get_by_label("Fusion"), fusion)
    person.press(page.get_by_role("button", name="Add to the queue"))
    page.locator("p[data-state]", has_text="left").wait_for()
    person.pictured("running")
    shown = page.get_by_role("button", name="Show the report")
    shown.wait_for()
    person.pictured("done")
    person.press(shown)
    page.frame_locator("iframe").get_by_text("Confidence").first.wait_for()
    page.wait_for_timeout(2000)  # until the viewer shows its first picture
    person.pictured("report", whole=True)


def large_and_dark(person: Person) -> None:
    """Shows all pages in dark colors, in half of the window as at a zoom of 200 %."""
    page = person.page
    page.emulate_media(color_scheme="dark")
    page.set_viewport_size({"width": 640, "height": 450})
    for name in PAGES:
        go(person, name)
        person.pictured(f"dark_{name.lower()}")
        if page.evaluate("document.documentElement.scrollWidth > innerWidth"):
            person.serious.append(f"{name} at 200 %: wider than the window")


def walk(browser: Any, kind: str, pictures: Path, fusion: str) -> Person:
    with served(folder_of(kind, pictures / "folders")) as address:
        page = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
        person = Person(page, pictures, kind, keyboard=kind == "raw")
        page.goto(address)
        page.get_by_role("button", name="pol (6 images)").wait_for()
        create(person)
        if kind == "coin":
            mask_of_the_coin(person)
        profile(person)
        run(person, fusion)
        if kind == "raw":
            large_and_dark(person)
        page.context.close()
    return person


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PICTURES")
    parser.add_argument("--folders", nargs="+", default=["relief", "coin", "raw"], choices=("relief", "coin", "raw"))
    parser.add_argument("--fusion", default="refined", choices=("refined", "grid"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    found = 0
    with chromium() as browser:
        for kind in args.folders:
            person = walk(browser, kind, args.output, args.fusion)
            print(f"{kind}, {'keyboard' if person.keyboard else 'mouse'}")
            for step, seconds in person.steps:
                print(f"  {seconds:7.1f} s  {step}")
            for words in person.serious:
                print(f"  FOUND {words}")
            found += len(person.serious)
            sys.stdout.flush()
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
