"""Arranges songs that the hands of a scene cannot play as written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from cadenza.arranging.arranger import Arranged, Arranger
from cadenza.episode import Episode
from cadenza.fingering.search import find_fingering
from cadenza.music.arrangement import Arrangement
from cadenza.music.expressive_metrics import expressive_metrics
from cadenza.music.metrics import step_metrics
from cadenza.music.performance import played_in
from cadenza.music.score import Note, Score
from cadenza.scene.scene import Scene
from cadenza.tasks.goal_track import GoalTrack, players_of

_MOST_LEFT_OUT = 0.1  # share of the notes that hands may leave out of music for one instrument
_MOST_LEFT_OUT_OF_SEVERAL = 0.01  # the same of music for several
_TWO_HANDS = 2  # tracks of one player


@dataclass(frozen=True)
class HandArrangement:
    """A song as it was arranged for hands, and the song itself."""

    original: Score
    arranged: Arranged

    def __str__(self) -> str:
        """What was done, in words."""
        return f"arranged for the hands: {self.arranged.fidelity}; as written: --arrange off"

    def metrics(self, episode: Episode, track: GoalTrack) -> dict[str, Any]:
        """Metrics of the arrangement, and of what was played against the original.

        Args:
            episode: what was played.
            track: the goals of the episode, of the arranged song.
        """
        original = replace(track, score=Score(tuple(self._on_clock(track))), dropped=())
        steps = min(episode.num_steps, original.goals.num_steps)
        keys, wanted = episode["key_activation"][:steps], original.goals.keys[:steps]
        written = original.delayed_score.until(episode.num_steps * episode.dt)
        onsets = expressive_metrics(played_in(episode), written)["note_onset_f1"]
        return {
            **asdict(self.arranged.fidelity),
            "arranged_grade": self.arranged.grade,
            "original_f1": float(step_metrics(keys, wanted)[2].mean()),
            "original_note_onset_f1": onsets,
        }

    def _on_clock(self, track: GoalTrack) -> Iterator[Note]:
        """Yields the notes of the original that the keyboard has, on the clock of the track."""
        mine, clock = self.arranged.score, track.score
        first, begins = mine.notes[0], clock.notes[0]
        stretch = (clock.total_time - begins.start) / (mine.total_time - first.start)
        for note in self.original.notes:
            start = begins.start + (note.start - first.start) * stretch
            end = begins.start + (note.end - first.start) * stretch
            pitch = note.pitch + begins.pitch - first.pitch
            if start >= 0 and pitch in track.scene.keyboard.pitches:
                yield Note(start, end, pitch, note.velocity)


def arranged_for(score: Score, arrangement: Arrangement, scene: Scene) -> HandArrangement | None:
    """The arrangement of a song for the hands of a scene; None if it is to be played as written.

    That is so with `arrange="off"`, and with "auto" where the hands leave out few notes.
    """
    if arrangement.arrange == "off" or not scene.sides or not score.notes:
        return None
    wanted = arrangement.arrange == "always" or arrangement.level is not None
    if not wanted and _is_playable(score, scene):
        return None
    arranger = Arranger(players_of(scene), scene.hand.jump_times)
    if arrangement.level is None:
        return HandArrangement(score, arranger.arrange(score))
    return HandArrangement(score, arranger.arrange(score, float(arrangement.level)))


def _is_playable(score: Score, scene: Scene) -> bool:
    """Whether hands leave out few notes of a song."""
    several = len({number for note in score.notes for number in note.tracks}) > _TWO_HANDS
    most = _MOST_LEFT_OUT_OF_SEVERAL if several else _MOST_LEFT_OUT
    _, dropped = find_fingering(score, players_of(scene))
    return len(dropped) <= most * len(score.notes)
