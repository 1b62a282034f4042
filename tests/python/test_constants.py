"""The benchmark of the constants without its runs: the constants it finds in the sources and in docs/constants.md, and its summary of figures."""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
constants: Any = importlib.import_module("constants")
varied_source: Any = importlib.import_module("varied_source")
TABLE = ROOT / "docs/constants.md"


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sources")
    shutil.copytree(ROOT / "cpp", folder / "cpp")
    return folder


@pytest.fixture(scope="module")
def found(tree: Path) -> dict[str, Any]:
    return {constant.key: constant for constant in varied_source.instrument(tree)}


def test_constants_are_found_and_rewritten(tree: Path, found: dict[str, Any]) -> None:
    assert len(found) > 200
    assert not [constant.left for constant in found.values() if "its code was found" in constant.left]
    assert found["swept_prior.cpp:stride"].value == "4" and not found["swept_prior.cpp:stride"].left
    assert found["reflection_model_internal.h:node_count"].left == varied_source.LAYOUT
    text = (tree / "cpp/malus/prior/swept_prior.cpp").read_text()
    assert 'static const int stride = malus_varied::of<int>("swept_prior.cpp:stride", 4);' in text
    # Derived numbers stay as they are.
    text = (tree / "cpp/malus/prior/smoothed_cloud.cpp").read_text()
    assert "constexpr double weighted_gaussian_variance = 0.5808;" in text
    # A constant that follows from other constants is computed as the program starts.
    assert "const double last_index = first_index" in (tree / "cpp/malus/fusion/index_search.cpp").read_text()


def test_table_has_all_constants(found: dict[str, Any]) -> None:
    named = set()
    for line in TABLE.read_text().splitlines():
        cells = [part.strip() for part in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 6:
            named |= set(constants.keys_of(cells[3], "", set()))
    assert named <= set(found)
    varied = {key for key, constant in found.items() if not constant.left}
    assert varied <= named, f"docs/constants.md lacks {sorted(varied - named)}"


def row(station: str, factor: float, ratio: float, same: bool = False) -> dict[str, Any]:
    ratios = dict(rmse=ratio, detail_mad=ratio, normal_median=1.0)
    return dict(
        key="a", factor=factor, station=station, code=0, ratios=ratios, same=dict(depth=same, sigma=same, rest=same)
    )


def test_figures_are_means_over_stations() -> None:
    rows = [row("001_coin_sun", 0.5, 1.21), row("001_coin_sun", 1.5, 1.0)]
    rows += [row("002_bust_sun", 0.5, 1.0), row("002_bust_sun", 1.5, 0.995)]
    assert constants.cell(constants.summary(rows)) == "+10, −0.3; coin sun +21"
    assert constants.cell(constants.summary([row("a", 0.5, 1.0, True), row("a", 1.5, 1.0, True)])) == "nothing"
    not_reached = dict(key="a", factor=0.5, station="a", reached=False)
    assert constants.cell(constants.summary([not_reached])) == "not reached"
    # A station that does not reach the code counts as unchanged.
    halved = constants.summary([row("a", 0.5, 1.21), not_reached | dict(station="b")])
    assert halved["mean"]["0.5"] == pytest.approx(1.1)
