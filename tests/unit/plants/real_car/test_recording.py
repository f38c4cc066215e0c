"""Recordings of a drive: mended, or left as they are."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import pytest

from steerkit.plants.real_car import recording as tapes


def cut_short(folder: Path) -> Path:
    tape = tapes.Recording(folder / "tape.mcap", {"a": "b"})
    for k in range(50):
        tape._queue.put(("/tick", {"t": 0.01 * k}))
    tape.close()
    whole = (folder / "tape.mcap").read_bytes()
    (folder / "tape.mcap").write_bytes(whole[: 3 * len(whole) // 4])
    return folder / "tape.mcap"


def test_a_recording_that_was_cut_short_gets_its_end(tmp_path: Path) -> None:
    file = cut_short(tmp_path)
    left = tapes.read(file)
    assert not left.whole
    assert [m.values for m in tapes.mend(file).messages] == [m.values for m in left.messages]
    assert tapes.read(file) == left._replace(whole=True)
    assert [f.name for f in tmp_path.iterdir()] == ["tape.mcap"]


def test_a_recording_that_cannot_be_mended_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = cut_short(tmp_path)
    before = file.read_bytes()

    def full(self: tapes.Recording, topic: str, values: dict[str, Any]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tapes.Recording, "_add", full)
    with pytest.raises(OSError, match=r"its copy could not be written: .*No space left"):
        tapes.mend(file)
    assert file.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["tape.mcap"]
