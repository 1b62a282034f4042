"""What every stage works with: the program, the folder, the options, and where progress and warnings go."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from malus.options import Options
from malus.photogrammetry.journal import Journal
from malus.photogrammetry.program import Colmap

#: Part of the whole that each stage takes, about.
SHARES = {
    "copies": (0.00, 0.04),
    "features": (0.04, 0.20),
    "matches": (0.20, 0.60),
    "mapping": (0.60, 0.80),
    "adjustment": (0.80, 0.84),
    "station": (0.84, 0.98),
    "station_features": (0.84, 0.86),
    "scale": (0.98, 1.00),
}


@dataclass(frozen=True)
class Bench:
    """Shared by the stages of one station's photogrammetry, all of whose files are below `folder`."""

    colmap: Colmap
    folder: Path
    journal: Journal
    options: Options
    progress: Callable[[float, str], None]
    """Receives the share of the whole that is done, and what is being done."""
    log: Callable[[str, str], None]
    """Receives a level (info, warning) and a message."""

    @property
    def images(self) -> Path:
        """Folder of the images that COLMAP sees."""
        return self.folder / "images"

    def report(self, stage: str, fraction: float, message: str) -> None:
        """Report that `fraction` of a stage is done."""
        start, end = SHARES[stage]
        self.progress(start + (end - start) * min(max(fraction, 0.0), 1.0), message)

    def counter(self, stage: str, pattern: str, message: str) -> Callable[[str], None]:
        """A line reader that reports progress from lines with a count and a total, the groups of `pattern`."""
        expression = re.compile(pattern)

        def read(line: str) -> None:
            match = expression.search(line)
            if match:
                done, total = int(match[1]), int(match[2])
                self.report(stage, done / total, f"{message} {done}/{total}")

        return read

    def log_file(self, name: str) -> Path:
        """Where the output of a stage is kept."""
        return self.folder / f"{name}.log"

    def extract_features(self, stage: str, database: Path, names: list[str], reader: dict[str, object]) -> None:
        """Find the features of images that share one camera, which `reader` (ImageReader.*) describes."""
        names_file = self.folder / f"{stage}_names.txt"
        names_file.write_text("".join(f"{name}\n" for name in names))
        photos = self.options.photos
        self.colmap.run(
            "feature_extractor",
            {
                "database_path": database,
                "image_path": self.images,
                "image_list_path": names_file,
                "ImageReader.single_camera": 1,
                **{f"ImageReader.{key}": value for key, value in reader.items()},
                "SiftExtraction.use_gpu": 0,
                "SiftExtraction.num_threads": self.colmap.threads,
                "SiftExtraction.max_num_features": photos.max_features,
                "SiftExtraction.max_image_size": photos.max_side_px,
            },
            self.log_file(stage),
            on_line=self.counter(stage, r"Processed file \[(\d+)/(\d+)\]", "features of photo"),
        )

    def matching_options(self) -> dict[str, object]:
        """Options of every matcher."""
        photos = self.options.photos
        return {
            "SiftMatching.use_gpu": 0,
            "SiftMatching.num_threads": self.colmap.threads,
            "SiftMatching.guided_matching": photos.guided_matching,
            "SiftMatching.min_num_inliers": photos.min_inliers,
        }
