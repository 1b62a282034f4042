"""Attack on functions that take arrays: each one that a test calls is called again with one argument changed.

A plugin of pytest, to be used with an extension under sanitizers (scripts/test --sanitize python -p arrays FILES), which end the
process at the first access beyond an array. Arrays lose a row or a column, become empty, huge, not a number, or another view of
the same memory; objects such as priors are replaced by those of other sizes. Then only a result, a ValueError, a TypeError or an
error of malus may follow; others are listed at the end, and the exit code is 1.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import random
import signal
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import numpy as np
import pytest

import malus
from malus import _core

MODULES = ("polarization", "capture", "prior", "stereo", "evidence", "height", "fusion", "surface", "assess")
#: Objects of the extension that functions take.
RESULTS = (_core.PolarizationState, _core.ReflectionMap, _core.DepthPrior, _core.HeightMap, _core.FusedSurface)
#: A call that takes longer with the test's own arguments is not repeated; one that takes as long as LONGEST_S is a finding.
QUICK_S, LONGEST_S = 2.0, 60
#: Time for all changes of one call; they come in random order.
CALL_S = 15
#: Calls of each function that are repeated with changes: those with other types of arguments come first.
CALLS = 4
EXPECTED = (malus.MalusError, ValueError, TypeError, MemoryError, Warning)

Call = tuple[tuple[Any, ...], dict[str, Any]]


class Attack:
    """What was called, and what came of it."""

    def __init__(self) -> None:
        self.kinds: dict[str, set[str]] = defaultdict(set)
        self.pool: dict[type, list[Any]] = defaultdict(list)
        self.outcomes: Counter[str] = Counter()
        self.findings: dict[str, str] = {}
        self.is_attacking = False

    def wrapped(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, which after a quick call is called again with changed arguments."""

        @functools.wraps(function)
        def call(*words: Any, **named: Any) -> Any:
            start = time.monotonic()
            result = function(*words, **named)
            if not self.is_attacking and time.monotonic() - start < QUICK_S:
                self.attack(name, function, (words, named))
            return result

        return call

    def attack(self, name: str, function: Callable[..., Any], call: Call) -> None:
        """Repeat a call with each change of each argument, unless one of the same kind was repeated before."""
        values = [*call[0], *call[1].values()]
        for value in values:
            if isinstance(value, RESULTS) and len(self.pool[type(value)]) < 20:
                self.pool[type(value)].append(value)
        kind = (
            f"{[kind_of(value) for value in call[0]]} {sorted((key, kind_of(value)) for key, value in call[1].items())}"
        )
        if kind in self.kinds[name] or len(self.kinds[name]) >= CALLS:
            return
        self.kinds[name].add(kind)
        self.is_attacking = True
        try:
            changed = list(self.changed_calls(call))
            random.Random(kind).shuffle(changed)
            end = time.monotonic() + CALL_S
            for what, (words, named) in changed:
                if time.monotonic() > end:
                    break
                self.outcomes[self.outcome(f"{name} with {what}", function, words, named)] += 1
        finally:
            self.is_attacking = False

    def changed_calls(self, call: Call) -> Iterator[tuple[str, Call]]:
        words, named = call
        for k, value in enumerate(words):
            for what, other in self.changes(value):
                yield f"argument {k + 1} {what}", ((*words[:k], other, *words[k + 1 :]), named)
        for key, value in named.items():
            if key == "threads":
                continue
            for what, other in self.changes(value):
                yield f"{key} {what}", (words, {**named, key: other})

    def outcome(self, what: str, function: Callable[..., Any], words: Any, named: Any) -> str:
        """Call; the kind of what happened. Whatever is not expected is a finding."""
        signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
        try:
            function(*words, **named)
            return "results"
        except EXPECTED as error:
            return type(error).__name__
        except KeyboardInterrupt:
            raise
        except Exception as error:
            self.findings[f"{what}: {type(error).__name__}"] = str(error)
            return "findings"
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def changes(self, value: Any) -> Iterator[tuple[str, Any]]:
        """Other values for an argument, each with its description."""
        if isinstance(value, np.ndarray):
            yield from changed_arrays(value)
        elif isinstance(value, RESULTS):
            others = [other for other in self.pool[type(value)] if other is not value]
            yield from (("of another call", other) for other in others[:5])
        elif isinstance(value, malus.Camera):
            for width, height in ((1, 1), (value.width + 1, value.height), (value.width, value.height - 1)):
                yield "of another size", dataclasses.replace(value, width=width, height=height)
            yield "turned", dataclasses.replace(value, width=value.height, height=value.width)
        elif isinstance(value, list | tuple) and value:
            yield "without its last element", value[:-1]
            yield "empty", value[:0]
            yield "twice", value + value
            for what, other in self.changes(value[-1]):
                yield f"with a last element {what}", type(value)([*value[:-1], other])  # type: ignore[call-arg]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield from ((f"= {other}", other) for other in (0, -1, 2**31, 1e300, np.nan, np.inf))


def kind_of(value: Any) -> str:
    """Type of an argument; of arrays also their axes and element type."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.ndim}"
    return f"[{kind_of(value[0])}]" if isinstance(value, list | tuple) and value else type(value).__name__


def changed_arrays(array: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Arrays of other shapes, values, element types and memory layouts."""
    yield "with another axis", array[..., None]
    yield "in three channels", np.stack([array] * 3, axis=-1)
    yield "of big-endian numbers", array.astype(array.dtype.newbyteorder(">"))
    yield "of text", array.astype(str)
    with np.errstate(all="ignore"):
        half = array.astype(np.float16)
    yield "of half precision", half
    for value in (0, -1, 255, 2**32 - 1, np.nan, np.inf, -1e300):
        full = np.full(array.shape, value, np.float64)
        with np.errstate(all="ignore"):
            same_type = full.astype(array.dtype)
        yield f"full of {value}", same_type
        yield f"full of real {value}", full
    for axis in range(array.ndim):
        shorter = np.delete(array, -1, axis)
        yield f"shorter along axis {axis}", shorter
        yield f"longer along axis {axis}", np.concatenate([array, array], axis)
        yield f"empty along axis {axis}", np.take(array, [], axis)
        yield f"with one element along axis {axis}", np.take(array, [0], axis)
        yield f"reversed along axis {axis}", np.flip(array, axis)
        yield f"repeated along axis {axis}", np.broadcast_to(np.take(array, [0], axis), array.shape)
    if array.ndim > 1:
        yield "turned", np.swapaxes(array, 0, 1)
        yield "flat", array.ravel()
        yield "without an axis", array[0]
    if array.dtype.itemsize > 1:
        memory = np.empty(array.nbytes + 1, np.uint8)[1:]
        unaligned = np.ndarray(array.shape, array.dtype, memory)
        unaligned[...] = array
        yield "unaligned", unaligned


def whole_run(*words: Any, **named: Any) -> None:
    """A station made of arrays, until what is computed from both images and prior."""
    station = malus.Station(*words, **named)
    given = any(named.get(name) is not None for name in ("prior_points", "prior_mesh", "prior_depth"))
    malus.reconstruct(station, until="prior" if given else "polarization", threads=2)


def pytest_configure() -> None:
    """Wrap all public functions of the steps before tests import them."""

    def too_long(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"over {LONGEST_S} s")

    signal.signal(signal.SIGALRM, too_long)
    for module in (getattr(malus, name) for name in MODULES):
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ == module.__name__ and not name.startswith("_"):
                setattr(module, name, ATTACK.wrapped(f"{module.__name__}.{name}", function))
    malus.Camera.resected = ATTACK.wrapped("Camera.resected", malus.Camera.resected)  # type: ignore[method-assign]
    create = malus.Station.__init__

    @functools.wraps(create)
    def make(self: malus.Station, *words: Any, **named: Any) -> None:
        create(self, *words, **named)
        if not ATTACK.is_attacking:
            ATTACK.attack("Station", whole_run, (words, named))

    malus.Station.__init__ = make  # type: ignore[method-assign]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print what was attacked, and the findings."""
    terminalreporter.write_line(f"attacked {len(ATTACK.kinds)} functions: {dict(ATTACK.outcomes)}")
    for what, message in ATTACK.findings.items():
        terminalreporter.write_line(f"FINDING: {what}: {message}")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Findings fail the run."""
    if ATTACK.findings and session.exitstatus == 0:
        session.exitstatus = 1


ATTACK = Attack()
