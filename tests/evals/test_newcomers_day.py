"""The whole day of a newcomer, in a directory that is no checkout, with parts of their own."""

import os
import sys
from functools import partial
from pathlib import Path

from tests.support import programs
from tests.support.newcomers_day import DAY, bring_files, do


def test_a_newcomers_day_from_the_first_command_to_the_last(tmp_path: Path) -> None:
    """Course, car, controller and output element of one's own; learn, stop, go on; compare, film, export, report."""
    bring_files(tmp_path)
    fork = partial(programs.python, "-m", "steerkit", folder=tmp_path)  # as processes, all of them: `make dist`
    held: dict[Path, bytes] = {}
    for command in DAY:
        do(command, [sys.executable, "-m", "steerkit"], tmp_path, os.environ, fork)
        changed = [file.name for file, content in held.items() if file.read_bytes() != content]
        assert not changed, f"steerkit {command.line} changed what was there: {changed}"
        # nets and results that exist are gone on with, never made anew
        kept = [*tmp_path.glob("runs/*/nets/net-*.npz"), *tmp_path.glob("kept/cases/*.json")]
        held = {file: file.read_bytes() for file in kept}
