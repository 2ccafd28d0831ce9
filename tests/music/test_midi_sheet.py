"""Sheet music as MIDI: mido plays it in time, and finds the metre, the keys and the tempos."""

from dataclasses import replace

import mido
import pytest

from cadenza.cli import main
from cadenza.music.formats.midi import read_midi
from cadenza.music.formats.midi_sheet import write_midi_sheet
from cadenza.music.formats.musicxml_writing import write_musicxml
from cadenza.music.formats.reading import read_score
from cadenza.music.score import Bar, Note, PedalEvent, Score

HALF_A_TICK = 0.6 / 31_920 / 2  # [s] at the slowest tempo
# An upbeat, a bar at 120 quarters a minute, and one at 100 and in another key.
BARS = (
    Bar(0.0, 0, (0.0,), key=-3),
    Bar(0.5, 1, (0.5, 1.0, 1.5), key=-3),
    Bar(2.0, 2, (2.0, 2.6, 3.2), key=2),
)
NOTES = tuple(Note(t, t + 0.31, 60) for t in (0.0, 0.5, 1.017, 1.5, 2.0, 2.61, 3.2))
SONG = Score(NOTES, (PedalEvent(0.6, 127), PedalEvent(1.9, 0)), "Song", bars=BARS)


def signs(path, kind):
    """What messages of a kind say, and when mido plays them [s]."""
    now, notes = 0.0, []
    for message in mido.MidiFile(path):
        now += message.time
        if message.type == kind:
            notes.append((round(now, 3), {**message.dict()} | {"time": 0}))
    return notes


def test_a_song_keeps_its_metre_its_keys_and_its_tempos(tmp_path):
    write_midi_sheet(SONG, tmp_path / "song.mid")
    tempos = signs(tmp_path / "song.mid", "set_tempo")
    assert [(at, each["tempo"]) for at, each in tempos] == [(0.0, 500_000), (2.0, 600_000)]
    metres = signs(tmp_path / "song.mid", "time_signature")
    signatures = [(at, each["numerator"], each["denominator"]) for at, each in metres]
    assert signatures == [(0.0, 1, 4), (0.5, 3, 4)]
    keys = signs(tmp_path / "song.mid", "key_signature")
    assert [(at, each["key"]) for at, each in keys] == [(0.0, "Eb"), (2.0, "D")]
    again = read_midi(tmp_path / "song.mid")
    assert [bar.key for bar in again.bars] == [-3, -3, 2]


def test_words_of_tempo_are_on_the_sheet_and_play_nothing(tmp_path):
    marks = {"Andante con moto": 0.0, "poco rit.": 1.0, "a tempo": 2.0}
    words = (((time, text),) for text, time in marks.items())
    bars = (replace(bar, words=each) for bar, each in zip(BARS, words, strict=True))
    song = replace(SONG, bars=tuple(bars))
    write_midi_sheet(song, tmp_path / "song.mid")
    file = mido.MidiFile(tmp_path / "song.mid")
    credit = "Sonatina Allegro, sequenced by a pianist in 1999"
    file.tracks[0].insert(1, mido.MetaMessage("text", text=credit))
    file.tracks[0].insert(1, mido.MetaMessage("marker", text="Intro"))
    file.save(tmp_path / "song.mid")
    write_musicxml(song, tmp_path / "song.musicxml")
    for name in ("song.mid", "song.musicxml"):
        again = read_score(tmp_path / name)
        words = {text: time for bar in again.bars for time, text in bar.words}
        assert words == pytest.approx(marks, abs=1e-3)
        assert [n.start for n in again.notes] == pytest.approx([n.start for n in NOTES], abs=0.02)


def test_what_is_sung_is_no_word_of_tempo(tmp_path):
    write_midi_sheet(SONG, tmp_path / "song.mid")
    file = mido.MidiFile(tmp_path / "song.mid")
    for text in ("presto", "/Allegro ", "@KMIDI KARAOKE FILE"):
        file.tracks[1].insert(0, mido.MetaMessage("text", text=text))
    file.tracks[1].insert(0, mido.MetaMessage("marker", text="Adagio"))
    file.save(tmp_path / "song.mid")
    assert next(bar.words for bar in read_midi(tmp_path / "song.mid").bars) == ((0.0, "Adagio"),)


@pytest.mark.parametrize("later", [-0.7, -1e-10, 0.0, 0.3])
def test_all_times_are_kept_wherever_the_bars_begin(later, tmp_path):
    moved = replace(SONG, bars=tuple(bar.moved(lambda time: time + later) for bar in BARS))
    write_midi_sheet(moved, tmp_path / "song.mid")
    again = read_midi(tmp_path / "song.mid")
    assert again.title == "Song"
    for before, after in zip(SONG.notes, again.notes, strict=True):
        assert after.start == pytest.approx(before.start, abs=HALF_A_TICK)
        assert after.end == pytest.approx(before.end, abs=HALF_A_TICK)
    for move, read in zip(SONG.pedal, again.pedal, strict=True):
        assert read.time == pytest.approx(move.time, abs=HALF_A_TICK)
    begins = [bar.time for bar in moved.bars if bar.time >= -HALF_A_TICK]
    times = [bar.time for bar in again.bars]
    assert [min(times, key=lambda at: abs(at - time)) for time in begins] == pytest.approx(
        begins, abs=HALF_A_TICK
    )


def test_an_arrangement_of_fur_elise_is_in_three_eight(tmp_path):
    main(["arrange", "FurEliseOpening", "-o", str(tmp_path / "elise.mid")])
    ((_, upbeat), (at, metre)) = signs(tmp_path / "elise.mid", "time_signature")
    assert (upbeat["numerator"], upbeat["denominator"]) == (1, 8)
    assert (at, metre["numerator"], metre["denominator"]) == (0.4, 3, 8)
    ((_, tempo),) = signs(tmp_path / "elise.mid", "set_tempo")
    assert mido.tempo2bpm(tempo["tempo"]) == 75
