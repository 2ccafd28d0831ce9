"""Which hand plays what, as tracks of MIDI files and fingers say it."""

import mido
import pytest

from cadenza.fingers import LEFT, RIGHT
from cadenza.music.libraries.library import load_score

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
