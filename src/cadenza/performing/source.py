"""Finds the song that a word names: a piece, a file, or the folder of a policy or of practice."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

from cadenza.agents.playback import SavedPlan, load_plan
from cadenza.configs import as_config
from cadenza.errors import CadenzaError, CadenzaWarning
from cadenza.files import TENSORS
from cadenza.hub import fetched, is_on_hub
from cadenza.learning.policy_folder import (
    POLICY,
    POLICY_FILE,
    LearntPolicy,
    check_is_no_run,
    load_policy,
)
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.reading import name_without_ending
from cadenza.music.libraries.bundled import songs
from cadenza.music.libraries.library import check_is_name, find_song
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig, check_modules

PRACTISED = f"plan{TENSORS}"  # what the folder of a song that was practised holds
PRACTICE = f"practice{TENSORS}"  # how far it has been practised
PRACTISED_HOW = "practice.json"  # and in what task and scene
Song = str | Path | Score


@dataclass(frozen=True)
class Source:
    """A song, and what else the word stands for that names it; made once by `resolve`."""

    name: str
    """The word, with the letters of the piece's own name, or the title of a score."""
    score: Score
    arrangement: Arrangement = field(default_factory=Arrangement)
    """The part of the song that the score has."""
    written: Score | None = None
    """The whole song without the expression that its score has, if that has any."""
    policy: LearntPolicy | None = None
    """The policy that has learnt the song, if the word is its folder."""
    practised: SavedPlan | None = None
    """The plan that practice made, if the word is the folder of a practised song."""

    @property
    def short_name(self) -> str:
        """The name without folders and ending; for a folder of a policy or practice, its title."""
        own_folder = self.policy is not None or self.practised is not None
        return self.score.title if own_folder else name_without_ending(self.name)

    def titled(self, title: str) -> Source:
        """The song under another title."""
        whole = self.written and replace(self.written, title=title)
        return replace(self, name=title, score=replace(self.score, title=title), written=whole)

    def written_for(self, hands: str) -> Source:
        """The song with the notes that are written for these hands, see `Arrangement.written_for`.

        Raises:
            CadenzaError: nothing is written for the one hand that plays.
        """
        mine = self.arrangement.written_for(hands, self.score)
        whole = self.written and self.arrangement.written_for(hands, self.written)
        return replace(self, score=mine, written=whole)


def resolve(song: Song, arrangement: Arrangement | None = None) -> Source:
    """Loads what a word stands for that names a song; what was repaired in it is a warning.

    Args:
        song: see `load_song`, or a score.
        arrangement: which notes of it; all by default. A score is then played as written.

    Raises:
        CadenzaError: there is no such song, or it cannot be read; it is the folder of a policy that
            plays any song, or of practice that was killed before it had a plan.
    """
    if arrangement is None and isinstance(song, Score):
        arrangement = Arrangement(arrange="off")
    arrangement = as_config(arrangement, Arrangement)
    if isinstance(song, Score):
        return Source(song.title, song, arrangement)
    check_is_name(song)
    if is_own_folder(song):
        return _own_song(Path(song), str(song), arrangement)
    whole = arrangement.whole(str(song))
    score = arrangement.performed(whole, str(song))
    written = whole if arrangement.expression else None
    for remark in score.remarks:
        warnings.warn(f"{song}: {remark}", CadenzaWarning, stacklevel=3)
    return Source(find_song(song).name, score, arrangement, written)


def load_song(song: str | Path, arrangement: Arrangement | None = None) -> Score:
    """Loads the score that a name or a path stands for; what was repaired in it is a warning.

    Args:
        song: a bundled song, see `cadenza.songs`; the path of a MIDI or MusicXML file; or the
            folder of a policy or of a practised song, which hold theirs; a policy may lie on the
            hub, as ``hub:OWNER/NAME``. A folder of the same name as a bundled song wants a path
            with a separator, such as ``./OdeToJoy``.
        arrangement: which notes of it; all by default.

    Raises:
        CadenzaError: there is no such song, or it cannot be read.
    """
    check_is_name(song)
    return resolve(song, arrangement).score


def is_own_folder(song: str | Path) -> bool:
    """Returns whether a song is named by the folder of a policy or of practice, which has it.

    A policy may lie on the hub, see `cadenza.hub`.
    """
    text = str(song)
    bundled = text.lower() in {piece.name.lower() for piece in songs()}
    folder = os.path.isdir(song) or is_on_hub(song)
    return folder and not (bundled and isinstance(song, str))


def _own_song(folder: Path, name: str, arrangement: Arrangement) -> Source:
    """Loads the folder of a policy or of a practised song."""
    folder = fetched(folder, POLICY)
    if arrangement.chosen:
        raise CadenzaError(
            f"{name}: plays its song as it was trained or practised; leave out --tracks, "
            "--plain, --arrange, --level, --drums, --first-seconds and --expression"
        )
    if (path := folder / PRACTISED).is_file():
        plan = load_plan(path)
        if plan.practised is None or plan.score is None:
            raise CadenzaError(f"{path}: holds no song that was practised; use another copy")
        check_modules(plan.config(SceneConfig), path)
        return Source(name, plan.score, plan.config(Arrangement), practised=plan)
    if any((folder / name).is_file() for name in (PRACTICE, PRACTISED_HOW)):
        raise CadenzaError(
            f"{name}: practice has not played the song to the end yet; run the same command again "
            "that practised there"
        )
    if not (folder / POLICY_FILE).is_file():
        check_is_no_run(folder)
        raise CadenzaError(
            f"{name}: is a folder, but not of a policy or of practice; give a music file"
        )
    policy = load_policy(folder)
    if policy.score is None:
        raise CadenzaError(f"{name}: plays any song; name one: cadenza play SONG --agent {name}")
    return Source(name, policy.score, policy=policy)
