"""Runs that Studio starts, one at a time. Each is a command in its own process, which continues when a page is closed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from malus.errors import InputError
from malus.studio import settings

#: Most lines of a run's log that are kept.
_LOG_LINES = 2000
#: Seconds for an interrupted run to end by itself before it is killed.
_PATIENCE_S = 30
_ENDED = ("done", "failed", "canceled")


@dataclass
class Run:
    """One run, waiting, running or ended. title: inputs and result; asked: the page's request, to repeat it; command: makes the arguments
    of `malus` when the run starts; page: folder of the run's report page; station: the station file, None for a comparison; number:
    given when the run is queued.
    """

    work: Path
    title: str
    asked: Mapping[str, Any]
    command: Callable[[], list[str]]
    page: Path
    station: Path | None = None
    number: int = 0
    state: str = "waiting"
    fraction: float = 0.0
    seconds_left: float | None = None
    step: str = ""
    message: str = ""
    steps: dict[str, float] = field(default_factory=dict)
    log: list[str] = field(default_factory=list)
    error: str = ""
    process: subprocess.Popen[str] | None = None

    def note(self, line: str) -> None:
        """Keep a line of the log."""
        self.log.append(line)
        del self.log[:-_LOG_LINES]

    def take(self, event: Mapping[str, Any]) -> None:
        """Update the run from an event (a line of `malus … --json`)."""
        if event.get("event") == "log":
            self.note(f"{event['level']}: {event['message']}")
            return
        if event.get("event") != "progress":
            return
        if event["step"] != self.step or event["fraction"] >= 1:
            self.note(f"{event['step']} {100 * event['fraction']:.0f} % {event['message']}".rstrip())
        self.step, self.message = event["step"], event["message"]
        self.steps[self.step] = event["fraction"]
        self.fraction, self.seconds_left = event["overall"], event["seconds_left"]


class Runs:
    """The queue of runs; a thread processes it."""

    def __init__(self) -> None:
        self._runs: list[Run] = []
        self._number = 0
        self._changed = threading.Condition()
        self._closing = False
        self._worker = threading.Thread(target=self._work, name="runs", daemon=True)
        self._worker.start()

    def all(self) -> list[Run]:
        """All runs, the oldest first."""
        with self._changed:
            return list(self._runs)

    def add_station(self, station: Path, work: Path, fusion: str, title: str, asked: Mapping[str, Any]) -> Run:
        """Queue the reconstruction of a station."""

        def command() -> list[str]:
            words = ["run", str(station), "-o", str(work), "--fusion", fusion]
            options = settings.file_of(station)
            return [*words, "--options", str(options)] if options.is_file() else words

        return self._add(Run(work, title, asked, command, work / "report", station))

    def add_comparison(
        self, before: Path, after: Path, folder: Path, same_frame: bool, title: str, asked: Mapping[str, Any]
    ) -> Run:
        """Queue the comparison of the results of two dates."""
        words = ["compare", str(before), str(after), "-o", str(folder), *(["--same-frame"] if same_frame else [])]
        return self._add(Run(folder, title, asked, lambda: words, folder))

    def _add(self, new: Run) -> Run:
        """Queue a run. If the same run waits or runs already, it is returned instead; an ended run with this folder is removed.

        Raises InputError while another run uses the same folder for its results.
        """
        with self._changed:
            for run in self._runs:
                if run.work == new.work and run.state not in _ENDED:
                    if run.asked == new.asked:
                        return run
                    raise InputError(
                        f"{new.work.name}: {run.title} has not ended, expected another folder, or that one canceled first"
                    )
            self._runs = [run for run in self._runs if run.work != new.work]
            self._number += 1
            new.number = self._number
            self._runs.append(new)
            self._changed.notify_all()
            return new

    def cancel(self, number: int) -> None:
        """End a run as Ctrl-C does: the results of finished steps are kept."""
        with self._changed:
            for run in self._runs:
                if run.number != number or run.state in _ENDED:
                    continue
                run.state = "canceled"
                if run.process is not None:
                    run.process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Cancel all runs and wait until they have ended."""
        self._closing = True
        for run in self.all():
            self.cancel(run.number)
        with self._changed:
            self._changed.notify_all()
        self._worker.join(timeout=_PATIENCE_S)
        for run in self.all():
            if run.process is not None and run.process.poll() is None:
                run.process.kill()
        self._worker.join()

    def _next(self) -> Run | None:
        with self._changed:
            while not self._closing:
                for run in self._runs:
                    if run.state == "waiting":
                        run.state = "running"
                        return run
                self._changed.wait()
        return None

    def _work(self) -> None:
        while (run := self._next()) is not None:
            self._follow(run)

    def _follow(self, run: Run) -> None:
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "malus", *run.command(), "--json"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",  # Libraries may write bytes that are no text.
                # Ctrl-C in Studio's terminal ends Studio, which then ends its runs.
                start_new_session=True,
            )
        except OSError as error:
            run.state, run.error = "failed", f"malus could not be started ({error})"
            return
        with self._changed:
            run.process = process
            if run.state == "canceled":
                process.send_signal(signal.SIGINT)
        with process:
            errors = threading.Thread(target=_read_errors, args=(process, run))
            errors.start()
            assert process.stdout is not None
            for line in process.stdout:
                try:
                    run.take(json.loads(line))
                except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                    run.note(line.rstrip())
            code = process.wait()
            errors.join()
        with self._changed:
            if code == 0:  # also if it was canceled too late
                run.state = "done"
            elif run.state == "running":
                run.state = "failed"
            if run.state == "failed" and not run.error:
                run.error = f"malus ended with code {code}"


def _read_errors(process: subprocess.Popen[str], run: Run) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        run.note(line.rstrip())
        if line.startswith("malus: "):
            run.error = line.removeprefix("malus: ").rstrip()


def described(run: Run) -> dict[str, Any]:
    """A run for the page, without its log."""
    names = ("number", "title", "asked", "state", "fraction", "seconds_left", "step", "message", "error")
    # A copy of the steps: the thread that follows the run may add one while the page's answer is written.
    return {**{name: getattr(run, name) for name in names}, "steps": dict(run.steps)}
