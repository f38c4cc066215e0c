"""The workers of a Dask cluster: asked who they are before anything is given to them.

A scheduler that cannot import this package would take the work and never say a word; a worker with other sources would
give other numbers. Both are asked with built-in functions only, so that they can answer whatever they have installed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any

from benchmarks.run.sources import source, versions

CONTACT = 8.0
"""For a scheduler, and for workers, to answer [s]."""
WORKERS = 60.0
"""For a first worker to come [s]."""
_NAME = "steerkit-control"
CURE = f"install {_NAME} {versions().get(_NAME, '')} with the extra bench there as here, and start it again"
"""What to do about a machine that is not like this one."""
_QUESTION = """
try:
    from benchmarks.run.sources import source, versions
    answer = {"source": source(everything=True), "versions": versions()}
except Exception as error:
    answer = {"error": f"{type(error).__name__}: {error}"}
"""
_ASK = f"exec({_QUESTION!r}, place := {{}}) or place['answer']"
Answer = Mapping[str, Any]
"""`source` and `versions` of another machine, or its `error`."""


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """A `distributed.Client` of the scheduler at `address`, while it is needed.

    Raises ValueError, which says what to do, for a scheduler that does not answer or has no workers, for a scheduler or
    a worker that has not the package, its sources and its versions of this machine, and when workers die in vain.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise ValueError(
            "--backend dask needs the package distributed: pip install 'steerkit-control[bench]'"
        ) from error
    with ThreadPoolExecutor(1) as thread:  # an event loop of its own, whatever runs in this thread
        thread.submit(asyncio.run, _survey(address)).result()
    with Client(address, timeout=CONTACT, set_as_default=False) as client:
        try:
            yield client
        except KilledWorker as error:
            raise ValueError(f"--address {address}: {error}; finished cases are kept") from error
        except ModuleNotFoundError as error:  # on a worker that came later
            raise ValueError(_objection("a worker", {"error": str(error)}) or "") from error


async def _survey(address: str) -> None:
    from distributed import Client

    where, what = f"--address {address}", "no Dask scheduler answers there"
    client = None
    try:
        client = Client(address, timeout=CONTACT, asynchronous=True, set_as_default=False)
        await _in_time(client)  # it has no end of its own where somebody listens but says nothing
        what = "the scheduler does not answer"
        _accept(f"{where}: the scheduler", await _in_time(client.run_on_scheduler(eval, _ASK, {})), packages=False)
        what = f"no worker has come within {WORKERS:g} s; start one: dask worker {address}"
        await client.wait_for_workers(1, timeout=WORKERS)  # type: ignore[misc, func-returns-value, unused-ignore]
        what = "a worker does not answer"
        answers = await _in_time(client.run(eval, _ASK, {}))
    except (OSError, TimeoutError) as error:
        raise ValueError(f"{where}: {what} ({str(error) or type(error).__name__})") from error
    finally:
        if client is not None:
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(client.close(timeout=1.0), 2.0)
    for worker, answer in answers.items():
        _accept(f"{where}: the worker {worker}", answer)


async def _in_time(answer: Any) -> Any:
    """What is waited for, or a TimeoutError."""
    return await asyncio.wait_for(answer, CONTACT)


def _accept(who: str, answer: Answer, *, packages: bool = True) -> None:
    """Raise ValueError unless `who` is as this machine; packages: other packages, too."""
    objection = _objection(who, answer, packages=packages)
    if objection:
        raise ValueError(objection)


def _objection(who: str, answer: Answer, *, packages: bool = True) -> str:
    """Why `who` cannot work for this machine, and what to do; nothing if it can."""
    mine = versions()
    if "error" in answer:
        return f"{who} cannot import this package ({answer['error']}): {CURE}"
    theirs = answer["versions"]
    if answer["source"] != source(everything=True) or theirs.get(_NAME) != mine.get(_NAME):
        both = (theirs, answer["source"]), (mine, source(everything=True))
        there, here = (f"{found.get(_NAME)}, sources {hashed}" for found, hashed in both)
        return f"{who} has another {_NAME} ({there}) than this machine ({here}): {CURE}"
    other = [key for key in {**mine, **theirs} if mine.get(key) != theirs.get(key)] if packages else []
    if other:
        listed = ", ".join(f"{key} {theirs.get(key, 'missing')} instead of {mine.get(key, 'none')}" for key in other)
        return f"{who} has {listed}, and numbers may depend on that: install the versions of this machine there"
    return ""
