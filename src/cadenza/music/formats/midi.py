"""Standard MIDI files: reading with repair, and writing."""

from __future__ import annotations

import sys
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from operator import attrgetter, itemgetter
from pathlib import Path

import mido

from cadenza.errors import CadenzaError, errors_in
from cadenza.files import write_atomically
from cadenza.music.formats.midi_messages import (
    INSTRUMENTS,
    KEY,
    LONGEST,
    MARKER,
    METRE,
    NAME,
    NOTE_ON,
    SUSTAIN,
    TEMPO,
    TEXT,
    Message,
    MidiFile,
    parsed,
)
from cadenza.music.formats.midi_playing import Channel, Part, Playing
from cadenza.music.formats.source import printable, read_bytes, title_of
from cadenza.music.repair import merged_pedal, repaired_notes
from cadenza.music.score import (
    BEAT_TYPES,
    MAX_SIGNS,
    Bar,
    Note,
    PedalEvent,
    Score,
    Track,
    check_chosen,
)
from cadenza.music.signs.tempo_map import is_of_tempo
from cadenza.music.written_hands import names_only_a_part

# What is written: at 120 quarters a minute 48,000 ticks a second, in which both 1 ms and thirds of
# a second are whole numbers. A time read back differs by at most half a tick (10.4 us).
_TICKS_PER_QUARTER = 24_000
_TICKS_PER_SECOND = 2 * _TICKS_PER_QUARTER

_DEFAULT_TEMPO = 500_000  # [us] per quarter, until the file says otherwise
_PUNCTUATION = "‘’“”–—…"
_MAX_BARS, _MAX_BEATS = 20_000, 100_000  # more are taken for damage


def read_midi(path: str | Path, tracks: Collection[int] = ()) -> Score:
    """The piano score in a Standard MIDI file (format 0, 1 or 2), bare or wrapped in RIFF (RMID).

    All instruments but the drums are played together, or only `tracks`, by their numbers in
    `Score.tracks`: a track is what one channel of a port plays in one track of the file. Drums are
    on channel 10, if it is in no MPE zone, and where a bank of sounds of General MIDI 2 or Yamaha
    XG, or a message to a Roland or Yamaha synthesizer, says so. Notes are transposed as coarse
    tuning (of a channel, of all, or as key shift of GS or XG) says when they begin, and to the key
    nearest to where the pitch wheel is held; fine tuning is left out.

    Of format 2, whose tracks are songs of their own, the first with notes is read. The sustain
    pedals (controller 64, lifted by 121) of all channels that are played move the one pedal, which
    is as low as that of any of them. A sostenuto pedal (66) holds the notes of its channel that
    sound when it goes down, until it goes up. Times follow the tempo changes, or the SMPTE division
    where the file has one. Bars follow the time signatures, where there are any. Chunks of unknown
    types are skipped. What cannot be played on one piano is repaired, and `Score.remarks` says so:

    - notes outside the 88 keys are left out;
    - notes that end when they start are left out;
    - of equal pitches that start together one is kept, as long and as loud as the longest and
      loudest;
    - a note still sounding when its pitch starts again is cut there, and the new one lasts at least
      as long (a note-off ends the oldest note of its channel and pitch, in its own track if there
      is one);
    - notes while the volume (controllers 7 and 11) of their channel is zero are left out, if they
      are not of chosen tracks;
    - a note that is never released ends with its track, or where all of its channel are ended
      (controllers 120 and 123 to 127);
    - of a track that is cut off, what is whole is read, and one of a wrong length is read to its
      end;
    - velocities, pedals and volumes over 127 are taken for 127, and other settings over 127 are
      left out.

    Raises CadenzaError if the file is not there, no MIDI file or damaged, or has no notes, or not
    one of `tracks`.
    """
    path = Path(path)
    content = read_bytes(path)
    with errors_in(path):
        return score_of(parsed(content), tracks, title_of(path))


def score_of(file: MidiFile, tracks: Collection[int], title: str) -> Score:
    """The score in a file; without a name in it, it has the `title`."""
    remarks, messages = list(file.remarks), file.tracks
    if file.format == 2:
        songs = [track for track in messages if any(each.kind == NOTE_ON for each in track)]
        if len(songs) > 1:
            remarks.append(f"the file holds {len(songs)} separate songs: the first is used")
        messages = songs[:1]

    clock = _Clock.of(file.division, messages)
    playing = Playing(messages, clock.at)
    melodic = [part for part in playing.parts if not part.is_drums]
    listed = _tracks(melodic)
    if tracks:
        check_chosen(tracks, listed)
        parts_with_notes = [part for part in melodic if part.sounds]
        melodic = [parts_with_notes[number - 1] for number in sorted(set(tracks))]
    chosen = {part.channel for part in melodic}
    moves = merged_pedal(move for move in playing.moves if not tracks or move[1] in chosen)
    pedal = tuple(PedalEvent(clock.seconds(time), value) for time, value in moves)

    notes = [note for part in melodic for note in part.notes]
    counts = Counter(
        outside=sum(part.outside for part in melodic), bent=sum(part.bent for part in melodic)
    )
    drums = [part for part in playing.parts if part.is_drums]
    muted = [note for part in melodic for note in part.muted]
    if tracks:
        notes += muted  # which are asked for
    else:
        counts["drums"] = sum(len(part.notes) + len(part.muted) + part.outside for part in drums)
        counts["muted"] = len(muted)
    if playing.soft.intersection(chosen) or (playing.soft and not tracks):
        remarks.append("the soft pedal is left out")
    score_notes, all_remarks = repaired_notes(notes, counts, remarks, clock.seconds)
    bars = _bars(file.division, messages, clock, until=score_notes[-1].start)
    return Score(score_notes, pedal, _title(messages) or title, all_remarks, listed, bars)


_KARAOKE_TITLE, _KARAOKE = "@T", "soft karaoke"
_SUNG = b"@", b"\\", b"/"  # beginnings of karaoke texts, and of lines in them


def _title(tracks: list[list[Message]]) -> str:
    """The title that a file gives: the first of karaoke, else the name of its first track.

    A track that is only called after a hand, or after the makers of karaoke, names no piece.
    """
    texts = (_text(each.data) for track in tracks for each in track if each.kind == TEXT)
    for text in texts:
        if text.startswith(_KARAOKE_TITLE):
            return text.removeprefix(_KARAOKE_TITLE).strip()
    name = next((_text(each.data) for each in tracks[0] if each.kind == NAME), "")
    return "" if names_only_a_part(name) or name.lower() == _KARAOKE else name


def write_midi(score: Score, path: str | Path) -> None:
    """Write notes, pedal and title as a MIDI file of format 0 with 48,000 ticks a second.

    Read back, times are the same to half a tick (10.4 us), pitches, velocities and pedal values
    exactly; a note shorter than a tick lasts one, and of notes of one pitch that are closer than a
    tick each begins a tick after the one before. Fingers are not part of MIDI, see
    `cadenza.music.formats.fingering_file`. Raises CadenzaError if the score is longer than an hour
    and a half.
    """
    last = max((event.time for event in score.pedal), default=0.0)
    if _ticks(max(score.total_time, last)) > LONGEST:
        raise CadenzaError(
            f"{path}: cannot write a song of {max(score.total_time, last) / 60:.4g} minutes, "
            f"the longest is {LONGEST // _TICKS_PER_SECOND // 60}"
        )
    track = mido.MidiTrack(title_messages(score))
    track.append(mido.MetaMessage("set_tempo", tempo=_DEFAULT_TEMPO))
    track += messages(score.notes, score.pedal, _ticks)
    file = mido.MidiFile(type=0, ticks_per_beat=_TICKS_PER_QUARTER, charset="utf-8")
    file.tracks.append(track)
    with write_atomically(Path(path)) as out:
        file.save(file=out)


def title_messages(score: Score) -> list[mido.MetaMessage]:
    """The message that names the song, if it has a title."""
    title = score.title.encode("utf-8", "replace").decode("utf-8")
    return [mido.MetaMessage("track_name", name=title)] if title else []


def messages(
    notes: Iterable[Note], pedal: Iterable[PedalEvent], ticks: Callable[[float], int]
) -> Iterator[mido.Message]:
    """Yield the messages of notes and of the pedal, each with the ticks since the one before.

    `ticks` converts times [s]. At one tick, notes end first, then the pedal moves, then notes
    begin. Notes last a tick or more, and those of one pitch begin a tick apart at least.
    """
    timed: list[tuple[int, int, mido.Message]] = []
    free: dict[int, int] = {}  # from which tick on a note of each pitch can begin
    for note in sorted(notes, key=attrgetter("start")):
        start = max(ticks(note.start), free.get(note.pitch, 0))
        free[note.pitch] = start + 1
        end = max(start + 1, ticks(note.end))
        on = mido.Message("note_on", note=note.pitch, velocity=note.velocity)
        timed += [(start, 2, on), (end, 0, mido.Message("note_off", note=note.pitch))]
    for event in pedal:
        move = mido.Message("control_change", control=SUSTAIN, value=event.value)
        timed.append((ticks(event.time), 1, move))
    last_tick = 0
    for tick, _, message in sorted(timed, key=lambda item: item[:2]):
        yield message.copy(time=tick - last_tick)
        last_tick = tick


@dataclass(frozen=True)
class _Clock:
    """A map from ticks to time in whole numbers, so that tempo changes add no rounding.

    From `ticks[i]`, which is at `units[i]`, every tick lasts `rates[i]` units.
    """

    ticks: list[int]
    units: list[int]
    rates: list[int]
    units_per_second: int

    @classmethod
    def of(cls, division: int, tracks: Iterable[Iterable[Message]]) -> _Clock:
        """The clock of ticks in this division; raises CadenzaError if it is not valid."""
        if division < 0:  # SMPTE: minus the frames a second, and the ticks a frame
            frames, ticks_per_frame = 256 - ((division >> 8) & 0xFF), division & 0xFF
            if frames not in (24, 25, 29, 30) or ticks_per_frame == 0:
                raise CadenzaError("the file's time division is not valid MIDI")
            if frames == 29:  # stands for 30000/1001 frames a second
                return cls([0], [0], [1001], 30_000 * ticks_per_frame)
            return cls([0], [0], [1], frames * ticks_per_frame)
        if division == 0:
            raise CadenzaError("the file's time division is zero, not valid MIDI")
        changes = (each for track in tracks for each in track if each.kind == TEMPO)
        clock = cls([0], [0], [_DEFAULT_TEMPO], division * 1_000_000)
        for change in sorted(changes, key=attrgetter("tick")):
            clock.units.append(clock.at(change.tick))
            clock.ticks.append(change.tick)
            clock.rates.append(int.from_bytes(change.data[:3], "big"))
        return clock

    def at(self, tick: int) -> int:
        i = bisect_right(self.ticks, tick) - 1
        return self.units[i] + (tick - self.ticks[i]) * self.rates[i]

    def seconds(self, units: float) -> float:
        return units / self.units_per_second


def _tracks(parts: Sequence[Part]) -> tuple[Track, ...]:
    """The tracks with notes, numbered, with programs of their own or of their channels."""
    programs: dict[Channel, int] = {}
    for part in parts:
        if part.program is not None:
            programs.setdefault(part.channel, part.program)
    tracks = []
    for number, part in enumerate((part for part in parts if part.sounds), start=1):
        program = programs.get(part.channel, 0) if part.program is None else part.program
        notes = [*part.notes, *part.muted]
        pitches = [note.pitch for note in notes]
        for note in notes:
            note.tracks = (number,)
        about = _text(part.name), INSTRUMENTS[program], part.channel.number + 1
        tracks.append(Track(number, *about, len(pitches), min(pitches), max(pitches)))
    return tuple(tracks)


def _bars(
    division: int, tracks: Sequence[Iterable[Message]], clock: _Clock, until: float
) -> tuple[Bar, ...]:
    """The bars from the first time signature to the time `until` [s], with keys and words of tempo.

    A time signature begins a new bar. There are no bars in SMPTE frames, which have no beats.
    """
    metres: dict[int, tuple[int, int]] = {}  # from which tick on: beats in a bar, type of beat
    for track in tracks:
        for tick, kind, data, _ in track:
            if kind == METRE and 1 << data[1] in BEAT_TYPES:
                metres[tick] = data[0], 1 << data[1]
    bars: list[Bar] = []
    keys, words = _keys(tracks), _words(tracks)
    beats = 0
    begins = sorted(tick for tick, (numerator, _) in metres.items() if numerator > 0)
    for first, end in pairwise([*begins, sys.maxsize]):
        numerator, denominator = metres[first]
        four = 16 * division // denominator  # ticks of four beats, as a 64th may be half a tick
        for n in count(0, numerator):
            ticks = [first + (n + beat) * four // 4 for beat in range(numerator)]
            times = [clock.seconds(clock.at(tick)) for tick in ticks if tick < end]
            if not times or times[0] > until:
                break
            beats += numerator
            if len(bars) == _MAX_BARS or beats > _MAX_BEATS:
                return ()
            known = bisect_right(keys, ticks[0], key=itemgetter(0))
            key = keys[known - 1][1] if known else None
            bar_end = min(end, first + (n + numerator) * four // 4)
            texts = words[bisect_left(words, (ticks[0], "")) : bisect_left(words, (bar_end, ""))]
            timed = tuple((clock.seconds(clock.at(tick)), text) for tick, text in texts)
            bars.append(Bar(times[0], len(bars) + 1, tuple(times), denominator, key, timed))
    return tuple(bars)


def _keys(tracks: Iterable[Iterable[Message]]) -> list[tuple[int, int]]:
    """The key signatures [sharps] by ticks; none where all are C major, as of files without one."""
    signatures = (each for track in tracks for each in track if each.kind == KEY and each.data)
    keys = [(each.tick, int.from_bytes(each.data[:1], signed=True)) for each in signatures]
    valid_keys = sorted((each for each in keys if abs(each[1]) <= MAX_SIGNS), key=itemgetter(0))
    return valid_keys if any(key for _, key in valid_keys) else []


def _words(tracks: Iterable[Iterable[Message]]) -> list[tuple[int, str]]:
    """The words of tempo among markers and texts, but not lyrics, by ticks."""
    events = [each for track in tracks for each in track if each.kind in (TEXT, MARKER)]
    is_sung = any(each.kind == TEXT and each.data.startswith(_SUNG) for each in events)
    texts = {(each.tick, _text(each.data)) for each in events if not is_sung or each.kind == MARKER}
    return sorted(each for each in texts if is_of_tempo(each[1]))


def _text(data: bytes) -> str:
    """The text in a file, printable and on one line; empty if its encoding is not known."""
    try:
        return printable(data.decode("utf-8"))
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
        return printable(text) if _is_western(text) else ""


def _is_western(text: str) -> bool:
    """Whether few letters have accents; bytes of other alphabets seem to have hardly any others."""
    plain = sum(letter.isascii() and letter.isalpha() for letter in text)
    strange = sum(not letter.isascii() and letter not in _PUNCTUATION for letter in text)
    return 2 * strange <= plain


def _ticks(seconds: float) -> int:
    return round(seconds * _TICKS_PER_SECOND)
