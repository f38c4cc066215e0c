"""Files: the old one or the new one, whole, whatever happens; and .npz files read with care."""

import errno
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit._support import files
from tests.support.recordings import full_disk


def names(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def test_a_file_is_there_when_the_block_has_ended_well_and_not_before(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")
    with files.atomic_write(file) as draft:
        draft.write_text("new")
        assert file.read_text() == "old"
        assert draft.parent == tmp_path  # on the same disk, or it could not be renamed at once
    assert file.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [ValueError("mine"), KeyboardInterrupt(), OSError(errno.ENOSPC, "no space")])
def test_after_any_error_the_old_file_is_there_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")

    def fail() -> None:
        with files.atomic_write(file) as draft:
            draft.write_text("half")
            raise error

    with pytest.raises(type(error)) as caught:
        fail()
    assert f"{file} was not written; what was there before is unchanged" in caught.value.__notes__
    assert file.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_a_new_file_that_could_not_be_written_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="x holds objects, expected numbers or text"):
        files.write_npz(tmp_path / "a.npz", {"x": [object()]})
    assert names(tmp_path) == []


def test_on_a_full_disk_the_old_file_stays_and_no_rubbish_is_left(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    files.write_npz(file, {"x": np.arange(3.0)})
    with full_disk(10_000):
        for write in (
            lambda: files.write_npz(file, {"x": np.ones(5000)}),
            lambda: files.write_text(file, "x" * 20_000),
        ):
            with pytest.raises(OSError, match="File too large"):
                write()
    np.testing.assert_array_equal(files.read_npz(file, "test")["x"], np.arange(3.0))
    assert names(tmp_path) == ["a.npz"]


def test_the_disk_has_it_before_the_old_one_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    sync, replace = os.fsync, os.replace
    monkeypatch.setattr(files.os, "fsync", lambda handle: (calls.append("sync"), sync(handle)))
    monkeypatch.setattr(files.os, "replace", lambda a, b: (calls.append("replace"), replace(a, b)))
    files.write_text(tmp_path / "a", "a")
    assert calls == ["sync", "replace"]
    calls.clear()
    files.write_npz(tmp_path / "a", {"x": 1.0}, durable=False)
    files.write_arrays(tmp_path / "a", "thing", {"x": 1.0}, durable=False)
    assert calls == ["replace", "replace"]


def test_a_file_that_another_thread_makes_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, stat = tmp_path / "a", Path.stat

    def made_after_the_first_look(self: Path, **options: Any) -> os.stat_result:
        if self.name == "a" and not os.path.exists(file):
            os.close(os.open(file, os.O_CREAT))
            raise FileNotFoundError(errno.ENOENT, "not there yet")
        return stat(self, **options)

    monkeypatch.setattr(Path, "stat", made_after_the_first_look)
    files.write_text(file, "mine")
    monkeypatch.undo()
    assert file.read_text() == "mine"


def test_what_a_killed_process_left_is_written_over(tmp_path: Path) -> None:
    with files.atomic_write(tmp_path / "a") as draft:
        left = draft
        draft.write_text("a")
    left.write_text("half")
    with files.atomic_write(tmp_path / "a") as draft:
        assert draft == left
        assert not draft.exists()
        draft.write_text("b")
    assert names(tmp_path) == ["a"]


def test_a_link_is_followed_and_what_is_no_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    files.write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "."):
        with pytest.raises(ValueError, match="is a folder or a device, expected a file's name"):
            files.write_text(tmp_path / name, "x")
    with pytest.raises(FileNotFoundError, match=r"there is no such folder.*nowhere"):
        files.write_text(tmp_path / "nowhere" / "a", "x")


def test_text_is_utf_8_in_any_locale(tmp_path: Path) -> None:
    files.write_text(tmp_path / "a", "grün ✓\n")
    assert (tmp_path / "a").read_bytes() == "grün ✓\n".encode()
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbfx,y\n")  # a byte order mark is no part of the text
    assert files.read_text(tmp_path / "a.csv", "test") == "x,y\n"


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_come_back_bit_for_bit_under_any_name(tmp_path: Path, compressed: bool) -> None:
    arrays = {"x": np.array([0.1, -0.0, np.inf]), "n": np.arange(3), "t": np.array(["a", "grün"])}
    files.write_npz(tmp_path / "no_suffix", arrays, compressed=compressed)
    back = files.read_npz(tmp_path / "no_suffix", "test")
    assert back.keys() == arrays.keys()
    for name, values in arrays.items():
        assert back[name].dtype == values.dtype
        assert back[name].tobytes() == values.tobytes()
    files.write_npz(tmp_path / "zeros", {"x": np.zeros(10_000)}, compressed=compressed)
    assert ((tmp_path / "zeros").stat().st_size < 10_000) is compressed


def test_broken_and_foreign_files_are_told_and_nothing_in_them_is_executed(tmp_path: Path) -> None:
    files.write_npz(tmp_path / "good", {"x": np.arange(100.0)})
    good = (tmp_path / "good").read_bytes()
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "objects.npz", x=np.array([{}], dtype=object))
    contents = {"empty": b"", "cut": good[:-40], "text": b"a,b\n", "damaged": good[:200] + b"\xff" + good[201:]}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    for name in (*contents, "array.npy", "objects.npz"):
        with pytest.raises(ValueError, match=f"me: .*{name} is no NumPy .npz file, or a broken one"):
            files.read_npz(tmp_path / name, "me")
    with pytest.raises(FileNotFoundError):
        files.read_npz(tmp_path / "nowhere", "me")
    with pytest.raises(IsADirectoryError):
        files.read_npz(tmp_path, "me")


def test_arrays_of_another_kind_are_refused(tmp_path: Path) -> None:
    files.write_arrays(tmp_path / "a", "thing", {"x": 1.0})
    assert files.read_arrays(tmp_path / "a", "thing")["x"] == 1.0
    with pytest.raises(ValueError, match="a: holds 'steerkit thing 1', expected 'steerkit policy 1'"):
        files.read_arrays(tmp_path / "a", "policy")
    files.write_npz(tmp_path / "b", {"x": 1.0})
    with pytest.raises(ValueError, match=r"b: holds 'an .npz of another program', expected 'steerkit policy 1'"):
        files.read_arrays(tmp_path / "b", "policy")
    (tmp_path / "c").write_text("no")
    with pytest.raises(ValueError, match=r"c: cannot be read .* cut short or not a steerkit policy file"):
        files.read_arrays(tmp_path / "c", "policy")


def test_a_small_file_that_asks_for_a_lot_of_memory_is_refused_before_it_gets_any(tmp_path: Path) -> None:
    file = tmp_path / "bomb.npz"
    np.savez_compressed(file, a=np.zeros(3_000_000))  # 24 MB of zeros in 24 kB
    assert file.stat().st_size < 100_000
    with pytest.raises(ValueError, match="its arrays take 24 MB, expected at most 20 MB"):
        files.read_npz(file, "test", largest=20_000_000)
    assert files.read_npz(file, "test", largest=25_000_000)["a"].shape == (3_000_000,)


def test_a_header_that_promises_more_than_there_is_is_refused(tmp_path: Path) -> None:
    whole_file, liar = tmp_path / "a.npz", tmp_path / "b.npz"
    np.savez(whole_file, a=np.zeros(10))
    with zipfile.ZipFile(whole_file) as source, zipfile.ZipFile(liar, "w") as target:
        target.writestr("a.npy", source.read("a.npy").replace(b"(10,)", b"(99,)"))
    with pytest.raises(ValueError, match="says that it has 792 bytes"):
        files.read_npz(liar, "test")


def test_a_bounded_file_gives_what_is_left_however_much_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "short"
    file.write_bytes(b"0123456789")
    with files.Bounded(file) as stream:
        assert stream.read(4) == b"0123"
        assert stream.read(2**60) == b"456789", "an allocation of that size would fail"
        assert stream.read(1) == b""
        stream.seek(8)
        assert stream.read() == b"89"


def test_ctrl_c_while_arrays_are_written_is_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(stream: Any, **arrays: Any) -> None:
        with zipfile.ZipFile(stream, "w") as archive:
            archive.open("a", "w").write(b"half")
            raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        files.write_npz(tmp_path / "a.npz", {"a": 1.0})
    assert list(tmp_path.iterdir()) == []


def test_what_a_file_goes_on_giving_after_its_end_is_not_read() -> None:
    """Those of /proc are files without a length; /proc/kmsg has none to give for a while, and never ends."""
    assert files.read_bytes("/proc/self/status") == b""
