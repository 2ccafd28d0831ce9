"""Practice in the background, while nothing is played."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from asyncio.subprocess import PIPE
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadenza.episode import load_episode
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.performing.performance import perform
from cadenza.studio import jobs, player, practice_process
from cadenza.studio.messages import JSON, WireMessage
from cadenza.studio.request import PRACTISED, Order, PlayRequest

SCORE = Score(tuple(Note(0.4 * i, 0.4 * i + 0.3, 60 + i) for i in range(3)), title="Three")


def order(song: str = "OdeToJoy", folder: Path = Path("/nowhere")) -> Order:
    return Order(PlayRequest(song, PRACTISED), "Three", song, True, "0" * 16, str(folder))


def state_of(pid: int) -> str:
    """T is that of a process that stands still."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs Linux")
def test_practice_stands_still_while_others_play(monkeypatch):
    """The process does nothing but wait."""
    begun = []

    async def waiting(*_: str) -> Any:
        command = [sys.executable, "-S", "-c", "import time; time.sleep(60)"]
        begun.append(await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE))
        return begun[-1]

    async def until(condition: Any) -> None:
        while not condition():
            await asyncio.sleep(0.01)

    async def run() -> None:
        practising = jobs.BackgroundPractice()
        practising.pause(True)
        practising.begin(order("OdeToJoy"))
        await until(lambda: begun and state_of(begun[0].pid) == "T")
        practising.pause(False)
        await until(lambda: state_of(begun[0].pid) != "T")
        practising.begin(order("OdeToJoy"))  # it goes on
        assert len(begun) == 1
        practising.begin(order("JingleBells"))  # another takes its place
        await until(lambda: len(begun) == 2)
        assert begun[0].returncode is not None
        practising.stop()
        await until(lambda: begun[1].returncode is not None)
        assert practising.summary["status"]["state"] == "stopped"
        await practising.close()

    monkeypatch.setattr(jobs, "start_bound_process", waiting)
    asyncio.run(asyncio.wait_for(run(), 60))


def test_practice_that_cannot_begin_is_no_end_of_all_practice(monkeypatch):
    tried = []

    async def full(*_: str) -> Any:
        tried.append(None)
        raise BlockingIOError("no room for another process")

    async def run() -> None:
        practising = jobs.BackgroundPractice()
        for song in ("OdeToJoy", "OdeToJoy", "JingleBells"):
            practising.begin(order(song))
            while practising.summary["status"]["state"] == "preparing":
                await asyncio.sleep(0.01)
            assert practising.summary["status"]["state"] == "failed"
            assert "no room for another process" in practising.summary["status"]["error"]
        assert len(tried) == 3
        await practising.close()

    monkeypatch.setattr(jobs, "start_bound_process", full)
    asyncio.run(asyncio.wait_for(run(), 60))


@pytest.mark.slow
def test_what_was_practised_is_played(tmp_path, monkeypatch):
    song, messages = tmp_path / "three.mid", list[WireMessage]()
    write_midi(SCORE, song)
    monkeypatch.setattr(practice_process, "ENOUGH", 0.2)
    practice_process.practise(order(str(song), tmp_path), messages.append)
    content = [json.loads(message.content) for message in messages if message.kind == JSON]
    assert content[-1]["state"] == "done"
    played, _ = player.play(order(str(song), tmp_path), lambda _: None, lambda: None)
    assert played.settings["agent"] == "playback"
    assert played.metrics["f1"] == pytest.approx(max(content[-1]["f1"]))
    with player.set_up_order(order(str(song), tmp_path), lambda *_: None) as setup:
        assert perform(setup).metrics["f1"] == pytest.approx(content[-1]["f1"][0])  # at first sight


def test_practice_that_cannot_go_on_begins_anew(tmp_path, monkeypatch):
    song, messages = tmp_path / "three.mid", list[WireMessage]()
    write_midi(SCORE, song)
    folder = player.practice_folder_of(order(str(song), tmp_path))
    folder.mkdir(parents=True)
    (folder / "practice.safetensors").write_bytes(b"damaged")
    monkeypatch.setattr(practice_process, "ENOUGH", 0.0)
    practice_process.practise(order(str(song), tmp_path), messages.append)
    assert (folder / "practice.safetensors.old").read_bytes() == b"damaged"


def test_a_damaged_plan_is_practised_anew(tmp_path):
    song = tmp_path / "three.mid"
    write_midi(SCORE, song)
    folder = player.practice_folder_of(order(str(song), tmp_path))
    folder.mkdir(parents=True)
    (folder / "plan.safetensors").write_bytes(b"damaged")
    played, _ = player.play(order(str(song), tmp_path), lambda _: None, lambda: None)
    assert played.settings["agent"] == "planner"
    assert [path.name for path in folder.iterdir()] == ["plan.safetensors.old"]


SERVER = """
import asyncio, sys
from cadenza.studio import jobs
from cadenza.studio.processes import start_bound_process
from cadenza.studio.request import PRACTISED, Order, PlayRequest

processes = []

async def start(module):
    processes.append(await start_bound_process(module))
    return processes[-1]

jobs.start_bound_process = start

async def run():
    practising = jobs.BackgroundPractice()
    request = PlayRequest("OdeToJoy", PRACTISED)
    practising.begin(Order(request, "Ode", "OdeToJoy", False, "0" * 16, sys.argv[1]))
    while "stage" not in practising.status:
        await asyncio.sleep(0.1)
    practising.pause(True)
    print(processes[0].pid, flush=True)
    await asyncio.sleep(60)

asyncio.run(run())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
def test_practice_ends_with_a_server_that_is_killed(tmp_path):
    """Also while it stands still for a song: nothing would wake it again."""
    command = [sys.executable, "-c", SERVER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        pid = int(server.stdout.readline())
        while state_of(pid) != "T":
            time.sleep(0.01)
        server.kill()
    try:
        end = time.monotonic() + 10
        while Path(f"/proc/{pid}").exists() and state_of(pid) != "Z":
            assert time.monotonic() < end
            time.sleep(0.01)
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["planner", "generalist"])
def test_what_is_streamed_is_what_the_command_line_plays(tmp_path, agent):
    """The same bits, so nothing is lost by it."""
    song = tmp_path / "three.mid"
    write_midi(SCORE, song)
    request = PlayRequest("three", agent, tempo=1.25, transpose=2, seed=3, expression=True)
    ours = Order(request, "Any title", str(song), True, "0" * 16, str(tmp_path))
    streamed, states = player.play(ours, lambda _: None, lambda: None)
    options = ["--seed", "3", "--stretch", "0.8", "--transpose", "2", "--expression", "1"]
    options += ["--agent", agent, "--no-video"]
    command = ["play", str(song), "-o", str(tmp_path / "out"), *options]
    subprocess.run([sys.executable, "-m", "cadenza", *command], check=True)
    written = load_episode(tmp_path / "out" / "episode.npz")
    assert written.arrays.keys() == streamed.episode.arrays.keys()
    for name, values in written.arrays.items():
        if name != "metrics":  # which have times among them
            np.testing.assert_array_equal(values, streamed.episode[name], err_msg=name)
    assert len(states.rows) % written.num_steps == 0
