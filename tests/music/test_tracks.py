"""Which of a file's tracks are played, and the reduction to melody and bass."""

import mido
import pytest
from hypothesis import given

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.arrangement import Arrangement, melody_and_bass, melody_and_bass_tracks
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, PedalEvent, Score, Track
from music_strategies import scores
from players import find_fingering

QUARTER = 480
PARTS = (  # name, channel, program, pitches of 16 quarters, and how many sound at once
    ("Vocals", 0, 53, [72, 74, 76, 77] * 4, 1),
    ("Bass", 1, 33, [36, 43, 45, 41] * 4, 1),
    ("Guitar", 2, 25, [60, 55, 57, 53] * 4, 3),
    ("Strings", 3, 48, [67, 62, 64, 60] * 4, 3),
    ("Keys", 4, None, [48, 50, 52, 53] * 4, 2),
    ("Drums", 9, None, [36, 42, 38, 42] * 4, 1),
)


def _track(name, channel, program, pitches, at_once):
    track = mido.MidiTrack([mido.MetaMessage("track_name", name=name)])
    if program is not None:
        track.append(mido.Message("program_change", channel=channel, program=program))
    track.append(mido.Message("control_change", channel=channel, control=64, value=100 + channel))
    for pitch in pitches:
        chord = [pitch + 4 * k for k in range(at_once)]
        track += [mido.Message("note_on", channel=channel, note=p) for p in chord]
        for k, p in enumerate(chord):
            off = mido.Message("note_off", channel=channel, note=p, time=0 if k else QUARTER)
            track.append(off)
    return track


@pytest.fixture(params=[0, 1], ids=["format 0", "format 1"])
def pop_song(request, tmp_path):
    file = mido.MidiFile(type=request.param, ticks_per_beat=QUARTER)
    tracks = [mido.MidiTrack([mido.MetaMessage("track_name", name="Pop")])]
    tracks += [_track(*part) for part in PARTS]
    file.tracks += tracks if request.param else [mido.merge_tracks(tracks)]
    file.save(tmp_path / "pop.mid")
    return tmp_path / "pop.mid"


def test_tracks_are_listed_with_their_instruments(pop_song):
    tracks = load_score(pop_song).tracks
    assert [(t.number, t.instrument, t.channel, t.notes, t.lowest, t.highest) for t in tracks] == [
        (1, "voice oohs", 1, 16, 72, 77),
        (2, "fingered bass", 2, 16, 36, 45),
        (3, "steel-string guitar", 3, 48, 53, 68),
        (4, "string ensemble 1", 4, 48, 60, 75),
        (5, "acoustic grand piano", 5, 32, 48, 57),
    ]


def test_tracks_of_a_track_each_have_their_names(tmp_path):
    file = mido.MidiFile(type=1)
    file.tracks += [_track(*PARTS[1]), _track(*PARTS[0])]
    file.save(tmp_path / "two.mid")
    assert [track.name for track in load_score(tmp_path / "two.mid").tracks] == ["Bass", "Vocals"]


def test_a_track_without_a_program_has_that_of_its_channel(tmp_path):
    setup = mido.MidiTrack([mido.Message("program_change", channel=4, program=6)])
    file = mido.MidiFile(type=1)
    file.tracks += [_track(*PARTS[4]), setup]
    file.save(tmp_path / "song.mid")
    assert load_score(tmp_path / "song.mid").tracks == (
        Track(1, "Keys", "harpsichord", 5, 32, 48, 57),
    )


def test_only_the_chosen_tracks_are_played_with_their_pedals(pop_song):
    score = load_score(pop_song, tracks=(2, 1))
    assert {note.pitch for note in score.notes} == {72, 74, 76, 77, 36, 43, 45, 41}
    assert {event.value for event in score.pedal} == {100, 101}
    assert score.remarks == ()  # nobody asked for drums
    assert len(score.tracks) == 5


def test_all_tracks_are_those_of_no_choice(pop_song):
    assert load_score(pop_song, tracks=range(1, 6)).notes == load_score(pop_song).notes


@pytest.mark.parametrize("number", [0, -1, 6])
def test_a_track_that_is_not_there_is_refused(pop_song, number):
    with pytest.raises(CadenzaError, match=f"no track {number}; the file has tracks 1 to 5"):
        load_score(pop_song, tracks=(1, number))


def test_fingers_of_other_tracks_do_no_harm(pop_song):
    pop_song.with_suffix(".fingering").write_text("0 72 4\n0 36 9\n")
    fingers = {n.pitch: n.finger for n in load_score(pop_song, tracks=[1]).notes if n.start == 0}
    assert fingers == {72: Finger(hand=0, index=4)}


def test_melody_and_bass_of_a_pop_song(pop_song):
    score = melody_and_bass(load_score(pop_song, tracks=(1, 2, 3, 5)))
    assert [note.pitch for note in score.notes] == [36, 72, 43, 74, 45, 76, 41, 77] * 4


def notes_of(pitches, length, step):
    return [Note(i * step, i * step + length, pitch) for i, pitch in enumerate(pitches)]


def test_the_melody_is_a_voice_and_not_the_chords_above_it():
    tune, walk = notes_of([72, 74, 76, 72] * 4, 0.24, 0.25), notes_of([40, 43] * 4, 0.45, 0.5)
    pads = [Note(t, t + 2, pitch) for t in (0.0, 2.0) for pitch in (76, 79, 83)]
    fill = notes_of([90, 91], 0.2, 0.3)
    parts = {1: pads, 2: walk, 3: fill, 5: tune}
    tracks = {number: Score(tuple(notes)) for number, notes in parts.items()}
    assert melody_and_bass_tracks(tracks) == (5, 2)
    assert melody_and_bass_tracks({1: tracks[1], 4: tracks[1], 5: tracks[5]}) == (1, 4, 5)


def test_a_song_of_many_tracks_is_reduced_to_two_of_them(pop_song):
    reduced = Arrangement(reduce="melody-bass").score(str(pop_song))
    chosen = load_score(pop_song, (1, 2))  # vocals and bass
    assert reduced.notes == melody_and_bass(chosen).notes
    assert {note.pitch for note in reduced.notes} == {note.pitch for note in chosen.notes}


def test_melody_and_bass_go_on_while_inner_voices_move():
    long = Note(0.0, 2.0, 76), Note(0.0, 2.0, 40)
    inner = Note(0.0, 1.0, 60), Note(0.5, 1.0, 64), Note(1.0, 1.5, 62)
    score = Score((*long, *inner), (PedalEvent(0.0, 127),))
    assert melody_and_bass(score) == Score(long, score.pedal)


def test_a_voice_goes_on_below_a_note_that_is_about_to_end():
    legato = Score((Note(0.0, 1.03, 76), Note(1.0, 2.0, 74), Note(0.0, 2.0, 40)))
    ends = [(note.pitch, note.end) for note in melody_and_bass(legato).notes]
    assert ends == [(40, 2.0), (76, 1.0), (74, 2.0)]


@given(scores())
def test_melody_and_bass_are_at_most_two_notes_at_once_and_playable(score):
    reduced = melody_and_bass(score)
    originals = {(note.start, note.pitch): note.end for note in score.notes}
    for note in reduced.notes:
        assert note.end <= max(n.end for n in score.notes if n.pitch == note.pitch)
        assert (note.start, note.pitch) in originals
        sounding = [n for n in reduced.notes if n.start <= note.start < n.end]
        assert len(sounding) <= 2
    assert max(n.pitch for n in reduced.notes) == max(n.pitch for n in score.notes)
    _, dropped = find_fingering(reduced.without_fingers())
    assert dropped == ()
