"""The PIG dataset, of which all files here are made up."""

import os
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.libraries.library import load_score, open_library
from cadenza.music.libraries.pig import import_pig, published_name, read_fingered
from cadenza.music.score import Note, Score
from music_strategies import monophonic_per_key, scores
from mutations import at_most_refused, other_bytes
from numbered import finger

NAMES = ("C", "C#", "D", "Eb", "E", "F", "F#", "G", "Ab", "A", "Bb", "B")
# As the paper names them: title, and how the published package calls the piece.
ETUDES = {
    "French Suite no. 1 Allemande": "FrenchSuiteNo1Allemande",
    "French Suite no. 5 Sarabande": "FrenchSuiteNo5Sarabande",
    "Piano Sonata D. 845 1st mov.": "PianoSonataD8451StMov",
    "Partita no. 2 (6)": "PartitaNo26",
    "Waltz op. 64 no. 1": "WaltzOp64No1",
    "Bagatelle op. 3 no. 4": "BagatelleOp3No4",
    "Kreisleriana op. 16 no. 8": "KreislerianaOp16No8",
    "French Suite no. 5 Gavotte": "FrenchSuiteNo5Gavotte",
    "Piano Sonata no. 23 2nd mov.": "PianoSonataNo232NdMov",
    "Golliwogg's Cakewalk": "GolliwoggsCakewalk",
    "Piano Sonata no. 2 1st mov.": "PianoSonataNo21StMov",
    "Piano Sonata K. 279 in C major 1st mov.": "PianoSonataK279InCMajor1StMov",
}
ONE = """//Version: PianoFingering_v170101
0\t0.000000\t0.500000\tC#4\t64\t80\t0\t1
1\t0.500000\t1.000000\tEbb3\t70\t80\t1\t-5
2\t1.000000\t1.500000\tF##5\t90\t80\t0\t4_1
3\t1.500000\t2.000000\tCb4\t64\t80\t1\t-2_-1
4\t2.000000\t2.500000\tB#3\t64\t80\t0\t3_
"""
ONE_READ = (
    Note(0.0, 0.5, 61, 64, finger(0)),
    Note(0.5, 1.0, 50, 70, finger(9)),
    Note(1.0, 1.5, 79, 90, finger(3)),
    Note(1.5, 2.0, 59, 64, finger(6)),
    Note(2.0, 2.5, 60, 64, finger(2)),
)


def text_of(score: Score) -> str:
    """As the authors would write it."""
    lines = ["//Version: PianoFingering_v170101"]
    for number, note in enumerate(score.notes):
        octave, step = divmod(note.pitch, 12)
        hand = note.finger.hand
        sign = (note.finger.index + 1) * (-1 if hand else 1)
        cells = (number, repr(note.start), repr(note.end), f"{NAMES[step]}{octave - 1}")
        lines.append("\t".join(map(str, (*cells, note.velocity, 80, hand, sign))))
    return "\n".join(lines) + "\n"


def make(folder: Path, pieces: dict[int, tuple[str, str]], file: str = ONE) -> Path:
    """A dataset of the pieces number -> (composer, title), all with the same notes."""
    place = folder / "PianoFingeringDataset_v1.2"
    (place / "FingeringFiles").mkdir(parents=True)
    rows = [f'{n},{composer},"{title}",8,5,1,a,,' for n, (composer, title) in pieces.items()]
    columns = "ID,Composer,Piece,#Bars,#Notes,#Types,Fingering1,,"
    (place / "List.csv").write_text("\n".join([columns, *rows, ""]))
    for number in pieces:
        fingering(place, number).write_text(file)
    return place


def fingering(place: Path, number: int, annotator: int = 1) -> Path:
    return place / "FingeringFiles" / f"{number:03d}-{annotator}_fingering.txt"


def zipped(place: Path, path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(place.rglob("*")):
            archive.write(file, file.relative_to(place.parent))
    return path


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("CADENZA_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def dataset(tmp_path):
    return make(
        tmp_path,
        {
            1: ("J. S. Bach", "Invention No. 1, BWV 772"),
            2: ("F. Chopin", "Étude"),
            7: ("X", "Étude"),
        },
    )


# A file of notes


def test_a_file_of_notes():
    score = read_fingered(ONE.encode(), "f")
    assert score.notes == ONE_READ
    assert score.remarks == ()


@pytest.mark.parametrize(
    "content",
    [
        ONE.replace("\n", "\r\n").encode(),
        b"\xef\xbb\xbf" + ONE.encode(),
        ONE.strip().encode(),
        ONE.replace("1\t0.5", "// a remark\n\n1\t0.5").encode(),
        ONE.replace("-5\n", "-5\t// weak\n").encode(),
    ],
)
def test_other_ways_to_write_the_same(content):
    assert read_fingered(content, "f").notes == ONE_READ


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("64\t80\t0\t1", "64\t80\t0", "7 columns; expected eight"),
        ("0.000000\t0.5", "nan\t0.5", "onset [s] 'nan'; expected a number"),
        ("0.000000\t0.5", "-0.1\t0.5", "onset [s] '-0.1'; expected"),
        ("0.500000\tC#4", "9999\tC#4", "offset [s] '9999'; expected a number, 0 to 3,600"),
        ("0.000000\t0.5", "0.6\t0.5", "offset 0.5 is before onset 0.6"),
        ("C#4", "H4", "pitch 'H4'; expected one such as C4"),
        ("C#4", "c4", "pitch 'c4'; expected"),
        ("C#4", "C#", "pitch 'C#'; expected"),
        ("C#4", "C9", "pitch C9 is outside the piano's 88 keys"),
        (
            "\t64\t80\t0\t1\n",
            "\t0\t80\t0\t1\n",
            "onset velocity '0'; expected a whole number, 1 to 127",
        ),
        ("80\t0\t1\n", "80\t2\t1\n", "channel '2'; expected 0 for the right hand"),
        ("80\t0\t1\n", "80\t0\t6\n", "finger '6'; expected 1 to 5"),
        ("80\t0\t1\n", "80\t0\t0\n", "finger '0'; expected"),
        ("80\t0\t1\n", "80\t0\t1_7\n", "finger '1_7'; expected"),
        ("80\t0\t1\n", "80\t0\t\u0661\n", "finger '\u0661'; expected"),
    ],
)
def test_a_wrong_line_is_named(old, new, message):
    assert old in ONE
    with pytest.raises(CadenzaError) as caught:
        read_fingered(ONE.replace(old, new, 1).encode(), "001-1_fingering.txt")
    assert str(caught.value).startswith(f"001-1_fingering.txt:2: {message}")


def test_a_file_without_notes_is_refused():
    with pytest.raises(CadenzaError, match=r"f:3: not text in UTF-8"):
        read_fingered(ONE.encode().replace(b"Ebb3", b"E\xff3"), "f")
    for nothing in (b"//Version\n", b""):
        with pytest.raises(CadenzaError, match="f: there are no notes"):
            read_fingered(nothing, "f")


def test_the_finger_says_which_hand_plays_and_a_remark_that_the_channel_does_not():
    crossed = ONE.replace("80\t1\t-5", "80\t0\t-5")
    score = read_fingered(crossed.encode(), "f")
    assert score.notes == ONE_READ
    (remark,) = score.remarks
    assert remark.startswith("f:3: channel and finger are of different hands")


fingered = (
    scores()
    .map(monophonic_per_key)
    .map(
        lambda score: Score(tuple(replace(n, finger=n.finger or Finger(0, 0)) for n in score.notes))
    )
)


@given(fingered)
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_read(score):
    assert read_fingered(text_of(score).encode(), "f").notes == score.notes


@given(st.integers(0, 2**32 - 1), fingered)
@settings(max_examples=150, deadline=None)
def test_damage_is_at_most_refused(seed, score):
    rng = np.random.default_rng(seed)
    content = text_of(score).encode()
    for _ in range(rng.integers(1, 4)):
        content = other_bytes(rng, content) or b"\n"
    with at_most_refused():
        read_fingered(content, "f")


# A dataset


@pytest.mark.parametrize("packed", [False, True])
def test_importing(dataset, tmp_path, packed):
    fingering(dataset, 2).rename(fingering(dataset, 2, 3))
    fingering(dataset, 2, 10).write_text(ONE.replace("C#4", "A0"))
    imported = import_pig(zipped(dataset, tmp_path / "pig.zip") if packed else dataset)
    assert (imported.left_out, imported.doubtful) == ([], [])
    library = open_library("repertoire-150")
    names = [song.name for song in library.songs]
    assert names == [
        "repertoire-150/InventionNo1Bwv772",
        "repertoire-150/Étude",
        "repertoire-150/Étude-2",
    ]
    song = library.songs[0]
    assert (song.title, song.composer) == ("Invention No. 1, BWV 772", "J. S. Bach")
    assert (song.seconds, song.notes, song.hands, song.source) == (2.5, 5, 2, "PIG 001")
    for song in library.songs:
        assert song.load().notes == load_score(song.name).notes == ONE_READ
        assert song.load().title == song.title


def test_a_zip_file_of_the_files_themselves(dataset, tmp_path):
    with zipfile.ZipFile(tmp_path / "pig.zip", "w") as archive:
        for file in dataset.rglob("*.*"):
            archive.write(file, file.relative_to(dataset))
            archive.write(file, Path("__MACOSX/x", f"._{file.name}"))
    assert len(import_pig(tmp_path / "pig.zip").rows) == 3


def test_the_list_may_call_its_columns_otherwise(dataset):
    path = dataset / "List.csv"
    path.write_text(path.read_text().replace("ID,Composer,Piece", "No.,Composer,Title"))
    import_pig(dataset)
    assert open_library("repertoire-150").songs[0].title == "Invention No. 1, BWV 772"


def test_the_twelve_etudes_are_found_however_their_titles_are_written(tmp_path):
    titles = [*("Piano Sonata No. 14 Op. 27 No. 2, 1st mov.", "Waltz Op. 64 No. 2", *ETUDES)]
    variants = {
        "in C major 1st mov.": "1st movement",
        "Partita no. 2 (6)": "Partita No.2-6",
        "Golliwogg's": "Golliwogg\u2019s",
        "no. 1 Allemande": "No.1, Allemande",
        "D. 845": "D845 in A minor,",
    }
    place = make(tmp_path / "a", {n: ("", title) for n, title in enumerate(titles, 1)})
    import_pig(place)
    library = open_library("etude-12")
    assert [song.name for song in library.songs] == [f"etude-12/{n}" for n in ETUDES.values()]
    assert load_score("etude-12/golliwoggscakewalk").notes == ONE_READ
    text = (place / "List.csv").read_text()
    for old, new in variants.items():
        assert old in text
        text = text.replace(old, new)
    (place / "List.csv").write_text(text)
    import_pig(place, replace=True)
    assert [song.title for song in open_library("etude-12").songs][9] == "Golliwogg\u2019s Cakewalk"
    assert len(open_library("etude-12").songs) == 12


@pytest.mark.parametrize(("title", "name"), ETUDES.items())
def test_pieces_are_called_as_in_the_published_benchmark(title, name):
    assert published_name(title) == name


def test_damaged_files_are_left_out_and_said_to_be(dataset, capsys):
    fingering(dataset, 2).write_text(ONE.replace("Ebb3", "Ehh3"))
    fingering(dataset, 7).unlink()
    fingering(dataset, 9).write_text(ONE)
    with (dataset / "List.csv").open("a") as file:
        file.write('x,A,B\n1,A,B\n4,A,\n8,A,"A "B" of C"\n')
    with pytest.raises(SystemExit) as stop:
        main(["import", "pig", str(dataset)])
    assert stop.value.code == 1
    output = capsys.readouterr()
    assert output.out == (
        "1 song; to list them: cadenza songs repertoire-150\n0 of them are in etude-12\n"
    )
    *lines, last = output.err.replace(f"{dataset}/", "").splitlines()
    assert sorted(line.split("; expected")[0] for line in lines) == [
        "FingeringFiles/002-1_fingering.txt:3: pitch 'Ehh3'",
        "FingeringFiles/009-1_fingering.txt: there is no such piece in List.csv",
        "List.csv:4: no file of fingers for 'Étude'",
        "List.csv:5: number of a piece 'x'",
        "List.csv:6: a second line for piece 1",
        "List.csv:7: piece 4 has no title",
        "List.csv:8: no file of fingers for 'A B\" of C\"'",
    ]
    assert last == "cadenza: repertoire-150: 7 of 8 could not be read and were left out"
    assert len(open_library("repertoire-150").songs) == 1
    with pytest.raises(CadenzaError, match="etude-12: none of its pieces is in repertoire-150"):
        open_library("etude-12")


def test_what_is_no_dataset_is_refused(tmp_path, data, dataset):
    (tmp_path / "no.zip").write_bytes(b"PK nothing")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "List.csv").write_text("ID,Composer\n1,x\n")
    for source, message in {
        "no.zip": "neither a folder nor a readable ZIP file",
        "nowhere": "there is no such folder or ZIP file",
        "empty": r"there is no List\.csv in it; .* https://",
        "other": r"List\.csv:1: there is no column Piece",
    }.items():
        with pytest.raises(CadenzaError, match=message):
            import_pig(tmp_path / source)
    for number in (1, 2, 7):
        fingering(dataset, number).write_text("x")
    with pytest.raises(CadenzaError, match=r"not one piece can be read; .*txt:1: 1 columns"):
        import_pig(dataset)
    assert not [path for path in data.rglob("*") if not path.name.startswith(".")][1:]


def test_a_zip_file_that_would_fill_the_disk_is_not_unpacked(dataset, tmp_path):
    os.truncate(fingering(dataset, 2), 300 * 2**20)
    path = zipped(dataset, tmp_path / "pig.zip")
    with pytest.raises(CadenzaError, match="neither a folder nor a readable ZIP file"):
        import_pig(path)
    os.truncate(fingering(dataset, 2), 20 * 2**20)
    (message,) = import_pig(zipped(dataset, path)).left_out
    assert "002-1_fingering.txt: over 2 MiB" in message


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_a_damaged_zip_file_is_at_most_refused(tmp_path_factory, seed):
    folder = tmp_path_factory.mktemp("zip")
    path = zipped(make(folder, {1: ("A", "B"), 2: ("C", "D")}), folder / "pig.zip")
    rng = np.random.default_rng(seed)
    path.write_bytes(other_bytes(rng, path.read_bytes()))
    with at_most_refused():
        import_pig(path, replace=True)


# Interrupted


def test_an_import_that_fails_leaves_what_was_there(dataset, data):
    import_pig(dataset)
    files = sorted(data.rglob("*"))

    def fail(done: int, total: int) -> None:
        if done == total - 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_pig(dataset, replace=True, progress=fail)
    assert sorted(data.rglob("*")) == files
    assert open_library("repertoire-150").songs[0].load().notes == ONE_READ


@pytest.mark.parametrize("again", [False, True])
def test_a_killed_import_leaves_nothing_half(dataset, data, again):
    if again:
        import_pig(dataset)
    code = (
        "import sys, time; from pathlib import Path\n"
        "from cadenza.music.libraries.pig import *\n"
        "def wait(done, total):\n    if done == 2: print('two', flush=True); time.sleep(60)\n"
        "import_pig(Path(sys.argv[1]), True, wait)"
    )
    command = [sys.executable, "-c", code, str(dataset)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stdout.readline() == "two\n"
        with pytest.raises(CadenzaError, match="another import is running"):
            import_pig(dataset, replace=True)
        process.send_signal(signal.SIGKILL)
    if again:
        assert open_library("repertoire-150").songs[2].load().notes == ONE_READ
    else:
        with pytest.raises(CadenzaError, match="cadenza import pig"):
            open_library("repertoire-150")
    import_pig(dataset, replace=again)
    assert len(open_library("repertoire-150").songs) == 3
    assert len(list(data.rglob("*.mid"))) == 3
