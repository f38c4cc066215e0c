"""Results that are kept: what is there is not made again, a half line is none, another file is refused."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from benchmarks.run.kept import append_line, done, stored


@dataclass(frozen=True)
class Job:
    seed: int


@dataclass(frozen=True)
class Other:
    seed: int


class Pool:
    """Carries out at once what it is given, as `spread.Workers` do, and counts it; killed after so many."""

    def __init__(self, killed_after: int = 99):
        self.made, self.killed_after = list[int](), killed_after

    def done(self, function: Any, pieces: Sequence[Any], **_: Any) -> Iterator[tuple[int, Any]]:
        for number, job in enumerate(pieces):
            if len(self.made) >= self.killed_after:
                raise KeyboardInterrupt
            self.made.append(job.seed)
            yield number, function(job)


def drive(job: Any) -> dict[str, Any]:
    return {"e": {1: math.inf, 2: math.nan}.get(job.seed, 0.1), "names": ("a", "b")}


def rows(pool: Any, keep: Path | None, *seeds: int, kind: Any = Job) -> list[Any]:
    return done(drive, [kind(seed) for seed in seeds], pool, keep)


def test_a_stopped_study_goes_on_where_it_was(tmp_path: Path) -> None:
    keep, pool = tmp_path / "new" / "drives.jsonl", Pool(killed_after=2)
    with pytest.raises(KeyboardInterrupt):
        rows(pool, keep, 0, 1, 2, 3)
    with keep.open("a") as file:
        file.write('{"job": "[')  # killed while it wrote
    assert [row["e"] for row in stored(keep).values()] == [0.1, math.inf]
    pool = Pool()
    again = rows(pool, keep, 0, 1, 2, 3)
    assert pool.made == [2, 3]
    assert [row["seed"] for row in again] == [0, 1, 2, 3]
    assert [row["names"] for row in again] == [["a", "b"]] * 4
    assert repr(rows(Pool(0), keep, 0, 1, 2, 3)) == repr(again), "all of them are kept, as they were"
    assert [row["seed"] for row in rows(pool, keep, 3, kind=Other)] == [3]
    assert pool.made == [2, 3, 3], "another kind of drive is another drive"
    assert [row["seed"] for row in rows(Pool(), None, 4, 5)] == [4, 5], "without a file nothing is kept"


@pytest.mark.parametrize("line", ["nonsense", "[]", '{"job": "x"}', '{"job": 1, "row": {}}'])
def test_another_file_is_refused(line: str, tmp_path: Path) -> None:
    file = tmp_path / "drives.jsonl"
    file.write_text('{"job": "x", "row": {}}\n' + line + "\n")
    with pytest.raises(ValueError, match=r"line 2.*expected the result of a study"):
        stored(file)


def test_lines_are_added_and_half_a_line_goes(tmp_path: Path) -> None:
    file = tmp_path / "lines"
    append_line(file, "one")
    with file.open("a") as stream:
        stream.write("half of")
    append_line(file, "zwei ä")
    assert file.read_text(encoding="utf-8") == "one\nzwei ä\n"
