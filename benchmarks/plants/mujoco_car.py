"""A car on four suspended wheels in MuJoCo, whose mechanics no one here wrote (extra `peers`)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram.block import State
from steerkit.plants.single_track import IntegratedCar
from steerkit.vehicles import VW_PASSAT, G, Vehicle

_HEIGHT, _RADIUS, _TRACK = 0.55, 0.31, 1.54  # m
_WHEEL, _SPRING, _DAMPER = 22.0, 28e3, 2600.0  # kg, N/m, N s/m
_ROLL, _PITCH = 0.22, 0.95  # moments of inertia about x and y, over that about z
_RELAXATION = 0.4  # m, of a tyre's slip
_SHAPE = 1.3  # of the Magic Formula
_FORWARD, _PEDALS = 2.0, 3.0  # 1/s, m/s^2: how fast, and with how much at most, it closes a gap in speed
_SLOWEST = 0.5  # m/s
_WHEELS = (("fl", 1, 1), ("fr", 1, -1), ("rl", 0, 1), ("rr", 0, -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class MujocoCar(IntegratedCar):
    """A free body on four wheels, each on a spring and a damper, and in contact with the ground: 12 degrees of freedom.

    The contact holds the load N of a wheel; MuJoCo's friction has neither a cornering stiffness nor a relaxation, so
    that it is frictionless, and a tyre's force is put to its contact point: with the wheel's own velocity (v_x, v_y),

        alpha' = v_x/sigma (-atan(v_y/v_x) - alpha),   F_y = mu N sin(1.3 atan(B alpha)),

    sigma = 0.4 m, B such that F_y/alpha of both wheels of an axle is the data sheet's at rest. The rear wheels push
    with m sat(2/s (v_cmd - v_x), +-3 m/s^2). The front wheels turn, both alike, by position actuators, to
    delta_sw_cmd/steer_ratio. a_y is the mean of v_y' + v_x r over the last sample.

    state: qpos (13) and qvel (12) of MuJoCo; the slips and the loads of the four tyres; psi as any turn, a_y and the
    last delta_sw. Interpreted floats only: it cannot be traced or batched. Valid on a plane, forwards, above 0.5 m/s. A
    NaN gives NaN. ImportError without mujoco. `substeps` at dt = 0.01 s: 5 at least.
    source: MuJoCo, XML reference; Pacejka 2012, section 1.2 and chapter 7 (relaxation).
    """

    pure = False  # MuJoCo computes

    vehicle: Vehicle = VW_PASSAT
    """Mass, yaw inertia, axles, tyres, friction and ratio."""
    substeps: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.dt / self.substeps <= 2.001e-3, "MujocoCar", f"substeps = {self.substeps}, of 2 ms at most each")

    @cached_property
    def _mujoco(self) -> "_Calculator":
        return _Calculator(self.vehicle, self.dt / self.substeps)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        require(not batch, "MujocoCar", "one car at a time: it cannot be batched")
        c, s = math.cos(0.5 * self.psi0), math.sin(0.5 * self.psi0)
        v_x, v_y = self.v0 * math.cos(self.psi0), self.v0 * math.sin(self.psi0)
        qpos, qvel = [self.x0, self.y0, _HEIGHT, c, 0.0, 0.0, s, *[0.0] * 6], [v_x, v_y, *[0.0] * 10]
        return tuple(float(q) for q in (*qpos, *qvel, *[0.0] * 4, *self._mujoco.at_rest, self.psi0, 0.0, 0.0))

    def output(self, t: Any, x: State, u: Any) -> Any:
        psi, a_y, delta_sw = x[-3:]
        v_x, v_y = _turned(x[13], x[14], psi)
        return self.Y(x[0], x[1], psi, math.hypot(v_x, v_y), math.atan2(v_y, v_x), x[18], a_y, delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        p = self.vehicle
        if not all(map(math.isfinite, (*x, u.delta_sw_cmd, u.v_cmd))):
            return (math.nan,) * len(x)
        delta_sw = min(max(u.delta_sw_cmd, -p.delta_sw_max), p.delta_sw_max)
        slips, loads = list(x[25:29]), list(x[29:33])
        motion = self._mujoco.after(x[:25], slips, loads, delta_sw / float(p.steer_ratio), u.v_cmd, self.substeps)
        q_w, q_x, q_y, q_z = motion[3:7]
        yaw = math.atan2(2.0 * (q_w * q_z + q_x * q_y), 1.0 - 2.0 * (q_y * q_y + q_z * q_z))
        psi = x[-3] + math.remainder(yaw - x[-3], math.tau)
        v_x, v_y = _turned(motion[13], motion[14], psi)
        _, before = _turned(x[13], x[14], x[-3])
        a_y = (v_y - before) / self.dt + v_x * 0.5 * (motion[18] + x[18])
        return (*motion, *slips, *loads, psi, a_y, delta_sw)


def _turned(x: float, y: float, psi: float) -> tuple[float, float]:
    """A vector of the ground, along and across the car."""
    c, s = math.cos(psi), math.sin(psi)
    return c * x + s * y, c * y - s * x


class _Tyre(NamedTuple):
    body: int
    geom: int
    front: bool
    stiffness: float
    """B [1/rad]."""


class _Calculator:
    """MuJoCo's model, and data that each call sets anew."""

    def __init__(self, vehicle: Vehicle, step: float):
        import mujoco

        p, self._mj, self._step = vehicle, mujoco, step
        self._model = mujoco.MjModel.from_xml_string(_xml(p, step))
        self._data = mujoco.MjData(self._model)
        self._mass, self._mu = float(p.m), float(p.mu)
        front, rear = (0.5 * float(p.m) * G * float(arm) / float(p.wheelbase) for arm in (p.l_r, p.l_f))
        self.at_rest = (front, front, rear, rear)
        self._tyres = []
        for (name, is_front, _), load in zip(_WHEELS, self.at_rest, strict=True):
            stiffness = 0.5 * float(p.c_f if is_front else p.c_r) / (_SHAPE * self._mu * load)
            body, geom = self._model.body(name).id, self._model.geom(name).id
            self._tyres.append(_Tyre(body, geom, bool(is_front), stiffness))
        self._wheel_of = {tyre.geom: number for number, tyre in enumerate(self._tyres)}

    def after(
        self, motion: Any, slips: list[float], loads: list[float], delta: float, v_cmd: float, steps: int
    ) -> tuple[float, ...]:
        """qpos and qvel after so many steps; the tyres' slips [rad] and loads [N] are brought up to date in place."""
        mj, model, data = self._mj, self._model, self._data
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion[:13], motion[13:]
        data.ctrl[:] = delta
        velocity, applied = np.zeros(6), data.xfrc_applied
        for _ in range(steps):
            mj.mj_step1(model, data)
            for number, tyre in enumerate(self._tyres):
                mj.mj_objectVelocity(model, data, mj.mjtObj.mjOBJ_BODY, tyre.body, velocity, 1)
                _, _, _, v_x, v_y, _ = velocity.tolist()
                v_x = max(v_x, _SLOWEST)
                kept = math.exp(-self._step * v_x / _RELAXATION)
                slips[number] = kept * slips[number] - (1.0 - kept) * math.atan(v_y / v_x)
                side = self._mu * loads[number] * math.sin(_SHAPE * math.atan(tyre.stiffness * slips[number]))
                a_x = min(max(_FORWARD * (v_cmd - v_x), -_PEDALS), _PEDALS)
                push = 0.0 if tyre.front else 0.5 * self._mass * a_x
                xx, xy, _, yx, yy, _, zx, zy, _ = data.xmat[tyre.body].tolist()
                x, y, z = push * xx + side * xy, push * yx + side * yy, push * zx + side * zy
                applied[tyre.body] = x, y, z, _RADIUS * y, -_RADIUS * x, 0.0
            mj.mj_step2(model, data)
            loads[:] = [0.0] * 4
            contact, forces = data.contact, data.efc_force.tolist()
            for pair, row in zip(contact.geom.tolist(), contact.efc_address.tolist(), strict=True):
                if row >= 0:  # without friction, a contact that pushes is one row
                    loads[self._wheel_of[max(pair)]] += forces[row]
        return (*data.qpos.tolist(), *data.qvel.tolist())


def _xml(p: Vehicle, step: float) -> str:
    """The car in MuJoCo's format, at rest on its springs; its centre of gravity is the body's origin."""
    l_f, l_r, m, i_z = (float(value) for value in (p.l_f, p.l_r, p.m, p.i_z))
    chassis = m - 4.0 * _WHEEL
    ahead = 2.0 * _WHEEL * (l_r - l_f) / chassis
    turn = i_z - 2.0 * _WHEEL * (l_f**2 + l_r**2 + 0.5 * _TRACK**2) - chassis * ahead**2
    wheels = ""
    for name, front, side in _WHEELS:
        load = 0.5 * m * G * (l_r if front else l_f) / (l_f + l_r) - _WHEEL * G
        hinge = f'<joint name="steer-{name}" axis="0 0 1" damping="150" armature="1"/>' if front else ""
        wheels += f"""
      <body name="{name}" pos="{l_f if front else -l_r} {0.5 * side * _TRACK} {_RADIUS - _HEIGHT}">
        <inertial pos="0 0 0" mass="{_WHEEL}" diaginertia="0.8 1.2 0.8"/>
        <joint type="slide" axis="0 0 1" stiffness="{_SPRING}" damping="{_DAMPER}" springref="{-load / _SPRING}"/>
        {hinge}
        <geom name="{name}" type="sphere" size="{_RADIUS}" condim="1"/>
      </body>"""
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast" gravity="0 0 {-G}"><flag warmstart="disable"/></option>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" condim="1" solref="0.01 1"/>
    <body name="car" pos="0 0 {_HEIGHT}">
      <freejoint/>
      <inertial pos="{ahead} 0 0" mass="{chassis}" diaginertia="{_ROLL * turn} {_PITCH * turn} {turn}"/>{wheels}
    </body>
  </worldbody>
  <actuator>
    <position joint="steer-fl" kp="20000"/>
    <position joint="steer-fr" kp="20000"/>
  </actuator>
</mujoco>"""
