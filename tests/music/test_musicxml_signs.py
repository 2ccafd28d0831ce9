"""Signs of MusicXML that say in which order, how loud, how fast and by whom notes are played."""

import pytest

from cadenza.errors import CadenzaError
from cadenza.music.formats.musicxml.reader import read_musicxml
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note
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

TEMPO = FOUR_QUARTERS + tempo(60)


def words(text):
    return direction(f"<words>{text}</words>")


def bars(*signs):
    """Bars of one note each, with what stands before and after it."""
    pairs = [sign if isinstance(sign, tuple) else ("", sign) for sign in signs]
    made = [before + note(f"C{i}", 16) + after for i, (before, after) in enumerate(pairs, start=4)]
    return document([FOUR_QUARTERS + made[0], *made[1:]])


def order(score):
    """The numbers of bars as they are played."""
    return "".join(str(bar.number) for bar in score.bars)


MIDDLE = '<barline location="middle"><bar-style>light-light</bar-style></barline>'
SEGNO, CODA = direction("<segno/>"), direction("<coda/>")
AFTER_JUMP = AGAIN.replace("<repeat", '<repeat after-jump="yes"')


@pytest.mark.parametrize(
    ("signs", "expected"),
    [
        (("", words("Fine"), words("D.C. al Fine")), "12312"),
        (("", words(" FINE "), words("Da Capo al Fine")), "12312"),
        (("", words("Fin."), words("D.C.")), "12312"),
        (("", words("To Coda"), words("D. C. al Coda"), (words("Coda"), "")), "123124"),
        (("", words("On D.C. to Coda"), words("D.C."), (words("Coda"), "")), "123124"),
        (("", words("to \U0001d10c"), words("D.C."), (words("\U0001d10c"), "")), "123124"),
        (("", direction("<words>To</words><coda/>"), words("D.C."), (CODA, "")), "123124"),
        (("", CODA, words("D.C. al Coda"), (CODA, "")), "123124"),  # a sign is where it leads from
        (("", (SEGNO, ""), words("D.S.")), "12323"),
        (("", (words("\U0001d10b"), ""), words("dal segno")), "12323"),
        (("", (SEGNO, ""), SEGNO + words("D.S.")), "12323"),  # beside D.S. it is no goal
        ((SEGNO, "", words("D.S. al Fine")), "12323"),  # at the end of a bar: of the next
        (("", (SEGNO, words("al Coda")), jump('dalsegno="x"'), (CODA, "")), "12324"),
        (("<barline><segno/></barline>", "", words("D.S.")), "12323"),
        (("", words("Da capoeira, fine weather"), words("finely")), "123"),
    ],
)
def test_jumps_may_be_words_or_signs(signs, expected, saved):
    score = load_score(saved(bars(*signs)))
    assert (order(score), score.remarks) == (expected, ())


@pytest.mark.parametrize(
    ("signs", "expected"),
    [
        (("", (words("Trio"), ""), words("D.C.")), "1231"),
        (("", (words("Menuetto"), ""), (words("Trio"), words("Menuetto D.C.")), ""), "12324"),
        (("", words("Fine"), words("D.C. al Fine"), "", ""), "1231245"),  # another movement
        (("", words("D.C."), AGAIN, ""), "1231231234"),  # words stand before what they are for
    ],
)
def test_a_da_capo_is_of_its_movement(signs, expected, saved):
    assert order(load_score(saved(bars(*signs)))) == expected


@pytest.mark.parametrize(
    ("signs", "expected"),
    [
        ((jump('dacapo="yes" time-only="1"', "D.C."), AGAIN, ""), "11223"),
        (("", jump('dacapo="yes" time-only="3"', "D.C.") + AGAIN, ""), "12123"),
        (("", jump('tocoda="c" time-only="2"') + AGAIN, "", (CODA, "")), "12124"),
        ((AFTER_JUMP, '<sound dacapo="yes"/>', ""), "1121123"),
        (("", ('<sound forward-repeat="yes"/>', ""), AGAIN), "12323"),
    ],
)
def test_a_jump_or_repeat_may_say_when_it_is_taken(signs, expected, saved):
    assert order(load_score(saved(bars(*signs)))) == expected


@pytest.mark.parametrize("fine", ['<sound fine="8"/>', words("Fine") + MIDDLE])
def test_a_fine_may_be_within_a_bar(fine, read):
    end = note("D4", 8) + fine + note("E4", 8)
    measures = [TEMPO + note("C4", 16), end, note("F4", 16) + words("D.C.")]
    assert played(read(*measures))[4:] == [(12, 16, 60), (16, 18, 62)]


def test_a_bar_with_too_much_in_one_part_is_as_long_as_in_others(saved):
    upper = [FOUR_QUARTERS + note("C5", 16), note("D5", 16)]
    lower = [FOUR_QUARTERS + note("C3", 16) + note("C3", 16), note("D3", 16)]
    score = load_score(saved(document(upper, lower)))
    assert [(n.start, n.pitch) for n in score.notes if n.pitch != 48] == [
        (0.0, 72),
        (2.0, 50),
        (2.0, 74),
    ]


def test_notes_may_be_for_some_passes_only(read):
    second = note("G5", 16).replace("<note", '<note time-only="2, 3"')
    score = read(FOUR_QUARTERS + note("C4", 16) + BACK + second + AGAIN)
    assert played(score) == [(0.0, 2.0, 60), (2.0, 4.0, 60), (2.0, 4.0, 79)]


def marked(mark, staff=None):
    return direction(f"<dynamics>{mark}</dynamics>").replace(
        "</direction>", f"<staff>{staff}</staff></direction>" if staff else "</direction>"
    )


def test_a_dynamic_is_for_its_staff(read):
    upper = marked("<f/>", 1) + note("C5", 16) + BACK
    later = note("C5", 16) + BACK + marked("<pp/>", 2) + note("C3", 16, 2)
    score = read(FOUR_QUARTERS + upper + note("C3", 16, 2), later)
    # A staff without marks of its own follows those of the other.
    assert [(n.pitch, n.velocity) for n in score.notes] == [(48, 96), (72, 96), (48, 33), (72, 96)]


@pytest.mark.parametrize(
    ("mark", "velocities"),
    [
        (marked("<pppp/>"), (10, 10)),
        (marked("<pppppp/>"), (4, 4)),
        (marked("<ffff/>"), (127, 127)),
        (marked("<other-dynamics> FFF </other-dynamics>"), (126, 126)),
        (marked("<fp/>"), (96, 49)),
        (marked("<other-dynamics>dolce</other-dynamics>"), (80, 80)),
        (jump('dynamics="50"'), (45, 45)),
        (marked("<p/>").replace("</direction>", '<sound dynamics="60"/></direction>'), (54, 54)),
        ('<sound dynamics="x"/>', (80, 80)),
    ],
)
def test_dynamics(mark, velocities, read):
    score = read(FOUR_QUARTERS + mark + note("C4", 8) + note("D4", 8))
    assert tuple(n.velocity for n in score.notes) == velocities


def test_hairpins_lead_to_the_next_dynamic_unless_plain(saved):
    start, stop = (direction(f'<wedge type="{of}"/>') for of in ("crescendo", "stop"))
    bar = marked("<p/>") + start + note("C4", 8) + note("D4", 8) + stop + marked("<f/>")
    path = saved(document([FOUR_QUARTERS + bar, note("E4", 16)]))
    assert [n.velocity for n in read_musicxml(path).notes] == [49, 72, 96]
    assert [n.velocity for n in read_musicxml(path, plain=True).notes] == [49, 49, 96]


def test_dynamics_may_stand_at_notes(read):
    loud = note("C4", 8, inside="<notations><dynamics><ff/></dynamics></notations>")
    score = read(FOUR_QUARTERS + note("B3", 4) + loud + note("D4", 4))
    assert [n.velocity for n in score.notes] == [80, 112, 112]


def metronome(*units, per_minute):
    return direction(
        f"<metronome>{''.join(units)}<per-minute>{per_minute}</per-minute></metronome>"
    )


def unit(name, *more):
    return f"<beat-unit>{name}</beat-unit>{''.join(more)}"


@pytest.mark.parametrize(
    ("mark", "quarters_a_minute"),
    [
        (metronome(unit("32nd"), per_minute=240), 30),
        (metronome(unit("breve"), per_minute=20), 160),
        (metronome(unit("half"), per_minute="c. 60"), 120),
        (metronome(unit("quarter"), per_minute=0), 120),
        (metronome(unit("quarter", "<beat-unit-dot/><beat-unit-dot/>"), per_minute=40), 70),
        (metronome(unit("eighth"), per_minute="120,5"), 60.25),
        (
            metronome(
                unit("quarter"), f"<beat-unit-tied>{unit('16th')}</beat-unit-tied>", per_minute=40
            ),
            50,
        ),
    ],
)
def test_metronome_marks_of_any_note(mark, quarters_a_minute, read):
    score = read(FOUR_QUARTERS + mark + note("C4", 16))
    assert score.total_time == pytest.approx(240 / quarters_a_minute)
    score = read(FOUR_QUARTERS + tempo(30) + mark + note("C4", 16))
    assert score.total_time == pytest.approx(8)  # what is given for playback counts


def test_a_metronome_mark_counts_after_a_tempo_for_playback(read):
    later = metronome(unit("quarter"), per_minute=120) + note("D4", 16)
    score = read(TEMPO + note("C4", 16), later)
    assert played(score) == [(0.0, 4.0, 60), (4.0, 6.0, 62)]


def shown(name, inside=""):
    return f"<metronome-note><metronome-type>{name}</metronome-type>{inside}</metronome-note>"


@pytest.mark.parametrize(
    ("mark", "seconds"),
    [
        (unit("quarter") + unit("quarter", "<beat-unit-dot/>"), 8 / 3),
        (unit("eighth") + unit("quarter"), 2),
        (shown("half") + "<metronome-relation>equals</metronome-relation>" + shown("quarter"), 8),
    ],
)
def test_a_note_may_be_as_long_as_another_was(mark, seconds, read):
    equal = direction(f"<metronome>{mark}</metronome>") + note("D4", 16)
    score = read(TEMPO + note("C4", 16), equal)
    assert score.total_time - 4 == pytest.approx(seconds)
    marked = equal.replace("</direction>", '<sound tempo="30"/></direction>', 1)
    score = read(TEMPO + note("C4", 16), marked)
    assert score.total_time - 4 == 8


def test_a_metronome_mark_that_gives_no_tempo_is_told(read):
    unclear = metronome(unit("quarter"), per_minute="fast")
    score = read(FOUR_QUARTERS + unclear + note("C4", 16))
    assert score.remarks == ("1 metronome mark without a tempo left out",)


@pytest.mark.parametrize(
    ("words", "quarters_a_minute"),
    [
        ("Andante con moto", 92),
        ("ANDANTINO", 94),
        ("Allegro moderato", 118),
        ("Più allegro", 1.15 * 120),
        ("Largely by heart", 120),
    ],
)
def test_words_have_their_usual_tempo_in_a_file_without_any(read, words, quarters_a_minute):
    mark = direction(f"<words>{words}</words>")
    score = read(FOUR_QUARTERS + mark + note("C4", 16))
    assert score.total_time == pytest.approx(4 * 60 / quarters_a_minute)
    remarks = ("1 tempo word played as usual, as the file gives no tempo",)
    assert score.remarks == (remarks if quarters_a_minute in (92, 94, 118) else ())
    given = read(FOUR_QUARTERS + mark + note("C4", 16), tempo(60) + note("C4", 4))
    assert given.total_time == pytest.approx(2 / (1.15 if "Più" in words else 1) + 1)
    assert given.remarks == ()


def test_swing_and_what_is_plain(saved):
    swing = "<swing><first>2</first><second>1</second><swing-type>eighth</swing-type></swing>"
    path = saved(document([TEMPO + f"<sound>{swing}</sound>" + note("C4", 2) + note("D4", 2)]))
    assert [n.start for n in read_musicxml(path).notes] == pytest.approx([0, 2 / 3])
    assert [n.start for n in read_musicxml(path, plain=True).notes] == [0.0, 0.5]


def test_a_metronome_mark_may_show_swing(read):
    bracket = "<metronome-tuplet type='{}'><actual-notes>3</actual-notes>"
    bracket += "<normal-notes>2</normal-notes></metronome-tuplet>"
    of_three = shown("quarter", bracket.format("start")) + shown("eighth", bracket.format("stop"))
    two = shown("eighth") + shown("eighth") + "<metronome-relation>equals</metronome-relation>"
    mark = direction(f"<metronome>{two}{of_three}</metronome>")
    score = read(TEMPO + mark + note("C4", 2) + note("D4", 2))
    assert [each.start for each in score.notes] == pytest.approx([0, 2 / 3])


def test_fermatas_at_the_ends_of_lines_of_a_chorale_are_not_held(read):
    held = note("C4", 16, inside="<notations><fermata/></notations>")
    line = [note("D4", 16), held]
    few = read(TEMPO + note("B3", 16), *line * 3)
    chorale = read(TEMPO + note("B3", 16), *line * 4)
    assert (few.total_time, chorale.total_time) == (7 * 4 + 3 * 4, 9 * 4)


def test_signs_at_notes_are_played_unless_plain(saved):
    inside = (
        "<notations><ornaments><trill-mark/></ornaments>"
        "<articulations><staccato/></articulations></notations>"
    )
    path = saved(document([TEMPO + note("C4", 8, inside=inside) + note("E4", 8)]))
    assert {n.pitch for n in read_musicxml(path).notes} == {60, 62, 64}
    assert played(read_musicxml(path, plain=True)) == [(0.0, 2.0, 60), (2.0, 4.0, 64)]


def moves(score):
    return [(event.time, event.value) for event in score.pedal]


def test_the_pedal_may_be_for_playback_only(read):
    down, half, up = (f'<sound damper-pedal="{value}"/>' for value in ("yes", "50", "no"))
    bar = TEMPO + down + note("C4", 4) + half + note("D4", 4) + up + note("E4", 8)
    later = half.replace("/>", "><offset>4</offset></sound>")
    early = TEMPO + down + later + note("C4", 8) + up + note("E4", 8)
    for music in (bar, early):
        assert moves(read(music)) == [(0, 127), (1, 64), (2, 0)]


def test_a_pedal_without_a_stop_stays_down_and_may_be_pressed_again(read):
    start = direction('<pedal type="start"/>')
    bar = TEMPO + start + note("C4", 8) + start + note("D4", 8)
    assert moves(read(bar)) == [(0, 127), (2, 0), (2, 127)]


def test_the_pedal_is_down_while_any_part_holds_it(saved):
    start, stop = (direction(f'<pedal type="{of}"/>') for of in ("start", "stop"))
    one = TEMPO + start + note("C4", 8) + stop + note("D4", 8)
    other = FOUR_QUARTERS + note("C4", 4) + start + note("D4", 8) + stop + note("E4", 4)
    assert moves(load_score(saved(document([one], [other])))) == [(0, 127), (3, 0)]


def test_the_sostenuto_pedal_holds_what_sounds_when_it_goes_down(read):
    sign, stop = direction('<pedal type="sostenuto"/>'), direction('<pedal type="stop"/>')
    sustain, lifted = sign.replace("sostenuto", "start"), stop.replace("/", ' number="2"/', 1)
    second = sign.replace("/", ' number="2"/', 1)
    lift = direction("<words>sost. ped.</words>").replace(
        "</direction>", '<sound sostenuto-pedal="{}"/></direction>'
    )
    notes = note("C4", 4), note("D4", 4), note("E4", 8)
    for down, up in ((sign, stop), (lift.format("yes"), lift.format("no"))):
        music = [TEMPO + down + notes[0] + notes[1] + up + notes[2]]
        score = read(*music)
        assert played(score) == [(0, 2, 60), (1, 2, 62), (2, 4, 64)]
        assert (score.pedal, score.remarks) == ((), ())
    both = [TEMPO + sustain + second + notes[0] + lifted + notes[1] + stop + notes[2]]
    assert [(each.time, each.value) for each in read(*both).pedal] == [
        (0, 127),
        (2, 0),
    ]


@pytest.mark.parametrize(
    ("sign", "remark"),
    [
        (words("Una corda"), "the soft pedal is left out"),
        ('<sound soft-pedal="yes"/>', "the soft pedal is left out"),
        (words("Sost. Ped."), "1 sostenuto pedal left out, as only words tell of it"),
        ('<sound tempo="90" time-only="2"/>', "1 sound for single passes left out"),
    ],
)
def test_what_no_key_or_pedal_does_is_told(sign, remark, read):
    score = read(TEMPO + sign + note("C4", 16) + AGAIN)
    assert (played(score), score.remarks) == ([(0, 4, 60), (4, 8, 60)], (remark,))


def test_a_voice_keeps_its_hand_on_the_other_staff(read):
    def fingered(pitch, voice, staff, number):
        return note(pitch, 8, staff, finger(number)).replace(f"<voice>{staff}", f"<voice>{voice}")

    upper = fingered("C5", 1, 1, 5) + fingered("C4", 1, 2, 1)
    lower = fingered("C3", 2, 2, 5) + fingered("E4", 2, 1, 1)
    alone = fingered("D4", 1, 2, 2) + fingered("F4", 1, 2, 3)  # still the right hand
    score = read(TEMPO + upper + BACK + lower, alone)
    hands = {n.pitch: (n.finger.hand, *n.hands) for n in score.notes}
    assert hands == {72: (0, 0), 60: (0, 0), 48: (1, 1), 64: (1, 1), 62: (0, 0), 65: (0, 0)}


def test_voices_of_one_name_on_both_staves_are_two(read):
    lower = note("C3", 16, 2).replace("<voice>2", "<voice>1")
    score = read(FOUR_QUARTERS + note("C5", 16) + BACK + lower)
    assert {n.pitch: n.hands for n in score.notes} == {72: (0,), 48: (1,)}


def test_a_percussion_clef_means_drums(saved):
    clef = FOUR_QUARTERS.replace("</attr", "<clef><sign>percussion</sign></clef></attr")
    drums = clef + note("C3", 16)
    assert pitches(load_score(saved(document([FOUR_QUARTERS + note("C4", 16)], [drums])))) == [60]


def test_parts_of_drums_are_left_out(saved):
    text = document([FOUR_QUARTERS + note("C4", 16)], [FOUR_QUARTERS + note("C3", 16)])
    name = "<part-name>Part 2</part-name>"
    for sign in ("<midi-channel>10</midi-channel>", "<midi-unpitched>37</midi-unpitched>"):
        drums = f'<midi-instrument id="P2-I1">{sign}</midi-instrument>'
        score = load_score(saved(text.replace(name, name + drums)))
        assert (pitches(score), len(score.tracks)) == ([60], 1)
        assert score.remarks == ("1 note of drums left out",)


def test_a_key_held_by_one_voice_and_struck_by_another_is_held_on(read):
    rest = "<note><rest/><duration>4</duration><voice>2</voice></note>"
    bar = TEMPO + note("C4", 16) + BACK + rest + note("C4", 4, 2)
    assert played(read(bar)) == [(0.0, 1.0, 60), (1.0, 4.0, 60)]


def test_notes_of_a_chord_may_be_shorter_and_grace_notes_a_chord(read):
    def in_chord(text):
        return text.replace("<pitch>", "<chord/><pitch>")

    graces = note("A4", 0, grace=True) + in_chord(note("D5", 0, grace=True))
    chord = note("C4", 8) + in_chord(note("E4", 4))
    score = read(TEMPO + chord + graces + note("F4", 8))
    assert played(score) == [
        (0.0, 2.0, 60),
        (0.0, 1.0, 64),
        (1.9, 2.0, 69),
        (1.9, 2.0, 74),
        (2.0, 4.0, 65),
    ]


def test_a_grace_note_tied_to_its_note_is_that_note(read):
    grace = note("C4", 0, grace=True, inside='<tie type="start"/>')
    tied = note("C4", 16, inside='<tie type="stop"/>')
    assert played(read(TEMPO + grace + tied)) == [(0.0, 4.0, 60)]


@pytest.mark.parametrize("pitch", [("<octave>4", "<octave>four"), ("<step>C", "<step>H")])
def test_a_pitch_that_cannot_be_read_is_told(pitch, read):
    unreadable = note("C4", 8).replace(*pitch)
    score = read(TEMPO + unreadable + note("D4", 8))
    assert pitches(score) == [62]
    assert score.remarks == ("1 note with an unreadable <step> or <octave> left out",)


def test_an_accidental_shows_and_an_alteration_sounds(read):
    shown = note("A4", 8, inside="<accidental>sharp</accidental>")
    sounds = note("A4", 8).replace("<octave>", "<alter>1</alter><octave>")
    assert pitches(read(FOUR_QUARTERS + shown + sounds)) == [69, 70]


@pytest.mark.parametrize("empty", ["<direction/>", direction(""), "<barline/>", "<note/>"])
def test_empty_elements_mean_nothing(empty, read):
    score = read(FOUR_QUARTERS + empty + note("A4", 16))
    assert (score.notes, score.remarks) == ((Note(0.0, 2.0, 69, tracks=(1,)),), ())


def test_an_empty_bar_is_as_long_as_its_metre(read):
    score = read(FOUR_QUARTERS + note("C4", 4), "", note("D4", 4))
    assert played(score) == [(0.0, 0.5, 60), (2.5, 3.0, 62)]


@pytest.mark.parametrize(
    "named",
    [
        "./a b/score.xml",
        "/a%20b/Score.xml",
        "a b\\score.xml",
        'a.pdf"/><rootfile full-path="a b/score.xml',
        '"/><!-- full-path="a.xml" --><rootfile full-path="a b/score.xml',
        "lost.xml",
    ],
)
def test_programs_differ_in_how_they_name_a_document(named, saved):
    text = document([FOUR_QUARTERS + note("C4", 16)])
    path = saved(compressed(text, name="a b/score.xml", named=named), "song.mxl")
    assert pitches(load_score(path)) == [60]


def test_mei_is_named(saved):
    path = saved('<?xml version="1.0"?><m:mei xmlns:m="x"><m:music/></m:mei>', "song.xml")
    with pytest.raises(CadenzaError, match=r"MEI.* MuseScore"):
        load_score(path)


@pytest.mark.parametrize(
    ("words_at_the_end", "expected"),
    [
        ("Menuetto primo D.C. senza repliche", "12312"),
        ("2nd time D.C. (without repeats) al Fine", "12312"),
        ("Da Capo, poi segue la Coda", "12312"),
        ("voice tacet on D.C.", "123"),
        ("The D.C. al Fine is played softer", "123"),
        ("D.C. only", "123"),
        ("D.C. al Fine was added by the editor", "123"),
    ],
)
def test_words_may_mention_a_jump_that_is_none(words_at_the_end, expected, saved):
    assert order(load_score(saved(bars("", words("Fine"), words(words_at_the_end))))) == expected


def pitched(pitch, duration, tie="", ornament="", inside=""):
    ties = "".join(f'<tie type="{kind}"/>' for kind in tie.split())
    ornaments = f"<notations><ornaments>{ornament}</ornaments></notations>" if ornament else ""
    return note(pitch, duration, inside=ties + inside + ornaments)


SECOND = '<barline location="left"><ending number="2" type="start"/></barline>'
FIRST = SECOND.replace("2", "1", 1)


@pytest.mark.parametrize(
    ("first", "after"),
    [
        (pitched("C4", 16, "start") + AGAIN, pitched("C4", 16, "stop")),  # a repeat of one bar
        (pitched("C4", 16, "start") + AGAIN, pitched("C4", 16)),  # without the end of the tie
    ],
)
def test_no_tie_leads_back_to_the_beginning_of_a_repeat(first, after, read):
    score = read(TEMPO + first, after)
    assert played(score) == [(0, 4, 60), (4, 12, 60)]


@pytest.mark.parametrize(("tie", "struck"), [("stop", [0, 8]), ("", [0, 8, 12])])
def test_a_tie_leads_into_a_second_ending_if_it_ends_there(tie, struck, read):
    first = FIRST + pitched("C4", 16, "stop") + AGAIN.replace("<rep", '<ending number="1"/><rep')
    second = SECOND + pitched("C4", 16, tie)
    score = read(TEMPO + pitched("C4", 16, "start"), first, second)
    assert [n.start for n in score.notes] == struck


def test_an_ornament_on_the_later_part_of_a_tie_begins_there(read):
    mark = "<trill-mark/>"
    later = pitched("C4", 8, "start") + pitched("C4", 4, "stop", mark)
    starts = [n.start for n in read(TEMPO + later).notes]
    assert starts[:2] == [0, 2]
    assert len(starts) == 1 + 12
    both = pitched("C4", 8, "start", mark) + pitched("C4", 4, "stop", mark)
    notes = read(TEMPO + both).notes
    assert [n.pitch for n in notes] == [62, 60] * 18


@pytest.mark.parametrize(
    ("sign", "expected"),
    [
        ('<trill-mark trill-step="half" beats="4"/>', [61, 60, 61, 60]),
        ('<trill-mark trill-step="whole" start-note="main" beats="3"/>', [60, 62, 60]),
        ('<trill-mark/><wavy-line type="start" trill-step="half" beats="2"/>', [61, 60]),
        ('<trill-mark beats="4" two-note-turn="half"/>', [62, 60, 62, 60, 59, 60]),
        ('<mordent trill-step="half"/>', [60, 59, 60]),
        ('<mordent beats="5" start-note="below"/>', [59, 60, 59, 60, 59, 60]),
        ('<inverted-mordent trill-step="half" two-note-turn="whole"/>', [60, 61, 60, 58, 60]),
        ('<turn trill-step="half" start-note="main"/>', [60, 61, 60, 59, 60]),
        ('<trill-mark beats="999999999999"/>', [62, 60] * 10),  # of 0.05 s each
    ],
)
def test_what_is_said_for_playback_of_ornaments(sign, expected, read):
    score = read(TEMPO + pitched("C4", 4, ornament=sign))
    assert pitches(score) == expected


def test_a_trill_may_accelerate(read):
    mark = '<trill-mark beats="6" accelerate="yes"/>'
    notes = read(TEMPO + pitched("C4", 4, ornament=mark)).notes
    lengths = [n.end - n.start for n in notes]
    assert sum(lengths) == pytest.approx(1)
    assert sorted(lengths, reverse=True) == lengths
    assert lengths[0] > 1.5 * lengths[-1]


def wedge(kind, more=""):
    return direction(f'<wedge type="{kind}" {more}/>')


@pytest.mark.parametrize(
    ("begin", "end", "velocities"),
    [
        (wedge("crescendo", 'niente="yes"'), wedge("stop"), [1, 48, 96]),
        (wedge("diminuendo"), wedge("stop", 'niente="yes"'), [96, 48, 1]),
        (wedge("diminuendo", 'niente="yes"'), wedge("stop"), [96, 48, 1]),
        (words("dim. al niente"), marked("<p/>"), [96, 48, 49]),
    ],
)
def test_hairpins_from_and_to_silence(begin, end, velocities, read):
    bar = marked("<f/>") + begin + note("C4", 8) + note("D4", 8) + end
    score = read(FOUR_QUARTERS + bar, note("E4", 16))
    assert [n.velocity for n in score.notes] == velocities


@pytest.mark.parametrize("line", ["dashes", "bracket"])
def test_a_line_after_words_is_as_long_as_the_change(line, read):
    begin, stop = (direction(f'<{line} type="{of}" number="1"/>') for of in ("start", "stop"))
    together = begin.replace("><d", "><direction-type><words>cresc.</words></direction-type><d", 1)
    for sign in (words("cresc.") + begin, together):
        bar = marked("<p/>") + sign + note("C4", 8) + note("D4", 8) + stop
        after = [note("E4", 16), marked("<f/>") + note("F4", 16)]
        score = read(FOUR_QUARTERS + bar, *after)
        assert [n.velocity for n in score.notes] == [49, 57, 65, 96]


SLASHED = "<attributes><measure-style><slash type='{}'/></measure-style></attributes>"
A_SLASH = "1 note that a slash stands for left out"
SILENT = "1 note of no volume left out"
SLIDE = '<notations><slide type="start"/></notations>'
HIGH, HALF, LONG = [(4, 8, 72)], [(0, 2, 60)], [(0, 4, 60)]  # notes that are played


@pytest.mark.parametrize(
    ("music", "expected", "remark"),
    [
        ([note("B4", 16, inside="<notehead>slash</notehead>"), note("C5", 16)], HIGH, A_SLASH),
        (
            [SLASHED.format("start") + note("B4", 16), SLASHED.format("stop") + note("C5", 16)],
            HIGH,
            A_SLASH,
        ),
        ([note("C4", 8) + note("D4", 8).replace("<note", '<note dynamics="0"')], HALF, SILENT),
        ([note("C4", 8) + '<sound dynamics="0"/>' + note("D4", 8)], HALF, SILENT),
        (
            ["<harmony><kind>major</kind></harmony>" + note("C4", 16)],
            LONG,
            "1 chord symbol left out",
        ),
        ([note("C4", 16, inside=SLIDE)], LONG, "1 glissando left out"),
    ],
)
def test_what_is_not_played_as_a_pitch_is_told(music, expected, remark, read):
    score = read(TEMPO + music[0], *music[1:])
    assert (played(score), score.remarks) == (expected, (remark,))


@pytest.mark.parametrize("kind", ["ossia", "cue", "alternate", "editorial"])
def test_a_staff_that_is_not_played_is_left_out_and_is_no_hand(kind, read):
    details = f'<staves>3</staves><staff-details number="1"><staff-type>{kind}</staff-type>'
    head = TEMPO.replace("</attributes>", f"{details}</staff-details></attributes>", 1)
    bar = note("C6", 16, 1) + BACK + note("C5", 16, 2) + BACK + note("C3", 16, 3)
    score = read(head + bar)
    assert [(n.pitch, n.hands) for n in score.notes] == [(48, (1,)), (72, (0,))]
    assert score.remarks == ("1 note of an ossia, or on a staff for reference, left out",)


def test_notes_of_cue_size_are_played(read):
    small = note("C4", 16, inside='<type size="cue">whole</type>')
    assert pitches(read(FOUR_QUARTERS + small)) == [60]


def test_parts_of_no_volume_are_silent_until_they_have_some(saved):
    text = document(
        [FOUR_QUARTERS + note("C4", 16)], [FOUR_QUARTERS + note("C5", 16), "{}" + note("D5", 16)]
    )
    name = "<part-name>Part 2</part-name>"
    silent = '<midi-instrument id="P2-I1"><volume>{}</volume></midi-instrument>'
    text = text.replace(name, name + silent.format(0))
    score = load_score(saved(text.replace("{}", "")))
    assert (pitches(score), score.remarks) == ([60], ("2 notes of no volume left out",))
    score = load_score(saved(text.replace("{}", f"<sound>{silent.format(80)}</sound>")))
    assert pitches(score) == [60, 74]


@pytest.mark.parametrize(("double", "pitch"), [("<double/>", 36), ('<double above="yes"/>', 60)])
def test_music_may_be_doubled_an_octave_away(double, pitch, read):
    attributes = FOUR_QUARTERS.replace(
        "</attr", f"<transpose><chromatic>0</chromatic>{double}</transpose></attr"
    )
    score = read(attributes + note("C3", 16))
    assert sorted(pitches(score)) == sorted([48, pitch])


@pytest.mark.parametrize(
    "more",
    [
        "<note><rest/><duration>4</duration><voice>2</voice></note>",
        "<forward><duration>4</duration></forward>",
    ],
)
def test_rests_do_not_make_a_bar_longer(more, read):
    bar = TEMPO + note("C4", 16) + BACK + note("C3", 8, 2) + more * 3
    assert played(read(bar, note("D4", 16)))[2] == (4, 8, 62)


def test_bars_have_the_fermatas_over_their_notes(read):
    held = note("D4", 8, inside="<notations><fermata/></notations>")
    score = read(FOUR_QUARTERS + note("C4", 8) + held, note("E4", 16))
    assert [bar.fermatas for bar in score.bars] == [(1.0,), ()]
