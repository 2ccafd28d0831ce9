"""Sheet music as a Standard MIDI file, with its metre, its keys, its tempos and their words."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate, pairwise
from operator import itemgetter
from pathlib import Path

import mido

from cadenza.files import write_atomically
from cadenza.music.formats.midi import messages, title_messages, write_midi
from cadenza.music.formats.midi_messages import LONGEST
from cadenza.music.notation.metre import QUARTER, WHOLE, Measure, metre_of
from cadenza.music.score import MAX_SIGNS, Score

_FINER = 19  # ticks of the file for one of a metre: nearly as many as a file can have
_TICKS = _FINER * QUARTER  # ticks of a quarter
_LATE = 1e-3  # [s] by which a beat may be early or late before the tempo is given anew
_SECOND = 1e6  # [us]
_SLOWEST = 2**24 - 1  # [us] of a quarter
_KEYS = [step + sign for sign in ("b", "", "#") for step in "FCGDAEB"][1:]  # from C flat on


def write_midi_sheet(score: Score, path: Path) -> None:
    """Write a score with metre, keys, tempos and words of tempo as a MIDI file of format 1.

    Bars are those of `metre_of`; the first begins where the song has begun. Read back, times are
    the same to half a tick, of which a quarter has 31,920. A score that has no bars, or is too
    long, is written as `write_midi` does.
    """
    if not score.bars or not score.notes:
        write_midi(score, path)
        return
    metre = metre_of(score)
    first = max(int((metre.times <= 0).sum()) - 1, 0)  # the cell in which the song begins
    tempos = _tempos(metre.times[first:].tolist(), (_FINER * metre.ticks[first:]).tolist())
    begin, slowness = tempos[0]
    origin = begin - round(float(metre.times[first]) * _SECOND * _TICKS / slowness)
    tempos[0] = origin, slowness
    starts = [tick - origin for tick, _ in tempos]
    lengths = ((b - a) * us for (a, b), (_, us) in zip(pairwise(starts), tempos, strict=False))
    times = list(accumulate(lengths, initial=0))

    def ticks(seconds: float) -> int:
        time = seconds * _SECOND * _TICKS
        i = max(bisect_right(times, time) - 1, 0)
        return round(starts[i] + (time - times[i]) / tempos[i][1])

    end = max([score.total_time, *(event.time for event in score.pedal)])
    if ticks(end) > LONGEST:
        write_midi(score, path)
        return
    signs = [(tick, mido.MetaMessage("set_tempo", tempo=us)) for tick, us in tempos]
    signs += _signs(measure for measure in metre.measures if _FINER * measure.start >= origin)
    texts = ((ticks(time), text) for bar in score.bars for time, text in bar.words)
    signs += [(origin + at, mido.MetaMessage("text", text=text)) for at, text in texts if at >= 0]
    file = mido.MidiFile(type=1, ticks_per_beat=_TICKS, charset="utf-8")
    file.tracks.append(mido.MidiTrack(title_messages(score)))
    now = 0
    for tick, sign in sorted(signs, key=itemgetter(0)):
        file.tracks[0].append(sign.copy(time=tick - origin - now))
        now = tick - origin
    file.tracks.append(mido.MidiTrack(messages(score.notes, score.pedal, ticks)))
    with write_atomically(path) as out:
        file.save(file=out)


def _tempos(times: Sequence[float], ticks: Sequence[int]) -> list[tuple[int, int]]:
    """The tempos of cells at `times` [s] and `ticks`: from which tick on, [us] of a quarter."""
    tempos: list[tuple[int, int]] = []
    now, tempo = times[0] * _SECOND, 0
    for (tick, following), end in zip(pairwise(ticks), times[1:], strict=True):
        quarters = (following - tick) / _TICKS
        if not tempo or abs(now + tempo * quarters - end * _SECOND) > _LATE * _SECOND:
            tempo = min(max(round((end * _SECOND - now) / quarters), 1), _SLOWEST)
            tempos.append((tick, tempo))
        now += tempo * quarters
    return tempos


def _signs(measures: Iterable[Measure]) -> Iterator[tuple[int, mido.MetaMessage]]:
    signature, key = None, None
    for measure in measures:
        tick, beat_type = _FINER * measure.start, measure.written[1]
        new_signature = measure.length * beat_type // WHOLE, beat_type
        if new_signature != signature:
            signature = new_signature
            beats = {"numerator": new_signature[0], "denominator": beat_type}
            yield tick, mido.MetaMessage("time_signature", **beats)
        if measure.key not in (key, None):
            key = measure.key
            yield tick, mido.MetaMessage("key_signature", key=_KEYS[MAX_SIGNS + key])
