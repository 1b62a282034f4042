"""Console output: overall progress and time left, closing lines, errors, the main options."""

from __future__ import annotations

import errno
import html
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import malus
from conftest import malus_here, run_program
from malus import cli, progress
from malus.cli.output import print_lines
from malus.options import MAIN
from malus.progress import BarProgress, JsonProgress, Overall, ProgressView, WarningsOnly, duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_overall_progress_weights_steps_by_their_expected_time(clock: list[float]) -> None:
    overall = Overall([("a", 10), ("b", 30)])
    overall.update("a", 0.5)
    overall.update("unknown", 1.0)
    assert overall.fraction == pytest.approx(5 / 40)
    overall.update("a", 1.0)
    overall.update("b", 0.5)
    assert overall.fraction == pytest.approx(25 / 40)


def test_time_left_follows_the_measured_speed(clock: list[float]) -> None:
    overall = Overall([("kept", 1000), ("a", 1000), ("b", 1000)])
    overall.update("kept", 1.0)
    assert overall.seconds_left == pytest.approx(2000)
    overall.update("a", 0.0)
    clock[0] = 3000
    overall.update("a", 1.0)
    assert overall.seconds_left == pytest.approx(1000 * 3005 / 1005)


def test_json_events_have_the_overall_progress(capsys: pytest.CaptureFixture[str], clock: list[float]) -> None:
    view = JsonProgress()
    view.expect([("a", 1), ("b", 3)])
    view.progress("a", 0.0, "")
    view.progress("a", 1.0, "")
    event = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (event["step"], event["overall"]) == ("a", 0.25)
    assert event["seconds_left"] > 0


def test_no_time_left_is_given_before_it_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    view = JsonProgress()
    view.expect([("batch", 60.0)], guessed=True)
    for fraction in (0.0, 0.5):
        view.progress("batch", fraction, "")
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["overall"], first["seconds_left"]) == (0.0, None)
    assert second["overall"] == 0.5 and second["seconds_left"] < 10


def test_lines_fit_on_a_terminal_and_stay_whole_in_a_file(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    said = "  reasons: " + "the reflection-model explains some " * 5
    print_lines(said)
    assert capsys.readouterr().out == said + "\n"
    monkeypatch.setattr(cli.sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "60")
    print_lines(said)
    first, *others = capsys.readouterr().out.splitlines()
    assert max(map(len, (first, *others))) <= 60 and all(line.startswith("    ") for line in others)
    assert " ".join((first + " " + " ".join(others)).split()) == " ".join(said.split())
    print_lines("1 of 2 stations failed\n  o1: no such file")  # a text of several lines keeps its line breaks
    assert capsys.readouterr().out == "1 of 2 stations failed\n  o1: no such file\n"


@pytest.mark.parametrize("kind", [BarProgress, WarningsOnly, JsonProgress])
def test_a_warning_is_told_once(capsys: pytest.CaptureFixture[str], kind: type[ProgressView]) -> None:
    """A run with photos is two runs: the second repeats the warnings of the steps that the first has done."""
    view = kind()
    for message in ("doubtful", "strange", "doubtful"):
        view.log("warning", message)
    view.result("high", [], True)
    told = capsys.readouterr()
    if kind is not JsonProgress:
        assert told.err == "warning: doubtful\nwarning: strange\n"
        return
    *events, last = map(json.loads, told.out.splitlines())
    assert [event["message"] for event in events] == ["doubtful", "strange"] == last["warnings"]


def buffered() -> dict[str, str]:
    """The environment without the variable by which Python writes everything at once."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}


def unread(*command: str | Path, errors_too: bool = False) -> tuple[int, str | None]:
    """Exit code and errors of a program whose output, with `errors_too` also that of errors, is a pipe that nobody reads."""
    kept, closed = os.pipe()
    os.close(kept)
    errors = closed if errors_too else subprocess.PIPE
    run = subprocess.Popen(command, stdout=closed, stderr=errors, text=True, env=buffered())
    os.close(closed)
    _, err = run.communicate(timeout=300)
    return run.returncode, err


def test_a_run_whose_output_nobody_reads_any_more_is_not_done(small_station_source: Path, tmp_path: Path) -> None:
    """`malus run … --json | head` and `malus run … 2>&1 | head` ended with exit code 0 or 1, whatever the run had done."""
    command = [sys.executable, "-m", "malus.cli", "decompose", small_station_source / "station.toml", "-o"]
    said = "malus: interrupted; finished steps are kept and will not be repeated\n"
    assert unread(*command, tmp_path / "a", "--json") == (130, said)
    assert unread(*command, tmp_path / "b", errors_too=True) == (130, None)
    program = Path(os.environ.get("MALUS_STATION", Path(__file__).parents[2] / "build/malus-station"))
    if program.exists():
        station = small_station_source / "station.toml"
        assert unread(program, station, "-o", tmp_path / "c", "--json") == (130, "malus-station: interrupted\n")


def test_output_that_cannot_be_written_has_an_exit_code_of_malus() -> None:
    """Lines that fit into Python's buffer were written after the exit code was decided: Python complained, and ended with code 120."""
    command = [sys.executable, "-m", "malus.cli", "options", "--main"]
    assert unread(*command) == (0, "")
    with open("/dev/full", "w") as full:
        for arguments in (command, [*command[:-2], "--version"]):
            run = subprocess.run(arguments, stdout=full, stderr=subprocess.PIPE, text=True, env=buffered())
            assert (run.returncode, run.stderr) == (5, "malus: standard output: No space left on device\n")
    closed = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], stderr=subprocess.PIPE, env=buffered())
    assert (closed.returncode, closed.stderr) == (0, b"")


def test_another_pipe_that_breaks_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was taken for the output that nobody reads: commands ended with 130 as if interrupted, or with 0 as if done."""

    def broken(*_: object) -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe", "share/page.html")

    with pytest.raises(BrokenPipeError), JsonProgress():
        broken()
    monkeypatch.setattr(malus, "write_report", broken)
    outcome = malus_here("report", "work")
    assert (outcome.code, outcome.err) == (5, "malus: share/page.html: Broken pipe\n")


@pytest.mark.parametrize(("seconds", "said"), [(0.2, "5 s"), (42, "40 s"), (150, "2 min"), (9000, "2.5 h")])
def test_durations_are_rounded_for_reading(seconds: float, said: str) -> None:
    assert duration(seconds) == said


def test_closing_lines_say_size_accuracy_and_warnings(finished_grid: Path) -> None:
    quality = malus.Workspace(finished_grid).quality
    lines = malus.report.summary_lines({**quality, "warnings": ["fuse: doubtful"]}, (59.2, 47.3))
    assert "59.2 x 47.3 mm" in lines[0] and f"one pixel is {1000 * quality['gsd']:.0f} µm" in lines[0]
    assert "24.0 x 24.1 mm" in malus.report.summary_lines(quality, (24, 24.1))[0]
    assert lines[1].startswith("  accuracy: ") and lines[1].count("µm") == 2
    assert lines[-1] == "  warning: fuse: doubtful"
    assert not any("converged" in line for line in lines)


def test_closing_lines_of_a_surface_that_lies_nowhere_near_its_reference(finished_grid: Path) -> None:
    """The figures are missing: the summary ended with a TypeError, after the run was done."""
    none = dict.fromkeys(("mean", "rmse", "mad", "minimum", "p05", "median", "p95", "maximum"))
    far = {"status": "no pixel near the reference", "distance_gsd": {"count": 0, **none}}
    lines = malus.report.summary_lines({**malus.Workspace(finished_grid).quality, "reference": far}, (24, 24.1))
    assert "  distance to the reference: no pixel near the reference" in lines


def test_closing_lines_say_how_much_of_the_surface_was_compared(finished_grid: Path) -> None:
    """An RMSE of the few pixels near the reference looked like that of the whole surface; a patch beside it had an empty line."""
    near = {"status": "done", "compared_fraction": 0.031, "distance_gsd": {"count": 9, "rmse": 0.2, "mad": 0.1}}
    beside = {"name": "beside", "prior": None, "polarization": None, "fused": None}
    quality = {**malus.Workspace(finished_grid).quality, "reference": near, "patches": [beside]}
    lines = malus.report.summary_lines(quality, (24, 24.1))
    assert any("near which 3.1 % of the surface lies: RMSE " in line for line in lines)
    assert not any("beside" in line for line in lines)


def test_missing_convergence_is_explained_in_plain_words(tiny_station_source: Path, tmp_path: Path) -> None:
    outcome = malus_here(
        "run", tiny_station_source / "station.toml", "-o", tmp_path / "work", "--fusion", "grid",
        "--set", "height.iterations=1", "--set", "optimize.enabled=true",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    report = (tmp_path / "work/report/index.html").read_text().split('<section id="provenance"')[0]
    for said in (outcome.out, html.unescape(report)):
        assert "The surface's fine detail is less sure by about that" in said and "larger height.iterations" in said
        assert "The equations were not solved together, as optimize.enabled asks for" in said
        assert "iteration limit" not in said and "converged" not in said


def test_main_options_are_a_dozen_of_all() -> None:
    lines = malus_here("options", "--main").out.splitlines()
    listed = [line.split(" = ")[0] for line in lines if not line.startswith(" ")]
    assert sorted(listed) == sorted(MAIN) and len(listed) == 12
    meanings = {meaning for _, _, _, meaning in malus.Options.describe()}
    assert all(line.strip() in meanings for line in lines if line.startswith(" ")), "told twice, with Studio's titles"


def test_options_fit_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli.sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["options", "--main"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and sum(not line.startswith(" ") for line in lines) == len(MAIN)


def test_errors_fit_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir("/")  # the long path of the test's folder would not be broken over lines
    assert cli.main(["check", r"C:\Users\Anna\museum\station.toml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 80 and len(lines) > 1
    assert "drive C: of Windows is /mnt/c in WSL" in " ".join(line.strip() for line in lines)


def test_results_are_not_written_among_the_inputs(small_station: Path) -> None:
    outcome = malus_here("run", small_station, "-o", small_station.parent)
    assert outcome.code == 2 and "station_work" in outcome.err
    assert not (small_station.parent / "manifest.json").exists()


def test_single_steps_list_the_files_they_wrote(finished_grid: Path, small_station: Path, tmp_path: Path) -> None:
    outcome = malus_here("decompose", small_station, "-o", tmp_path / "work")
    assert outcome.code == 0, outcome.err
    assert "polarization/degree.tif" in outcome.out and "polarization/zenith.tif" in outcome.out


def test_commands_on_a_workspace_follow_json_and_quiet(finished_grid: Path, tmp_path: Path) -> None:
    """They printed a plain line among the events, and in spite of --quiet; options with mistakes were accepted."""
    written = tmp_path / "a.stl"
    command = ("export", finished_grid, "--format", "stl", "-o", written)
    assert malus_here(*command).out == f"{written}\n"
    assert malus_here(*command, "--quiet").out == ""
    [event] = [json.loads(line) for line in malus_here(*command, "--json").out.splitlines()]
    assert (event["event"], event["step"], event["fraction"]) == ("progress", "export", 1.0)
    assert event["message"] == str(written)
    wrong = malus_here(*command, "--set", "grid.nothing=8")
    assert wrong.code == 2 and "unknown option grid.nothing" in wrong.err


def test_check_prints_only_warnings_with_quiet(small_station_source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It printed the whole plan in spite of --quiet."""
    plan: dict[str, object] = {"name": "small", "does": [], "warnings": ["dark", "small"]}
    monkeypatch.setattr(malus, "check", lambda *_, **__: plan)
    command = ("check", small_station_source / "station.toml", "--quiet")
    outcome = malus_here(*command)
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "warning: dark\nwarning: small\n")
    plan["warnings"] = []
    outcome = malus_here(*command)
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


def test_report_takes_the_station_like_other_steps(
    finished_grid: Path, small_station_source: Path, small_station: Path, tmp_path: Path
) -> None:
    work = tmp_path / "work"
    shutil.copytree(finished_grid, work)
    (work / "report" / "index.html").unlink()
    outcome = malus_here("report", small_station_source / "station.toml", "-o", work, "--json")
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out.splitlines()[-1])["message"] == str(work / "report" / "index.html")
    assert (work / "report" / "index.html").is_file()
    refused = malus_here("report", small_station, "-o", work)
    assert refused.code == 2 and "belongs to station 'small'" in refused.err


def test_misspelled_words_get_a_suggestion() -> None:
    for words, said in (
        (["studo"], "'studo' is unknown; did you mean studio?"),
        (
            ["stone/station.toml"],
            "stone/station.toml is no command, expected one before it, such as malus check stone/station.toml",
        ),
        (["demo", "coins"], "'coins' is unknown; did you mean coin?"),
        (["nonsense"], "choose from"),
        (["export", "work", "--fromat", "stl"], "--fromat is unknown; did you mean --format?"),
        (["run", "station.toml", "--until=fuse", "-o", "work"], "usage: malus run"),
        (["run", "station.toml", "--until=fuse", "-o", "work"], "malus: --until is unknown\n"),
    ):
        outcome = malus_here(*words)
        assert outcome.code == 2 and said in outcome.err, outcome.err


def test_help_shows_only_options_that_do_something() -> None:
    """Options of steps do nothing in commands on a finished workspace, which take them all the same: a mistake in them is told."""
    for command in ("view", "export", "report", "compare", "fuse"):
        words = malus_here(command, "--help").out
        assert all(
            (option in words) == (command == "fuse") for option in ("--set", "--options", "--fusion", "--preset")
        )


def test_help_has_no_equation_or_figure_numbers() -> None:
    for command in ((), ("fuse",), ("height",), ("decompose",)):
        assert not re.search(r"\b(Eq|Fig)\b", malus_here(*command, "--help").out)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "the following arguments are required: COMMAND (malus --help lists the commands)"),
        ("view FOLDER/none", "none: there is no such folder, expected one that `malus run"),
        ("view FOLDER", "is no workspace, expected one that `malus run"),
        ("report FOLDER", "is no workspace, expected one that `malus run"),
        ("export FOLDER --format obj", "is no workspace, expected one that `malus run"),
        (
            "export FOLDER --format obj --chart FOLDER/none.json",
            "none.json: no such file, expected one that `malus chart`",
        ),
        ("studio FOLDER/station.toml", "is a file, expected its folder: FOLDER"),
        ("studio FOLDER --port 70000", "--port 70000, expected 0 to 65535"),
        ("import FOLDER -o FOLDER/station.txt", "expected a name for the station file that ends in .toml"),
        ("run FOLDER/object.toml -o FOLDER/w", "`malus object FOLDER/object.toml -o DIR` runs it"),
        ("check FOLDER/campaign.toml", "`malus batch FOLDER/campaign.toml -o DIR` runs it"),
        ("object FOLDER/station.toml -o FOLDER/w", "`malus run FOLDER/station.toml -o DIR` runs it"),
        ("batch FOLDER/object.toml -o FOLDER/w", "is an object file, expected a campaign file"),
        ("check FOLDER", "FOLDER: is a folder, expected a station file, such as FOLDER/station.toml"),
        ("object FOLDER -o FOLDER/w", "FOLDER: is a folder, expected an object file, such as FOLDER/object.toml"),
        ("batch FOLDER -o FOLDER/w", "expected a campaign file, such as FOLDER/campaign.toml"),
        ("run FOLDER/a.toml -o FOLDER/w --reference FOLDER/none.ply", "--reference FOLDER/none.ply: no such file"),
    ],
)
def test_missing_files_and_wrong_files_are_told_apart(tmp_path: Path, command: str, words: str) -> None:
    (tmp_path / "station.toml").write_text('[polarized]\nimages = "pol"\n[object]\ntitle = "Stone"\n')
    (tmp_path / "object.toml").write_text('[object]\nstations = ["station.toml"]\n')
    (tmp_path / "campaign.toml").write_text('[campaign]\nstations = ["station.toml"]\n')
    outcome = malus_here(*command.replace("FOLDER", str(tmp_path)).split())
    assert outcome.code == 2 and words.replace("FOLDER", str(tmp_path)) in outcome.err


def test_the_program_starts_without_importing_matplotlib() -> None:
    """Importing matplotlib takes as long as importing everything else."""
    outcome = run_program(sys.executable, "-c", "import sys, malus.cli; print('matplotlib' in sys.modules)")
    assert outcome.out.strip() == "False", outcome.err


@pytest.mark.parametrize("step", ["batch", "stations"])
def test_a_log_names_every_station_that_has_ended(capsys: pytest.CaptureFixture[str], step: str) -> None:
    with BarProgress() as view:
        view.expect([(step, 1.0)])
        view.progress(step, 0.0, "")
        for count, said in enumerate(("bust: done", "coin: failed", "vase: done"), start=1):
            view.progress(step, count / 3, said)
    assert [line.split(step)[1].strip() for line in capsys.readouterr().err.splitlines()] == [
        "bust: done", "coin: failed", "vase: done"
    ]  # fmt: skip


def test_words_in_brackets_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    """Names of station tables in brackets were once taken for colors and lost, and lines were broken after 80 characters."""
    view = BarProgress()
    warning = f"the height may be upside down: give [optics] light = [x, y, z]; {'and more of it, ' * 8}[/red] at last"
    with view:
        view.expect([("height", 1.0)])
        view.progress("height", 1.0, "[prior] was left out")
        view.log("warning", warning)
    assert capsys.readouterr().err == f"100 %  height        [prior] was left out\nwarning: {warning}\n"
