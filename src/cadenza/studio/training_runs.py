"""Training runs in a folder, begun on the page or by `cadenza train`, and their policies."""

from __future__ import annotations

import asyncio
import re
import signal
from asyncio.subprocess import STDOUT, Process
from contextlib import suppress
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.files import folder_name, modification_times
from cadenza.learning.metrics_log import MetricsLog
from cadenza.learning.run_folder import RunFolder
from cadenza.studio.processes import kill, start_bound_process, suspend
from cadenza.studio.request import PlayRequest

_MAX_LEARNING = 1  # runs at once
_INTERRUPTED = 130  # how "cadenza train" exits when it was asked to stop
_MAX_POINTS = 200  # of a curve
_MAX_OUTPUT = 2**16  # bytes of the output of a run that are kept, of which the last line is shown
_MAX_ERROR, _MAX_STEM = 300, 40  # letters of an error, and of a title in the name of a run
_MAX_RUNS = 10_000  # of one title
_PATIENCE = 20.0  # [s] for a checkpoint, before a run that was asked to stop is killed
_POLICY = "policy/"  # the agent "policy/NAME" is the best policy of a run
_NOTHING_YET: dict[str, Any] = dict.fromkeys(("steps", "f1", "note_onset_f1"))
_NOTHING_YET |= {"step": 0, "points": []}


class TrainingRuns:
    """Trains one policy at a time, and suspends it while songs are played."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self._learning: dict[str, Process] = {}  # by the name of a run
        self._errors: dict[str, str] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._figures: dict[Path, tuple[int, dict[str, Any]]] = {}  # size of its metrics, figures
        self._paused = False
        self._stopping: set[str] = set()  # runs that were asked to
        self._starting = asyncio.Lock()

    def runs(self) -> list[dict[str, Any]]:
        """Lists all runs that can be read, the newest first, with the points of their curves.

        Runs that have begun, or failed, without having written anything are among them.
        """
        figures: dict[str, dict[str, Any]] = {}
        for path in self._paths():
            with suppress(CadenzaError, OSError):  # damaged, or just deleted
                figures[path.name] = self._figures_of(path)
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
        """Returns the folder of each policy, by the name of the agent that plays it."""
        best = {_POLICY + path.name: path / "best" for path in self._paths()}
        return {agent: path for agent, path in best.items() if path.is_dir()}

    async def begin(self, request: PlayRequest, title: str, source: str, steps: int) -> str:
        """Trains a policy on a song, and returns the name of the run.

        Raises:
            CadenzaError: another run is learning.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        options: dict[str, float | str] = {
            "num-steps": steps,
            "seed": request.seed,
            "hand": request.hand,
            "hands": request.playing_hands,
            "transpose": request.transpose,
            "stretch": 1 / request.tempo,
            "expression": float(request.expression),
        }
        flags = [f"--{option}={value}" for option, value in options.items()]
        flags += ["--plain"] if request.plain else []
        tracks = ["--tracks", *map(str, request.tracks)] if request.tracks else []
        async with self._starting:
            self._check_is_free()
            stem = folder_name(title)[:_MAX_STEM]
            taken = {path.name for path in self.folder.iterdir()}
            name = next(n for i in range(1, _MAX_RUNS) if (n := f"{stem} {i}") not in taken)
            await self._start(name, source, "--output", str(self.folder / name), *flags, *tracks)
        return name

    async def resume(self, name: str) -> None:
        """Continues a run from its last checkpoint.

        Raises:
            CadenzaError: another run is learning, or there is no such run.
        """
        async with self._starting:
            self._check_is_free()
            await self._start(name, "--resume", str(self._path(name)))

    def stop(self, name: str) -> None:
        """Ends a run after a checkpoint.

        Raises:
            CadenzaError: it is not learning.
        """
        if name not in self._learning:
            raise CadenzaError("this run is not learning")
        self._stopping.add(name)
        for number in signal.SIGCONT, signal.SIGTERM:
            with suppress(ProcessLookupError):
                self._learning[name].send_signal(number)

    def pause(self, paused: bool) -> None:
        """Suspends the run that learns, or has it go on."""
        if paused != self._paused:
            self._paused = paused
            for process in self._learning.values():
                suspend(process, paused)

    async def close(self) -> None:
        """Ends all runs, after a checkpoint if that does not take long."""
        for name in list(self._learning):
            self.stop(name)
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=_PATIENCE)
        for process in self._learning.values():
            kill(process)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _paths(self) -> list[Path]:
        """Returns the folders whose names the page can show and ask for, the newest first."""
        found = (path.parent for path in modification_times(self.folder.glob("*/run.json")))
        return [path for path in found if path.name.isprintable()]

    def _path(self, name: str) -> Path:
        for path in self._paths():
            if path.name == name:
                return path
        raise CadenzaError("there is no such run")

    def _figures_of(self, run: Path) -> dict[str, Any]:
        """Returns steps, scores and curve of a run; they are read again when there are more."""
        metrics = run / "metrics.jsonl"
        size = metrics.stat().st_size if metrics.is_file() else 0
        if self._figures.get(run, (-1, {}))[0] != size:
            config, _ = RunFolder(run).description()
            rows = MetricsLog(run).rows() if size else []
            evaluated = [r for r in rows if None not in (r.get("eval_step"), r.get("eval/f1"))]
            best: dict[str, Any] = max(evaluated, key=lambda row: row["eval/f1"], default={})
            points = [(row["eval_step"], row["eval/f1"]) for row in evaluated]
            figures = {
                "step": max((row["step"] for row in rows), default=0),
                "steps": config.num_steps,
                "f1": best.get("eval/f1"),
                "note_onset_f1": best.get("eval/note_onset_f1"),
                "points": points[:: len(points) // _MAX_POINTS + 1],
            }
            self._figures[run] = size, figures
        return self._figures[run][1]

    def _check_is_free(self) -> None:
        if len(self._learning) >= _MAX_LEARNING:
            raise CadenzaError("a policy is learning already; stop it, or wait")

    async def _start(self, name: str, *arguments: str) -> None:
        """Runs `cadenza train` in a session of its own: Ctrl-C is for the server."""
        command = ["cadenza", "train", *arguments, "--no-video", "--quiet"]
        process = await start_bound_process(*command, stderr=STDOUT, start_new_session=True)
        self._errors.pop(name, None)
        self._learning[name] = process
        suspend(process, self._paused)
        task = asyncio.create_task(self._follow(name, process))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _follow(self, name: str, process: Process) -> None:
        """Waits for the end of a run, and keeps the last line of its output as its error."""
        output = b""
        assert process.stdout is not None
        while more := await process.stdout.read(_MAX_OUTPUT):
            output = (output + more)[-_MAX_OUTPUT:]
        code = await process.wait()
        del self._learning[name]
        was_asked = name in self._stopping
        self._stopping.discard(name)
        if code == -signal.SIGKILL and not was_asked:
            self._errors[name] = "was killed, as a system does that runs out of memory"
        elif code not in (0, _INTERRUPTED, -signal.SIGTERM, -signal.SIGKILL):
            last = output.decode(errors="replace").rstrip().rpartition("\n")[2]
            self._errors[name] = re.sub(r"^\w*error: ", "", last, flags=re.IGNORECASE)[:_MAX_ERROR]
