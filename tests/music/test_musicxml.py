"""MusicXML as notation programs export it, and as an attacker would."""

import contextlib
import io
import re
import zipfile

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT
from cadenza.music.formats.musicxml.reader import read_musicxml
from cadenza.music.formats.musicxml.tree import MAX_DEPTH, MAX_NOTES, MAX_PARTS, MAX_XML_BYTES
from cadenza.music.libraries.library import load_score
from cadenza.music.score import PedalEvent
from musicxml_documents import (
    AGAIN,
    BACK,
    FOUR_QUARTERS,
    compressed,
    direction,
    document,
    finger,
    jump,
    note,
    pitches,
    played,
    tempo,
)
from numbered import numbers


@pytest.mark.parametrize(
    "credit",
    [
        "<identification><creator type='composer'>Clara</creator></identification>",
        "<credit><credit-type>composer</credit-type><credit-words>Clara</credit-words></credit>",
        "<credit page='1'><credit-words justify='right'>Clara</credit-words></credit>",
    ],
)
def test_a_file_says_who_wrote_its_music(saved, credit):
    text = document([FOUR_QUARTERS + note("C4", 4)])
    assert load_score(saved(text)).composer == ""
    assert (
        load_score(saved(text.replace("<part-list>", credit + "<part-list>", 1))).composer
        == "Clara"
    )


def test_the_large_words_of_the_first_page_are_a_title(saved):
    words = "<credit-words justify='center' valign='top'>Rag</credit-words>"
    text = document([FOUR_QUARTERS + note("C4", 4)], title="")
    credit = f"<credit page='1'>{words}</credit><part-list>"
    assert load_score(saved(text.replace("<part-list>", credit, 1))).title == "Rag"


def test_notes_times_and_title(read):
    score = read(FOUR_QUARTERS + note("C4", 8) + note("E4", 8))
    assert played(score) == [(0.0, 1.0, 60), (1.0, 2.0, 64)]  # 120 quarters a minute
    assert (score.title, score.remarks) == ("Little piece", ())


@pytest.mark.parametrize("name", ["song.musicxml", "SONG.XML", "song.mxl", "song.mid", "song"])
def test_it_is_known_by_how_it_begins(name, saved):
    text = document([FOUR_QUARTERS + note("C4", 4)])
    score = load_score(saved(compressed(text) if name == "song.mxl" else text, name))
    assert played(score) == [(0.0, 0.5, 60)]


@pytest.mark.parametrize(
    ("declared", "stored"),
    [
        ("UTF-16", "utf-16"),
        ("UTF-16", "utf-8"),
        ("UTF-16", "latin-1"),
        ("UTF-8", "utf-16"),
        ("UTF-8", "utf-16-be"),
        ("UTF-8", "cp1252"),
        ("ISO-8859-1", "utf-8"),
        ("mac-roman", "mac-roman"),
        ("punycode", "utf-8"),
        ("no-such", "utf-8-sig"),
    ],
)
def test_whatever_encoding_is_declared_another_may_be_used(declared, stored, saved):
    text = document([FOUR_QUARTERS + note("C4", 4)], title="Präludium")
    score = load_score(saved(text.replace("UTF-8", declared).encode(stored)))
    assert score.title == "Präludium"


@pytest.mark.parametrize(
    ("printed", "number"), [("17", 17), ("0", 0), ("X1", 1), ("", 1), ("9" * 5000, 1), ("²", 1)]
)
def test_bars_without_a_number_that_can_be_read_are_counted(printed, number, saved):
    text = document([FOUR_QUARTERS + note("C4", 4)]).replace('number="1"', f'number="{printed}"')
    (bar,) = load_score(saved(text)).bars
    assert bar.number == number


def test_tempo_ties_grace_notes_pedal_and_dynamics(read):
    first = (
        FOUR_QUARTERS
        + tempo(60)
        + direction("<dynamics><f/></dynamics>")
        + direction('<pedal type="start"/>')
        + note("C5", 16, inside='<tie type="start"/>')
    )
    second = (
        tempo(120)
        + note("C5", 8, inside='<tie type="stop"/>')
        + direction('<pedal type="stop"/>')
        + note("B4", 0, grace=True)
        + note("A4", 0, grace=True)
        + note("G4", 8)
    )
    score = read(first, second)
    graces = [(4.8, 4.9, 71), (4.9, 5.0, 69)]
    assert played(score) == [(0.0, 5.0, 72), *graces, (5.0, 6.0, 67)]
    assert score.pedal == (PedalEvent(0.0, 127), PedalEvent(5.0, 0))
    assert {n.velocity for n in score.notes} == {96}


SLOW, CUE = FOUR_QUARTERS + tempo(60), note("D4", 4).replace("<note>", "<note><cue/>")
LATER = tempo(240).replace("<sound", '<offset sound="yes">8</offset><sound')
BACK_AND_ON = "<backup><duration>8</duration></backup>{}<forward><duration>8</duration></forward>"
PLAYED = {
    "grace notes before the first beat come first": (
        [FOUR_QUARTERS + note("B4", 0, grace=True) + note("C5", 4)],
        [(0.0, 0.1, 71), (0.1, 0.6, 72)],
    ),
    "grace notes at the end of a bar are played there": (
        [FOUR_QUARTERS + note("C4", 16) + note("D4", 0, grace=True) + AGAIN],
        [(0.0, 2.0, 60), (1.9, 2.0, 62), (2.0, 4.0, 60), (3.9, 4.0, 62)],
    ),
    "a repeat may end within a measure": (
        [
            FOUR_QUARTERS + note("C4", 8) + AGAIN.replace("right", "middle") + note("D4", 8),
            note("E4", 16),
        ],
        [(0.0, 1.0, 60), (1.0, 2.0, 60), (2.0, 3.0, 62), (3.0, 5.0, 64)],
    ),
    "repeats of more than twice are played as often": (
        [FOUR_QUARTERS + note("C4", 16) + AGAIN.replace("<repeat ", '<repeat times="3" ')],
        [(0.0, 2.0, 60), (2.0, 4.0, 60), (4.0, 6.0, 60)],
    ),
    "a segno after the last note is that of the next bar": (
        [
            FOUR_QUARTERS + note("C4", 16) + jump('segno="s"'),
            note("D4", 16) + jump('dalsegno="s"'),
        ],
        [(0.0, 2.0, 60), (2.0, 4.0, 62), (4.0, 6.0, 62)],
    ),
    "the tempo may change while a note is held": (
        [SLOW + note("C4", 16) + BACK_AND_ON.format(tempo(240)), note("E4", 16)],
        [(0.0, 2.5, 60), (2.5, 3.5, 64)],
    ),
    "the tempo may change later than its sign stands": (
        [SLOW + LATER + note("C4", 16)],
        [(0.0, 2.5, 60)],
    ),
    "but not where it does so on paper only": (
        [SLOW + LATER.replace(' sound="yes"', "") + note("C4", 16)],
        [(0.0, 1.0, 60)],
    ),
    "a tempo after the end means nothing": (
        [FOUR_QUARTERS + note("C4", 16) + '<sound tempo="60"><offset>2</offset></sound>'],
        [(0.0, 2.0, 60)],
    ),
    "cue notes are silent but last": (
        [FOUR_QUARTERS + note("C4", 4) + CUE + CUE.replace("/>", "/><chord/>") + note("E4", 4)],
        [(0.0, 0.5, 60), (1.0, 1.5, 64)],
    ),
    "durations need not be whole": (
        [FOUR_QUARTERS + note("C4", 1.5) + note("D4", 2.5) + note("E4", 4)],
        [(0.0, 0.1875, 60), (0.1875, 0.5, 62), (0.5, 1.0, 64)],
    ),
}


@pytest.mark.parametrize(("bars", "expected"), PLAYED.values(), ids=PLAYED)
def test_when_notes_are_played(bars, expected, read):
    score = read(*bars)
    assert (played(score), score.remarks) == (expected, ())


def test_a_change_of_the_pedal_lifts_it_and_presses_it_again(read):
    start, change, stop = (direction(f'<pedal type="{of}"/>') for of in ("start", "change", "stop"))
    first = FOUR_QUARTERS + tempo(60) + start + note("C4", 8) + change + note("D4", 8)
    score = read(first, note("E4", 16) + stop)
    moves = [(0.0, 127), (2.0, 0), (2.0, 127), (8.0, 0)]
    assert [(event.time, event.value) for event in score.pedal] == moves


@pytest.mark.parametrize(("offset", "seconds"), [(4, 0.5), (-4, 0.0), (100, 2.0)])
def test_pedal_marks_sound_at_their_offset(offset, seconds, read):
    start, stop = (direction(f'<pedal type="{of}"/>') for of in ("start", "stop"))
    later = start.replace("</direction>", f'<offset sound="yes">{offset}</offset></direction>')
    bars = [FOUR_QUARTERS + later + note("C4", 16), note("D4", 16) + stop]
    score = read(*bars)
    assert [(event.time, event.value) for event in score.pedal] == [(seconds, 127), (4.0, 0)]


@pytest.mark.parametrize("beat_type", ["-4", "0", "3", "1000000000", "x"])
def test_beats_that_cannot_be_are_quarters(beat_type, read):
    strange = FOUR_QUARTERS.replace("<beat-type>4<", f"<beat-type>{beat_type}<")
    (bar,) = read(strange + note("C4", 16)).bars
    assert (bar.beats, bar.beat_type) == ((0.0, 0.5, 1.0, 1.5), 4)


def test_a_bar_without_measure_has_no_beats(read):
    (bar,) = read(FOUR_QUARTERS + note("C4", 4 * 1000)).bars
    assert (bar.time, bar.beats) == (0.0, ())


def test_notes_may_have_velocities_of_their_own(read):
    loud, soft = (note("C4", 4).replace("<note", f'<note dynamics="{p}"') for p in ("110.5", "0"))
    strange = note("E4", 4).replace("<note", '<note dynamics="loud"')
    bar = FOUR_QUARTERS + direction("<dynamics><p/></dynamics>") + loud + note("D4", 4)
    score = read(bar + strange + soft)
    assert [n.velocity for n in score.notes] == [99, 49, 49]  # in percent of 90
    assert score.remarks == ("1 note of no volume left out",)


def test_repeats_are_played_with_the_tempo_and_the_pedal_of_their_place(read):
    pedal = direction('<pedal type="start"/>'), direction('<pedal type="stop"/>')
    first = FOUR_QUARTERS + tempo(60) + pedal[0] + note("C4", 16)
    second = tempo(240) + note("D4", 16) + pedal[1] + AGAIN
    score = read(first, second, note("E4", 16))
    assert played(score) == [
        (0.0, 4.0, 60),
        (4.0, 5.0, 62),
        (5.0, 9.0, 60),
        (9.0, 10.0, 62),
        (10.0, 11.0, 64),
    ]
    assert [(e.time, e.value) for e in score.pedal] == [(0, 127), (5, 0), (5, 127), (10, 0)]


@pytest.mark.parametrize("fine", ['fine="yes"', 'fine="4"'])
def test_da_capo_al_fine(fine, read):
    measures = [
        FOUR_QUARTERS + note("C4", 16) + jump(fine),
        note("D4", 16) + '<sound dacapo="yes"/>',
    ]
    assert pitches(read(*measures)) == [60, 62, 60]


@pytest.mark.parametrize(("label", "at_the_end"), [("1", False), ("S2", True)])
def test_dal_segno_al_coda(label, at_the_end, read):
    to_coda, dal_segno = jump('tocoda="c"'), jump(f'dalsegno="{label}"')
    measures = [
        FOUR_QUARTERS + note("C4", 16),
        jump(f'segno="{label}"') + note("D4", 16),
        note("E4", 16) + to_coda if at_the_end else to_coda + note("E4", 16),
        note("F4", 16) + dal_segno if at_the_end else dal_segno + note("F4", 16),
        jump('coda="c"') + note("G4", 16),
    ]
    score = read(*measures)
    assert pitches(score) == [60, 62, 64, 65, 62, 64, 67]
    assert score.remarks == ()
    assert [bar.number for bar in score.bars] == [1, 2, 3, 4, 2, 3, 5]


def test_jumps_that_cannot_be_followed_are_told(read):
    measures = [FOUR_QUARTERS + note("C4", 16) + jump('dalsegno="s"'), note("D4", 16)]
    score = read(*measures)
    assert pitches(score) == [60, 62]
    assert score.remarks == ("1 jump without a segno or coda to go to left out",)


def test_bars_that_are_never_reached_are_told(read):
    measures = [
        FOUR_QUARTERS + jump('tocoda="c"') + note("C4", 16),
        note("D4", 16) + jump('dacapo="yes"'),
        note("E4", 16),
        jump('coda="c"') + note("F4", 16),
    ]
    score = read(*measures)
    assert pitches(score) == [60, 62, 60, 65]
    assert score.remarks == ("1 bar passed over by all repeats and jumps",)


def test_a_tie_leads_into_each_ending(read):
    def ending(number, music, after=""):
        bracket = f'<ending number="{number}" type="{{}}"/>'
        left = f'<barline location="left">{bracket.format("start")}</barline>'
        return f'{left}{music}<barline location="right">{bracket.format("stop")}{after}</barline>'

    tied = note("C4", 16, inside='<tie type="stop"/>')
    measures = [
        FOUR_QUARTERS + note("C4", 16, inside='<tie type="start"/>'),
        ending(1, tied, '<repeat direction="backward"/>'),
        ending(2, tied),
    ]
    score = read(*measures)
    assert played(score) == [(0.0, 4.0, 60), (4.0, 8.0, 60)]
    assert score.tracks[0].notes == 1


def test_measures_begin_together_in_all_parts(saved):
    upper = [FOUR_QUARTERS + note("C5", 8), note("D5", 16)]
    lower = [FOUR_QUARTERS + note("C3", 16), note("D3", 16)]
    score = load_score(saved(document(upper, lower)))
    assert played(score) == [(0.0, 2.0, 48), (0.0, 1.0, 72), (2.0, 4.0, 50), (2.0, 4.0, 74)]


def test_what_is_not_played_is_told(read):
    unpitched = note("E4", 8).replace("pitch>", "unpitched>")
    unpitched = unpitched.replace("step>", "display-step>").replace("octave>", "display-octave>")
    sign = '<measure-style><measure-repeat type="start">1</measure-repeat></measure-style>'
    again = f"<attributes>{sign}</attributes><note><rest/><duration>16</duration></note>"
    score = read(FOUR_QUARTERS + note("C4", 8) + unpitched, again)
    assert played(score) == [(0.0, 1.0, 60)]
    assert score.remarks == ("1 unpitched note left out", "1 bar-repeat sign left out")


@pytest.mark.parametrize(
    ("alter", "pitch", "remarks"),
    [("1.0", 61, ()), ("-1.5", 58, ("1 microtone rounded to a semitone",))],
)
def test_alterations_need_not_be_written_as_whole_numbers(alter, pitch, remarks, read):
    altered = note("C4", 4).replace("<octave>", f"<alter>{alter}</alter><octave>")
    score = read(FOUR_QUARTERS + altered)
    assert (pitches(score), score.remarks) == ([pitch], remarks)


def test_scores_ordered_by_measures_are_read(saved):
    text = document([FOUR_QUARTERS + note("C4", 16)], [FOUR_QUARTERS + note("E4", 16)])
    begin, end = text.index("<part id"), text.index("</score-partwise>")
    parts = [FOUR_QUARTERS + note(pitch, 16) for pitch in ("C4", "E4")]
    within = "".join(f'<part id="P{i}">{part}</part>' for i, part in enumerate(parts, start=1))
    text = text[:begin] + f'<measure number="1">{within}</measure>' + text[end:]
    score = load_score(saved(text.replace("score-partwise", "score-timewise")))
    assert played(score) == [(0.0, 2.0, 60), (0.0, 2.0, 64)]


def test_a_namespace_makes_no_difference(saved):
    text = document([FOUR_QUARTERS + note("C4", 16)])
    named = text.replace("<score-partwise", '<score-partwise xmlns="http://www.musicxml.org/ns"')
    assert pitches(load_score(saved(named))) == [60]
    text = re.sub(r"<(/?)(\w)", r"<\1m:\2", text).replace("partwise v", 'partwise xmlns:m="x" v')
    assert pitches(load_score(saved(text))) == [60]


def test_what_stands_in_comments_and_sections_of_text_is_not_counted(saved):
    notes = "<note/>" * 2 * MAX_NOTES
    music = f"<!--{notes}-->{FOUR_QUARTERS}{note('C4', 16)}"
    text = document([music], title=f"<![CDATA[{notes}]]>")
    assert pitches(load_score(saved(text))) == [60]


def test_nested_changes_of_the_pedal_do_not_double(read):
    change = direction('<pedal type="change"/>')
    inner = change
    for _ in range((MAX_DEPTH - 8) // 2):
        inner = f"<measure>{change[: -len('</direction>')]}{inner}</direction></measure>"
    assert pitches(read(FOUR_QUARTERS + inner + note("C4", 16))) == [60]


def test_an_archive_with_a_single_document_needs_no_contents(saved):
    text = document([FOUR_QUARTERS + note("C4", 16)])
    for names in (["a.xml"], ["a.xml", "b.musicxml"]):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            for name in names:
                archive.writestr(name, text)
        path = saved(out.getvalue(), "song.mxl")
        if len(names) == 1:
            assert pitches(load_score(path)) == [60]
        else:
            with pytest.raises(CadenzaError, match="2 documents, and no table of contents"):
                load_score(path)


def test_what_macos_adds_to_an_archive_is_no_document(saved):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("song/score.xml", document([FOUR_QUARTERS + note("C4", 16)]))
        archive.writestr("song/META-INF/container.xml", "<container/>")
        for added in ("__MACOSX/song/._score.xml", "song/._score.xml", "__MACOSX/a.xml"):
            archive.writestr(added, b"\0\5\26\7")
    assert pitches(load_score(saved(out.getvalue(), "song.mxl"))) == [60]


def test_there_may_be_any_number_of_repeats(read):
    measures = [FOUR_QUARTERS + note("C4", 4), *[note("C4", 4) + AGAIN] * 60]
    score = read(*measures)
    assert len(score.notes) == 2 * 61
    assert score.remarks == ()


def test_fingering_of_two_staves_is_taken_over(read):
    upper = note("C5", 8, 1, finger(1)) + note("G5", 8, 1, finger(5))
    lower = note("C3", 8, 2, finger(5)) + note("G3", 8, 2)
    score = read(FOUR_QUARTERS + upper + BACK + lower)
    assert [n.pitch for n in score.notes] == [48, 72, 55, 79]
    assert numbers(score) == [9, 0, -1, 4]


def test_two_staves_say_which_hand_plays_what(read):
    both = note("C5", 8, 1) + note("G4", 8, 1) + BACK + note("C3", 8, 2) + note("G4", 8, 2)
    score = read(FOUR_QUARTERS + both)
    assert [(n.pitch, n.hands) for n in score.notes] == [
        (48, (LEFT,)),
        (72, (RIGHT,)),
        (67, (RIGHT, LEFT)),
    ]


def test_on_one_staff_nobody_knows_whose_finger_it_is(read):
    score = read(FOUR_QUARTERS + note("C5", 8, 1, finger(1)))
    assert not score.has_fingering
    assert score.notes[0].hands == ()


def test_parts_are_tracks(saved):
    path = saved(document(*([FOUR_QUARTERS + note(p, 4)] for p in ("C5", "C4", "C3"))))
    score = load_score(path, tracks=(1, 3))
    assert [n.pitch for n in score.notes] == [48, 72]
    assert [(t.number, t.name, t.notes) for t in score.tracks] == [
        (1, "Part 1", 1),
        (2, "Part 2", 1),
        (3, "Part 3", 1),
    ]
    with pytest.raises(CadenzaError, match="no track 4; the file has tracks 1 to 3"):
        load_score(path, tracks=[4])


def test_a_part_without_measures_is_silent(saved):
    score = load_score(saved(document([FOUR_QUARTERS + note("C4", 4)], [])))
    assert pitches(score) == [60]


def test_a_message_repeats_only_the_beginning_of_a_long_name(saved):
    with pytest.raises(CadenzaError, match=r"\(it is <x{30,40}\.\.\.>\)"):
        load_score(saved(f"<{'x' * 5000}/>"))


@pytest.mark.parametrize(
    ("transposition", "sounds"),
    [
        ("<diatonic>-1</diatonic><chromatic>-2</chromatic>", 70),  # a clarinet
        ("<chromatic>0</chromatic><octave-change>-1</octave-change>", 60),  # a double bass
        ("<octave-change> 1 </octave-change>", 84),
        ("<chromatic>-2</chromatic><octave-change>-1</octave-change>", 58),  # a bass clarinet
        ("<chromatic>-2</chromatic><octave-change>low</octave-change>", 70),
    ],
)
def test_transposing_instruments_sound_as_they_do(transposition, sounds, read):
    attributes = f"<transpose>{transposition}</transpose></attributes>"
    attributes = FOUR_QUARTERS.replace("</attributes>", attributes)
    assert [n.pitch for n in read(attributes + note("C5", 4)).notes] == [sounds]


def test_a_transposition_holds_from_where_it_stands(read):
    def shift(semitones):
        return f"<attributes><transpose><chromatic>{semitones}</chromatic></transpose></attributes>"

    measures = [
        FOUR_QUARTERS + note("C4", 16),
        shift(-2) + note("C4", 16),
        shift(-3) + note("C4", 16),
    ]
    assert [n.pitch for n in read(*measures).notes] == [60, 58, 57]


@pytest.mark.parametrize("sign", ["p", "", " ", "thumb"])
def test_fingerings_that_are_no_numbers_are_left_out(sign, read):
    upper = note("C5", 8, 1, finger(sign)) + note("G5", 8, 1, finger(5))
    score = read(FOUR_QUARTERS + upper + BACK + note("C3", 16, 2))
    assert numbers(score) == [-1, -1, 4]
    assert score.remarks == ("1 unreadable fingering left out",)


@pytest.mark.parametrize("mark", ["0", "-90", "120,5", "nan", "fast", "1e9"])
def test_tempos_that_cannot_be_are_left_out(mark, read):
    score = read(FOUR_QUARTERS + tempo(mark) + note("C4", 4))
    assert played(score) == [(0.0, 0.5, 60)]
    assert score.remarks == ("1 impossible tempo left out",)


@pytest.mark.parametrize("duration", ["1e999999999", "1/3", "9" * 5000, "x"])
def test_durations_that_are_no_numbers_take_no_time(duration, read):
    notes = note("C4", 1.5) + note("D4", duration) + note("E4", 4)
    score = read(FOUR_QUARTERS + notes)
    assert played(score) == [(0.0, 0.1875, 60), (0.1875, 0.6875, 64)]
    assert score.remarks == ("1 note of no length left out",)


@pytest.mark.parametrize("divisions", ["4", "4.0", " 4.", "0.5"])
def test_whole_durations_may_be_written_as_decimals(divisions, read):
    quarters = float(divisions)
    back = f"<backup><duration>{2 * quarters:.2f}</duration></backup>"
    notes = note("C4", f"{quarters:.1f}") + note("D4", f"{quarters:.3f}")
    attributes = FOUR_QUARTERS.replace(">4</divisions>", f">{divisions}</divisions>")
    score = read(attributes + notes + back + note("C3", quarters))
    assert played(score) == [(0.0, 0.5, 48), (0.0, 0.5, 60), (0.5, 1.0, 62)]


def test_durations_too_fine_to_count_are_rounded(read):
    triplet = "".join(note(name, "1.333333333") for name in ("C4", "D4", "E4"))
    score = read(FOUR_QUARTERS + triplet + note("F4", 4))
    assert [n.pitch for n in score.notes] == [60, 62, 64, 65]
    starts = [n.start for n in score.notes]
    assert starts == pytest.approx([0.0, 1 / 6, 1 / 3, 0.5], abs=1e-4)


@pytest.mark.parametrize(
    "mark",
    [
        '<direction><offset sound="yes">-1</offset><sound tempo="60"/></direction>',
        '<sound tempo="60"><offset>-3</offset></sound>',
    ],
)
def test_a_tempo_before_the_beginning_holds_from_there(mark, read):
    score = read(FOUR_QUARTERS + mark + note("C4", 4) + note("D4", 12))
    assert played(score) == [(0.0, 1.0, 60), (1.0, 4.0, 62)]


def test_a_section_that_is_silent_when_repeated_without_end_takes_no_time(read):
    begin = '<barline location="left"><ending number="1" type="start"/></barline>'
    end = '<ending number="1" type="stop"/><repeat direction="backward" times="1000000000000"/>'
    music = f'{begin}{FOUR_QUARTERS}{note("C4", 16)}<barline location="right">{end}</barline>'
    assert pitches(read(music)) == [60]


PIECE = FOUR_QUARTERS + note("C4", 4)
LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
BLANKS = b" " * (MAX_XML_BYTES + 1)
MANY_NOTES = "<score-partwise>" + "<note/>" * (MAX_NOTES + 1)
NESTED = "<a>" * 350_000 + "</a>" * 350_000


def declaring(text, title="Little piece"):
    """A piece whose document begins with such a declaration."""
    return document([PIECE], title=title, head=f"<!DOCTYPE score-partwise [{text}]>")


def often(music):
    """A bar that is repeated a thousand times."""
    return music + AGAIN.replace("<repeat", '<repeat times="999"')


LAUGHING = declaring(f'<!ENTITY l0 "ha">{LAUGHS}', "&l9;")
CHANGE = direction('<pedal type="change"/>').replace("</direction>", f"{NESTED}</direction>")
TRILL = "<notations><ornaments><trill-mark/></ornaments></notations>"
UNUSUAL = "packed in an unusual way"
ATTACKS = {
    "billion laughs": (LAUGHING, "XML entities"),
    "billion laughs in UTF-16": (LAUGHING.encode("utf-16"), "XML entities"),
    "file of this machine": (
        declaring('<!ENTITY x SYSTEM "file:///etc/passwd">', "&x;"),
        "XML entities",
    ),
    "zip bomb": (compressed(BLANKS), "over 16 MiB unpacked"),
    "zip of nothing": (compressed(b"", "x")[:60], "damaged"),
    "zip that names nothing": (compressed(b"<a/>", "a", named="'"), "names one"),
    "zip without a score": (compressed(b"<a/>", "&quot;" * 10_000), "names one"),
    "packed by bzip2": (compressed(BLANKS, packing=zipfile.ZIP_BZIP2), UNUSUAL),
    "packed by LZMA": (compressed(BLANKS, packing=zipfile.ZIP_LZMA), UNUSUAL),
    "deep": ("<score-partwise>" + "<a>" * 350_000, "within each other"),
    "deep beside a change of the pedal": (document([CHANGE + PIECE]), "within each other"),
    "attributes for all": (
        declaring(f'<!ATTLIST note a CDATA "{"x" * 100_000}">'),
        "XML entities or the like",
    ),
    "too many tags": ("<score-partwise>" + "<a/>" * MAX_PARTS, "too large for a song"),
    "too many attributes": (
        "<score-partwise>" + '<a b="" c="" d=""/>' * (MAX_PARTS // 4),
        "too large for a song",
    ),
    "too many notes": (MANY_NOTES, "over 40000 notes"),
    "too many notes of a namespace": (
        MANY_NOTES.replace("<score-partwise", '<m:score-partwise xmlns:m="x"').replace(
            "<note", "<m:note"
        ),
        "over 40000 notes",
    ),
    "too many notes in UTF-16": (MANY_NOTES.encode("utf-16"), "over 40000 notes"),
    "too many repeats": (
        document([PIECE, *[often(note("C4", 4))] * 101]),
        "over 100000 bars with all repeats",
    ),
    "too many parts": (document(*[[FOUR_QUARTERS]] * 501), "over 500 parts"),
    "a trill of years": (
        document([FOUR_QUARTERS + note("C4", "999999999999", inside=TRILL)]),
        "hours; the longest is 4",
    ),
    "too many tempos with all repeats": (
        document([FOUR_QUARTERS + often((note("C4", 4) + tempo(90)) * 101)]),
        "over 100000",
    ),
    "timewise": ("<score-timewise/>", "there are no notes"),
    "not a score": ("<opus></opus>", "cannot be read as MusicXML"),
    "a page": ("\n<!DOCTYPE html><br>", "is a page (HTML), no music"),
    "cut short": (document([PIECE])[:-30], "cannot be read as MusicXML"),
    "not XML": (b"MThd and so on", "does not begin as XML"),
    "no notes": (document([FOUR_QUARTERS]), "there are no notes"),
    "no parts": (document(), "there are no notes"),
}


@pytest.mark.parametrize(("content", "message"), ATTACKS.values(), ids=ATTACKS.keys())
def test_attacks_and_accidents_end_in_one_line(content, message, saved):
    path = saved(content)
    with pytest.raises(CadenzaError) as error:
        read_musicxml(path)
    assert message in str(error.value)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


VALID = document([FOUR_QUARTERS + tempo(90) + note("C4", 4) + AGAIN, note("D4", 4, 1, finger(2))])


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.integers(0, len(VALID)), st.integers(0, 30), st.binary(max_size=20))
def test_damaged_files_read_or_explain(saved, at, gone, instead):
    data = VALID.encode()
    path = saved(data[:at] + instead + data[at + gone :])
    with contextlib.suppress(CadenzaError):
        assert read_musicxml(path).notes
