"""Records what a person reads on a console of 80 columns: runs on the terminal, redirected, interrupted and resumed, refused runs,
a campaign, and an object.

    python benchmarks/walk/console.py STATION.toml -o TEXTS [--fusion grid] [--page docs/console.md]

Writes a text file for each case into TEXTS; for a terminal it contains the final screen. Prints what is wrong with the texts; the exit
code is then 1. --page also writes the texts into a page, below their marks.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path

COLUMNS = 80
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


MALUS = [sys.executable, "-m", "malus"]


def prepare(folder: Path, source: Path, fusion: str) -> str:
    """Copy the station into the folder: one intact copy and one that lacks an image, with a campaign of both; and an object of two
    copies. Returns the name of the station's folder.
    """
    name, broken = source.name, f"{source.name}_broken"
    for copy in (name, broken, "figure/front", "figure/side"):
        shutil.copytree(source, folder / copy)
    side = folder / "figure/side/station.toml"
    side.write_text(side.read_text().replace(f'name = "{name}"', 'name = "side"'))
    min((folder / broken).rglob("pol_*")).unlink()
    options = f'[options]\nfusion = "{fusion}"\n'
    (folder / "campaign.toml").write_text(
        f'[campaign]\nname = "Room 3"\nstations = ["{name}/station.toml", "{broken}/station.toml"]\n{options}'
    )
    (folder / "figure/object.toml").write_text(
        f'[object]\nname = "figure"\nstations = ["*/station.toml"]\nfaces = 3000\nclosed = false\n{options}'
    )
    return name


def on_terminal(words: list[str], folder: Path | None = None, *, interrupt_at: str = "") -> tuple[int, str, list[str]]:
    """Exit code, final screen, and every state of every line. Ctrl-C is pressed once `interrupt_at` is shown."""
    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    process = subprocess.Popen(words, stdin=other, stdout=other, stderr=other, start_new_session=True, cwd=folder)
    os.close(other)
    said = b""
    while True:
        if not select.select([main], [], [], 600)[0]:
            raise AssertionError("nothing was said for ten minutes")
        try:
            block = os.read(main, 65536)
        except OSError:  # the other end is closed
            break
        said += block
        if interrupt_at and interrupt_at in said.decode(errors="replace"):
            interrupt_at = ""
            time.sleep(1)  # a person needs time to react
            os.killpg(process.pid, signal.SIGINT)
    text = said.decode(errors="replace")
    states = [_CONTROL.sub("", state) for state in re.split(r"[\r\n]", text)]
    return process.wait(), screen(text), states


def screen(text: str) -> str:
    """Final screen of a terminal; understands only the control sequences that move up and clear a line."""
    lines, row, column = [""], 0, 0
    for part in re.findall(r"\x1b\[[0-9;?]*[A-Za-z]|\r|\n|[^\x1b\r\n]+", text):
        if part == "\r":
            column = 0
        elif part == "\n":
            row, column = row + 1, 0
            lines += [""] * (row == len(lines))
        elif part.endswith("A") and part.startswith("\x1b"):
            row = max(0, row - int(part[2:-1] or 1))
        elif part == "\x1b[2K":
            lines[row] = ""
        elif not part.startswith("\x1b"):
            lines[row] = lines[row][:column].ljust(column) + part + lines[row][column + len(part) :]
            column += len(part)
    return "\n".join(line.rstrip() for line in lines)


def problems(code: int, expected: int, text: str, states: list[str]) -> list[str]:
    found = [] if code == expected else [f"exit code {code}, expected {expected}"]
    found += [f"wider than {COLUMNS}: {state}" for state in states if len(state) > COLUMNS]
    return found + ["a traceback"] * ("Traceback" in text)


def with_texts(page: str, texts: dict[str, str]) -> str:
    """The page, with each text inserted into the block below its mark."""
    for name, text in texts.items():
        before, mark, after = page.partition(f"<!-- console: {name} -->\n\n```text\n")
        if mark:
            page = before + mark + text.rstrip() + "\n```" + after.partition("```")[2]
    return page


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("station", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="TEXTS")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--fusion", default="refined", choices=("refined", "grid"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []

    def keep(name: str, seconds: float, text: str, found: list[str]) -> None:
        (args.output / f"{name}.txt").write_text(text)
        print(f"{name}: {seconds:.1f} s", *found, sep="\n  ", flush=True)
        wrong.extend(found)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        station = prepare(folder, args.station.resolve().parent, args.fusion)

        def run(work: str, which: str = station) -> list[str]:
            return ["run", f"{which}/station.toml", "-o", work, "--fusion", args.fusion]

        for kind, words, expected, at in (
            ("interrupted", run("work"), 130, "evidence"),
            ("resumed", run("work"), 0, ""),
            ("terminal", run("again"), 0, ""),
            ("inputs", run(station), 2, ""),
            ("another", run("work", "figure/side"), 2, ""),
            ("batch", ["batch", "campaign.toml", "-o", "room3"], 2, ""),
            ("object", ["object", "figure/object.toml", "-o", "out"], 0, ""),
        ):
            start = time.monotonic()
            code, text, states = on_terminal([*MALUS, *words], folder, interrupt_at=at)
            keep(kind, time.monotonic() - start, text, problems(code, expected, text, states))
        start = time.monotonic()
        done = subprocess.run([*MALUS, *run("third")], cwd=folder, capture_output=True, text=True)
        text = f"standard output:\n{done.stdout}\nstandard error:\n{done.stderr}"
        found = problems(done.returncode, 0, text, [])
        found += ["control characters in a file"] * bool(re.search(r"[\x1b\r]", text))
        keep("redirected", time.monotonic() - start, text, found)
        if args.page:
            texts = {path.stem: path.read_text().replace(name, "/home/anna") for path in args.output.glob("*.txt")}
            args.page.write_text(with_texts(args.page.read_text(), texts))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
