"""The transition store: it never delays a step, survives a kill, and refuses what it cannot vouch for."""

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.store import StoreError, TransitionStore
from tests.support.stores import AWKWARD, drive, fill, kept, same


def test_rows_come_back_in_order_and_bit_for_bit(tmp_path: Path) -> None:
    whole = drive(300)
    whole.append(AWKWARD, -0.0, AWKWARD, 99)
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        fill(store, whole)
        store.flush()
        assert store.writer is not None
        assert (store.writer.committed, store.writer.waiting, store.fault) == (301, [], "")
        assert same(store.transitions(), whole)  # another reader, while it is open to be written
    assert same(TransitionStore(tmp_path / "t.db").transitions(), whole)


def test_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(30))
    with TransitionStore(path, run="a") as store:
        assert store.next_episode() == 4
        fill(store, drive(10, seed=1, first_episode=4))
    rows = TransitionStore(path).transitions()
    assert rows.s[30:].tobytes() == drive(10, seed=1).s.tobytes()
    assert rows.s[:30].tobytes() == drive(30).s.tobytes()
    with TransitionStore(tmp_path / "new.db", run="a") as store:
        assert store.next_episode() == 0


def test_a_file_is_of_one_run(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(3))
    with pytest.raises(StoreError, match=r"holds the runs \['a'\], expected b; use a new file"):
        TransitionStore(path, run="b")
    assert len(TransitionStore(path).transitions()) == 3
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO run VALUES (2, 'b')")
    db.close()
    for run in (None, "a"):
        with pytest.raises(StoreError, match=r"holds the runs \['a', 'b'\], expected"):
            TransitionStore(path, run=run)


def test_what_cannot_be_learned_from_is_refused_at_once(tmp_path: Path) -> None:
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        with pytest.raises(ValueError, match="psi_e_next = nan, expected a finite number; end the episode"):
            store.append([0.0] * 6, 0.0, [0.0, 0.0, 0.0, float("nan"), 0.0, 0.0], 1)
        with pytest.raises(ValueError, match="s has 5, s_next has 6 entries, expected 6: e, e_dot"):
            store.append([0.0] * 5, 0.0, [0.0] * 6, 1)
    assert len(TransitionStore(tmp_path / "t.db").transitions()) == 0
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        store.append([0.0] * 6, 0.0, [0.0] * 6, 1)
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        TransitionStore(tmp_path / "t.db").append([0.0] * 6, 0.0, [0.0] * 6, 1)


@pytest.fixture
def blocked(tmp_path: Path) -> Iterator[tuple[TransitionStore, sqlite3.Connection]]:
    """A store whose file another program holds locked."""
    store = TransitionStore(tmp_path / "t.db", run="a")
    other = sqlite3.connect(store.path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    yield store, other
    other.close()
    store.close()


def test_a_locked_database_does_not_stop_append_and_loses_nothing(
    blocked: tuple[TransitionStore, sqlite3.Connection],
) -> None:
    store, other = blocked
    whole = drive(1000)
    fill(store, whole)
    for _ in range(500):  # would never return if append waited for the lock: nobody else releases it
        store.append([1.0] * 6, 0.5, [2.0] * 6, 200)
    with pytest.raises(StoreError, match=r"1500 transitions are not written after 0\.5 s: .*locked"):
        store.flush(timeout=0.5)
    assert store.writer is not None
    assert (len(store.writer.waiting), store.writer.committed) == (1500, 0)
    assert "locked" in store.fault
    other.execute("ROLLBACK")
    store.flush()
    assert (store.writer.waiting, store.fault) == ([], "")
    rows = store.transitions()
    assert len(rows) == 1500
    assert rows.s[:1000].tobytes() == whole.s.tobytes()


def test_rows_that_cannot_be_written_are_no_secret(
    blocked: tuple[TransitionStore, sqlite3.Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("steerkit.learning.data.store.PROMISE", -1.0)
    store, _ = blocked

    def give_up() -> None:
        store.append([1.0] * 6, 0.5, [2.0] * 6, 1)
        with pytest.raises(StoreError, match="1 transitions are not written"):
            store.close(timeout=1.0)

    with pytest.warns(RuntimeWarning, match="1 transitions wait to be written: .*locked"):
        give_up()


CHILD = """
import sys, time
from steerkit.learning.data.store import TransitionStore
store = TransitionStore(sys.argv[1], run="a")
k = 0
while True:
    store.append([k, 0, 5, 0, 0, 0], 0.5, [k + 1, 0, 5, 0, 0, 0], k // 100)
    k += 1
    print(k, store.writer.committed, time.monotonic(), flush=True)
    time.sleep(0.005)
"""


def test_kill_9_loses_at_most_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    lines = [child.stdout.readline()]
    while int(lines[-1].split()[1]) < 200:
        lines.append(child.stdout.readline())
    lines += [child.stdout.readline() for _ in range(400)]  # two seconds and more
    os.kill(child.pid, signal.SIGKILL)
    lines += child.stdout.readlines()
    child.wait()
    told = [line.split() for line in lines if line.endswith("\n")]
    appended, committed = int(told[-1][0]), int(told[-1][1])
    rows = TransitionStore(path).transitions()
    assert committed <= len(rows) <= appended + 1
    np.testing.assert_array_equal(rows.s[:, 0], np.arange(len(rows)))
    np.testing.assert_array_equal(rows.episode, np.arange(len(rows)) // 100)
    if len(rows) < appended:  # how old was the oldest row that is lost, by the child's own clock?
        assert float(told[-1][2]) - float(told[len(rows)][2]) < 1.0
    with TransitionStore(path, run="a") as store:
        store.append([0.0] * 6, 0.0, [0.0] * 6, store.next_episode())
    assert len(TransitionStore(path).transitions()) == len(rows) + 1


def test_a_program_that_ends_without_closing_loses_nothing(tmp_path: Path) -> None:
    code = CHILD.replace("while True", "while k < 50").replace("time.sleep(0.005)", "")
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "t.db")], check=True, capture_output=True)
    assert len(TransitionStore(tmp_path / "t.db").transitions()) == 50
