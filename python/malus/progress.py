"""How the command line shows progress: a rich bar for people, JSON lines for programs, warnings only when quiet."""

from __future__ import annotations

import json
import sys
import time
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


class ProgressView:
    """Receives progress and log events; use as a context manager."""

    def progress(self, step: str, fraction: float, message: str) -> None:
        """One progress event: `fraction` of `step` is done."""

    def log(self, level: str, message: str) -> None:
        """One log line of level debug, info or warning."""

    def __enter__(self) -> ProgressView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


class WarningsOnly(ProgressView):
    """Each warning at once, a line on standard error, and nothing else."""

    def log(self, level: str, message: str) -> None:
        """Print warnings."""
        if level == "warning":
            print(f"warning: {message}", file=sys.stderr, flush=True)


class JsonProgress(ProgressView):
    """One JSON object an event on standard output."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def _write(self, **event: Any) -> None:
        print(json.dumps({**event, "seconds": round(time.monotonic() - self._start, 3)}), flush=True)

    def progress(self, step: str, fraction: float, message: str) -> None:
        """Write a progress object."""
        self._write(event="progress", step=step, fraction=round(fraction, 4), message=message)

    def log(self, level: str, message: str) -> None:
        """Write a log object."""
        self._write(event="log", level=level, message=message)


class BarProgress(ProgressView):
    """One line a step with a bar on standard error; plain lines when that is not a terminal."""

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr, highlight=False)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<13}"),
            BarColumn(bar_width=30),
            TimeElapsedColumn(),
            TextColumn("{task.fields[message]}"),
            console=self._console,
        )
        self._tasks: dict[str, Any] = {}

    def __enter__(self) -> BarProgress:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._console.is_terminal:
            self._bar.stop()

    def progress(self, step: str, fraction: float, message: str) -> None:
        """Advance the step's bar."""
        if not self._console.is_terminal:
            if fraction >= 1:
                self._console.print(f"{step:<13} {message or 'done'}")
            return
        if step not in self._tasks:
            self._tasks[step] = self._bar.add_task(step, total=1.0, message="")
        self._bar.update(self._tasks[step], completed=fraction, message=message)

    def log(self, level: str, message: str) -> None:
        """Print warnings above the bars."""
        if level == "warning":
            self._console.print(f"[yellow]warning:[/yellow] {message}")
