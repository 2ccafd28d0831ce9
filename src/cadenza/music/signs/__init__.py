"""What the signs of a score mean: from notes as written to notes as they sound.

Here are the conventions by which they are played: how long, how fast, how loud.

Nothing here knows a file format. Places and lengths in a score are `Fraction`s of a quarter, so
that what is written together sounds together to the bit; seconds come from a `TempoMap`.

Sources are named in short: Bach is C. P. E. Bach, Versuch über die wahre Art das Clavier zu
spielen, 1753; Türk the Klavierschule, Leipzig 1789; Grove A Dictionary of Music and Musicians,
London 1879-1889; Gehrkens Music Notation and Terminology, New York 1914. MuseScore's figures are
those that its program (github.com/musescore/MuseScore) and the instruments in its files have by
default.
"""

NOTES_A_SECOND = 12.0
"""The speed of trills and other ornaments, and the most of tremolos [1/s]; a choice."""
ARPEGGIO_STEP = 0.04  # the time from a note of a broken chord to the next [s]; a choice
GRACE_LENGTH = 0.1  # the time that a short grace note takes before the beat [s]; a choice

STACCATO = 0.5  # the length of staccato notes, as a share of the written one; MuseScore's
STACCATISSIMO = 0.33  # the length of notes with a wedge, as a share of the written one; MuseScore's
PORTATO = 0.67
"""The length of staccato notes under a slur or with a line, as such a share; MuseScore's."""
MARCATO = 0.67  # the length of notes with an upright wedge, as such a share; MuseScore's
PHRASE_LIFT = 0.05
"""How much earlier the last note under a slur ends [s], at most half of it; a choice."""
BREATH = 0.15
"""How much earlier a note ends before a breath mark [s], at most half of it; a choice. As with
MuseScore, the beat goes on."""

ACCENT = 1.15
"""The velocity of notes with an accent, as a multiple of the velocity around them; a choice, below
that of marcato."""
STRONG_ACCENT = 1.2  # the velocity of notes with an upright wedge, as such a multiple; MuseScore's
SFORZATO = 1.5  # the velocity of notes with sf, sfz and the like, as such a multiple; MuseScore's
HAIRPIN_STEP = 16
"""The change of velocity over a hairpin without a goal: the distance of two dynamics."""
OPEN_HAIRPIN = 8  # how far a cresc. or dim. reaches that no dynamic ends [quarters]; a choice.

FERMATA = 2.0
"""How many times longer a note with a fermata is; MuseScore's, and as Türk says of slow pieces and
long notes."""
SHORT_FERMATA = 1.5  # how many times longer a note with the angled sign is; MuseScore's
LONG_FERMATA = 3.0  # how many times longer a note with the square sign is; MuseScore's
CHORALE_FERMATA = 1.0
"""How many times longer a note with a fermata is in a chorale, where it only shows that a line
ends; a choice. In a chorale, four fermatas or more are 1.5 to 6 bars apart in the mean."""
CAESURA = 0.5  # the silence at a caesura [s]; a choice. MuseScore has 2 s.
RITARDANDO = 0.75
"""The tempo at the end of a ritardando without a goal, as a share of that before it; that of
MuseScore."""
ACCELERANDO = 1.33
"""The tempo at the end of an accelerando without a goal, as such a share; MuseScore's."""
OPEN_RAMP = 16
"""How far a change of tempo reaches that no mark ends [quarters], before the tempo is as it was; a
choice."""
MENO_MOSSO = 0.85  # the tempo after meno mosso or ritenuto, as a share of that before it; a choice
PIU_MOSSO = 1.15  # the tempo after più mosso, as such a share; a choice
