"""The cars' common equations: symmetries, where and whereto, batches, stops, NaN, teaching errors."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.diagram.units import radians_of
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.vehicles import VW_PASSAT
from tests.support.stepped import run

CARS = pytest.mark.parametrize("cls", [LinearSingleTrack, NonlinearSingleTrack])


steering = st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(0.0, 12.0)), min_size=5, max_size=40)


@CARS
@settings(max_examples=25)
@given(inputs=steering)
def test_mirror_symmetry(cls, inputs):
    car = cls(vehicle=VW_PASSAT)
    left = run(car, inputs)[0][-1]
    right = run(car, [(-delta, v) for delta, v in inputs])[0][-1]
    mirrored = (right.x, -right.y, -right.psi, right.v, -right.beta, -right.r, -right.a_y, -right.delta_sw)
    assert left == pytest.approx(mirrored, rel=1e-12, abs=1e-12)


@CARS
@settings(max_examples=25)
@given(inputs=steering, x0=st.floats(-50, 50), y0=st.floats(-50, 50), psi0=st.floats(-7, 7))
def test_where_and_whereto_do_not_matter(cls, inputs, x0, y0, psi0):
    here = run(cls(vehicle=VW_PASSAT), inputs)[0][-1]
    there = run(cls(vehicle=VW_PASSAT, x0=x0, y0=y0, psi0=psi0), inputs)[0][-1]
    c, s = math.cos(psi0), math.sin(psi0)
    moved = here._replace(x=x0 + c * here.x - s * here.y, y=y0 + s * here.x + c * here.y, psi=psi0 + here.psi)
    assert there == pytest.approx(moved, rel=1e-9, abs=1e-9)


@CARS
def test_outputs_belong_to_the_inputs_last_applied(cls):
    ys, _ = run(cls(vehicle=VW_PASSAT, v0=2.0), [(1.0, 5.0), (2.0, 6.0), (3.0, 7.0)])
    assert [y.delta_sw for y in ys] == [0.0, 1.0, 2.0]
    assert [y.v for y in ys] == pytest.approx([2.0, 5.0, 6.0], rel=1e-3)


@CARS
def test_the_wheel_has_a_stop(cls):
    ys, _ = run(cls(vehicle=VW_PASSAT), [(99.0, 5.0), (-99.0, 5.0), (0.0, 5.0)])
    assert [y.delta_sw for y in ys] == [0.0, radians_of(520.0), -radians_of(520.0)]


@CARS
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(vehicle="vw-passat"), r"expected a Vehicle; by name or from a file: vehicle\('vw-passat'\)"),
        (dict(dt=0.1), r"dt = 0.1 \[s\], expected .*raise substeps"),
    ],
)
def test_teaching_errors_of_cars(cls, change, message):
    with pytest.raises(ValueError, match=f"{cls.__name__}: .*{message}"):
        cls(**{"vehicle": VW_PASSAT, **change})
    assert cls(vehicle=VW_PASSAT, dt=0.05, substeps=5).dt == 0.05


@CARS
@pytest.mark.parametrize(("sway", "v"), [(0.0, 5.0), (0.4, 6.0), (-0.3, 2.0)])
def test_v_and_beta_are_length_and_direction_of_the_velocity(cls, sway, v):
    car = cls(vehicle=VW_PASSAT)
    x = car.init()._replace(psi=0.7, sway=sway, v=v, r=0.2)
    dx, dy, *_ = car.rhs(x[:5], 0.0, v)
    y = car.output(0.0, x, ())
    assert (y.v * math.cos(y.psi + y.beta), y.v * math.sin(y.psi + y.beta)) == pytest.approx((dx, dy), abs=1e-12)
