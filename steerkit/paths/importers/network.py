"""What a map holds, and a route through it: pieces of lane or way, and which follows which."""

import heapq
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram.maths import Array
from steerkit.paths.importers.course import Line
from steerkit.paths.importers.tracks import Track

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
    noise: float = 0.0
    """How far its points lie beside the way unless something else is said, as a standard deviation [m]."""
    drawn: bool = False
    """Does a line run straight between its points?"""
    notes: tuple[str, ...] = ()
    origin_deg: tuple[float, float] | None = None
    """Where x = y = 0 is [degrees], if it is known."""
    tracks: Mapping[str, Track] = field(default_factory=dict)
    """Of a file of tracks, by name: each has its own noise and origin."""
    faulty: Mapping[str, str] = field(default_factory=dict)
    """Roads, lanelets or ways that are left out, by name, and why."""

    @property
    def left_out(self) -> list[str]:
        """What to say of that which is left out, in a line or none."""
        if not self.faulty:
            return []
        some = [f"{name} ({why})" for name, why in itertools.islice(self.faulty.items(), 3)]
        more = f" and {len(self.faulty) - 3} more" if len(self.faulty) > 3 else ""
        return [f"{len(self.faulty)} faulty {self.kind}s are left out: {'; '.join(some)}{more}"]

    def source(self, choice: Mapping[str, str]) -> "Map | Track":
        """What says noise, origin and whether it was drawn: the track that is chosen, or all of a map."""
        return self.tracks[choice.get(self.kind) or next(iter(self.tracks))] if self.tracks else self

    @cached_property
    def groups(self) -> dict[str, list[str]]:
        """Roads, lanelets, ways or tracks by name, with the names of their pieces."""
        found: dict[str, list[str]] = {}
        for name, piece in self.pieces.items():
            found.setdefault(piece.group, []).append(name)
        return found

    def length_of(self, group: str) -> float:
        """How long a road, lanelet, way or track is [m], driven one way."""
        pieces = [self.pieces[name] for name in self.groups[group]]
        return sum(p.length for p in pieces if (p.lane, p.back) == (pieces[0].lane, pieces[0].back))

    def listed(self) -> str:
        """What there is to choose from, in a line."""
        groups = list(self.groups)
        words = [self._word(group) for group in groups[:_LISTED]]
        return "; ".join(words) + (f" and {len(groups) - _LISTED} more" if len(groups) > _LISTED else "")

    def _word(self, group: str) -> str:
        lanes = [lane for lane in self._lanes(group) if lane]
        which = f"lane {', '.join(lanes)}, " if lanes else ""
        return f"{self.kind} {group} ({which}{self.length_of(group):.0f} m)"

    def route(self, choice: Mapping[str, str], where: str) -> tuple[Line, bool, list[str]]:
        """The centre of what is chosen, from its beginning to its end; is it a round; and what to say of it.

        Raises ValueError that lists what there is where nothing, or something else, is chosen; where no route leads to
        the goal; and where the pieces of a route do not meet.
        """
        first = self._first(choice, where)
        names, closed = self._followed([first]), False
        if "to" in choice:
            to, _, to_lane = choice["to"].partition(":")
            goals = {n for n in self._group(to, f"{where}: to") if not to_lane or self.pieces[n].lane == to_lane}
            require(goals, where, f"{self.kind} {to} has no lane {to_lane}; lanes: {', '.join(self._lanes(to))}")
            names = self._shortest(first, {first} if first in goals else goals, where, choice["to"])
            closed = names[-1] == first
            names = names[:-1] if closed else self._followed(names)
        line, notes = self._joined(names, closed, where)
        passed = list(dict.fromkeys(self.pieces[n].group for n in names))
        summary = f"{self.kind} {', '.join(passed[:20])}{' ...' if len(passed) > 20 else ''}"
        lane = self.pieces[first].lane
        return line, closed, [f"{summary}, lane {lane} at its beginning" if lane else summary, *notes]

    def _group(self, group: str, where: str) -> list[str]:
        why = "" if group in self.groups else self.faulty.get(group)
        require(not why, where, f"{self.kind} {group} is faulty: {why}; there is {self.listed()}")
        require(group in self.groups, where, f"there is no {self.kind} {group}; there is {self.listed()}")
        return self.groups[group]

    def _lanes(self, group: str) -> list[str]:
        return list(dict.fromkeys(self.pieces[name].lane for name in self.groups[group]))

    def _first(self, choice: Mapping[str, str], where: str) -> str:
        """The piece at which what is chosen begins."""
        for key in choice:
            valid = (self.kind, "to", "lane") if self.kind == "road" else (self.kind, "to")
            require(key in valid, where, f"{key} is no key here; it holds {self.listed()}")
        groups = list(self.groups)
        asked = self.kind in choice or len(groups) == 1
        require(asked, where, f"which {self.kind}? choose one, FILE#{self.kind}=...: {self.listed()}")
        group = choice.get(self.kind, groups[0])
        names, lanes = self._group(group, where), self._lanes(group)
        one = "lane" in choice or len(lanes) == 1
        require(one, where, f"which lane of {self.kind} {group}? choose lane=: {', '.join(lanes)}")
        lane = choice.get("lane", lanes[0])
        require(lane in lanes, where, f"{self.kind} {group} has no lane {lane} to drive on; lanes: {', '.join(lanes)}")
        entered = {after for name in names for after in self.pieces[name].next if after != name}
        in_lane = [name for name in names if self.pieces[name].lane == lane]
        return next((name for name in in_lane if name not in entered), in_lane[0])

    def _after(self, name: str) -> list[str]:
        return [after for after in self.pieces[name].next if after in self.pieces]

    def _followed(self, names: list[str]) -> list[str]:
        """On to the end of the last one's group."""
        group = self.pieces[names[-1]].group
        while True:
            after = [name for name in self._after(names[-1]) if self.pieces[name].group == group]
            if len(after) != 1 or after[0] in names:
                return names
            names = [*names, after[0]]

    def _shortest(self, first: str, goals: set[str], where: str, goal: str) -> list[str]:
        """Dijkstra's shortest route, by the length of what is driven before its last piece."""
        queue, done, pushed = [(0.0, 0, [first])], set[str](), itertools.count(1)
        while queue:
            cost, _, names = heapq.heappop(queue)  # of routes as long, the one found first
            if len(names) > 1 and names[-1] in goals:
                return names
            if names[-1] not in done or len(names) == 1:
                done.add(names[-1])
                cost += self.pieces[names[-1]].length
                for after in self._after(names[-1]):
                    if after in goals or after not in done:
                        heapq.heappush(queue, (cost, next(pushed), [*names, after]))
        reached = sorted({self.pieces[name].group for name in done})
        some = ", ".join(reached[:_LISTED]) + (" ..." if len(reached) > _LISTED else "")
        raise ValueError(f"{where}: no route leads to {self.kind} {goal}: not connected; what can be reached: {some}")

    def _joined(self, names: list[str], closed: bool, where: str) -> tuple[Line, list[str]]:
        lines, notes = [self.pieces[name].line() for name in names], []
        for k in range(0 if closed else 1, len(lines)):
            before, line = lines[k - 1], lines[k]
            gap = math.dist(before.xy[-1], line.xy[0])
            between = f"between {self._called(names[k - 1])} and {self._called(names[k])}"
            at = "{}, at ({:.1f}, {:.1f}) [m]".format(between, *line.xy[0])
            require(gap <= _GAP, where, f"a gap of {gap:.2g} m {at}: not connected")
            if gap > _TOLD:
                notes.append(f"a gap of {gap:.2f} m {between} is bridged")
            turn = abs(math.remainder(_heading(line.xy[:2]) - _heading(before.xy[-2:]), 2.0 * math.pi))
            require(turn <= _KINK or self.kind == "way", where, f"a kink of {turn:.1f} rad {at}, which no car drives")
        parts = [lines[0], *(line.part(slice(1, None)) for line in lines[1:])]
        speeds = [np.full(len(p.xy), np.nan) if p.v_limit is None else p.v_limit for p in parts]
        limits = None if all(line.v_limit is None for line in lines) else np.concatenate(speeds)
        return Line(xy=np.concatenate([p.xy for p in parts]), v_limit=limits), notes

    def _called(self, name: str) -> str:
        piece = self.pieces[name]
        return f"{self.kind} {piece.group}{f' lane {piece.lane}' if piece.lane else ''}"


def require_some(pieces: Mapping[str, Any], faulty: Mapping[str, str], file: str, what: str) -> None:
    """ValueError where a map holds nothing, or nothing that is not faulty."""
    first = next((f": {name}: {why}" for name, why in faulty.items()), "")
    require(pieces, file, f"holds no {what}" if not faulty else f"all of its {what} are faulty{first}")


def _heading(xy: Array) -> float:
    return math.atan2(*(xy[1] - xy[0])[::-1])
