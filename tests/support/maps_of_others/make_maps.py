"""Makes the maps beside this file with the writers of lanelet2 and commonroad-io, and keeps where the readers of those
see the way from lanelet 1 to lanelet 4: x, y [m] of its middle. Not run by the tests, which need neither package.

    pip install lanelet2==1.2.3 commonroad-io==2026.1 && python tests/support/maps_of_others/make_maps.py
"""

import json
from pathlib import Path

import lanelet2
import numpy as np
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
from commonroad.common.util import FileFormat
from commonroad.planning.planning_problem import PlanningProblemSet
from commonroad.scenario.lanelet import Lanelet
from commonroad.scenario.scenario import Scenario, ScenarioID

HERE = Path(__file__).parent
ORIGIN = (52.28, 8.02)
WIDE = 3.5


def middle(k: int) -> np.ndarray:
    """Lanelet k of 1 to 4 along a way with a bend; 5 and 6 lie beside it and are the ones to be spoilt."""
    s = np.linspace(0.0, 160.0, 161)
    psi = np.clip((s - 50.0) / 40.0, 0.0, 1.2)
    xy = np.cumsum(np.column_stack((np.cos(psi), np.sin(psi))), axis=0)
    if k > 4:
        return np.column_stack((np.linspace(0.0, 30.0, 7), np.full(7, -40.0 - 10.0 * k)))
    return xy[40 * (k - 1) : 40 * k + 1 : 4]


def sides(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Left and right bound."""
    way = middle(k)
    along = np.gradient(way, axis=0)
    left = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, None] * 0.5 * WIDE
    if 1 < k <= 4:  # one edge with the lanelet before
        before = middle(k - 1)
        step = np.gradient(before, axis=0)[-1]
        left[0] = np.array((-step[1], step[0])) / np.hypot(*step) * 0.5 * WIDE
    return way + left, way - left


def lanelet_map(file: Path) -> None:
    """The six lanelets as lanelet2 writes them: neighbours share their points."""
    points: dict[tuple[int, int], object] = {}
    made = lanelet2.core.LaneletMap()
    count = iter(range(1000, 9999))
    for k in range(1, 7):
        bounds = []
        for side in sides(k):
            line = []
            for x, y in side:
                key = (round(100.0 * x), round(100.0 * y))
                points.setdefault(key, lanelet2.core.Point3d(next(count), float(x), float(y), 0.0))
                line.append(points[key])
            bounds.append(lanelet2.core.LineString3d(next(count), line))
        one = lanelet2.core.Lanelet(k, *bounds)
        one.attributes["subtype"] = "road"
        made.add(one)
    lanelet2.io.write(str(file), made, lanelet2.projection.LocalCartesianProjector(lanelet2.io.Origin(*ORIGIN)))


def seen_by_lanelet2(file: Path) -> list[list[float]]:
    """The middle as lanelet2 reads it."""
    made = lanelet2.io.load(str(file), lanelet2.projection.LocalCartesianProjector(lanelet2.io.Origin(*ORIGIN)))
    return [[p.x, p.y] for k in range(1, 5) for p in made.laneletLayer[k].centerline]


def commonroad_map(file: Path) -> None:
    """The same as commonroad-io writes it."""
    scenario = Scenario(0.1, ScenarioID.from_benchmark_id("DEU_Steerkit-1_1_T-1", "2020a"))
    for k in range(1, 7):
        left, right = sides(k)
        ahead, behind = ([k + 1] if k < 4 else []), ([k - 1] if 1 < k <= 4 else [])
        scenario.add_objects(Lanelet(left, 0.5 * (left + right), right, k, predecessor=behind, successor=ahead))
    writer = CommonRoadFileWriter(
        scenario, PlanningProblemSet(), "a", "b", "c", set(), decimal_precision=9, file_format=FileFormat.XML
    )
    writer.write_to_file(str(file), OverwriteExistingFile.ALWAYS)


def seen_by_commonroad(file: Path) -> list[list[float]]:
    """The middle as commonroad-io reads it."""
    network = CommonRoadFileReader(str(file)).open()[0].lanelet_network
    return [p for k in range(1, 5) for p in network.find_lanelet_by_id(k).center_vertices.tolist()]


if __name__ == "__main__":
    lanelet_map(HERE / "lanelet2.osm")
    commonroad_map(HERE / "commonroad.xml")
    seen = {"lanelet2.osm": seen_by_lanelet2, "commonroad.xml": seen_by_commonroad}
    middles = {name: [[round(x, 3) for x in p] for p in read(HERE / name)] for name, read in seen.items()}
    (HERE / "middles.json").write_text(json.dumps(middles) + "\n", encoding="utf-8")
