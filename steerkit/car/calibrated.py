"""The vehicle file that a drive's estimates make: what was found, with intervals, and the data sheet for the rest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.car import recording as tapes
from steerkit.car import replay as replays
from steerkit.car.config.config import CarConfig
from steerkit.car.estimates import DROVE, EARLIER, QUANTITIES, changes, earlier, known_in, lines
from steerkit.car.protocol import ESTIMATES
from steerkit.estimators.estimate import Estimated
from steerkit.vehicles.file import text_of, vehicle_text

DATA_SHEET = "data sheet"
"""Who tells what no drive has told."""
NAMED = "-calibrated"
"""End of the name of a car that was calibrated."""


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """What is known of a car after a drive."""

    config: CarConfig
    found: Mapping[str, Estimated]
    """By the names of `protocol.ESTIMATES`."""
    before: Mapping[str, Estimated]
    """What an earlier drive knew: kept where this one did not tell."""
    log: str
    digest: str
    """SHA-256 of the recording."""
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> dict[str, tuple[Estimated, str]]:
        """Each quantity that a drive has told, and which one."""
        rows = {name: (self.before[name], EARLIER) for name in ESTIMATES if name in self.before}
        rows |= {name: (self.found[name], DROVE) for name in ESTIMATES if self.found[name].valid > 0.5}
        return {name: rows[name] for name in ESTIMATES if name in rows}

    @property
    def learned(self) -> int:
        """How many quantities this drive has told."""
        return sum(source == DROVE for _, source in self.known.values())

    @property
    def steering(self) -> dict[str, float]:
        """Dead time, lag [s] and offset [rad]: dead time and lag as a pair, whose sum is known best."""
        known, times = self.known, {"delay": self.config.delay, "lag": self.config.lag}
        if self.found["delay_lag"].valid > 0.5:
            times = {name: self.found[name].value for name in times}
        else:
            times = {name: known[name][0].value if name in known else value for name, value in times.items()}
        offset = known["offset"][0].value if "offset" in known else 0.0
        return {name: max(value, 0.0) for name, value in times.items()} | {"offset": offset}

    @property
    def changes(self) -> list[str]:
        """What is another than the earlier drive found."""
        return changes(self.before, self.found)

    def text(self) -> str:
        """The vehicle file: `vehicle(file)` reads its car, `steering_of(file)` its steering."""
        car, known = self.config.vehicle, self.known
        ratio = known["steer_ratio"][0].value if "steer_ratio" in known else car.steer_ratio
        sheet = {"delay": self.config.delay, "lag": self.config.lag, "offset": 0.0, "rate_zero": 0.0}
        sheet |= {"steer_ratio": float(car.steer_ratio), "understeer": float(car.understeer_gradient)}
        rows: dict[str, dict[str, Any]] = {}
        for name in ESTIMATES:
            unit = QUANTITIES[name].si
            if name in known:
                q, source = known[name]
                rows[name] = {"value": q.value, "low": q.low, "high": q.high, "unit": unit, "source": source}
            elif name in sheet:
                rows[name] = {"value": sheet[name], "unit": unit, "source": DATA_SHEET}
        untold = [name for name in ESTIMATES if name not in known]
        notes = [f"{', '.join(untold)}: not told by this drive"] if untold else []
        provenance = {
            "log": self.log,
            "sha256": self.digest,
            "base": f"{car.name}: m, i_z, l_f, l_r, c_f, c_r, mu are given, not found",
            "notes": [*self.notes, *notes],
            "changes": self.changes,
        }
        named = replace(car, name=f"{car.name.removesuffix(NAMED)}{NAMED}", steer_ratio=ratio)
        return vehicle_text(named, steering=self.steering, estimates=rows, provenance=provenance)


class NothingLearned(ValueError):
    """A drive that told nothing: too slow, too straight, or never engaged."""


def check_place(out: FilePath) -> None:
    """Raise ValueError unless a vehicle file can be written there: a new one, or in the place of one."""
    require(out.suffix == ".toml", f"--out {out}", "a vehicle file ends in .toml")
    require(out.absolute().parent.is_dir(), f"--out {out}", f"there is no folder {out.absolute().parent}")
    if out.exists():
        known_in(text_of(out), f"--out {out}")


def of_recording(recording: FilePath) -> Calibrated:
    """What the longest drive of a recording tells; raises ValueError when there is none."""
    recorded = tapes.read(recording)
    config = tapes.config_of(recorded)
    drives = list(replays.drives(recorded))
    require(bool(drives), f"{recording}", "nobody drove: there is no request in it")
    drive = max(drives, key=lambda drive: len(drive.requests))
    estimators, _ = replays.replayed_estimates(drive, config)
    lost = () if recorded.whole else (f"the recording is damaged or cut short: {recorded.kept()}",)
    digest = hashlib.sha256(recording.read_bytes()).hexdigest()
    found = estimators.found()
    return Calibrated(config=config, found=found, before=earlier(config), log=recording.name, digest=digest, notes=lost)


def from_recording(recording: FilePath, out: FilePath, *, say: bool = True) -> dict[str, Any]:
    """Write the vehicle file that a recording makes, and say what is known and what has changed; returns the same.

    A file that is there already is the earlier drive: what this one does not tell is kept. Raises NothingLearned, and
    writes nothing, when this drive has told nothing.
    """
    made = of_recording(recording)
    if out.exists():
        made = replace(made, before=known_in(text_of(out), f"{out}"))
    if say:
        print("\n".join([*lines(made.found), *made.changes]))
    if not made.learned:
        needed = "the wheel has to move to and fro while the car is ENGAGED and drives 3 m/s or faster"
        raise NothingLearned(f"{recording}: nothing was learned, no vehicle file is written; {needed}")
    try:
        write_text(out, made.text())
    except OSError as error:
        error.add_note(f"the drive is in {recording}: steerkit car calibrate --from {recording} --out FILE")
        raise
    print(f'{made.learned} of {len(ESTIMATES)} quantities in {out}; to drive with it: [vehicle] name = "{out.name}"')
    times = ", ".join(f"{name} = {value:.3f}" for name, value in made.steering.items() if name != "offset")
    print(f"and for controllers that predict: [kit] {times}")
    rows = {
        name: {"value": q.value, "low": q.low, "high": q.high, "valid": q.valid > 0.5} for name, q in made.found.items()
    }
    return {"vehicle_file": str(out), "estimates": rows, "changes": made.changes}
