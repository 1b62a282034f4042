"""Expected time and memory of finding the photos' cameras and of sweeping a station (decision 71)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from malus.options import Options
from malus.photogrammetry.features import sift_mb

# Processor seconds, by runs of 12 photos and a station of .6 megapixels, and of 40 photos and a station of 18 (decision 71).
#: Copies and windows.
_SECONDS_A_MEGAPIXEL, _SECONDS_A_PHOTO = 0.29, 2.9
#: SIFT, on the photo as it is and at twice its size.
_SIFT_SECONDS, _DOUBLED_SIFT_SECONDS = 0.92, 2.85
#: Verification and mapping, by the number of features; comparison of descriptors, by its square; of 8192 features.
_SECONDS_A_PAIR, _COMPARISON_SECONDS_A_PAIR = 0.78, 0.33
_FEATURES = 8192
#: Features that textured photos have in a megapixel, searched at twice its size; a quarter of them without that.
_FEATURES_A_MEGAPIXEL = 7600
#: A sweep, per megapixel of the station and photo.
_SWEEP_SECONDS = 0.112
#: Processor seconds in a second, per thread: COLMAP does not use all of them all the time.
_BUSY_SHARE = 0.8
#: Memory of Python, its packages and the library before any input is read.
_FIXED_MB = 100
#: Maps of the polarization step, which stay in memory meanwhile.
_KEPT_MB_A_MEGAPIXEL = 64
_FLOAT_MB_A_MEGAPIXEL = 4.0
#: Floats per pixel of each photo. While windows are matched: measured with 40 photos of 18 megapixels, half of it for the
#: photos with their pyramids. In the sweep: the photos and the level that is compared.
_MATCHED_FLOATS, _SWEPT_FLOATS = 9 / 4, 5 / 4
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
    def finding_seconds(self) -> float:
        """Seconds of finding the cameras."""
        photos = self.options.photos
        searched = sum(1e-6 * w * h * min(1.0, photos.max_side_px / max(w, h)) ** 2 for w, h in self.sizes)
        found = _FEATURES_A_MEGAPIXEL * searched / max(len(self.sizes), 1)
        sift = _SIFT_SECONDS if found / 4 > photos.max_features else _DOUBLED_SIFT_SECONDS
        features = min(found, photos.max_features) / _FEATURES
        pair = _SECONDS_A_PAIR * features + _COMPARISON_SECONDS_A_PAIR * features**2
        seconds = self.megapixels * _SECONDS_A_MEGAPIXEL + len(self.sizes) * _SECONDS_A_PHOTO + searched * sift
        return (seconds + self.pairs * pair) / self._busy_threads

    @property
    def sweeping_seconds(self) -> float:
        """Seconds of the sweeps, without the fusion between them."""
        sweeps = 2 if self.options.sweep.again else 1
        return sweeps * _SWEEP_SECONDS * self.station_mpx * len(self.sizes) / self._busy_threads

    @property
    def _busy_threads(self) -> float:
        return _BUSY_SHARE * min(self.threads, 2)

    def held_mb(self, photo_floats: float, rasters: float) -> float:
        """Memory with `photo_floats` floats per pixel of each photo and `rasters` rasters of the station."""
        floats = photo_floats * self.megapixels + rasters * self.station_mpx
        return _FIXED_MB + _KEPT_MB_A_MEGAPIXEL * self.station_mpx + _FLOAT_MB_A_MEGAPIXEL * floats


def photos_cost(work: Work) -> Expected:
    """Cost of finding the cameras."""
    features_mb = work.held_mb(0, 0) + _COLMAP_MB + work.threads * sift_mb(work.sizes, work.options.photos.max_side_px)
    return Expected(work.finding_seconds, max(features_mb, work.held_mb(_MATCHED_FLOATS, 0)))


def sweep_cost(work: Work) -> Expected:
    """Cost of the sweeps of one station, without the fusion between them."""
    rasters = _SWEEP_RASTERS + _SWEEP_RASTERS_A_PHOTO * len(work.sizes)
    memory_mb = work.held_mb(_SWEPT_FLOATS, rasters) + work.threads * _SWEEP_MB_A_THREAD
    return Expected(work.sweeping_seconds, memory_mb)
