"""Every command of `malus`, with its arguments and options."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import malus
from malus import _core
from malus.cli.parser import Parser
from malus.demo import EXAMPLES
from malus.exports import COLORED, FORMATS, MESHES
from malus.shell import SHELLS

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


#: Below the list of commands.
_BEGIN = """\
begin with one of these:
  malus demo                   try it on an example
  malus studio FOLDER          everything in the web browser
  malus import FOLDER -o STATION.toml, then malus check, run, view and export

malus COMMAND --help says more of a command."""

_Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


class _Add(Protocol):
    """Adds a command that takes the common options, and by default a station file and a workspace folder, and runs steps."""

    def __call__(
        self,
        name: str,
        text: str,
        *,
        station: bool = True,
        work: bool = True,
        computes: bool = True,
        threads: str = ...,
    ) -> argparse.ArgumentParser: ...


def _work_of(command: argparse.ArgumentParser, **how: Any) -> None:
    command.add_argument("-o", "--output", type=Path, metavar="WORK", **how)
    command.add_argument(
        "--replace",
        action="store_true",
        help="take the workspace over if it belongs to another station; its results are removed",
    )


def _common_options(*, computes: bool, threads: str) -> Parser:
    """Options of every command. computes: whether it runs steps; else the help leaves out the options of steps. threads: help text."""

    def told(text: str) -> str:
        return text if computes else argparse.SUPPRESS

    common = Parser(add_help=False)
    # What only some commands have.
    common.set_defaults(reference=None, register=False, m3c2=False, pixels=None)
    common.add_argument("--threads", type=int, metavar="N", help=threads)
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


def command_line() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = Parser(
        prog="malus",
        description=malus.__doc__.splitlines()[0] if malus.__doc__ else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_BEGIN,
    )
    parser.add_argument("--version", action="version", version=f"malus {malus.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)

    def add(
        name: str,
        text: str,
        *,
        station: bool = True,
        work: bool = True,
        computes: bool = True,
        threads: str = "number of threads; default: all cores",
    ) -> argparse.ArgumentParser:
        common = _common_options(computes=computes, threads=threads)
        command = commands.add_parser(name, help=text, description=text, parents=[common])
        if station:
            command.add_argument("station", type=Path, metavar="STATION.toml", help="station file")
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
    paper.add_argument(
        "station", nargs="?", type=Path, metavar="STATION.toml", help="station file; left out with --campaign"
    )
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
        station=False,
        work=False,
    )
    check.add_argument(
        "station", type=Path, metavar="STATION.toml", help="file of a station, or of an object (OBJECT.toml)"
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
            help="find the reference's place on the surface, however far off it lies, then align the surface to it",
        )
        command.add_argument(
            "--m3c2", action="store_true", help="compare with the reference by M3C2, too (needs the extra m3c2)"
        )


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
    export.add_argument(
        "--format", choices=list(FORMATS), required=True, help="what to write (docs/deliverables.md describes each)"
    )
    export.add_argument("--faces", type=int, metavar="N", help=f"at most N triangles ({', '.join(MESHES)})")
    export.add_argument(
        "--interval", type=float, metavar="LENGTH", help="distance between contour lines; default: a round number"
    )
    export.add_argument("--y-up", action="store_true", help="glb: turn the model from z up to glTF's y up")
    export.add_argument(
        "--albedo", action="store_true", help=f"color without highlights and shading ({', '.join(COLORED)})"
    )
    export.add_argument(
        "--trim",
        type=float,
        metavar="GSD",
        help="meshes: leave out parts whose depth has a larger standard deviation than this many GSD (sizes of a pixel on the object)",
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


def _add_plain(commands: _Commands, name: str, text: str) -> Parser:
    """Add a command without the common options."""
    return commands.add_parser(name, help=text, description=text)


def _add_chart(commands: _Commands) -> None:
    chart = _add_plain(commands, "chart", "measure a ColorChecker, for the colors of exports")
    chart.add_argument(
        "source", type=Path, metavar="IMAGE|WORK", help="color image, or workspace, that shows the chart"
    )
    chart.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE.json", help="file to write, for malus export --chart"
    )
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
    start = _add_plain(commands, "import", "write a station file for a folder of polarized images")
    start.add_argument("folder", type=Path, metavar="FOLDER", help="folder with the polarized images")
    start.add_argument("-o", "--output", type=Path, required=True, metavar="STATION.toml", help="station file to write")
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
    threads = "number of threads of each station; default: all cores, divided among the stations that run at a time"
    many = add(
        "batch",
        "run many stations; one merged table and page over all of them",
        station=False,
        work=False,
        threads=threads,
    )
    many.add_argument("campaign", type=Path, metavar="CAMPAIGN.toml", help="file that names the stations")
    whole = add(
        "object",
        "run the stations of one object; one surface of all of them",
        station=False,
        work=False,
        threads=threads,
    )
    whole.add_argument("object", type=Path, metavar="OBJECT.toml", help="file that names the object's stations")
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
    local = _add_plain(commands, "studio", "the whole workflow in the web browser, without writing files by hand")
    local.add_argument(
        "folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="folder to open; default: this folder"
    )
    local.add_argument("--port", type=int, default=0, help="port of the page; default: any free one")
    local.add_argument("--no-browser", action="store_true", help="print the address, do not open the browser")
    shell = _add_plain(commands, "completion", "print a script that completes commands and options in a shell")
    shell.add_argument("shell", choices=SHELLS, help="the shell that is to read the script")
    _add_plain(commands, "manual", "print the manual page (roff): malus manual | man -l -")
    options = _add_plain(commands, "options", "list every option with its default and meaning")
    options.add_argument("--main", action="store_true", help="list only the dozen options that matter most")
    options.add_argument(
        "--preset",
        nargs="?",
        const="",
        metavar="NAME",
        help="list what this preset changes; without a name: list the presets",
    )
    options.set_defaults(json=False, quiet=False)
