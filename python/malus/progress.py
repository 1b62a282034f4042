"""Progress on the command line: progress bars for people, JSON lines for programs, only warnings with --quiet."""

from __future__ import annotations

import json
import select
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

#: Seconds of work after which the measured speed has the same weight as the expected speed.
_TRUST_SECONDS = 5.0
#: Steps whose every message says how a station has ended.
_OF_STATIONS = ("batch", "stations")


class Overall:
    """How much of the whole run is done, and how long the remaining part will take at the speed measured so far.

    `expected`: steps in their order and the seconds that each is expected to take. If the first event of a step says that the step is
    done, it was kept from an earlier run and is not used to measure the speed. guessed: only the ratios of these seconds are meaningful.
    """

    def __init__(self, expected: Sequence[tuple[str, float]], *, guessed: bool = False) -> None:
        self._expected = dict(expected)
        self._guessed = guessed
        self._done: dict[str, float] = {}
        self._kept: set[str] = set()
        self._start = time.monotonic()

    def update(self, step: str, fraction: float) -> None:
        """Process an event; unexpected steps do not count."""
        if step not in self._expected:
            return
        if step not in self._done and fraction >= 1:
            self._kept.add(step)
        self._done[step] = max(fraction, self._done.get(step, 0.0))

    @property
    def fraction(self) -> float:
        """Share of the whole run that is done, 0 … 1."""
        total = sum(self._expected.values())
        return (
            sum(seconds * self._done.get(step, 0.0) for step, seconds in self._expected.items()) / total
            if total
            else 0.0
        )

    @property
    def seconds_left(self) -> float | None:
        """Expected remaining seconds, at the speed measured so far; None while only guesses are known."""
        if self._guessed and not any(self._done.values()):
            return None
        rest = sum(seconds * (1 - self._done.get(step, 0.0)) for step, seconds in self._expected.items())
        computed = sum(self._expected[step] * part for step, part in self._done.items() if step not in self._kept)
        return rest * (time.monotonic() - self._start + _TRUST_SECONDS) / (computed + _TRUST_SECONDS)


def duration(seconds: float) -> str:
    """A duration as readable text, rounded to the accuracy of an estimate."""
    if seconds < 90:
        return f"{max(5, 5 * round(seconds / 5))} s"
    if seconds < 5400:
        return f"{round(seconds / 60)} min"
    return f"{seconds / 3600:.1f} h"


def nobody_reads() -> bool:
    """Whether standard output or standard error is a pipe whose reader has ended."""
    poll = select.poll()
    for descriptor in (1, 2):
        poll.register(descriptor, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


class ProgressView:
    """Receives progress and log events; use as a context manager."""

    def __init__(self) -> None:
        self._overall = Overall([])
        self._warnings: list[str] = []

    def expect(self, expected: Sequence[tuple[str, float]], *, guessed: bool = False) -> None:
        """Set the steps to come and the seconds that each is expected to take; guessed: only their ratios are meaningful."""
        self._overall = Overall(expected, guessed=guessed)

    def progress(self, step: str, fraction: float, message: str) -> None:
        """One progress event: `fraction` of `step` is done."""

    def log(self, level: str, message: str) -> None:
        """One log line of level debug, info or warning. A run repeats the warnings of steps that were done before: each is told once."""
        if level == "warning":
            if message in self._warnings:
                return
            self._warnings.append(message)
        self._tell(level, message)

    def _tell(self, level: str, message: str) -> None:
        """Tell a log line for the first time."""

    def result(self, level: str | None, reasons: Sequence[str], assessed: bool) -> None:
        """The confidence in the surface, once the run is done; level None = there is no surface."""

    def __enter__(self) -> ProgressView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The reader of the output has ended (`malus run … --json | head`), and so the run ended before it was done. For a pipe
        # that is standard error, rich raises SystemExit. Other pipes and sockets break, too, which is an error.
        if isinstance(error, SystemExit) or (isinstance(error, BrokenPipeError) and nobody_reads()):
            raise KeyboardInterrupt from None


class WarningsOnly(ProgressView):
    """Prints each warning immediately, as a line on standard error, and nothing else."""

    def _tell(self, level: str, message: str) -> None:
        """Print warnings."""
        if level == "warning":
            print(f"warning: {message}", file=sys.stderr, flush=True)


class JsonProgress(ProgressView):
    """Writes one JSON object per event to standard output."""

    def __init__(self) -> None:
        super().__init__()
        self._start = time.monotonic()

    def _write(self, **event: Any) -> None:
        print(json.dumps({**event, "seconds": round(time.monotonic() - self._start, 3)}), flush=True)

    def progress(self, step: str, fraction: float, message: str) -> None:
        """Write a progress object."""
        self._overall.update(step, fraction)
        self._write(
            event="progress",
            step=step,
            fraction=round(fraction, 4),
            message=message,
            overall=round(self._overall.fraction, 4),
            seconds_left=None if (left := self._overall.seconds_left) is None else round(left, 1),
        )

    def _tell(self, level: str, message: str) -> None:
        """Write a log object."""
        self._write(event="log", level=level, message=message)

    def result(self, level: str | None, reasons: Sequence[str], assessed: bool) -> None:
        """Write the last object: `confidence` as in quality.json, null if there is no surface, and every warning of the run."""
        confidence = None if level is None else {"level": level, "reasons": list(reasons)}
        self._write(event="result", confidence=confidence, assessed=assessed, warnings=self._warnings)


class BarProgress(ProgressView):
    """Shows one line with a bar per step on standard error; plain lines if standard error is not a terminal."""

    def __init__(self) -> None:
        super().__init__()
        self._console = Console(file=sys.stderr, highlight=False)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<13}"),
            BarColumn(bar_width=30),
            TimeElapsedColumn(),
            TextColumn("{task.fields[message]}", markup=False),
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
        super().__exit__(kind, error, trace)

    def progress(self, step: str, fraction: float, message: str) -> None:
        """Advance the bar of the step and the bar of the whole run."""
        self._overall.update(step, fraction)
        if not self._console.is_terminal:
            # A log names each station that has ended, as the bar does one after the other.
            if fraction >= 1 or (step in _OF_STATIONS and message):
                self._print(Text(f"{100 * self._overall.fraction:3.0f} %  {step:<13} {message or 'done'}"))
            return
        for name in ("everything", step):
            if name not in self._tasks:
                self._tasks[name] = self._bar.add_task(name, total=1.0, message="")
        self._bar.update(self._tasks[step], completed=fraction, message=message)
        seconds = self._overall.seconds_left
        left = (
            "done" if self._overall.fraction >= 1 else "begun" if seconds is None else f"about {duration(seconds)} left"
        )
        self._bar.update(
            self._tasks["everything"],
            completed=self._overall.fraction,
            message=f"{100 * self._overall.fraction:.0f} %, {left}",
        )

    def _tell(self, level: str, message: str) -> None:
        """Print warnings above the bars."""
        if level == "warning":
            # As Text: in a plain string, rich would take words in brackets such as [optics] for markup and drop them.
            self._print(Text.assemble(("warning:", "yellow"), " ", message))

    def _print(self, line: Text) -> None:
        """Print a line, wrapped on a terminal only: in a file each message stays on one line, so that it can be searched."""
        self._console.print(line, soft_wrap=not self._console.is_terminal)
