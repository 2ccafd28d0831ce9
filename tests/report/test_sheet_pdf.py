"""Sheet music as PDF: its pages, read by what every PDF says of itself."""

import re
import zlib

import pytest

from cadenza.fingers import RIGHT, Finger
from cadenza.music.score import Bar, Note, Score
from cadenza.report.sheet_pdf import write_pdf


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
    write_pdf(song(4), tmp_path / "a.pdf", "Antonín")
    (page,) = pages_of(tmp_path / "a.pdf")
    texts = re.findall(r"Tm \((.*)\) Tj", page)
    assert texts[0] == r"A \(short\) song by Dvorák"  # a letter that Times lacks loses its accent
    assert texts[1] == "Antonín"
    assert [text for text in texts if text in "12345"] == ["1", "2", "3", "4"] * 4


@pytest.mark.parametrize("num_bars", range(8, 20))
def test_no_bar_is_left_to_a_system_of_its_own(tmp_path, num_bars):
    write_pdf(song(num_bars), tmp_path / "a.pdf")
    (page,) = pages_of(tmp_path / "a.pdf")
    *_, last = page.split(" cm\nq")
    assert len(re.findall(r"Tm \([1-5]\) Tj", last)) > 4  # a finger for each note


@pytest.mark.parametrize("num_bars", range(60, 90, 3))
def test_pages_are_numbered_and_none_ends_with_a_system_by_itself(tmp_path, num_bars):
    write_pdf(song(num_bars), tmp_path / "a.pdf")
    pages = pages_of(tmp_path / "a.pdf")
    assert len(pages) > 1
    for number, page in enumerate(pages, start=1):
        assert f"({number} / {len(pages)}) Tj" in page
        assert page.count(" cm\nq") > 1  # systems
