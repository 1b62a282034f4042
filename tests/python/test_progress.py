"""Overall progress: steps count by the time they are expected to take, what was kept says nothing of the speed."""

from __future__ import annotations

import json

import pytest

from malus import progress
from malus.progress import JsonProgress, Overall, duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_steps_count_by_their_expected_time(clock: list[float]) -> None:
    overall = Overall([("a", 10), ("b", 30)])
    overall.update("a", 0.5)
    overall.update("unknown", 1.0)
    assert overall.fraction == pytest.approx(5 / 40)
    overall.update("a", 1.0)
    overall.update("b", 0.5)
    assert overall.fraction == pytest.approx(25 / 40)


def test_time_left_follows_the_speed_that_was_met(clock: list[float]) -> None:
    overall = Overall([("kept", 1000), ("a", 1000), ("b", 1000)])
    overall.update("kept", 1.0)
    assert overall.seconds_left == pytest.approx(2000)
    overall.update("a", 0.0)
    clock[0] = 3000
    overall.update("a", 1.0)
    assert overall.seconds_left == pytest.approx(1000 * 3005 / 1005)


def test_json_events_say_how_far_everything_is(capsys: pytest.CaptureFixture[str], clock: list[float]) -> None:
    view = JsonProgress()
    view.expect([("a", 1), ("b", 3)])
    view.progress("a", 0.0, "")
    view.progress("a", 1.0, "")
    event = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (event["step"], event["overall"]) == ("a", 0.25)
    assert event["seconds_left"] > 0


@pytest.mark.parametrize(("seconds", "said"), [(0.2, "5 s"), (42, "40 s"), (150, "2 min"), (9000, "2.5 h")])
def test_durations_as_people_say_them(seconds: float, said: str) -> None:
    assert duration(seconds) == said
