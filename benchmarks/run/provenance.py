"""Where results come from: versions, commit, platform, sources, and the protocol that was followed."""

import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

from benchmarks.entries import controller
from benchmarks.peers.agents import AGENTS
from benchmarks.peers.agents import SETTINGS as PEERS
from benchmarks.run.sources import ROOT, source, versions
from benchmarks.run.trainings import TRAININGS
from benchmarks.scenarios import facts
from benchmarks.suites import TRAINING, Job, Suite
from steerkit.learning.rundir import plain
from steerkit.learning.settings import setting
from steerkit.scenario import Scenario


def provenance(suites: Sequence[Suite], planned: Sequence[Job], seeds: int | None) -> dict[str, Any]:
    """All that provenance.json holds."""
    return {
        "suites": {one.name: one.about for one in suites},
        "seeds": sorted({job.seed for job in planned}),
        "planned": [job.id for job in planned],
        "scenarios": scenarios(suites, planned),
        "controllers": {name: _controller(name) for name in dict.fromkeys(job.controller for job in planned)},
        "source": source(),
        "versions": versions(),
        "commit": _git("rev-parse", "HEAD"),
        "dirty": bool(_git("status", "--porcelain")),
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "command": " ".join(["python -m benchmarks", *sys.argv[1:]]),
        "config": {"seeds": seeds},
    }


def scenarios(suites: Sequence[Suite], planned: Sequence[Job]) -> dict[str, dict[str, Any]]:
    """The fields of every scenario and training that is planned, by its name."""
    table: dict[str, dict[str, Any]] = {}
    places = {place.name: place for one in suites for place in one.scenarios}
    for one in suites:
        for place in one.scenarios:
            if table.setdefault(place.name, facts(place)) != facts(place):
                raise ValueError(f"two scenarios of these suites are called '{place.name}' but differ")
    for job in planned:
        if job.suite == TRAINING:
            training = TRAININGS[controller(job.controller).training]
            names = ("minutes", "episode_metres", "offline_iterations")
            fields = {name: getattr(training, name) for name in names}
            table[job.scenario] = facts(training.at(places.get(job.taught_on))) | fields
    used = {job.scenario for job in planned}
    return {name: fields for name, fields in table.items() if name in used}


def digest(job: Job, scenario: Scenario | None, timed_steps: int) -> str:
    """A hash of all that determines a case's numbers."""
    content = {
        "case": [job.scenario, job.controller, job.seed, job.kind],
        "scenario": None if scenario is None else facts(scenario),
        "controller": _controller(job.controller),
        "timed_steps": timed_steps,
        "source": source(),
        "versions": versions(),
        "machine": platform.machine(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _controller(name: str) -> dict[str, Any]:
    one = controller(name)
    entry: dict[str, Any] = {"kind": one.kind, "about": one.about}
    if one.setting:
        how = AGENTS[PEERS[one.setting]] if one.setting in PEERS else plain(setting(one.setting))
        entry |= {"setting": how, "training": f"train-{one.training}"}
    return entry


def _git(*words: str) -> str | None:
    """What git says of this checkout; None where there is none, as in an installed package."""
    if not (ROOT / ".git").exists():
        return None
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, encoding="utf-8", timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    try:
        lines = FilePath("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
