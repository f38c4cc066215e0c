"""Made-up work, and workers that do it, for the study `scheduler`; what runs on them imports little and starts soon."""

from __future__ import annotations

import asyncio
import os
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class MadeUp:
    """A case that is not carried out."""

    number: int
    told: bytes
    """As much as a worker is told of a case."""
    size: int
    """Of the files that it hands back [bytes]."""
    seconds: float = 0.0
    """That it takes."""


def made_up(piece: MadeUp) -> dict[str, bytes]:
    """On a worker: files of bytes by chance, since those of a case cannot be compressed any further either."""
    time.sleep(piece.seconds)
    name, last = f"made-up-{piece.number}", min(piece.size, 2000)
    return {f"trajectories/{name}.npz": os.urandom(piece.size - last), f"cases/{name}.json": os.urandom(last)}


def serve(address: str, count: int) -> None:
    """So many workers in this process, until it is ended."""
    from distributed import Worker

    async def all_of_them() -> None:
        async with AsyncExitStack() as stack:
            those = [Worker(address, nthreads=1, dashboard=False, memory_limit=0) for _ in range(count)]
            for one in those:
                await stack.enter_async_context(one)
            await asyncio.gather(*(one.finished() for one in those))

    asyncio.run(all_of_them())


def held(dask_scheduler: Any) -> tuple[int, float]:
    """On the scheduler: how many tasks it knows, and its memory [kB]."""
    return len(dask_scheduler.tasks), dask_scheduler.proc.memory_info().rss / 1e3
