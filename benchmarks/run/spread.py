"""Pieces of work on the processes of this machine or the workers of a cluster; suites and studies over seeds or cars.

    with computing(Where(backend="dask", address="tcp://HOST:8786")) as those:
        for number, result in those.done(function, pieces):   # as they come
            ...

`function` is a module's, and takes one piece; both cross to other processes. What a killed worker had begun is begun
again elsewhere. Results do not depend on who computes them: whatever chance needs is in the piece.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from benchmarks.run.cluster import CURE, dask_client
from benchmarks.run.sources import identity

BACKENDS = ("loky", "dask")
_PATIENCE = 3  # times that workers may die with nothing finished in between
_LEAST = 1000  # pieces that a cluster holds at least, so that workers that come while it runs have some at once
_COUNTED = 5.0  # how often a cluster is asked for its size [s]
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


class Workers(Protocol):
    """Those of this machine or of a cluster."""

    @property
    def count(self) -> int:
        """How many pieces are worked on at once, as of now."""

    def done(
        self,
        function: Callable[[Piece], Result],
        pieces: Sequence[Piece],
        *,
        until: float = math.inf,
        say: Say = lambda text: None,
    ) -> Iterator[tuple[int, Result]]:
        """Number and result of every piece, as they finish; an error of a piece ends it.

        until: the `time.monotonic` from which on no piece is handed out. say: told of what needs no answer.
        """


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where to compute, on a study's command line."""
    parser.add_argument(
        "--processes",
        "--jobs",
        type=int,
        default=None,
        help="processes at once (default 2, with --quick this one alone; -1: a core each)",
    )
    parser.add_argument("--backend", default="loky", help="loky: processes here; dask: the workers of a cluster")
    parser.add_argument("--address", default=None, help="of the Dask scheduler, tcp://HOST:PORT")


def where(options: argparse.Namespace) -> Where:
    """What `add_options` added. Raises ValueError as `Where`."""
    usual = 1 if options.quick else 2  # another process takes longer to start than a quick form has to do
    return Where(options.backend, options.address, usual if options.processes is None else options.processes)


@contextmanager
def computing(where: Where) -> Iterator[Workers]:
    """The workers, while they are needed. Raises ValueError for a cluster that cannot do it: see `dask_client`."""
    if where.backend == "loky":
        yield Here(where.processes)
        return
    assert where.address is not None
    with dask_client(where.address) as client:
        yield Cluster(client)


@dataclass(frozen=True)
class Here:
    """Processes of this machine."""

    processes: int = -1

    @property
    def count(self) -> int:
        """See `Workers`."""
        return self.processes if self.processes > 0 else os.cpu_count() or 1

    def done(
        self,
        function: Callable[[Piece], Result],
        pieces: Sequence[Piece],
        *,
        until: float = math.inf,
        say: Say = lambda text: None,
    ) -> Iterator[tuple[int, Result]]:
        """See `Workers`; raises WorkersDiedError when processes die again and again."""
        import joblib
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        left = dict(enumerate(pieces))
        deaths = 0
        ahead = "2*n_jobs" if until == math.inf else "n_jobs"  # what waits for a process is begun after `until`
        while left and time.monotonic() < until:
            before = len(left)
            try:
                with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
                    hands = min(joblib.effective_n_jobs(self.processes), len(pieces))  # one more would start in vain
                    parallel = joblib.Parallel(
                        n_jobs=hands, return_as="generator_unordered", batch_size=1, pre_dispatch=ahead
                    )
                    given = (
                        joblib.delayed(_numbered)(function, number, piece)
                        for number, piece in list(left.items())
                        if time.monotonic() < until
                    )
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


def _numbered(function: Callable[[Piece], Result], number: int, piece: Piece) -> tuple[int, Result]:
    return number, function(piece)


class Cluster:
    """The workers of a Dask cluster: each has a piece waiting while it computes another, so that none is idle."""

    def __init__(self, client: Any):
        self.client = client

    @property
    def count(self) -> int:
        """See `Workers`."""
        return sum(self.client.nthreads().values())

    def done(
        self,
        function: Callable[[Piece], Result],
        pieces: Sequence[Piece],
        *,
        until: float = math.inf,
        say: Say = lambda text: None,
    ) -> Iterator[tuple[int, Result]]:
        """See `Workers`; raises ValueError for a worker that came later and has other sources."""
        from distributed import as_completed

        left, me = iter(enumerate(pieces)), identity()
        coming = as_completed(loop=self.client.loop, with_results=True)
        going: dict[Any, int] = {}  # by future, which it keeps alive
        room, counted = 0, -math.inf

        def hand_out() -> None:
            nonlocal room, counted
            if time.monotonic() > counted + _COUNTED:  # workers come and go
                threads, counted = self.count, time.monotonic()
                room = max(2 * threads, _LEAST) if until == math.inf else max(1, threads)
            while len(going) < room and time.monotonic() < until and (following := next(left, None)) is not None:
                future = self.client.submit(_like_here, me, function, following[1], pure=False)
                going[future] = following[0]
                coming.add(future)

        hand_out()
        while going:
            future, result = next(coming)
            number = going.pop(future)
            hand_out()  # first: whoever takes the result may take its time
            yield number, result


def _like_here(asking: str, function: Callable[[Piece], Result], piece: Piece) -> Result:
    """On a worker: the result of a piece, unless sources or versions are not those of the machine that asks."""
    if identity() != asking:
        raise ValueError(f"a worker that came later ({platform.node()}) has other sources or versions: {CURE}")
    return function(piece)
