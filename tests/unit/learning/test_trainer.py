"""Training beside driving: nobody waits, nothing is lost silently, and the nets are those of `nfq.iterate`."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from steerkit.learning.costs import BandCost, Costs, TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting, Learned, Problem
from steerkit.learning.trainer import Job, Nets, SimulatedTrainer, Trainer
from tests.support import programs
from tests.support.programs import alive
from tests.support.records import ACTIONS, recorded

PROBLEM = Problem(actions=ACTIONS, cost=TanhCost(), fit=FitSetting(epochs=10, nets=2))
SECONDS_TO_WAIT = 120.0
"""Only reached when something is broken."""


def job(number: int, **changes: Any) -> Job:
    transitions, cost = changes.get("transitions", recorded()), changes.get("cost", TanhCost())
    return Job(number=number, seed=number, transitions=transitions, problem=replace(PROBLEM, cost=cost))


def expected(number: int, nets: Nets = ()) -> Nets:
    return nfq.iterate(recorded(), PROBLEM, nets, seed=number)


def same(nets: Nets | None, others: Nets) -> bool:
    assert nets is not None
    return all((p == q).all() for net, other in zip(nets, others, strict=True) for p, q in zip(net, other, strict=True))


def until(done: Callable[[], Any]) -> Any:
    """Wait for something that must come."""
    deadline = time.monotonic() + SECONDS_TO_WAIT
    while not (answer := done()):
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.01)
    return answer


@dataclass(frozen=True)
class Gate:
    """A cost that tells when training has begun and holds it until a file `go` is there."""

    place: Path

    def __call__(self, s: Any, a: Any, s_next: Any) -> Costs:
        (self.place / f"begun-{os.getpid()}").touch()
        until((self.place / "go").exists)
        return BandCost()(s, a, s_next)

    def wait_for_training(self, trainer: Trainer) -> int:
        """Until its process has begun: the number of that."""
        until((self.place / f"begun-{trainer.pid}").exists)
        return trainer.pid or 0


class Deadly:
    def __call__(self, s: Any, a: Any, s_next: Any) -> Costs:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@pytest.fixture(scope="module")
def shared() -> Iterator[Trainer]:
    """One process for all tests that leave it whole."""
    with Trainer() as trainer:
        yield trainer


@pytest.fixture(autouse=True)
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes begin as forks, but for the shared one: what they import takes longer than what they do."""
    programs.forking(monkeypatch.setattr)


@pytest.fixture
def own() -> Iterator[Trainer]:
    with Trainer() as trainer:
        yield trainer


# ---- the same interface -----------------------------------------------------------------------------------------


@pytest.fixture(params=[lambda: nullcontext(SimulatedTrainer(seconds=3.0)), Trainer], ids=["simulated", "process"])
def trainer(request: pytest.FixtureRequest) -> Iterator[Any]:
    with request.param() as made:
        yield made


def test_every_trainer_makes_the_nets_of_iterate_one_after_the_other(trainer: Any) -> None:
    assert trainer.poll(0.0) is None
    assert not trainer.busy
    rows = recorded()
    trainer.submit(job(1, transitions=rows), 0.0)
    rows.extend(*[getattr(recorded(seed=1), name) for name in ("s", "a", "s_next", "episode")])  # drives on
    assert trainer.busy
    result = until(lambda: trainer.poll(3.0))
    first = expected(1)
    assert (result.number, result.fault, trainer.busy) == (1, "", False)
    assert same(result.nets, first)
    assert trainer.poll(4.0) is None  # once only
    trainer.submit(job(2), 5.0)
    trainer.submit(job(3), 5.0)
    second = until(lambda: trainer.poll(11.0))
    assert second.number == 3  # 2 is where 3 began, and no more
    assert same(second.nets, expected(3, expected(2, first)))
    assert second.seconds > 0.0
    assert (trainer.busy, trainer.poll(100.0)) == (False, None)
    with pytest.raises(ValueError, match="job number 3, expected > 3, the one before"):
        trainer.submit(job(3), 12.0)


# ---- simulated --------------------------------------------------------------------------------------------------


def test_simulated_nets_are_ready_when_the_charged_time_has_passed() -> None:
    trainer = SimulatedTrainer(seconds=1.5)
    trainer.submit(job(1), 10.0)
    assert trainer.poll(11.45) is None
    first = trainer.poll(30 * 0.05 + 10.0)
    assert first is not None
    trainer.submit(job(2), 20.0)
    trainer.submit(job(3), 20.5)  # begins at 21.5, when 2 is done
    assert trainer.poll(22.95) is None
    assert trainer.poll(23.0) is not None
    trainer.submit(job(4), 40.0)  # after a pause: begins at once
    assert trainer.poll(41.5) is not None
    trainer.submit(job(5), 50.0)
    resumed = SimulatedTrainer(seconds=1.5, pending=trainer.pending)  # of a checkpoint
    assert same(resumed.learned.nets, trainer.learned.nets)
    assert resumed.poll(51.5) is not None
    with pytest.raises(ValueError, match="job number 5"):
        resumed.submit(job(5), 52.0)
    again = SimulatedTrainer(learned=Learned(first.nets or (), first.forecast))
    again.submit(job(2), 60.0)
    assert same(again.learned.nets, expected(2, first.nets))


# ---- in a process -----------------------------------------------------------------------------------------------


def test_an_error_in_training_is_told_and_the_next_job_works(shared: Trainer) -> None:
    pid = shared.pid
    for number, change, why in (
        (200, {"transitions": Transitions()}, "net 200 could not be trained: ValueError: nfq.iterate: no transitions"),
        (202, {"cost": lambda s, a, s_next: None}, "net 202 could not be trained: .*pickle"),
    ):
        shared.submit(job(number, **change))
        result = until(shared.poll)
        assert result.nets is None
        assert re.match(why, result.fault)
    before = shared._learned
    shared.submit(job(203))
    assert same(until(shared.poll).nets, expected(203, before.nets))
    assert (shared.pid, shared.busy) == (pid, False)


def test_neither_submit_nor_poll_waits_and_the_process_steps_back(own: Trainer, tmp_path: Path) -> None:
    gate = Gate(tmp_path)
    own.submit(job(1, cost=gate))
    gate.wait_for_training(own)
    assert own.pid is not None
    behind = min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)  # 19 is the end of the scale
    assert os.getpriority(os.PRIO_PROCESS, own.pid) == behind
    big = recorded(50_000)  # more than a pipe holds
    for number in range(2, 20):  # would never return if any of it waited: the gate is closed
        own.submit(job(number, transitions=big, cost=gate))
        assert own.poll() is None
        assert own.busy
    own.close()


def test_kill_9_while_training_is_told_and_made_good(own: Trainer, tmp_path: Path) -> None:
    gate = Gate(tmp_path)
    own.submit(job(1))
    first = until(own.poll)
    own.submit(job(2, cost=gate))
    old = gate.wait_for_training(own)
    os.kill(old, signal.SIGKILL)
    until(lambda: own.poll() or own.pid != old)  # driving goes on
    gate.wait_for_training(own)  # the same job, in a new process
    assert own.poll() is None
    assert own.busy
    (tmp_path / "go").touch()
    result = until(own.poll)
    assert result.fault == own.faults[0]
    assert result.fault == f"training process {old} died over net 2"
    assert same(result.nets, nfq.iterate(recorded(), replace(PROBLEM, cost=BandCost()), first.nets, seed=2))
    own.submit(job(3))
    assert same(until(own.poll).nets, expected(3, result.nets))


def test_kill_9_while_idle_costs_the_next_job_nothing(own: Trainer) -> None:
    old = own.pid or 0
    os.kill(old, signal.SIGKILL)
    until(lambda: not alive(old))
    own.submit(job(1))
    assert same(until(own.poll).nets, expected(1))
    assert own.faults[0].startswith(f"training process {old} died ")


def test_what_was_trained_and_not_fetched_is_not_trained_again(own: Trainer) -> None:
    """Nobody fetches while the recovery controller cannot hand over."""
    for number in (1, 2):
        own.submit(job(number))
        until(own.idle)
    assert own.pid is not None
    os.kill(own.pid, signal.SIGKILL)
    until(lambda: not alive(own.pid or 0))
    own.submit(job(3))
    assert [waiting.number for waiting in own._jobs] == [3]
    assert same(until(own.poll).nets, expected(3, expected(2, expected(1))))


def test_a_job_that_kills_its_process_is_given_up_and_the_next_one_works(own: Trainer) -> None:
    own.submit(job(1, cost=Deadly()))
    result = until(own.poll)
    assert result.nets is None
    assert result.fault.count(" died over net 1") == 3
    assert not own.busy
    own.submit(job(2))
    assert same(until(own.poll).nets, expected(2))


def test_a_process_that_is_silent_for_too_long_is_replaced(
    own: Trainer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(tmp_path)
    own.submit(job(1, cost=gate))
    gate.wait_for_training(own)
    monkeypatch.setattr("steerkit.learning.trainer.PATIENCE", 0.0)
    until(lambda: own.poll() or own.faults)
    assert own.busy
    assert own.faults[0].endswith("died over net 1")
    (tmp_path / "go").touch()
    until(own._futures[0].done)  # nobody asked in time, but it was not silent
    assert (own.poll() is not None, len(own.faults), alive(own.pid or 0)) == (True, 1, True)


def test_ctrl_c_is_for_the_loop(own: Trainer, tmp_path: Path) -> None:
    gate = Gate(tmp_path)
    own.submit(job(1, cost=gate))
    gate.wait_for_training(own)
    assert own.pid is not None
    os.kill(own.pid, signal.SIGINT)
    (tmp_path / "go").touch()
    assert until(own.poll).nets is not None
    assert own.faults == []


def test_close_ends_the_process_in_the_middle_of_a_job(tmp_path: Path) -> None:
    trainer, gate = Trainer(), Gate(tmp_path)
    trainer.submit(job(1, cost=gate))
    gate.wait_for_training(trainer)
    trainer.close()
    assert trainer.pid is not None
    with pytest.raises(ProcessLookupError):
        os.kill(trainer.pid, 0)
    assert (trainer.poll(), trainer.faults) == (None, [])
    with pytest.raises(RuntimeError, match="closed; make a new one"):
        trainer.submit(job(2))
    trainer.close()


def test_the_process_ends_with_its_parent() -> None:
    code = """
import sys, time
from steerkit.learning.trainer import Trainer
if __name__ == "__main__":
    trainer = Trainer()
    print(trainer.pid, flush=True)
    time.sleep(1000)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert alive(child)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    until(lambda: not alive(child))
