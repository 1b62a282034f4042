"""Records which stages of the photogrammetry are done, so that an interrupted run continues with the next stage, and what they took."""

from __future__ import annotations

import hashlib
import json
import resource
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from malus import _core
from malus._files import read_record, sha256_of, write_record
from malus.errors import InputError
from malus.photogrammetry import database
from malus.photogrammetry.diagnosis import Log
from malus.photogrammetry.program import Colmap

#: Set in the notes of a stage that ended for lack of time.
UNFINISHED = "unfinished"

_DATABASES = (".db", ".db-wal", ".db-shm")


def digest(*arrays: NDArray[Any]) -> str:
    """SHA-256 of the numbers of arrays, one after the other, as an input of a stage."""
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


class Journal:
    """Marks of finished stages, `done/<stage>.json` below a folder.

    A stage's key is the hash of malus's version, of the stage's inputs, and of the key and the outputs of the stage before it: a stage
    that runs again, because it was unfinished or its outputs were lost, may give other results. The stage is done if its mark has this key and
    its outputs are unchanged. Outputs are compared by hash; COLMAP's databases, which reading can change, by size.
    """

    def __init__(self, folder: Path, log: Log, colmap: Colmap | None = None) -> None:
        """Keep the marks below `folder`, which is created if needed. `log` gets the stages' messages. Time and memory of
        `colmap` count as those of the stages.
        """
        self.folder = folder
        self.times: dict[str, dict[str, float]] = {}
        self._colmap = colmap
        self._marks = folder / "done"
        self._marks.mkdir(parents=True, exist_ok=True)
        self._previous = ""
        self._log = log
        self._warnings: list[str] = []
        self._watched: dict[Path, str] = {}

    def watch(self, files: Mapping[str, Path]) -> dict[str, str]:
        """Hashes of files that stages read, under the given names. From now on a stage does not count as done if one of these
        files changed while the stage ran.
        """
        hashes = {name: sha256_of(path) for name, path in files.items()}
        self._watched |= {path: hashes[name] for name, path in files.items()}
        return hashes

    def require_unchanged(self) -> None:
        """InputError if a watched file has changed."""
        for path, before in self._watched.items():
            if sha256_of(path) != before:
                raise InputError(f"{path} was changed while it was read; run again")

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
        """Notes of a stage: from its mark if the stage is done, else as `run` returns them.

        `outputs` are files or folders below the journal's folder. They are removed before the stage is run. The notes
        must be JSON. Notes that say UNFINISHED hold for this run only, and the next one repeats the stage. Time and memory of the
        stage go to `times`: `seconds`, `cpu_seconds`, `peak_mb`.
        """
        text = json.dumps(
            {"stage": name, "version": _core.version, "inputs": inputs, "after": self._previous}, sort_keys=True
        )
        key = hashlib.sha256(text.encode()).hexdigest()
        mark = self._marks / f"{name}.json"
        done = read_record(mark) or {}
        if done.get("key") == key and "times" in done and done.get("outputs") == self._states(outputs):
            for warning in done["warnings"]:
                self._log("warning", warning)
        else:
            mark.unlink(missing_ok=True)
            for output in outputs:
                self._remove(self.folder / output)
            meter = _Meter(self._colmap)
            self._warnings = []
            notes = run()
            self.require_unchanged()
            done = {
                "key": key,
                "outputs": self._states(outputs),
                "notes": notes,
                "warnings": self._warnings,
                "times": meter.stop(),
            }
            if not notes.get(UNFINISHED):
                write_record(mark, done)
        self._previous = hashlib.sha256((key + json.dumps(done["outputs"], sort_keys=True)).encode()).hexdigest()
        self.times[name] = done["times"]
        kept: dict[str, Any] = done["notes"]
        return kept

    def total_times(self) -> dict[str, Any]:
        """`seconds`, `cpu_seconds` and `peak_mb` of all stages together, and of each stage (`stages`)."""
        stages = self.times.values()
        return {
            **{name: round(sum(stage[name] for stage in stages), 2) for name in ("seconds", "cpu_seconds")},
            "peak_mb": max((stage["peak_mb"] for stage in stages), default=0.0),
            "stages": self.times,
        }

    def _states(self, outputs: Sequence[str]) -> dict[str, int | str]:
        states: dict[str, int | str] = {}
        for output in outputs:
            path = self.folder / output
            files = sorted(path.rglob("*")) if path.is_dir() else [path]
            for file in files:
                if file.is_file():
                    state = file.stat().st_size if file.suffix in _DATABASES else sha256_of(file)
                    states[str(file.relative_to(self.folder))] = state
        return states

    @staticmethod
    def _remove(path: Path) -> None:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            database.remove(path)


def _children_seconds() -> float:
    """Processor seconds of the child processes that have ended."""
    use = resource.getrusage(resource.RUSAGE_CHILDREN)
    return use.ru_utime + use.ru_stime


class _Meter:
    """Measures time, processor time and memory of this process and of COLMAP, from its construction on."""

    def __init__(self, colmap: Colmap | None) -> None:
        self._colmap = colmap
        if colmap is not None:
            colmap.peak_mb = 0.0
        self._children = _children_seconds()
        self._watch = _core.StepWatch()

    def stop(self) -> dict[str, float]:
        """To be called once. `seconds`, `cpu_seconds`, and `peak_mb`, the most memory that this process and COLMAP had together."""
        times: dict[str, float | None] = json.loads(self._watch.stop())
        peaks = (times["peak_mb"] or 0.0, self._colmap.peak_mb if self._colmap is not None else 0.0)
        return {
            "seconds": round(times["seconds"] or 0.0, 2),
            "cpu_seconds": round((times["cpu_seconds"] or 0.0) + _children_seconds() - self._children, 2),
            "peak_mb": round(max(peaks)),
        }
