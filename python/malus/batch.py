"""Many stations: independent tasks, each with a marker file for its outcome, on this machine, on a Dask cluster, or as an array job."""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from malus import _core
from malus._extra import extra
from malus._files import (
    UNTIL_LEFT_S,
    read_record,
    read_regular,
    remove_unfinished,
    with_relative_paths,
    write_record,
    write_text,
)
from malus.campaign import Campaign, Task
from malus.columns import csv_text
from malus.errors import ExternalError, InputError, MalusError, ResourceError, ending_of, error_of
from malus.options import Options
from malus.pages import template
from malus.photogrammetry.shared_frame import load_cameras
from malus.reconstruction import reconstruct
from malus.report import write_report
from malus.threads import ALL_CORES
from malus.workspace import Workspace

Outcome = dict[str, Any]

_SCHEDULER_TIMEOUT = "20s"

#: Columns of the merged table.
COLUMNS = (
    "station", "status", "reason", "name", "confidence", "reasons", "unit", "gsd", "method", "quality", "coverage",
    "patch_prior_rmse_gsd", "patch_fused_rmse_gsd", "reference_rmse_gsd", "warnings",
)  # fmt: skip


def run_station(task: Task) -> Outcome:
    """Run one station to its end and write its marker; a failure is returned as an outcome, not raised."""
    started = time.monotonic()
    outcome = _outcome(task, "done")
    try:
        outcome["key"] = task.key()
        result = reconstruct(
            task.load(),
            Options(**json.loads(task.options)),
            workspace=task.workspace,
            replace=True,  # after a change of the campaign, another station may have this name and workspace
            keep_maps=False,
            threads=task.threads,
            cameras=load_cameras(Path(task.cameras)) if task.cameras else None,
        )
        if task.report:
            write_report(task.workspace)
        outcome["figures"] = _figures(result.quality) if result.quality else {}
        # So that a result that is later removed or replaced does not count as done.
        outcome["manifest"] = _manifest(task)
    except Exception as error:  # no error of one station may end the others
        code, reason = ending_of(error)
        outcome |= _outcome(task, "failed", reason, code)
    outcome["seconds"] = round(time.monotonic() - started, 3)
    write_record(task.marker, outcome)
    return outcome


def run_campaign(
    campaign: Campaign,
    output: str | Path,
    *,
    jobs: int = 1,
    threads: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    cameras: Path | None = None,
    progress: Callable[[int, int, Outcome], None] | None = None,
) -> list[Outcome]:
    """Run the stations of a campaign that are not done yet, and merge the results of all that are.

    OUTPUT gets stations/NAME/ (a workspace each), done/NAME.json (how each ended), and campaign.csv, campaign.json and
    index.html over all stations. jobs: number of stations that run at the same time, each in a process of this machine; threads:
    of each station (default: all cores, divided among the jobs; on a Dask worker those of its machine, divided among the stations
    that it runs at a time). scheduler: address of a Dask scheduler whose workers see the same files; needs the extra "dask".
    shard (i, n): only every n-th station, from the i-th on (1 ≤ i ≤ n), for array jobs.
    cameras: folder with a file of cameras for each station (malus.photogrammetry.shared_frame) that has none of its own.
    Stations that failed before are tried again. A script that calls this at its top level needs `if __name__ == "__main__":`
    around the call, because the processes import the script. progress: how many stations this run has ended, of how many, and
    the outcome of the last one. Returns the outcomes of all stations of the campaign, as `outcomes_of`; `status` is done, failed
    or pending.
    """
    if jobs < 1:
        raise InputError(f"--jobs {jobs}, expected at least 1")
    if shard is not None:
        checked_shard(*shard, "shard")
    for folder in (Path(output), Path(output) / "done"):
        remove_unfinished(folder, older_than_s=UNTIL_LEFT_S)
    tasks = campaign.tasks(output, threads or max(1, ALL_CORES // jobs), cameras)
    mine = tasks if shard is None else tasks[shard[0] - 1 :: shard[1]]
    open_tasks = [task for task in mine if _marker(task).get("status") != "done"]
    if open_tasks:
        finished = (
            _on_this_machine(open_tasks, jobs) if scheduler is None else _on_cluster(open_tasks, scheduler, threads)
        )
        with closing(finished):  # ends the processes if `progress` raises an error, or Ctrl-C comes while it runs
            for count, outcome in enumerate(finished, start=1):
                if progress is not None:
                    progress(count, len(open_tasks), outcome)
    return _merge(campaign, tasks, Path(output))


def outcomes_of(campaign: Campaign, output: str | Path, cameras: Path | None = None) -> list[Outcome]:
    """The outcomes of all stations of a campaign, pending where an outcome is not valid any more; nothing is run."""
    return [_marker(task) for task in campaign.tasks(output, 1, cameras)]


def shard_of_environment() -> tuple[int, int] | None:
    """The shard of a Slurm array job (SLURM_ARRAY_TASK_ID, _MIN, _MAX, _STEP and _COUNT), or None outside of one.

    InputError for an array with gaps, such as 1,3,7: Slurm does not say which of its tasks this one is.
    """
    if "SLURM_ARRAY_TASK_ID" not in os.environ or "SLURM_ARRAY_TASK_COUNT" not in os.environ:
        return None
    try:
        task, count = (int(os.environ[f"SLURM_ARRAY_TASK_{name}"]) for name in ("ID", "COUNT"))
        first = int(os.environ.get("SLURM_ARRAY_TASK_MIN", "0"))
        step = int(os.environ.get("SLURM_ARRAY_TASK_STEP", "1"))
        last = int(os.environ.get("SLURM_ARRAY_TASK_MAX", first + (count - 1) * step))
    except ValueError:
        raise InputError(
            "SLURM_ARRAY_TASK_ID, _MIN, _MAX, _STEP and _COUNT are not all numbers; give --shard i/n instead"
        ) from None
    if step < 1 or (task - first) % step or last - first != (count - 1) * step:
        raise InputError(
            f"SLURM_ARRAY_TASK_ID = {task} of {count} tasks from {first} to {last}: the array has gaps, expected one as "
            "--array=0-7 or --array=1-15:2; or give --shard i/n"
        )
    return checked_shard((task - first) // step + 1, count, "SLURM_ARRAY_TASK_ID and SLURM_ARRAY_TASK_COUNT")


def parse_shard(text: str) -> tuple[int, int]:
    """Parse the value `i/n` of --shard."""
    parts = text.split("/")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise InputError(f"--shard {text}, expected i/n such as 3/8")
    return checked_shard(int(parts[0]), int(parts[1]), f"--shard {text}")


def checked_shard(index: int, count: int, where: str) -> tuple[int, int]:
    """The shard, if 1 ≤ index ≤ count; otherwise InputError, whose message begins with `where`, the source of the numbers."""
    if not 1 <= index <= count:
        raise InputError(f"{where}: shard {index} of {count}, expected 1 ≤ i ≤ n")
    return index, count


def failure(outcomes: Sequence[Outcome]) -> MalusError | None:
    """The error with which the command line ends if stations failed: it lists all of them with their reasons and has the first
    one's exit code; None if none failed.
    """
    failed = [outcome for outcome in outcomes if outcome["status"] == "failed"]
    if not failed:
        return None
    pending = sum(outcome["status"] == "pending" for outcome in outcomes)  # of other shards
    waiting = f", {pending} {'is' if pending == 1 else 'are'} not run yet" if pending else ""
    others = "; the others are done" if len(outcomes) > len(failed) + pending else ""
    lines = [f"{len(failed)} of {len(outcomes)} stations failed{waiting}{others}"]
    lines += [f"  {outcome['station']}: {outcome['reason']}" for outcome in failed]
    return error_of(failed[0]["exit_code"])("\n".join(lines))


def _outcome(task: Task, status: str, reason: str = "", exit_code: int = 0) -> Outcome:
    return {
        "station": task.identifier, "file": task.station, "status": status, "reason": reason, "exit_code": exit_code
    }  # fmt: skip


def _killed(task: Task, reason: str) -> Outcome:
    """Write the marker of a station whose process was killed before it could."""
    outcome = {**_outcome(task, "failed", reason, ResourceError.exit_code), "key": task.key(), "seconds": 0.0}
    write_record(task.marker, outcome)
    return outcome


def _end_with_parent() -> None:
    """End this process when its parent process ends, for whatever reason: nobody would collect the results, and this process
    would keep its station's workspace locked.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(ResourceError.exit_code)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes for stations. They end with this process. If it is interrupted, they end at once, and waiting stations are not run."""
    others = set(multiprocessing.active_children())
    # Fresh processes, not forks: this process may have threads and hold locks.
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=_end_with_parent)
    try:
        yield pool
    except (KeyboardInterrupt, GeneratorExit):
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _submitted(pool: ProcessPoolExecutor, tasks: Sequence[Task]) -> list[Future[Outcome]]:
    """Submit the tasks to the pool. Its processes ignore Ctrl-C, which a terminal sends to all processes: this process ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return [pool.submit(run_station, task) for task in tasks]
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_this_machine(tasks: Sequence[Task], jobs: int) -> Generator[Outcome, None, None]:
    left = {task.identifier: task for task in tasks}
    try:
        with _processes(min(jobs, len(tasks))) as pool:
            for future in as_completed(_submitted(pool, tasks)):
                outcome = future.result()
                del left[outcome["station"]]
                yield outcome
    except BrokenProcessPool:
        # A process was killed (most often for its memory), and the pool does not say at which station. Running one at a time does.
        for task in left.values():
            try:
                with _processes(1) as pool:
                    yield _submitted(pool, [task])[0].result()
            except BrokenProcessPool:
                yield _killed(task, "its process was killed, perhaps out of memory (see malus check)")


def _run_on_worker(task: Task, threads: int | None, version: str) -> Outcome:
    """`run_station` on a Dask worker. threads: None = the cores of the worker's machine, divided among the stations it runs at a time.

    ExternalError if the worker's Malus is not the `version` that asks for the station: what it makes would not count as done there.
    """
    if version != _core.version:
        raise ExternalError(
            f"a Dask worker has Malus {_core.version}, this program is {version}; expected the same version on all machines"
        )
    if threads is None:
        worker = extra("distributed", "distributed", "--scheduler", "dask").get_worker()
        threads = max(1, ALL_CORES // worker.state.nthreads)
    return run_station(replace(task, threads=threads))


def _on_cluster(tasks: Sequence[Task], address: str, threads: int | None) -> Generator[Outcome, None, None]:
    distributed = extra("distributed", "distributed", "--scheduler", "dask")
    try:
        client = distributed.Client(address, timeout=_SCHEDULER_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ExternalError(f"--scheduler {address}: no Dask scheduler answers ({error})") from None
    with client:
        # If a worker dies, its station goes to another worker, which resumes the workspace.
        futures = {
            client.submit(
                _run_on_worker, task, threads, _core.version, key=f"malus-{task.identifier}-{task.key()}", pure=False
            ): task
            for task in tasks
        }
        # Silence Dask's traceback for a lost scheduler: the error below reports it.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        for future in distributed.as_completed(futures):
            try:
                failed_with = future.exception()
                outcome = future.result() if failed_with is None else None
            except distributed.CancelledError:
                raise ExternalError(
                    f"--scheduler {address}: the Dask scheduler was lost or the stations were canceled there; "
                    "what is done is kept, and the same command goes on"
                ) from None
            if outcome is not None:
                yield outcome
            elif isinstance(failed_with, distributed.KilledWorker):
                yield _killed(futures[future], "its workers were killed again and again, perhaps out of memory")
            else:
                raise failed_with


def _marker(task: Task) -> Outcome:
    """The outcome of a station, if it is still valid; otherwise pending. Results are valid if their manifest is unchanged and
    its files exist with their sizes. Their content is not checked: reading a whole campaign would take longer than some stations.
    """
    pending = _outcome(task, "pending")
    outcome = read_record(task.marker)
    if outcome is None or outcome.get("key") != task.key():
        return pending
    if outcome["status"] == "done" and not (outcome.get("manifest") == _manifest(task) and _has_results(task)):
        return pending
    return outcome


def _has_results(task: Task) -> bool:
    try:
        outputs = Workspace(task.workspace).outputs
        return all((task.workspace / name).stat().st_size == output["size"] for name, output in outputs.items())
    except (InputError, OSError):
        return False


def _manifest(task: Task) -> str | None:
    """SHA-256 of the manifest of a station's results, without the times and the entry of the report, which shows them; None if there is no
    manifest or it cannot be read. Two equal runs have the same hash, so that objects made of them have the same records.
    """
    try:
        manifest = json.loads(read_regular(task.workspace / "manifest.json"))
        del manifest["times"]
        if "report" in manifest["steps"]:
            manifest["steps"]["report"] = "done"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _figures(quality: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of a station that the merged table shows."""

    # Means over different patches could not be compared.
    both = [patch for patch in quality["patches"] if patch["prior"] is not None and patch["fused"] is not None]

    def mean_patch(surface: str) -> float | None:
        return sum(patch[surface]["rmse_gsd"] for patch in both) / len(both) if both else None

    reference = quality["reference"]
    return {
        "name": quality["name"],
        "confidence": quality["confidence"]["level"],
        "reasons": " ".join(quality["confidence"]["reasons"]),
        "unit": quality["unit"],
        "gsd": quality["gsd"],
        "method": quality["method"],
        "quality": quality["status"],
        "coverage": quality["coverage"]["fraction"],
        "patch_prior_rmse_gsd": mean_patch("prior"),
        "patch_fused_rmse_gsd": mean_patch("fused"),
        "reference_rmse_gsd": reference["distance_gsd"]["rmse"] if reference else None,
        "warnings": "; ".join(quality["warnings"]),
    }


def _as_text(value: object) -> object:
    """A cell that spreadsheet programs do not take for a formula, whatever character its text begins with."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def _merge(campaign: Campaign, tasks: Sequence[Task], output: Path) -> list[Outcome]:
    """Write the tables and the page over all stations. Nothing in them depends on when or where a station ran."""
    page = template("campaign.html.j2")
    outcomes = [_marker(task) for task in tasks]
    while True:
        rows = [
            {
                "station": outcome["station"],
                "status": outcome["status"],
                "reason": with_relative_paths(outcome["reason"], campaign.folder),
            }
            | {column: outcome.get("figures", {}).get(column) for column in COLUMNS[3:]}
            for outcome in outcomes
        ]
        write_text(output / "campaign.csv", csv_text(COLUMNS, (map(_as_text, row.values()) for row in rows)))
        record = {"campaign": campaign.name, "version": _core.version, "stations": rows}
        write_text(output / "campaign.json", json.dumps(record, indent=1) + "\n")
        counts = {status: sum(row["status"] == status for row in rows) for status in ("done", "failed", "pending")}
        write_text(
            output / "index.html",
            page.render(campaign=campaign, rows=rows, counts=counts, version=_core.version),
        )
        # Another shard may have finished a station meanwhile, and its tables may have been overwritten by ours: write them again.
        now = [_marker(task) for task in tasks]
        if now == outcomes:
            return outcomes
        outcomes = now
