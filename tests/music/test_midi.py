import io
import struct
import time
from collections import Counter
from itertools import pairwise

import mido
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.arrangement import Arrangement, load_song
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.formats.source import MAX_BYTES
from cadenza.music.libraries.library import load_score
from cadenza.music.repair import RawNote, repaired_notes
from cadenza.music.score import Note, PedalEvent, Score
from music_strategies import monophonic_per_key, scores, seconds

HALF_TICK = 0.5 / 48_000 + 1e-12


def on(pitch, time=0, velocity=80, channel=0):
    return mido.Message("note_on", note=pitch, velocity=velocity, time=time, channel=channel)


def off(pitch, time=0, channel=0):
    return mido.Message("note_off", note=pitch, time=time, channel=channel)


@pytest.fixture
def saved(tmp_path):
    """Save tracks of messages, 10 ticks a quarter of 0.5 s; return the path."""

    def save(*tracks, type=1, ticks_per_beat=10):
        file = mido.MidiFile(type=type, ticks_per_beat=ticks_per_beat)
        file.tracks.extend(mido.MidiTrack(track) for track in tracks)
        path = tmp_path / "song.mid"
        file.save(path)
        return path

    return save


def played(score):
    return [(note.start, note.end, note.pitch) for note in score.notes]


def test_times_velocities_and_pedal(saved):
    pedal = mido.Message("control_change", control=64, value=100, time=5)
    other = mido.Message("control_change", control=1, value=100)
    score = read_midi(
        saved([on(60, velocity=33), pedal, other, off(60, 5), on(64, 10), off(64, 10)])
    )
    assert score.notes == (Note(0.0, 0.5, 60, 33), Note(1.0, 1.5, 64, 80))
    assert score.pedal == (PedalEvent(0.25, 100),)
    assert score.remarks == ()
    assert not score.has_fingering


def test_running_status(tmp_path):
    events = bytes([0, 0x90, 60, 80, 10, 60, 0, 0, 62, 80, 10, 62, 0, 0, 0xFF, 0x2F, 0])
    data = b"MThd" + struct.pack(">LHHH", 6, 0, 1, 10) + b"MTrk" + struct.pack(">L", len(events))
    (tmp_path / "running.mid").write_bytes(data + events)
    assert played(read_midi(tmp_path / "running.mid")) == [(0.0, 0.5, 60), (0.5, 1.0, 62)]


def test_tempo_changes_of_one_track_hold_for_all(saved):
    tempo = mido.MetaMessage
    conductor = [tempo("set_tempo", tempo=1_000_000), tempo("set_tempo", tempo=250_000, time=20)]
    bass = [on(40), off(40, 5), on(40, 35), off(40, 10)]
    score = read_midi(saved(conductor, [on(60, 10), off(60, 20)], bass))
    assert played(score) == [(0.0, 0.5, 40), (1.0, 2.25, 60), (2.5, 2.75, 40)]


def test_a_thousand_tempo_changes_add_no_rounding(saved):
    track = [
        mido.MetaMessage("set_tempo", tempo=333_333 + 3 * (k % 7), time=1) for k in range(1400)
    ]
    expected = (500_000 + sum(333_333 + 3 * (k % 7) for k in range(1399))) / 10_000_000
    score = read_midi(saved([*track, on(60), off(60, 10)]))
    assert score.notes[0].start == expected


@pytest.mark.parametrize(
    ("frames", "ticks_per_second"), [(24, 960), (25, 1000), (29, 40 * 30000 / 1001), (30, 1200)]
)
def test_smpte_division(tmp_path, frames, ticks_per_second):
    events = bytes([0, 0x90, 60, 80, 100, 0x80, 60, 0, 0, 0xFF, 0x2F, 0])
    division = bytes([256 - frames, 40])
    head = b"MThd" + struct.pack(">LHH", 6, 0, 1) + division
    (tmp_path / "a.mid").write_bytes(head + b"MTrk" + struct.pack(">L", len(events)) + events)
    assert read_midi(tmp_path / "a.mid").notes[0].end == pytest.approx(100 / ticks_per_second)


def test_separate_songs_of_format_2_are_not_mixed(saved):
    names = [mido.MetaMessage("track_name", name="Suite")]
    first = [mido.MetaMessage("track_name", name="Gigue"), on(60), off(60, 10)]
    score = read_midi(saved(names, first, [on(70), off(70, 10)], type=2))
    assert (score.title, played(score)) == ("Gigue", [(0.0, 0.5, 60)])
    assert score.remarks == ("the file holds 2 separate songs: the first is used",)


def test_drums_are_left_out(saved):
    hold = mido.Message("control_change", control=64, value=127, channel=9)
    score = read_midi(saved([on(60), on(40, channel=9), hold, off(40, 5, 9), off(60, 5)]))
    assert played(score) == [(0.0, 0.5, 60)]
    assert score.pedal == ()
    assert score.remarks == ("1 note of drums left out",)


CUT = "1 note cut short where the same key is struck again"
MERGED = "1 note doubled at the same moment merged"
HELD = "1 note never released: held to the end of the track"
LATE_END = mido.MetaMessage("end_of_track", time=10)


@pytest.mark.parametrize(
    ("tracks", "notes", "remarks"),
    [
        ([[on(60), on(60, 10, 0), on(60, 10), on(60, 20, 0)]], [(0, 0.5, 60), (1, 2, 60)], []),
        ([[on(20), on(21), on(108), on(109), off(20), off(21, 5), off(108, 5)]],
         [(0, 0.25, 21), (0, 0.5, 108)], ["2 notes outside the piano's 88 keys left out"]),
        ([[on(60), off(60), on(62), off(62, 10)]],
         [(0, 0.5, 62)], ["1 note of no length left out"]),
        ([[on(60), on(60, 10), off(60, 10), off(60, 10)]],
         [(0, 0.5, 60), (0.5, 1.5, 60)], [CUT]),
        # A key that another track strikes again sounds to the end of the longer note ...
        ([[on(60), off(60, 40)], [on(60, 10), off(60, 5), on(60, 5), off(60, 5)]],
         [(0, 0.5, 60), (0.5, 1, 60), (1, 2, 60)], [CUT.replace("1 note", "2 notes")]),
        # ... unless nothing releases that one.
        ([[on(60), off(62, 90)], [on(60, 10), off(60, 10)]],
         [(0, 0.5, 60), (0.5, 1, 60)], [CUT]),
        # A note-off in another track ends the note of its channel, where its own has none.
        ([[on(60), on(60, 40)], [off(60, 10), off(60, 40)]], [(0, 0.5, 60), (2, 2.5, 60)], []),
        ([[on(60), off(60, 20)], [on(60, 10), off(60, 20)]],
         [(0, 0.5, 60), (0.5, 1.5, 60)], [CUT]),
        ([[on(60), off(60, 20)], [off(60, 10, channel=1)]], [(0, 1, 60)], []),
        ([[on(60), on(60), off(60, 10), on(62, 10), off(62, 10)]],
         [(0, 0.5, 60), (1, 1.5, 62)], [MERGED]),
        ([[on(60), on(62, 10), off(62, 10), LATE_END]], [(0, 1.5, 60), (0.5, 1, 62)], [HELD]),
        ([[off(60), on(60), off(60, 10), off(60, 3)]], [(0, 0.5, 60)], []),
    ],
)  # fmt: skip
def test_what_one_piano_cannot_play_is_repaired(saved, tracks, notes, remarks):
    score = read_midi(saved(*tracks))
    assert (played(score), list(score.remarks)) == (notes, remarks)


def test_doubled_notes_are_merged_into_the_longest_and_loudest(saved):
    score = read_midi(saved([on(60, velocity=90), off(60, 10)], [on(60, velocity=50), off(60, 20)]))
    assert (score.notes, score.remarks) == ((Note(0.0, 1.0, 60, 90),), (MERGED,))


@pytest.mark.parametrize("control", [120, 123])
def test_all_notes_of_a_channel_end_together(control, saved):
    def end(channel):
        return mido.Message("control_change", control=control, channel=channel, time=10)

    score = read_midi(saved([on(60), on(64), on(67, channel=1), end(0), end(1)]))
    assert played(score) == [(0.0, 0.5, 60), (0.0, 0.5, 64), (0.0, 1.0, 67)]
    assert score.remarks == ()


def test_tracks_that_only_switch_something_are_no_tracks(saved):
    path = saved([on(60), off(60, 10)], [on(30), off(30)], [on(72), off(72, 10)])
    assert [track.lowest for track in read_midi(path).tracks] == [60, 72]
    assert played(read_midi(path, tracks=[2])) == [(0.0, 0.5, 72)]


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("Für Elise", "Für Elise"), (" a\n\x07 b ", "a b"), ("", "song"), ("猫", "猫"),
        ("The Right Stuff", "The Right Stuff"), ("1812", "1812"),
        ("Right", "song"), ("Piano LH", "song"), ("Main gauche", "song"), ("Staff 1", "song"),
    ],
)  # fmt: skip
def test_title_is_the_first_tracks_name_or_the_files(saved, name, title):
    name = mido.MetaMessage("track_name", name=name.encode().decode("latin1"))
    assert read_midi(saved([name, on(60), off(60, 10)], [])).title == title


def test_karaoke_says_its_title_in_a_text(saved):
    name = mido.MetaMessage("track_name", name="Soft Karaoke")
    kind, title = (mido.MetaMessage("text", text=text) for text in ("@KMIDI", "@TOh, Susanna"))
    assert read_midi(saved([name, kind], [title], [on(60), off(60, 10)])).title == "Oh, Susanna"
    assert read_midi(saved([name, kind], [on(60), off(60, 10)])).title == "song"


@pytest.mark.parametrize(
    ("written", "title"),
    [
        ("Für Elise".encode("latin1"), "Für Elise"),
        ("Clair – l’été".encode("cp1252"), "Clair – l’été"),
        ("Катюша".encode("cp1251"), "song"),
        ("アイ".encode("shift_jis"), "song"),
        ("あい".encode("shift_jis"), "song"),
    ],
)
def test_a_name_in_letters_that_are_not_known_is_no_title(saved, written, title):
    name = mido.MetaMessage("track_name", name=written.decode("latin1"))
    score = read_midi(saved([name, on(60), off(60, 10)]))
    assert score.title == title
    assert score.tracks[0].name == ("" if title == "song" else title)


def test_no_notes_at_all_and_none_left(saved):
    with pytest.raises(CadenzaError, match="there are no notes; "):
        read_midi(saved([]))
    with pytest.raises(CadenzaError, match=r"no notes left \(2 notes outside"):
        read_midi(saved([on(1), on(2), off(1, 3), off(2)]))


def test_of_a_song_of_hours_the_beginning_can_be_played(saved):
    path = str(saved([on(60, 100_000), off(60, 100_000)]))
    advice = r"would last 83\.33 minutes; .* play its beginning with --first-seconds"
    with pytest.raises(CadenzaError, match=advice):
        load_song(path, Arrangement())
    assert load_song(path, Arrangement(first_seconds=2)).notes == (Note(5000.0, 5002.0, 60),)


def test_files_that_are_no_songs(tmp_path):
    good = tmp_path / "good.mid"
    write_midi(Score((Note(0, 1, 60),)), good)
    cases = {
        "missing": (None, "no such file"),
        "empty": (b"", "is empty"),
        "text": (b"hello, this is no song", "not a MIDI file"),
        "short": (good.read_bytes()[:23], r"no notes left \(1 track cut off"),
        "head": (good.read_bytes()[:9], "is incomplete"),
        "format": (good.read_bytes().replace(b"\0\0\0\6\0\0", b"\0\0\0\6\0\7"), "format 7"),
        "division": (good.read_bytes().replace(struct.pack(">H", 24_000), b"\0\0"), "division"),
        "frames": (good.read_bytes().replace(struct.pack(">H", 24_000), b"\x99\1"), "division"),
        "large": (b"MThd" + bytes(MAX_BYTES), "too large"),
    }
    for name, (data, message) in cases.items():
        path = tmp_path / name
        if data is not None:
            path.write_bytes(data)
        with pytest.raises(CadenzaError, match=message) as caught:
            read_midi(path)
        assert "\n" not in str(caught.value)
        assert str(path) in str(caught.value)
    with pytest.raises(CadenzaError, match="is a folder"):
        read_midi(tmp_path)


def chunk(name: bytes, content: bytes, order=">") -> bytes:
    return name + struct.pack(f"{order}L", len(content)) + content


SONG = bytes([0, 0x90, 60, 80, 10, 0x80, 60, 0, 0, 0xFF, 0x2F, 0])
HEAD = chunk(b"MThd", struct.pack(">HHH", 0, 1, 10))


@pytest.mark.parametrize("keys", [[(0x0D, 0)], [(2, 0xFF), (0xF8, 1)], [(0xF9, 0), (7, 1)]])
def test_key_signatures_do_not_matter_even_where_no_key_has_them(tmp_path, keys):
    signatures = b"".join(bytes([5, 0xFF, 0x59, 2, *key]) for key in keys)
    (tmp_path / "a.mid").write_bytes(HEAD + chunk(b"MTrk", signatures + SONG))
    score = read_midi(tmp_path / "a.mid")
    start = 0.25 * len(keys)
    assert played(score) == [(start, start + 0.5, 60)]
    assert score.remarks == ()


@pytest.mark.parametrize("sign", [(0x58, 4, 2), (0x58,), (0x51, 7)])
def test_a_tempo_or_time_signature_that_cannot_be_read_is_left_out(tmp_path, sign):
    kind, *content = sign
    broken = bytes([5, 0xFF, kind, len(content), *content])
    (tmp_path / "a.mid").write_bytes(HEAD + chunk(b"MTrk", broken + SONG))
    score = read_midi(tmp_path / "a.mid")
    assert played(score) == [(0.25, 0.75, 60)]
    assert score.remarks == ("1 unreadable tempo or time signature left out",)


TWO = bytes([0, 0x90, 60, 80, 10, 0x80, 60, 0, 0, 0x90, 62, 80, 10, 0x80, 62, 0, 0, 0xFF, 0x2F, 0])
FIRST, SECOND = (0.0, 0.5, 60), (0.5, 1.0, 62)
EXCLUSIVE = bytes([0, 0x90, 60, 80, 0, 0xF0, 2, 1, 0xF7, 10, 60, 0, 0, 0xFF, 0x2F, 0])
CUT_OFF, NO_LENGTH = "1 track cut off: its end is missing", "1 note of no length left out"


def of_tracks(count):
    """A head that says so."""
    return chunk(b"MThd", struct.pack(">HHH", 1, count, 10))


DAMAGED = {
    "tracks missing": (
        of_tracks(5) + chunk(b"MTrk", TWO),
        [FIRST, SECOND],
        ["4 tracks of 5 missing: the file may be incomplete"],
    ),
    "more tracks than said": (of_tracks(1) + chunk(b"MTrk", SONG) * 2, [FIRST], [MERGED]),
    "too large a size": (HEAD + b"MTrk" + struct.pack(">L", 9999) + TWO, [FIRST, SECOND], []),
    "cut within a note": (HEAD + chunk(b"MTrk", TWO)[:-6], [FIRST], [CUT_OFF, NO_LENGTH]),
    "cut before its end": (HEAD + chunk(b"MTrk", TWO)[:-8], [FIRST], [CUT_OFF, NO_LENGTH]),
    "cut between notes": (HEAD + chunk(b"MTrk", TWO)[:-12], [FIRST], [CUT_OFF]),
    "no end": (HEAD + chunk(b"MTrk", TWO[:-4]), [FIRST, SECOND], []),
    "value over 127": (
        HEAD + chunk(b"MTrk", SONG.replace(bytes([80]), b"\xff")),
        [FIRST],
        ["1 value over 127 taken for 127"],
    ),
    "bytes after the end": (
        HEAD + chunk(b"MTrk", SONG + b"abc"),
        [FIRST],
        ["3 bytes after the end of a track left out"],
    ),
    "padded": (HEAD + chunk(b"MTrk", SONG + bytes(3)), [FIRST], []),
    "MacBinary": (bytes(128) + HEAD + chunk(b"MTrk", SONG), [FIRST], []),
    "running status after system exclusive": (HEAD + chunk(b"MTrk", EXCLUSIVE), [FIRST], []),
    "time before an unknown event": (
        HEAD + chunk(b"MTrk", bytes([10, 0xFF, 0x60, 1, 0]) + SONG),
        [(0.5, 1.0, 60)],
        [],
    ),
}


@pytest.mark.parametrize(("data", "notes", "remarks"), DAMAGED.values(), ids=DAMAGED)
def test_what_is_whole_of_a_damaged_file_is_read(tmp_path, data, notes, remarks):
    (tmp_path / "a.mid").write_bytes(data)
    score = read_midi(tmp_path / "a.mid")
    assert played(score) == notes
    assert list(score.remarks) == remarks


ENDLESS = SONG[:-4]  # without an event that says that it ends
LATER = chunk(b"MTrk", bytes([10, 0x90, 62, 80, 10, 0x80, 62, 0, 0, 0xFF, 0x2F, 0]))


def sized(content, size):
    return b"MTrk" + struct.pack(">L", size) + content


MISPLACED = [
    *((sized(SONG, len(SONG) + wrong), []) for wrong in (1, 8, 999, -1, -7, -len(SONG))),
    *((sized(ENDLESS, len(ENDLESS) + wrong), []) for wrong in (3, 999, -1, -len(ENDLESS))),
    (chunk(b"MTrk", SONG) + bytes(5), []),
    (chunk(b"MTrk", SONG) + b"junk!", ["5 bytes after the end of a track left out"]),
    (sized(SONG, 999) + b"junk!", ["5 bytes after the end of a track left out"]),
    (sized(SONG, 2) + b"junk!", ["5 bytes after the end of a track left out"]),
    (chunk(b"MTrk", ENDLESS) + b"\xf9\xff", ["2 bytes after the end of a track left out"]),
    (chunk(b"MTrk", bytes([0, 0xFF, 1, 4]) + b"MTrk" + SONG), []),
    (b"XFIH" + struct.pack(">L", 50) + chunk(b"MTrk", SONG), []),
    (b"abc" + chunk(b"MTrk", SONG), []),
]


@pytest.mark.parametrize(("first", "remarks"), MISPLACED)
def test_a_track_is_found_where_it_begins(tmp_path, first, remarks):
    head = chunk(b"MThd", struct.pack(">HHH", 1, 2, 10))
    (tmp_path / "a.mid").write_bytes(head + first + LATER)
    score = read_midi(tmp_path / "a.mid")
    assert played(score) == [FIRST, SECOND]
    assert list(score.remarks) == remarks


def test_of_a_last_track_of_length_zero_all_is_read(tmp_path):
    (tmp_path / "a.mid").write_bytes(HEAD + sized(TWO[:-4], 0))
    assert played(read_midi(tmp_path / "a.mid")) == [FIRST, SECOND]


@pytest.mark.parametrize(
    "status", [[0xB0, 0, 0xFF], [0xB0, 0xFF, 0], [0xB0, 120, 0x80], [0xE0, 0, 0xFF]]
)
def test_settings_with_damaged_values_are_left_out(tmp_path, status):
    begins, ends = SONG[:4], SONG[4:]
    (tmp_path / "a.mid").write_bytes(HEAD + chunk(b"MTrk", begins + bytes([5, *status]) + ends))
    score = read_midi(tmp_path / "a.mid")
    assert played(score) == [(0.0, 0.75, 60)]
    assert score.remarks == ("1 setting with a value over 127 left out",)


@pytest.mark.parametrize("size", [0, 5, 100])
def test_chunks_of_unknown_types_are_skipped(tmp_path, size):
    unknown, track = chunk(b"XFIH", b"\xff" * size), chunk(b"MTrk", SONG)
    (tmp_path / "a.mid").write_bytes(HEAD + unknown + unknown + track + unknown)
    score = read_midi(tmp_path / "a.mid")
    assert played(score) == [(0.0, 0.5, 60)]
    assert score.remarks == ()


def test_a_midi_file_wrapped_in_riff_is_read(tmp_path):
    song = chunk(b"data", HEAD + chunk(b"MTrk", SONG), "<")
    odd = chunk(b"DISP", b"abc", "<") + b"\0"  # RIFF pads to even sizes
    path = tmp_path / "a.rmi"
    path.write_bytes(chunk(b"RIFF", b"RMID" + odd + song, "<"))
    assert played(read_midi(path)) == [(0.0, 0.5, 60)]
    for other in (b"RMID" + odd, b"WAVE" + song):
        path.write_bytes(chunk(b"RIFF", other, "<"))
        with pytest.raises(CadenzaError, match="not a MIDI file"):
            read_midi(path)


def control(number, value, time=0, channel=0):
    return mido.Message("control_change", control=number, value=value, time=time, channel=channel)


def test_the_pedal_is_as_low_as_any_channel_holds_it(saved):
    left = [control(64, 127, 0, 1), control(64, 0, 20, 1)]
    right = [on(60), control(64, 100, 10), control(64, 0, 20), off(60, 20)]
    score = read_midi(saved(right, left))
    assert [(event.time, event.value) for event in score.pedal] == [
        (0.0, 127),
        (1.0, 100),
        (1.5, 0),
    ]


def test_a_change_of_the_pedal_in_all_channels_lifts_it(saved):
    def hand(channel):
        down, up, again = (control(64, value, 0, channel) for value in (127, 0, 127))
        return [down, on(60, 0, 80, channel), off(60, 10, channel), up, again]

    score = read_midi(saved(hand(0), hand(1)))
    assert [(event.time, event.value) for event in score.pedal] == [(0, 127), (0.5, 0), (0.5, 127)]


def test_resetting_the_controllers_of_a_channel_lifts_its_pedal(saved):
    begin, other, end = control(121, 0, 0), control(121, 0, 10, 1), control(121, 0, 10)
    score = read_midi(saved([begin, on(60), control(64, 127, 0), other, end, off(60, 10)]))
    assert score.pedal == (PedalEvent(0.0, 127), PedalEvent(1.0, 0))


def test_the_sostenuto_pedal_holds_what_sounds_when_it_goes_down(saved):
    down, up = control(66, 127, 5), control(66, 0, 10)
    notes = [on(60), down, off(60, 5), on(62), off(62, 10), up, on(64), off(64, 10)]
    score = read_midi(saved(notes))
    assert played(score) == [(0.0, 1.5, 60), (0.5, 1.0, 62), (1.5, 2.0, 64)]
    assert score.pedal == ()
    assert score.remarks == ()


def test_that_the_soft_pedal_is_left_out_is_told(saved):
    for value, remarks in ((0, ()), (127, ("the soft pedal is left out",))):
        assert read_midi(saved([on(60), control(67, value), off(60, 10)])).remarks == remarks


def test_notes_in_a_channel_without_volume_are_left_out(saved):
    melody = [control(7, 0), on(60), off(60, 10), on(62), control(7, 90, 5), off(62, 5)]
    expression = [control(11, 0, 0, 1), on(64, 0, 80, 1), off(64, 10, 1), control(121, 0, 0, 1)]
    score = read_midi(saved(melody, [*expression, on(65, 0, 80, 1), off(65, 10, 1)]))
    assert played(score) == [(0.5, 1.0, 62), (0.5, 1.0, 65)]
    assert score.remarks == ("2 notes in a channel of no volume left out",)
    chosen = read_midi(saved(melody), tracks=(1,))
    assert played(chosen) == [(0.0, 0.5, 60), (0.5, 1.0, 62)]


def sysex(*data):
    return mido.Message("sysex", data=data)


GS_RHYTHM = sysex(0x41, 0x10, 0x42, 0x12, 0x40, 0x12, 0x15, 0x01, 0x18)  # of channel 2
GS_MELODY = sysex(0x41, 0x10, 0x42, 0x12, 0x40, 0x10, 0x15, 0x00, 0x1B)  # of channel 10
GS_RESET = sysex(0x41, 0x10, 0x42, 0x12, 0x40, 0x00, 0x7F, 0x00, 0x41)
XG_DRUMS = sysex(0x43, 0x10, 0x4C, 0x08, 0x01, 0x07, 0x02)  # of channel 2


@pytest.mark.parametrize(
    ("set_up", "channel", "drums"),
    [
        ([], 9, True),
        ([], 1, False),
        ([control(0, 127, 0, 1)], 1, True),
        ([control(0, 126, 0, 1)], 1, True),
        ([control(0, 120, 0, 1)], 1, True),
        ([control(0, 127, 0, 1), control(0, 0, 0, 1)], 1, False),
        ([control(0, 127, 0, 2)], 1, False),
        ([control(0, 0, 0, 9)], 9, True),
        ([control(0, 121, 0, 9)], 9, False),
        ([GS_RHYTHM, control(0, 0, 0, 1)], 1, True),
        ([GS_MELODY], 9, False),
        ([GS_RESET, control(0, 127, 0, 1)], 1, False),
        ([XG_DRUMS], 1, True),
    ],
)
def test_banks_and_messages_to_synthesizers_say_which_channels_are_drums(
    saved, set_up, channel, drums
):
    notes = [on(36, 0, 80, channel), off(36, 10, channel)]
    score = read_midi(saved([*set_up, *notes, on(60), off(60, 10)]))
    assert [note.pitch for note in score.notes] == ([60] if drums else [36, 60])
    assert score.remarks == (("1 note of drums left out",) if drums else ())


def test_what_sets_up_a_channel_may_stand_in_a_later_track(saved):
    drums = [on(36, channel=1), off(36, 10, channel=1)]
    muted = [on(48, channel=2), off(48, 10, channel=2)]
    score = read_midi(
        saved([*drums, on(60), off(60, 10)], muted, [control(0, 127, 0, 1), control(7, 0, 0, 2)])
    )
    assert [note.pitch for note in score.notes] == [60]


def test_short_messages_to_synthesizers_do_no_harm(saved):
    messages = [GS_RHYTHM, GS_RESET, XG_DRUMS]
    cut = [sysex(*message.data[:end]) for message in messages for end in range(len(message.data))]
    assert len(read_midi(saved([*cut, on(60), off(60, 10)])).notes) == 1


def test_endless_numbers_end_at_once(tmp_path):
    head = b"MThd" + struct.pack(">LHHH", 6, 0, 1, 10) + b"MTrk" + struct.pack(">L", 2**31)
    (tmp_path / "a.mid").write_bytes(head + b"\xff" * (MAX_BYTES - 100))
    begin = time.perf_counter()
    with pytest.raises(CadenzaError, match="damaged"):
        read_midi(tmp_path / "a.mid")
    assert time.perf_counter() - begin < 5


def test_a_midi_file_is_known_by_how_it_begins(tmp_path, saved):
    path = saved([on(60), off(60, 10)]).rename(tmp_path / "song.xml")
    assert played(load_score(path)) == [FIRST]


def valid_file() -> bytes:
    file = mido.MidiFile(type=1, ticks_per_beat=96)
    sysex = mido.Message("sysex", data=(1, 2, 3))
    words = mido.MetaMessage("lyrics", text="la " * 20)
    key = mido.MetaMessage("key_signature", key="F#m")
    smpte = mido.MetaMessage("smpte_offset")
    tempo = mido.MetaMessage("set_tempo", tempo=400_000, time=7)
    bend = mido.Message("pitchwheel", pitch=100)
    file.tracks.append(mido.MidiTrack([words, key, smpte, tempo]))
    melody = [message for p in range(60, 80) for message in (on(p, 3), off(p, 30))]
    file.tracks.append(mido.MidiTrack([sysex, bend, *melody]))
    out = io.BytesIO()
    file.save(file=out)
    return out.getvalue()


VALID = valid_file()
FUZZ = settings(
    max_examples=300, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def reads_or_explains(path, data: bytes) -> bool:
    path.write_bytes(data)
    try:
        score = read_midi(path)
    except CadenzaError as error:
        return "\n" not in str(error)
    return bool(score.notes)


@FUZZ
@given(data=st.binary(max_size=300))
def test_any_bytes_give_a_score_or_a_clear_error(tmp_path, data):
    assert reads_or_explains(tmp_path / "a.mid", data)
    head = b"MThd" + struct.pack(">LHHH", 6, 1, 1, 96)
    assert reads_or_explains(tmp_path / "a.mid", head + data)
    track = b"MTrk" + struct.pack(">L", len(data))
    assert reads_or_explains(tmp_path / "a.mid", head + track + data)


@FUZZ
@given(
    cut=st.integers(0, len(VALID)),
    changes=st.lists(st.tuples(st.integers(0, len(VALID) - 1), st.integers(0, 255)), max_size=8),
)
def test_damaged_files_give_a_score_or_a_clear_error(tmp_path, cut, changes):
    assert reads_or_explains(tmp_path / "a.mid", VALID[:cut])
    data = bytearray(VALID)
    for place, value in changes:
        data[place] = value
    assert reads_or_explains(tmp_path / "a.mid", bytes(data))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(score=st.one_of(scores(), scores(seconds)))
def test_what_is_written_is_read_back(tmp_path, score):
    score = monophonic_per_key(score)
    write_midi(score, tmp_path / "a.mid")
    again = read_midi(tmp_path / "a.mid")
    assert again.remarks == ()

    def by_pitch(score):
        return sorted(score.notes, key=lambda n: (n.pitch, n.start))

    for note, original in zip(by_pitch(again), by_pitch(score), strict=True):
        assert (note.pitch, note.velocity) == (original.pitch, original.velocity)
        assert note.start == pytest.approx(original.start, abs=HALF_TICK)
        assert note.end == pytest.approx(original.end, abs=HALF_TICK)
    assert [event.value for event in again.pedal] == [event.value for event in score.pedal]
    for event, original in zip(again.pedal, score.pedal, strict=True):
        assert event.time == pytest.approx(original.time, abs=HALF_TICK)


TICK = 1 / 48_000
within_ticks = st.integers(0, 20).map(lambda k: k * TICK / 4)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.lists(st.tuples(within_ticks, within_ticks, st.integers(60, 61)), max_size=12, min_size=1),
    st.booleans(),
)
def test_notes_closer_than_a_tick_are_all_read_back(tmp_path, times, may_overlap):
    notes, free = [], {}
    for velocity, (start, length, pitch) in enumerate(sorted(times), start=1):
        if may_overlap or start >= free.get(pitch, 0.0):
            notes.append(Note(start, start + length + 1e-9, pitch, velocity))
            free[pitch] = notes[-1].end
    write_midi(Score(tuple(notes)), tmp_path / "a.mid")
    again = read_midi(tmp_path / "a.mid")
    by_velocity = sorted(again.notes, key=lambda note: note.velocity)
    for note, original in zip(by_velocity, notes, strict=True):
        assert (note.pitch, note.velocity) == (original.pitch, original.velocity)
        assert original.start - TICK / 2 <= note.start + 1e-12
        assert note.start <= original.start + len(notes) * TICK
        assert note.end - note.start >= TICK - 1e-12
    assert may_overlap or again.remarks == ()


def test_times_on_the_millisecond_and_on_thirds_are_read_back_exactly(tmp_path):
    times = [k / 1000 for k in range(0, 3000, 7)] + [k / 3 for k in range(10, 40)]
    notes = [Note(a, b, 60) for a, b in pairwise(times)]
    write_midi(Score(tuple(notes), title="Übung"), tmp_path / "a.mid")
    again = read_midi(tmp_path / "a.mid")
    assert again.notes == tuple(notes)
    assert again.title == "Übung"


def test_a_note_shorter_than_a_tick_lasts_one(tmp_path):
    for length in 1e-9, 1e-10:
        write_midi(Score((Note(0, length, 60),)), tmp_path / "a.mid")
        assert read_midi(tmp_path / "a.mid").notes == (Note(0, 1 / 48_000, 60),)


def test_a_score_of_hours_is_not_written(tmp_path):
    with pytest.raises(CadenzaError, match="100 minutes, the longest is 93"):
        write_midi(Score((Note(0, 6000, 60),)), tmp_path / "a.mid")
    assert not list(tmp_path.iterdir())


def test_of_two_notes_at_the_same_moment_the_finger_and_the_end_that_are_known_are_kept():
    known = Finger(0, 2)
    for fingers in ((None, known), (known, None), (known, Finger(1, 0))):
        doubled = [RawNote(0, 480, 60, 80, True, finger) for finger in fingers]
        (note,), _ = repaired_notes(doubled, Counter(), ())
        assert note.finger == known
    doubled = [RawNote(0, 480, 60, 80, True), RawNote(0, 9600, 60, 90, False)]
    for tracks in doubled, doubled[::-1]:
        (note,), remarks = repaired_notes(tracks, Counter(), ())
        assert (note.end, note.velocity, remarks) == (480, 90, (MERGED,))
