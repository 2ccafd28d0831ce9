"""Samples of tones, made in a process."""

from anyio import BrokenWorkerProcess, CapacityLimiter, to_process

from cadenza.errors import CadenzaError
from cadenza.studio.tone_samples import NUM_BANDS, NUM_PITCHES, samples


class Synthesizer:
    """A maker of one tone after the other, in a process.

    The server must not make them itself: it starts processes, and what multiplies matrices on
    threads may then hang for ever.
    """

    def __init__(self) -> None:
        self._one = CapacityLimiter(1)

    async def tone(self, pitch: int, band: int) -> bytes:
        """Return the samples of a tone, see `samples`.

        Raises CadenzaError if there is no such tone, or the process has ended.
        """
        if pitch not in range(NUM_PITCHES) or band not in range(NUM_BANDS):
            raise CadenzaError("there is no such tone")
        try:
            return await to_process.run_sync(
                samples, pitch, band, cancellable=True, limiter=self._one
            )
        except BrokenWorkerProcess as error:
            raise CadenzaError("the tone cannot be made") from error
