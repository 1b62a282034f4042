"""Opens every hand-written page of the site (run scripts/site first) on a screen and on a phone.

    .venv/bin/python benchmarks/walk/site.py -o PICTURES [PAGE.html ...]

Writes a picture of each page. Prints serious findings of axe, requests to the network, missing pictures and files, and pages wider than
the phone. The exit code is 1 if there are any. The C++ reference, which Doxygen generates, is not opened.
"""

from __future__ import annotations

import argparse
import functools
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from browser import chromium, serious_findings

SITE = Path(__file__).resolve().parents[2] / "out" / "site"
SCREEN, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


class _Silent(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


def examined(page: Any, address: str, picture: Path) -> list[str]:
    wrong: list[str] = []
    wrong += [] if page.goto(address).ok else ["not there"]
    page.evaluate("for (const image of document.images) image.loading = 'eager'")
    page.wait_for_load_state("networkidle")
    page.screenshot(path=picture, full_page=True)
    wrong += page.evaluate("[...document.images].filter(i => !i.naturalWidth).map(i => 'no picture: ' + i.src)")
    if (width := page.evaluate("document.documentElement.scrollWidth")) > page.viewport_size["width"]:
        wrong.append(f"{width} px wide")
    return wrong + serious_findings(page)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="below out/site (default: all)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PICTURES")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    written = [str(path.relative_to(SITE)) for path in sorted(SITE.rglob("*.html"))]
    pages = args.pages or [path for path in written if not path.startswith(("cpp/", "decisions/", "404"))]
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Silent, directory=SITE))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    here = f"http://127.0.0.1:{server.server_port}/"
    found = 0
    asked: list[str] = []
    with chromium() as browser:
        for name, viewport in (("screen", SCREEN), ("phone", PHONE)):
            page = browser.new_page(viewport=viewport)
            page.set_default_timeout(300_000)
            page.on("request", lambda request: asked.append(request.url))
            page.on("pageerror", lambda error: asked.append(f"script error: {error}"))
            for path in pages:
                picture = args.output / f"{path.removesuffix('.html').replace('/', '_')}_{name}.png"
                asked.clear()
                wrong = examined(page, here + path, picture)
                wrong += [f"asks {url}" for url in asked if not url.startswith((here, "data:", "blob:"))]
                print(f"{path}, {name}: {len(wrong)} found", *wrong, sep="\n  ", flush=True)
                found += len(wrong)
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
