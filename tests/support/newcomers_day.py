"""A newcomer's day: files of one's own, the commands from the first to the last, and what each has to show.

`python -m tests.support.newcomers_day DIRECTORY` does it with the `steerkit` that is installed beside the interpreter.
"""

import csv
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.own_controller import own_controller
from tests.support.places import SUPPORT

RATIO, WHEELBASE, MASS, DELAY = 16.5, 2.7, 1500.0, 0.05
"""The newcomer's car: steering ratio [1], wheelbase [m], mass [kg], steering delay [s]."""
PATIENCE = 120.0
"""Seconds after which a process that shows nothing is taken for dead."""
Run = Callable[..., subprocess.CompletedProcess[str]]
CAR = "--course yard.csv --vehicle mine.toml"
LEARN = f"learn {CAR} --setting model-free --with doe=my_parts.py:Geared --with fit.nets=2 --minutes 1.4 --seed 1"
COMPARE = f"--code my_parts.py drive stanley mpc runs/a my_file.py:make {CAR} --rounds 0.3"
OWN = "my_file.py:make"


@dataclass(frozen=True, kw_only=True)
class Done:
    """A command that has ended."""

    place: Path
    code: int
    out: str
    err: str

    def answer(self) -> Any:
        """The JSON object that is the last line of its output."""
        return json.loads(self.out.strip().splitlines()[-1])


@dataclass(frozen=True, kw_only=True)
class Command:
    """One line of the day, what it has to show, and whether and how it is stopped."""

    line: str
    shows: Callable[[Done], None]
    stop: signal.Signals | None = None
    """Sent as soon as three nets more are in runs/a."""
    code: int = 0


def bring_files(place: Path) -> None:
    """The newcomer's own files: a course, a log of a car, a controller, an output element."""
    angles = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    radii = 32.0 + 5.0 * np.cos(2.0 * angles)
    _write(place / "yard.csv", ("x", "y"), zip(radii * np.cos(angles), radii * np.sin(angles)))
    _write(place / "lap.csv", ("t", "delta_sw", "v", "r"), _lap())
    own_controller(place)
    shutil.copy(SUPPORT / "own_parts.py", place / "my_parts.py")


def _write(file: Path, names: Sequence[str], rows: Any) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(names)
        table.writerows([f"{value:.6f}" for value in row] for row in rows)


def _lap() -> list[tuple[float, float, float, float]]:
    """Two minutes of a single-track car at walking to running pace, 50 rows a second: t, delta_sw, v, r."""
    l_f, c_f, c_r, i_z = 1.2, 1.8e5, 2.2e5, 2400.0
    l_r, step, noise = WHEELBASE - l_f, 0.002, random.Random(1)
    beta = r = 0.0
    rows = []
    for k in range(60_000):
        t = k * step
        v = 6.0 + 1.5 * math.sin(0.1 * t)
        if k % 10 == 0:
            rows.append((t, _wheel(t), v, r + noise.gauss(0.0, 0.003)))
        delta = _wheel(t - DELAY) / RATIO
        f_f, f_r = c_f * (delta - beta - l_f * r / v), c_r * (l_r * r / v - beta)
        beta += step * ((f_f + f_r) / (MASS * v) - r)
        r += step * (l_f * f_f - l_r * f_r) / i_z
    return rows


def _wheel(t: float) -> float:
    return 2.0 * math.sin(0.5 * t) + math.sin(1.3 * t + 1.0)


def _identified(done: Done) -> None:
    found = done.answer()["estimates"]
    assert abs(found["steer_ratio"]["value"] / RATIO - 1.0) < 0.02, found["steer_ratio"]
    assert found["steer_ratio"]["source"] == "log and prior"  # no heading tells the gyro's scale
    assert abs(found["delay_lag"]["value"] - DELAY) < 0.03, found["delay_lag"]
    assert f"steer_ratio = {found['steer_ratio']['value']}" in (done.place / "mine.toml").read_text(encoding="utf-8")
    assert any("the rest of vw-passat" in note for note in done.answer()["notes"]), "names the car that was borrowed"


def _interrupted(done: Done) -> None:
    assert "steerkit: interrupted; the same with --out runs/a goes on from the last training" in done.err, done.err
    assert not done.out


def _killed(done: Done) -> None:
    assert not done.out


def _went_on(done: Done) -> None:
    run = done.answer()
    assert 1.4 <= run["driving_minutes"] < 1.42, run
    assert run["updates"] + 1 == len(_nets(done.place)), "net 0 is the untrained one"
    assert (run["course"], run["setting"], run["seed"]) == ("yard.csv", "model-free", 1)
    assert {file.name for file in (done.place / "runs" / "a").glob("*.png")} == {
        "learning.png",
        "round.png",
        "data.png",
    }


def _learned_longer(done: Done) -> None:
    run = done.answer()
    assert 1.5 <= run["driving_minutes"] < 1.52, run
    assert run["transitions"] > 1000
    kept = json.loads((done.place / "runs" / "a" / "run.json").read_text(encoding="utf-8"))
    assert "Geared" in json.dumps(kept)


def _compared(done: Done) -> None:
    rows = {row["controller"]: row for row in done.answer()["drives"]}
    assert list(rows) == ["stanley", "mpc", "runs/a", OWN]
    analytic = [rows[name] for name in ("stanley", "mpc", OWN)]
    assert all(row["held"] and 0.0 < row["rms_e"] < 0.05 for row in analytic), rows
    assert rows["runs/a"]["share_within_5cm"] > 0.3, "an untrained net has less than 0.02"
    assert len({row["rms_e"] for row in rows.values()}) == 4, "each drove for itself"
    files = {file.name for file in (done.place / "compared").iterdir()}
    assert files == {"stanley.npz", "mpc.npz", "a.npz", "my_file.py-make.npz", "drive.png"}


def _filmed(done: Done) -> None:
    from PIL import Image

    with Image.open(done.place / "film.gif") as film:
        assert getattr(film, "n_frames", 1) > 10
        assert min(film.size) > 200
    assert done.answer()["controller"] == "runs/a"


def _exported(done: Done) -> None:
    import onnxruntime

    assert done.answer()["onnx"]["largest_difference"]["action"] == 0.0
    session = onnxruntime.InferenceSession(str(done.place / "policy.onnx"))
    states = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 6))
    states[:, 2] += 5.0
    action, q = session.run(["action", "q"], {"state": states})
    allowed = np.deg2rad([-60.0, -10.0, 0.0, 10.0, 60.0])
    assert np.abs(action[:, None] - allowed).min(axis=1).max() < 1e-12
    assert len(set(action)) > 1
    assert 0.0 < q.min() < q.max() < 1.0


def _kept(done: Done) -> None:
    assert (done.answer()["done"], done.answer()["errors"]) == (2, 0)
    assert len(_cases(done.place)) == 2


def _beside(done: Done) -> None:
    assert (done.answer()["done"], done.answer()["errors"]) == (4, 0)
    ours = [case for case in _cases(done.place) if "my_file" in case]
    assert len(ours) == len(_cases(done.place)) - len(ours) == 2


def _reported(done: Done) -> None:
    page = (done.place / "kept" / "report.html").read_text(encoding="utf-8")
    rows = [row for row in page.split("<tr")[1:] if "</tr>" in row]
    named = {name: [row for row in rows if f">{name}<" in row] for name in ("stanley-textbook", OWN)}
    assert all(named.values()), {name: len(found) for name, found in named.items()}
    assert len(page) > 100_000


def _nets(place: Path) -> set[str]:
    return {file.name for file in (place / "runs" / "a" / "nets").glob("net-*.npz")}


def _cases(place: Path) -> set[str]:
    return {file.name for file in (place / "kept" / "cases").glob("*.json")}


DAY = (
    Command(line=f"identify lap.csv --wheelbase {WHEELBASE} --name mine --out mine.toml --json", shows=_identified),
    Command(line=f"{LEARN} --out runs/a --json", shows=_interrupted, stop=signal.SIGINT, code=130),
    Command(line=f"{LEARN} --out runs/a --json", shows=_killed, stop=signal.SIGKILL, code=-9),
    Command(line=f"{LEARN} --out runs/a --json", shows=_went_on),
    Command(line="--code my_parts.py learn --out runs/a --minutes +0.1 -q --json", shows=_learned_longer),
    Command(line=f"{COMPARE} --out compared --json", shows=_compared),
    Command(
        line=f"--code my_parts.py drive runs/a {CAR} --rounds 0.05 --animate film.gif --out filmed --json",
        shows=_filmed,
    ),
    Command(line="--code my_parts.py export runs/a --onnx policy.onnx --json", shows=_exported),
    Command(line="bench run golden --only stanley-textbook --seeds 1 -j 1 --out kept -q --json", shows=_kept),
    Command(
        line=f"bench run golden --controller {OWN} --only my_file --seeds 1 -j 1 --out kept -q --json", shows=_beside
    ),
    Command(line="bench report kept", shows=_reported),
)
"""The day, in its order."""


def do(
    command: Command, program: Sequence[str], place: Path, environment: Mapping[str, str], run: Run | None = None
) -> Done:
    """Carry one line out in `place`, stop it if it is to be stopped, and look at what it shows.

    run: how to run a line that is not stopped, other than as a process of `program`.
    """
    words = command.line.split()
    if run and command.stop is None:
        ended = run(*words)
        code, out, err = ended.returncode, ended.stdout, ended.stderr
    else:
        code, out, err = _process(command, [*program, *words], place, environment)
    where = f"steerkit {command.line}"
    assert code == command.code, f"{where}: exit code {code}\n{out}\n{err}"
    # an interrupt within Python's own ZipFile has that complain as it is thrown away
    said = err.partition("Exception ignored in: <function ZipFile.__del__")[0] if command.stop else err
    assert "Traceback" not in said, f"{where}\n{err}"
    done = Done(place=place, code=code, out=out, err=err)
    try:
        command.shows(done)
    except Exception as why:
        why.add_note(f"after: {where}")
        raise
    return done


def _process(
    command: Command, words: Sequence[str], place: Path, environment: Mapping[str, str]
) -> tuple[int, str, str]:
    """(exit code, output, errors)."""
    before = len(_nets(place))
    # a shell without job control has its children ignore an interrupt, and they would hand that on
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            words, cwd=place, env=dict(environment), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGINT, handler)
    with process:
        try:
            if command.stop is not None:
                _await_nets(process, place, before + 3)
                process.send_signal(command.stop)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    return process.returncode, out, err


def _await_nets(process: subprocess.Popen[str], place: Path, number: int) -> None:
    end = time.monotonic() + PATIENCE
    while len(_nets(place)) < number:
        assert process.poll() is None, "the run was over before it could be stopped"
        assert time.monotonic() < end, f"no {number} nets in {place}/runs/a/nets"
        time.sleep(0.02)


def main() -> int:
    """The day, in a directory that is made for it."""
    place = Path(sys.argv[1]).resolve()
    place.mkdir()
    bring_files(place)
    for command in DAY:
        do(command, [str(Path(sys.executable).with_name("steerkit"))], place, os.environ)
        print(f"steerkit {command.line}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
