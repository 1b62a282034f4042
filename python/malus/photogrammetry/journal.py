"""Which stages of the photogrammetry are done, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from malus import _core
from malus._files import read_record, write_record
from malus.photogrammetry import database

Log = Callable[[str, str], None]


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Journal:
    """Marks of finished stages, `done/<stage>.json` below a folder.

    A stage's key is the hash of malus's version, of what it was given and of the key of the stage before it; it is done when its mark has
    that key and its outputs are as it left them: by their sizes, and rasters, which the pipeline reads, by their hashes.
    """

    def __init__(self, folder: Path, log: Log) -> None:
        """Keep the marks below `folder`, which is created if needed. `log` gets the stages' messages."""
        self.folder = folder
        self.seconds: dict[str, float] = {}
        self._marks = folder / "done"
        self._marks.mkdir(parents=True, exist_ok=True)
        self._previous = ""
        self._log = log
        self._warnings: list[str] = []

    def log(self, level: str, message: str) -> None:
        """Log a message; the warnings of a stage are repeated when it is not run again."""
        if level == "warning":
            self._warnings.append(message)
        self._log(level, message)

    def stage(
        self,
        name: str,
        inputs: Mapping[str, Any],
        outputs: Sequence[str],
        run: Callable[[], dict[str, Any]],
    ) -> dict[str, Any]:
        """Notes of a stage: those of its mark if it is done, else those that `run` returns, after it has been run.

        `outputs` are files or folders below the journal's folder. They are removed before the stage is run. The notes
        must be JSON. What the stage took is in `seconds`.
        """
        text = json.dumps(
            {"stage": name, "version": _core.version, "inputs": inputs, "after": self._previous}, sort_keys=True
        )
        self._previous = key = hashlib.sha256(text.encode()).hexdigest()
        mark = self._marks / f"{name}.json"
        done = read_record(mark) or {}
        if done.get("key") == key and done.get("outputs") == self._states(outputs):
            for warning in done["warnings"]:
                self._log("warning", warning)
        else:
            mark.unlink(missing_ok=True)
            for output in outputs:
                self._remove(self.folder / output)
            start = time.monotonic()
            self._warnings = []
            notes = run()
            done = {
                "key": key,
                "outputs": self._states(outputs),
                "notes": notes,
                "warnings": self._warnings,
                "seconds": round(time.monotonic() - start, 2),
            }
            write_record(mark, done)
        self.seconds[name] = done["seconds"]
        kept: dict[str, Any] = done["notes"]
        return kept

    def _states(self, outputs: Sequence[str]) -> dict[str, int | str]:
        states: dict[str, int | str] = {}
        for output in outputs:
            path = self.folder / output
            files = sorted(path.rglob("*")) if path.is_dir() else [path]
            for file in files:
                if file.is_file():
                    state = sha256_of(file) if file.suffix == ".tif" else file.stat().st_size
                    states[str(file.relative_to(self.folder))] = state
        return states

    @staticmethod
    def _remove(path: Path) -> None:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            database.remove(path)
