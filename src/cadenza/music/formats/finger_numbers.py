"""The numbers of fingers in files.

0..4 are the right hand's thumb to little finger, 5..9 the left hand's, and -1 none or an unknown
one. Of hands with more fingers, R6 is the sixth of the right hand, L7 the seventh of the left.
"""

import re

from cadenza.errors import CadenzaError, quoted
from cadenza.fingers import SIDES, Finger

_NUMBERED = 5  # fingers of a hand
_UNKNOWN = -1
_LETTERS = "".join(side[0].upper() for side in SIDES)
_COUNTED = re.compile(rf"([{_LETTERS}])([1-9][0-9]?)")


def finger_number(finger: Finger | None) -> int | str:
    """The number of a finger in files."""
    if finger is None:
        return _UNKNOWN
    if finger.index < _NUMBERED:
        return _NUMBERED * finger.hand + finger.index
    return f"{_LETTERS[finger.hand]}{finger.index + 1}"


def finger_from(text: int | str) -> Finger | None:
    """The finger with this number in files, None for unknown; raises CadenzaError for no finger."""
    text = str(text)
    if text == str(_UNKNOWN):
        return None
    if re.fullmatch("[0-9]", text):
        return Finger(*divmod(int(text), _NUMBERED))
    if counted := _COUNTED.fullmatch(text):
        return Finger(_LETTERS.index(counted[1]), int(counted[2]) - 1)
    raise CadenzaError(
        f"there is no finger {quoted(text)}; right hand 0-4, left hand 5-9, -1 unknown; beyond the "
        "fifth finger of a hand R6, L6 and so on"
    )
