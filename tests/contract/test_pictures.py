"""Every picture shows what it showed: sizes, colours, limits, texts and data, summarised in tests/golden/pictures.json.

Whoever changes a picture on purpose renews the file by `python -m tests.contract.test_pictures`, and looks at it.
"""

import contextlib
import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import matplotlib.style
import numpy as np
import pytest
from matplotlib.collections import Collection
from matplotlib.patches import Patch

from steerkit.cli.log import contents, picture
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import Log, simulate
from steerkit.gym.vector_env import Painter
from steerkit.identification.fit import Identified, Prediction
from steerkit.learning import pictures
from steerkit.learning.data.distance import Distance, states_of
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import Experiment
from steerkit.learning.learner_state import Episode
from steerkit.learning.nfq.rprop import new_net
from steerkit.logs import RawLog
from steerkit.logs.channels import Channel, ColumnMap
from steerkit.logs.drive import Drive
from steerkit.logs.resimulate import Resimulated, compared
from steerkit.plots import animation, diagram, drive, style
from steerkit.scenario import Scenario
from steerkit.scenario.drive import Sweep
from tests.support.diagrams import LOOPS, small
from tests.support.places import ROOT
from tests.support.straight_road import PASSAT

GOLDEN = ROOT / "tests/golden/pictures.json"
LOOK = """text color facecolor edgecolor linewidth linestyle marker markersize markeredgewidth drawstyle zorder alpha
fontsize fontweight ha va sizes cmap frame_on"""
DATA = "xydata position offsets xy extent clim array bbox_to_anchor"
PANEL = "xlabel ylabel title xscale yscale facecolor xticks yticks"
WAVES = """car.x car.y car.psi car.delta_sw car.a_y path.e path.psi_e path.kappa supervisor.learning supervisor.delta_sw
controller.action"""
T = 0.05 * np.arange(600.0)
SIGNALS = {name: (0.4 + 0.1 * k) * np.sin((0.3 + 0.1 * k) * T + k) for k, name in enumerate(WAVES.split())}
SIGNALS |= {"car.v": 5.0 + 0.05 * T, "path.s": 5.0 * T, "path.progress": 5.0 * T}
LOG, SCENARIO, SEEN = Log(T, SIGNALS, dict.fromkeys(SIGNALS, "m")), Scenario(course="circle"), Transitions()
STATES = np.sin(np.outer(np.arange(1.0, 60.0), 0.3 + np.arange(6.0))) * [0.5, 1.0, 1.0, 0.2, 0.3, 4.0]
SEEN.extend(STATES + np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0]), STATES[:, 0], STATES, 0)
NFQ, PATH = NfqPolicy(nets=(new_net((7, 5, 1), seed=1), new_net((7, 5, 1), seed=2))), SCENARIO.path()
EPISODES = tuple(
    Episode(began=a, progress=5.0 * a, net=1, ended=b, failed=b is not None, distance=30.0)
    for a, b in ((0.0, 3.2), (4.1, 11.7), (13.3, None))
)
DRIVE = Drive(name="a", dt=0.05, delta_sw=T, v=3.0 + T % 7.0, r=0.2 * np.sin(T), measured=T > 5.0, calibrated=True)
ERRORS = ("rms", "rms_driving", "mean_driving", "rms_rezeroed", "zero_shift")
PREDICTED = Prediction(drive=DRIVE, r=0.3 * np.sin(T + 0.1), **dict(zip(ERRORS, 0.01 * np.arange(1.0, 6.0))))
FITTED: dict[str, Any] = {"vehicle": PASSAT, "base": PASSAT, "drive": DRIVE, "estimates": (), "theta": {}, "free": ()}
FOUND = Identified(**FITTED, fit=replace(PREDICTED, r=1.1 * DRIVE.r), covariance=np.eye(1), correlation_time=1.0)
STEERED = {"actuator.delta_sw": np.sin(T), "path.e": 0.1 * T, "car.a_y": 2.0 * np.cos(T)}
AGAIN = Resimulated(
    **dict.fromkeys(("name", "controller"), "a"),
    **dict(vehicle=PASSAT, v=DRIVE.v, path=PATH, log=Log(T, STEERED, {}), compared=T > 5.0),
    **dict(driven=0.3 * np.sin(T + 0.1), a_y_driven=3.0 * np.sin(T)),
)


def painted() -> Any:
    """A frame of the gym's."""
    loop = SimpleNamespace(blocks={"car": None})
    painter: Any = Painter(SimpleNamespace(dt=0.05, limit=0.5, path=PATH, loop=loop))  # type: ignore[arg-type]
    for k in range(250):
        painter.add({"t": T[k], **{key: LOG[f"car.{key}"][k] for key in ("x", "y", "psi")}, "e": LOG["path.e"][k]})
    painter.frame()
    return painter._scene


def seen(scene: Any, show: Callable[..., Any], *at: float) -> Any:
    """The scene at a moment."""
    show(scene, *at)
    return scene


def told() -> Any:
    """The picture of a log of ten channels, the last of which is a drive's."""
    named = [Channel(name=f"c{k}", t=T, values=np.sin(T + k), unit="m" * (k % 2)) for k in range(9)]
    of = RawLog(
        name="a",
        where="a",
        channels={c.name: c for c in [*named, Channel(name="v", t=T, values=T)]},
        notes=(),
        digest="",
    )
    rows, *_ = contents(of, ColumnMap({}))
    return picture(of, rows)


OWN = Log(T, SIGNALS | dict.fromkeys(("path.e_dot", "path.r_e", "doe.state"), 0.1 * np.cos(T)), {})
APART = Distance.of(states_of(OWN, "a"), SEEN, Experiment().setting.description())
SCENE = (animation.Moments.of_log(LOG), PATH, 2.7, 1.2, 15.0, 18.0)
PICTURES: dict[str, Callable[[], Any]] = {
    **{
        f"diagram {name}": lambda make=make: diagram.plot_diagram(make())
        for name, make in LOOPS.items()
        if name != "sensors"
    },
    "log": lambda: diagram.plot_log(simulate(small(), 1.0, batch=7), ["wave.v", "gain.y", "angle.angle"]),
    "figure": lambda: style.new_figure(2, map_beside=True, title="a")[0],
    "course": lambda: drive.plot_course(PATH),
    "trace": lambda: drive.trace(LOG, title="a", seconds=10.0),
    "learning": lambda: drive.learning(LOG, title="a"),
    "learning's begin": lambda: drive.learning(LOG, title="a", seconds=10.0),
    "first round": lambda: drive.first_round(LOG, began=1.0, done=20.0, title="a"),
    "round": lambda: drive.round_driven(LOG, LOG, title="a"),
    "rounds": lambda: drive.rounds_driven({"a": LOG, "b": LOG}, title="a"),
    "scene": lambda: seen(animation.Scene(*SCENE), animation.Scene.show, 9.0, 2.0).figure,
    "frame": lambda: painted().figure,
    "map": lambda: pictures.policy_map(NFQ, SCENARIO, visited=SEEN),
    "log's channels": told,
    "resimulated": lambda: compared(AGAIN),
    "identified": lambda: FOUND.plot(PREDICTED),
    "data": lambda: pictures.beside_the_data(SEEN, OWN, APART, title="a"),
    "sweep": lambda: Sweep({"k": T}, {"k": T, "rms_e": np.sin(T), "of mine": T}).plot(),
    "sweep of two": lambda: Sweep({"k": T[:20], "m": T[:30]}, {"rms_e": T}).plot(),
    "fit": lambda: FOUND.plot(),
    "replay": lambda: pictures.replay(EPISODES, LOG, 2, name="run"),
    "replay of the last": lambda: pictures.replay(EPISODES, LOG, 3, name="run"),
}


def words(thing: Any, names: str) -> str:
    """Its type, and what its getters of these names return, numbers with five digits."""
    said = [type(thing).__name__]
    for name in names.split():
        value = None
        with contextlib.suppress(AttributeError, TypeError, ValueError):
            value = getattr(thing, f"get_{name}")()
            value = " ".join(f"{x:.5g}" for x in np.ravel(np.asarray(value, dtype=float)))
        if str(value) not in ("nan", "None", "default"):
            said.append(f"{name}={getattr(value, 'name', value)}")
    return ", ".join(said)


def numbers(thing: Any) -> list[float]:
    """Of its data: count, smallest, largest, mean, and a mean that knows their order."""
    found = [getattr(thing, f"get_{name}")() for name in DATA.split() if hasattr(thing, f"get_{name}")]
    if isinstance(thing, Patch):
        found = [thing.get_patch_transform().transform_path(thing.get_path()).vertices]
    found += [path.vertices for path in thing.get_paths()] if isinstance(thing, Collection) else []
    x = np.concatenate([np.ravel(np.ma.filled(np.ma.asarray(a, dtype=float), 0.0)) for a in found if a is not None])
    x = np.nan_to_num(x, nan=-7.0)
    return [len(x), x.min(), x.max(), x.mean(), np.mean(np.linspace(0.0, 1.0, len(x)) * x)] if len(x) else []


@matplotlib.style.context("default")
def summary(draw: Callable[[], Any]) -> dict[str, list[float]]:
    """Of the figure drawn, its panels and all artists that look alike: words, and numbers."""
    figure = draw()
    found: dict[str, list[float]] = {"figure": [*figure.get_size_inches(), figure.dpi]}
    for n, axes in enumerate(figure.axes):
        tick, left = axes.xaxis.get_major_ticks(1)[0], axes.spines["left"].get_linewidth()
        sizes = [left, tick.label1.get_fontsize(), tick.gridline.get_linewidth(), tick.gridline.get_visible()]
        limits = [*axes.get_xlim(), *axes.get_ylim(), *axes.get_position().bounds, *axes.margins()]
        found[f"{n} {words(axes, PANEL)}"] = limits + sizes
        legends = [axes.get_legend()] if axes.get_legend() else []
        parts = [part for legend in legends for part in (legend, *legend.get_lines(), *legend.get_texts())]
        for artist in [*axes.lines, *axes.patches, *axes.collections, *axes.images, *axes.texts, *parts]:
            found.setdefault(f"{n} {words(artist, LOOK)}", []).extend(numbers(artist))
    for artist in [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]:
        found[words(artist, LOOK)] = numbers(artist)
    figure.draw_without_rendering()  # most tests, and the programs that they start, draw nothing
    return {key: [float(f"{value:.9g}") for value in values] for key, values in found.items()}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_shows_what_it_showed(name: str) -> None:
    found, expected = summary(PICTURES[name]), json.loads(GOLDEN.read_text(encoding="utf-8"))[name]
    assert list(found) == list(expected)
    for key, values in expected.items():
        assert found[key] == pytest.approx(values, rel=1e-6, abs=1e-8), key


if __name__ == "__main__":
    text = json.dumps({name: summary(draw) for name, draw in PICTURES.items()})
    GOLDEN.write_text(text.replace('], "', '],\n"') + "\n", encoding="utf-8")
