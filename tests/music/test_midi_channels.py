"""What moves notes of MIDI files from their keys, apart or to the drums, by the specifications."""

import mido
import pytest

from cadenza.music.formats.midi import read_midi

QUARTER = 10  # ticks, of 0.5 s


def control(number, value, time=0, channel=0):
    return mido.Message("control_change", control=number, value=value, time=time, channel=channel)


def parameter(number, value, channel=0):
    """Set a registered parameter and choose none again, as files do."""
    chosen = [control(101, 0, 0, channel), control(100, number, 0, channel)]
    none = [control(101, 127, 0, channel), control(100, 127, 0, channel)]
    return [*chosen, control(6, value, 0, channel), *none]


def note(pitch, channel=0, wait=0, length=QUARTER):
    on = mido.Message("note_on", note=pitch, velocity=80, time=wait, channel=channel)
    return [on, mido.Message("note_off", note=pitch, time=length, channel=channel)]


def wheel(position, time=0, channel=0):
    return mido.Message("pitchwheel", pitch=position, time=time, channel=channel)


def sysex(text):
    return mido.Message("sysex", data=bytes.fromhex(text))


def port(number):
    return mido.MetaMessage("midi_port", port=number)


@pytest.fixture
def read(tmp_path):
    def score(*tracks):
        file = mido.MidiFile(type=1, ticks_per_beat=QUARTER)
        file.tracks.extend(mido.MidiTrack(track) for track in tracks)
        file.save(tmp_path / "a.mid")
        return read_midi(tmp_path / "a.mid")

    return score


def pitches(score):
    return [note.pitch for note in score.notes]


FINE_UP = [control(101, 0), control(100, 1), control(6, 96), control(38, 0)]  # 50 cents
MAKERS_OWN = [*parameter(2, 66)[:2], control(99, 1), control(98, 8), control(6, 100)]
UP_5 = "41 10 42 12 40 00 05 45 76"
UP_5_OF_XG = "43 10 4C 00 00 06 45"
GM_ON, GS_RESET = "7E 7F 09 01", "41 10 42 12 40 00 7F 00 41"


@pytest.mark.parametrize(
    ("before", "pitch"),
    [
        (parameter(2, 64), 60),
        (parameter(2, 52), 48),
        (parameter(2, 76, channel=1), 60),
        ([*parameter(2, 66), *note(60, 3), *parameter(2, 64)], 60),
        ([*parameter(2, 66)[:3], control(96, 0), control(96, 0), control(97, 0)], 63),
        ([*parameter(2, 66), control(121, 0)], 62),
        (FINE_UP, 60),
        (MAKERS_OWN, 60),
        ([sysex("7F 7F 04 04 00 34")], 48),
        ([sysex("7F 7F 04 03 00 34")], 60),
        ([sysex("7F 7F 04 04 00 34"), *parameter(2, 66)], 50),
        ([sysex("7F 7F 04 04 00 34"), *note(60, 3), sysex(GM_ON)], 60),
        ([sysex(GS_RESET), sysex(UP_5)], 65),
        ([sysex("41 10 42 12 40 11 16 34 55")], 48),
        ([sysex("41 10 42 12 40 12 16 34 54")], 60),
        ([sysex("41 10 42 12 40 11 16 7F 0A")], 60),
        ([sysex(UP_5), *note(60, 3), sysex(GS_RESET)], 60),
        ([sysex("43 10 4C 00 00 7E 00"), sysex(UP_5_OF_XG)], 65),
        ([sysex("43 10 4C 08 00 08 3D")], 57),
        ([sysex("43 10 4C 08 01 08 3D")], 60),
        ([sysex(UP_5), sysex(UP_5_OF_XG)], 65),
        ([sysex(UP_5[:-6])], 60),
    ],
)
def test_tuning_by_semitones_transposes(read, before, pitch):
    score = read([*before, *note(60)])
    assert pitches(score)[-1] == pitch
    assert score.remarks == ()


def test_a_tuned_note_ends_with_its_key(read):
    score = read([*parameter(2, 66), note(60)[0], *parameter(2, 64), *note(62), note(60)[1]])
    assert [(n.start, n.end, n.pitch) for n in score.notes] == [(0, 1, 60), (0, 0.5, 62)]


def test_notes_are_left_out_by_the_pitch_that_sounds(read):
    down = parameter(2, 52)
    score = read([*down, *note(25), *note(112), *parameter(2, 64), *note(60)])
    assert pitches(score) == [100, 60]
    assert score.remarks == ("1 note outside the piano's 88 keys left out",)


BENT = "1 note bent by the pitch wheel taken for the nearest key"


@pytest.mark.parametrize(
    ("before", "pitch", "is_exact"),
    [
        ([wheel(8191)], 62, True),
        ([wheel(127 * 128 - 8192)], 62, True),  # by a wheel of 7 bits
        ([wheel(-4096)], 59, True),
        ([wheel(2048)], 60, False),
        ([wheel(8191), wheel(0)], 60, True),
        ([wheel(8191), control(121, 0)], 60, True),
        ([wheel(8191, channel=1)], 60, True),
        ([*parameter(0, 12), wheel(8191)], 72, True),
        ([wheel(4096), *parameter(0, 24)], 72, True),
        ([*parameter(0, 12), wheel(8191 * 3 // 8)], 64, False),
        ([sysex("41 10 42 12 40 21 10 4C 43"), wheel(-8192)], 48, True),
        ([wheel(8191), *parameter(2, 54)], 52, True),
    ],
)
def test_a_held_pitch_wheel_moves_notes(read, before, pitch, is_exact):
    score = read([*before, *note(60)])
    assert pitches(score) == [pitch]
    assert score.remarks == (() if is_exact else (BENT,))


@pytest.mark.parametrize(("held", "pitch"), [(1, 60), (8, 62)])
def test_a_bend_that_moves_on_at_once_is_not_the_pitch_of_a_note(read, held, pitch):
    on, off = note(60, length=QUARTER - held)
    score = read([wheel(8191), on, wheel(0, held), off])
    assert pitches(score) == [pitch]
    assert score.remarks == (() if pitch == 62 else (BENT,))


def test_a_bend_within_a_note_is_no_other_note(read):
    on, off = note(60, length=5)
    assert pitches(read([on, wheel(8191, 1), wheel(0, 4), off])) == [60]


@pytest.mark.parametrize(
    ("before", "is_drums"),
    [
        ([], True),
        (parameter(6, 15), False),
        (parameter(6, 9), False),
        (parameter(6, 8), True),
        (parameter(6, 6, channel=15), False),
        (parameter(6, 5, channel=15), True),
        (parameter(6, 15, channel=3), True),
        ([*parameter(6, 15), *parameter(6, 0)], True),
        ([*parameter(6, 15), *parameter(6, 2, channel=15)], False),
    ],
)
def test_members_of_an_mpe_zone_are_no_drums(read, before, is_drums):
    score = read([*before, *note(36, 9), *note(60)])
    assert pitches(score) == ([60] if is_drums else [36, 60])


def test_members_of_an_mpe_zone_bend_by_their_range_and_with_its_manager(read):
    zone = parameter(6, 15)
    octave = 8192 // 4  # of the 48 semitones of a member
    assert pitches(read([*zone, wheel(octave, 0, 2), *note(60, 2)])) == [72]
    both = [wheel(8191), wheel(octave, 0, 2)]
    assert pitches(read([*zone, *both, *note(60, 2), *note(60, 3)])) == [74, 62]
    assert pitches(read([*zone, *parameter(0, 12, 4), *both, *note(60, 2)])) == [65]


def test_channels_of_ports_have_nothing_in_common(read):
    muted = [port(1), control(7, 0), *note(40)]
    tuned = [port(2), *parameter(2, 66), *note(50)]
    upper = [port(0), *note(60, length=4 * QUARTER)]
    stray = [port(3), note(60, wait=QUARTER)[1], *note(70)]
    score = read(upper, muted, tuned, stray)
    played = [(n.start, n.end, n.pitch) for n in score.notes]
    assert played == [(0.0, 0.5, 52), (0.0, 2.0, 60), (0.5, 1.0, 70)]
    assert score.remarks == ("1 note in a channel of no volume left out",)


def test_the_pedals_of_ports_have_nothing_in_common(read):
    held = [port(0), control(64, 127), *note(60), control(64, 0, 3 * QUARTER)]
    other = [port(1), control(64, 0, QUARTER), *note(64)]
    score = read(held, other)
    assert [(e.time, e.value) for e in score.pedal] == [(0.0, 127), (2.0, 0)]


def test_the_tenth_channel_of_every_port_plays_drums(read):
    score = read([port(0), *note(60)], [port(1), *note(36, 9)], [port(1), *note(64)])
    assert sorted(pitches(score)) == [60, 64]


@pytest.mark.parametrize("mode", [124, 125, 126, 127])
def test_messages_of_mode_end_notes(read, mode):
    on, off = note(60)
    score = read([on, control(mode, 0, QUARTER), *note(64), off])
    assert [(n.start, n.end, n.pitch) for n in score.notes] == [(0, 0.5, 60), (0.5, 1, 64)]


@pytest.mark.parametrize(
    ("system", "is_drums"),
    [
        ([], True),
        (["43 10 4C 00 00 7E 00"], True),
        ([GM_ON], True),
        ([GS_RESET], False),
        (["41 10 42 12 40 01 30 04 0B"], False),
        (["41 10 45 12 10 00 00 41 2F"], False),  # letters on its display
        (["41 10 42 12 40 01 30 04 0B", "43 10 4C 00 00 7E 00"], True),
        (["43 73 01 14", "41 10 42 12 40 01 30 04 0B"], False),  # a Yamaha that is not XG
    ],
)
def test_bank_127_is_drums_for_xg_and_not_for_roland(read, system, is_drums):
    score = read([*map(sysex, system), control(0, 127, 0, 2), *note(36, 2), *note(60)])
    assert pitches(score) == ([60] if is_drums else [36, 60])


def test_a_later_message_says_for_which_synthesizer_the_file_is(read):
    later = sysex("41 10 42 12 40 01 30 04 0B").copy(time=QUARTER)
    assert pitches(read([control(0, 127, 0, 2), *note(36, 2), later, *note(60)])) == [36, 60]
