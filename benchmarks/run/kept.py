"""Results of a study's jobs, kept in a file as they come, so that a study that was stopped goes on."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

from benchmarks.run.sources import source
from benchmarks.run.spread import Workers
from benchmarks.tables import as_line, say
from steerkit._support.errors import require
from steerkit._support.files import sync

Row = Mapping[str, Any]
"""A job's fields, then those of what came of it, and `code`: a hash of the sources that it was made with."""


def stored(file: Path) -> dict[str, Row]:
    """What `done` kept in `file`, by job; nothing where there is no file.

    A last line that a killed study left half written is none. Raises ValueError for a file of anything else.
    """
    if not file.exists():
        return {}
    *whole, _ = file.read_text(encoding="utf-8").split("\n")
    rows = dict[str, Row]()
    for number, line in enumerate(whole, start=1):
        try:
            kept = json.loads(line)
        except ValueError:
            kept = None
        ours = isinstance(kept, dict) and kept.keys() == {"job", "row"} and isinstance(kept["job"], str)
        require(ours, f"{file}, line {number}", f"{line[:40]!r}, expected the result of a study, as --keep makes it")
        assert kept is not None
        rows[kept["job"]] = kept["row"]
    return rows


def done(
    function: Callable[[Any], Mapping[str, Any]], jobs: Sequence[Any], those: Workers, keep: Path | str | None = None
) -> list[Row]:
    """The rows of `jobs` in their order: those that the file `keep` holds, and the others, said and kept as they come.

    jobs: dataclasses; function: of one, returns what came of it by name. Raises ValueError as `stored`.
    """
    file = Path(keep) if keep else None
    known = stored(file) if file else {}
    rows = {job: known[_name(job)] for job in jobs if _name(job) in known}
    left = [job for job in jobs if job not in rows]
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
    for number, made in those.done(function, left, say=say):
        job = left[number]
        rows[job] = json.loads(json.dumps(asdict(job) | {**made, "code": source()}))
        if file:
            append_line(file, json.dumps({"job": _name(job), "row": rows[job]}))
        say(f"{len(rows)} of {len(jobs)}: {as_line(rows[job])}")
    return [rows[job] for job in jobs]


def _name(job: Any) -> str:
    assert is_dataclass(job)
    return json.dumps([type(job).__name__, asdict(job)])  # type: ignore[arg-type]


def append_line(file: Path, line: str) -> None:
    """Add a line to a text file (UTF-8), and wait until the disk has it; a last line that is half written goes first.

    For records that are kept one by one while a program runs that may be killed. The file is made where there is none.
    """
    with file.open("ab+") as out:
        out.seek(0)
        out.truncate(out.read().rfind(b"\n") + 1)
        out.write(f"{line}\n".encode())
        out.flush()
        sync(out)
