"""What the signs of a score mean: from notes as written to notes as they sound.

Nothing here knows a file format. Places and lengths in a score are `Fraction`s of a quarter, so
that what is written together sounds together to the bit; seconds come from a `TempoMap`.
"""
