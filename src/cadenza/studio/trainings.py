"""Runs of training in a folder, begun on the page or by `cadenza train`, and their policies."""

from __future__ import annotations

import asyncio
import re
import signal
from asyncio.subprocess import STDOUT, Process
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.files import folder_name
from cadenza.learning.run_folder import RunFolder, read_rows
from cadenza.studio.ages import ages
from cadenza.studio.processes import bound, hold, kill
from cadenza.studio.request import PlayRequest

_MOST_AT_ONCE = 1
_INTERRUPTED = 130  # how "cadenza train" exits when it was asked to stop
_MOST_POINTS = 200  # of a curve
_MOST_SAID = 2**16  # bytes of what it says that are kept
_PATIENCE = 20.0  # [s] for a checkpoint, before a run that was asked to stop is killed
POLICY = "policy/"  # what the agent begins with that is the best policy of a run


_NOTHING_YET: dict[str, Any] = dict.fromkeys(("steps", "f1", "note_onset_f1"))
_NOTHING_YET |= {"step": 0, "points": []}


@dataclass(frozen=True)
class _Learning:
    process: Process
    errors: list[str] = field(default_factory=list)
    """The last line of them."""


class Trainings:
    """One run learns at a time; it stands still while songs are played."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self._learning: dict[str, _Learning] = {}
        self._errors: dict[str, str] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._known: dict[Path, tuple[int, dict[str, Any]]] = {}
        self._paused = False
        self._to_end: set[str] = set()  # runs that were asked to
        self._beginning = asyncio.Lock()

    def runs(self) -> list[dict[str, Any]]:
        """All that can be read, the newest first, with the points of their curves.

        Among them are those that have begun, or failed, without having written anything.
        """
        figures: dict[str, dict[str, Any]] = {}
        for path in self._paths():
            with suppress(CadenzaError, OSError):  # of another version, damaged, or just deleted
                figures[path.name] = self._figures(path)
        new = dict.fromkeys((*self._learning, *self._errors), _NOTHING_YET)
        return [
            {**known, "name": name, "state": self._state(name, known)}
            | {"error": self._errors.get(name, "")}
            for name, known in (new | figures).items()
        ]

    def _state(self, name: str, figures: dict[str, Any]) -> str:
        if name in self._learning:
            return "learning"
        if figures is _NOTHING_YET:
            return "failed"
        return "finished" if figures["step"] >= figures["steps"] else "stopped"

    def policies(self) -> dict[str, Path]:
        """Agent -> the folder of its policy."""
        best = {POLICY + path.name: path / "best" for path in self._paths()}
        return {agent: path for agent, path in best.items() if path.is_dir()}

    async def begin(self, request: PlayRequest, title: str, source: str, steps: int) -> str:
        """Has a policy learn a song; the name of the run.

        Raises:
            CadenzaError: another run is learning.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        options: dict[str, float | str] = {
            "num-steps": steps,
            "seed": request.seed,
            "hand": request.hand,
            "transpose": request.transpose,
            "stretch": 1 / request.tempo,
        }
        flags = [f"--{option}={value}" for option, value in options.items()]
        tracks = ["--tracks", *map(str, request.tracks)] if request.tracks else []
        async with self._beginning:
            self._check_room()
            stem, taken = folder_name(title)[:40], {path.name for path in self.folder.iterdir()}
            name = next(n for i in range(1, 10_000) if (n := f"{stem} {i}") not in taken)
            await self._train(name, source, "--output", str(self.folder / name), *flags, *tracks)
        return name

    async def go_on(self, name: str) -> None:
        """Raises: CadenzaError: another run is learning, or there is no such run."""
        async with self._beginning:
            self._check_room()
            await self._train(name, "--resume", str(self._path(name)))

    def stop(self, name: str) -> None:
        """After a checkpoint.

        Raises:
            CadenzaError: it is not learning.
        """
        if name not in self._learning:
            raise CadenzaError("this run is not learning")
        self._to_end.add(name)
        process = self._learning[name].process
        for number in signal.SIGCONT, signal.SIGTERM:
            with suppress(ProcessLookupError):
                process.send_signal(number)

    def pause(self, paused: bool) -> None:
        """Stands still, or goes on."""
        if paused != self._paused:
            self._paused = paused
            for learning in self._learning.values():
                hold(learning.process, paused)

    async def close(self) -> None:
        """Ends all, after a checkpoint if that does not take long."""
        for name in list(self._learning):
            self.stop(name)
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=_PATIENCE)
        for learning in self._learning.values():
            kill(learning.process)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _paths(self) -> list[Path]:
        """Those whose names the page can show, and ask for, the newest first."""
        found = (path.parent for path in ages(self.folder.glob("*/run.json")))
        return [path for path in found if path.name.isprintable()]

    def _path(self, name: str) -> Path:
        for path in self._paths():
            if path.name == name:
                return path
        raise CadenzaError("there is no such run")

    def _figures(self, run: Path) -> dict[str, Any]:
        """What is known of a run; read again when there is more."""
        metrics = run / "metrics.jsonl"
        size = metrics.stat().st_size if metrics.is_file() else 0
        if self._known.get(run, (-1, {}))[0] != size:
            config, _ = RunFolder(run).description()
            rows = read_rows(run) if size else []
            tried = [r for r in rows if None not in (r.get("eval_step"), r.get("eval/f1"))]
            best: dict[str, Any] = max(tried, key=lambda row: row["eval/f1"], default={})
            points = [(row["eval_step"], row["eval/f1"]) for row in tried]
            figures = {
                "step": max((row["step"] for row in rows), default=0),
                "steps": config.num_steps,
                "f1": best.get("eval/f1"),
                "note_onset_f1": best.get("eval/note_onset_f1"),
                "points": points[:: len(points) // _MOST_POINTS + 1],
            }
            self._known[run] = size, figures
        return self._known[run][1]

    def _check_room(self) -> None:
        if len(self._learning) >= _MOST_AT_ONCE:
            raise CadenzaError("a policy is learning already; stop it, or wait")

    async def _train(self, name: str, *arguments: str) -> None:
        """As `cadenza train` does, in a session of its own: Ctrl-C is for the server."""
        command = ["cadenza", "train", *arguments, "--no-video", "--quiet"]
        process = await bound(*command, stderr=STDOUT, start_new_session=True)
        self._errors.pop(name, None)
        learning = self._learning[name] = _Learning(process)
        hold(process, self._paused)
        task = asyncio.create_task(self._listen(name, learning))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _listen(self, name: str, learning: _Learning) -> None:
        process, said = learning.process, b""
        assert process.stdout is not None
        while more := await process.stdout.read(_MOST_SAID):
            said = (said + more)[-_MOST_SAID:]
        code = await process.wait()
        del self._learning[name]
        asked = name in self._to_end
        self._to_end.discard(name)
        if code == -signal.SIGKILL and not asked:
            self._errors[name] = "was killed, as a system does that runs out of memory"
        elif code not in (0, _INTERRUPTED, -signal.SIGTERM, -signal.SIGKILL):
            last = said.decode(errors="replace").rstrip().rpartition("\n")[2]
            self._errors[name] = re.sub(r"^\w*error: ", "", last, flags=re.IGNORECASE)[:300]
