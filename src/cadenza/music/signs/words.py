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
_LOUDER = r"(cresc|rinforzando|dal niente)"
_SOFTER = r"(decresc|dim\b|dimin|calando|morendo|smorz|perdendosi|al niente)"
_TRIPLETS = 2, 1  # "Swing": the first note is about twice as long (MuseScore's handbook)
_EVEN = 1, 1


def tempo_change(text: str) -> TempoChange | None:
    """The change of tempo that words such as "poco rit." ask for, if any."""
    return next((change for change, words in _CHANGES if _has(text, words)), None)


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
