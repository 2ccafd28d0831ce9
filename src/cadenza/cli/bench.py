"""`cadenza bench`: many agents play many songs, in runs that can be stopped and resumed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from cadenza.agents.registry import PLANNER, PLAYBACK, PRACTISED, PRETRAINED, is_folder
from cadenza.cli.arguments import Flat, Output, Quiet
from cadenza.cli.options import TRAIN, Options, Read, split_agents
from cadenza.cli.runs import Execution, Work, check_execution, run_all
from cadenza.configs import MAX_SEED, whole_number
from cadenza.errors import CadenzaError, CadenzaWarning, counted, quoted
from cadenza.learning.config import preset
from cadenza.learning.learner import Preset

if TYPE_CHECKING:
    from cadenza.evaluation.jobs import BenchJob, Contender

_MAX_SEEDS = 10_000  # seeds of one range: a typo ends at once
_MAX_RUNS = 20_000  # runs that take days
_SUFFIXES = {"": None, "-residual": True, "-from-nothing": False}


@dataclass(frozen=True)
class Bench(Options):
    """Have agents play all songs of a library, with several seeds.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza bench --songs bundled --agents planner,zero --seeds 0-2 -o results
    """

    songs: str = "debug"
    """A song, a library, see "cadenza libraries", or a folder. LIBRARY:SPLIT is a split of it."""
    agents: tuple[str, ...] = ("planner",)
    """Agents of "cadenza play" but playback, with commas or spaces between; or train:fast,
    train:paper, train:published, train:fast-from-nothing: a policy trained on each song."""
    seeds: tuple[str, ...] = ("0",)
    """Random seeds, such as 0-2 or 0,5, for each agent and song."""
    output: Output[Path] = Path("bench")
    """Folder of the runs, which is extended if it holds some already."""
    num_threads: int = 1
    """Threads of each run."""
    num_steps: int | None = None
    """Environment steps of train:PRESET. By default those of the preset."""
    pages: Literal["first-seed", "all", "none"] = "first-seed"
    """Runs leave a page to watch and hear: the first of each song and agent, all, or none."""
    execution: Flat[Execution] = field(default_factory=Execution)
    quiet: Quiet = False


def run(command: Bench, read: Read[Bench]) -> None:
    from cadenza.evaluation.jobs import bench_jobs
    from cadenza.evaluation.results import is_finished
    from cadenza.evaluation.run import carry_out
    from cadenza.music.libraries.library import open_library

    agents, seeds = _agents(command), _seeds(command.seeds)
    check_execution(command.num_threads, command.execution)
    contenders = _contenders(command, read, agents)
    library = open_library(command.songs)
    if (runs := len(library.songs) * len(agents) * len(seeds)) > _MAX_RUNS:
        parts = (library.songs, "song"), (agents, "agent"), (seeds, "seed")
        what = ", ".join(counted(len(each), noun) for each, noun in parts)
        raise CadenzaError(
            f"{what}: {runs:,} runs, but a bench holds up to {_MAX_RUNS:,}; choose fewer, such as "
            "a split or a smaller folder of songs"
        )
    jobs = bench_jobs(library, contenders, seeds, command.arrangement, command.pages)
    if not jobs:
        raise CadenzaError("there is nothing to run: choose other songs or agents")
    trains = any(job.spec.training is not None for job in jobs)
    until = "a checkpoint of the runs that train" if trains else "ending the runs under way"
    results = ["cadenza", "results", str(command.output)]
    work = Work(carry_out, is_finished, _result, until, results)
    run_all(command.output, command.num_threads, command.execution, jobs, work)


def _agents(command: Bench) -> list[str]:
    agents = split_agents(command.agents)
    if not agents:
        raise CadenzaError("nobody plays: name at least one agent")
    agents = list(dict.fromkeys(agents))
    if PLAYBACK in agents:
        raise CadenzaError(f"{PLAYBACK} plays a single file: name other agents")
    return agents


def _seeds(parts: Sequence[str]) -> list[int]:
    """The seeds of texts such as 0-2 or 0,5, each once."""
    seeds: dict[int, None] = {}
    for part in (part for given in parts for part in given.split(",") if part):
        first, _, last = part.partition("-")
        try:
            ends = int(first), int(last or first)
        except ValueError as error:
            raise CadenzaError(f"seeds {part}: give whole numbers such as 0-2 or 0,5") from error
        for end in ends:
            whole_number(end, "seed", 0, MAX_SEED)
        if not 0 <= ends[1] - ends[0] < _MAX_SEEDS:
            raise CadenzaError(f"seeds {part}: give them as FIRST-LAST, at most {_MAX_SEEDS}")
        seeds |= dict.fromkeys(range(ends[0], ends[1] + 1))
    if not seeds:
        raise CadenzaError("no seed: name at least one")
    return list(seeds)


def _contenders(
    command: Bench, read: Read[Bench], agents: Sequence[str]
) -> Callable[[str], list[Contender]]:
    """A function from a song to its contenders, with the options of the command.

    Given options override the options that a policy was trained with.
    """
    fixed = {name: _contender(command, read, name) for name in agents if name != PRETRAINED}

    def contenders(song: str) -> list[Contender]:
        candidates = (
            fixed[name] if name in fixed else _pretrained(command, read, song) for name in agents
        )
        return [contender for contender in candidates if contender is not None]

    return contenders


def _contender(command: Bench, read: Read[Bench], agent: str) -> Contender:
    from cadenza.agents.registry import make_agent
    from cadenza.evaluation.jobs import Contender, digest_of_files
    from cadenza.hub import pinned
    from cadenza.learning.policy_folder import policy_folder

    if agent.startswith(TRAIN):
        return _trained(command, read, agent)
    if is_folder(agent):
        folder = policy_folder(agent)
        return _from_folder(command, read, pinned(agent, folder), folder)
    config = command.configs.get(agent)
    make_agent(agent, config)  # an unknown agent is an error before any plays
    return Contender(agent, command.task, command.scene, config, digest_of_files(config))


def _pretrained(command: Bench, read: Read[Bench], song: str) -> Contender | None:
    """The policy that comes with the song; None, with a warning, if there is none."""
    from cadenza.learning.pretrained import pretrained_folder

    try:
        folder = pretrained_folder(song)
    except CadenzaError:
        what = f"{song}: left out for {PRETRAINED}, no policy comes with it"
        warnings.warn(what, CadenzaWarning, stacklevel=2)
        return None
    return _from_folder(command, read, PRETRAINED, folder)


def _from_folder(command: Bench, read: Read[Bench], agent: str, folder: Path) -> Contender:
    """A policy or practised hands, which play as they learnt unless an option says otherwise."""
    from cadenza.evaluation.jobs import Contender
    from cadenza.files import sha256_of
    from cadenza.learning.policy_folder import POLICY_FILE
    from cadenza.performing.setup import find_player

    player = find_player(folder, configs=command.configs)
    own = read(task=player.task, scene=player.scene)
    name, config = POLICY_FILE, None
    if player.policy is None:
        name, config = PRACTISED, command.configs.get(PLANNER)
    return Contender(agent, own.task, own.scene, config, sha256_of(folder / name)[:12])


def _trained(command: Bench, read: Read[Bench], agent: str) -> Contender:
    from cadenza.evaluation.jobs import Contender
    from cadenza.learning.config import check

    presets = {
        f"{TRAIN}{name}{suffix}": (name, residual)
        for suffix, residual in _SUFFIXES.items()
        for name in get_args(Preset)
    }
    if agent not in presets:
        raise CadenzaError(f"no agent {quoted(agent)}: choose from {', '.join(presets)}")
    training = preset(*presets[agent])
    own = read(task=training.task, scene=training.scene)
    steps = training.num_steps if command.num_steps is None else command.num_steps
    config = replace(training, task=own.task, scene=own.scene, num_steps=steps)
    check(config)
    return Contender(agent, own.task, own.scene, config)


def _result(folder: Path, _: BenchJob) -> str:
    from cadenza.evaluation.results import read_result

    result = read_result(folder)
    f1, onsets = (result.metrics.get(name) for name in ("f1", "note_onset_f1"))
    return f"F1 {f1:.3f}, note onset F1 {onsets:.3f}, {result.timing.wall_seconds:.0f} s"
