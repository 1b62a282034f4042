"""What commands print for people, or with --json for programs."""

from __future__ import annotations

import argparse
import shutil
import sys
import textwrap
from pathlib import Path
from typing import TextIO

from malus.progress import BarProgress, JsonProgress, ProgressView, WarningsOnly


def view_of(args: argparse.Namespace) -> ProgressView:
    """Where progress is shown: as --json and --quiet say."""
    if args.json:
        return JsonProgress()
    return WarningsOnly() if args.quiet else BarProgress()


def print_lines(*lines: str, hang: int = 2, to: TextIO | None = None) -> None:
    """Print lines for a person: wrapped to the width of a terminal, without breaking words; unchanged to a file."""
    stream = to or sys.stdout
    for line in "\n".join(lines).split("\n"):
        if stream.isatty():
            indent = " " * (len(line) - len(line.lstrip()) + hang)
            columns = max(40, shutil.get_terminal_size().columns)
            line = textwrap.fill(
                line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
            )
        print(line, file=stream)


def tell_written(args: argparse.Namespace, step: str, *paths: Path) -> None:
    """Name what was written: a line each, or with --json an event each; nothing with --quiet."""
    if args.json:
        view = JsonProgress()
        view.expect([(step, 1.0)])
        for path in paths:
            view.progress(step, 1.0, str(path))
    elif not args.quiet:
        print(*paths, sep="\n")
