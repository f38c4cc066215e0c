"""A process without dead time: recorded transitions in which what a car does is beside the command that it answers."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.delay_compensator import ANSWER, FELT, LONGEST, UNLIMITED, DelayCompensator
from steerkit.controllers.policy import COLUMNS, DOE, E_DOT, PSI_E, R_E, StateDescription, V
from steerkit.diagram.maths import Array
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.model import (
    CENTRED,
    KAPPA,
    LEAST_LOST,
    MOST_LOST,
    OFF_CENTRE,
    CarModel,
    angles_felt,
    course_share,
    explained,
    follow,
    speed,
    with_heading_of_yaw_rate,
)
from steerkit.task import DT

FEWEST = 12
"""Samples from which a dead time is looked for."""
REFINED = 30
"""Samples from which a model is refined."""
AS_GOOD = 1.02
"""A longer dead time is preferred to a shorter one that explains w better by less than this factor: the model's three
angles can stand for a sample of it, and the process that is learned is the simpler, the less of it is left."""
NOTHING = 1e-5
"""Turn in a sample that is as good as none [rad], for records without noise; above `scaled_from` by (v/v0)^2 less. A
fast car's angles are small: with 1e-5 at 15 m/s, the calmer a net drove, the longer the dead time that was found."""
PIECE = 200
"""Rows of the pieces in which it is asked whether the dead time has changed."""
CHANGED, DRIFTS = 0.4, 0.05
"""By how much the logarithm of what is left unexplained has to fall, summed over pieces, where there are two dead times
[1], and by how much more for each piece: noise, and steering that is no dead time and three angles, move it by that."""
MATTERS = 5e-4
"""Turn in a sample that is little [rad]: what changes less has not changed."""
GAINED = 300.0
"""Twice the log-likelihood by which two cars explain a record better than one, from which on they are two."""
AGREES = 1.15
"""A car found from where it was steered most, or before, stays while it foresees the newest rows as well as one found
from them, by this factor."""
SETTLED, STAYS = 1500, 1.05
"""From so many samples on (75 s), a car with overshoot or slew that was found before stays while it foresees the record
as well as one found anew, by that factor: calm driving tells little of a car."""
AHEAD = 10
"""Samples over which a model has to foresee the car."""
MOTOR = 0.2
"""What of the lateness of a record of others' driving is taken for lag [s], of motor and car: a dead time found too
long foresees what has not happened, one found too short is made up for by the model's three angles."""
ROWS = 3000
"""Newest samples from which it has to."""
LITTLE = 0.01
"""How firmly a fast car's loss*v^2 is taken to be little [rad]."""
OFFSET = 8.0
"""How much more evidence than CENTRED's samples a fast car's offset needs: its angles are small, and what steering by
torque leaves unexplained can look like one."""
TRUST, TRUST_COURSE = 0.25, 0.1
"""Share of what is seen in the filtered w and r_e (see `DelayCompensator`) and, of a fast car, in e and c where they
are noise (see `trust_in_course`)."""
TAKEN_BACK, CERTAIN = 0.05, 2.0
"""Correlation of what a model did not foresee of c with that of the sample before: noise if it is below that, negative,
by so many standard errors."""


LEADS = (0.3, 0.6, 1.2, 2.4)
"""Overshoots that a fast car's steering may show [1] ..."""
MOSTS = (3.0, 6.0, 12.0)
"""... their largest amounts [rad m^2/s^2]: by torque, about 0.15, 0.3 and 0.6 m/s^2 ..."""
FADES = (0.035, 0.07, 0.14)
"""... how fast they go [1]: in 1.4, 0.7 and 0.35 s ..."""
SLEWS = (2.0, 2.8, 4.0, 5.0, 6.3, 8.0, 12.0)
"""... and how far it turns in a sample [rad m^2/s^2]: by torque, 5 m/s^3 are about 6."""
BETTER = 0.95
"""They are believed where w is foreseen by that factor better with them."""


_CAR = (*ANSWER, *FELT, "straight")
"""What is known of a car from one update to the next, beside its dead time."""
_LEAST = (-np.inf, 0.0, 0.0, 0.0, -np.inf)
"""Of a fast car's `keep`, gains and constant."""


class Process(NamedTuple):
    """What a learner makes of its record: transitions without dead time, and how to act on a car that has some."""

    record: Transitions
    """Aligned transitions of the columns that a net sees, with doe counted from the angle of going straight on."""
    model: CarModel
    """The car of that record."""
    forecast: DelayCompensator


def process_of(
    record: Transitions, description: StateDescription, longest: float, before: DelayCompensator | None = None
) -> Process:
    """The process without dead time behind recorded transitions, and the dead time, up to `longest` [s].

    record: with the column kappa. One with speeds above the description's `scaled_from` is of a fast car (see `moved`).
    before: what was found before; a car with overshoot or slew stays while it foresees as well, so that nets which
    follow on each other are of one car: the record (STAYS), or of a longer one than ROWS, where noise is more than
    MATTERS, the newest half of those (AGREES). Of a car that has changed, what was recorded before is left out
    (`since_change`, `since_other_gain`).
    """
    fast = bool(record.s[:, V].max(initial=0.0) > description.scaled_from)
    record = with_heading_of_yaw_rate(record) if fast else record
    most = min(LONGEST, round(longest / DT))
    record = since_change(record, most)
    if record.own.any():  # of others' driving, one car is taken for granted: what they answer can look like a change
        newest = since_other_gain(record, dead_time_of(record, most, description.scaled_from))
        if len(newest) >= SETTLED or before is None or not before.feels:  # wander, too, looks like another gain
            record = newest
    if record.own.any() or len(_foreseeable(aligned(record, most))) < REFINED:

        def found(rows: Transitions, within: float) -> tuple[int, CarModel, bool]:
            """Dead time and car of some rows, and whether they are those of before and noise hides any others."""
            best = dead_time_of(rows, most, description.scaled_from, 0 if before is None else before.samples)
            part = aligned(rows, best)
            model = refined(CarModel.fit(part, description, fast=fast), part)
            model = overshooting(model, part, description, before) if fast else model
            if not fast or before is None or not before.feels or len(rows) < SETTLED:
                return best, model, False
            old = replace(model, **{name: getattr(before, name) for name in _CAR})
            error = strays_of(model, part)
            noisy = error > MATTERS
            if strays_of(old, aligned(rows, before.samples)) <= (within if noisy else STAYS) * error:
                return before.samples, old, noisy
            return best, model, False

        long = fast and len(record) > ROWS
        newest = record.part(slice(-ROWS // 2, None)) if long else record
        best, model, stays = found(newest, AGREES if long else STAYS)
        if long and not stays:  # what was steered most tells more, but is older: is it of the same car?
            of_most, car, _ = found(most_steered(record), STAYS)
            if strays_of(car, aligned(newest, of_most)) <= AGREES * strays_of(model, aligned(newest, best)):
                best, model = of_most, car
    else:
        best, part, model = _of_others(record, description, most, fast)
        model = overshooting(model, part, description, before) if fast else model
    part = aligned(record, best)
    numbers = {name: getattr(model, name) for name in _CAR}
    s, s_next = part.s[:, : len(COLUMNS)].copy(), part.s_next[:, : len(COLUMNS)].copy()
    s[:, DOE] -= model.straight
    s_next[:, DOE] -= model.straight
    process = Transitions(COLUMNS, s, part.a, s_next, part.episode, part.own)
    course = trust_in_course(model, process) if fast else 1.0
    return Process(process, model, DelayCompensator(samples=best, trust=TRUST, trust_course=course, **numbers))


def _of_others(
    record: Transitions, description: StateDescription, most: int, fast: bool
) -> tuple[int, Transitions, CarModel]:
    """Dead time [samples], aligned record and model where all was steered by others.

    A controller answers what it sees, a human steers smoothly: one sample's turn then shows its dead time falsely, or
    not. So each dead time's model has to foresee w over AHEAD samples; of those that are as good as the best, by
    AS_GOOD, it is the one nearest to `lateness` less MOTOR.
    """
    likely = (lateness(record) - MOTOR) / DT
    found = list[tuple[float, int, Transitions, CarModel]]()
    for samples in range(most + 1):
        part = aligned(record, samples)
        model = refined(CarModel.fit(part, description, fast=fast), part)
        found.append((strays_of(model, part), samples, part, model))
    least = min(error for error, *_ in found)
    good = [one for one in found if one[0] <= AS_GOOD * least + NOTHING]
    _, samples, part, model = min(good, key=lambda one: abs(one[1] - likely))
    return samples, part, model


def trust_in_course(model: CarModel, record: Transitions) -> float:
    """Share of the measured e and c in a forecast's: TRUST_COURSE where c is noisy, 1 where the model is what is wrong.

    The noise of a measurement is taken back a sample later, so that what comes otherwise than foreseen, y, has

        rho = E[y(k) y(k - 1)]/E[y^2] = -1/2,   0 or more where it is the car's doing (wind, wear in the steering),

    in n samples to within 1/sqrt(n). A net that drives at 1 mm else answers the last digit of a pose (1 mm, 1e-4 rad)
    with the wheel, at 1 to 10 Hz. Source: Muth 1960 (the local level model); Box, Jenkins 1970, section 4.3.
    """
    y = explained(model, record).residual[:, E_DOT] / speed(record.s_next)
    y, row = y - y.mean(), np.flatnonzero(follow(record))
    if len(row) < REFINED:
        return 1.0
    rho = float(np.mean(y[row] * y[row - 1]) / max(float(np.mean(y * y)), 1e-30))
    return TRUST_COURSE if rho < -TAKEN_BACK - CERTAIN / np.sqrt(len(row)) else 1.0


def since_change(record: Transitions, longest: int) -> Transitions:
    """The newest rows: those that agree on one dead time.

    A record in pieces of PIECE rows, n of them older and m newer, has changed between them where two dead times explain
    w better than one does, together by more than CHANGED (cost L):

        min_k L(all) - min_k L(older) - min_k L(newer) > CHANGED + DRIFTS min(n, m)
        L = sum over pieces of min(l(k), l(k - 1)),   l(k) = ln(what k leaves unexplained, RMS, + MATTERS)

    k - 1 counts too, as calm driving hardly tells one dead time from the next, and the shorter explains what the longer
    does. Pieces are added from the newest on, until this is so for one of their splits: the newest change. Source:
    Basseville, Nikiforov 1993, chapter 2 (generalised likelihood ratio).
    """
    ends, costs = list[int](), list[Array]()
    for end in range(len(record), 0, -PIECE):
        errors = np.array(unexplained(record.part(slice(max(0, end - PIECE), end)), longest))
        if len(errors) <= longest:
            continue
        cost = np.log(errors + MATTERS)
        ends.append(end)
        costs.append(np.minimum(cost, np.append(cost[0], cost[:-1])))
        newer = np.cumsum(costs, axis=0)
        older, count = newer[-1] - newer, np.arange(1, len(costs) + 1)
        gain = newer[-1].min() - newer.min(axis=1) - older.min(axis=1) - DRIFTS * np.minimum(count, count[::-1] - 1)
        if gain.max() > CHANGED:
            return record.part(slice(ends[int(gain.argmax()) + 1], None))
    return record


def since_other_gain(record: Transitions, samples: int) -> Transitions:
    """The newest rows: those that agree on how the car answers its wheel, with a dead time of `samples`.

    The newest 2, 4, 8, ... pieces of PIECE rows, N rows in all, are split in two. Least squares of the model of
    `unexplained`, in which a gain and `keep` grow with v^2, leave S of the squares with one set of weights, S_old and
    S_new with two. They are cut where N ln((S + L)/(S_old + S_new + L)) is largest, L = N MATTERS^2, if that is over
    GAINED. Source: as of `since_change`.
    """
    w, v2 = record.s[:, E_DOT] / speed(record.s) - record.s[:, PSI_E], record.s[:, V] ** 2
    doe, episode = record.s_next[:, DOE], np.cumsum(~follow(record))
    row = np.arange(samples + 2, len(record) - 1)
    row = row[episode[row - samples - 2] == episode[row + 1]][::-1]
    pieces = len(row) // PIECE
    if pieces < 2:
        return record
    row = row[: pieces * PIECE]
    angles = [doe[row - samples - i] for i in range(3)]
    x = np.column_stack((w[row], v2[row] * w[row], *angles, v2[row] * angles[0], np.ones(len(row)), w[row + 1]))
    x[:, :-1] /= np.abs(x[:, :-1]).max(axis=0).clip(1e-9)
    x = x.reshape(pieces, PIECE, -1)
    newer = np.cumsum(x.transpose(0, 2, 1) @ x, axis=0)
    for count in sorted({*(2**n for n in range(1, pieces.bit_length())), pieces}):
        whole = newer[count - 1]
        left = _left(newer[: count - 1]) + _left(whole - newer[: count - 1])
        little = count * PIECE * MATTERS**2
        gain = count * PIECE * np.log((_left(whole) + little) / (left + little))
        if gain.max() > GAINED:
            return record.part(slice(int(row[PIECE * (int(gain.argmax()) + 1) - 1]) - samples - 2, None))
    return record


def _left(squares: Array) -> Array:
    """What least squares leaves of the last column's squares, from the columns' products (..., n, n); a trace more."""
    some = squares + 1e-9 * np.trace(squares, axis1=-2, axis2=-1)[..., None, None] * np.eye(squares.shape[-1])
    return 1.0 / np.linalg.inv(some)[..., -1, -1]


def most_steered(record: Transitions) -> Transitions:
    """The newest ROWS/2 rows and, in pieces of PIECE rows, as many of those before in which the wheel is turned most.

    By v^2 d(doe)/dt, RMS. In calm driving the controller's answer to noise is most of what the wheel does, and the car
    that explains it best is not the car: after minutes without the first seconds, dead time and overshoot go astray.
    Source: Ljung 1999, section 13.4 (bias of closed-loop data, and the input's power against it).
    """
    if len(record) <= ROWS:
        return record
    newest = len(record) - ROWS // 2
    rows = np.arange(newest - newest % PIECE).reshape(-1, PIECE)  # from the first on, the same in every update
    turned = speed(record.s) ** 2 * (record.s_next[:, DOE] - record.s[:, DOE])
    most = np.argsort(-np.mean(turned[rows] ** 2, axis=1), kind="stable")[: ROWS // 2 // PIECE]
    row = np.concatenate((*rows[np.sort(most)], np.arange(newest, len(record))))
    episode = np.cumsum(~follow(record))[row]
    episode += len(record) * np.cumsum(np.diff(row, prepend=row[0]) > 1)
    part = record.part(row)
    return Transitions(part.names, part.s, part.a, part.s_next, episode, part.own)


def dead_time_of(record: Transitions, longest: int, scaled_from: float = np.inf, before: int = 0) -> int:
    """The dead time [samples], 0 to `longest`, that explains w, the course's angle to the car, best; 0 of too few rows.

    The longest of those that are as good as the best, by AS_GOOD and NOTHING. scaled_from: speed above which a record's
    car is fast, and `fast` in `unexplained` [m/s]. before: what was found before [samples]; where that is longer, a
    fast car's stays until it is twice as much worse.
    """
    share = min(1.0, scaled_from / float(speed(record.s).max(initial=1.0)))
    errors, nothing = unexplained(record, longest, fast=share < 1.0) or [0.0], NOTHING * share * share
    best = int(np.argmin(errors))
    while best + 1 < len(errors) and errors[best + 1] <= AS_GOOD * min(errors) + nothing:
        best += 1
    if share < 1.0 and best < before < len(errors) and errors[before] <= AS_GOOD**2 * min(errors) + nothing:
        return before
    return best


def lateness(record: Transitions) -> float:
    """By how much later than in the next sample w follows the wheel [s], dead time and lags together: late in

        w(k + 1) = (gain + loss v^2) (doe(k + 1) - late d(doe)/dt) + constant

    by least squares. Who steers smoothly shows this well, and hardly how much of it is dead time.
    """
    v, doe = speed(record.s_next), record.s_next[:, DOE]
    w = record.s_next[:, E_DOT] / v - record.s_next[:, PSI_E]
    x = np.column_stack((doe, v * v * doe, (doe - record.s[:, DOE]) / DT, np.ones(len(doe))))
    gain, loss, late, _ = np.linalg.lstsq(x, w, rcond=None)[0]
    return float(-late / max(abs(gain + loss * np.mean(v * v)), 1e-9))


def unexplained(record: Transitions, longest: int, *, fast: bool = False) -> list[float]:
    """What dead times of 0 to `longest` samples leave unexplained of w, the course's angle to the car, RMS [rad].

    Least squares of each dead time n, all on the same rows k, so that what they leave unexplained is compared:

        w(k + 1) = keep w(k) + sum_i gains_i doe(k - n - i) + constant,   i = 0, 1, 2, as in `CarModel`.

    The rows are those with enough samples of their episode before them. In a record too short for that only shorter
    ones are tried. fast: no gain is negative, as a car turns to where it is steered, and its yaw rate (its w) shows
    that at once. Gains of both signs foresee a calmly turned wheel from its past: then a dead time that is samples too
    long, or too short, explains w as well. Source: Ljung 1999, section 4.2 (ARX); Lawson, Hanson 1974, chapter 23.
    """
    w, episode = record.s[:, E_DOT] / speed(record.s) - record.s[:, PSI_E], np.cumsum(~follow(record))
    for most in range(longest, -1, -1):
        row = np.arange(most + 2, len(record) - 1)
        row = row[episode[row - most - 2] == episode[row + 1]]
        if len(row) >= FEWEST:
            break
    else:
        return []
    errors, doe = [], record.s_next[:, DOE]
    for n in range(most + 1):
        columns = np.column_stack((w[row], doe[row - n], doe[row - n - 1], doe[row - n - 2], np.ones(len(row))))
        coefficients, *_ = np.linalg.lstsq(columns, w[row + 1], rcond=None)
        if fast and (coefficients[1:4] < 0.0).any():
            from scipy.optimize import lsq_linear  # as `refined` does

            coefficients = lsq_linear(columns, w[row + 1], (_LEAST, np.inf), method="bvls").x
        errors.append(float(np.sqrt(np.mean((columns @ coefficients - w[row + 1]) ** 2))))
    return errors


def aligned(record: Transitions, samples: int) -> Transitions:
    """The transitions as they would be without `samples` of dead time.

    The output element's angle and the action of a sample are put beside the car's motion of `samples` later, which is
    the motion that the next angle begins to change. The last samples of each episode's angles have no such motion.
    """
    if samples == 0:
        return record
    episode = np.cumsum(~follow(record))
    row = np.arange(max(0, len(record) - samples))
    row = row[episode[row] == episode[row + samples]]
    s, s_next = record.s[row + samples].copy(), record.s_next[row + samples].copy()
    s[:, DOE], s_next[:, DOE] = record.s[row, DOE], record.s_next[row, DOE]
    return Transitions(record.names, s, record.a[row], s_next, record.episode[row], record.own[row])


def refined(model: CarModel, part: Transitions) -> CarModel:
    """The model that foresees w best over the next AHEAD samples, beginning from one of least squares.

    One sample's turn is mostly noise, and weights fitted to it let a long forecast stray; least squares over what the
    model makes of w by the wheel's angles alone, 1 to AHEAD samples after each row, do not. The yaw rate's answer is
    that of its change over AHEAD samples; a fast car's yaw rate is w, and the course's share is found so.
    Returns the model as it was where the record is too short, or where the other would turn the car the wrong way.
    Source: Ljung 1999, section 4.2 (output error).
    """
    from scipy.optimize import least_squares  # loads as slowly as all else that a drive needs

    row = _foreseeable(part)
    if len(row) < REFINED:
        return model
    s, v = part.s, speed(part.s)
    course = s[:, E_DOT] / v
    w = course - s[:, PSI_E]
    fast, fastest = model.fast > 0.0, float(v.max()) ** 2
    firmly = np.sqrt(AHEAD * CENTRED * (OFFSET if fast else 1.0))

    def strays(weights: Array) -> Array:
        errors = [foreseen - w[row + j + 1] for j, foreseen in enumerate(_foreseen(part, row, weights, fast))]
        believed = [firmly * weights[-1], *([LITTLE * weights[-2] * fastest] if fast else ())]
        return np.append(np.concatenate(errors), believed)

    bounds: tuple[Any, Any] = (-np.inf, np.inf)
    if fast:
        most = np.array([np.inf] * 4 + [MOST_LOST / fastest, np.inf])
        bounds = (np.array([0.0] * 3 + [-np.inf, LEAST_LOST / fastest, -np.inf]), most)
    scale = (1e-2, 1e-2, 1e-2, 1e-1, 1e-3, 1e-3)
    first = np.clip(_weights(model), *bounds)
    found = least_squares(strays, first, bounds=bounds, x_scale=scale, max_nfev=30)
    now, before, earlier, back, grown, constant = (float(value) for value in found.x)
    answer = {"now": now, "before": before, "earlier": earlier, "back": back}
    if fast:
        rises = _foreseen(part, row, found.x, fast)[-1] - w[row]
        turned = DT * np.add.reduce([0.5 * (s[row + j, R_E] + s[row + j + 1, R_E]) for j in range(AHEAD)])
        kept = course[row + AHEAD] - course[row] - turned
        answer["nose"], answer["tail"] = course_share(rises, kept, v[row])
        answer["loss"] = grown
    else:
        x = np.add.reduce([v[row + j] * (w[row + j + 1] - w[row + j]) for j in range(AHEAD)])
        r = s[:, R_E] + s[:, V] * s[:, KAPPA]
        answer |= {"slip": grown, "yaw": float(x @ (r[row + AHEAD] - r[row]) / (x @ x + 1e-9))}
    straight = float(np.clip(-constant / max(now + before + earlier, 1e-6), -OFF_CENTRE, OFF_CENTRE))
    other = replace(model, **answer, straight=straight)
    right = (other.ratio(np.array([v.min(), v.max()])) > 0.0).all() and 0.0 < other.yaw < 4.0 * abs(model.yaw)
    return other if right else model


def overshooting(
    model: CarModel, part: Transitions, description: StateDescription, before: DelayCompensator | None = None
) -> CarModel:
    """The model with the overshoot and the slew that foresee w best; itself, where they are not BETTER.

    before: what was found before, which stays unless others are BETTER.

    Slew and overshoot are looked for together among a few values, then the overshoot's time. Each is judged by what
    least squares leave unexplained of v^2 w over AHEAD samples, on what its car feels of the wheel:

        v^2 w(k + AHEAD) = keep v^2 w(k) + sum_i gains_i v^2 u(k - 1 + i) + stiff v^4 sum_i u(k + i) + constant
    """
    row = _foreseeable(part)
    if len(row) < 4 * REFINED:
        return model
    found = dict(lead=0.0, fade=FADES[1], most=UNLIMITED, slew=UNLIMITED)
    overshoots = [dict(lead=0.0), *(dict(lead=lead, most=most) for lead in LEADS for most in MOSTS)]
    both = [one | dict(slew=slew) for slew in (UNLIMITED, *SLEWS) for one in overshoots]
    for changes in (both, [dict(fade=fade) for fade in FADES]):
        cars = [found | change for change in changes]
        left = _left_by(cars, part, row)
        found = cars[int(left.argmin())]
    kept = before is not None and before.feels
    if kept:
        shape = {name: float(getattr(before, name)) for name in FELT}
        found = found if left.min() < BETTER * _left_by([shape], part, row)[0] else shape
    if found["lead"] == 0.0 and found["slew"] == UNLIMITED:
        return model
    other = replace(model, **found)
    angles = _as_felt(other, part)
    fitted = replace(refined(CarModel.fit(angles, description, fast=True), angles), **found)
    if not strays_of(fitted, part) < (1.0 if kept else BETTER) * strays_of(model, part):
        return model
    return replace(fitted, held=model.held, pushed=model.pushed)


def _as_felt(model: CarModel, part: Transitions) -> Transitions:
    """The record with the angles that the car feels in place of the wheel's."""
    felt = model.felt(part)
    if felt is None:
        return part
    s, s_next = part.s.copy(), part.s_next.copy()
    s[:, DOE], s_next[:, DOE] = felt.now, model.after(part.s, part.s_next[:, DOE], felt).now
    return Transitions(part.names, s, part.a, s_next, part.episode, part.own)


def _left_by(cars: Sequence[dict[str, float]], part: Transitions, row: NDArray[np.intp]) -> Array:
    """What each car's angles leave unexplained of v^2 w over AHEAD samples after each row (n,), RMS (cars,)."""
    v, car = speed(part.s), SimpleNamespace(**{name: np.array([one[name] for one in cars]) for name in FELT})
    w = v * v * (part.s[:, E_DOT] / v - part.s[:, PSI_E])
    left, y = [], w[row + AHEAD]
    for u in angles_felt(car, part)[0].T:
        angles = [v[row + j] ** 2 * u[row + j] for j in range(-1, AHEAD + 1)]
        stiff = v[row] ** 2 * np.add.reduce(angles)
        x = np.column_stack((w[row], *angles, stiff, np.ones(len(row))))
        weights = np.linalg.solve(x.T @ x + 1e-6 * np.eye(x.shape[1]), x.T @ y)
        left.append(float(np.sqrt(np.mean((x @ weights - y) ** 2))))
    return np.array(left)


def strays_of(model: CarModel, part: Transitions) -> float:
    """By how much w comes otherwise than a model foresees it, 1 to AHEAD samples ahead, RMS [rad]."""
    part = _as_felt(model, part)
    row, fast = _foreseeable(part), model.fast > 0.0
    w = part.s[:, E_DOT] / speed(part.s) - part.s[:, PSI_E]
    errors = [ahead - w[row + j + 1] for j, ahead in enumerate(_foreseen(part, row, _weights(model), fast))]
    return float(np.sqrt(np.mean(np.square(errors))))


def _foreseeable(part: Transitions) -> NDArray[np.intp]:
    """The newest ROWS rows that have a row before them and AHEAD after them in their episode."""
    episode = np.cumsum(~follow(part))
    row = np.arange(1, max(1, len(part) - AHEAD))
    return row[episode[row - 1] == episode[row + AHEAD]][-ROWS:]


def _weights(model: CarModel) -> tuple[float, ...]:
    """The weights of `_foreseen`."""
    total = model.now + model.before + model.earlier
    grown = model.loss if model.fast else model.slip
    return model.now, model.before, model.earlier, model.back, grown, -model.straight * total


def _foreseen(part: Transitions, row: NDArray[np.intp], weights: Sequence[float] | Array, fast: bool) -> list[Array]:
    """What w becomes 1 to AHEAD samples after each row (n,), by the wheel's angles alone."""
    now, before, earlier, back, grown, constant = weights
    slip, loss = (0.0, grown) if fast else (grown, 0.0)
    v, doe = speed(part.s), part.s[:, DOE]
    w, ahead = part.s[row, E_DOT] / v[row] - part.s[row, PSI_E], []
    for j in range(AHEAD):
        at = row + j
        turn = now * doe[at + 1] + before * doe[at] + earlier * doe[at - 1] + constant
        w = w + turn / (1.0 + loss * v[at] ** 2) - (back + slip * v[at] ** 2) * w
        ahead.append(w)
    return ahead
