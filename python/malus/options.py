"""Options of every step, checked against the list of options in the C++ library."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Unpack

from malus import _core, _option_types
from malus._option_types import Sections, Values
from malus._plain import plain
from malus._section import Section

_SCHEMA: dict[str, dict[str, dict[str, Any]]] = json.loads(_core.option_schema())


#: The options that a user is likely to need, each with its title, for a list short enough to read.
MAIN = {
    "capture.registration": "Align the images to each other",
    "polarizer.calibrate_angles": "Correct the angles of the polarizer",
    "polarizer.angle_sigma_deg": "How well the scale was read [°]",
    "photos.backend": "Program for the photographs",
    "photos.max_side_px": "Largest side of the photographs [px]",
    "sweep.again": "Stereo a second time, about the fused surface",
    "prior.smoothing_px": "Smoothing of the coarse surface [px]",
    "evidence.refuse": "Stop where an input is certainly wrong",
    "refine.prior_weight": "Trust in the coarse surface",
    "surface.subsample": "Coarser mesh",
    "surface.dem_pixel": "Pixel of the elevation model",
    "assess.alignment": "Move onto the reference first",
}


def allowed(name: str) -> str:
    """The values that an option may have, in words, such as "a number (0 to 1)"."""
    section, key = name.split(".")
    field = _SCHEMA[section][key]
    # Not by %g, which would write a billion with an exponent.
    low, high = (f"{field[end]:.9f}".rstrip("0").rstrip(".") if end in field else None for end in ("min", "max"))
    if low is None and high is None:
        return str(field["type"])
    bounds = f"{high} or less" if low is None else f"{low} or more" if high is None else f"{low} to {high}"
    return f"{field['type']} ({bounds})"


class Options(Sections):
    """Options of a reconstruction.

    Every step has a section (`options.height.smoothness`); `fusion` is "refined" (default) or "grid". Sections are given
    as mappings: ``Options(fusion="grid", height={"smoothness": 0.1})``. A mapping that is assigned to a section sets the
    options that it names: ``options.height = {"smoothness": 0.1}``. Unknown names, wrong types and values out of
    range raise `malus.InputError`. `Options.describe()` lists everything with type, default and meaning; editors complete
    sections and options.
    """

    def __init__(self, fusion: Literal["refined", "grid"] = "refined", **sections: Unpack[Values]) -> None:
        self._values: dict[str, Any] = json.loads(_core.default_options())
        self.update({"fusion": fusion, **sections})

    @staticmethod
    def preset(name: str) -> Options:
        """The options of a named preset; InputError lists the names. "paper": the method as printed."""
        options = Options()
        options._values = json.loads(_core.preset_options(name))
        return options

    @staticmethod
    def presets() -> dict[str, str]:
        """Meaning of each preset, by name."""
        return dict(_core.presets())

    def update(self, changes: Mapping[str, Any]) -> None:
        """Set several options: ``{"section": {"key": value}}``."""
        merged = json.loads(json.dumps(self._values))
        for name, given in changes.items():
            value = given._options._values[given._name] if isinstance(given, Section) else given
            if isinstance(value, Mapping):
                changed = {key: plain(item, f"option {name}.{key}") for key, item in value.items()}
                merged[name] = {**merged.get(name, {}), **changed}
            else:
                merged[name] = plain(value, f"option {name}")
        self._values = json.loads(_core.check_options(json.dumps(merged)))

    def set(self, assignment: str) -> None:
        """Set one option from text, as `--set section.key=value` does."""
        self._values = json.loads(_core.set_option(self.to_json(), assignment))

    def update_from_file(self, path: str | Path) -> None:
        """Read options from a TOML file with one table per section."""
        self._values = json.loads(_core.options_from_file(self.to_json(), str(path)))

    @property
    def fusion(self) -> str:
        """Which fusion makes the result: "grid" (the paper's transfer) or "refined"."""
        return str(self._values["fusion"])

    @fusion.setter
    def fusion(self, value: str) -> None:
        self.update({"fusion": value})

    def __getattr__(self, name: str) -> Section:
        if name.startswith("_") or name not in _SCHEMA:
            raise AttributeError(f"no option section {name}; there are {', '.join(_SCHEMA)}")
        typed: type[Section] = getattr(_option_types, f"{name.title()}Section")
        return typed(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        # An attribute of another name would be ignored by every run.
        if name.startswith("_") or name == "fusion":
            super().__setattr__(name, value)
        else:
            self.update({name: value})

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *_SCHEMA]

    def to_dict(self) -> dict[str, Any]:
        """All values, nested by section."""
        values: dict[str, Any] = json.loads(self.to_json())
        return values

    def to_json(self) -> str:
        """All values as JSON text."""
        return json.dumps(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Options) and self._values == other._values

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        sections = ", ".join(f"{name}={value!r}" for name, value in self._values.items())
        return f"Options({sections})"

    @staticmethod
    def describe() -> Iterator[tuple[str, str, Any, str]]:
        """Yield (section.key, type, default, meaning) of every option."""
        for section, fields in _SCHEMA.items():
            for key, field in fields.items():
                yield f"{section}.{key}", field["type"], field["default"], field["doc"]
