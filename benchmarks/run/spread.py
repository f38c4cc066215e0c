"""Pieces of work on the processes of this machine or the workers of a Dask cluster, through joblib.

    with computing(Where(backend="dask", address="tcp://HOST:8786")) as workers:
        for number, result in workers.done(function, pieces):   # as they come
            ...

`function` is a module's, and takes one piece; both cross to other processes. A piece that a killed worker had begun is
begun again elsewhere. Results do not depend on who computes them: whatever chance needs is in the piece.

The machines of a cluster are asked for their sources and versions before any piece is handed out: a scheduler that
cannot import this package would take the work and never answer; a worker with other sources would compute other
numbers. They are asked with built-in functions only, so that they can answer whatever is installed there.
"""

import argparse
import asyncio
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from benchmarks.run.sources import identity, source, versions
from benchmarks.tables import as_line, say

BACKENDS = ("loky", "dask")
_PATIENCE = 3  # times that workers may die with nothing finished in between
_LEAST = 1000  # pieces that a cluster holds at least, so that workers that come while it runs have some at once
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
Piece = TypeVar("Piece")
Result = TypeVar("Result")
Say = Callable[[str], None]


class WorkersDiedError(RuntimeError):
    """Worker processes die again and again."""


@dataclass(frozen=True)
class Where:
    """Who computes; raises ValueError for what does not go together.

    backend: `loky`, processes of this machine, or `dask`, the workers of the scheduler at `address`, which must have
    the sources of this machine. processes: how many at once with `loky`, -1: one a core; 1: in this process.
    """

    backend: str = "loky"
    address: str | None = None
    processes: int = -1

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ValueError(f"backend '{self.backend}' is not known; valid: {', '.join(BACKENDS)}")
        if (self.backend == "dask") != (self.address is not None):
            raise ValueError("--backend dask needs --address tcp://HOST:PORT of a scheduler, and only it takes one")
        if self.processes == 0 or self.processes < -1:
            raise ValueError(f"--jobs {self.processes}, expected a count >= 1, or -1 for one a core")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where to compute, on a study's command line."""
    parser.add_argument("--jobs", type=int, default=None, help="processes (2; with --quick this one; -1: one a core)")
    parser.add_argument("--backend", default="loky", help="loky: processes here; dask: the workers of a cluster")
    parser.add_argument("--address", default=None, help="of the Dask scheduler, tcp://HOST:PORT")


def where(options: argparse.Namespace) -> Where:
    """What `add_options` added. Raises ValueError as `Where`."""
    usual = 1 if options.quick else 2  # another process takes longer to start than a quick form has to do
    return Where(options.backend, options.address, usual if options.jobs is None else options.jobs)


@contextmanager
def computing(where: Where) -> "Iterator[Workers]":
    """The workers, while they are needed. Raises ValueError for a cluster that cannot do it: see `dask_client`."""
    if where.address is None:
        yield Workers(where.processes)
        return
    with dask_client(where.address) as client:
        yield Workers(client=client)


@dataclass(frozen=True)
class Workers:
    """Processes of this machine, or with a `client` the workers of its Dask cluster."""

    processes: int = -1
    client: Any = None

    @property
    def count(self) -> int:
        """How many pieces are worked on at once, as of now."""
        if self.client is not None:
            return sum(self.client.nthreads().values())
        return self.processes if self.processes > 0 else os.cpu_count() or 1

    def done(
        self, function: Callable[[Piece], Result], pieces: Sequence[Piece], *, say: Say = lambda text: None
    ) -> Iterator[tuple[int, Result]]:
        """Number and result of every piece, as they finish; an error of a piece ends it.

        say: receives what needs no answer. Raises WorkersDiedError when processes of this machine die again and again,
        ValueError for a worker that came later to a cluster and has other sources.
        """
        import joblib
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        left, deaths, me = dict(enumerate(pieces)), 0, identity()
        if self.client is None:
            how: dict[str, Any] = dict(backend="loky", inner_max_num_threads=1)
        else:
            how = dict(backend="dask", client=self.client)
        while left:
            before, hands = len(left), self.count
            try:
                with joblib.parallel_config(**how):
                    parallel = joblib.Parallel(
                        n_jobs=min(hands, len(pieces)) if self.client is None else -1,  # one more would start in vain
                        return_as="generator_unordered",
                        batch_size=1,
                        pre_dispatch=2 * hands if self.client is None else max(2 * hands, _LEAST),
                    )
                    given = [joblib.delayed(_like_here)(me, function, number, piece) for number, piece in left.items()]
                    for number, result in parallel(given):
                        del left[number]
                        yield number, result
            except TerminatedWorkerError:
                deaths = 1 if len(left) < before else deaths + 1
                if deaths >= _PATIENCE:
                    raise WorkersDiedError(
                        f"workers died {deaths} times with nothing finished (killed, or out of memory?); "
                        f"{len(left)} of {len(pieces)} are left"
                    ) from None
                say(f"a worker died; {len(left)} of {len(pieces)} are begun again")
            else:
                return

    def in_order(self, function: Callable[[Piece], Result], pieces: Sequence[Piece], what: str) -> list[Result]:
        """The results of all pieces in their order; each is said as it comes. Raises as `done`."""
        results = dict[int, Result]()
        for number, result in self.done(function, pieces, say=say):
            results[number] = result
            say(f"{what} {len(results)} of {len(pieces)}: {as_line(result)}")
        return [results[number] for number in range(len(pieces))]


def _like_here(asking: str, function: Callable[[Piece], Result], number: int, piece: Piece) -> tuple[int, Result]:
    """On a worker: the result of a piece, unless sources or versions are not those of the machine that asks."""
    if identity() != asking:
        raise ValueError(f"a worker that came later ({platform.node()}) has other sources or versions: {CURE}")
    return number, function(piece)


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
