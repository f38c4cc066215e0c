"""Hostile files by a seed: each is read, or refused in one line; no code is run, nothing is touched, nothing hangs.

`HOSTILE=500 pytest tests/evals/test_hostile_files.py` makes so many of them.
"""

import copy
import json
import math
import os
import random
import re
import signal
import sys
import tomllib
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.car import recording as recordings
from steerkit.car.config import shipped
from steerkit.car.loop import RUN_FORMAT, Steers
from steerkit.car.protocol import Remark, encode
from steerkit.cli import app
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment
from steerkit.vehicles import vehicle, vehicle_text
from tests.support.places import ROOT
from tests.support.recordings import small

COUNT = int(os.environ.get("HOSTILE", "60"))
LONGEST = 2.0
"""Processor time that a command may take [s]."""
GIVEN = json.loads((ROOT / "tests/support/hostile.json").read_text())
CASES, CHANGES = GIVEN["files and the commands that read them"], set(GIVEN["changes"])
ODD = [*GIVEN["values"], 10**400, "x" * 5000]
WORDS = [*(word.encode() for word in GIVEN["words"]), *(5000 * part for part in (b"9", b"[", b'{"a":', b"a.")), b"\xff"]
CAR, NET, POLICY = "dbw-kit.toml", "r/nets/net-0001.npz", (ROOT / "tests/attack/policy.npz").read_bytes()
STEERS = Steers(name="stanley").text()


def places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Each place in nested lists and tables: what holds it, and its key."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], (dict, list)):
            yield from places(tree[key])


def mutated(tree: Any, rng: random.Random) -> Any:
    """Nested lists and tables with one to three places taken out, exchanged, added or replaced."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        (holder, key), (other, name) = rng.choices(list(places(tree)) or [([0], 0)], k=2)
        what, odd = rng.random(), copy.deepcopy(rng.choice(ODD))
        if what < 0.15:
            del holder[key]
        elif what < 0.3 and not isinstance(holder[key], (dict, list)):
            other[name], holder[key] = holder[key], odd
        elif what < 0.4 and isinstance(holder, dict):
            holder[rng.choice(["kind", "doe", "plant", "file", "x\ny"])] = odd
        else:
            holder[key] = odd
    return tree


def toml(value: Any, joint: str = "") -> str:
    """A value in TOML; with a joint, a whole file."""
    if isinstance(value, dict):
        rows = [f"{json.dumps(key)} = {toml(v)}" for key, v in value.items() if v is not None]
        return joint.join(rows) if joint else f"{{ {', '.join(rows)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def spoilt(data: bytes, rng: random.Random) -> bytes:
    """Bytes with a number, a word or a line exchanged, doubled, cut out or nested deeply; or cut short, or flipped."""
    parts = [m.span() for m in re.finditer(rb"[^\n]*\n|[\w.]+|\W", data)]
    (begin, end), (other, last) = rng.choices(parts, k=2)
    new, flips = rng.choice([*WORDS, 2 * data[begin:end], data[other:last]]), bytearray(data)
    flips[rng.randrange(len(flips))] ^= 1 << rng.randrange(8)
    return rng.choice([data[:begin] + new + data[end:]] * 4 + [data[:begin], bytes(flips)])


def recording(file: Path, rng: random.Random) -> None:
    """A recording with another description and other messages, and good sums."""
    found = recordings.parse(small())
    texts, messages, what = dict(found.metadata), list(found.messages), rng.randrange(5)
    if what == 0:
        key = rng.choice(list(texts))
        texts[key] = spoilt(texts[key].encode(), rng).decode(errors="replace")
    elif what == 1:
        texts["file:config.toml"] = toml(mutated(tomllib.loads(texts["file:config.toml"]), rng), "\n")
    who = mutated(json.loads(STEERS), rng) if what == 2 else json.loads(STEERS)
    data = json.dumps({"t": 0.0, "link": 1, "data": encode(Remark(json.dumps(who)[:4000])).hex()}).encode()
    messages.insert(5, messages[5]._replace(topic="/client", data=data))
    for k in rng.choices(range(len(messages)), k=rng.choice((0, 1, 3))):
        topic = rng.choice([messages[k].topic, messages[k].topic, *recordings.TOPICS])
        data = json.dumps(mutated(json.loads(messages[k].data), rng)).encode()
        messages[k] = messages[k]._replace(topic=topic, data=data)
    new = recordings.RecordingFile(file, texts, 0)
    for message in messages:
        new.add(message.topic, message.when, message.data)
        new.flush()
    new.close()


def spoil(file: Path, rng: random.Random) -> None:
    """Make a hostile file of it, of its kind, or what is no file at all."""
    if file.suffix == ".toml":
        file.write_text(toml(mutated(tomllib.loads(file.read_text()), rng), "\n"))
    elif file.suffix == ".json":
        file.write_text(json.dumps(mutated(json.loads(file.read_text()), rng)))
    elif file.suffix == ".mcap":
        file.unlink()
        recording(file, rng)
    elif file.suffix == ".npz":
        arrays: dict[str, Any] = dict(np.load(file))
        for name in rng.sample(sorted(arrays), rng.choice((1, 1, 2, 3))):
            a = arrays[name]
            odd = [a[..., None], a.ravel()[:0], a.astype("U4"), np.zeros(a.shape, complex), np.zeros((9, 10**6))]
            arrays[name] = rng.choice(
                [*odd, np.array("evil.py:make"), np.array(math.nan), np.array(-1), np.zeros_like(a)]
            )
        np.savez(file, **arrays)
    if (what := rng.randrange(20)) < 4:
        file.unlink()
        os.mkfifo(file) if what == 0 else file.mkdir() if what == 1 else os.symlink("/dev/zero", file)
        if what == 3:
            file.unlink()
            file.touch()
            os.truncate(file, 1 << 42)
    elif what < 9 or file.suffix == ".dbc":
        file.write_bytes(spoilt(file.read_bytes(), rng))


def template() -> dict[str, bytes]:
    """What stands in the folder."""
    car = shipped(CAR).read_text().replace("vw-passat", "my.toml") + '\n[controllers]\nallow = ["evil.py:make"]\n'
    plain = rundir.plain(Experiment())
    run = {"format": rundir.FORMAT, **{key: {} for key in rundir.KEYS}, "experiment": plain}
    own = "open('ran', 'w')\ndef make(belief): pass\n"
    texts = {CAR: car, "my.toml": vehicle_text(vehicle("vw-passat")), "victim": "kept", "a.mcap": ""}
    texts |= {"evil.py": own, "evil/__init__.py": own, "s.toml": toml(json.loads(json.dumps(plain)), "\n")}
    texts["r/run.json"] = json.dumps(run)
    texts["r/car.json"] = json.dumps({"format": RUN_FORMAT, "setting": plain["setting"]})
    dbc = {name: shipped(name).read_bytes() for name in ("dbw_steering.dbc", "pose.dbc")}
    return {name: text.encode() for name, text in texts.items()} | dbc | {NET: POLICY}


touched: list[str] = []
"""Files that were written or removed, programs and connections, but for what a command is there to write."""
MAY = re.compile(r".*/?(\.?a\.repaired\.mcap.*|\.?dbw-kit-calibrated\.toml.*|__pycache__/.*|null)")


def watch(event: str, words: tuple[Any, ...]) -> None:
    """An audit hook."""
    flags = words[2] if event == "open" and isinstance(words[2], int) else 0
    if (flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) or event in CHANGES) and not MAY.fullmatch(f"{words[0]}"):
        touched.append(f"{event} {words[0]}")


class Long(BaseException):
    """It took too long."""


def run(words: list[str]) -> str:
    """What is wrong with how `steerkit WORDS` ends; "" when nothing is."""

    def stop(*_: object) -> None:
        raise Long

    sys.argv = ["steerkit", *words]
    clocks = {signal.ITIMER_PROF: (signal.SIGPROF, LONGEST), signal.ITIMER_REAL: (signal.SIGALRM, 60.0)}
    before = {number: signal.signal(number, stop) for number, _ in clocks.values()}
    touched.clear()
    try:
        for clock, (_, seconds) in clocks.items():
            signal.setitimer(clock, seconds)
        app.main()
    except SystemExit:
        pass
    except BaseException:
        return traceback.format_exc(limit=-6)
    finally:
        for clock, (number, _) in clocks.items():
            signal.setitimer(clock, 0.0)
            signal.signal(number, before[number])
    return "; ".join(touched)


def test_hostile_files_are_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def begins(*_: object, **__: object) -> None:
        raise ValueError("here a drive would begin")

    for name in ("steerkit.car.session.session", "steerkit.learning.report.learn_with_progress"):
        monkeypatch.setattr(name, begins)
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.syspath_prepend(".")
    sys.addaudithook(watch)
    files, wrong, ended = template(), list[str](), Counter[str]()
    for number in range(COUNT):
        name, command = CASES[number % len(CASES)]
        for file, data in files.items():
            (place := tmp_path / f"{number}" / file).parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(data)
        monkeypatch.chdir(tmp_path / f"{number}")
        spoil(Path(name), random.Random(number))
        said = run(command.split())
        lines = capsys.readouterr().err.splitlines()
        if said or len(lines) > 1 or Path("ran").exists() or Path("victim").read_bytes() != files["victim"]:
            wrong.append(f"{number}, {command}: {said or lines}")
        ended[f"{command}: {'refused' if lines else 'read'}"] += 1
    if COUNT > 60:
        with capsys.disabled():
            print("", *sorted(ended.items()), sep="\n")
    assert not wrong, f"{len(wrong)} of {COUNT}\n" + "\n".join(wrong)
