"""Pictures that explain a learning run: what it values, what it would do, where it failed.

`draw_all` draws the set of a run directory. How to read them: docs/learning.md.
"""

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy, mean_of
from steerkit.controllers.policy import DOE, PSI_E, E, V
from steerkit.diagram.maths import Array
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.learning import rundir
from steerkit.learning.data.distance import REACH, Distance, states_of
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.learner_state import Episode
from steerkit.learning.nfq.iterate import patterns
from steerkit.learning.nfq.rprop import forward
from steerkit.paths.path import Path
from steerkit.plots.animation import animate, film_writer
from steerkit.plots.drive import round_driven
from steerkit.plots.style import COLOURS, new_figure, styled
from steerkit.scenario import Scenario
from steerkit.task import TRIP

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def q_values(policy: NfqPolicy, s: Array) -> Array:
    """Each net's value of each action (nets, actions, n) for the states s (n, columns); actions in rising order.

    In doubles: in singles the last digits, and so the contours, are another machine's.
    """
    require(bool(policy.nets), "diagnostics", "the policy has no nets, expected at least one; let it learn first")
    d, scale = policy.description, policy.description.scale_of(policy.actions)
    inputs = [patterns(d, s, np.full(len(s), a), scale) for a in sorted(policy.actions)]
    nets = [tuple([part.astype(float) for part in net]) for net in policy.nets or ()]
    return np.array([[forward(net, x) for x in inputs] for net in nets])


def course_angle(scenario: Scenario, doe: Any) -> Any:
    """Angle [rad] between the car's axis and the way its reference point goes, wheel at `doe` [rad], without slip.

        tan(course) = b/L tan(delta),  b: from the rear axle to the reference point, L: wheelbase

    A car that holds the path through a steady bend has psi_e = -course: at the front axle -delta itself.
    """
    car = scenario.nominal
    return np.arctan((car.l_r + scenario.ahead) / car.wheelbase * np.tan(np.asarray(doe) / car.steer_ratio))


def states(
    scenario: Scenario, names: Sequence[str], n: int, *, v: Any, doe: Any = 0.0, psi: Any = 0.0, **more: Any
) -> Array:
    """States (n, columns) that a car can be in: v [m/s], wheel at doe [rad], heading psi [rad] off the steady bend's.

        psi_e = psi - course,  e_dot = v/cos(course) sin(psi),  e = r_e = 0, unless `more` says otherwise

    Each a number or (n,). Nets are only good where cars have been: a heading error without its e_dot is no such place.
    """
    course = course_angle(scenario, doe)
    columns = {"v": v, "doe": doe, "psi_e": psi - course, "e_dot": v / np.cos(course) * np.sin(psi)} | more
    return np.stack([np.broadcast_to(columns.get(name, 0.0), n) for name in names], axis=1).astype(float)


@styled
def policy_map(
    policy: NfqPolicy,
    scenario: Scenario,
    *,
    visited: Transitions | None = None,
    v: float = 6.0,
    doe_deg: Sequence[float] = (-120.0, 0.0, 120.0),
    title: str = "",
) -> "Figure":
    """The greedy action and its value over (e, psi_e) at speed v [m/s], for several angles of the steering wheel.

    Headings count from psi_0, that of a car which holds the path through the bend of that angle. Dots: the visited
    states within 0.75 m/s and 40 degrees of the wheel; elsewhere the net is guessing.
    """
    n = 161
    names, actions = policy.description.names, sorted(policy.actions)
    e, psi = np.linspace(-TRIP, TRIP, n), np.linspace(-radians_of(10.0), radians_of(10.0), n)
    over = {"e": np.tile(e, n), "psi": np.repeat(psi, n), "v": v}
    q = [mean_of(q_values(policy, states(scenario, names, n * n, doe=radians_of(doe), **over))) for doe in doe_deg]
    colours = _action_colours(actions)
    shades = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in colours], dtype=np.uint8)
    look: dict[str, Any] = {"extent": (-TRIP, TRIP, -10.0, 10.0), "origin": "lower", "aspect": "auto"}
    top = max(float(values.min(axis=0).max()) for values in q)
    title = f"{title or 'NfqPolicy'}: what the net does at {v:.1f} m/s"
    figure, (only,) = new_figure(title=title, width=10.5, height=6.8)
    figure.delaxes(only)
    axes = figure.subplots(2, len(q), squeeze=False, sharey=True)
    seen = dict(zip(names, (visited or Transitions(names)).s.T))
    for (above, below), doe, values in zip(axes.T, doe_deg, q):
        course = course_angle(scenario, radians_of(doe))
        value = values.min(axis=0).reshape(n, n)
        above.imshow(shades[values.argmin(axis=0).reshape(n, n)], **look)
        picture = below.imshow(value, cmap="viridis", vmin=0.0, vmax=top, **look)
        below.contour(e, degrees_of(psi), value, levels=8, colors="white", linewidths=0.5, alpha=0.6)
        near = (np.abs(seen["v"] - v) < 0.75) & (np.abs(seen["doe"] - radians_of(doe)) < radians_of(40.0))
        heading = degrees_of(seen["psi_e"][near] + course_angle(scenario, seen["doe"][near]))
        for axis, colour in ((above, COLOURS["ink"]), (below, COLOURS["paper"])):
            axis.plot(seen["e"][near], heading, ".", ms=2.2, mew=0, color=colour, alpha=0.6)
            axis.grid(False)
            axis.axvline(0.0, color=colour, lw=0.5, alpha=0.6)
            axis.axhline(0.0, color=colour, lw=0.5, alpha=0.6)
            axis.set(xlim=(-TRIP, TRIP), ylim=(-10.0, 10.0))
        above.tick_params(labelbottom=False)
        above.set_title(f"wheel at {doe:+.0f}°, psi_0 = {degrees_of(-course):+.1f}°" if doe else "wheel straight")
        below.set_xlabel("e [m], + = left")
    for row in axes:
        row[0].set_ylabel("psi_e - psi_0 [deg], + = left")
    for action, colour in zip(actions, colours):
        axes[0, 0].plot([], [], "s", ms=7, color=colour, label=f"{degrees_of(action):+.0f}°" if action else "hold, 0°")
    figure.legend(loc="outside lower center", ncols=len(actions), frameon=False)
    figure.colorbar(picture, ax=list(axes.flat), label="expected cost to go", aspect=40, pad=0.01)
    return figure


def _action_colours(actions: Sequence[float]) -> list[str]:
    """Blue to the right, orange to the left, the stronger the darker; grey for none."""

    def shades(scale: Sequence[str], count: int) -> list[str]:
        return [scale[round(2 * k / max(1, count - 1))] for k in range(count)]

    right = shades(("#0b3c5d", "#2f7fb5", "#9cc9e3"), sum(a < 0.0 for a in actions))
    left = shades(("#8a3b06", "#d9772b", "#f2c39b"), sum(a > 0.0 for a in actions))
    return [*right, *(["#b4bcc4"] * (0.0 in actions)), *left[::-1]]


_PAIRS = (((V, "v [m/s]"), (DOE, "wheel [deg]")), ((E, "e [m]"), (PSI_E, "psi_e [deg]")))


@styled
def beside_the_data(record: Transitions, log: Log, apart: Distance, *, title: str) -> "Figure":
    """Recorded states (grey), a drive's by their distance from them, and that distance over time."""
    figure, (only,) = new_figure(title=title, width=10.5, height=3.6)
    figure.delaxes(only)
    left, middle, right = figure.subplots(1, 3)
    s = states_of(log, "beside_the_data")
    for axis, ((i, x_label), (j, y_label)) in zip((left, middle), _PAIRS):
        axis.plot(record.s[:, i], degrees_of(record.s[:, j]), ".", ms=2.0, mew=0, color=COLOURS["muted"], alpha=0.5)
        order = np.argsort(apart.d)
        look: dict[str, Any] = {"s": 3, "lw": 0, "cmap": "viridis", "vmin": 0.0, "vmax": 2.0 * REACH}
        dots = axis.scatter(s[order, i], degrees_of(s[order, j]), c=apart.d[order], **look)
        axis.set(xlabel=x_label, ylabel=y_label)
    figure.colorbar(dots, ax=middle, label="distance [1]")
    right.plot(log.t, apart.d, color=COLOURS["learned"], lw=0.9)
    right.axhline(REACH, color=COLOURS["limit"], lw=0.8, ls="--")
    right.set(xlabel="t [s]", ylabel=f"distance from the data [1]; {REACH:g}: as far as nets learned", ylim=(0.0, None))
    return figure


def ended(episode: Episode, log: Log) -> float:
    """Driving time at which an episode ended, or the log's end [s]."""
    return float(log.t[-1]) if episode.ended is None else episode.ended


def failed_at(episodes: Sequence[Episode], log: Log) -> NDArray[np.intp]:
    """Samples of a run's log at which the recovery controller took over."""
    times = [episode.ended for episode in episodes if episode.failed]
    return np.minimum(np.searchsorted(log.t, np.array(times, dtype=float) - 1e-6), len(log.t) - 1)


def replay(episodes: Sequence[Episode], log: Log, number: int, *, name: str) -> "Figure":
    """Episode `number` (from 1) of the run `name`: on the map, e, wheel and lateral acceleration."""
    episode = episodes[number - 1]
    began, end = episode.began, ended(episode, log)
    part = (log.t >= began - 1e-6) & (log.t <= end + 1e-6)
    ending = "failed" if episode.failed else "still driving"
    title = f"{name}: episode {number}, {ending} after {end - began:.1f} s, {episode.distance:.0f} m"
    shown = Log(log.t[part], {name: values[part] for name, values in log.items()}, log.units)
    return round_driven(shown, title=title)


def draw_all(place: str | FilePath, out: str | FilePath | None = None) -> list[FilePath]:
    """Draw the diagnostics of a run directory as PNG files in `out` (default: `diagnostics` in it); returns them.

    Replays: the longest episode, and the last that failed. Raises ValueError for a directory that holds no whole run.
    """
    run = rundir.load(FilePath(place))
    log, episodes, visited = rundir.drive_log(FilePath(place), until=run.t), run.counts.episodes, run.transitions
    folder = FilePath(place) / "diagnostics" if out is None else FilePath(out)
    folder.mkdir(parents=True, exist_ok=True)
    scenario, speeds = run.experiment.scenario, visited.s[:, V]
    name = f"{FilePath(place).resolve().name}: {run.experiment.setting.name} on {scenario.course.name}"
    v = float(np.median(speeds)) if len(speeds) else 6.0
    policy = rundir.final_policy(FilePath(place), run.counts.updates)
    files = [folder / "policy-map.png"]
    policy_map(policy, scenario, visited=visited, v=v, title=name).savefig(files[0])
    lengths = [ended(episode, log) - episode.began for episode in episodes]
    failed = [k for k, episode in enumerate(episodes, start=1) if episode.failed]
    for number in sorted({*([int(np.argmax(lengths)) + 1] if lengths else []), *failed[-1:]}):
        files.append(folder / f"episode-{number}.png")
        replay(episodes, log, number, name=name).savefig(files[-1])
    return files


def film_of(place: str | FilePath, file: str | FilePath, *, lasts: float = 20.0, fps: float = 8.0) -> FilePath:
    """Write the film of a run directory to `file`, .gif or .mp4: to its first whole round, or to the run's end.

    The beginning, until the learner has the wheel again after its first failure, runs in real time; all after it as
    fast as the film's length needs. lasts: how long it is [s], 2 to 120. fps: pictures a second, 1 to 60.
    Returns the file. Raises ValueError for another ending, length or rate, and for what is no run directory.
    """
    film_writer(file)
    require(2.0 <= lasts <= 120.0, "film", f"lasts = {lasts} s, expected 2 to 120")
    run = rundir.load(FilePath(place))
    log, done = rundir.drive_log(FilePath(place), until=run.t), run.counts.first_round_done
    require(len(log.t) >= 2, "film", f"{place}: nothing has been driven yet")
    until = float(log.t[-1] if done is None else min(done, log.t[-1]))
    moments = moments_of(run.counts.episodes, log, until, lasts, fps)
    car = run.experiment.scenario.nominal
    return animate(with_heading(run.path, log), run.path, file, vehicle=car, fps=fps, moments=moments)


def with_heading(path: Path, log: Log) -> Log:
    """A run's signals, and the car's heading, which it does not record."""
    psi = path.psi(log["path.s"]) + log["path.psi_e"]
    return Log(log.t, {**log.signals, "car.psi": psi}, {**log.units, "car.psi": "rad"})


def moments_of(episodes: Sequence[Episode], log: Log, until: float, lasts: float, fps: float) -> Array:
    """Driving time of each picture [s]: the beginning in real time, if that takes up to half the film; else evenly."""
    t, failed = log.t, failed_at(episodes, log)
    again = t[(log["supervisor.learning"] > 0.5) & (t > t[failed[0]])] if len(failed) else t[:0]
    begin = min(until, (float(again[0]) if len(again) else 0.0) + 4.0)
    first = np.arange(0.0, begin, max(1.0, begin / (0.5 * lasts)) / fps)
    return np.concatenate((first, np.linspace(begin, until, max(2, round(lasts * fps) - len(first)))))
