"""Programs of General MIDI by their names, and controllers by their numbers."""

LARGEST = 127  # the largest value of a controller
BANK, VOLUME, EXPRESSION = 0, 7, 11
SUSTAIN, SOSTENUTO, SOFT = 64, 66, 67  # the pedals of a piano
AMOUNTS = frozenset((VOLUME, EXPRESSION, SUSTAIN, SOSTENUTO, SOFT))
"""The controllers whose values, where too large, can only mean the largest."""
RESET = 121  # the controller that lifts the pedals of a channel, among others
ALL_OFF = frozenset((120, *range(123, 128)))
"""The controllers that end all notes of a channel; the last four change its mode, too."""
CHANNELS, DRUM_CHANNEL = range(16), 9
"""The channels of a port, and the tenth of them, counted from 0."""
ROLAND, YAMAHA, ANY_TIME, REAL_TIME = 0x41, 0x43, 0x7E, 0x7F
"""The first bytes of system exclusive messages: of two makers, and two that are for all."""
MAKERS = frozenset(bytes([maker]) for maker in (ROLAND, YAMAHA, ANY_TIME, REAL_TIME))
"""The first bytes of the system exclusive messages that are understood."""

_NAMES = """
acoustic grand piano, bright acoustic piano, electric grand piano, honky-tonk piano, electric
piano 1, electric piano 2, harpsichord, clavinet, celesta, glockenspiel, music box, vibraphone,
marimba, xylophone, tubular bells, dulcimer, drawbar organ, percussive organ, rock organ, church
organ, reed organ, accordion, harmonica, tango accordion, nylon-string guitar, steel-string
guitar, jazz guitar, clean electric guitar, muted electric guitar, overdriven guitar, distortion
guitar, guitar harmonics, acoustic bass, fingered bass, picked bass, fretless bass, slap bass 1,
slap bass 2, synth bass 1, synth bass 2, violin, viola, cello, contrabass, tremolo strings,
pizzicato strings, orchestral harp, timpani, string ensemble 1, string ensemble 2, synth strings
1, synth strings 2, choir aahs, voice oohs, synth voice, orchestra hit, trumpet, trombone, tuba,
muted trumpet, French horn, brass section, synth brass 1, synth brass 2, soprano sax, alto sax,
tenor sax, baritone sax, oboe, English horn, bassoon, clarinet, piccolo, flute, recorder, pan
flute, blown bottle, shakuhachi, whistle, ocarina, square lead, sawtooth lead, calliope lead,
chiff lead, charang lead, voice lead, fifths lead, bass and lead, new age pad, warm pad, polysynth
pad, choir pad, bowed pad, metallic pad, halo pad, sweep pad, rain effect, soundtrack effect,
crystal effect, atmosphere effect, brightness effect, goblins effect, echoes effect, sci-fi
effect, sitar, banjo, shamisen, koto, kalimba, bagpipe, fiddle, shanai, tinkle bell, agogo, steel
drums, woodblock, taiko drum, melodic tom, synth drum, reverse cymbal, guitar fret noise, breath
noise, seashore, bird tweet, telephone ring, helicopter, applause, gunshot
"""
INSTRUMENTS = tuple(" ".join(name.split()) for name in _NAMES.split(","))
"""(128,) the instruments by their program numbers, which count from 0."""
