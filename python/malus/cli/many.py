"""Commands that run many stations: batch and object."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from malus import batch
from malus.campaign import Campaign
from malus.cli.output import print_lines, view_of
from malus.cli.settings import options_of
from malus.object import Object, run_object
from malus.object.doubts import doubted_stations
from malus.object.figures import object_summary
from malus.photogrammetry.diagnosis import listed

#: Assumed seconds per station of a campaign before any is done, and per station of an object for the object's surface.
_A_STATION_S = 60.0


def run_batch(args: argparse.Namespace) -> None:
    """Run the stations of a campaign; raises the error of the first station that failed."""
    campaign = Campaign.load(args.campaign)
    options_of(args, campaign.options)
    shard = batch.parse_shard(args.shard) if args.shard else batch.shard_of_environment()
    ran: list[str] = []
    with view_of(args) as view:

        def ended(count: int, total: int, outcome: batch.Outcome) -> None:
            ran.append(outcome["station"])
            view.progress("batch", count / total, f"{outcome['station']}: {outcome['status']}")

        view.expect([("batch", _A_STATION_S * len(campaign.stations))], guessed=True)
        view.progress("batch", 0.0, f"{len(campaign.stations)} stations")
        outcomes = batch.run_campaign(
            campaign,
            args.output,
            jobs=args.jobs,
            threads=args.threads,
            scheduler=args.scheduler,
            shard=shard,
            progress=ended,
        )
        done = [outcome for outcome in outcomes if outcome["status"] == "done"]
        view.progress("batch", 1.0, f"{len(done)} of {len(outcomes)} done")
    if not args.quiet and not args.json:
        levels = Counter(outcome["figures"].get("confidence") for outcome in done)
        told = ", ".join(f"{levels[level]} {level}" for level in ("high", "partial", "low") if levels[level])
        print_lines(
            f"{campaign.name}: {len(done)} of {len(outcomes)} stations done{f'; confidence: {told}' if told else ''}",
            *_words_on_runs(outcomes, ran),
            f"  page: {args.output / 'index.html'}",
        )
    failed = batch.failure(outcomes)
    if failed is not None:
        raise failed


def run_object_file(args: argparse.Namespace) -> None:
    """Run the stations of an object and make its surface; raises the error of the first station that failed."""
    thing = Object.load(args.object)
    options_of(args, thing.campaign.options)
    shard = batch.parse_shard(args.shard) if args.shard else batch.shard_of_environment()
    ran: list[str] = []
    with view_of(args) as view:
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
            ended=lambda outcome: ran.append(outcome["station"]),
        )
        pending = sum(outcome["status"] == "pending" for outcome in outcomes)
        folder = args.output / "object"
        quality = {} if pending else _figures_of_object(folder)
        if args.json and quality:  # otherwise they are printed below
            for warning in _doubts_of_object(quality):
                view.log("warning", warning)
    failed = batch.failure(outcomes)
    if pending:
        if not (args.json or args.quiet):
            print(f"{pending} of {len(outcomes)} stations are not run yet; the surface is made when all are")
    elif not args.json:
        _print_object(folder, quality, _words_on_runs(outcomes, ran), args.quiet)
    if failed is not None:
        raise failed


def _words_on_runs(outcomes: Sequence[batch.Outcome], ran: Sequence[str]) -> list[str]:
    """A line that names the stations run now, if other stations were run by an earlier run or by that of another shard."""
    others = sum(outcome["status"] != "pending" and outcome["station"] not in ran for outcome in outcomes)
    names = [outcome["station"] for outcome in outcomes if outcome["station"] in ran]
    return [f"  run now: {listed(names) or 'none'}; run before or elsewhere: {others}"] if others else []


def _print_object(folder: Path, quality: Mapping[str, Any], on_runs: Sequence[str], quiet: bool) -> None:
    if quiet:  # warnings are printed even so
        for line in _doubts_of_object(quality, "warning: "):
            print(line, file=sys.stderr)
        return
    print_lines(*object_summary(quality), *on_runs, f"  report: malus view {folder}")


def _figures_of_object(folder: Path) -> dict[str, Any]:
    quality: dict[str, Any] = json.loads((folder / "quality.json").read_text(encoding="utf-8"))
    return quality


def _doubts_of_object(quality: Mapping[str, Any], before: str = "") -> list[str]:
    """The stations that are not fully trusted, and all warnings; each line begins with the word `before`."""
    return [*doubted_stations(quality), *(before + warning for warning in quality["warnings"])]
