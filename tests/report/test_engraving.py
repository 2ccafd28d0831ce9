"""Engraved scores: drawings in which notes are known, and pages of PDF."""

import base64
import json
import re
import zlib
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from cadenza.fingers import LEFT, RIGHT, Finger
from cadenza.music.etudes.library import make_etude
from cadenza.music.formats.musicxml_writing import musicxml_of
from cadenza.music.libraries.library import load_score
from cadenza.music.notation.sheet import sheet_of
from cadenza.music.score import Bar, Note, Score
from cadenza.report.engraving import engraved, engraving_of, engraving_within
from cadenza.report.sheet_pdf import write_pdf

SVG = "{http://www.w3.org/2000/svg}"
BEAT = 0.5  # [s]
SPACE = 180  # between two lines of a staff, in units of a drawing
CLEAR = SPACE / 4  # of a stem, on either side


def bars(count):
    begins = [4 * BEAT * n for n in range(count)]
    beats = [tuple(begin + BEAT * k for k in range(4)) for begin in begins]
    return tuple(map(Bar, begins, range(1, count + 1), beats))


@pytest.fixture(scope="module")
def score():
    """Four bars: a note tied over two bar lines, under others of the right hand, and chords."""
    upper = [
        Note(BEAT * i, BEAT * (i + 1), 72 + i % 5, finger=Finger(RIGHT, i % 5)) for i in range(16)
    ]
    held = [Note(0, 12 * BEAT, 60, finger=Finger(RIGHT, 0))]
    lower = [
        Note(4 * BEAT * i, 4 * BEAT * (i + 1), pitch, finger=Finger(LEFT, 4))
        for i in range(4)
        for pitch in (36, 43)
    ]
    return Score(tuple(upper + held + lower), title="<Tied> & held", bars=bars(4))


def drawings(engraving):
    """The systems as XML."""
    return [ElementTree.fromstring(f"<svg>{system.svg}</svg>") for system in engraving.systems]


def drawn_notes(engraving):
    return [note for drawing in drawings(engraving) for note in drawing.iter("g")]


def test_the_sign_of_a_rolled_chord_is_turned_in_a_pdf(tmp_path):
    chord = [Note(0.05 * i, 2.0, pitch) for i, pitch in enumerate((60, 64, 67, 72))]
    write_pdf(Score(tuple(chord), bars=(Bar(0.0, 1, (0.0, 0.5, 1.0, 1.5)),)), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    assert re.search(r"q -?0\.0000 -1\.0000 1\.0000 -?0\.0000 [-\d.]+ [-\d.]+ cm\nq 1 0 0 1", page)


def test_every_note_is_drawn_with_all_that_it_is_tied_to(score):
    sheet = sheet_of(score)
    numbers = [int(note.get("data-note")) for note in drawn_notes(engraved(sheet))]
    assert set(numbers) == set(range(len(score.notes)))
    held = sheet.notes.index(next(note for note in score.notes if note.pitch == 60))
    assert {number for number in numbers if numbers.count(number) > 1} == {held}
    assert numbers.count(held) == 3


def test_higher_notes_are_drawn_higher(score):
    sheet = sheet_of(score)
    heights = {}
    for note in drawn_notes(engraved(sheet)):
        heights[sheet.notes[int(note.get("data-note"))].pitch] = int(note.find("use").get("y"))
    assert sorted(heights, key=heights.get, reverse=True) == sorted(heights)


def test_fingers_stand_above_the_right_hand_and_below_the_left(score):
    (drawing,) = drawings(engraved(sheet_of(score)))
    fingers = [text for text in drawing.iter("text") if text.get("class") == "fing"]
    heads = [int(use.get("y")) for note in drawing.iter("g") for use in note.findall("use")[:1]]
    above = sorted(text.text for text in fingers if int(text.get("y")) < min(heads))
    below = [text.text for text in fingers if int(text.get("y")) > max(heads)]
    assert above == sorted([*(str(i % 5 + 1) for i in range(16)), "1"])
    assert below == ["5"] * 8


def test_numbers_of_fingers_are_clear_of_heads_stems_and_each_other():
    """Also beside stems that reach beyond a staff, and above two voices."""
    notes = []
    for i in range(64):
        upper, lower = Finger(RIGHT, i % 5), Finger(LEFT, 3 * i % 5)
        at = BEAT * i
        notes.append(Note(at, at + BEAT, 60 + 7 * i % 23, finger=upper))
        notes.append(Note(at, at + BEAT, 40 + 5 * i % 19, finger=lower))
        if i % 3 == 0:  # a second voice, or a chord
            notes.append(Note(at, at + BEAT / (1 + i % 2), 38 + i % 9, finger=Finger(LEFT, 4)))
            notes.append(Note(at, at + BEAT / (1 + i % 2), 57 + i % 9, finger=Finger(RIGHT, 0)))
    engraving = engraved(sheet_of(Score(tuple(notes), bars=bars(16))))
    for drawing in drawings(engraving):
        numbers = []
        for text in drawing.iter("text"):
            if text.get("class") == "fing":
                x, y, size = (int(text.get(name)) for name in ("x", "y", "font-size"))
                numbers.append((x - 0.21 * size, y - 0.68 * size, x + 0.21 * size, y))
        assert len(numbers) > 10
        obstacles = list(numbers)
        for use in drawing.iterfind(".//g[@class='note']/use"):  # heads, and accidentals as tall
            x, y = int(use.get("x")), int(use.get("y"))
            obstacles.append((x, y - SPACE / 2, x + 1.2 * SPACE, y + SPACE / 2))
        for line in drawing.iterfind(".//path"):
            x, y, along, down = map(int, re.findall(r"-?\d+", line.get("d"))[:4])
            if x == along:  # a stem or the line of a bar
                obstacles.append((x - CLEAR, min(y, down), x + CLEAR, max(y, down)))
        for i, (left, top, right, bottom) in enumerate(numbers):
            others = np.array(obstacles[:i] + obstacles[i + 1 :])
            beside = (others[:, 0] >= right) | (others[:, 2] <= left)
            assert np.all(beside | (others[:, 1] >= bottom) | (others[:, 3] <= top))


def test_fingers_of_a_chord_stand_in_a_column_in_the_order_of_its_notes():
    """Also where heads a second apart stand beside each other."""
    upper = [Note(0, BEAT, 72 + 2 * i, finger=Finger(RIGHT, i)) for i in range(3)]
    lower = [Note(0, BEAT, 48 + 2 * i, finger=Finger(LEFT, 2 - i)) for i in range(3)]
    (drawing,) = drawings(engraved(sheet_of(Score((*upper, *lower), bars=bars(1)))))
    numbers = [text for text in drawing.iter("text") if text.get("class") == "fing"]
    numbers.sort(key=lambda text: int(text.get("y")))
    assert [text.text for text in numbers] == ["3", "2", "1", "1", "2", "3"]
    assert len({text.get("x") for text in numbers}) == 1


def test_bars_follow_each_other_in_place_and_time():
    score = load_score("FurEliseOpening").with_initial_silence(0.5)
    sheet = sheet_of(score)
    bars = [bar for system in engraved(sheet).systems for bar in system.bars]
    assert [bar.number for bar in bars] == [written.measure.number for written in sheet.measures]
    assert [bar.begin for bar in bars[1:]] == pytest.approx([bar.end for bar in bars[:-1]])
    assert bars[0].begin <= score.notes[0].start
    assert bars[-1].end >= score.notes[-1].start
    for system in engraved(sheet).systems:
        edges = [(bar.left, bar.right) for bar in system.bars]
        assert all(left < right for left, right in edges)
        assert edges[-1][1] <= 1.01 * system.width


def test_a_document_needs_nothing_else(score):
    document = ElementTree.fromstring(engraved(sheet_of(score)).document)
    there = {element.get("id") for element in document.iter() if element.get("id")}
    used = {use.get("href").removeprefix("#") for use in document.iter(f"{SVG}use")}
    assert used == there
    # Music fonts are in no browser: their letters are outlines.
    assert not re.search("[\ue000-\uf8ff]", "".join(document.itertext()))


def read(text):
    return json.loads(zlib.decompress(base64.b64decode(text)))


def test_another_process_draws_the_same(score):
    assert read(engraving_within(600.0, score)) == read(engraving_of(score))


def test_the_page_knows_the_notes_and_has_the_sheet_music(score):
    about = read(engraving_of(score))
    assert about["notes"] == [[note.pitch, note.start, note.end] for note in score.notes]
    root = ElementTree.fromstring(about["musicxml"])
    assert root.findtext("work/work-title") == score.title
    assert len(root.findall(".//fingering")) == len(score.notes)


def test_music_without_a_metre_has_a_score_only_where_it_fits_one():
    song = replace(load_score("MinuetInG"), bars=())
    assert "estimated" in read(engraving_of(song))["remarks"][0]
    rng = np.random.default_rng(0)
    free = [
        replace(n, start=n.start + t, end=n.end + t)
        for n, t in zip(song.notes, rng.uniform(0, 0.15, len(song.notes)), strict=True)
    ]
    assert not engraving_of(replace(song, notes=tuple(free)))
    assert not engraving_of(Score(()))


def test_too_long_a_score_is_left_out():
    notes = tuple(Note(0.1 * i, 0.1 * (i + 1), 60) for i in range(15_001))
    assert not engraving_of(Score(notes))
    held = tuple(Note(0, 3000, pitch) for pitch in range(60, 72))
    assert not engraving_of(Score(held, bars=bars(1500)))


def test_three_minutes_take_a_small_part_of_a_page():
    """All of a page is to have less than 3 MB."""
    piece = make_etude("chorale", 8, 1)
    times = range(int(180 / piece.total_time) + 1)
    notes = [
        replace(
            note,
            start=note.start + n * piece.total_time,
            end=note.end + n * piece.total_time,
            finger=Finger(int(note.pitch < 60), i % 5),
        )
        for n in times
        for i, note in enumerate(piece.notes)
    ]
    assert 50_000 < len(engraving_of(Score(tuple(notes)))) < 300_000


def pages_of(path) -> list[str]:
    """The operators of each page; every object lies where the table at the end says."""
    content = path.read_bytes()
    places = [int(place) for place in re.findall(rb"(\d{10}) 00000 n", content)]
    for number, place in enumerate(places, start=1):
        assert content[place:].startswith(f"{number} 0 obj".encode())
    assert content[int(re.findall(rb"startxref\n(\d+)", content)[0]) :].startswith(b"xref")
    packed = re.findall(rb"stream\n(.*?)\nendstream", content, re.DOTALL)
    return [zlib.decompress(page).decode("cp1252") for page in packed]


def song(num_bars: int, title: str = "A (short) song by Dvořák") -> Score:
    bars = tuple(
        Bar(2.0 * i, i + 1, tuple(2 * i + b / 2 for b in range(4))) for i in range(num_bars)
    )
    notes = (
        Note(at, at + 0.5, 60 + 5 * (i % 4), finger=Finger(RIGHT, i % 5))
        for bar in bars
        for i, at in enumerate(bar.beats)
    )
    return Score(tuple(notes), title=title, bars=bars)


def test_a_page_has_title_composer_and_the_finger_of_each_note(tmp_path):
    write_pdf(replace(song(4), composer="Antonín"), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    texts = re.findall(r"Tm \((.*)\) Tj", page)
    assert texts[0] == r"A \(short\) song by Dvorák"  # a letter that Times lacks loses its accent
    assert texts[1] == "Antonín"
    assert [text for text in texts if text in "12345"] == ["1", "2", "3", "4"] * 4


def test_metronome_marks_of_half_notes_are_drawn(tmp_path):
    bars = tuple(Bar(2.0 * i, i + 1, (2.0 * i, 2.0 * i + 1), 2) for i in range(2))
    notes = tuple(Note(i, i + 1, 60) for i in range(4))
    write_pdf(Score(notes, title="Alla breve", bars=bars), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    texts = re.findall(r"Tm \((.*)\) Tj", page)
    assert texts[-1].split() == ["=", "60"]
    assert "?" not in "".join(texts)


def test_what_times_lacks_in_titles_of_music_is_spelled(tmp_path):
    score = song(1, "Nocturne in E♭ and C♯ minor, № 2")
    write_pdf(replace(score, composer="Łódź"), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    title, composer, *_ = re.findall(r"Tm \((.*)\) Tj", page)
    assert (title, composer) == ("Nocturne in E-flat and C-sharp minor, No. 2", "Lódz")


@pytest.mark.parametrize("num_bars", range(8, 20))
def test_no_bar_is_left_to_a_system_of_its_own(tmp_path, num_bars):
    write_pdf(song(num_bars), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    *_, last = page.split(" cm\nq")
    assert len(re.findall(r"Tm \([1-5]\) Tj", last)) > 4  # a finger for each note


@pytest.mark.parametrize(
    "num_bars",
    [60, 69, 78, 87, *(pytest.param(n, marks=pytest.mark.slow) for n in (63, 66, 72, 75, 81, 84))],
)
def test_pages_are_numbered_and_none_ends_with_a_system_by_itself(tmp_path, num_bars):
    write_pdf(song(num_bars), tmp_path / "a.pdf")
    pages = pages_of(tmp_path / "a.pdf")
    assert len(pages) > 1
    for number, page in enumerate(pages, start=1):
        assert f"({number} / {len(pages)}) Tj" in page
        assert page.count(" cm\nq") > 1  # systems


def test_fermatas_are_drawn_and_not_written_where_the_tempo_waits_already():
    song = Score(
        (Note(0.0, 0.5, 72), Note(0.5, 2.0, 74)), bars=(replace(*bars(1), fermatas=(0.5,)),)
    )
    drawn, written = engraved(sheet_of(song)), musicxml_of(sheet_of(song))
    assert "E4C0" in drawn.glyphs  # the name of the sign in SMuFL
    assert "fermata" not in written
