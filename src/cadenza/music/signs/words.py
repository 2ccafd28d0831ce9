"""Words in a score that change its tempo, its loudness or its rhythm."""

import re

from cadenza.music.signs.tempo_map import TempoChange

# Each with the words that the change is called by; \b before all, so that "brit." is no "rit.".
_CHANGES = (
    (TempoChange.TEMPO_PRIMO, r"(tempo (primo|i\b|1)|(1o|1\.|primo) tempo)"),
    (TempoChange.A_TEMPO, r"(a tempo|au mouvement|im zeitma(ss|ß))"),
    (
        TempoChange.MENO_MOSSO,
        r"(meno (mosso|allegro|vivo|presto)|ritenut|riten\b|langsamer|plus lent)",
    ),
    (TempoChange.PIU_MOSSO, r"(pi(ù|u'?) (mosso|allegro|vivo|presto)|schneller|plus vite)"),
    (
        TempoChange.RITARDANDO,
        r"(rit\b|ritard|rallent|rall\b|allarg|slarg|lentando|calando|morendo|smorz|cédez|"
        r"ritenendo)",
    ),
    (TempoChange.ACCELERANDO, r"(accel|string(endo|\b)|affrett|precipit|serrez|beschleunig)"),
)
# Quarters a minute, those of MuseScore's palette; words of two tempos come first.
_USUAL_TEMPOS = {
    "allegro moderato": 118,
    "grave": 35,
    "largo": 50,
    "lento": 52.5,
    "larghetto": 63,
    "adagio": 71,
    "andante": 92,
    "andantino": 94,
    "moderato": 114,
    "allegretto": 116,
    "allegro": 144,
    "vivace": 172,
    "presto": 187,
    "prestissimo": 200,
}
AS_USUAL = "played as usual, as the file gives no tempo"  # what is done with such words
_LOUDER = r"(cresc|rinforzando|dal niente)"
_SOFTER = r"(decresc|dim\b|dimin|calando|morendo|smorz|perdendosi|al niente)"
_TRIPLETS = 2, 1  # "Swing": the first note is about twice as long (MuseScore's handbook)
_EVEN = 1, 1


def tempo_change(text: str) -> TempoChange | None:
    """The change of tempo that words such as "poco rit." ask for, if any."""
    return next((change for change, words in _CHANGES if _has(text, words)), None)


def usual_tempo(text: str) -> float | None:
    """The quarters a minute that are usual for words such as "Andante con moto", if any."""
    if tempo_change(text) is not None:
        return None
    tempos = _USUAL_TEMPOS.items()
    return next((tempo for word, tempo in tempos if _has(text, rf"{word}\b")), None)


def loudness_step(text: str) -> int | None:
    """1 for words such as "cresc.", -1 for "dim." and the like, None for others."""
    if _has(text, _LOUDER):
        return 1
    return -1 if _has(text, _SOFTER) else None


def swing(text: str) -> tuple[int, int] | None:
    """How words such as "Swing" or "Straight" divide a beat in two, if they do."""
    if _has(text, "straight"):
        return _EVEN
    return _TRIPLETS if _has(text, "swing") else None


def _has(text: str, words: str) -> bool:
    return re.search(rf"(?<!\w){words}", " ".join(text.split()), re.IGNORECASE) is not None
