"""The command line: `malus run STATION.toml -o WORK` and its parts."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import json
import os
import re
import shutil
import signal
import sys
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Protocol, TextIO, TypeAlias

import malus
from malus import _core, batch, m3c2, registration, scans, studio
from malus._files import require_utf8, resolved
from malus.campaign import Campaign, kinds_of, require_kind
from malus.change import change_summary
from malus.chart import measure_chart
from malus.demo import EXAMPLES, example_station
from malus.errors import InputError, ending_of
from malus.exports import COLORED, FORMATS, MESHES
from malus.object import Object, run_object
from malus.object.doubts import doubted_stations
from malus.object.figures import object_summary
from malus.options import MAIN
from malus.progress import BarProgress, JsonProgress, ProgressView, WarningsOnly, nobody_reads
from malus.reconstruction import PLATES_SECONDS, expected_times
from malus.report_head import size_of_object
from malus.shell import SHELLS, completion, manual
from malus.threads import ALL_CORES

INTERRUPTED = 130

#: Assumed seconds per station of a campaign before any is done, and per station of an object for the object's surface.
_A_STATION_S = 60.0
#: For each single-step command: the last step that it runs, its fusion (None = as the options say) and its help text. The steps that
#: the command needs run first, unless they are done already.
STEP_COMMANDS = {
    "decompose": (
        "zenith",
        None,
        "how bright, how strongly and in which direction the light is polarized (intensity, degree, phase, zenith)",
    ),
    "prior": ("prior", None, "the coarse surface as the polarized images see it"),
    "height": ("height", None, "height from polarization alone"),
    "fuse": (
        "fuse",
        None,
        "the fused surface, by --fusion: refined (default) or grid (the method of the paper: faster, coarser)",
    ),
    "refine": ("fuse", "refined", "the fused surface by nonlinear refinement, the same as fuse --fusion refined"),
    "mesh": ("mesh", None, "the mesh, in true size"),
    "assess": ("assess", None, "patches, profiles, comparison with a reference"),
}


class _Parser(argparse.ArgumentParser):
    """A parser that raises InputError, which ends the program with its exit code."""

    def error(self, message: str) -> None:  # type: ignore[override]
        self.print_usage(sys.stderr)
        if message.endswith(": COMMAND"):
            message += " (malus --help lists the commands)"
        raise InputError(_with_the_nearest(message))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Report an unknown option first, before argparse complains of arguments that are missing because of it."""
        if self._subparsers is None:
            args = _with_lists_of_numbers(args)
            for word in args:
                name = word.partition("=")[0]
                if word == "--":
                    break
                if name.startswith("--") and not any(known.startswith(name) for known in self._option_string_actions):
                    near = difflib.get_close_matches(name, self._option_string_actions, n=1)
                    self.error(f"{name} is unknown" + (f"; did you mean {near[0]}?" if near else ""))
        return super().parse_known_args(args, namespace)


def _with_lists_of_numbers(words: Sequence[str]) -> list[str]:
    """The words with lists such as -45,0,45 joined to their options: argparse takes such a list for an option of its own."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1].startswith("--") and re.fullmatch(r"-[\d.]+(,[^,]*)+", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _with_the_nearest(message: str) -> str:
    """A message of argparse; for an invalid choice it suggests a similar valid one, if there is one."""
    wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)$", message)
    near = difflib.get_close_matches(wrong[1], re.findall(r"[\w-]+", wrong[2]), n=1) if wrong else []
    return f"{message[: wrong.start()]}{wrong[1]!r} is unknown; did you mean {near[0]}?" if wrong and near else message


def _leaves(until: str, fusion: str | None, *more: str) -> str:
    """The end of a command's help: the files of its steps, and `more`."""
    options = malus.Options()
    if fusion is not None:
        options.fusion = fusion
    lines = ["leaves in WORK:"]
    for step, _, files, further in _core.describe_run(options.to_json(), until):
        lines += [f"  {file}  ({step})" for file in files]
        lines += [f"  {file}  ({step}, if there is one)" for file in further]
    return "\n".join([*lines, *(f"  {file}" for file in more)])


_Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"


class _Add(Protocol):
    """Adds a command that takes the common options, and by default a station file and a workspace folder, and runs steps."""

    def __call__(
        self, name: str, text: str, *, station: bool = True, work: bool = True, computes: bool = True
    ) -> argparse.ArgumentParser: ...


def _work_of(command: argparse.ArgumentParser, **how: Any) -> None:
    command.add_argument("-o", "--output", type=Path, metavar="WORK", **how)
    command.add_argument(
        "--replace",
        action="store_true",
        help="take the workspace over if it belongs to another station; its results are removed",
    )


def _common_options(*, computes: bool) -> _Parser:
    """Options of every command. computes: whether it runs steps, whose options other commands take, but do not show."""

    def told(text: str) -> str:
        return text if computes else argparse.SUPPRESS

    common = _Parser(add_help=False)
    # What only some commands have.
    common.set_defaults(reference=None, register=False, m3c2=False, pixels=None)
    common.add_argument("--threads", type=int, metavar="N", help="number of threads; default: all cores")
    common.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help=told("set an option of any step (malus options lists them); can be repeated"),
    )
    common.add_argument("--options", type=Path, metavar="FILE.toml", help=told("file with options, one table per step"))
    common.add_argument(
        "--fusion",
        choices=["grid", "refined"],
        help=told(
            "grid = the method of the paper: faster, coarser (default of malus paper), refined = nonlinear refinement (default of all others)"
        ),
    )
    common.add_argument("--preset", metavar="NAME", help=told("start from a named set of options: paper"))
    common.add_argument(
        "--json", action="store_true", help="write progress to standard output, one JSON object per event"
    )
    common.add_argument(
        "--quiet", action="store_true", help="print only errors, warnings, and a confidence that is not high"
    )
    return common


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="malus", description=malus.__doc__.splitlines()[0] if malus.__doc__ else None)
    parser.add_argument("--version", action="version", version=f"malus {malus.__version__}")
    common = {computes: _common_options(computes=computes) for computes in (True, False)}
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(
        name: str, text: str, *, station: bool = True, work: bool = True, computes: bool = True
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text, parents=[common[computes]])
        if station:
            command.add_argument("station", type=Path, metavar="STATION.toml")
        if work:
            _work_of(command, required=True, help="workspace folder")
        return command

    _add_runs(add)
    _add_uses_of_a_workspace(add)
    _add_chart(commands)
    _add_compare(add)
    _add_import(commands)
    _add_many_stations(add)
    _add_help(commands)
    return parser


def _add_runs(add: _Add) -> None:
    run = add("run", "the whole job: station file in, workspace with mesh, figures and report out")
    demo = add("demo", "the whole job on an example that ships with malus", station=False, work=False)
    demo.add_argument(
        "example",
        nargs="?",
        default="relief",
        choices=EXAMPLES,
        help="name of the example; default: relief",
        metavar="|".join(EXAMPLES),
    )
    _work_of(demo, default=Path("malus-demo"), help="workspace folder, default: malus-demo")
    paper = add(
        "paper",
        "the method of the paper as printed, with its figures and tables in WORK/paper",
        station=False,
        work=False,
    )
    paper.add_argument("station", nargs="?", type=Path, metavar="STATION.toml")
    paper.add_argument(
        "--campaign",
        nargs="+",
        type=Path,
        metavar="WORK",
        help="merge these workspaces into one table, in the folder of -o",
    )
    paper.add_argument(
        "--pixels",
        nargs="+",
        metavar="X,Y",
        help="show intensity against polarizer angle (Fig. 1c) at these pixels, at most eight, instead of the station's",
    )
    _work_of(paper, required=True, help="workspace folder, or folder for the merged tables")
    check = add(
        "check",
        "read all inputs; report what would be done, the time and memory it needs, and what is wrong",
        work=False,
    )
    check.add_argument(
        "--overlay",
        type=Path,
        metavar="FILE.png",
        help="file for the picture of the coarse surface on the image; default: in the current folder, the name of the station file with "
        "-check.png (station-check.png)",
    )
    steps = {name: add(name, text) for name, (_, _, text) in STEP_COMMANDS.items()}
    of_a_run = _leaves("assess", None, "report/index.html  (report)")
    told = [(run, of_a_run), (demo, of_a_run)]
    told.append(
        (
            paper,
            _leaves("assess", "grid", "paper/captions.md, figures and tables  (paper)", "report/index.html  (report)"),
        )
    )
    told += [(steps[name], _leaves(until, fusion)) for name, (until, fusion, _) in STEP_COMMANDS.items()]
    for command, files in told:
        command.formatter_class = argparse.RawDescriptionHelpFormatter
        command.epilog = files
    for command in (run, paper, steps["assess"]):
        command.add_argument(
            "--reference",
            type=Path,
            metavar="SCAN.ply",
            help="compare with this cloud or mesh (PLY, text, LAS or E57)",
        )
        command.add_argument(
            "--register",
            action="store_true",
            help="find the reference's place on the surface, however far off it lies, then align",
        )
        command.add_argument("--m3c2", action="store_true", help="compare with the reference by M3C2 too (py4dgeo)")


def _add_uses_of_a_workspace(add: _Add) -> None:
    report = add("report", "rebuild the report of a workspace", station=False, work=False, computes=False)
    report.add_argument("work", type=Path, metavar="WORK", help="workspace folder; or, with -o, the station file")
    report.add_argument(
        "-o", "--output", type=Path, metavar="WORK", help="workspace folder of the station, as for the other steps"
    )
    view = add("view", "open the report of a workspace in the web browser", station=False, work=False, computes=False)
    view.add_argument("work", type=Path, metavar="WORK", help="workspace folder, or folder of an object's results")
    export = add(
        "export", "write the surface of a workspace for another program", station=False, work=False, computes=False
    )
    export.add_argument("work", type=Path, metavar="WORK", help="workspace folder")
    export.add_argument("--format", choices=list(FORMATS), required=True, help="what to write")
    export.add_argument("--faces", type=int, metavar="N", help=f"at most N triangles ({', '.join(MESHES)})")
    export.add_argument(
        "--interval", type=float, metavar="LENGTH", help="distance between contour lines; default: a round number"
    )
    export.add_argument("--y-up", action="store_true", help="glb: turn the model from z up to glTF's y up")
    export.add_argument(
        "--albedo", action="store_true", help=f"color without highlights and shading ({', '.join(COLORED)})"
    )
    export.add_argument(
        "--trim", type=float, metavar="GSD", help="meshes: leave out parts with a larger standard deviation of depth"
    )
    export.add_argument(
        "--fill", action="store_true", help="meshes: close holes; parts that were not measured are magenta"
    )
    export.add_argument("--url", help="iiif: where the folder will be on the web; default: http://localhost:8000")
    export.add_argument(
        "--chart",
        type=Path,
        metavar="FILE.json",
        help="file from `malus chart`: colors in sRGB with a stated color difference",
    )
    export.add_argument(
        "-o", "--output", type=Path, metavar="PATH", help="file or folder to write; default: in WORK/export/"
    )


def _add_chart(commands: _Commands) -> None:
    chart = commands.add_parser("chart", help="measure a ColorChecker, for the colors of exports")
    chart.add_argument(
        "source", type=Path, metavar="IMAGE|WORK", help="color image, or workspace, that shows the chart"
    )
    chart.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.json")
    chart.add_argument(
        "--corners",
        metavar="X,Y,…",
        help="pixels of the centers of dark skin, bluish green, black, white; default: the chart is searched for",
    )
    chart.add_argument(
        "--response",
        default="linear",
        metavar="linear|srgb|gamma:X",
        help="encoding of the image; srgb for a camera's JPEG; default: linear",
    )
    chart.add_argument(
        "--white-level", type=float, metavar="DN", help="as in the station file; default: full scale of the file"
    )
    chart.add_argument(
        "--black-level", type=float, default=0.0, metavar="DN", help="as in the station file; default: 0"
    )


def _add_compare(add: _Add) -> None:
    dates = add(
        "compare", "what changed between two workspaces of one object", station=False, work=False, computes=False
    )
    dates.add_argument("before", type=Path, metavar="BEFORE", help="workspace of the earlier date")
    dates.add_argument("after", type=Path, metavar="AFTER", help="workspace of the later date")
    dates.add_argument(
        "--same-frame",
        action="store_true",
        help="both workspaces are in one frame already: do not move the later surface",
    )
    dates.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("malus-change"),
        metavar="DIR",
        help="folder for page and maps, default: malus-change",
    )


def _add_import(commands: _Commands) -> None:
    start = commands.add_parser("import", help="write a station file for a folder of polarized images")
    start.add_argument("folder", type=Path, metavar="FOLDER", help="folder with the polarized images")
    start.add_argument("-o", "--output", type=Path, required=True, metavar="STATION.toml")
    start.add_argument(
        "--table", type=Path, metavar="FILE.csv", help="images and angles; default: the folder's CSV file"
    )
    start.add_argument(
        "--pattern", metavar="REGEX", help="regular expression whose one group captures the angle in each file's name"
    )
    start.add_argument(
        "--angles",
        metavar="A,B,…",
        help="polarizer angles in degrees, one for each image in natural order of the names",
    )
    start.add_argument(
        "--mosaic",
        metavar="A,B,C,D",
        help="one image of a polarization camera: angles of its 2 x 2 cell in degrees, row by row",
    )
    start.add_argument("--colors", metavar="RGGB", help="Bayer pattern of a color polarization camera")
    start.add_argument(
        "--metashape",
        type=Path,
        metavar="cameras.xml",
        help="cameras of a Metashape project, for [camera]; with --label",
    )
    start.add_argument("--label", help="name of the polarized view's camera in that project")
    start.add_argument("--cloud", type=Path, metavar="FILE", help="cloud in the same frame, for [prior]")
    start.add_argument("--unit", help="unit of camera and cloud; default: m if cameras.xml says so, else mm")


def _add_many_stations(add: _Add) -> None:
    many = add("batch", "run many stations; one merged table and page over all of them", station=False, work=False)
    many.add_argument("campaign", type=Path, metavar="CAMPAIGN.toml")
    whole = add("object", "run the stations of one object; one surface of all of them", station=False, work=False)
    whole.add_argument("object", type=Path, metavar="OBJECT.toml")
    for command in (many, whole):
        command.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for all stations")
        command.add_argument(
            "--jobs",
            type=int,
            default=1,
            metavar="N",
            help="number of stations to run at a time on this machine; default: 1",
        )
        command.add_argument("--scheduler", metavar="ADDRESS", help="run on the workers of this Dask scheduler instead")
        command.add_argument(
            "--shard",
            metavar="I/N",
            help="run only every N-th station, starting with the I-th; default in a Slurm array job: the job's own share",
        )


def _add_help(commands: _Commands) -> None:
    local = commands.add_parser("studio", help="the whole workflow in the web browser, without writing files by hand")
    local.add_argument(
        "folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="folder to open; default: this folder"
    )
    local.add_argument("--port", type=int, default=0, help="port of the page; default: any free one")
    local.add_argument("--no-browser", action="store_true", help="print the address, do not open the browser")
    shell = commands.add_parser("completion", help="print a script that completes commands and options in a shell")
    shell.add_argument("shell", choices=SHELLS)
    commands.add_parser("manual", help="print the manual page (roff): malus manual | man -l -")
    options = commands.add_parser("options", help="list every option with its default and meaning")
    options.add_argument("--main", action="store_true", help="list only the dozen options that matter most")
    options.add_argument(
        "--preset",
        nargs="?",
        const="",
        metavar="NAME",
        help="list what this preset changes; without a name: list the presets",
    )
    options.set_defaults(json=False, quiet=False)


def _numbers(option: str, text: str | None, expected: str) -> list[float] | None:
    try:
        return None if text is None else [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{option} {text}, expected {expected}") from None


def _view(args: argparse.Namespace) -> ProgressView:
    if args.json:
        return JsonProgress()
    return WarningsOnly() if args.quiet else BarProgress()


def _options(args: argparse.Namespace, start: malus.Options | None = None) -> malus.Options:
    if start is not None and args.preset:
        raise InputError("--preset: a campaign's options stand in its file, [options]")
    options = start or (malus.Options.preset(args.preset) if args.preset else malus.Options())
    if args.options:
        options.update_from_file(args.options)
    for assignment in args.set:
        options.set(assignment)
    if args.fusion:
        options.fusion = args.fusion
    return options


def _reconstruct(
    args: argparse.Namespace, station_path: Path, until: str | None = None, fusion: str | None = None
) -> None:
    options = _options(args)
    if fusion is not None and options.fusion != fusion:
        raise InputError(f"fusion = {options.fusion}, but `malus {args.command}` is {fusion}; use `malus fuse`")
    reference: Path | None = args.reference
    for flag in ("m3c2", "register"):
        if getattr(args, flag) and reference is None:
            raise InputError(f"--{flag} needs a reference, expected --reference SCAN.ply")
    if args.m3c2:
        m3c2.py4dgeo()  # now, not after hours of work
    if args.register and options.assess.alignment == "none":
        options.assess.alignment = "rigid"  # the registration is accurate to a few pixels only
    if reference is not None and not reference.is_file():
        raise InputError(f"--reference {reference}: no such file, expected a cloud or a mesh")
    _require_own_folder(args.output, station_path)
    require_kind(station_path, "station")
    station = malus.Station.load(station_path)
    if args.pixels:
        station = station.with_curves_of([_pixel(text) for text in args.pixels])
    if reference is not None and scans.is_scan(reference):
        reference = _as_ply(reference, station, args)
    with _view(args) as view:
        expected = expected_times(station, options, until=until, threads=args.threads)
        if args.command == "paper":
            expected.append(("paper", PLATES_SECONDS))
        view.expect(expected)

        def reconstruct(until: str | None) -> None:
            malus.reconstruct(
                station,
                options,
                workspace=args.output,
                replace=args.replace,
                until=until,
                reference=reference,
                keep_maps=False,
                threads=args.threads,
                progress=lambda p: view.progress(p.step, p.fraction, p.message),
                log=view.log,
            )

        if args.register and reference is not None:
            reconstruct("fuse")
            view.progress("register", 0.0, "")
            reference = registration.register_reference(args.output, reference)
            view.progress("register", 1.0, str(reference))
        reconstruct(until)
        if args.m3c2 and reference is not None:
            view.progress("m3c2", 0.0, "")
            m3c2.compare(args.output, reference)
            view.progress("m3c2", 1.0, "")
        if args.command == "paper":
            view.progress("paper", 0.0, "")
            view.progress("paper", 1.0, str(malus.write_paper(args.output)))
        if until is None:
            view.progress("report", 0.0, "")
            page = malus.write_report(args.output)
            view.progress("report", 1.0, str(page))
    confidence = _core.surface_confidence(str(args.output))
    if args.json:
        view.result(*(confidence or (None, (), False)))
        return
    if until not in (None, "assess") and not args.quiet:
        _print_files(args.output, until)
    if confidence is not None:
        _print_summary(args.output, *confidence, quiet=args.quiet)


def _as_ply(scan: Path, station: malus.Station, args: argparse.Namespace) -> Path:
    """A reference in LAS or E57, written into the workspace for the C++ library. One that cannot be read takes no workspace over."""
    cloud = scans.read_scan(scan, station.unit)
    _core.claim_workspace(str(args.output), station._core, args.replace)
    return scans.as_ply(*cloud, args.output / "reference")


def _pixel(text: str) -> tuple[int, int]:
    """Parse X,Y of --pixels."""
    match text.split(","):
        case [x, y] if x.strip().isdecimal() and y.strip().isdecimal():
            return int(x), int(y)
    raise InputError(f"--pixels {text}: expected X,Y, two whole numbers from the top left pixel 0,0 on")


def _require_own_folder(work: Path, station: Path) -> None:
    """InputError if the results would be written among the inputs: deleting the results would then delete the inputs, too."""
    try:
        is_input = work.resolve() == station.resolve().parent
    except (OSError, RuntimeError):  # a loop of links: opening the path reports it
        return
    if is_input:
        raise InputError(
            f"-o {work}: is the folder of the station's inputs, expected one of its own for the results, such as "
            f"-o {work / (station.stem + '_work')}"
        )


def _print_lines(*lines: str, hang: int = 2, to: TextIO | None = None) -> None:
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


def _print_files(work: Path, step: str) -> None:
    """Print the files in the folders to which the last step has written."""
    workspace = malus.Workspace(work)
    folders = {Path(name).parts[0] for name in workspace.manifest["steps"].get(step, {}).get("outputs", {})}
    files = [name for name in workspace.outputs if Path(name).parts[0] in folders]
    print(f"{work} has", *files, sep="\n  ")


def _print_summary(work: Path, level: str, reasons: Sequence[str], assessed: bool, *, quiet: bool) -> None:
    """Print the main figures, if the surface is assessed, and the confidence; with `quiet` only a confidence that is not high."""
    if quiet:
        if level != "high":
            print(*malus.report.confidence_lines(level, reasons, assessed), sep="\n", file=sys.stderr)
    elif assessed:
        workspace = malus.Workspace(work)
        _print_lines(*malus.report.summary_lines(workspace.quality, size_of_object(workspace)))
        if workspace.has("report/index.html"):
            print(f"  report: malus view {work}")
    else:
        _print_lines(*malus.report.confidence_lines(level, reasons, assessed))


def _check(args: argparse.Namespace) -> None:
    if "object" in kinds_of(args.station):
        if args.overlay is not None:
            raise InputError(
                f"--overlay {args.overlay}: is a picture of one station, expected its file instead of an object's"
            )
        thing = Object.load(args.station)
        plans = thing.check(_options(args, thing.campaign.options), threads=args.threads)
        surface, surface_seconds = thing.planned_surface(plans)
        seconds = sum(plan["seconds"] for plan in plans)
        if args.json:
            said = {"does": surface, "seconds": surface_seconds}
            print(
                json.dumps(
                    {"name": thing.name, "stations": plans, "surface": said, "seconds": seconds + surface_seconds}
                )
            )
            return
        print(f"object {thing.name}: {len(plans)} stations, {seconds:.0f} s one after another")
        _print_lines(f"  {surface}")
        print(f"expected: about {surface_seconds:.0f} s")
        for plan in plans:
            _print_plan(plan)
        return
    require_kind(args.station, "station")
    station = malus.Station.load(args.station)
    overlay = args.overlay
    if overlay is None and os.access(".", os.W_OK):
        overlay = Path(f"{args.station.stem}-check.png")
    plan = malus.check(station, _options(args), overlay=overlay, threads=args.threads)
    plan["overlay"] = overlay and str(overlay)
    if args.json:
        print(json.dumps(plan))
    else:
        _print_plan(plan)


def _print_plan(plan: dict[str, Any]) -> None:
    # Of an object: the name in folders and tables, as the stations' own names may be alike.
    name = f"{plan['station']} ({plan['name']})" if "station" in plan else plan["name"]
    print(f"station {name}: {plan['width']} x {plan['height']} px, {plan['object_pixels']:.0f} on the object")
    _print_lines(*(f"  {line}" for line in plan["does"]))
    print(f"expected: about {plan['seconds']:.0f} s and {plan['memory_mb']:.0f} MB of memory")
    _print_lines(*([f"warning: {warning}" for warning in plan["warnings"]] or ["no warnings"]))
    if "overlay" in plan:
        picture = plan["overlay"] or "none, this folder cannot be written to (--overlay)"
        shown = (
            "the coarse surface on the image"
            if any(line.startswith("prior:") for line in plan["does"])
            else "image and mask"
        )
        print(f"picture of {shown}: {picture}")


def _work_to_report(args: argparse.Namespace) -> Path:
    """The workspace of `malus report WORK`, or of `malus report STATION.toml -o WORK`; InputError if it is another station's."""
    if args.output is None:
        return Path(args.work)
    require_kind(args.work, "station")
    malus.Station.load(args.work)
    belongs = malus.Workspace(args.output).manifest["station"]
    files = [Path(belongs["file"]), args.output / belongs["file_from_here"]] if belongs["file"] else []
    if resolved(args.work) not in map(resolved, files):
        raise InputError(
            f"-o {args.output}: belongs to station {belongs['name']!r} of {belongs['file'] or 'arrays'}, expected the workspace of "
            f"{args.work}"
        )
    return Path(args.output)


def _tell_written(args: argparse.Namespace, step: str, *paths: Path) -> None:
    """Name what was written: a line each, or with --json an event each; nothing with --quiet."""
    if args.json:
        view = JsonProgress()
        view.expect([(step, 1.0)])
        for path in paths:
            view.progress(step, 1.0, str(path))
    elif not args.quiet:
        print(*paths, sep="\n")


def _object(args: argparse.Namespace) -> None:
    thing = Object.load(args.object)
    _options(args, thing.campaign.options)
    shard = batch.parse_shard(args.shard) if args.shard else batch.shard_of_environment()
    with _view(args) as view:
        stations = _A_STATION_S * len(thing.campaign.stations)
        steps = [*(["photos"] if thing.shared else []), "stations", "object"]
        view.expect([(step, stations) for step in steps], guessed=True)
        view.progress(steps[0], 0.0, "")
        outcomes = run_object(
            thing,
            args.output,
            jobs=args.jobs,
            threads=args.threads,
            scheduler=args.scheduler,
            shard=shard,
            progress=view.progress,
        )
        pending = sum(outcome["status"] == "pending" for outcome in outcomes)
        folder = args.output / "object"
        quality = {} if pending else _figures_of_object(folder)
        if args.json and quality:  # otherwise they are printed below
            for warning in _doubts_of_object(quality):
                view.log("warning", warning)
    failed = batch.failure(outcomes)
    if not args.json and pending:
        print(f"{pending} of {len(outcomes)} stations are not run yet; the surface is made when all are")
    elif not args.json:
        _print_object(folder, quality, args.quiet)
    if failed is not None:
        raise failed


def _print_object(folder: Path, quality: Mapping[str, Any], quiet: bool) -> None:
    if quiet:  # warnings are printed even so
        for line in _doubts_of_object(quality, "warning: "):
            print(line, file=sys.stderr)
        return
    _print_lines(*object_summary(quality), f"  report: malus view {folder}")


def _figures_of_object(folder: Path) -> dict[str, Any]:
    quality: dict[str, Any] = json.loads((folder / "quality.json").read_text(encoding="utf-8"))
    return quality


def _doubts_of_object(quality: Mapping[str, Any], before: str = "") -> list[str]:
    """Stations that are not fully trusted, and all warnings, each with the word `before` it."""
    return [*doubted_stations(quality), *(before + warning for warning in quality["warnings"])]


def _compare(args: argparse.Namespace) -> None:
    with _view(args) as view:
        view.expect([("compare", 20.0)])
        change = malus.compare(
            args.before,
            args.after,
            args.output,
            same_frame=args.same_frame,
            threads=args.threads,
            progress=lambda fraction, message: view.progress("compare", fraction, message),
        )
        if args.json or args.quiet:  # otherwise the summary prints the warnings
            for warning in change.figures["warnings"]:
                view.log("warning", warning)
    if not (args.json or args.quiet):
        _print_lines(*change_summary(change.figures), f"  page: {change.folder / 'index.html'}")


def _batch(args: argparse.Namespace) -> None:
    campaign = Campaign.load(args.campaign)
    _options(args, campaign.options)
    shard = batch.parse_shard(args.shard) if args.shard else batch.shard_of_environment()
    with _view(args) as view:
        view.expect([("batch", _A_STATION_S * len(campaign.stations))], guessed=True)
        view.progress("batch", 0.0, f"{len(campaign.stations)} stations")
        outcomes = batch.run_campaign(
            campaign,
            args.output,
            jobs=args.jobs,
            threads=args.threads,
            scheduler=args.scheduler,
            shard=shard,
            progress=lambda done, total, outcome: view.progress(
                "batch", done / total, f"{outcome['station']}: {outcome['status']}"
            ),
        )
        done = [outcome for outcome in outcomes if outcome["status"] == "done"]
        view.progress("batch", 1.0, f"{len(done)} of {len(outcomes)} done")
    if not args.quiet and not args.json:
        levels = Counter(outcome["figures"].get("confidence") for outcome in done)
        told = ", ".join(f"{levels[level]} {level}" for level in ("high", "partial", "low") if levels[level])
        _print_lines(
            f"{campaign.name}: {len(done)} of {len(outcomes)} stations done{f'; confidence: {told}' if told else ''}",
            f"  page: {args.output / 'index.html'}",
        )
    failed = batch.failure(outcomes)
    if failed is not None:
        raise failed


def _list_options(preset: str | None, *, main_only: bool) -> None:
    if preset == "":
        for name, meaning in malus.Options.presets().items():
            print(f"{name}\n    {meaning}")
        return
    values = (malus.Options() if preset is None else malus.Options.preset(preset)).to_dict()
    defaults = malus.Options().to_dict()
    if preset is not None and values["fusion"] != defaults["fusion"]:
        print(f"fusion = {json.dumps(values['fusion'])}")
    for name, kind, default, meaning in malus.Options.describe():
        section, key = name.split(".")
        value = values[section][key]
        if (preset is None or value != defaults[section][key]) and (name in MAIN or not main_only):
            title = f"{MAIN[name]}: " if main_only else ""
            _print_lines(f"{name} = {json.dumps(default if preset is None else value)}  ({kind})")
            _print_lines(f"    {title}{meaning}", hang=0)


def _paper(args: argparse.Namespace) -> None:
    if (args.station is None) == (args.campaign is None):
        raise InputError("paper: expected either STATION.toml or --campaign WORK…")
    if args.campaign is not None:
        of_a_run = ("pixels", "reference", "register", "m3c2", "set", "options", "fusion", "preset", "replace")
        given = [f"--{name}" for name in of_a_run if getattr(args, name)]
        if given:
            raise InputError(
                f"{', '.join(given)}: --campaign merges finished workspaces and takes no options of a run, expected them with STATION.toml"
            )
        _tell_written(args, "paper", *malus.merge_campaign(args.campaign, args.output))
        return
    args.preset = args.preset or "paper"
    _reconstruct(args, args.station)


def _exported(args: argparse.Namespace) -> Path:
    return malus.export(
        args.work,
        args.format,
        args.output,
        faces=args.faces,
        interval=args.interval,
        y_up=args.y_up,
        albedo=args.albedo,
        chart=args.chart,
        url=args.url,
        trim=args.trim,
        fill=args.fill,
        threads=args.threads,
    )


def _run(arguments: Sequence[str] | None) -> None:
    for text in sys.argv[1:] if arguments is None else arguments:
        require_utf8(text)
    args = _parser().parse_args(arguments)
    if args.command == "completion":
        print(completion(_parser(), args.shell))
        return
    if args.command == "manual":
        print(manual(_parser()))
        return
    if args.command == "options":
        _list_options(args.preset, main_only=args.main)
        return
    if args.command == "import":
        print(
            malus.import_station(
                args.folder,
                args.output,
                table=args.table,
                pattern=args.pattern,
                angles=_numbers("--angles", args.angles, "angles in degrees: 0,45,90,135"),
                mosaic=_numbers("--mosaic", args.mosaic, "four angles in degrees: 90,45,135,0"),
                colors=args.colors,
                metashape=args.metashape,
                label=args.label,
                cloud=args.cloud,
                unit=args.unit,
            )
        )
        return
    if args.command == "chart":
        corners = _numbers("--corners", args.corners, "eight numbers: x,y of four patches")
        correction = measure_chart(
            args.source,
            corners=corners,
            response=args.response,
            white_level=args.white_level,
            black_level=args.black_level,
        )
        print(correction.save(args.output), correction.summary(), sep="\n")
        return
    if args.command == "studio":
        studio.serve(args.folder, port=args.port, browser=not args.no_browser)
        return
    if args.threads is None and args.command not in ("batch", "object"):  # these divide the cores among their jobs
        args.threads = ALL_CORES
    if args.threads is not None and args.threads < 1:
        raise InputError(f"--threads {args.threads}, expected at least 1")
    if args.command in ("report", "view", "export", "compare"):
        _options(args)  # of steps that are done: they change nothing here, but a mistake in them is told
    if args.command == "check":
        _check(args)
    elif args.command == "report":
        _tell_written(args, "report", malus.write_report(_work_to_report(args)))
    elif args.command == "view":
        _tell_written(args, "view", malus.open_report(args.work))
    elif args.command == "export":
        _tell_written(args, "export", _exported(args))
    elif args.command == "compare":
        _compare(args)
    elif args.command == "batch":
        _batch(args)
    elif args.command == "object":
        _object(args)
    elif args.command == "demo":
        _reconstruct(args, example_station(args.example))
    elif args.command == "paper":
        _paper(args)
    else:
        _reconstruct(args, args.station, *STEP_COMMANDS.get(args.command, (None, None))[:2])


def _start_with_utf8() -> None:
    """Restart the program in UTF-8 mode if the locale has another encoding: the C++ library takes file names in UTF-8."""
    if sys.getfilesystemencoding() != "utf-8":
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def _end_at_signals() -> None:
    """Treat the signals of a batch system or a closing shell like Ctrl-C, so that programs that the run started end, too."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # If SIGHUP is ignored (nohup), the user wants the run to continue without its shell.
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code (0, 2, 3, 4, 5 or 130; see malus.errors)."""
    if arguments is None:
        _start_with_utf8()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a character that a terminal cannot show must not end a run
            stream.reconfigure(errors="backslashreplace")
    _end_at_signals()
    try:
        _run(arguments)
    except KeyboardInterrupt:
        with contextlib.suppress(BrokenPipeError):
            print("malus: interrupted; finished steps are kept and will not be repeated", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, BrokenPipeError) and nobody_reads():
            # The reader of our last lines has ended (`malus options | head`): end silently.
            sys.stderr.close()
            return 0
        if "MALUS_TRACEBACK" in os.environ:
            raise
        code, message = ending_of(error)
        _print_lines(f"malus: {message}", *(f"  {note}" for note in getattr(error, "__notes__", ())), to=sys.stderr)
        return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
