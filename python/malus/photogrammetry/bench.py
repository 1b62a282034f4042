"""What all stages share: COLMAP, the folder, the options, and the receivers of progress and warnings."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from malus import _core
from malus.options import Options
from malus.photogrammetry import database
from malus.photogrammetry.journal import Journal
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.program import Colmap

#: Points with up to this many times the mean reprojection error are kept, even above the limit of the options.
_ERRORS_KEPT = 2.5
#: Start and end of each stage, about, as shares of the whole.
SHARES = {
    "copies": (0.00, 0.04),
    "features": (0.04, 0.20),
    "matches": (0.20, 0.60),
    "mapping": (0.60, 0.80),
    "adjustment": (0.80, 0.84),
    "station": (0.84, 0.95),
    "windows": (0.95, 0.98),
    "scale": (0.98, 1.00),
}


@dataclass(frozen=True)
class Bench:
    """Shared by the stages of one station's photogrammetry. All their files are below `folder`."""

    colmap: Colmap
    folder: Path
    journal: Journal
    options: Options
    progress: Callable[[float, str], None]
    """Receives the finished share of the whole work, and the name of the current step."""
    log: Callable[[str, str], None]
    """Receives a level (info, warning) and a message."""
    inside_masks: bool = False
    """Whether features count only inside masks, because what surrounds the object does not move with it."""

    @property
    def images(self) -> Path:
        """Folder of the images that COLMAP reads."""
        return self.folder / "images"

    def report(self, stage: str, fraction: float, message: str) -> None:
        """Report that `fraction` of a stage is done."""
        start, end = SHARES[stage]
        self.progress(start + (end - start) * min(max(fraction, 0.0), 1.0), message)

    def counter(
        self, stage: str, pattern: str, message: str, part: tuple[float, float] = (0.0, 1.0)
    ) -> Callable[[str], None]:
        """A line reader that reports progress from lines with a count and a total, the groups of `pattern`.

        part: of the stage, in which they count.
        """
        expression = re.compile(pattern)

        def read(line: str) -> None:
            match = expression.search(line)
            if match:
                done, total = int(match[1]), int(match[2])
                self.report(stage, part[0] + (part[1] - part[0]) * done / total, f"{message} {done}/{total}")

        return read

    def log_file(self, name: str) -> Path:
        """Where the output of a stage is kept."""
        return self.folder / f"{name}.log"

    def adjust(self, stage: str, source: Path, target: Path, *, lens: bool, principal_point: bool = False) -> None:
        """Drop points with large residuals, which are mostly wrong matches, and adjust the model to the other points. lens,
        principal_point: whether these are adjusted, too.
        """
        filtered = target.with_name(f"{target.name}_filtered")
        for folder in (filtered, target):
            folder.mkdir(parents=True, exist_ok=True)
        log = self.log_file(stage)
        limit_px = max(self.options.photos.max_error_px, _ERRORS_KEPT * SparseModel.read(source).mean_error_px)
        self.colmap.run(
            "point_filtering",
            {
                "input_path": source,
                "output_path": filtered,
                "min_track_len": 2,
                "max_reproj_error": limit_px,
                "min_tri_angle": 1.5,
            },
            log,
        )
        self.colmap.run(
            "bundle_adjuster",
            {
                "input_path": filtered,
                "output_path": target,
                "BundleAdjustment.refine_focal_length": lens,
                "BundleAdjustment.refine_extra_params": lens,
                "BundleAdjustment.refine_principal_point": principal_point,
            },
            log,
        )
        shutil.rmtree(filtered)

    def match(self, stage: str, target: Path, pairs: list[tuple[str, str]], *, guided: bool) -> None:
        """Match pairs of images in a database and have COLMAP verify them.

        Malus compares the descriptors itself, by COLMAP's criteria: without a GPU, COLMAP's own search takes most of a run.
        """
        photos = self.options.photos
        descriptors = database.read_descriptors(target)
        names = sorted(descriptors)
        index = {name: number for number, name in enumerate(names)}
        found = _core.match_pairs(
            [descriptors[name] for name in names],
            [(index[first], index[second]) for first, second in pairs],
            self.colmap.threads,
            lambda _, fraction, message: self.report(stage, 0.5 * fraction, f"matches of {message}"),
        )
        database.write_matches(target, pairs, found)
        pairs_file = self.folder / f"{stage}_pairs.txt"
        lines = (f"{database.quoted(first)} {database.quoted(second)}\n" for first, second in pairs)
        pairs_file.write_text("".join(lines), encoding="utf-8")
        self.report(stage, 0.5, "verifying matches")
        self.colmap.run(
            "matches_importer",
            {
                "database_path": target,
                "match_list_path": pairs_file,
                "SiftMatching.use_gpu": 0,
                "SiftMatching.num_threads": self.colmap.threads,
                "SiftMatching.guided_matching": int(guided),
                "SiftMatching.min_num_inliers": photos.min_inliers,
            },
            self.log_file(stage),
            on_line=self.counter(stage, r"Matching block \[(\d+)/(\d+)\]", "verified block"),
        )
