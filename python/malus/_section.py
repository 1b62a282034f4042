"""The options of one step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol


class OptionValues(Protocol):
    """The options of all steps, by section."""

    _values: dict[str, Any]

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change some options, after checking them."""


class Section:
    """The options of one step as attributes; assignment checks name, type and range."""

    def __init__(self, options: OptionValues, name: str) -> None:
        object.__setattr__(self, "_options", options)
        object.__setattr__(self, "_name", name)

    def __getattr__(self, key: str) -> Any:
        if key.startswith("_"):  # asked for by copy and pickle, also before there are any attributes
            raise AttributeError(key)
        values = self._options._values[self._name]
        if key not in values:
            raise AttributeError(f"no option {self._name}.{key}; there are {', '.join(values)}")
        return values[key]

    def __setattr__(self, key: str, value: Any) -> None:
        self._options.update({self._name: {key: value}})

    def __dir__(self) -> list[str]:
        return list(self._options._values[self._name])

    def __repr__(self) -> str:
        return f"{self._name}({', '.join(f'{k}={v!r}' for k, v in self._options._values[self._name].items())})"
