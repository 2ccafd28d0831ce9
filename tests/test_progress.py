"""What is shown of work that takes a while, on a terminal and elsewhere."""

import io
import sys
import time

import pytest

from cadenza.cli.printing import QUIET, progress, stages


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch):
    """Seconds that time.monotonic tells, to be moved by the test."""
    seconds = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: seconds[0])
    return seconds


def test_a_log_gets_a_line_now_and_then(clock, monkeypatch):
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    with progress("playing", "steps") as advance:
        for done in range(1, 101):
            advance(done, 100, "F1 0.5" if done > 50 else "")
            clock[0] += 0.25
    assert log.getvalue() == (
        "playing: 41 of 100 steps, 00:14 left\nplaying: 81 of 100 steps, 00:04 left, F1 0.5\n"
    )


def test_stages_of_a_performance_have_clocks_of_their_own(clock, monkeypatch):
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    with stages("song, seed 3") as tell:
        for stage, of in (("fingers", 10), ("postures", 4), ("playing", 20)):
            for done in range(1, of + 1):
                tell(stage, done, of)
                clock[0] += {"fingers": 2, "postures": 20, "playing": 4}[stage]
                if (stage, done) == ("playing", 10):
                    clock[0] += 10
                    tell("postures", 1, 4)
    assert log.getvalue().splitlines() == [
        "fingers: 6 of 10 notes, 00:08 left",
        "postures: 2 of 4 iterations, 00:40 left",
        "postures: 3 of 4 iterations, 00:20 left",
        "postures: 4 of 4 iterations",
        "song, seed 3: 4 of 20 steps, 01:04 left",
        "song, seed 3: 7 of 20 steps, 00:52 left",
        "song, seed 3: 10 of 20 steps, 00:40 left",
        "song, seed 3: 10 of 20 steps, 00:55 left, postures",
        "song, seed 3: 14 of 20 steps, 00:28 left",
        "song, seed 3: 17 of 20 steps, 00:13 left",
        "song, seed 3: 20 of 20 steps",
    ]


def test_what_is_resumed_is_timed_from_where_it_goes_on(clock, monkeypatch):
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    with progress("learning", "steps", 30.0) as advance:
        advance(900, 1000)
        clock[0] += 40
        advance(940, 1000)
    assert log.getvalue() == "learning: 940 of 1000 steps, 01:00 left\n"


def test_short_work_leaves_no_line(capsys):
    with progress("playing", "steps") as advance:
        for done in range(10):
            advance(done, 9)
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress("playing", "steps") as advance:
        advance(1, 3)
        time.sleep(1.1)  # it appears after a second
        advance(2, 3, "F1 0.5")
    shown = terminal.getvalue()
    assert "playing" in shown
    assert "2/3" in shown
    assert "F1 0.5" in shown
    assert shown.endswith("\r")


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_quiet_shows_nothing(stream, clock, monkeypatch):
    shown = stream()
    monkeypatch.setattr(sys, "stderr", shown)
    token = QUIET.set(True)
    try:
        with progress("playing", "steps") as advance:
            for done in range(3):
                advance(done, 2)
                clock[0] += 60
    finally:
        QUIET.reset(token)
    assert shown.getvalue() == ""
