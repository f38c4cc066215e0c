"""Cars out: a vehicle's numbers as other programs write them, a CommonRoad parameter set and a row like opendbc's."""

from steerkit._support.errors import require
from steerkit.vehicles import G, Vehicle


def commonroad(car: Vehicle) -> str:
    """The parameter set of CommonRoad's vehicle models (YAML), its single track and kinematic ones.

    C = c_f L/(mu m g l_r) at the front and c_r L/(mu m g l_f) at the rear; CommonRoad has one C for both axles,
    -p_ky1/p_dy1, so their mean stands there, and a comment says both. What no vehicle file knows, such as length and
    width, is left out: take it from a set of CommonRoad's. Raises ValueError for a batch of cars.
    """
    m, l_f, l_r, c_f, c_r, mu, ratio = _one(car)
    front, rear = (c * (l_f + l_r) / (mu * m * G * share) for c, share in ((c_f, l_r), (c_r, l_f)))
    stop = float(car.delta_sw_max) / ratio
    rows = [
        f"# {car.name}, written by steerkit",
        f"# cornering stiffness coefficients [1/rad]: front {front:.6g}, rear {rear:.6g}; CommonRoad has their mean",
        f"a: {l_f!r}  # centre of gravity to front axle [m]",
        f"b: {l_r!r}  # to rear axle [m]",
        f"m: {m!r}  # [kg]",
        f"I_z: {float(car.i_z)!r}  # [kg m^2]",
        "steering:",
        f"  min: {-stop!r}  # road wheels [rad]",
        f"  max: {stop!r}",
        "tire:",
        f"  p_dy1: {mu!r}  # friction [1]",
        f"  p_ky1: {-mu * 0.5 * (front + rear)!r}  # -mu times the mean coefficient [1/rad]",
    ]
    return "\n".join([*rows, ""])


def opendbc(car: Vehicle, *, delay: float | None = None) -> dict[str, float | str]:
    """The car as opendbc's CarParams name it, to be written as JSON.

    delay: of the steering [s], lag included, as its `steerActuatorDelay` is meant; left out where it is not known.
    """
    m, l_f, l_r, c_f, c_r, _, ratio = _one(car)
    row: dict[str, float | str] = {
        "carFingerprint": car.name,
        "mass": m,
        "wheelbase": l_f + l_r,
        "centerToFront": l_f,
        "steerRatio": ratio,
        "rotationalInertia": float(car.i_z),
        "tireStiffnessFront": c_f,
        "tireStiffnessRear": c_r,
    }
    return row if delay is None else {**row, "steerActuatorDelay": delay}


def _one(car: Vehicle) -> tuple[float, ...]:
    numbers = (car.m, car.l_f, car.l_r, car.c_f, car.c_r, car.mu, car.steer_ratio)
    require(all(not getattr(x, "shape", ()) for x in numbers), "export", f"'{car.name}' is a batch of cars; take one")
    return tuple(float(x) for x in numbers)
