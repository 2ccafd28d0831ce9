"""Bars, against the times at which mido plays what begins with them."""

import json
from dataclasses import asdict, replace
from itertools import pairwise

import mido
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.files import parsed_json
from cadenza.music.etudes.library import KINDS, make_etude
from cadenza.music.formats.midi import read_midi
from cadenza.music.formats.reading import read_score
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Bar, Note, Score, bar_at, describe_times
from musicxml_documents import AGAIN, FOUR_QUARTERS, document, note, tempo

TICKS = 96  # a quarter: a 64th is a whole number of them
METRES = st.tuples(st.integers(1, 12), st.sampled_from([1, 2, 4, 8, 16, 32, 64]), st.integers(1, 4))
TEMPOS = st.tuples(st.integers(0, 2000), st.integers(100_000, 2_000_000))

THREE = Score(
    tuple(Note(i, i + 0.5, 60) for i in range(6)), bars=tuple(Bar(2.0 * i, i + 1) for i in range(3))
)


def saved(path, metres, tempos=()):
    """A file in which a note of a tick begins with every bar; metres are said in another track."""
    meta, note = mido.MetaMessage, mido.Message
    changes, strikes, tick = [], [], 0
    for beats, unit, bars in metres:
        change = meta("time_signature", numerator=beats, denominator=unit)
        changes.append((tick, change))
        for _ in range(bars):
            strikes += [(tick, note("note_on", note=60)), (tick + 1, note("note_off", note=60))]
            tick += 4 * TICKS * beats // unit
    changes += [(at, meta("set_tempo", tempo=tempo)) for at, tempo in tempos]
    file = mido.MidiFile(ticks_per_beat=TICKS)
    for timed in sorted(changes, key=lambda change: change[0]), strikes:
        ticks = [0, *(at for at, _ in timed)]
        track = (m.copy(time=b - a) for (a, b), (_, m) in zip(pairwise(ticks), timed, strict=True))
        file.tracks.append(mido.MidiTrack(track))
    file.save(path)
    return path


def struck_by_mido(path):
    now, struck = 0.0, []
    for message in mido.MidiFile(path):
        now += message.time
        if message.type == "note_on":
            struck.append(now)
    return struck


@given(st.lists(METRES, min_size=1, max_size=4), st.lists(TEMPOS, max_size=3))
def test_bars_begin_where_time_signatures_and_tempos_say(tmp_path_factory, metres, tempos):
    path = saved(tmp_path_factory.mktemp("bars") / "song.mid", metres, tempos)
    bars = read_midi(path).bars
    assert [bar.time for bar in bars] == pytest.approx(struck_by_mido(path), abs=1e-6)
    assert [bar.number for bar in bars] == list(range(1, 1 + sum(n for _, _, n in metres)))


@given(st.lists(METRES, min_size=1, max_size=4), st.lists(TEMPOS, max_size=3))
def test_beats_begin_where_bars_of_a_beat_would(tmp_path_factory, metres, tempos):
    folder = tmp_path_factory.mktemp("bars")
    bars = read_midi(saved(folder / "song.mid", metres, tempos)).bars
    beats = [(1, unit, count * beats) for beats, unit, count in metres]
    struck = struck_by_mido(saved(folder / "beats.mid", beats, tempos))
    assert [beat for bar in bars for beat in bar.beats] == pytest.approx(struck, abs=1e-6)
    assert [(len(bar.beats), bar.beat_type) for bar in bars] == [
        (beats, unit) for beats, unit, count in metres for _ in range(count)
    ]


@given(
    st.lists(METRES, min_size=1, max_size=3),
    st.floats(0.2, 5),
    st.integers(-12, 12),
    st.floats(0, 3),
    st.floats(0.5, 20),
)
def test_bars_go_along_with_their_notes(
    tmp_path_factory, metres, factor, semitones, silence, seconds
):
    score = read_midi(saved(tmp_path_factory.mktemp("bars") / "song.mid", metres))
    moved = score.with_initial_silence(1.0).beginning(seconds).with_silence_trimmed()
    moved = moved.stretched(factor).transposed(semitones).with_initial_silence(silence).mirrored
    assert [bar.time for bar in moved.bars] == pytest.approx([n.start for n in moved.notes])
    assert [bar.beats[0] for bar in moved.bars] == [bar.time for bar in moved.bars]
    assert [bar_at(moved, note.start) for note in moved.notes] == [
        bar.number for bar in score.bars[: len(moved.notes)]
    ]


def test_files_without_a_metre_have_no_bars(tmp_path):
    assert read_midi(saved(tmp_path / "song.mid", [(4, 4, 2)])).bars
    file = mido.MidiFile(tmp_path / "song.mid")
    del file.tracks[0]
    file.save(tmp_path / "song.mid")
    assert read_midi(tmp_path / "song.mid").bars == ()
    # 25 frames of 4 ticks a second: no beats, and so no bars.
    file = mido.MidiFile(saved(tmp_path / "song.mid", [(4, 4, 2)]), clip=True)
    data = bytearray((tmp_path / "song.mid").read_bytes())
    data[12:14] = bytes([256 - 25, 4])
    (tmp_path / "song.mid").write_bytes(data)
    assert read_midi(tmp_path / "song.mid").bars == ()


@pytest.mark.parametrize("metre", [(0, 4, 0), (1, 2**20, 0)])
def test_impossible_metres_are_ignored(tmp_path, metre):
    path = saved(tmp_path / "song.mid", [(1, 4, 2), metre])
    assert [bar.time for bar in read_midi(path).bars] == pytest.approx(struck_by_mido(path))


def test_a_song_of_a_million_bars_has_none(tmp_path):
    path = saved(tmp_path / "song.mid", [(1, 64, 1)], [(0, 1)])
    file = mido.MidiFile(path)
    later = 64 * 10**6
    file.tracks[1].append(mido.Message("note_on", note=64, time=later))
    file.tracks[1].append(mido.Message("note_off", note=64, time=96))
    file.save(path)
    assert read_midi(path).bars == ()


def test_bars_of_musicxml_have_their_printed_numbers_and_are_repeated(tmp_path):
    first = FOUR_QUARTERS.replace("<beats>4", "<beats>3") + tempo(90) + note("C4", 12)
    text = document([first, note("C4", 12) + AGAIN, note("C4", 12)])
    for number in 3, 2, 1:
        text = text.replace(f'measure number="{number}"', f'measure number="{number + 6}"')
    (tmp_path / "song.musicxml").write_text(text)
    score = read_score(tmp_path / "song.musicxml")
    assert [bar.number for bar in score.bars] == [7, 8, 7, 8, 9]
    assert [bar.time for bar in score.bars] == pytest.approx([0, 2, 4, 6, 8])
    assert score.bars[1].beats == pytest.approx([2, 2 + 2 / 3, 2 + 4 / 3])


def test_bars_that_are_not_counted_have_the_number_of_the_bar_before(tmp_path):
    text = document([FOUR_QUARTERS + note("C4", 16), *[note("C4", 16)] * 4])
    for number, printed in enumerate(("7", "X1", "8", "8a", "-1"), start=1):
        text = text.replace(f'measure number="{number}"', f'measure number="={printed}"')
    (tmp_path / "song.musicxml").write_text(text.replace('"=', '"'))
    assert [bar.number for bar in read_score(tmp_path / "song.musicxml").bars] == [7, 7, 8, 8, 8]


def test_a_bar_that_its_beats_do_not_fill_has_finer_ones(tmp_path):
    first = FOUR_QUARTERS.replace("<beats>4", "<beats>3") + note("C4", 2)
    text = document([first, note("C4", 12)]).replace('number="1"', 'number="0"')
    (tmp_path / "song.musicxml").write_text(text)
    pickup, first_bar = read_score(tmp_path / "song.musicxml").bars
    assert (pickup.beats, pickup.beat_type) == ((0.0,), 8)
    assert (first_bar.beats, first_bar.beat_type) == ((0.25, 0.75, 1.25), 4)


def test_bars_of_midi_have_the_key_signatures_of_the_file(tmp_path):
    path = saved(tmp_path / "song.mid", [(4, 4, 4)])
    assert [bar.key for bar in read_midi(path).bars] == [None] * 4
    file = mido.MidiFile(path)
    for key, ticks in ("C", 0), ("Fm", 2 * 4 * TICKS):
        file.tracks.append(mido.MidiTrack([mido.MetaMessage("key_signature", key=key, time=ticks)]))
    file.save(path)
    score = read_midi(path)
    assert [bar.key for bar in score.bars] == [0, 0, -4, -4]
    assert [bar.key for bar in score.transposed(-1).bars] == [5, 5, 1, 1]
    assert [bar.key for bar in score.transposed(12).mirrored.bars] == [0, 0, 4, 4]


def test_a_midi_file_that_only_says_c_major_may_say_nothing(tmp_path):
    path = saved(tmp_path / "song.mid", [(4, 4, 1)])
    file = mido.MidiFile(path)
    file.tracks[0].insert(0, mido.MetaMessage("key_signature", key="C"))
    file.save(path)
    assert [bar.key for bar in read_midi(path).bars] == [None]


def test_bars_of_musicxml_have_their_keys_at_concert_pitch(tmp_path):
    clarinet = FOUR_QUARTERS.replace("<time>", "<key><fifths>2</fifths></key><time>").replace(
        "</attributes>", "<transpose><chromatic>-2</chromatic></transpose></attributes>"
    )
    change = "<attributes><key><fifths>-3</fifths></key></attributes>"
    music = document([clarinet + note("D4", 16), note("D4", 16) + change, note("D4", 16)])
    (tmp_path / "song.musicxml").write_text(music)
    assert [bar.key for bar in read_score(tmp_path / "song.musicxml").bars] == [0, 0, -5]


@pytest.mark.parametrize("kind", KINDS)
def test_etudes_have_bars_up_to_their_last_note(kind):
    score = make_etude(kind, 4, 1)
    times = [bar.time for bar in score.bars]
    assert score.bars[0].beats[:2] == (0.0, pytest.approx(times[1] / len(score.bars[0].beats)))
    assert score.bars[0].number == 1
    assert np.diff(times) == pytest.approx(times[1])
    assert times[-1] <= max(note.start for note in score.notes) < times[-1] + times[1]


def test_bars_are_kept_by_saved_scores_and_do_not_make_them_differ():
    written = parsed_json(json.dumps(asdict(WrittenScore.of(THREE))), WrittenScore, "file")
    assert written.score.bars == THREE.bars
    assert replace(THREE, bars=()) == THREE


def test_times_must_be_finite():
    for times in (float("nan"), ()), (0.0, (0.0, float("inf"))):
        with pytest.raises(CadenzaError, match="finite"):
            Bar(times[0], 1, times[1])
    with pytest.raises(CadenzaError, match="whole note"):
        Bar(0.0, 1, (0.0,), beat_type=0)


@pytest.mark.parametrize(
    ("times", "expected"),
    [([2.0], "bar 2"), ([0.0, 3.9], "bars 1-2"), ([5, 0.5, 4.5], "bars 1, 3")],
)
def test_places_are_said_as_musicians_do(times, expected):
    assert describe_times(THREE, times) == expected


def test_without_bars_places_are_said_in_seconds():
    assert describe_times(replace(THREE, bars=()), [4.5, 1]) == "1.0, 4.5 s"


def test_the_silence_before_a_song_belongs_to_its_first_bar():
    later = THREE.with_initial_silence(0.5)
    assert describe_times(later, [0.2, 0.5, 2.4]) == "bar 1"
    assert describe_times(later, [2.5]) == "bar 2"
