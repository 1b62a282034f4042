"""Examines reports as readers see them: on a screen, on a phone 390 px wide, and printed.

    python benchmarks/walk/reports.py WORK... -o PICTURES

Writes NAME_screen.png, NAME_phone.png, NAME.pdf and pictures of its pages (pdftoppm) into PICTURES. Prints serious findings of axe-core,
controls that Tab does not reach, and pages wider than their window. The exit code is 1 if there are any.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from browser import chromium, serious_findings, unreached

SCREEN, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


def settled(page: Any) -> None:
    """Scroll through the page, so that parts that are only drawn when visible are complete."""
    height = page.evaluate("document.documentElement.scrollHeight")
    for y in range(0, height, 700):
        page.evaluate(f"scrollTo(0, {y})")
        page.wait_for_timeout(50)
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(1000)


def examined(browser: Any, report: Path, name: str, pictures: Path) -> list[str]:
    page = browser.new_page(viewport=SCREEN)
    page.set_default_timeout(300_000)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(f"script error: {error}"))
    page.goto(report.resolve().as_uri())
    settled(page)
    page.screenshot(path=pictures / f"{name}_screen.png", full_page=True)
    wrong += serious_findings(page)
    wrong += [f"not reached by Tab: {html}" for html in unreached(page)]
    page.pdf(path=pictures / f"{name}.pdf", format="A4", print_background=True)
    if shutil.which("pdftoppm"):
        subprocess.run(
            ["pdftoppm", "-r", "60", "-png", pictures / f"{name}.pdf", pictures / f"{name}_print"], check=True
        )
    page.set_viewport_size(PHONE)
    settled(page)
    page.screenshot(path=pictures / f"{name}_phone.png", full_page=True)
    wrong += [f"phone: {words}" for words in serious_findings(page)]
    width = page.evaluate("document.documentElement.scrollWidth")
    if width > PHONE["width"]:
        wrong.append(f"phone: {width} px wide")
    page.close()
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("works", nargs="+", type=Path, metavar="WORK")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PICTURES")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    found = 0
    with chromium() as browser:
        for work in args.works:
            wrong = examined(browser, work / "report" / "index.html", work.name, args.output)
            print(f"{work}: {len(wrong)} found", *wrong, sep="\n  ", flush=True)
            found += len(wrong)
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
