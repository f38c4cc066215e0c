"""What a map holds, and a route through it: pieces of lane or way, and which follows which."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from steerkit._support.errors import require
from steerkit.paths.importers.course import Line

_GAP, _TOLD, _KINK = 0.5, 0.05, 0.8
"""Pieces that follow each other are so far apart at most [m], are said to be from here on, and turn by this at most."""
_LISTED = 12


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Piece:
    """A part of a road that is driven from one end to the other."""

    group: str
    """What it is called by: the road's, lanelet's or way's name, the track's."""
    lane: str = ""
    """Which lane of it; empty where there is but one."""
    length: float
    """[m]."""
    next: tuple[str, ...] = ()
    """The pieces that may be driven after it."""
    line: Callable[[], Line]
    """Its centre, made when it is needed."""
    back: bool = False
    """Is it the other way along what is called by its name?"""
    about: str = ""
    """For lists: its type, name or speed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Map:
    """All that can be driven in a file."""

    kind: str
    """What its groups are: road, lanelet, way, track, feature."""
    pieces: Mapping[str, Piece]
    noise: float
    """How far its points lie beside the way unless something else is said, as a standard deviation [m]."""
    drawn: bool
    """Does a line run straight between its points?"""
    notes: tuple[str, ...] = ()
    origin_deg: tuple[float, float] | None = None
    _names: dict[str, list[str]] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        for name, piece in self.pieces.items():
            self._names.setdefault(piece.group, []).append(name)

    def groups(self) -> dict[str, list[Piece]]:
        """Roads, lanelets, ways or tracks by name, with their pieces."""
        return {group: [self.pieces[name] for name in names] for group, names in self._names.items()}

    def length_of(self, group: str) -> float:
        """How long a road, lanelet, way or track is [m], driven one way."""
        pieces = [self.pieces[name] for name in self._names[group]]
        return sum(p.length for p in pieces if (p.lane, p.back) == (pieces[0].lane, pieces[0].back))

    def listed(self) -> str:
        """What there is to choose from, in a line."""
        groups = self.groups()
        words = [self._word(group, pieces) for group, pieces in [*groups.items()][:_LISTED]]
        return "; ".join(words) + (f" and {len(groups) - _LISTED} more" if len(groups) > _LISTED else "")

    def _word(self, group: str, pieces: list[Piece]) -> str:
        lanes = dict.fromkeys(piece.lane for piece in pieces if piece.lane)
        length = self.length_of(group)
        which = f"lane {', '.join(lanes)}, " if lanes else ""
        return f"{self.kind} {group} ({which}{length:.0f} m)"

    def route(self, choice: Mapping[str, str], where: str) -> tuple[Line, bool, tuple[str, ...]]:
        """The centre of what is chosen, from its beginning to its end; is it a round; and what to say of it.

        Raises ValueError that lists what there is where nothing, or something else, is chosen; where no route leads to
        the goal; and where the pieces of a route do not meet.
        """
        start, lane = self._asked(choice, where)
        first = self._first(start, lane, where)
        goal = choice.get("to")
        names, closed = self._followed([first]), False
        if goal is not None:
            to, _, to_lane = goal.partition(":")
            self._check_group(to, f"{where}: to")
            goals = {n for n in self._names[to] if not to_lane or self.pieces[n].lane == to_lane}
            require(goals, where, f"{self.kind} {to} has no lane {to_lane}; lanes: {', '.join(self._lanes(to))}")
            names = self._shortest(first, goals, where, goal)
            closed = names[-1] == first
            names = names[:-1] if closed else self._followed(names)
        line, notes = self._joined(names, closed, where)
        passed = list(dict.fromkeys(self.pieces[n].group for n in names))
        summary = [f"{self.kind} {', '.join(passed[:20])}{' ...' if len(passed) > 20 else ''}"]
        summary += [f"lane {self.pieces[first].lane} at its beginning"] * bool(self.pieces[first].lane)
        return line, closed, (", ".join(summary), *notes)

    def _asked(self, choice: Mapping[str, str], where: str) -> tuple[str, str]:
        for key in choice:
            valid = (self.kind, "to", "lane", "lap") if self.kind == "road" else (self.kind, "to", "lap")
            require(key in valid, where, f"{key} is no key here; it holds {self.listed()}")
        if self.kind in choice:
            self._check_group(choice[self.kind], where)
            return choice[self.kind], choice.get("lane", "")
        require(len(self._names) == 1, where, f"which {self.kind}? choose one, FILE#{self.kind}=...: {self.listed()}")
        return next(iter(self._names)), choice.get("lane", "")

    def _check_group(self, group: str, where: str) -> None:
        require(group in self._names, where, f"there is no {self.kind} {group}; there is {self.listed()}")

    def _lanes(self, group: str) -> list[str]:
        return list(dict.fromkeys(self.pieces[name].lane for name in self._names[group]))

    def _first(self, group: str, lane: str, where: str) -> str:
        lanes = self._lanes(group)
        if not lane:
            require(len(lanes) == 1, where, f"which lane of {self.kind} {group}? choose lane=: {', '.join(lanes)}")
            lane = lanes[0]
        require(lane in lanes, where, f"{self.kind} {group} has no lane {lane} to drive on; lanes: {', '.join(lanes)}")
        names = [name for name in self._names[group] if self.pieces[name].lane == lane]
        entered = {after for name in self._names[group] for after in self.pieces[name].next if after != name}
        return next((name for name in names if name not in entered), names[0])

    def _followed(self, names: list[str]) -> list[str]:
        """On to the end of the last one's group."""
        group = self.pieces[names[-1]].group
        while True:
            after = [n for n in self.pieces[names[-1]].next if n in self.pieces and self.pieces[n].group == group]
            if len(after) != 1 or after[0] in names:
                return names
            names = [*names, after[0]]

    def _shortest(self, first: str, goals: set[str], where: str, goal: str) -> list[str]:
        """Dijkstra's shortest route; back to `first` itself where that is the goal."""
        queue, before, done = [(0.0, 0, first, "")], dict[str, str](), set[str]()
        count = 0
        while queue:
            cost, _, name, last = heapq.heappop(queue)
            arrived = name in goals and last and (name == first or first not in goals)
            if name in done and not arrived:
                continue
            if arrived:
                names = [name, last]
                while names[-1] != first:
                    names.append(before[names[-1]])
                return names[::-1]
            done.add(name)
            before[name] = last
            for after in self.pieces[name].next:
                if after in self.pieces and (after not in done or after == first):
                    count += 1
                    heapq.heappush(queue, (cost + self.pieces[name].length, count, after, name))
        reached_groups = sorted({self.pieces[n].group for n in done})
        some = ", ".join(reached_groups[:_LISTED]) + (" ..." if len(reached_groups) > _LISTED else "")
        raise ValueError(f"{where}: no route leads to {self.kind} {goal}: not connected; what can be reached: {some}")

    def _joined(self, names: list[str], closed: bool, where: str) -> tuple[Line, list[str]]:
        lines, notes = [self.pieces[name].line() for name in names], []
        limits = any(line.v_limit is not None for line in lines)
        for k, line in enumerate(lines):
            before = lines[k - 1]
            if k == 0 and not closed:
                continue
            gap = math.dist(before.xy[-1], line.xy[0])
            at = f"between {self._called(names[k - 1])} and {self._called(names[k])}"
            x, y = line.xy[0]
            require(gap <= _GAP, where, f"a gap of {gap:.2g} m {at}, at ({x:.1f}, {y:.1f}) [m]: not connected")
            if gap > _TOLD:
                notes.append(f"a gap of {gap:.2f} m {at} is bridged")
            turn = abs((_heading(line, 0) - _heading(before, -1) + math.pi) % (2.0 * math.pi) - math.pi)
            what = f"a kink of {turn:.1f} rad {at}, at ({x:.1f}, {y:.1f}) [m], which no car drives"
            require(turn <= _KINK or self.kind == "way", where, what)
        parts = [line.part(slice(0 if k == 0 else 1, None)) for k, line in enumerate(lines)]
        speeds = [p.v_limit if p.v_limit is not None else np.full(len(p.xy), np.nan) for p in parts]
        xy = np.concatenate([p.xy for p in parts])
        driven = lines[0].v if len(lines) == 1 else None
        return Line(xy=xy, v=driven, v_limit=np.concatenate(speeds) if limits else None), notes

    def _called(self, name: str) -> str:
        piece = self.pieces[name]
        return f"{self.kind} {piece.group}{f' lane {piece.lane}' if piece.lane else ''}"


def _heading(line: Line, end: int) -> float:
    a, b = (line.xy[0], line.xy[1]) if end == 0 else (line.xy[-2], line.xy[-1])
    return math.atan2(b[1] - a[1], b[0] - a[0])
