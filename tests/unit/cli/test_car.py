"""`steerkit car`: results where they are expected, and mistakes answered in one line with exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest

from steerkit.cli import car as car_cli


def run(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["steerkit car", *words])
    try:
        car_cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_check_prints_what_is_read_and_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", "dbw-kit.toml", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    for word in ("STEERING_REPORT (0x65)", "STEERING_CMD (0x64)", "path     paper", "no mistakes found"):
        assert word in printed


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("check", "mine.toml"), "shipped: dbw-kit.toml"),
        (("order", "GO"), "valid: ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE, OFF"),
        (("order", "ENGAGE", "--socket", "/nowhere/socket"), "no driver process answers there"),
        (("tape", "/dev/null"), "no recording of steerkit"),
        (("simulate", "--listen", "0.0.0.0:0"), "only 127.0.0.1"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    words: tuple[str, ...], says: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1


def test_a_controller_that_is_not_known_names_the_valid_ones(tmp_path: Path) -> None:
    from steerkit.on_car.loop import controller_named
    from steerkit.on_car.processes import fault_of
    from steerkit.plants.real_car.file.reading import load

    with pytest.raises(ValueError, match=r"valid: stanley, .*nfq \(the newest net in runs/car\), a learning run's"):
        controller_named("stanly", load("dbw-kit.toml"))
    with pytest.raises(ValueError, match="nor a place with a trained policy"):
        controller_named(str(tmp_path), load("dbw-kit.toml"))
    fault = fault_of("delay pose 2 0.2", 5.0)
    assert (fault.kind, fault.target, fault.start, fault.length, fault.amount) == ("delay", "pose", 5.0, 2.0, 0.2)
    with pytest.raises(ValueError, match="valid: drop, delay"):
        fault_of("dorp pose", 0.0)
