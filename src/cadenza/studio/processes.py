"""Processes that work for the server: their start, orders and messages."""

import json
import os
import signal
import sys
from asyncio import IncompleteReadError, StreamReader, create_subprocess_exec, wait_for
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.limits import READING_SECONDS
from cadenza.studio.messages import HEADER, MAX_BYTES
from cadenza.studio.request import Order


async def start_process(module: str, *arguments: str, **options: Any) -> Process:
    """Start a module of ours as a process, which imports nothing from the working folder."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    return await create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE, **options)


async def start_bound_process(module: str) -> Process:
    """Start a process that ends with this one and may be suspended, see `cadenza.studio.limits`."""
    process = await start_process("cadenza.studio.limits", module)
    assert process.stdout is not None
    try:
        await process.stdout.read(1)
    except BaseException:
        kill(process)  # it would be left behind
        raise
    return process


def kill(process: Process) -> None:
    """Kill a process at once, if it has not ended."""
    with suppress(ProcessLookupError):
        process.kill()


def suspend(process: Process, suspended: bool) -> None:
    """Suspend a process, or have it go on."""
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGSTOP if suspended else signal.SIGCONT)


async def send_order(process: Process, order: Order) -> None:
    """Give a process an order, if it is still there."""
    assert process.stdin is not None
    with suppress(ConnectionError):
        process.stdin.write(json.dumps(asdict(order)).encode() + b"\n")
        await process.stdin.drain()


def cancel_song(process: Process) -> None:
    """Tell a player to drop its song; see `cadenza.studio.messages`."""
    assert process.stdin is not None
    process.stdin.write(b"\n")


async def messages(stream: StreamReader) -> AsyncIterator[tuple[bytes, bytes]]:
    """Yield kind and content of each message; see `cadenza.studio.messages`."""
    with suppress(IncompleteReadError):
        while True:
            kind, length = HEADER.unpack(await stream.readexactly(HEADER.size))
            if length > MAX_BYTES:
                return
            yield kind, await stream.readexactly(length)


async def _output_of(module: str, *arguments: str, **options: Any) -> bytes | None:
    """The output of a module of ours, run as a process; None if it fails, or is killed."""
    process = await start_process(module, *arguments, **options)
    try:
        output, _ = await process.communicate()
    finally:
        kill(process)
        await process.wait()
    return None if process.returncode else output


async def read_upload(path: Path) -> dict[str, Any]:
    """Read a file in a limited process, see `cadenza.studio.upload_reader`.

    Raises CadenzaError if it is no music, or more than the studio takes.
    """
    reading = _output_of("cadenza.studio.upload_reader", os.fspath(path))
    try:
        output = await wait_for(reading, READING_SECONDS)
    except TimeoutError:
        raise CadenzaError("it takes too long to read") from None
    if output is None:
        raise CadenzaError("the file is damaged, or needs too much memory or time")
    answer: dict[str, Any] = json.loads(output)
    if "error" in answer:
        raise CadenzaError(answer["error"])
    return answer


async def opening_picture(song: str) -> bytes:
    """The first picture of a song, see `studio.state_stream`; nothing if it fails."""
    try:
        return await _output_of("cadenza.studio.state_stream", song, stderr=DEVNULL) or b""
    except OSError:  # there is no room for it
        return b""
