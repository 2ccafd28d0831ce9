"""A performance of a song by an agent, and the files that it leaves."""

import html
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planner.misses import Miss, misses_of
from cadenza.agents.rollout import play_episode
from cadenza.arranging.fidelity import Fate
from cadenza.episode import KEY_EVENTS, Episode
from cadenza.errors import CadenzaError
from cadenza.files import content_of, plain, read_json, write_json
from cadenza.fingers import NO_FINGER, SIDES, Side, finger_number
from cadenza.music.arrangement import SomeSong
from cadenza.music.formats.midi_sheet import write_midi_sheet
from cadenza.music.performance import key_runs, played_in
from cadenza.music.score import Score
from cadenza.performing.setup import Setup, SomeAgent, find_player, set_up
from cadenza.performing.verdict import Advice, advice, verdict
from cadenza.report.html_pages import write_page
from cadenza.report.performance_page import performance_page
from cadenza.report.sound import encode_opus, synthesize
from cadenza.report.tone import Tone, tone
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import body_poses, drawing
from cadenza.scene.scene import Scene, hand_alone
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.reward import key_activation
from cadenza.tasks.setups import NamedSetup, setup_named

_REPLACED = (
    *("metrics.json", "episode.npz", *(f"episode-{side}.npz" for side in SIDES), "misses.json"),
    *("arrangement.json", "played.mid", "wanted.mid", "report.html", "video.mp4"),
)
RESULTS = ("settings.json", *_REPLACED)  # files that a performance leaves

_IN_A_NOTEBOOK = 240.0  # [s] of music: the notebook keeps the page


@dataclass(frozen=True)
class Performance:
    """A song as an agent has played it."""

    score: Score
    """The song that was to be played, in its own time and pitch."""
    goal: Score
    """The score on the clock of the episode: trimmed, stretched, transposed, after its silence."""
    episode: Episode
    """The recording of all steps."""
    metrics: dict[str, Any]
    """The metrics, see `cadenza.agents.rollout.EpisodeResult`, and `energy` of all actuators by
    their power at step ends [J], None if the task does not count it."""
    settings: dict[str, Any]
    """The options by name: agent, seed, task and scene."""
    scene: Scene
    """The scene of hands and keyboard."""
    track: GoalTrack | None
    """The song with the fingers that play it, if the agent plans the whole of it."""
    misses: list[Miss] | None
    """Notes that were missed or let go early, and why; None without a plan to tell by."""
    fates: list[Fate] | None = None
    """The fate of each note of a song that was arranged for the hands; None if it was not."""
    advice: Advice | None = None
    """What to try where much of the song was lost."""

    def __repr__(self) -> str:
        agent, f1 = self.settings["agent"], self.metrics["f1"]
        return f"Performance({self.score.title!r} by {agent}, {self.seconds:.1f} s, F1 {f1:.3f})"

    def _repr_html_(self) -> str:
        """The page of `save` for a notebook; for long music, only how to see the page."""
        if self.seconds > _IN_A_NOTEBOOK:
            what, how = html.escape(repr(self)), "<code>.save(folder)</code> writes report.html"
            return f"<p>{what} is long; {how}, the page to watch and hear it.</p>"
        with TemporaryDirectory() as folder:
            self.save(folder)
            page = html.escape((Path(folder) / "report.html").read_text(encoding="utf-8"))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 800px; border: 0"></iframe>'

    @property
    def played(self) -> Score:
        """The score of the notes and the pedal that sounded, see `played_in`."""
        return played_in(self.episode)

    @property
    def fingered_goal(self) -> Score:
        """The goal with the fingers that were to play it, as far as the agent has planned them."""
        return self.goal if self.track is None else self.track.delayed_score

    @property
    def verdict(self) -> str:
        """How well it was played, in a sentence, see `verdict`."""
        return verdict(self.played, self.goal.until(self.seconds), self.metrics)

    @property
    def remarks(self) -> list[str]:
        """Remarks on what of the song is not played."""
        return list(self.settings.get("remarks", ()))

    @property
    def losses(self) -> list[dict[str, Any]]:
        """The misses as `misses.json` has them."""
        return [asdict(miss) | {"finger": finger_number(miss.finger)} for miss in self.misses or ()]

    @property
    def seconds(self) -> float:
        """Length of the music that was played [s]; less than all if the episode ended early."""
        return self.episode.num_steps * self.episode.dt

    def save(
        self, folder: str | Path, progress: Progress = silent, page: bool = True, voice: Tone = tone
    ) -> None:
        """Write what `cadenza play` leaves: report.html, metrics.json, episode.npz and so on.

        Args:
            folder: files of an earlier performance are replaced.
            progress: is called with how far each stage is.
            page: report.html too.
            voice: what makes the notes of its sound; the built-in piano unless it is another.
        """
        folder, played = Path(folder), self.played
        write_json(folder / "settings.json", self.settings)  # first, see `check_replaceable`
        for name in _REPLACED:
            (folder / name).unlink(missing_ok=True)
        self.episode.save(folder / "episode.npz")
        for side, part in hand_episodes(self.episode, self.scene).items():
            part.save(folder / f"episode-{side}.npz")
        write_json(folder / "metrics.json", self.metrics)
        if self.misses is not None:
            write_json(folder / "misses.json", self.losses)
        if self.fates is not None:
            write_json(folder / "arrangement.json", [fate.as_json for fate in self.fates])
        sheet = replace(self.goal, notes=played.notes, pedal=played.pedal)
        write_midi_sheet(sheet, folder / "played.mid")
        write_midi_sheet(self.goal, folder / "wanted.mid")
        if page:
            progress("making the sound", 0, 1)
            write_page(folder / "report.html", self._page(folder, voice))

    def _page(self, folder: Path, voice: Tone) -> Iterator[str]:
        """The page, see `performance_page`, with the MIDI files in the folder."""
        seconds, written = self.seconds, self.fingered_goal.until(self.seconds)
        return performance_page(
            self.episode,
            plain(self.metrics),
            plain(self.settings),
            synthesize(self.played, voice),
            verdict=self.verdict,
            misses=plain(self.losses),
            arrangement=[plain(fate.as_json) for fate in self.fates or ()],
            goal_sound=encode_opus(synthesize(written, voice), mono=True, seconds=seconds),
            midi=content_of(folder / "played.mid"),
            goal_midi=content_of(folder / "wanted.mid"),
            written=self.fingered_goal,
        )


def check_replaceable(folder: Path, song: str | Path | None = None) -> None:
    """Check the folder to which results will be written before a song is played.

    Raises CadenzaError if they would replace the song, or files that no performance has left there.
    """
    existing = [name for name in RESULTS if (folder / name).exists()]
    for name in existing:
        if song is not None and Path(song).exists() and (folder / name).samefile(song):
            raise CadenzaError(
                f"{song}: would be replaced by what is played; choose another folder with --output"
            )
    if existing and not _are_results(folder):
        raise CadenzaError(
            f"{folder}: holds {', '.join(existing)} from something else; choose another folder "
            "with --output"
        )


def _are_results(folder: Path) -> bool:
    try:
        settings = read_json(folder / "settings.json", dict[str, Any])
    except CadenzaError:
        return False
    return {"song", "agent", "task", "scene"} <= settings.keys()


def play(
    song: SomeSong | None = None,
    agent: SomeAgent | None = None,
    seed: int = 0,
    *,
    task: TaskConfig | None = None,
    scene: SceneConfig | None = None,
    setup: str | None = None,
    plan: str | Path | None = None,
    progress: Progress = silent,
    num_threads: int | None = None,
) -> Performance:
    """Play a song with an agent, as `cadenza play` does::

        performance = cadenza.play("OdeToJoy")
        print(performance.metrics["f1"])
        performance.save("played/joy")

    Raises CadenzaError if the song or the agent is not there, an option makes no sense, or they do
    not go together.

    Args:
        song: the name of a piece (see `cadenza.songs`), the path of a MIDI or MusicXML file, a
            `Song` or a `Score`. None is the song that the agent has learnt or practised.
        agent: a name of `cadenza.agents.registry`; the folder of a policy, of a training run or of
            practice; "hub:OWNER/NAME"; "module:Class"; a `LearntPolicy`; or an `Agent`, such as a
            planner with options, `make_agent("planner", config)`. None is the planner.
        seed: of everything random; the same seed plays the same.
        task: what is played, observed and rewarded. None is what the policy was trained with, and
            for other agents `TaskConfig()`.
        scene: hands and keys; None is what the policy was trained with, or `SceneConfig()`.
        setup: the name of a setup, such as "allegro", in place of a scene; its agent plays unless
            one is given, in its task unless one is given.
        plan: the file whose actions "playback" plays: a plan or an episode.
        progress: is called with how far each stage is, `progress(stage, done, total)`.
        num_threads: how many threads a planner uses, by default two, one for each hand; it plays
            the same.
    """
    named = NamedSetup() if setup is None else setup_named(setup)
    if setup is not None and scene is not None:
        raise CadenzaError(f"setup {setup} has a scene of its own: give a setup or a scene")
    player = find_player(named.agent if agent is None else agent, song, plan=plan)
    player = named.applied_to(player).playing_in(task, scene)
    with set_up(song, player, seed=seed, num_threads=num_threads, progress=progress) as ready:
        return perform(ready, progress)


def perform(
    setup: Setup, progress: Progress = silent, stop: Callable[[], bool] = lambda: False
) -> Performance:
    """Play one episode, up to the step after which `stop` is true.

    Raises CadenzaError if the agent cannot play this task, or the seed is negative.
    """
    result = play_episode(setup.task, setup.agent, setup.seed, progress, stop)
    plan, settings, played = result.plan, setup.settings, result.episode.num_steps
    if played < setup.num_steps:
        part = f"{played * result.episode.dt:.1f} of {setup.num_steps * result.episode.dt:.1f} s"
        settings = settings | {"notices": [f"It ended after {part}; all here is about that part."]}
    metrics = result.metrics | {"energy": _energy(result.metrics, setup.task.config)}
    arrangement, fates = setup.arrangement, None
    if arrangement is not None:
        track = setup.task.tracks[0]
        metrics = metrics | arrangement.metrics(result.episode, track)
        fates = list(arrangement.fates(track))
    misses = None if plan is None else misses_of(result.episode, plan)
    num_notes = len(key_runs(result.episode["goal_keys"])[0])
    tip = advice(misses or (), num_notes, metrics["f1"], settings, arrangement is not None)
    if tip:
        settings = settings | {"notices": [*settings.get("notices", ()), f"{tip}."]}
    return Performance(
        score=setup.score,
        goal=setup.task.score(0),
        episode=result.episode,
        metrics=metrics,
        settings=settings,
        scene=setup.task.scene,
        track=None if plan is None else plan.track,
        misses=misses,
        fates=fates,
        advice=tip,
    )


def _energy(metrics: Mapping[str, Any], task: TaskConfig) -> float | None:
    cost, weight = metrics.get("reward/energy"), task.energy_coefficient
    return None if cost is None or not weight else float(-cost / weight * task.control_timestep)


def hand_episodes(episode: Episode, scene: Scene) -> dict[Side, Episode]:
    """Side -> the episode of that hand in its own scene; empty if hands play together."""
    apart = f"{SIDES[0]}_key_qpos" in episode.arrays
    return {side: _hand_episode(episode, scene, side) for side in scene.sides} if apart else {}


def _hand_episode(episode: Episode, scene: Scene, side: Side) -> Episode:
    alone, servos, joints = hand_alone(scene, side)
    hand, key_qpos = scene.fingers.of_hand(SIDES.index(side)), episode[f"{side}_key_qpos"]
    number = episode["goal_fingers"]
    is_own = (number >= hand.start) & (number < hand.stop)
    tips = np.zeros_like(episode["fingertip_xpos"])
    tips[:, hand] = episode["fingertip_xpos"][:, hand]
    hand_qpos = episode["hand_qpos"][:, joints]
    xpos, xquat = body_poses(alone, hand_qpos)
    pedal = episode["action"].shape[1] - 1
    actions = np.r_[servos, pedal]
    arrays = {
        "action": episode["action"][:, actions],
        "action_min": episode["action_min"][actions],
        "action_max": episode["action_max"][actions],
        "actuator_names": episode["actuator_names"][servos],
        "hand_joint_names": episode["hand_joint_names"][joints],
        "hand_qpos0": episode["hand_qpos0"][joints],
        "hand_qpos": hand_qpos,
        "hand_qvel": episode["hand_qvel"][:, joints],
        "fingertip_xpos": tips,
        "key_qpos": key_qpos,
        "key_activation": key_activation(key_qpos, scene.keyboard.sounds_from),
        "sustain_activation": episode["sustain_activation"],
        "goal_keys": episode["goal_keys"] & is_own,
        "goal_fingers": np.where(is_own, number, np.int8(NO_FINGER)),
        "goal_sustain": episode["goal_sustain"],
        "lowest_pitch": episode["lowest_pitch"],
        "body_xpos": xpos,
        "body_xquat": xquat,
        **{name: episode[f"{side}_{name}"] for name in KEY_EVENTS},
    }
    return Episode(f"{episode.song} ({side} hand)", episode.dt, arrays, drawing(alone))
