"""Processes that work for the server, and what they say."""

from __future__ import annotations

import json
import os
import signal
import sys
from asyncio import IncompleteReadError, StreamReader, create_subprocess_exec, wait_for
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.limits import READING_SECONDS
from cadenza.studio.messages import HEADER, MOST_BYTES
from cadenza.studio.request import Order


async def started(module: str, *arguments: str, **how: Any) -> Process:
    """A process of ours, which imports nothing from the working folder."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    return await create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE, **how)


async def bound(module: str, *arguments: str, **how: Any) -> Process:
    """One that ends with this process, whatever ends it, and may be held; see the module."""
    process = await started("cadenza.studio.bound", module, *arguments, **how)
    assert process.stdout is not None
    try:
        await process.stdout.read(1)
    except BaseException:
        kill(process)  # nobody else knows of it
        raise
    return process


def kill(process: Process) -> None:
    """At once, if it has not ended."""
    with suppress(ProcessLookupError):
        process.kill()


def hold(process: Process, paused: bool) -> None:
    """Has it stand still, or go on."""
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGSTOP if paused else signal.SIGCONT)


async def tell(process: Process, order: Order) -> None:
    """Gives it an order, if it is still there."""
    assert process.stdin is not None
    with suppress(ConnectionError):
        process.stdin.write(json.dumps(asdict(order)).encode() + b"\n")
        await process.stdin.drain()


def say(process: Process, line: bytes) -> None:
    """Tells a process that plays to wait, to go on, or to put down what it was given."""
    assert process.stdin is not None
    process.stdin.write(line)


async def messages(stream: StreamReader) -> AsyncIterator[tuple[bytes, bytes]]:
    """Kind and content of each, until there are no more; see `cadenza.studio.messages`."""
    with suppress(IncompleteReadError):
        while True:
            kind, length = HEADER.unpack(await stream.readexactly(HEADER.size))
            if length > MOST_BYTES:
                return
            yield kind, await stream.readexactly(length)


async def read_upload(path: Path) -> dict[str, Any]:
    """What a file holds, found out by a process with limits.

    Raises:
        CadenzaError: it is no music, or more than the studio takes.
    """
    process = await started("cadenza.studio.reading", os.fspath(path))
    try:
        out, _ = await wait_for(process.communicate(), READING_SECONDS)
        answer = json.loads(out)
    except TimeoutError:
        answer = {"error": "it takes too long to read"}
    except ValueError:  # killed by a limit
        answer = {"error": "the file is damaged, or needs too much memory or time"}
    finally:
        kill(process)
        await process.wait()
    if "error" in answer:
        raise CadenzaError(answer["error"])
    return answer


async def write_comparison(folders: Sequence[Path], page: Path) -> None:
    """Compares performances on a page.

    Raises:
        CadenzaError: they cannot be compared.
    """
    paths = map(os.fspath, (*folders, page))
    process = await started("cadenza.studio.comparing", *paths, stderr=DEVNULL)
    try:
        failed = await process.wait()
    finally:
        kill(process)
    if failed:
        raise CadenzaError("these performances cannot be compared")
