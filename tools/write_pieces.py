"""Writes the bundled pieces: src/cadenza/music/libraries/pieces/*.mid, *.fingering and index.toml.

Run `python tools/write_pieces.py` after changing a piece below.

What a hand plays is a line of tokens:

    C#4.2:1/2     C sharp 4 (C4 is middle C) with finger 2, half a quarter note long
    C4.1+E4.3:2   a chord; the length is left out where it is that of the token before
    r:1           a rest
    |             a bar line; the bars' lengths are checked, the first and last may be shorter
    p mp mf f ff  from here on softer or louder
    &             what follows is a second voice of the same hand, from the beginning

Fingers are written as pianists do, 1 thumb to 5 little finger, of the hand that plays. The pedal
has a line of its own: `P:2` lifts it and holds it down again for two quarters, `r:2` leaves it up.
A note is released 10 ms before its written end, except where a piece says otherwise.

All pieces are in the public domain; the arrangements and the fingering are Cadenza's own.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from cadenza.files import write_atomically
from cadenza.fingering.difficulty import grade as grade_of
from cadenza.fingers import Finger
from cadenza.music.formats.fingering_file import write_fingering
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of

HANDS = players_of(build_scene())
PIECES_FOLDER = Path(__file__).parents[1] / "src/cadenza/music/libraries/pieces"

VELOCITIES = {"p": 50, "mp": 65, "mf": 80, "f": 95, "ff": 115}
SEMITONES = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
ACCIDENTALS = {"": 0, "#": 1, "b": -1}
NOTE = re.compile(r"([A-G])([#b]?)(\d)\.([1-5])")
PEDAL_LIFT = Fraction(1, 10)  # [s] that the pedal is up between two holds


@dataclass(frozen=True)
class Piece:
    name: str
    title: str
    composer: str
    source: str
    difficulty: str
    quarter: str  # [s]
    bar: int | Fraction  # quarters
    right: str = ""
    left: str = ""
    pedal: str = ""
    release: Fraction = Fraction(1, 100)  # [s] before the written end

    def score(self) -> Score:
        notes = [note for voice in self.right.split("&") for note in self._notes(voice, hand=0)]
        notes += [note for voice in self.left.split("&") for note in self._notes(voice, hand=1)]
        return Score(tuple(notes), tuple(self._pedal_events()), self.title)

    def _notes(self, voice: str, hand: int) -> Iterator[Note]:
        velocity = VELOCITIES["mf"]
        for what, start, end in self._timed(voice):
            if what in VELOCITIES:
                velocity = VELOCITIES[what]
            elif what != "r":
                for note in what.split("+"):
                    pitch, sign = pitch_and_finger(note)
                    last = float(end - self.release)
                    yield Note(float(start), last, pitch, velocity, Finger(hand, sign - 1))

    def _pedal_events(self) -> Iterator[PedalEvent]:
        for what, start, end in self._timed(self.pedal):
            if what == "P":
                yield PedalEvent(float(start + PEDAL_LIFT), 127)
                yield PedalEvent(float(end), 0)

    def _timed(self, voice: str) -> Iterator[tuple[str, Fraction, Fraction]]:
        """Tokens with start and end [s]."""
        beat, length = Fraction(0), Fraction(1)
        bar_lines = []
        for token in voice.split():
            if token == "|":
                bar_lines.append(beat)
                continue
            what, _, written = token.partition(":")
            if what in VELOCITIES:
                yield what, Fraction(0), Fraction(0)
                continue
            length = Fraction(written) if written else length
            quarter = Fraction(self.quarter)
            yield what, beat * quarter, (beat + length) * quarter
            beat += length
        bars = [b - a for a, b in zip([Fraction(0), *bar_lines], [*bar_lines, beat], strict=True)]
        if any(bar != self.bar for bar in bars[1:-1]) or max(bars) > self.bar:
            raise ValueError(f"{self.name}: bars of {[str(bar) for bar in bars]} quarters: {voice}")


def pitch_and_finger(text: str) -> tuple[int, int]:
    match = NOTE.fullmatch(text)
    if not match:
        raise ValueError(f"not a note with a finger: {text!r}")
    letter, accidental, octave, finger = match.groups()
    pitch = 12 * (int(octave) + 1) + SEMITONES[letter] + ACCIDENTALS[accidental]
    return pitch, int(finger)


def exercise(what: str) -> str:
    return f"{what}; an exercise that belongs to nobody, fingered for Cadenza"


def folk(what: str) -> str:
    return f"{what}; public domain, arranged from memory and fingered for Cadenza"


def composed(work: str) -> str:
    return f"{work}; public domain, arranged from memory and fingered for Cadenza"


def broken_chords(chords: str) -> tuple[str, str]:
    """Bach's figure, twice a bar: two notes held by the left hand, three struck by the right.

    Each line of `chords` has the five notes of a bar. Returns what the right and left hands play.
    """
    right, low, high = [], [], []
    for line in chords.strip().splitlines():
        first, second, a, b, c = line.split()
        right.append(f"r:1/2 {a}:1/4 {b} {c} {a} {b} {c} " * 2)
        low.append(f"{first}:2 {first}")
        high.append(f"r:1/4 {second}:7/4 " * 2)
    return " | ".join(right), f"{' | '.join(low)} & {' | '.join(high)}"


def alberti(halves: str) -> str:
    """Eighths low, high, middle, high; `halves` gives low, middle and high of each half bar."""
    bars, notes = [], [half.split() for half in halves.split(",")]
    for one, two in zip(notes[::2], notes[1::2], strict=True):
        bars.append(" ".join(f"{low}:1/2 {high} {mid} {high}" for low, mid, high in (one, two)))
    return " | ".join(bars)


def triplets(quarters: str) -> str:
    """Bars, a line each: the three notes of every quarter, behind `2x` where played twice."""
    bars = []
    for line in quarters.strip().splitlines():
        tokens = []
        for part in line.split(","):
            *times, first, second, third = part.split()
            repeats = int(times[0].removesuffix("x")) if times else 1
            tokens += [f"{note}:1/3" for note in (first, second, third)] * repeats
        bars.append(" ".join(tokens))
    return " | ".join(bars)


# The six pieces below without a release gap are those that the published RoboPianist is recorded
# on, note for note and finger for finger; the tests hold them to that.
EXACT = Fraction(0)

C_SCALE_RIGHT = """
    C5.1:1 D5.2 E5.3 F5.1 | G5.2 A5.3 B5.4 C6.5 | B5.4 A5.3 G5.2 F5.1 | E5.3 D5.2 C5.1"""
C_SCALE_LEFT = """
    C3.5:1 D3.4 E3.3 F3.2 | G3.1 A3.3 B3.2 C4.1 | B3.2 A3.3 G3.1 F3.2 | E3.3 D3.4 C3.5"""
D_SCALE_RIGHT = """
    D5.1:1 E5.2 F#5.3 G5.1 | A5.2 B5.3 C#6.4 D6.5 | C#6.4 B5.3 A5.2 G5.1 | F#5.3 E5.2 D5.1"""
D_SCALE_LEFT = """
    D3.5:1 E3.4 F#3.3 G3.2 | A3.1 B3.3 C#4.2 D4.1 | C#4.2 B3.3 A3.1 G3.2 | F#3.3 E3.4 D3.5"""

FRERE_RIGHT = """
    C5.1:1 D5.2 E5.3 C5.1 | C5.1 D5.2 E5.3 C5.1 | E5.2 F5.3 G5.4:2 | E5.2:1 F5.3 G5.4:2 |
    G5.4:1/2 A5.5 G5.4 F5.3 E5.2:1 C5.1 | G5.4:1/2 A5.5 G5.4 F5.3 E5.2:1 C5.1 |
    C5.4 G4.1 C5.4:2 | C5.4:1 G4.1 C5.4:2"""
FRERE_LEFT = """
    C3.5:1 D3.4 E3.3 C3.5 | C3.5 D3.4 E3.3 C3.5 | E3.4 F3.3 G3.2:2 | E3.4:1 F3.3 G3.2:2 |
    G3.2:1/2 A3.1 G3.2 F3.3 E3.4:1 C3.5 | G3.2:1/2 A3.1 G3.2 F3.3 E3.4:1 C3.5 |
    C3.2 G2.5 C3.2:2 | C3.2:1 G2.5 C3.2:2"""

CLAIR_RIGHT_A = "C5.1:1 C5.1 C5.1 D5.2 | E5.3:2 D5.2 | C5.1:1 E5.3 D5.2 D5.2 | C5.1:4"
CLAIR_LEFT_A = """
    C3.5+E3.3+G3.1:4 | C3.5+E3.3+G3.1:2 B2.5+F3.2+G3.1 | C3.5+E3.3+G3.1 B2.5+F3.2+G3.1 |
    C3.5+E3.3+G3.1:4"""

JINGLE_RIGHT_A = "E4.3:1 E4.3 E4.3:2 | E4.3:1 E4.3 E4.3:2 | E4.3:1 G4.5 C4.1:3/2 D4.2:1/2 | E4.3:4"

ELISE_RIGHT = """
    E5.5:1/4 D#5.4 E5.5 B4.2 D5.4 C5.3 | A4.1:1/2 r:1/4 C4.1 E4.2 A4.4 |
    B4.5:1/2 r:1/4 E4.1 G#4.2 B4.4 | C5.5:1/2 r:1/4 E4.1 E5.5 D#5.4 |
    E5.5 D#5.4 E5.5 B4.2 D5.4 C5.3 | A4.1:1/2 r:1/4 C4.1 E4.2 A4.4 |
    B4.5:1/2 r:1/4 E4.1 C5.4 B4.3"""
ELISE_A_MINOR = "A2.5:1/4 E3.2 A3.1 r:3/4"
ELISE_E_MAJOR = "E2.5:1/4 E3.2 G#3.1 r:3/4"
ELISE_LEFT = f"""
    r:3/2 | {ELISE_A_MINOR} | {ELISE_E_MAJOR} | {ELISE_A_MINOR} |
    r:3/2 | {ELISE_A_MINOR} | {ELISE_E_MAJOR}"""
ELISE_PEDAL = "r:3/2 | P:1 r:1/2 | P:1 r:1/2 | P:1 r:1/2 | r:3/2 | P:1 r:1/2 | P:1 r:1/2"

HAYDN_RIGHT = """
    C5.1:1/2 C5.1 E5.3 E5.3 | G5.5 G5.5 E5.3:1 | F5.5:1/2 F5.5 D5.3 D5.3 | B4.2 B4.2 G4.1:1 |
    C5.1:1/2 C5.1 E5.3 E5.3 | G5.5 G5.5 E5.3:1 | C6.5:1/2 C6.5 F#5.2 F#5.2 | G5.3:1"""
HAYDN_LEFT = """
    C3.5+E3.3+G3.1:2 | C3.5+E3.3+G3.1 | B2.5+F3.2+G3.1 | B2.5+F3.2+G3.1 |
    C3.5+E3.3+G3.1 | C3.5+E3.3+G3.1 | D3.5+F#3.3+A3.1 | B2.5+D3.3+G3.1:1"""

GRIEG_RIGHT = """
    A4.1:1/2 B4.2 C5.3 D5.4 E5.5 C5.3 E5.5:1 | D#5.4:1/2 B4.2 D#5.4:1 D5.4:1/2 Bb4.2 D5.4:1 |
    A4.1:1/2 B4.2 C5.1 D5.2 E5.3 C5.1 E5.2 A5.5 | G5.4 E5.2 C5.1 E5.2 G5.4:2"""
GRIEG_LEFT = """
    A2.5:1 E3.1 A2.5 E3.1 | A2.5 E3.1 A2.5 E3.1 | A2.5 E3.1 A2.5 E3.1 | C3.5 G3.1 C3.5 G3.1"""

BACH_RIGHT, BACH_LEFT = broken_chords("""
    C4.5 E4.3 G4.1 C5.3 E5.5
    C4.5 D4.4 A4.1 D5.3 F5.5
    B3.5 D4.3 G4.1 D5.3 F5.5
    C4.5 E4.3 G4.1 C5.3 E5.5
    C4.5 E4.3 A4.1 E5.3 A5.5
    C4.5 D4.4 F#4.1 A4.2 D5.5
    B3.5 D4.3 G4.1 D5.3 G5.5
    B3.5 C4.4 E4.1 G4.2 C5.5
    A3.5 C4.3 E4.1 G4.2 C5.5
    D3.5 A3.1 D4.1 F#4.2 C5.5
    G3.5 B3.3 D4.1 G4.3 B4.5
""")

PIECES = (
    Piece(
        "TwinkleTwinkleLittleStar",
        "Twinkle, Twinkle, Little Star",
        "traditional",
        folk("first line of the tune 'Ah! vous dirai-je, maman' (France, 1761)"),
        "easy",
        "0.5",
        4,
        right="""
            C4.1:1 C4.1 G4.3 G4.3 | A4.4 A4.4 G4.3:2 | F4.4:1 F4.4 E4.3 E4.3 | D4.2 D4.2 C4.1:2""",
        release=EXACT,
    ),
    Piece(
        "MaryHadALittleLamb",
        "Mary Had a Little Lamb",
        "traditional",
        folk("nursery song, words by Sarah Josepha Hale (1830), tune of the 19th century"),
        "easy",
        "0.5",
        4,
        right="""
            E4.3:1 D4.2 C4.1 D4.2 | E4.3 E4.3 E4.3:2 | D4.2:1 D4.2 D4.2:2 | E4.3:1 G4.5 G4.5:2 |
            E4.3:1 D4.2 C4.1 D4.2 | E4.3 E4.3 E4.3 E4.3 | D4.2 D4.2 E4.3 D4.2 | C4.1:4""",
        left="""mp
            C3.5+G3.1:4 | C3.5+G3.1 | B2.5+G3.1 | C3.5+G3.1 |
            C3.5+G3.1 | C3.5+G3.1 | B2.5+G3.1 | C3.5+G3.1""",
    ),
    Piece(
        "OdeToJoy",
        "Ode to Joy",
        "Ludwig van Beethoven",
        composed("theme of the finale of Symphony No. 9, Op. 125 (1824), in C major"),
        "easy",
        "0.5",
        4,
        right="""
            E4.3:1 E4.3 F4.4 G4.5 | G4.5 F4.4 E4.3 D4.2 | C4.1 C4.1 D4.2 E4.3 |
            E4.3:3/2 D4.2:1/2 D4.2:2 |
            E4.3:1 E4.3 F4.4 G4.5 | G4.5 F4.4 E4.3 D4.2 | C4.1 C4.1 D4.2 E4.3 |
            D4.2:3/2 C4.1:1/2 C4.1:2""",
        left="""mp
            C3.5:4 | G3.1 | C3.5 | G3.1 | C3.5 | G3.1 | C3.5 | G3.1:2 C3.5""",
    ),
    Piece(
        "CMajorScaleOneHand",
        "C major scale, right hand",
        "exercise",
        exercise("one octave up and down"),
        "easy",
        "0.5",
        4,
        right=C_SCALE_RIGHT,
        release=EXACT,
    ),
    Piece(
        "DMajorScaleOneHand",
        "D major scale, right hand",
        "exercise",
        exercise("one octave up and down"),
        "easy",
        "0.5",
        4,
        right=D_SCALE_RIGHT,
        release=EXACT,
    ),
    Piece(
        "AuClairDeLaLune",
        "Au clair de la lune",
        "traditional",
        folk("French song of the 18th century"),
        "easy",
        "0.4",
        4,
        right=f"""
            {CLAIR_RIGHT_A} | {CLAIR_RIGHT_A} |
            D5.5:1 D5.5 D5.5 D5.5 | A4.2:2 A4.2 | D5.5:1 C5.4 B4.3 A4.2 | G4.1:4 |
            {CLAIR_RIGHT_A}""",
        left=f"""mp
            {CLAIR_LEFT_A} | {CLAIR_LEFT_A} |
            B2.5+D3.3+G3.1:4 | D3.5+F#3.3+A3.1 | B2.5+D3.3+G3.1:2 D3.5+F#3.3+A3.1 |
            B2.5+D3.3+G3.1:4 | {CLAIR_LEFT_A}""",
    ),
    Piece(
        "JingleBells",
        "Jingle Bells",
        "James Lord Pierpont",
        composed("refrain of 'One Horse Open Sleigh' (Boston, 1857)"),
        "easy",
        "0.4",
        4,
        right=f"""
            {JINGLE_RIGHT_A} | F4.4:1 F4.4 F4.4:3/2 F4.4:1/2 |
            F4.4:1 E4.3 E4.3 E4.3:1/2 E4.3 | E4.3:1 D4.2 D4.2 E4.3 | D4.2:2 G4.5 |
            {JINGLE_RIGHT_A} | F4.4:1 F4.4 F4.4:3/2 F4.4:1/2 |
            F4.4:1 E4.3 E4.3 E4.3:1/2 E4.3 | G4.5:1 G4.5 F4.4 D4.2 | C4.1:4""",
        left="""mp
            C3.5+G3.1:4 | C3.5+G3.1 | C3.5+G3.1 | C3.5+G3.1 | C3.5+F3.2+A3.1 | C3.5+G3.1 |
            D3.5+F#3.3+A3.1 | B2.5+F3.2+G3.1 |
            C3.5+G3.1 | C3.5+G3.1 | C3.5+G3.1 | C3.5+G3.1 | C3.5+F3.2+A3.1 | C3.5+G3.1 |
            B2.5+F3.2+G3.1 | C3.5+E3.3+G3.1""",
    ),
    Piece(
        "SurpriseSymphony",
        "Surprise Symphony, theme",
        "Joseph Haydn",
        composed("theme of the Andante of Symphony No. 94, Hob. I:94 (1791)"),
        "easy",
        "0.6",
        2,
        right=f"""mp {HAYDN_RIGHT} r |
            p {HAYDN_RIGHT} ff G4.1+B4.2+D5.3+G5.5""",
        left=f"p {HAYDN_LEFT} r | {HAYDN_LEFT} ff G2.5+G3.1",
    ),
    Piece(
        "CMajorScaleTwoHands",
        "C major scale, hands together",
        "exercise",
        exercise("one octave up and down"),
        "intermediate",
        "0.5",
        4,
        right=C_SCALE_RIGHT,
        left=C_SCALE_LEFT,
        release=EXACT,
    ),
    Piece(
        "DMajorScaleTwoHands",
        "D major scale, hands together",
        "exercise",
        exercise("one octave up and down"),
        "intermediate",
        "0.5",
        4,
        right=D_SCALE_RIGHT,
        left=D_SCALE_LEFT,
        release=EXACT,
    ),
    Piece(
        "CMajorChordProgressionTwoHands",
        "Chord progression in C major",
        "exercise",
        exercise("C, F, G and C major"),
        "intermediate",
        "0.5",
        2,
        right="C4.1+E4.3+G4.5:2 | F4.1+A4.3+C5.5 | G4.1+B4.3+D5.5 | C4.1+E4.3+G4.5",
        left="C3.1:2 | F2.4 | G2.3 | C3.1",
        release=EXACT,
    ),
    Piece(
        "FrereJacques",
        "Frère Jacques",
        "traditional",
        folk("French canon of the 18th century, the left hand two bars behind the right"),
        "intermediate",
        "0.5",
        4,
        right=f"{FRERE_RIGHT} | C5.4:1 G4.1 C5.4:2 | C5.4:1 G4.1 C5.4:2",
        left=f"r:4 | r | {FRERE_LEFT}",
    ),
    Piece(
        "InTheHallOfTheMountainKing",
        "In the Hall of the Mountain King, theme",
        "Edvard Grieg",
        composed("theme from Peer Gynt, Op. 23 (1875), transposed to A minor"),
        "intermediate",
        "0.6",
        4,
        right=f"p {GRIEG_RIGHT} | f {GRIEG_RIGHT}",
        left=f"p {GRIEG_LEFT} | mf {GRIEG_LEFT}",
    ),
    Piece(
        "Greensleeves",
        "Greensleeves",
        "traditional",
        folk("English song (registered in 1580), first strain, in A minor"),
        "intermediate",
        "0.6",
        3,
        right="""
            A4.1:1/2 | C5.2:1 D5.3:1/2 E5.4:3/4 F#5.5:1/4 E5.4:1/2 |
            D5.3:1 B4.2:1/2 G4.1:3/4 A4.2:1/4 B4.3:1/2 |
            C5.4:1 A4.2:1/2 A4.3:3/4 G#4.2:1/4 A4.3:1/2 | B4.4:1 G#4.2:1/2 E4.1:3/4 r:1/4 A4.1:1/2 |
            C5.2:1 D5.3:1/2 E5.4:3/4 F#5.5:1/4 E5.4:1/2 |
            D5.3:1 B4.2:1/2 G4.1:3/4 A4.2:1/4 B4.3:1/2 |
            C5.4:3/4 B4.2:1/4 A4.1:1/2 G#4.3:3/4 F#4.2:1/4 G#4.3:1/2 | A4.4:5/2""",
        left="""mp
            r:1/2 | A2.5+E3.1:3/2 A2.5+E3.1 | G2.5+D3.1 G2.5+D3.1 | A2.5+E3.1 A2.5+E3.1 |
            E2.5+B2.1 E2.5+B2.1 | A2.5+E3.1 A2.5+E3.1 | G2.5+D3.1 G2.5+D3.1 |
            A2.5+E3.1 E2.5+B2.1 | A2.5+E3.1:5/2""",
    ),
    Piece(
        "ChromaticScale",
        "Chromatic scale, hands together",
        "exercise",
        exercise("one octave up and down"),
        "intermediate",
        "0.8",
        Fraction(13, 2),
        right="""
            C5.1:1/2 C#5.3 D5.1 D#5.3 E5.1 F5.2 F#5.3 G5.1 G#5.3 A5.1 A#5.3 B5.1 C6.2 |
            B5.1 A#5.3 A5.1 G#5.3 G5.1 F#5.3 F5.2 E5.1 D#5.3 D5.1 C#5.3 C5.1""",
        left="""
            C3.1:1/2 C#3.3 D3.1 D#3.3 E3.2 F3.1 F#3.3 G3.1 G#3.3 A3.1 A#3.3 B3.2 C4.1 |
            B3.2 A#3.3 A3.1 G#3.3 G3.1 F#3.3 F3.1 E3.2 D#3.3 D3.1 C#3.3 C3.1""",
    ),
    Piece(
        "HarmonicMinorScale",
        "A harmonic minor scale, hands together",
        "exercise",
        exercise("two octaves up and down"),
        "intermediate",
        "0.6",
        Fraction(7, 2),
        right="""
            A4.1:1/2 B4.2 C5.3 D5.1 E5.2 F5.3 G#5.4 | A5.1 B5.2 C6.3 D6.1 E6.2 F6.3 G#6.4 |
            A6.5 G#6.4 F6.3 E6.2 D6.1 C6.3 B5.2 | A5.1 G#5.4 F5.3 E5.2 D5.1 C5.3 B4.2 | A4.1:2""",
        left="""
            A2.5:1/2 B2.4 C3.3 D3.2 E3.1 F3.3 G#3.2 | A3.1 B3.4 C4.3 D4.2 E4.1 F4.3 G#4.2 |
            A4.1 G#4.2 F4.3 E4.1 D4.2 C4.3 B3.4 | A3.1 G#3.2 F3.3 E3.1 D3.2 C3.3 B2.4 | A2.5:2""",
    ),
    Piece(
        "GymnopedieOpening",
        "Gymnopédie No. 1, opening",
        "Erik Satie",
        composed("Trois Gymnopédies, No. 1 (1888), opening; bass notes held by the pedal"),
        "intermediate",
        "0.8",
        3,
        right="""mf
            r:3 | r | r | r | r:1 F#5.3 A5.5 | G5.4 F#5.3 C#5.2 | B4.1 C#5.2 D5.3 | A4.1:3 |
            F#4.2:3""",
        left="""p
            G2.5:1/2 r B3.5+D4.3+F#4.1:2 | D2.5:1/2 r A3.5+C#4.3+F#4.1:2 |
            G2.5:1/2 r B3.5+D4.3+F#4.1:2 | D2.5:1/2 r A3.5+C#4.3+F#4.1:2 |
            G2.5:1/2 r B3.5+D4.3+F#4.1:2 | D2.5:1/2 r A3.5+C#4.3+F#4.1:2 |
            G2.5:1/2 r B3.5+D4.3+F#4.1:2 | D2.5:1/2 r A3.5+C#4.3+F#4.1:2 |
            G2.5:1/2 r B3.3+D4.1:2""",
        pedal="P:3 | P | P | P | P | P | P | P | P",
    ),
    Piece(
        "CanonInDOpening",
        "Canon in D, opening",
        "Johann Pachelbel",
        composed("Canon in D major, P. 37 (about 1690), bass and first two phrases of the violins"),
        "intermediate",
        "0.5",
        4,
        right="""
            F#5.5:2 E5.4 | D5.3 C#5.2 | B4.1 A4.2 | B4.1 C#5.2 |
            D5.3+F#5.5 C#5.2+E5.4 | B4.1+D5.3 A4.2+C#5.4 | G4.1+B4.3 F#4.2+A4.4 |
            G4.1+B4.3 E4.1+C#5.5 | F#4.2+D5.5:4""",
        left="""mp
            D3.1:2 A2.4 | B2.1 F#2.4 | G2.1 D2.4 | G2.2 A2.1 |
            D3.5+F#3.3+A3.1 A2.5+C#3.3+E3.1 | B2.5+D3.3+F#3.1 F#2.5+A2.3+C#3.1 |
            G2.5+B2.3+D3.1 D3.5+F#3.3+A3.1 | G2.5+B2.3+D3.1 A2.5+C#3.3+E3.1 |
            D3.5+F#3.3+A3.1:4""",
        pedal="P:2 P | P P | P P | P P | P P | P P | P P | P P | P:4",
    ),
    Piece(
        "MinuetInG",
        "Minuet in G major",
        "Christian Petzold",
        composed("BWV Anh. 114 (before 1725), bars 1-16, without ornaments"),
        "intermediate",
        "0.5",
        3,
        right="""
            D5.5:1 G4.1:1/2 A4.2 B4.3 C5.4 | D5.5:1 G4.1 G4.1 |
            E5.3 C5.1:1/2 D5.2 E5.3 F#5.4 | G5.5:1 G4.1 G4.1 |
            C5.4 D5.5:1/2 C5.4 B4.3 A4.2 | B4.3:1 C5.4:1/2 B4.3 A4.2 G4.1 |
            F#4.2:1 G4.1:1/2 A4.2 B4.3 G4.1 | A4.2:3 |
            D5.5:1 G4.1:1/2 A4.2 B4.3 C5.4 | D5.5:1 G4.1 G4.1 |
            E5.3 C5.1:1/2 D5.2 E5.3 F#5.4 | G5.5:1 G4.1 G4.1 |
            C5.4 D5.5:1/2 C5.4 B4.3 A4.2 | B4.3:1 C5.4:1/2 B4.3 A4.2 G4.1 |
            A4.2:1 B4.3:1/2 A4.2 G4.1 F#4.2 | G4.1:3""",
        left="""mp
            G3.5+B3.3+D4.1:2 A3.4:1 | B3.3:3 | C4.2 | B3.3 | A3.4 | G3.5 |
            D4.1:1 B3.3 G3.5 | D4.1 D3.5:1/2 C4.1 B3.2 A3.3 |
            B3.2:2 A3.3:1 | G3.4 B3.2 G3.4 | C4.1:3 | B3.2:1 C4.1:1/2 B3.2 A3.3 G3.4 |
            A3.3:2 F#3.5:1 | G3.4:2 B3.3:1 | C4.2 D4.1 D3.5 | G3.1:2 G2.5:1""",
    ),
    Piece(
        "ArpeggiosTwoHands",
        "Arpeggios, hands together",
        "exercise",
        exercise("C, F and G major over two octaves, up and down"),
        "hard",
        "0.6",
        8,
        right="""
            C4.1:1/2 E4.2 G4.3 C5.1 E5.2 G5.3 C6.5 G5.3 E5.2 C5.1 G4.3 E4.2 C4.1:1 r |
            F4.1:1/2 A4.2 C5.3 F5.1 A5.2 C6.3 F6.5 C6.3 A5.2 F5.1 C5.3 A4.2 F4.1:1 r |
            G4.1:1/2 B4.2 D5.3 G5.1 B5.2 D6.3 G6.5 D6.3 B5.2 G5.1 D5.3 B4.2 G4.1:1 r |
            C4.1+E4.2+G4.3+C5.5:2""",
        left="""
            C2.5:1/2 E2.4 G2.2 C3.1 E3.4 G3.2 C4.1 G3.2 E3.4 C3.1 G2.2 E2.4 C2.5:1 r |
            F2.5:1/2 A2.4 C3.2 F3.1 A3.4 C4.2 F4.1 C4.2 A3.4 F3.1 C3.2 A2.4 F2.5:1 r |
            G2.5:1/2 B2.4 D3.2 G3.1 B3.4 D4.2 G4.1 D4.2 B3.4 G3.1 D3.2 B2.4 G2.5:1 r |
            C2.5+G2.2+C3.1:2""",
    ),
    Piece(
        "BachPreludeInCMajor",
        "Prelude in C major",
        "Johann Sebastian Bach",
        composed("The Well-Tempered Clavier I, BWV 846 (1722), bars 1-11"),
        "hard",
        "0.6",
        4,
        right=BACH_RIGHT,
        left=BACH_LEFT,
    ),
    Piece(
        "FurEliseOpening",
        "Für Elise, opening",
        "Ludwig van Beethoven",
        composed("Bagatelle in A minor, WoO 59 (1810), bars 1-8 with the repeat"),
        "hard",
        "0.8",
        Fraction(3, 2),
        right=f"""
            E5.5:1/4 D#5.4 | {ELISE_RIGHT} | A4.2:1/2 r E5.5:1/4 D#5.4 |
            {ELISE_RIGHT} | A4.2:1""",
        left=f"""mp
            r:1/2 | {ELISE_LEFT} | {ELISE_A_MINOR} | {ELISE_LEFT} | A2.5:1/4 E3.2 A3.1:1/2""",
        pedal=f"r:1/2 | {ELISE_PEDAL} | P:1 r:1/2 | {ELISE_PEDAL} | P:1",
    ),
    Piece(
        "MoonlightOpening",
        "Moonlight Sonata, opening",
        "Ludwig van Beethoven",
        composed("Piano Sonata No. 14, Op. 27 No. 2 (1801), bars 1-5 without the melody's entry"),
        "hard",
        "1.2",
        4,
        right="p "
        + triplets("""
            4x G#3.1 C#4.2 E4.4
            4x G#3.1 C#4.2 E4.4
            2x A3.1 C#4.2 E4.4,   2x A3.1 D4.2 F#4.4
            G#3.1 B#3.2 F#4.5,    G#3.1 C#4.2 E4.4,  G#3.1 C#4.2 D#4.3,  F#3.1 B#3.2 D#4.4
            E3.1 G#3.2 C#4.4,     3x G#3.1 C#4.2 E4.4"""),
        left="""p
            C#2.5+C#3.1:4 | B1.5+B2.1 | A1.5+A2.1:2 F#1.5+F#2.1 | G#1.5+G#2.1 G#1.5+G#2.1 |
            C#2.5+G#2.2+C#3.1:4""",
        pedal="P:4 | P | P:2 P | P:1 P P P | P:4",
    ),
    Piece(
        "SonataFacileOpening",
        "Sonata facile, opening",
        "Wolfgang Amadeus Mozart",
        composed("Piano Sonata No. 16 in C major, K. 545 (1788), bars 1-4, trill left out"),
        "hard",
        "0.6",
        4,
        right="""
            C5.1:2 E5.3:1 G5.5 | B4.2:3/2 C5.3:1/4 D5.4 C5.3:1 r |
            A5.4:2 G5.3:1 C6.5 | G5.4:1 F5.3:1/2 E5.2:1/4 F5.3 E5.2:1 r""",
        left="mp "
        + alberti("""
                C4.5 E4.3 G4.1, C4.5 E4.3 G4.1, D4.5 F4.2 G4.1, C4.5 E4.3 G4.1,
                C4.5 F4.2 A4.1, C4.5 E4.3 G4.1, B3.5 D4.3 G4.1, C4.5 E4.3 G4.1"""),
    ),
)


def index() -> str:
    """Name and description of every piece, so that listing them reads no MIDI file."""
    lines = ["# Written by tools/write_pieces.py.\n"]
    for piece in PIECES:
        score = piece.score()
        seconds, grade = round(score.total_time, 2), round(grade_of(score, HANDS), 1)
        lines.append(f"\n[{piece.name}]\n")
        for key in ("title", "composer", "source", "difficulty"):
            lines.append(f"{key} = {json.dumps(getattr(piece, key), ensure_ascii=False)}\n")
        lines.append(f"grade = {grade}\nseconds = {seconds}\n")
        lines.append(f"hands = {bool(piece.right) + bool(piece.left)}\n")
    return "".join(lines)


def write_pieces(folder: Path) -> None:
    for piece in PIECES:
        score = piece.score()
        write_midi(score, folder / f"{piece.name}.mid")
        write_fingering(score, folder / f"{piece.name}.fingering")
    with write_atomically(folder / "index.toml") as file:
        file.write(index().encode())


def main() -> None:
    parser = argparse.ArgumentParser(description="Writes the bundled pieces.")
    parser.add_argument("folder", nargs="?", type=Path, default=PIECES_FOLDER)
    write_pieces(parser.parse_args().folder)


if __name__ == "__main__":
    main()
