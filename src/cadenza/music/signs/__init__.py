"""What the signs of a score mean: from notes as written to notes as they sound.

Nothing here knows a file format. Places and lengths in a score are `Fraction`s of a quarter, so
that what is written together sounds together to the bit; seconds come from a `TempoMap`.

Sources are named in short: Bach is C. P. E. Bach, Versuch über die wahre Art das Clavier zu
spielen, 1753; Türk the Klavierschule, Leipzig 1789; Grove A Dictionary of Music and Musicians,
London 1879-1889; Gehrkens Music Notation and Terminology, New York 1914. MuseScore's figures are
those that its program (github.com/musescore/MuseScore) and the instruments in its files have by
default.
"""
