"""Work that is spread: each piece once, whoever dies; no later than told; what does not go together is refused."""

import argparse
import math
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.run import spread
from benchmarks.run.results import Results
from benchmarks.run.runner import run
from benchmarks.run.sources import identity, source, versions
from benchmarks.run.spread import Where, Workers, _objection, computing, dask_client
from tests.support.tiny_suite import TINY, same


def twice(piece: int) -> int:
    return 2 * piece


def test_results_come_in_the_order_of_the_pieces_and_each_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finished = [(1, {"e": 0.25}), (0, {"e": 0.5})]
    monkeypatch.setattr(Workers, "done", lambda *_, **__: iter(finished))
    assert Workers().in_order(twice, [5, 7], "drives") == [{"e": 0.5}, {"e": 0.25}]
    assert capsys.readouterr().err == "drives 1 of 2: e 0.25\ndrives 2 of 2: e 0.5\n"


def test_workers_that_die_now_and_then_cost_nothing_as_long_as_pieces_finish(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pool that finishes one piece and then loses its workers, again and again."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    class Dying:
        def __init__(self, **how: Any):
            assert how["n_jobs"] == 2

        def __call__(self, tasks: Any) -> Any:
            (function, words, named), *rest = tasks
            yield function(*words, **named)
            if rest:
                raise TerminatedWorkerError("killed")

    monkeypatch.setattr(joblib, "Parallel", Dying)
    pieces, told = list(range(2 * spread._PATIENCE)), list[str]()
    assert dict(Workers(2).done(twice, pieces, say=told.append)) == {n: 2 * n for n in pieces}
    assert told == [f"a worker died; {n} of {len(pieces)} are begun again" for n in reversed(pieces[1:])]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--backend", "slurm"], "backend 'slurm' is not known; valid: loky, dask"),
        (["--backend", "dask"], "--backend dask needs --address"),
        (["--address", "tcp://127.0.0.1:1"], "--backend dask needs --address"),
        (["--jobs", "0"], "--jobs 0"),
    ],
)
def test_what_does_not_go_together_is_refused(options: list[str], message: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    spread.add_options(parser)
    assert spread.where(parser.parse_args([])) == Where("loky", None, 2)
    assert spread.where(parser.parse_args(["--quick"])) == Where("loky", None, 1)
    assert spread.where(parser.parse_args(["--quick", "--jobs", "2"])) == Where("loky", None, 2)
    with pytest.raises(ValueError, match=message):
        spread.where(parser.parse_args(options))


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Of a cluster of two workers in this process."""
    distributed = pytest.importorskip("distributed", reason="comes with the extra bench")
    with (
        distributed.LocalCluster(n_workers=2, processes=False, threads_per_worker=1, dashboard_address=":0") as local,
        distributed.Client(local, set_as_default=False) as one,
    ):
        yield one


def test_every_piece_is_done_once_with_its_number_and_an_error_of_one_ends_it(client: Any) -> None:
    with computing(Where(processes=1)) as one, computing(Where(processes=2)) as two:
        for those in (one, two, Workers(client=client)):
            assert sorted(those.done(twice, range(12))) == [(n, 2 * n) for n in range(12)]
    assert Workers(client=client).count == 2
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        dict(Workers(client=client).done(math.sqrt, [-1.0]))


def test_a_run_on_a_cluster_has_the_numbers_of_this_machine(client: Any, reference: Results, tmp_path: Path) -> None:
    """Who asked writes what workers hand back."""
    address = client.scheduler.address
    same(run([TINY], tmp_path / "there", backend="dask", address=address, quiet=True), reference)


def test_a_worker_that_comes_later_with_other_sources_is_refused(client: Any) -> None:
    assert spread._like_here(identity(), twice, 7, 2) == (7, 4)
    with pytest.raises(ValueError, match=r"a worker that came later \(.*\) has other sources .*: install"):
        spread._like_here("0" * 16, twice, 7, 2)


@pytest.mark.parametrize("who", ["scheduler", "worker"])
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("{'error': 'No module x'}", r" cannot import this package \(No module x\): .* with the extra bench there"),
        (
            f"{spread._ASK} | {{'source': '0' * 16}}",
            r" has another .*, sources 0{16}\) than this .*\): install steerkit",
        ),
    ],
)
def test_a_cluster_that_cannot_work_for_this_machine_is_told_in_seconds(
    client: Any, who: str, answer: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept, address = spread._accept, client.scheduler.address

    def accepted(asked: str, answered: Any, **how: Any) -> None:
        if f"the {who}" in asked:
            accept(asked, answered, **how)

    with dask_client(address) as like_here:
        assert len(like_here.nthreads()) == 2
    monkeypatch.setattr(spread, "_ASK", answer)
    monkeypatch.setattr(spread, "_accept", accepted)
    with pytest.raises(ValueError, match=f"^--address {address}: the {who}.*{message}"), dask_client(address):
        pytest.fail("there is no client")


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"steerkit-control": "9.9"}, r"it has another steerkit-control \(9\.9, "),
        ({"numpy": "0.1", "torch": "0.2"}, r"it has numpy 0\.1 instead of .*, torch 0\.2 instead of "),
    ],
)
def test_other_versions_matter_where_numbers_are_made(other: dict[str, str], message: str) -> None:
    answered = eval(spread._ASK, {})
    assert answered == {"source": source(everything=True), "versions": versions()}
    answered = answered | {"versions": versions() | other}
    assert re.match(message, _objection("it", answered))
    assert bool(_objection("it", answered, packages=False)) == ("numpy" not in other)  # as of a scheduler


@pytest.mark.parametrize("listening", [False, True])
def test_where_no_scheduler_answers_it_ends(listening: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is there, or somebody who says nothing."""
    monkeypatch.setattr(spread, "CONTACT", 0.5)
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if listening:
            server.listen()
        address = "tcp://{}:{}".format(*server.getsockname())
        refused = pytest.raises(ValueError, match=f"--address {address}: no Dask scheduler answers there")
        with refused, dask_client(address):
            pytest.fail("there is no client")
    with pytest.raises(ValueError, match="unknown address scheme 'nowhere'"), dask_client("nowhere://x"):
        pytest.fail("there is no client")
