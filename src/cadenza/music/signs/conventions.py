"""The conventions by which signs are played: how long, how fast, how loud."""

from __future__ import annotations

from dataclasses import dataclass

from cadenza.configs import in_short


@dataclass(frozen=True, slots=True)
class Conventions:
    """What the signs of a score mean in numbers; each field says where its default is from.

    MuseScore's figures are those that its program (github.com/musescore/MuseScore) and the
    instruments in its files have by default; Grove is A Dictionary of Music and Musicians, London
    1879-1889; Gehrkens is Music Notation and Terminology, New York 1914; Türk is the Klavierschule,
    Leipzig 1789. A choice is our own.
    """

    ornaments: bool = True
    """Play trills, mordents (as Grove does), turns (as Gehrkens does), slides and tremolos."""
    notes_a_second: float = 12.0
    """The speed of trills and other ornaments, and the most of tremolos [1/s]; a choice."""
    trills_from_above: bool = True
    """Begin trills on the upper neighbour, as C. P. E. Bach (1753) does, unless a grace note
    leads to the note; else on the note itself."""
    arpeggios: bool = True
    """Break chords with a wavy line, as Gehrkens does; from the beat on, a choice."""
    arpeggio_step: float = 0.04
    """The time from a note of a broken chord to the next [s]; a choice."""
    grace_length: float = 0.1
    """The time that a short grace note takes before the beat [s]; a choice."""
    appoggiaturas: bool = True
    """Play a single grace note without a stroke on the beat, as long as it shows, as Grove does,
    but at most half of the note or two thirds of a dotted one, as Gehrkens does."""
    staccato: float = 0.5
    """The length of staccato notes, as a share of the written one; MuseScore's."""
    staccatissimo: float = 0.33
    """The length of notes with a wedge, as a share of the written one; MuseScore's."""
    portato: float = 0.67
    """The length of staccato notes under a slur or with a line, as such a share; MuseScore's."""
    marcato: float = 0.67
    """The length of notes with an upright wedge, as such a share; MuseScore's."""
    phrase_lift: float = 0.05
    """How much earlier the last note under a slur ends [s], at most half of it; a choice."""
    breath: float = 0.15
    """How much earlier a note ends before a breath mark [s], at most half of it; a choice.
    As with MuseScore, the beat goes on."""
    accent: float = 1.15
    """The velocity of notes with an accent, as a multiple of the velocity around them; a choice,
    below that of marcato."""
    strong_accent: float = 1.2
    """The velocity of notes with an upright wedge, as such a multiple; MuseScore's."""
    sforzato: float = 1.5
    """The velocity of notes with sf, sfz and the like, as such a multiple; MuseScore's."""
    hairpin_step: int = 16
    """The change of velocity over a hairpin without a goal: the distance of two dynamics."""
    hairpins: bool = True
    """Become louder or softer little by little under hairpins, and after cresc. and dim."""
    open_hairpin: float = 8.0
    """How far a cresc. or dim. reaches that no dynamic ends [quarters]; a choice."""
    fermata: float = 2.0
    """How many times longer a note with a fermata is; MuseScore's, and as Türk says of slow pieces
    and long notes."""
    short_fermata: float = 1.5
    """How many times longer a note with the angled sign is; MuseScore's."""
    long_fermata: float = 3.0
    """How many times longer a note with the square sign is; MuseScore's."""
    chorale_fermata: float = 1.0
    """How many times longer a note with a fermata is in a chorale, where it only shows that a line
    ends; a choice. In a chorale, four fermatas or more are 1.5 to 6 bars apart in the mean."""
    caesura: float = 0.5
    """The silence at a caesura [s]; a choice. MuseScore has 2 s."""
    ritardando: float = 0.75
    """The tempo at the end of a ritardando without a goal, as a share of that before it;
    MuseScore's."""
    accelerando: float = 1.33
    """The tempo at the end of an accelerando without a goal, as such a share; MuseScore's."""
    open_ramp: float = 16.0
    """How far a change of tempo reaches that no mark ends [quarters], before the tempo is as it
    was; a choice."""
    meno_mosso: float = 0.85
    """The tempo after meno mosso or ritenuto, as a share of that before it; a choice."""
    piu_mosso: float = 1.15
    """The tempo after più mosso, as such a share; a choice."""
    swing: bool = True
    """Play notes off the beat later where the score says swing."""

    __repr__ = in_short

    @classmethod
    def plain(cls) -> Conventions:
        """The conventions by which notes are played as they stand, whatever signs they have."""
        return cls(
            ornaments=False,
            arpeggios=False,
            appoggiaturas=False,
            staccato=1.0,
            staccatissimo=1.0,
            portato=1.0,
            marcato=1.0,
            phrase_lift=0.0,
            breath=0.0,
            accent=1.0,
            strong_accent=1.0,
            sforzato=1.0,
            hairpins=False,
            fermata=1.0,
            short_fermata=1.0,
            long_fermata=1.0,
            chorale_fermata=1.0,
            caesura=0.0,
            ritardando=1.0,
            accelerando=1.0,
            meno_mosso=1.0,
            piu_mosso=1.0,
            swing=False,
        )
