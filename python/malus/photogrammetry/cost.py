"""Expected time and memory of finding the photos' cameras and of sweeping a station (decision 71)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from malus.options import Options
from malus.photogrammetry.features import sift_mb

# Twice the seconds of one run of the relief (12 photos, 8192 features each) with two threads on a shared machine.
_SECONDS_A_MEGAPIXEL = 2.4
_SECONDS_A_PAIR = 0.4
_SECONDS_A_PHOTO = 8.6
_FEATURES = 8192
#: Share of the seconds that the sweep takes.
_SWEEP_SHARE = 0.3
#: Memory of Python, its packages and the library before any input is read.
_FIXED_MB = 100
#: Maps of the polarization step, which stay in memory meanwhile.
_KEPT_MB_A_MEGAPIXEL = 64
_FLOAT_MB_A_MEGAPIXEL = 4.0
#: Floats per pixel of each photo. While windows are matched: measured with 40 photos of 18 megapixels, half of it for the
#: photos with their pyramids. In the sweep: the photos and the level that is compared.
_MATCHED_FLOATS, _SWEPT_FLOATS = 8 / 3, 5 / 4
#: Rasters of the station in the sweep, and further ones per photo in the search for highlights.
_SWEEP_RASTERS, _SWEEP_RASTERS_A_PHOTO = 12, 1 / 4
#: Memory of a tile of the sweep per thread, and of the program COLMAP.
_SWEEP_MB_A_THREAD, _COLMAP_MB = 40, 30


@dataclass(frozen=True)
class Expected:
    """Expected time and memory of a part of a run."""

    seconds: float
    memory_mb: float


@dataclass(frozen=True)
class Work:
    """Quantities that determine the cost."""

    sizes: Sequence[tuple[int, int]]
    """Width and height of each photo, px."""
    pairs: int
    """Number of photo pairs to match."""
    station_mpx: float
    """Megapixels of the station's image."""
    options: Options
    threads: int

    @property
    def megapixels(self) -> float:
        """Megapixels of all photos."""
        return sum(1e-6 * width * height for width, height in self.sizes)

    @property
    def seconds(self) -> float:
        """Seconds of all steps that use the photos."""
        count, features = len(self.sizes), (self.options.photos.max_features / _FEATURES) ** 2
        seconds = self.megapixels * _SECONDS_A_MEGAPIXEL + (self.pairs + count) * _SECONDS_A_PAIR * features
        return (seconds + count * _SECONDS_A_PHOTO) / min(self.threads, 2)

    def held_mb(self, photo_floats: float, rasters: float) -> float:
        """Memory with `photo_floats` floats per pixel of each photo and `rasters` rasters of the station."""
        floats = photo_floats * self.megapixels + rasters * self.station_mpx
        return _FIXED_MB + _KEPT_MB_A_MEGAPIXEL * self.station_mpx + _FLOAT_MB_A_MEGAPIXEL * floats


def photos_cost(work: Work) -> Expected:
    """Cost of finding the cameras."""
    features_mb = work.held_mb(0, 0) + _COLMAP_MB + work.threads * sift_mb(work.sizes, work.options.photos.max_side_px)
    return Expected((1 - _SWEEP_SHARE) * work.seconds, max(features_mb, work.held_mb(_MATCHED_FLOATS, 0)))


def sweep_cost(work: Work) -> Expected:
    """Cost of the sweeps of one station, without the fusion between them."""
    rasters = _SWEEP_RASTERS + _SWEEP_RASTERS_A_PHOTO * len(work.sizes)
    memory_mb = work.held_mb(_SWEPT_FLOATS, rasters) + work.threads * _SWEEP_MB_A_THREAD
    return Expected(_SWEEP_SHARE * work.seconds, memory_mb)
