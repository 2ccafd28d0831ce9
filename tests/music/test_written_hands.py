"""Which hand plays what, as tracks of MIDI files and fingers say it."""

import mido
import pytest

from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT, Finger
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Track

HIGH, LOW = [72, 74, 76, 77], [48, 50, 52, 53]
CHOIR, GUITAR = 52, 25


@pytest.fixture
def hands(tmp_path):
    """The hands that play each pitch of a file, of tracks (name, pitches, program) on channels."""

    def read(*tracks, chosen=()):
        file = mido.MidiFile(type=1)
        for channel, (name, pitches, *program) in enumerate(tracks):
            track = mido.MidiTrack([mido.MetaMessage("track_name", name=name)])
            track += [mido.Message("program_change", channel=channel, program=p) for p in program]
            for pitch in pitches:
                track.append(mido.Message("note_on", channel=channel, note=pitch))
                track.append(mido.Message("note_off", channel=channel, note=pitch, time=480))
            file.tracks.append(track)
        file.save(tmp_path / "song.mid")
        notes = load_score(tmp_path / "song.mid", chosen).notes
        return {note.pitch: note.hands for note in notes}

    return read


def as_written(right=(), left=()):
    return dict.fromkeys(right, (RIGHT,)) | dict.fromkeys(left, (LEFT,))


@pytest.mark.parametrize(
    "names",
    [
        ("Right", "Left"),
        ("Piano RH", "Piano LH"),
        ("Piano R.H.", "Piano L.H."),
        ("piano_rh", "piano_lh"),
        ("Right Hand", "Left Hand"),
        ("Piano right", "Piano left"),
        ("rechte Hand", "linke Hand"),
        ("upper:", "lower:"),
        ("Treble", "Bass"),
        ("up", "down"),
    ],
)
def test_names_of_tracks_say_which_hand_plays_even_where_hands_cross(names, hands):
    right, left = names
    assert hands((right, LOW), (left, HIGH)) == as_written(right=LOW, left=HIGH)


def test_the_hands_of_a_piano_among_others_play_their_tracks_only(hands):
    song = ("Voice", [60, 62], CHOIR), ("Piano right", HIGH), ("Piano left", LOW)
    assert hands(*song) == as_written(HIGH, LOW) | {60: (), 62: ()}


def test_two_voices_of_a_hand_may_have_tracks_of_their_own(hands):
    song = ("RH 1", HIGH), ("RH 2", [60, 62]), ("LH", LOW)
    assert hands(*song) == as_written([*HIGH, 60, 62], LOW)


@pytest.mark.parametrize("name", ["", "Piano", "A Sonata"])
def test_of_two_tracks_that_are_called_alike_the_lower_one_is_the_left_hands(name, hands):
    assert hands((name, LOW), (name, HIGH)) == as_written(HIGH, LOW)


@pytest.mark.parametrize(
    "tracks",
    [
        [("Piano", HIGH)],
        [("Vocals", HIGH), ("Piano", LOW)],  # names tell them apart
        [("Piano", [60, 62, 64]), ("Piano", [59, 61, 65])],  # neither is clearly lower
        [("Piano", HIGH), ("Piano", LOW), ("Piano", [60, 62])],
        [("Piano", HIGH, CHOIR), ("Piano", LOW, CHOIR)],
        [("Guitar right", HIGH, GUITAR), ("Guitar left", LOW, GUITAR)],
        [("Treble", HIGH), ("Alto", [66]), ("Bass", LOW)],
        [("Right", HIGH), ("Melody", LOW)],
        [("Primo RH", HIGH), ("Primo LH", [60]), ("Secondo RH", [57]), ("Secondo LH", LOW)],
    ],
)
def test_where_nothing_says_so_no_hands_are_known(tracks, hands):
    assert set(hands(*tracks).values()) == {()}


def test_fingers_say_which_hand_plays():
    assert all(
        note.hands == (note.finger.hand,) for note in load_score("CMajorScaleTwoHands").notes
    )


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
    assert {event.value for event in score.pedal} == {101}  # and not those of other channels
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
