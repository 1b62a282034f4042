"""Commands that run the steps of one station: run, demo, paper and the single steps."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import malus
from malus import _core, m3c2, registration, scans
from malus.campaign import require_kind
from malus.cli.output import print_lines, tell_written, view_of
from malus.cli.settings import options_of
from malus.errors import InputError
from malus.planning import PLATES_SECONDS, expected_times
from malus.report_head import size_of_object


def reconstruct_station(
    args: argparse.Namespace, station_path: Path, until: str | None = None, fusion: str | None = None
) -> None:
    """Run a station until a step (None = all), with what the command adds: M3C2, registration, the paper's plates, the report."""
    options = options_of(args)
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
    with view_of(args) as view:
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
        if until in (None, "assess"):
            registration.forget_registration(args.output, reference)
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
    """A reference in LAS or E57, written into the workspace for the C++ library. If it cannot be read, the workspace is left as it is."""
    cloud = scans.read_scan(scan, station.unit)
    _core.claim_workspace(str(args.output), station._core, args.replace)
    return scans.as_ply(cloud, args.output / "reference")


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
        print_lines(*malus.report.summary_lines(workspace.quality, size_of_object(workspace)))
        if workspace.has("report/index.html"):
            print(f"  report: malus view {work}")
    else:
        print_lines(*malus.report.confidence_lines(level, reasons, assessed))


def make_paper(args: argparse.Namespace) -> None:
    """`malus paper`: the method of the paper on a station, or the merged tables of many workspaces."""
    if (args.station is None) == (args.campaign is None):
        raise InputError("paper: expected either STATION.toml or --campaign WORK…")
    if args.campaign is not None:
        of_a_run = ("pixels", "reference", "register", "m3c2", "set", "options", "fusion", "preset", "replace")
        given = [f"--{name}" for name in of_a_run if getattr(args, name)]
        if given:
            raise InputError(
                f"{', '.join(given)}: --campaign merges finished workspaces and takes no options of a run, expected them with STATION.toml"
            )
        tell_written(args, "paper", *malus.merge_campaign(args.campaign, args.output))
        return
    args.preset = args.preset or "paper"
    reconstruct_station(args, args.station)
