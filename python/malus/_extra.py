"""Import of optional packages."""

from __future__ import annotations

import importlib
from types import ModuleType

from malus.errors import ExternalError


def extra(module: str, package: str, purpose: str, group: str = "export") -> ModuleType:
    """Import a module; if it is missing, ExternalError that names package, purpose and the extra to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ExternalError(
            f"{purpose} needs the Python package {package}, which is not installed; "
            f"expected after: pip install 'malus[{group}]'"
        ) from None
