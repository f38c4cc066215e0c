"""A residual learns what is there, is left out where it does not help, and fades outside its data."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.identification import Drive, identify_tyres, learn_residual
from steerkit.identification.ahead import MEMORY, look_ahead
from steerkit.identification.tyres import Residual, Tyres, missed
from steerkit.vehicles import VW_PASSAT
from tests.unit.identification.test_tyres import DT, made, mirrored

STARTS = np.arange(200, 1900, 7)
N = round(0.5 / DT)


@cache
def learned(noise: float, sway: float, turn: float) -> tuple[Drive, Tyres, Residual]:
    """From a drive on which accelerations besides come and go over 20 s."""
    drive = made(seconds=60.0, noise=noise, sway=sway, turn=turn)
    tyres = identify_tyres(drive, VW_PASSAT)
    return drive, tyres, learn_residual(tyres, drive)


def errors(model: Any, drive: Drive) -> np.ndarray:
    """RMS of v_y and r half a second ahead of the starts."""
    tyres = model.tyres if isinstance(model, Residual) else model
    scene = tyres.scene(drive)
    miss = scene.motion[:, STARTS + N] - model.ahead(scene, STARTS, N)[:, -1]
    return np.asarray(np.sqrt(np.mean(miss**2, axis=1)))


def test_what_persists_is_learned_and_helps_on_another_drive() -> None:
    _, tyres, residual = learned(0.002, 0.4, 0.1)
    assert residual.share > 0.5
    assert max(residual.gain.values()) < 0.8
    other = made(seconds=40.0, seed=7, noise=0.002, sway=-0.3, turn=0.1)
    assert (errors(residual, other) < 0.95 * errors(tyres, other)).all()


def test_it_never_makes_a_drive_of_other_noise_worse() -> None:
    """With noise alone it may filter the starts: within a hundredth of no worse in both, better in one or no share."""
    for noise in (0.02, 0.1):
        _, tyres, residual = learned(noise, 0.0, 0.0)
        other = made(seconds=40.0, seed=8, noise=noise)
        ratio = errors(residual, other) / errors(tyres, other)
        assert (ratio <= 1.01).all()
        assert residual.share == 0.0 or ratio.min() < 1.0


def test_outside_its_data_it_fades_out() -> None:
    drive, tyres, residual = learned(0.002, 0.4, 0.1)
    scene = tyres.scene(drive)
    inside = residual.fade(scene, STARTS, missed(tyres, scene, STARTS))
    assert np.mean(inside == 1.0) > 0.95
    for factor in (5.0, 50.0):
        far = residual.fade(scene, STARTS, factor * missed(tyres, scene, STARTS))
        assert np.all(far <= inside)
    fast = scene._replace(v_x=scene.v_x + 200.0)
    assert residual.fade(fast, STARTS, missed(tyres, scene, STARTS)).max() < 0.01
    scene.motion[1, STARTS] += 30.0
    correction = residual.ahead(scene, STARTS, N) - tyres.ahead(scene, STARTS, N)
    assert np.abs(correction[:, -1]).max() < 0.2


def test_left_and_right_are_alike() -> None:
    drive, _, residual = learned(0.002, 0.4, 0.1)
    offset = residual.tyres.theta["offset"]
    theta = residual.tyres.theta | {"offset": -offset, "slip_zero": -residual.tyres.theta["slip_zero"]}
    other = replace(residual, tyres=replace(residual.tyres, theta=theta))
    way = residual.ahead(residual.tyres.scene(drive), STARTS, N)
    assert other.ahead(other.tyres.scene(mirrored(drive)), STARTS, N) == pytest.approx(-way, abs=1e-9)


def test_where_v_y_is_not_measured_only_the_yaw_rate_is_learned() -> None:
    drive = replace(made(seconds=60.0, noise=0.002, turn=0.2), v_y=None)
    tyres = identify_tyres(drive, VW_PASSAT)
    residual = learn_residual(tyres, drive)
    assert list(residual.gain) == ["r"]
    assert residual.gain["r"] < 0.9
    assert not missed(tyres, tyres.scene(drive), STARTS)[0].any()


def test_it_is_judged_beside_the_others() -> None:
    drive, tyres, residual = learned(0.002, 0.4, 0.1)
    theta = dict.fromkeys(("offset", "delay", "lag", "rate_zero"), 0.0) | {
        "steer_ratio": 15.6,
        "d_f": 0.006,
        "d_r": 0.005,
    }
    found: Any = SimpleNamespace(vehicle=VW_PASSAT, base=VW_PASSAT, theta=theta)
    answer = look_ahead(found, drive, tyres, residual)
    for quantity in ("v_y", "r", "lateral"):
        of = answer.errors[quantity]
        assert list(of) == ["model", "persistence", "kinematics", "pacejka", "pacejka + residual"]
        assert of["pacejka + residual"][1] < 0.8 * of["pacejka"][1] < of["persistence"][1]
    fewer = look_ahead(found, drive, tyres)
    assert "pacejka + residual" not in fewer.errors["r"]
    assert 0 <= fewer.starts - answer.starts <= round(MEMORY / DT)


def test_a_drive_that_is_too_short_is_refused() -> None:
    drive, tyres, _ = learned(0.002, 0.4, 0.1)
    with pytest.raises(ValueError, match="to learn a residual from, expected 8 s"):
        learn_residual(tyres, replace(drive, measured=drive.t > 53.0))
