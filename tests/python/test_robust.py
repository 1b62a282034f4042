"""The spread that a few wrong values do not change."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from malus._robust import robust_spread

ROOT = Path(__file__).parents[2]


def test_spread_ignores_outliers_and_missing_values() -> None:
    values = np.random.default_rng(3).normal(0, 2.5, 40_000)
    assert robust_spread(values) == pytest.approx(2.5, rel=0.02)
    values[::50] = 1e9
    values[1::50] = np.nan
    assert robust_spread(values) == pytest.approx(2.5, rel=0.05)


def test_the_mad_factor_is_written_once() -> None:
    found = [
        path.name
        for folder in ("python/malus", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
        if re.search(r"1\.482", "".join(path.read_text(encoding="utf-8").split('"""')[::2]))
    ]
    assert found == ["_robust.py"]
