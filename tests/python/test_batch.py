"""Many stations: campaign file, merged table, broken stations, shards, killed workers."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import malus.batch
from conftest import edit, half_written, malus_here, needs_distributed
from conftest import malus as run_malus
from malus._files import read_record, write_record
from malus.campaign import Campaign, Task
from malus.cli import many
from malus.options import Options

CAMPAIGN = """
[campaign]
name = "museum"
stations = ["objects/*/station.toml"]
report = false

[options]
fusion = "grid"
[options.prior]
smoothing_px = 4
[options.height]
iterations = 2
"""


def campaign_of(folder: Path, source: Path, count: int) -> Path:
    """A campaign of copies of a station that differ in name."""
    for k in range(count):
        shutil.copytree(source, folder / "objects" / f"o{k:02}")
        edit(folder / "objects" / f"o{k:02}" / "station.toml", 'name = "small"', f'name = "object {k}"')
    (folder / "campaign.toml").write_text(CAMPAIGN)
    return folder / "campaign.toml"


def results(output: Path) -> dict[str, bytes]:
    """Every file that must not depend on how the campaign was run."""
    names = ["campaign.csv", "campaign.json", "index.html"]
    names += [str(path.relative_to(output)) for path in output.glob("stations/*/fused/*")]
    names += [str(path.relative_to(output)) for path in output.glob("stations/*/quality.json")]
    return {name: (output / name).read_bytes() for name in sorted(names)}


@pytest.fixture(scope="module")
def three(tiny_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Campaign file and output folder of a finished campaign of three stations, the second of which is broken."""
    file = campaign_of(tmp_path_factory.mktemp("three"), tiny_station_source, 3)
    edit(file.parent / "objects/o01/station.toml", "angles_deg = [0, 30,", "angles_deg = [0,")
    output = file.parent / "out"
    outcome = run_malus("batch", file, "-o", output, "--jobs", "2", "--threads", "1")
    assert outcome.code == 2, outcome.err
    assert "1 of 3 stations failed" in outcome.err
    # A log names every station, not only the one that ended last.
    for said in ("o00: done", "o01: failed", "o02: done"):
        assert f" %  batch         {said}\n" in outcome.err
    assert outcome.out.splitlines() == [
        "museum: 2 of 3 stations done; confidence: 2 partial",
        f"  page: {output / 'index.html'}",
    ]
    assert "o01: " in outcome.err and "angles_deg" in outcome.err
    assert "Traceback" not in outcome.err
    return file, output


def test_a_campaign_reports_its_start_at_once(three: tuple[Path, Path]) -> None:
    file, output = three
    first = json.loads(malus_here("batch", file, "-o", output, "--json").out.splitlines()[0])
    assert (first["fraction"], first["message"], first["seconds_left"]) == (0.0, "3 stations", None)


def test_a_later_run_says_which_stations_it_has_run(three: tuple[Path, Path]) -> None:
    file, output = three
    said = malus_here("batch", file, "-o", output).out.splitlines()
    assert said[1:] == ["  run now: o01; run before or elsewhere: 2", f"  page: {output / 'index.html'}"]


def test_stations_of_other_shards_are_not_of_an_earlier_run_and_long_lists_end() -> None:
    outcomes = [{"station": f"o{k}", "status": "done" if k < 9 else "pending"} for k in range(10)]
    (said,) = many._words_on_runs(outcomes, [f"o{k}" for k in range(8)])
    assert said == "  run now: o0, o1, o2, o3, o4, o5 and 2 more; run before or elsewhere: 1"
    assert many._words_on_runs(outcomes, [f"o{k}" for k in range(9)]) == []


def test_broken_station_is_listed_and_the_others_finish(three: tuple[Path, Path]) -> None:
    file, output = three
    rows = json.loads((output / "campaign.json").read_text())["stations"]
    assert [(row["station"], row["status"]) for row in rows] == [("o00", "done"), ("o01", "failed"), ("o02", "done")]
    assert "angles_deg" in rows[1]["reason"]
    assert rows[1]["reason"].startswith("o01/station.toml, line ")
    for name in ("campaign.csv", "campaign.json", "index.html"):
        assert str(file.parent) not in (output / name).read_text()
    assert rows[0]["name"] == "object 0" and rows[0]["gsd"] > 0 and rows[0]["patch_fused_rmse_gsd"] > 0
    assert rows[0]["confidence"] == "partial" and "grid transfer" in rows[0]["reasons"]
    assert rows[1]["confidence"] is None
    assert (output / "campaign.csv").read_text().count("\n") == 4
    page = (output / "index.html").read_text()
    assert "2 done, 1 failed" in page and "o01" in page
    assert "</b>, done" not in page and "not converged" not in page
    assert page.count("confidence partial") == 2 and "grid transfer takes all detail" in page
    assert (output / "stations/o02/fused/surface.ply").exists()


def test_done_stations_are_not_run_again_but_corrected_ones_are(three: tuple[Path, Path], tmp_path: Path) -> None:
    file = shutil.copytree(three[0].parent, tmp_path / "copy") / "campaign.toml"
    output = file.parent / "out"
    ran: list[str] = []
    campaign = Campaign.load(file)
    # The record of a finished station holds its path: in another folder every station is pending.
    assert {malus.batch._marker(task)["status"] for task in campaign.tasks(output, 1)} == {"pending"}
    campaign = Campaign.load(three[0])
    edit(three[0].parent / "objects/o01/station.toml", "angles_deg = [0,", "angles_deg = [0, 30,")
    outcomes = malus.batch.run_campaign(
        campaign, three[1], progress=lambda done, total, outcome: ran.append(outcome["station"])
    )
    assert ran == ["o01"] and outcomes == malus.batch.outcomes_of(campaign, three[1])
    assert [outcome["status"] for outcome in outcomes] == ["done"] * 3
    assert malus.batch.failure(outcomes) is None


@pytest.fixture(scope="module")
def undisturbed(tiny_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    """A campaign of three stations, and the results of one run of it."""
    file = campaign_of(tmp_path_factory.mktemp("undisturbed"), tiny_station_source, 3)
    assert malus_here("batch", file, "-o", file.parent / "out", "--threads", "1", "--quiet").code == 0
    return file, results(file.parent / "out")


def test_shards_together_equal_one_run(undisturbed: tuple[Path, dict[str, bytes]]) -> None:
    file, expected = undisturbed
    shards = file.parent / "shards"  # beside the other run: the manifests have relative paths of the inputs
    for index in ("1/2", "2/2"):
        shard = ("--shard", index, "--threads", "1", "--quiet")
        assert malus_here("batch", file, "-o", shards, *shard).code == 0
        rows = json.loads((shards / "campaign.json").read_text())["stations"]
        assert [row["status"] for row in rows].count("done") == (2 if index == "1/2" else 3)
    assert results(shards) == expected
    one, other = (
        [read_record(path) or {} for path in sorted((folder / "done").glob("*.json"))]
        for folder in (shards, file.parent / "out")
    )
    # An object's quality.json has them in its key, and must be the same for the same inputs.
    assert [marker["manifest"] for marker in one] == [marker["manifest"] for marker in other] and len(one) == 3


def test_the_report_of_a_station_does_not_change_its_marker(tmp_path: Path) -> None:
    """The page shows the times of the steps. A report that is missing, and other results, count."""
    task = Task("a", "a.toml", str(tmp_path), "{}", 1, True)
    task.workspace.mkdir(parents=True)
    steps = {"fuse": {"checksum": "1"}, "report": {"checksum": "2"}}
    found = []
    for changed in ({}, {"report": {"checksum": "3"}}, {"fuse": {"checksum": "4"}}):
        (task.workspace / "manifest.json").write_text(json.dumps({"steps": steps | changed, "times": {}}))
        found.append(malus.batch._manifest(task))
    (task.workspace / "manifest.json").write_text(json.dumps({"steps": {"fuse": steps["fuse"]}, "times": {}}))
    found.append(malus.batch._manifest(task))
    assert None not in found and found[0] == found[1] and len(set(found)) == 3


def test_a_shard_that_fails_does_not_call_the_others_done() -> None:
    def outcome(status: str) -> dict[str, object]:
        return {"station": "a", "status": status, "reason": "no light" * (status == "failed"), "exit_code": 3}

    outcomes = [outcome(status) for status in ("done", "failed", "pending", "pending")]
    error = malus.batch.failure(outcomes)
    assert "1 of 4 stations failed, 2 are not run yet; the others are done\n  a: no light" in str(error)
    assert "1 of 2 stations failed; the others are done" in str(malus.batch.failure(outcomes[:2]))
    assert str(malus.batch.failure(outcomes[1:2])).startswith("1 of 1 stations failed\n")
    assert str(malus.batch.failure(outcomes[1:])).startswith("1 of 3 stations failed, 2 are not run yet\n")


def test_a_station_is_done_only_while_its_inputs_and_results_are_unchanged(
    tiny_station_source: Path, tmp_path: Path
) -> None:
    """Every file that the station reads counts, inside its folder or not, and its results must be complete."""
    file = campaign_of(tmp_path, tiny_station_source, 2)
    shutil.move(tmp_path / "objects/o00/pol", tmp_path / "shared")
    edit(tmp_path / "objects/o00/station.toml", '"pol/', '"../../shared/')
    output = tmp_path / "out"

    def run() -> list[str]:
        ran: list[str] = []
        malus.batch.run_campaign(
            Campaign.load(file), output, progress=lambda done, total, outcome: ran.append(outcome["station"])
        )
        return ran

    assert run() == ["o00", "o01"]
    assert run() == []
    image = tmp_path / "shared/pol_000.tif"
    image.write_bytes(image.read_bytes())
    assert run() == ["o00"], "written anew"
    shutil.rmtree(output / "stations/o01")
    assert run() == ["o01"]
    os.truncate(output / "stations/o01/fused/depth.tif", 1000)
    assert run() == ["o01"]
    (output / "stations/o00/fused/normals.tif").unlink()
    assert run() == ["o00"]
    (tmp_path / "objects/o01/station.toml").unlink()
    edit(file, "objects/*/station.toml", 'objects/o00/station.toml", "objects/o01/station.toml')
    assert [malus.batch._marker(task)["status"] for task in Campaign.load(file).tasks(output, 1)] == ["done", "pending"]


def test_concurrent_merges_leave_complete_tables(three: tuple[Path, Path]) -> None:
    file, output = three
    merge = (
        "import sys, malus.batch; from malus.campaign import Campaign\n"
        "tasks = (campaign := Campaign.load(sys.argv[1])).tasks(sys.argv[2], 1)\n"
        "for _ in range(15): malus.batch._merge(campaign, tasks, malus.batch.Path(sys.argv[2]))"
    )
    command = [sys.executable, "-c", merge, str(file), str(output)]
    whole = (output / "campaign.json").read_text()
    shards = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for shard in shards:
        _, err = shard.communicate(timeout=300)
        assert shard.returncode == 0, err
    assert (output / "campaign.json").read_text() == whole
    assert not half_written(output)


def started_batch(file: Path, output: Path) -> subprocess.Popen[str]:
    """Start `malus batch` with two processes; returns once the first station has begun."""
    run = subprocess.Popen(
        [sys.executable, "-m", "malus.cli", "batch", file, "-o", output, "--jobs", "2", "--threads", "1", "--quiet"],
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    while not list(output.glob("stations/*/manifest.json")):
        assert run.poll() is None
        time.sleep(0.02)
    return run


def workers_of(output: Path) -> list[str]:
    """Command lines of processes that have files of the campaign's output open."""
    held = []
    for descriptors in Path("/proc").glob("[0-9]*/fd"):
        try:
            targets = [os.readlink(link) for link in descriptors.iterdir()]
        except OSError:  # ended meanwhile, or another user's
            continue
        if any(target.startswith(str(output)) for target in targets):
            held.append((descriptors.parent / "cmdline").read_text())
    return held


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_batch_runs_no_further_station(
    tiny_station_source: Path, tmp_path: Path, sent: signal.Signals
) -> None:
    """It leaves no processes behind either: they would hold workspaces that the next batch needs."""
    file = campaign_of(tmp_path, tiny_station_source, 12)
    run = started_batch(file, tmp_path / "out")
    if sent == signal.SIGINT:  # as a terminal does
        os.killpg(run.pid, sent)
    else:
        run.send_signal(sent)
    _, err = run.communicate(timeout=120)
    assert run.returncode == (-sent if sent == signal.SIGKILL else 130), err
    assert "Traceback" not in err
    for _ in range(600):
        if not workers_of(tmp_path / "out"):
            break
        time.sleep(0.1)
    assert not workers_of(tmp_path / "out")
    assert len(list((tmp_path / "out").glob("done/*.json"))) < 12


def test_an_error_of_the_caller_leaves_no_process(tiny_station_source: Path, tmp_path: Path) -> None:
    """While the error is kept, as notebooks do, the processes went on and held workspaces."""
    campaign = Campaign.load(campaign_of(tmp_path, tiny_station_source, 3))

    def fail(*_: object) -> None:
        raise RuntimeError("of the caller")

    with pytest.raises(RuntimeError, match="of the caller") as kept:
        malus.batch.run_campaign(campaign, tmp_path / "out", threads=1, progress=fail)
    assert not multiprocessing.active_children(), kept.value


def test_array_job_takes_its_shard_from_slurm(monkeypatch: pytest.MonkeyPatch) -> None:
    assert malus.batch.shard_of_environment() is None
    for name, value in (("ID", "5"), ("MIN", "4"), ("COUNT", "3")):
        monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", value)
    assert malus.batch.shard_of_environment() == (2, 3)
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "1")
    with pytest.raises(malus.InputError, match="SLURM_ARRAY_TASK_ID"):
        malus.batch.shard_of_environment()


def shards_of_array(monkeypatch: pytest.MonkeyPatch, tasks: range | list[int], step: int) -> list[tuple[int, int]]:
    """The shards of all tasks of an array job, whose environment Slurm sets as here."""
    said = {"MIN": min(tasks), "MAX": max(tasks), "STEP": step, "COUNT": len(tasks)}
    shards = []
    for task in tasks:
        for name, value in {**said, "ID": task}.items():
            monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", str(value))
        shard = malus.batch.shard_of_environment()
        assert shard is not None
        shards.append(shard)
    return shards


def test_an_array_job_with_a_step_runs_every_shard(monkeypatch: pytest.MonkeyPatch) -> None:
    assert shards_of_array(monkeypatch, range(1, 11, 2), 2) == [(k, 5) for k in range(1, 6)]
    assert shards_of_array(monkeypatch, range(4, 7), 1) == [(k, 3) for k in range(1, 4)]
    assert shards_of_array(monkeypatch, [7], 1) == [(1, 1)]


@pytest.mark.parametrize("tasks", [[1, 3, 7], [0, 1, 3], [3, 7]])
def test_an_array_job_with_gaps_is_refused(monkeypatch: pytest.MonkeyPatch, tasks: list[int]) -> None:
    """Otherwise its first tasks ran, and nobody the shards in the gaps."""
    with pytest.raises(malus.InputError, match=rf"{len(tasks)} tasks from {tasks[0]} to {tasks[-1]}: .*gaps.*--shard"):
        shards_of_array(monkeypatch, tasks, 1)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("stations =", "station =", "unknown key campaign.station; did you mean stations?"),
        ('["objects/*/station.toml"]', "[]", "expected a list of station files or globs"),
        ('stations = ["objects/*/station.toml"]', "", "campaign.stations is missing"),
        ("objects/*/", "things/*/", "no file matches"),
        ("iterations = 2", "iteration = 2", "height.iteration"),
        ("report = false", "report = 3", "expected true or false"),
        ("[campaign]", "[campaign", "not TOML"),
    ],
)
def test_errors_in_campaign_files_are_explained(
    tiny_station_source: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = edit(campaign_of(tmp_path, tiny_station_source, 1), old, new)
    outcome = malus_here("batch", file, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert message in outcome.err and str(file) in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize("shard", [(0, 2), (3, 2)])
def test_shards_from_python_are_checked(tiny_station_source: Path, tmp_path: Path, shard: tuple[int, int]) -> None:
    campaign = Campaign.load(campaign_of(tmp_path, tiny_station_source, 1))
    with pytest.raises(malus.InputError, match=rf"shard {shard[0]} of 2, expected 1 ≤ i ≤ n"):
        malus.batch.run_campaign(campaign, tmp_path / "out", shard=shard)


@pytest.mark.parametrize("arguments", [["--shard", "3/2"], ["--shard", "x"], ["--shard", "²/8"], ["--jobs", "0"]])
def test_wrong_command_lines(tiny_station_source: Path, tmp_path: Path, arguments: list[str]) -> None:
    file = campaign_of(tmp_path, tiny_station_source, 1)
    outcome = malus_here("batch", file, "-o", tmp_path / "out", *arguments)
    assert outcome.code == 2
    assert arguments[0] in outcome.err


def test_long_names_of_folders_leave_room_for_their_markers(tmp_path: Path) -> None:
    """The marker could not be written, and one such station ended the whole campaign."""
    names = ["ä" * 120 + end for end in "ab"] + ["c" * 250]
    files = tuple(tmp_path / name / "station.toml" for name in names)
    tasks = Campaign("long", files, Options(), False).tasks(tmp_path / "out", 1)
    assert len({task.identifier for task in tasks}) == 3 and tasks[2].identifier.startswith("ccc")
    for task in tasks:
        write_record(task.marker, {})
        assert read_record(task.marker) == {}


def test_stations_with_the_same_folder_name_stay_apart(tiny_station_source: Path, tmp_path: Path) -> None:
    for folder in ("a/bust", "b/bust"):
        shutil.copytree(tiny_station_source, tmp_path / folder)
    (tmp_path / "campaign.toml").write_text('[campaign]\nstations = ["a/bust/station.toml", "b/bust/station.toml"]\n')
    tasks = Campaign.load(tmp_path / "campaign.toml").tasks(tmp_path / "out", 1)
    assert [task.identifier for task in tasks] == ["bust", "bust-2"]


def test_a_station_is_done_only_while_the_masks_of_its_photos_are_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("views/a.jpg", "masks/a.jpg.png"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    said = {"files": [], "photos": {"folder": str(tmp_path / "views"), "masks": str(tmp_path / "masks")}}
    station = SimpleNamespace(load=lambda path, photos_of: SimpleNamespace(describe=lambda: said))
    monkeypatch.setattr("malus.campaign.Station", station)
    task = Task("a", str(tmp_path / "station.toml"), str(tmp_path), "{}", 1, False)
    before = task.key()
    assert task.key() == before
    (tmp_path / "masks/a.jpg.png").write_bytes(b"changed")
    assert task.key() != before


def test_a_folder_with_brackets_in_its_name_is_no_pattern(tmp_path: Path) -> None:
    for name in ("bust [1]", "bust 1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "station.toml").touch()
    for stations, found in (("bust [1]/station.toml", ["bust [1]"]), ("bust [0-9]/station.toml", ["bust 1"])):
        (tmp_path / "campaign.toml").write_text(f'[campaign]\nstations = ["{stations}"]\n')
        assert [path.parent.name for path in Campaign.load(tmp_path / "campaign.toml").stations] == found


def test_thousands_of_stations_are_named_at_once() -> None:
    def campaign(folders: list[str]) -> Campaign:
        return Campaign(
            "many", tuple(Path(f"/{k}/{name}/station.toml") for k, name in enumerate(folders)), Options(), False
        )

    names = [task.identifier for task in campaign(["a", "a-2", "a", "a", "b-1", "b-1", "b", "a-2"]).tasks("out", 1)]
    assert names == ["a", "a-2", "a-3", "a-4", "b-1", "b-1-2", "b-2", "a-2-2"]
    # On a network disk of Windows the second coin would take over the first one's workspace and marker, again and again.
    names = [task.identifier for task in campaign(["Coin", "coin", "COIN-2", "Straße", "STRASSE"]).tasks("out", 1)]
    assert names == ["Coin", "coin-2", "COIN-2-2", "Straße", "STRASSE-2"]
    start = time.process_time()
    assert len(set(task.identifier for task in campaign([f"o{k}" for k in range(5000)]).tasks("out", 1))) == 5000
    assert time.process_time() - start < 10  # 0.1 s; with a comparison of each name with all others 40 s


@needs_distributed
def test_a_missing_scheduler_is_reported(
    tiny_station_source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = campaign_of(tmp_path, tiny_station_source, 1)
    monkeypatch.setattr(malus.batch, "_SCHEDULER_TIMEOUT", "1s")
    with pytest.raises(malus.ExternalError, match="no Dask scheduler answers"):
        malus.batch.run_campaign(Campaign.load(file), tmp_path / "out", scheduler="tcp://127.0.0.1:9")


@needs_distributed
def test_a_worker_uses_its_own_cores_and_must_have_the_same_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stations got as many threads as the client has cores; those of a worker of another version stayed pending, with exit code 0."""
    import distributed

    task = Task("a", str(tmp_path / "station.toml"), str(tmp_path), "{}", 7, False)
    worker = SimpleNamespace(state=SimpleNamespace(nthreads=3))
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    monkeypatch.setattr(malus.batch, "ALL_CORES", 12)
    monkeypatch.setattr(malus.batch, "run_station", lambda task: {"threads": task.threads})
    assert malus.batch._run_on_worker(task, None, malus.__version__) == {"threads": 4}
    assert malus.batch._run_on_worker(task, 2, malus.__version__) == {"threads": 2}
    with pytest.raises(malus.ExternalError, match=r"this program is 9\.9\.9; expected the same version"):
        malus.batch._run_on_worker(task, 2, "9.9.9")


@needs_distributed
@pytest.mark.filterwarnings("ignore")  # Dask's own warnings while it loses a worker
def test_a_killed_worker_loses_no_result(tiny_station_source: Path, tmp_path: Path) -> None:
    import distributed

    file = campaign_of(tmp_path, tiny_station_source, 5)
    edit(file.parent / "objects/o03/station.toml", "angles_deg = [0, 30,", "angles_deg = [0,")
    campaign = Campaign.load(file)
    ended: list[str] = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        processes = [worker.pid for worker in cluster.workers.values()]

        def kill() -> None:
            while len(ended) < 2:
                time.sleep(0.02)
            os.kill(processes[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        outcomes = malus.batch.run_campaign(
            campaign,
            tmp_path / "cluster",
            threads=1,
            scheduler=cluster.scheduler_address,
            progress=lambda done, total, outcome: ended.append(outcome["station"]),
        )
        killer.join()
    assert sorted(ended) == [f"o{k:02}" for k in range(5)]
    assert [outcome["status"] for outcome in outcomes] == ["failed" if k == 3 else "done" for k in range(5)]
    malus.batch.run_campaign(campaign, tmp_path / "serial", threads=1)
    assert results(tmp_path / "cluster") == results(tmp_path / "serial")


@needs_distributed
@pytest.mark.filterwarnings("ignore")  # Dask's own warnings while it loses its scheduler
def test_a_killed_scheduler_is_reported_and_loses_no_result(
    undisturbed: tuple[Path, dict[str, bytes]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(malus.batch, "_SCHEDULER_TIMEOUT", "5s")
    campaign = Campaign.load(undisturbed[0])
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"

    def dask(part: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *words, "--no-dashboard"]
        return subprocess.Popen(command, stderr=subprocess.DEVNULL)

    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", str(port))
    worker = dask("worker", address, "--nthreads", "1")
    try:
        for _ in range(1200):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                break
            time.sleep(0.1)
        ended: list[str] = []

        def kill(done: int, total: int, outcome: malus.batch.Outcome) -> None:
            ended.append(outcome["station"])
            scheduler.kill()

        with pytest.raises(malus.ExternalError, match="scheduler was lost.*the same command goes on"):
            malus.batch.run_campaign(campaign, tmp_path / "out", threads=1, scheduler=address, progress=kill)
    finally:
        scheduler.kill()
        worker.terminate()
        scheduler.wait()
        worker.wait()
    assert not [record for record in caplog.records if record.exc_info], "no traceback of Dask's"
    malus.batch.run_campaign(
        campaign, tmp_path / "out", threads=1, progress=lambda *told: ended.append(told[2]["station"])
    )
    assert len(set(ended)) == len(ended), "none is run twice"
    assert results(tmp_path / "out") == undisturbed[1]


def test_plane_figures_of_the_table_are_of_the_same_patches() -> None:
    """The prior's mean was over other patches where one of the surfaces has a hole."""
    fits = [(0.2, 0.1), (None, 3.0), (5.0, None)]
    patches = [
        {"prior": prior and {"rmse_gsd": prior}, "fused": fused and {"rmse_gsd": fused}} for prior, fused in fits
    ]
    quality = {
        "name": "1", "confidence": {"level": "high", "reasons": []}, "unit": "mm", "gsd": 0.1, "method": "refined", "status": "done",
        "coverage": {"fraction": 1.0}, "reference": None, "warnings": [],
    }  # fmt: skip
    figures = malus.batch._figures({**quality, "patches": patches})
    assert (figures["patch_prior_rmse_gsd"], figures["patch_fused_rmse_gsd"]) == (0.2, 0.1)
    none = malus.batch._figures({**quality, "patches": patches[1:]})
    assert none["patch_prior_rmse_gsd"] is None and none["patch_fused_rmse_gsd"] is None
