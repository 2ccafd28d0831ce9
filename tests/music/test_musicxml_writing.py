"""Sheet music, read back by Cadenza and as XML."""

import time
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.etudes.library import KINDS, make_etude
from cadenza.music.formats.musicxml.reader import read_musicxml
from cadenza.music.formats.musicxml_writing import write_musicxml
from cadenza.music.libraries.library import load_score
from cadenza.music.libraries.songs import songs
from cadenza.music.score import Bar, Note, PedalEvent, Score, Track
from music_strategies import monophonic_per_key, scores

RIGHT, LEFT = 0, 1
VALUES = {"whole": 4, "half": 2, "quarter": 1, "eighth": "1/2", "16th": "1/4", "32nd": "1/8"} | {
    "64th": "1/16"
}


def bars(count, beats=4, beat=0.5, beat_type=4, start=0.0):
    length = beats * beat
    begins = [start + n * length for n in range(count)]
    return tuple(
        Bar(begin, n, tuple(begin + k * beat for k in range(beats)), beat_type)
        for n, begin in enumerate(begins, start=1)
    )


def line(pitches, step, length=None, hand=RIGHT, start=0.0, velocity=80):
    """One note after the other, `step` [s] apart."""
    return [
        Note(
            start + i * step, start + i * step + (length or step), pitch, velocity, Finger(hand, 1)
        )
        for i, pitch in enumerate(pitches)
    ]


def written(score, tmp_path):
    """The root of the document."""
    path = tmp_path / "song.musicxml"
    write_musicxml(score, path)
    return ElementTree.parse(path).getroot()


def read_back(score, tmp_path):
    write_musicxml(score, tmp_path / "song.musicxml")
    return read_musicxml(tmp_path / "song.musicxml")


def by_pitch(score):
    return sorted(score.notes, key=lambda note: (note.pitch, note.start))


def values(root, staff=1):
    """Types of the notes of a staff, with dots and tuplets, such as "quarter." or "eighth/3"."""
    notes = []
    for note in root.iter("note"):
        if note.findtext("staff") == str(staff) and note.find("pitch") is not None:
            actual = note.findtext("time-modification/actual-notes")
            dots = "." * len(note.findall("dot"))
            notes.append(note.findtext("type") + dots + (f"/{actual}" if actual else ""))
    return notes


def check_measures(root):
    """Check that voices fill their measures, and that values are as long as they look."""
    divisions = int(root.findtext(".//divisions"))
    length = None
    for measure in root.iter("measure"):
        if (beats := measure.findtext("attributes/time/beats")) is not None:
            beat_type = measure.findtext("attributes/time/beat-type")
            length = Fraction(4 * int(beats), int(beat_type)) * divisions
        filled = Counter()
        now, ends = 0, set()
        for element in measure:
            duration = int(element.findtext("duration") or 0)
            if element.tag == "backup":
                ends.add(now)
                now -= duration
                assert now == 0
            elif element.tag == "forward" or (
                element.tag == "note" and element.find("chord") is None
            ):
                now += duration
                filled[element.findtext("voice"), element.findtext("staff")] += duration
        ends.add(now)
        assert len(ends) == 1
        assert set(filled.values()) == ends
        assert ends == {length} or measure.get("implicit") == "yes"
        for note in measure.iter("note"):
            if (name := note.findtext("type")) is None:
                assert note.find("rest").get("measure") == "yes"
                continue
            value = Fraction(VALUES[name]) * (Fraction(3, 2) if note.find("dot") is not None else 1)
            if (changed := note.find("time-modification")) is not None:
                normal, actual = (changed.findtext(f"{n}-notes") for n in ("normal", "actual"))
                value *= Fraction(int(normal), int(actual))
            assert value * divisions == int(note.findtext("duration"))


@pytest.mark.parametrize("name", [piece.name for piece in songs()])
def test_bundled_pieces_are_read_back_as_they_were(name, tmp_path):
    score = load_score(name)
    read = read_back(score, tmp_path)
    check_measures(ElementTree.parse(tmp_path / "song.musicxml").getroot())
    moved = score.notes[0].start - read.notes[0].start  # bars may begin before the first note
    for before, after in zip(by_pitch(score), by_pitch(read), strict=True):
        assert after.start + moved == pytest.approx(before.start, abs=2e-3)
        assert (after.pitch, after.velocity, after.finger) == (
            before.pitch,
            before.velocity,
            before.finger,
        )
    assert read.title == score.title


@pytest.mark.parametrize("kind", KINDS)
def test_etudes_keep_their_bars(kind, tmp_path):
    score = make_etude(kind, 6, 1)
    read = read_back(score, tmp_path)
    assert len(read.bars) == len(score.bars)
    for before, after in zip(score.bars, read.bars, strict=True):
        assert after.beats == pytest.approx(before.beats, abs=1e-4)
        assert (after.number, after.beat_type) == (before.number, before.beat_type)
    for before, after in zip(by_pitch(score), by_pitch(read), strict=True):
        assert after.start == pytest.approx(before.start, abs=2e-3)


@settings(deadline=None, max_examples=60)
@given(score=scores().map(monophonic_per_key), with_bars=st.booleans())
def test_whatever_is_played_is_written(score, with_bars, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet")
    score = replace(score, bars=bars(12) if with_bars else ())
    remarks = write_musicxml(score, folder / "song.musicxml")
    check_measures(ElementTree.parse(folder / "song.musicxml").getroot())
    read = read_musicxml(folder / "song.musicxml")
    if any("left out" in remark for remark in remarks):
        return

    def heard(notes):
        return Counter((note.pitch, note.velocity, note.finger) for note in notes)

    assert heard(read.notes) == heard(score.notes)


def test_notes_are_on_the_staff_of_their_hand(tmp_path):
    crossed = (*line([48, 50], 0.5), *line([72, 74], 0.5, hand=LEFT))
    read = read_back(Score(crossed, bars=bars(1)), tmp_path)
    assert [(note.pitch, note.finger.hand) for note in read.notes] == [
        (48, RIGHT),
        (72, LEFT),
        (50, RIGHT),
        (74, LEFT),
    ]


def test_one_hand_alone_keeps_its_fingers(tmp_path):
    for hand in (RIGHT, LEFT):
        read = read_back(Score(tuple(line([60, 62, 64], 0.5, hand=hand))), tmp_path)
        assert [note.finger for note in read.notes] == [Finger(hand, 1)] * 3


def test_notes_without_a_finger_are_put_by_pitch(tmp_path):
    notes = [Note(i / 2, i / 2 + 0.5, pitch) for i in range(8) for pitch in (43 + i, 69 - i)]
    root = written(Score(tuple(notes), bars=bars(2)), tmp_path)
    octaves = {
        staff: {
            int(note.findtext("pitch/octave"))
            for note in root.iter("note")
            if note.findtext("staff") == staff and note.find("pitch") is not None
        }
        for staff in "12"
    }
    assert octaves == {"1": {4}, "2": {2, 3}}
    assert root.find(".//fingering") is None


def test_triplets_and_semiquavers_sound_together(tmp_path):
    right = line([72, 74, 76] * 4, 0.5 / 3)
    left = line([48, 50, 52, 53] * 4, 0.125, hand=LEFT)
    root = written(Score((*right, *left), bars=bars(1)), tmp_path)
    assert values(root, 1) == ["eighth/3"] * 12
    assert values(root, 2) == ["16th"] * 16
    kinds = [each.get("type") for each in root.iter("tuplet")]
    assert kinds == ["start", "stop"] * 4


def test_a_melody_is_held_above_what_moves(tmp_path):
    held = line([76, 77], 2.0)
    moving = line([60, 64, 67, 64] * 2, 0.5)
    root = written(Score((*held, *moving), bars=bars(2)), tmp_path)
    check_measures(root)
    assert Counter(values(root)) == {"whole": 2, "quarter": 8}


def test_ties_lead_over_bar_lines_and_show_the_beats(tmp_path):
    notes = [Note(0.0, 0.75, 60), Note(0.75, 1.25, 62), Note(1.25, 2.5, 64), Note(2.5, 4.0, 65)]
    root = written(Score(tuple(notes), bars=bars(2)), tmp_path)
    assert values(root) == [
        "quarter.",
        *("eighth", "eighth"),  # about the middle of the bar
        *("quarter.", "quarter"),
        "half.",
    ]
    assert [tie.get("type") for tie in root.iter("tie")] == ["start", "stop"] * 2
    read = read_musicxml(tmp_path / "song.musicxml")
    assert [(note.start, note.end) for note in read.notes] == [
        (note.start, note.end) for note in notes
    ]


@pytest.mark.parametrize(
    ("beats", "beat_type", "first", "rests"),
    [(3, 4, "quarter", ["quarter"] * 2), (6, 8, "eighth", ["eighth", "eighth", "quarter."])],
)
def test_rests_show_the_beats(beats, beat_type, first, rests, tmp_path):
    beat = 2.0 / beat_type
    notes = line([60], beat)
    root = written(Score(tuple(notes), bars=bars(1, beats, beat, beat_type)), tmp_path)
    upper = [note for note in root.iter("note") if note.findtext("staff") == "1"]
    shown = [note.findtext("type") + "." * len(note.findall("dot")) for note in upper]
    assert shown == [first, *rests]


def test_what_is_played_unevenly_is_written_evenly(tmp_path):
    rng = np.random.default_rng(1)
    played = [
        replace(note, start=max(0.0, note.start + rng.normal(0, 0.015)), end=note.end + 0.03)
        for note in line([60, 64, 67, 72] * 16, 0.25)
    ]
    score = Score(tuple(played), bars=bars(8))
    root = written(score, tmp_path)
    assert set(values(root)) == {"eighth"}
    assert root.find(".//rest[@measure]") is not None  # the left hand rests
    read = read_musicxml(tmp_path / "song.musicxml")
    assert [note.start for note in read.notes] == pytest.approx(
        [note.start for note in score.notes], abs=0.0625
    )


def test_a_ritardando_keeps_its_times(tmp_path):
    lengths = np.concatenate([np.full(16, 0.5), 0.5 * 1.05 ** np.arange(16)])
    times = np.concatenate([[0.0], np.cumsum(lengths)])
    slowing = tuple(
        Bar(float(times[4 * n]), n + 1, tuple(times[4 * n : 4 * n + 4].tolist())) for n in range(8)
    )
    halves = [x for a, b in pairwise(times) for x in (a, (a + b) / 2)]
    notes = [Note(a, b, 60 + i % 5) for i, (a, b) in enumerate(pairwise(halves))]
    root = written(Score(tuple(notes), bars=slowing), tmp_path)
    assert set(values(root)) == {"eighth"}
    read = read_musicxml(tmp_path / "song.musicxml")
    assert [note.start for note in read.notes] == pytest.approx(halves[:-1], abs=0.02)
    marks = [int(mark.text) for mark in root.iter("per-minute")]
    assert marks[0] == 120
    assert len(marks) > 1
    assert marks == sorted(marks, reverse=True)


def test_a_steady_tempo_is_written_once(tmp_path):
    root = written(Score(tuple(line([60] * 64, 0.25)), bars=bars(8)), tmp_path)
    assert [sound.get("tempo") for sound in root.iter("sound")] == ["120.0000"]


@pytest.mark.parametrize(
    ("beats", "beat_type", "unit", "per_minute"),
    [(4, 4, "quarter", "120"), (2, 2, "half", "60"), (7, 8, "quarter", "120")],
)
def test_the_tempo_is_that_of_the_beats(beats, beat_type, unit, per_minute, tmp_path):
    step = 2 / beat_type
    song = Score(tuple(line([60] * 2 * beats, step)), bars=bars(2, beats, step, beat_type))
    mark = written(song, tmp_path).find(".//metronome")
    assert (mark.findtext("beat-unit"), mark.findtext("per-minute")) == (unit, per_minute)


def test_very_high_and_very_low_bars_are_written_an_octave_nearer(tmp_path):
    high, low = [84, 96, 98, 96], [33, 24, 21, 24]
    right = line([72, 74, 76, 77, *high, *high, 67, 84, 96, 84], 0.5)
    left = line([48] * 4 + low + [48] * 8, 0.5, hand=LEFT)
    song = Score((*right, *left), bars=bars(4))
    root = written(song, tmp_path)
    shifts = [
        (measure.get("number"), direction.findtext("staff"), shift.get("type"))
        for measure in root.iter("measure")
        for direction in measure.iter("direction")
        for shift in direction.iter("octave-shift")
    ]
    assert shifts == [("2", "1", "down"), ("2", "2", "up"), ("2", "2", "stop"), ("3", "1", "stop")]
    assert by_pitch(read_back(song, tmp_path)) == by_pitch(song)


def test_a_pickup_precedes_the_first_bar(tmp_path):
    begins = (Bar(0.0, 0, (0.0,)), *bars(3, 3, start=0.5))
    notes = line([67, 72, 72, 72, 74, 74, 74, 76, 76, 76], 0.5)
    root = written(Score(tuple(notes), bars=begins), tmp_path)
    first, *others = root.iter("measure")
    assert (first.get("number"), first.get("implicit")) == ("0", "yes")
    assert len(first.findall("note/pitch")) == 1
    assert root.findtext(".//time/beats") == "3"
    assert len(root.findall(".//time")) == 1
    assert [len(measure.findall("note/pitch")) for measure in others] == [3, 3, 3]


def test_a_grace_note_before_the_first_bar_is_in_a_pickup_of_a_beat(tmp_path):
    notes = [Note(0.0, 0.1, 71), *line([72] * 6, 0.5, start=0.1)]
    first = next(written(Score(tuple(notes), bars=bars(2, 3, start=0.1)), tmp_path).iter("measure"))
    assert (first.get("number"), first.get("implicit")) == ("0", "yes")
    types = [note.findtext("type") for note in first.iter("note") if note.findtext("staff") == "1"]
    assert types == ["eighth", "16th", "16th"]


@pytest.mark.parametrize("beats", [(4, 5, 5), (2, 3, 2), (4, 11, 3)])
def test_a_first_bar_of_another_metre_is_no_pickup(beats, tmp_path):
    starts = [0.5 * sum(beats[:n]) for n in range(len(beats))]
    begins = tuple(
        Bar(start, n, tuple(start + 0.5 * beat for beat in range(count)))
        for n, (start, count) in enumerate(zip(starts, beats, strict=True), start=1)
    )
    notes = line([60 + n % 5 for n in range(sum(beats))], 0.5)
    root = written(Score(tuple(notes), bars=begins), tmp_path)
    assert root.findtext(".//time/beats") == f"{beats[0]}"
    assert not any(measure.get("implicit") for measure in root.iter("measure"))


def test_a_tempo_that_changes_by_degrees_is_shown_once_it_has_changed(tmp_path):
    beats = np.concatenate([[0.0], np.cumsum([0.5] * 8 + [0.5 + 0.06 * n for n in range(13)])])
    begins = tuple(
        Bar(float(beats[4 * n]), n + 1, tuple(beats[4 * n : 4 * n + 4].tolist())) for n in range(5)
    )
    places = enumerate(pairwise(beats[:21].tolist()))
    notes = tuple(Note(*place, 60 + n % 4) for n, place in places)
    root = written(Score(notes, bars=begins), tmp_path)
    shown = [int(each.text) for each in root.iter("per-minute")]
    assert shown[0] == 120
    assert all(b < 0.9 * a for a, b in pairwise(shown))
    assert len(shown) > 1


def rolled(pitches, start, step, end, hands=(LEFT,)):
    """A chord whose notes begin one after the other."""
    places = [(start + step * i, pitch, hands[i % len(hands)]) for i, pitch in enumerate(pitches)]
    return [Note(begin, end, pitch, hands=(hand,)) for begin, pitch, hand in places]


@pytest.mark.parametrize("late", [0.0, -0.13])  # on the beat, and before it
def test_a_rolled_chord_is_a_chord_with_its_sign(late, tmp_path):
    places = ((2 + late, 3.8), (4 + late, 5.8), (6 + late, 8))
    chords = [rolled([40, 47, 52, 56], start, 0.043, end) for start, end in places]
    melody = [Note(0.5 * n, 0.5 * n + 0.5, 64 + n % 5, hands=(RIGHT,)) for n in range(16)]
    song = Score((*melody, *(note for chord in chords for note in chord)), bars=bars(4))
    root = written(song, tmp_path)
    assert values(root, 2) == ["whole"] * 12
    assert len(root.findall(".//arpeggiate")) == 12
    assert not root.findall(".//arpeggiate[@number]")
    again = read_musicxml(tmp_path / "song.musicxml")
    starts = [[n.start for n in score.notes if n.pitch < 60] for score in (song, again)]
    assert starts[1] == pytest.approx(starts[0], abs=0.02 - late)


def test_a_chord_that_is_rolled_through_both_hands_has_one_sign(tmp_path):
    chord = rolled([76, 67, 55, 48], 0, 0.05, 2, hands=(RIGHT, RIGHT, LEFT, LEFT))
    root = written(Score(tuple(chord), bars=bars(1)), tmp_path)
    signs = root.findall(".//arpeggiate")
    assert [(sign.get("number"), sign.get("direction")) for sign in signs] == [("1", "down")] * 4
    assert values(root) == values(root, 2) == ["whole"] * 2


def test_notes_that_are_written_one_after_the_other_are_not_rolled(tmp_path):
    held = rolled([48, 52, 55, 60], 0, 0.0625, 2)  # 32nds
    others = line([72, 74, 76, 77], 0.5)
    late = [Note(0.0, 1, 36, hands=(LEFT,)), Note(0.04, 1, 84, hands=(RIGHT,))]  # as people play
    for notes in ([*held, *others], late):
        root = written(Score(tuple(notes), bars=bars(1)), tmp_path)
        assert not root.findall(".//arpeggiate")


def test_a_bar_of_minutes_can_be_read_again(tmp_path):
    song = Score((Note(0, 1, 60), Note(501, 502, 62)), bars=(Bar(0.0, 1), Bar(502.0, 2)))
    write_musicxml(song, tmp_path / "song.musicxml")
    score = read_musicxml(tmp_path / "song.musicxml")
    assert [note.start for note in score.notes] == pytest.approx([0, 501], abs=0.2)
    assert not score.remarks


@pytest.mark.parametrize(
    ("song", "metre", "pickup"),
    [("FurEliseOpening", ("3", "8"), 2), ("Greensleeves", ("6", "8"), 1)],
)
def test_the_metre_of_a_file_is_kept(song, metre, pickup, tmp_path):
    root = written(load_score(song), tmp_path)
    (time,) = root.iter("time")
    assert (time.findtext("beats"), time.findtext("beat-type")) == metre
    first = next(root.iter("measure"))
    assert (first.get("implicit"), len(first.findall("note/pitch"))) == ("yes", pickup)
    assert root.find(".//miscellaneous-field") is None


def test_a_pickup_that_the_file_does_not_tell_is_found(tmp_path):
    tune = [67, *[72, 74, 76] * 8]
    bass = [
        Note(0.5 + 1.5 * n, 2.0 + 1.5 * n, 36 + n % 4, finger=Finger(LEFT, 4)) for n in range(8)
    ]
    score = Score((*line(tune, 0.5), *bass), bars=bars(9, 3))
    remarks = write_musicxml(score, tmp_path / "song.musicxml")
    assert remarks == ("a pickup of 1 beat is assumed, which bar lines fit better",)
    root = ElementTree.parse(tmp_path / "song.musicxml").getroot()
    assert values(root, 2) == ["half."] * 8


def test_bar_lines_of_sheet_music_are_never_moved(tmp_path):
    tune = [67, *[72, 74, 76] * 8]
    listed = (Track(1, "Piano", "", None, len(tune), 67, 76),)
    score = Score(tuple(line(tune, 0.5)), bars=bars(9, 3), tracks=listed)
    assert write_musicxml(score, tmp_path / "song.musicxml") == ()


def test_beats_are_estimated_without_bars(tmp_path):
    tune = line([72, 67, 67] * 8, 0.6)
    bass = line([48, 50] * 4, 1.8, hand=LEFT)
    path = tmp_path / "song.musicxml"
    (remark,) = write_musicxml(Score((*tune, *bass)), path)
    assert remark == "the song has no bars: beats and bars are estimated"
    root = ElementTree.parse(path).getroot()
    assert root.findtext(".//time/beats") == "3"
    assert set(values(root)) == {"quarter"}


@pytest.mark.parametrize(
    ("tonic", "fifths"), [(62, 2), (65, -1), (63, -3), (61, -5), (66, 6), (64, 4)]
)
def test_a_major_scale_needs_no_accidentals(tonic, fifths, tmp_path):
    scale = [tonic + step for step in (0, 2, 4, 5, 7, 9, 11, 12, 11, 9, 7, 5, 4, 2, 0, 0)]
    root = written(Score(tuple(line(scale * 2, 0.5)), bars=bars(8)), tmp_path)
    assert abs(int(root.findtext(".//fifths"))) == abs(fifths)
    assert root.find(".//accidental") is None


def test_the_key_signatures_of_the_file_are_written_and_notes_named_by_them(tmp_path):
    scale = (0, 2, 4, 5, 7, 9, 11, 12)
    keys = {0: 60, -6: 66, 6: 66, -1: 65}
    tune = [tonic + step for tonic in keys.values() for step in scale]
    known = [
        replace(bar, key=key)
        for bar, key in zip(bars(8), [each for key in keys for each in (key, key)], strict=True)
    ]
    root = written(Score(tuple(line(tune, 0.5)), bars=tuple(known)), tmp_path)
    assert [int(each.text) for each in root.iter("fifths")] == list(keys)
    assert root.find(".//accidental") is None
    names = [each.findtext("step") for each in root.iter("pitch")]
    assert "".join(names[8:24]) == "GABCDEFG" + "FGABCDEF"


@pytest.mark.parametrize(
    ("count", "quarters", "types"),
    [
        (3, 2, ["quarter/3"] * 6),
        (5, 1, ["16th/5"] * 20),
        (7, 2, ["eighth/7"] * 14),
    ],
)
def test_tuplets_of_one_beat_or_two_are_written_without_ties(count, quarters, types, tmp_path):
    step = 0.5 * quarters / count
    score = Score(tuple(line([72, 74] * 10, step)[: 4 // quarters * count]), bars=bars(1))
    root = written(score, tmp_path)
    assert (values(root), root.find(".//tie")) == (types, None)
    again = read_back(score, tmp_path)
    assert [n.start for n in again.notes] == pytest.approx([n.start for n in score.notes], abs=1e-3)


@pytest.mark.parametrize(
    ("beats", "groups"), [(3, [3]), (4, [2, 2]), (5, [2, 3]), (7, [2, 2, 3]), (8, [2, 2, 2, 2])]
)
def test_eighths_are_beamed_also_where_beats_are_eighths(beats, groups, tmp_path):
    score = Score(tuple(line([72] * beats, 0.25)), bars=bars(1, beats, 0.25, 8))
    beams = [beam.text for beam in written(score, tmp_path).iter("beam")]
    expected = [["begin", *["continue"] * (group - 2), "end"] for group in groups]
    assert beams == [beam for group in expected for beam in group]


def test_accidentals_hold_for_their_bar(tmp_path):
    tune = [60, 62, 64, 65, 66, 66, 65, 65, 66, 67, 65, 67, 64, 65, 62, 60]
    root = written(Score(tuple(line(tune, 0.5)), bars=bars(4)), tmp_path)
    sounding = [note for note in root.iter("note") if note.find("pitch") is not None]
    shown = [note.findtext("accidental") for note in sounding]
    assert shown[4:11] == ["sharp", None, "natural", None, "sharp", None, "natural"]


def test_notes_without_fingers_go_to_the_staff_of_the_hand_that_they_are_written_for(tmp_path):
    notes = (Note(0, 1, 40, hands=(RIGHT,)), Note(1, 2, 72, hands=(LEFT,)))
    root = written(Score(notes, bars=bars(1)), tmp_path)
    staves = {note.findtext("pitch/octave"): note.findtext("staff") for note in root.iter("note")}
    assert (staves["2"], staves["5"]) == ("1", "2")


def test_what_is_quantised_says_so(tmp_path):
    exact = Score(tuple(line([60, 62, 64, 65], 0.5)), bars=bars(1))
    uneven = replace(exact, notes=tuple(replace(n, start=n.start + 0.02) for n in exact.notes))
    for score, expected in (
        (exact, []),
        (uneven, ["quantised: notes are moved to the nearest note values"]),
    ):
        assert list(write_musicxml(score, tmp_path / "song.musicxml")) == expected
        root = ElementTree.parse(tmp_path / "song.musicxml").getroot()
        assert [field.text for field in root.iter("miscellaneous-field")] == expected


def test_the_clef_changes_where_a_hand_stays_high(tmp_path):
    low, high = line([43, 48, 52, 55] * 4, 0.5, hand=LEFT), [72, 76, 79, 84] * 4
    notes = (*low, *line(high, 0.5, hand=LEFT, start=8.0))
    root = written(Score(notes, bars=bars(8)), tmp_path)
    lower = [clef.findtext("sign") for clef in root.iter("clef") if clef.get("number") == "2"]
    assert lower == ["F", "G"]


def test_velocities_are_kept_and_shown(tmp_path):
    loud = line([60, 62, 64, 65] * 2, 0.5, velocity=101)
    soft = line([60, 62, 64, 65] * 2, 0.5, start=4.0, velocity=47)
    score = Score((*loud, *soft), bars=bars(4))
    root = written(score, tmp_path)
    assert [mark[0].tag for mark in root.iter("dynamics")] == ["f", "p"]
    read = read_musicxml(tmp_path / "song.musicxml")
    assert [note.velocity for note in read.notes] == [101] * 8 + [47] * 8


def test_hairpins_lead_from_one_dynamic_to_another(tmp_path):
    """Piano for two bars, two bars of crescendo, forte for two, and suddenly piano."""
    velocities = [49] * 8 + list(range(52, 100, 6)) + [98] * 8 + [49] * 8
    pitches = [60, 62, 64, 65] * 8
    notes = [
        replace(note, velocity=velocity)
        for note, velocity in zip(line(pitches, 0.5), velocities, strict=True)
    ]
    root = written(Score(tuple(notes), bars=bars(8)), tmp_path)
    marks = [
        (int(measure.get("number")), sign.get("type") or sign[0].tag)
        for measure in root.iter("measure")
        for sign in measure.iter()
        if sign.tag in ("dynamics", "wedge")
    ]
    assert marks == [(1, "p"), (3, "crescendo"), (5, "stop"), (5, "f"), (7, "p")]
    read = read_musicxml(tmp_path / "song.musicxml")
    assert [note.velocity for note in read.notes] == velocities


def test_the_pedal_is_kept(tmp_path):
    moves = [(0.0, 127), (1.0, 0), (1.125, 90), (2.0, 100), (2.25, 10)]
    pedal = tuple(PedalEvent(*move) for move in moves)
    read = read_back(Score(tuple(line([60] * 3, 1.0)), pedal, bars=bars(2)), tmp_path)
    assert [(event.time, event.value) for event in read.pedal] == [
        (0.0, 127),
        (1.0, 0),
        (1.125, 127),
        (2.25, 0),
    ]


@pytest.mark.parametrize(
    "strange",
    [
        (Bar(0.0, 1),),
        (Bar(0.0, 1, (0.0,)),),
        tuple(Bar(n * 1e-5, n) for n in range(100)),
        (Bar(100.0, 1, (100.0, 100.5)),),
        (Bar(-9.0, -3, (-9.0, -8.0), 64), Bar(0.3, -2)),
    ],
)
def test_notes_are_written_whatever_the_bars(strange, tmp_path):
    score = Score(tuple(line([60, 62, 64, 65, 67], 0.5)), bars=strange)
    root = written(score, tmp_path)
    check_measures(root)
    assert [note.pitch for note in read_musicxml(tmp_path / "song.musicxml").notes] == [
        note.pitch for note in score.notes
    ]


def test_a_score_without_notes_is_refused(tmp_path):
    with pytest.raises(CadenzaError, match="no notes"):
        write_musicxml(Score(()), tmp_path / "song.musicxml")


@pytest.mark.slow
def test_twenty_thousand_notes_are_written_in_ten_seconds(tmp_path):
    rng = np.random.default_rng(0)
    notes = [
        replace(note, start=max(0.0, note.start + rng.normal(0, 0.01)))
        for hand, low in ((RIGHT, 64), (LEFT, 40))
        for part in (0, 7)
        for note in line(low + part + rng.integers(0, 7, 5000), 0.125, hand=hand)
    ]
    began = time.process_time()
    write_musicxml(Score(tuple(notes)), tmp_path / "song.musicxml")
    assert time.process_time() - began < 10
    assert len(read_musicxml(tmp_path / "song.musicxml").notes) > 19_900
