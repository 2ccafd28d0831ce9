"""Styles of songs: their tempi, forms and chord progressions, and who plays what in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cadenza.music.etudes.band.accompaniment import (
    BRASS,
    CLOSE,
    FOUR_STRINGS,
    HIGH_CLOSE,
    HIGH_STRINGS,
    ORGAN,
    ROOTLESS,
    STRINGS,
    boom_chick,
    broken,
    chords,
    held,
    open_chords,
    piano,
    picked,
    power_chords,
    riff,
    voiced,
)
from cadenza.music.etudes.band.rhythm_section import (
    CLAP,
    CLAVES,
    CLOSED_HAT,
    HIGH_CONGA,
    KICK,
    LOW_CONGA,
    OPEN_HAT,
    PEDAL_HAT,
    RIDE,
    SHAKER,
    SNARE,
    STICK,
    TAMBOURINE,
    Pattern,
    approached,
    drums,
    patterned_bass,
    walking_bass,
)


@dataclass(frozen=True)
class Chair:
    """An instrument of an accompaniment: what it plays, and on what.

    `names` are those its track may have, `programs` those of General MIDI, `share` the percentage
    of songs that have it, `sections` the kinds of sections in which it plays, all if empty.
    """

    plays: tuple[Pattern, ...]
    programs: tuple[int, ...]
    names: tuple[str, ...]
    share: int = 100
    sections: tuple[str, ...] = ()
    pedal: bool = False
    """Whether a sustain pedal is moved with the harmonies, if the song has one."""


@dataclass(frozen=True)
class Style:
    """A style: tempi in quarters a minute, `swing` as the share of a beat that its first half has.

    `forms` are sections in their order, `bars` how many bars of how many `beats` each kind has,
    `progressions` their chords in major and minor keys. `cells` are the kinds of rhythms of the
    melody, `colours` its scales, `leads` the programs that can have it, `solos` those that take it
    over for a section.
    """

    tempi: range
    minor: int
    """Percentage of songs in minor keys."""
    forms: tuple[str, ...]
    bars: Mapping[str, int]
    progressions: Mapping[bool, Mapping[str, tuple[str, ...]]]
    cells: tuple[str, ...]
    colours: tuple[str, ...]
    leads: tuple[int, ...]
    solos: tuple[int, ...]
    bass: tuple[Pattern, ...]
    basses: tuple[int, ...]
    drums: Pattern
    chairs: tuple[Chair, ...]
    beats: int = 4
    swing: float = 0.5


# Sections: i intro, v verse, c chorus, b bridge, s solo, o outro, e the final chord.
SECTIONS = {
    "i": "intro",
    "v": "verse",
    "c": "chorus",
    "b": "bridge",
    "s": "solo",
    "o": "outro",
    "e": "ending",
}
_POP_FORMS = ("ivcvcoe", "ivcvcbce", "ivvcvcscce", "vcvcbcoe", "ivvcscoe", "ivcvcscoe", "ivcbce")
_SONG = {"intro": 4, "verse": 8, "chorus": 8, "bridge": 8, "solo": 8, "outro": 4, "ending": 1}
_LONG_SONG = _SONG | {"verse": 16, "chorus": 16, "solo": 16}
# In AABA songs a verse is an A of eight bars.
_AABA_FORMS = ("vvbve", "ivvbve", "ivvbvssbve", "vvbvsbve", "vvbvssbve", "ivvbvssbvvbve")
_BLUES_FORMS = ("vve", "vvse", "ivvsve", "vvssve", "ivvssvve", "vvvssvve")

_LOUD = ("chorus", "bridge", "ending")
_FULL = ("verse", "chorus", "bridge", "solo", "ending")

# Rhythms in bars of four quarters
_WHOLE = ((0.0, 4.0),)
_HALVES = ((0.0, 2.0), (2.0, 2.0))
_QUARTERS = tuple((float(beat), 0.9) for beat in range(4))
_EIGHTHS = tuple((i / 2, 0.45) for i in range(8))
_SYNCOPATED = ((0.0, 1.5), (1.5, 1.0), (2.5, 1.5))
_BACKBEAT = ((1.0, 0.5), (3.0, 0.5))
_OFFBEATS = tuple((i + 0.5, 0.4) for i in range(4))
_STRUM = ((0.0, 1.0), (1.0, 0.5), (1.5, 1.0), (2.5, 0.5), (3.0, 0.5), (3.5, 0.5))
_STRUM_CALM = ((0.0, 1.0), (1.0, 1.0), (2.0, 0.5), (2.5, 0.5), (3.0, 1.0))
_CHARLESTON = ((0.0, 1.0), (1.5, 0.5))
_LATE_CHARLESTON = ((0.5, 0.5), (2.0, 1.0), (5.5, 0.5), (7.0, 0.5))
_COMP = ((1.5, 0.5), (3.5, 0.5), (5.0, 0.4), (6.5, 1.0))
_BOSSA = ((0.0, 0.5), (1.5, 0.5), (3.0, 0.5), (5.0, 0.5), (6.5, 0.5))
_BOSSA_FULL = ((0.0, 1.0), (1.0, 0.5), (2.5, 0.5), (3.5, 0.5), (5.5, 0.5), (7.0, 0.5))
_STABS = ((0.0, 0.4), (1.5, 0.4), (5.5, 0.4), (7.5, 0.5))
_STABS_LATE = ((2.5, 0.4), (3.5, 0.5), (7.0, 0.4))
# ... and of three
_WALTZ_WHOLE = ((0.0, 3.0),)
_WALTZ_CHORDS = ((1.0, 0.9), (2.0, 0.9))
_WALTZ_STRUM = ((0.0, 1.0), (1.0, 0.5), (1.5, 0.5), (2.0, 1.0))

_RIFFS = (
    (0.0, 1.0, 1.5, 2.5, 3.0),
    (0.0, 0.5, 1.5, 2.0, 3.0, 3.5),
    (0.5, 1.0, 1.5, 2.5, 3.5),
    (0.0, 0.75, 1.5, 2.0, 2.5, 3.0, 3.5),
)

_ROOT_FIFTH = patterned_bass([(0, 1.8, "r"), (2, 1.8, "f")])
_EIGHTH_BASS = patterned_bass([(i / 2, 0.45, "r") for i in range(8)])
_ROCK_BASS = patterned_bass(
    [(0, 0.9, "r"), (1, 0.45, "r"), (1.5, 0.45, "r"), (2.5, 0.45, "r"), (3, 0.9, "f")]
)
_BALLAD_BASS = patterned_bass([(0, 1.4, "r"), (1.5, 0.45, "r"), (2, 1.9, "r")])
_WHOLE_BASS = patterned_bass([(0, 3.9, "r")])
_BOSSA_BASS = patterned_bass([(0, 1.4, "r"), (1.5, 0.4, "f"), (2, 1.4, "f"), (3.5, 0.4, "r")])
_OCTAVE_BASS = patterned_bass([(i / 2, 0.4, "ro"[i % 2]) for i in range(8)])
_DRIVING_BASS = patterned_bass([(i / 4, 0.2, "r") for i in range(16) if i % 4])
_BOOGIE_BASS = patterned_bass(
    [(0, 0.9, "r"), (1, 0.45, "r"), (1.5, 0.45, "f"), (2, 0.9, "r"), (3, 0.9, "o")]
)
_WALTZ_BASS = patterned_bass([(0, 0.9, "r"), (3, 0.9, "f")])
_WALTZ_BASS_CALM = patterned_bass([(0, 2.8, "r")])

_POP_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "verse": (
            "I | V/VII | vi | IV",
            "I | vi | IV | V",
            "I | iii | IV | V",
            "vi | IV | I | V",
            "I | IV | I | V | I | IV | ii V | I",
            "Iadd9 | V | ii7 | IV V",
            "I | I | IV | IV | vi | V | IV | V",
        ),
        "chorus": (
            "I | V | vi | IV",
            "IV | V | I | vi | IV | V | I | I",
            "I | IV | vi | V",
            "IV | I | V | vi",
            "I | I/III | IV | V",
            "vi | V | IV | V | vi | V | IV V | I",
        ),
        "bridge": (
            "vi | iii | IV | I | vi | iii | ii7 | V7sus4",
            "IV | V | iii | vi | ii7 | V | I | V7",
            "bVI | bVII | I | I | bVI | bVII | V | V",
            "ii7 | V | iii7 | vi | IV | I/III | ii7 | V",
        ),
    },
    True: {
        "verse": (
            "i | bVI | bIII | bVII",
            "i | bVII | bVI | V7",
            "i | iv | bVII | bIII | bVI | iv | V7sus4 | V7",
            "i | i | bVI | bVII",
            "i | v | bVI | bVII",
        ),
        "chorus": (
            "bVI | bVII | i | i",
            "bVI | bIII | bVII | i",
            "i | bVI | bIII | bVII",
            "iv | bVII | bIII | bVI | iv | V7 | i | i",
        ),
        "bridge": (
            "iv | bVII | bIII | bVI | iv | i | V7sus4 | V7",
            "bVI | bVII | v | i | bVI | bVII | V7sus4 | V7",
        ),
    },
}
_ROCK_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "verse": ("I | bVII | IV | I", "I | I | IV | I | V | IV | I | V", "I | IV | I | V"),
        "chorus": ("I | V | vi | IV", "IV | I | bVII | IV | IV | I | V | V", "I | V | IV | V"),
        "bridge": ("vi | IV | vi | IV | vi | IV | V | V", "bVI | bVII | I | I"),
    },
    True: {
        "verse": ("i | i | bVII | bVI", "i | bVII | i | bVII", "i | bIII | iv | bVI bVII"),
        "chorus": ("i | bVI | bIII | bVII", "bVI | bVII | i | i", "i | bVII | iv | i"),
        "bridge": ("iv | iv | i | i | iv | iv | V | V", "bVI | bVI | bVII | bVII"),
    },
}
_SWING_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "intro": ("Imaj7 vi7 | ii7 V7 | iii7 VI7 | ii7 V7",),
        "verse": (
            "Imaj7 VI7 | ii7 V7 | iii7 VI7 | ii7 V7 | I7 | IVmaj7 iv6 | iii7 VI7 | ii7 V7",
            "Imaj7 | vi7 | ii7 | V7 | iii7 VI7b9 | ii7 V7 | I6 VI7 | ii7 V7",
            "I6 | II7 | ii7 V7 | I6 | Imaj7 | II7 | ii7 V7 | I6 V7",
            "ii7 | V7 | Imaj7 | IVmaj7 | iim7b5 | V7b9 | Imaj7 | I6",
        ),
        "bridge": (
            "III7 | III7 | VI7 | VI7 | II7 | II7 | ii7 | V7",
            "v7 | I7 | IVmaj7 | IV6 | vi7 | II7 | ii7 | V7",
        ),
    },
    True: {
        "intro": ("i6 | iim7b5 V7b9 | i6 | iim7b5 V7b9",),
        "verse": (
            "i6 | i6 | iim7b5 | V7b9 | iv7 bVII7 | bIIImaj7 bVImaj7 | iim7b5 V7b9 | i6",
            "iv7 | bVII7 | bIIImaj7 | bVImaj7 | iim7b5 | V7b9 | i6 | i6",
            "i7 | iv7 | i7 | i7 | bVI7 | V7 | i6 | iim7b5 V7b9",
        ),
        "bridge": (
            "v7 | I7 | iv7 | iv7 | iv7 | bVII7 | bIIImaj7 | V7b9",
            "iim7b5 | V7b9 | i6 | i6 | iv7 | bVII7 | bIIImaj7 | V7b9",
        ),
    },
}
_BOSSA_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "intro": ("Imaj9 | bIImaj7 | Imaj9 | bIImaj7", "ii9 | V7sus4 | ii9 | V7b9"),
        "verse": (
            "Imaj7 | Imaj7 | II9 | II9 | ii7 | V7 | Imaj7 | bIImaj7",
            "Imaj9 | vi9 | ii9 | V9 | iii7 | VI7b9 | ii9 | V7sus4",
            "I6 | IVmaj7 | iii7 | VI7 | ii7 | V7 | Imaj7 | V7sus4",
        ),
        "bridge": (
            "iv7 | bVII9 | bIIImaj7 | bIIImaj7 | iii7 | VI7 | ii7 | V7",
            "IVmaj7 | iv6 | iii7 | VI7b9 | ii9 | V9 | Imaj9 | V7sus4",
        ),
    },
    True: {
        "intro": ("i9 | iv9 | i9 | V7b9",),
        "verse": (
            "i6 | i6 | iv7 | iv7 | iim7b5 | V7b9 | i6 | V7b9",
            "i9 | iv9 | bVII9 | bIIImaj7 | bVImaj7 | iim7b5 | V7b9 | i9",
        ),
        "bridge": (
            "bIIImaj7 | bIIImaj7 | iv7 bVII7 | bIIImaj7 | iim7b5 | V7b9 | i6 | V7b9",
            "iv9 | bVII9 | bIIImaj7 | bVImaj7 | iim7b5 | iim7b5 | V7b9 | V7b9",
        ),
    },
}
_COUNTRY_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "verse": (
            "I | I | IV | I | I | I | V | V",
            "I | IV | I | V | I | IV | V | I",
            "I | vi | IV | V",
            "I | V | IV | I",
        ),
        "chorus": (
            "IV | IV | I | I | IV | I | V | V7",
            "IV | I | V | I",
            "I | I7 | IV | I | I | V | I | I",
        ),
        "bridge": ("vi | vi | IV | I | II7 | II7 | V | V7", "IV | I | IV | I | IV | I | II7 | V7"),
    },
    True: {
        "verse": ("i | bVII | i | i | i | bVII | bVI | V", "i | iv | i | V7"),
        "chorus": ("bIII | bVII | i | i | bIII | bVII | V7 | i", "iv | i | V7 | i"),
        "bridge": ("bVI | bIII | bVII | i | bVI | bIII | V7 | V7",),
    },
}
_BLUES_PROGRESSIONS: Mapping[bool, Mapping[str, tuple[str, ...]]] = {
    False: {
        "intro": ("V7 | IV7 | I7 | V7", "I7 | IV7 | I7 | V7"),
        "verse": (
            "I7 | I7 | I7 | I7 | IV7 | IV7 | I7 | I7 | V7 | IV7 | I7 | V7",
            "I7 | IV7 | I7 | I7 | IV7 | IV7 | I7 | VI7 | ii7 | V7 | I7 VI7 | ii7 V7",
            "I7 | IV7 | I7 | I7 | IV7 | IV7 | I7 | I7 | V7 | V7 | I7 | I7",
        ),
    },
    True: {
        "intro": ("i7 | iv7 | i7 | V7",),
        "verse": (
            "i7 | i7 | i7 | i7 | iv7 | iv7 | i7 | i7 | bVI7 | V7 | i7 | V7",
            "i7 | iv7 | i7 | i7 | iv7 | iv7 | i7 | i7 | V7 | iv7 | i7 | i7",
        ),
    },
}

# Programs of General MIDI, counted from 0.
_PIANOS, _E_PIANOS, _ORGANS = (0, 0, 1, 2), (4, 5), (16, 17, 18)
_NYLON, _STEEL, _JAZZ, _CLEAN, _MUTED, _OVERDRIVEN, _DISTORTION = 24, 25, 26, 27, 28, 29, 30
_VOICES = (52, 53, 54, 85)
_ENSEMBLES, _SYNTH_STRINGS = (48, 49), (50, 51)

_PIANO_NAMES = ("Piano", "PIANO", "Pno", "Grand Piano", "Piano 1", "Keys")
_GUITAR_NAMES = ("Guitar", "Gtr", "Acoustic Gtr", "Rhythm Guitar", "Guitar 1", "GUITAR")
_STRING_NAMES = ("Strings", "STRINGS", "Str", "Slow Strings", "String Pad")
_ORGAN_NAMES = ("Organ", "Hammond", "ORGAN", "B3")
_BRASS_NAMES = ("Brass", "Horns", "Brass Section", "HORNS")
_PAD_NAMES = ("Pad", "Synth Pad", "Warm Pad", "PAD")

_BALLAD_CHAIRS = (
    Chair(
        (piano(CLOSE, _HALVES, _QUARTERS, _WHOLE), piano(CLOSE, _QUARTERS, _QUARTERS, _SYNCOPATED)),
        (*_PIANOS, *_E_PIANOS),
        _PIANO_NAMES,
        90,
        pedal=True,
    ),
    Chair((picked, chords(open_chords, _STRUM_CALM)), (_NYLON, _STEEL), _GUITAR_NAMES, 65),
    Chair(
        (held(STRINGS), held(FOUR_STRINGS), held(HIGH_STRINGS)),
        (*_ENSEMBLES, *_SYNTH_STRINGS),
        _STRING_NAMES,
        85,
        _LOUD,
    ),
    Chair((held(ORGAN),), (*_ORGANS, 89, 91), ("Organ", "Pad", "Hammond"), 30, _FULL),
)
_BALLAD_DRUMS = drums(
    {CLOSED_HAT: "x-o-x-o-x-o-x-o-", KICK: "x-----o-x-------", SNARE: "----X-------X---"},
    {CLOSED_HAT: "xoooxoooxoooxooo", KICK: "x---------x-----", STICK: "----x-------x---"},
    {RIDE: "x-o-x-o-x-o-x-o-", KICK: "x------ox-x-----", SNARE: "----X-------X---"},
)

STYLES: dict[str, Style] = {
    "ballad": Style(
        tempi=range(70, 93),
        minor=30,
        forms=_POP_FORMS,
        bars=_SONG,
        progressions=_POP_PROGRESSIONS,
        cells=("straight", "sixteenths", "syncopated"),
        colours=("scale", "scale", "pentatonic"),
        leads=(*_VOICES, 65, 66, 73, 68, 0, 4, 40, 71, 11),
        solos=(65, 66, 26, 27, 73, 68, 40, 22),
        bass=(
            approached(_BALLAD_BASS, 40),
            approached(_WHOLE_BASS, 40),
            approached(_ROOT_FIFTH, 20),
        ),
        basses=(32, 33, 33, 35),
        drums=_BALLAD_DRUMS,
        chairs=_BALLAD_CHAIRS,
    ),
    "rock": Style(
        tempi=range(108, 161),
        minor=45,
        forms=_POP_FORMS,
        bars=_LONG_SONG,
        progressions=_ROCK_PROGRESSIONS,
        cells=("straight", "syncopated"),
        colours=("pentatonic", "pentatonic", "scale", "blues"),
        leads=(*_VOICES, 54, 65, 81, 80, 27),
        solos=(_OVERDRIVEN, _DISTORTION, _DISTORTION, 18, 66),
        bass=(_EIGHTH_BASS, _ROCK_BASS, approached(_EIGHTH_BASS, 40)),
        basses=(33, 34, 34),
        drums=drums(
            {CLOSED_HAT: "x-o-x-o-x-o-x-o-", KICK: "X-----x-x-------", SNARE: "----X-------X---"},
            {CLOSED_HAT: "x-o-x-o-x-o-x-o-", KICK: "X-------x-x-----", SNARE: "----X-------X---"},
            {OPEN_HAT: "x---x---x---x---", KICK: "X--x--x---x-----", SNARE: "----X-------X---"},
            {RIDE: "x-x-x-x-x-x-x-x-", KICK: "X-x-----x-x-----", SNARE: "----X-------X-.-"},
        ),
        chairs=(
            Chair(
                (chords(power_chords, _EIGHTHS, _SYNCOPATED), chords(power_chords, _HALVES)),
                (_OVERDRIVEN, _DISTORTION),
                ("Dist Gtr", "Rhythm Guitar", "Gtr 1", "Guitar L", "Crunch"),
                90,
            ),
            Chair(
                (chords(open_chords, _STRUM), chords(open_chords, _STRUM_CALM)),
                (_CLEAN, _STEEL),
                _GUITAR_NAMES,
                75,
            ),
            Chair(
                (
                    piano(HIGH_CLOSE, _HALVES, _EIGHTHS, _QUARTERS),
                    chords(voiced(HIGH_CLOSE), _EIGHTHS),
                ),
                _PIANOS,
                _PIANO_NAMES,
                40,
                pedal=True,
            ),
            Chair((held(ORGAN),), _ORGANS, _ORGAN_NAMES, 45),
            Chair((held(FOUR_STRINGS),), (*_ENSEMBLES, 50), _STRING_NAMES, 25, _LOUD),
            Chair((riff(52, *_RIFFS),), (_MUTED, _CLEAN, _OVERDRIVEN), ("Riff", "Gtr 3"), 30),
            Chair((chords(voiced(BRASS), _STABS, _STABS_LATE),), (61, 62), _BRASS_NAMES, 15, _LOUD),
        ),
    ),
    "swing": Style(
        tempi=range(112, 161),
        swing=0.64,
        minor=30,
        forms=_AABA_FORMS,
        bars=_SONG,
        progressions=_SWING_PROGRESSIONS,
        cells=("swing",),
        colours=("scale",),
        leads=(65, 66, 56, 59, 71, 11, 26, 0, 52, 53, 57, 22),
        solos=(66, 56, 0, 11, 26, 71, 57),
        bass=(walking_bass,),
        basses=(32, 32, 32, 35),
        drums=drums(
            {RIDE: "x-xox-xo", PEDAL_HAT: "--x---x-", KICK: "o---o---"},
            {RIDE: "x-xox-xo", PEDAL_HAT: "--x---x-", SNARE: "---.---."},
            {CLOSED_HAT: "x-xox-xo", KICK: "x-o-x-o-", SNARE: "--------|-----o--"},
        ),
        chairs=(
            Chair(
                (
                    chords(voiced(ROOTLESS), _CHARLESTON, _LATE_CHARLESTON, _COMP),
                    piano(CLOSE, _HALVES, _CHARLESTON, _COMP),
                ),
                (0, 0, 1),
                _PIANO_NAMES,
                90,
            ),
            Chair((chords(voiced(ROOTLESS), _QUARTERS),), (_JAZZ,), ("Guitar", "Jazz Gtr"), 50),
            Chair((chords(voiced(BRASS), _STABS, _STABS_LATE),), (61, 57, 66), _BRASS_NAMES, 50),
            Chair((held(FOUR_STRINGS),), _ENSEMBLES, _STRING_NAMES, 25),
            Chair((held(ORGAN),), (16, 17), _ORGAN_NAMES, 15),
        ),
    ),
    "bossa": Style(
        tempi=range(104, 145),
        minor=35,
        forms=_AABA_FORMS,
        bars=_SONG,
        progressions=_BOSSA_PROGRESSIONS,
        cells=("syncopated", "straight"),
        colours=("scale",),
        leads=(73, 65, 66, 52, 53, 11, 24, 71, 56, 0),
        solos=(73, 66, 11, 24, 0, 26),
        bass=(_BOSSA_BASS, _ROOT_FIFTH),
        basses=(32, 32, 33, 35),
        drums=drums(
            {
                CLOSED_HAT: "xoooxoooxoooxooo",
                KICK: "x-----x-x-----x-",
                STICK: "x-----x-----x---|----x-----x-----",
            },
            {SHAKER: "xoxoxoxoxoxoxoxo", KICK: "x-----x-x-----x-", CLAVES: "x--x--x-----x---"},
            {
                SHAKER: "x-o-x-o-x-o-x-o-",
                HIGH_CONGA: "x---x---x---x---",
                LOW_CONGA: "------------x-x-",
                STICK: "x--x--x-----x---",
            },
        ),
        chairs=(
            Chair(
                (chords(voiced(ROOTLESS), _BOSSA, _BOSSA_FULL), chords(open_chords, _BOSSA)),
                (_NYLON,),
                ("Guitar", "Nylon Gtr", "Violao", "Gtr"),
                90,
            ),
            Chair(
                (
                    chords(voiced(ROOTLESS), _BOSSA, _COMP),
                    piano(CLOSE, _HALVES, _BOSSA, _SYNCOPATED),
                ),
                (*_PIANOS, *_E_PIANOS),
                _PIANO_NAMES,
                65,
                pedal=True,
            ),
            Chair(
                (held(STRINGS), held(HIGH_STRINGS)),
                (*_ENSEMBLES, 50),
                _STRING_NAMES,
                55,
                ("bridge", "solo", "ending"),
            ),
            Chair((chords(voiced(BRASS), _STABS_LATE),), (61,), _BRASS_NAMES, 15, ("bridge",)),
        ),
    ),
    "country": Style(
        tempi=range(90, 151),
        minor=15,
        forms=_POP_FORMS,
        bars=_SONG | {"verse": 16},
        progressions=_COUNTRY_PROGRESSIONS,
        cells=("straight", "syncopated"),
        colours=("scale", "pentatonic"),
        leads=(*_VOICES, 22, 110, 73, 25, 105),
        solos=(22, 110, 25, 27, 105, 0),
        bass=(approached(_ROOT_FIFTH, 40), _ROOT_FIFTH),
        basses=(32, 33, 33),
        drums=drums(
            {SNARE: ".-o-.-o-.-o-.-o-", KICK: "x-------x-------", STICK: "----x-------x---"},
            {CLOSED_HAT: "x-o-x-o-x-o-x-o-", KICK: "x-----x-x-------", SNARE: "----x-------x---"},
            {TAMBOURINE: "--x---x---x---x-", KICK: "x-------x-------", SNARE: "----x-------x---"},
        ),
        chairs=(
            Chair(
                (boom_chick, chords(open_chords, _STRUM, _STRUM_CALM)), (_STEEL,), _GUITAR_NAMES, 95
            ),
            Chair((picked,), (105, 24, 27), ("Banjo", "Picking", "Gtr 2"), 45),
            Chair(
                (piano(CLOSE, _HALVES, _BACKBEAT, _SYNCOPATED),),
                (0, 3),
                _PIANO_NAMES,
                45,
                _FULL,
                pedal=True,
            ),
            Chair(
                (held(FOUR_STRINGS), held(HIGH_STRINGS)),
                (48, 49, 110),
                ("Strings", "Fiddles", "Str"),
                35,
                _LOUD,
            ),
            Chair((held(HIGH_CLOSE),), (26, 21), ("Steel Gtr", "Accordion"), 30, _FULL),
        ),
    ),
    "waltz": Style(
        tempi=range(84, 151),
        beats=3,
        minor=30,
        forms=_POP_FORMS,
        bars=_LONG_SONG,
        progressions=_COUNTRY_PROGRESSIONS,
        cells=("waltz",),
        colours=("scale",),
        leads=(*_VOICES, 40, 21, 73, 22, 110, 71),
        solos=(40, 21, 110, 22, 73, 0),
        bass=(_WALTZ_BASS, approached(_WALTZ_BASS_CALM, 40)),
        basses=(32, 33),
        drums=drums(
            {KICK: "x-----", SNARE: "--o-o-", CLOSED_HAT: "xoxoxo"},
            {KICK: "x-----", STICK: "--x-x-", RIDE: "x-x-x-"},
        ),
        chairs=(
            Chair(
                (chords(open_chords, _WALTZ_CHORDS, _WALTZ_STRUM), picked),
                (_NYLON, _STEEL),
                _GUITAR_NAMES,
                85,
            ),
            Chair(
                (piano(CLOSE, _WALTZ_WHOLE, _WALTZ_CHORDS),),
                (0, 0, 4, 21),
                _PIANO_NAMES,
                60,
                pedal=True,
            ),
            Chair((held(STRINGS), held(HIGH_STRINGS)), (*_ENSEMBLES, 50), _STRING_NAMES, 60, _LOUD),
        ),
    ),
    "synth pop": Style(
        tempi=range(100, 137),
        minor=55,
        forms=_POP_FORMS,
        bars=_SONG | {"intro": 8, "verse": 16},
        progressions=_POP_PROGRESSIONS,
        cells=("syncopated", "straight"),
        colours=("pentatonic", "scale"),
        leads=(*_VOICES, 80, 81, 81, 87, 62, 73),
        solos=(81, 80, 87, 29, 66),
        bass=(_OCTAVE_BASS, _EIGHTH_BASS, _DRIVING_BASS),
        basses=(38, 39, 38),
        drums=drums(
            {KICK: "X---X---X---X---", CLAP: "----X-------X---", OPEN_HAT: "--x---x---x---x-"},
            {KICK: "X---X---X---X---", SNARE: "----X-------X---", CLOSED_HAT: "xoxoxoxoxoxoxoxo"},
            {KICK: "X-----x-X-------", SNARE: "----X-------X---", CLOSED_HAT: "x-x-x-x-x-x-x-x-"},
        ),
        chairs=(
            Chair(
                (
                    broken(60, 0.25, (0, 1, 2, 3), (0, 2, 4, 2, 1, 3, 5, 3), (3, 2, 1, 0)),
                    broken(64, 0.5, (0, 1, 2, 3, 4, 3, 2, 1), (0, 3, 1, 4, 2, 5, 3, 6)),
                ),
                (81, 80, 88, 90, 98),
                ("Arp", "Sequence", "Synth Arp", "ARP 1", "Sequencer"),
                80,
            ),
            Chair((held(STRINGS), held(FOUR_STRINGS)), (88, 89, 90, 94, 50), _PAD_NAMES, 85),
            Chair(
                (chords(voiced(HIGH_CLOSE), _OFFBEATS, _SYNCOPATED, _STABS),),
                (62, 90, 81, 5),
                ("Synth", "Poly Synth", "Keys", "Synth 2"),
                70,
                _FULL,
            ),
            Chair((chords(power_chords, _EIGHTHS),), (_MUTED, _CLEAN), ("Muted Gtr", "Gtr"), 30),
            Chair((riff(60, *_RIFFS), riff(72, *_RIFFS)), (81, 5, 87, 98), ("Synth 3", "Hook"), 35),
            Chair((held(HIGH_STRINGS),), (50, 51, 48), _STRING_NAMES, 40, _LOUD),
        ),
    ),
    "blues": Style(
        tempi=range(80, 133),
        swing=0.66,
        minor=25,
        forms=_BLUES_FORMS,
        bars={"intro": 4, "verse": 12, "solo": 12, "ending": 1},
        progressions=_BLUES_PROGRESSIONS,
        cells=("swing", "straight"),
        colours=("blues", "blues", "pentatonic"),
        leads=(*_VOICES, 22, 66, 65, 27, 29, 56),
        solos=(22, 27, 29, 66, 0, 26),
        bass=(walking_bass, _BOOGIE_BASS, _ROOT_FIFTH),
        basses=(32, 33, 33),
        drums=drums(
            {CLOSED_HAT: "xoxoxoxo", KICK: "x---x-o-", SNARE: "--X---X-"},
            {RIDE: "x-xox-xo", KICK: "x---x---", SNARE: "--X---X-"},
        ),
        chairs=(
            Chair(
                (
                    piano(CLOSE, _QUARTERS, _CHARLESTON, _OFFBEATS, _COMP),
                    chords(voiced(ROOTLESS), _CHARLESTON, _LATE_CHARLESTON),
                ),
                (0, 1, 3),
                _PIANO_NAMES,
                70,
            ),
            Chair(
                (chords(open_chords, _BACKBEAT, _STRUM_CALM), chords(power_chords, _EIGHTHS)),
                (_CLEAN, _STEEL, _JAZZ),
                _GUITAR_NAMES,
                85,
            ),
            Chair((held(ORGAN),), _ORGANS, _ORGAN_NAMES, 50),
            Chair((chords(voiced(BRASS), _STABS, _STABS_LATE),), (61, 66), _BRASS_NAMES, 40),
            Chair((riff(55, *_RIFFS),), (66, 57, 27), ("Sax Riff", "Riff"), 25, ("verse",)),
        ),
    ),
}

USUAL_RANGE = (60, 84)
RANGES: dict[int, tuple[int, int]] = {
    22: (60, 81),
    24: (55, 79),
    25: (55, 79),
    26: (55, 79),
    27: (55, 81),
    29: (55, 84),
    30: (55, 84),
    40: (60, 88),
    110: (60, 86),
    56: (58, 79),
    57: (48, 69),
    59: (58, 77),
    62: (60, 81),
    65: (56, 77),
    66: (50, 71),
    68: (60, 81),
    71: (55, 79),
    73: (65, 89),
    87: (57, 81),
    105: (55, 79),
}
"""Program of an instrument -> the lowest and highest pitch of its melodies, if not as usual."""
VOICE_RANGES = ((57, 76), (55, 74), (48, 67), (52, 71), (60, 79))
"""The ranges of voices: of women, of men, and of men written an octave higher."""
VOICE_PROGRAMS = frozenset(_VOICES)
