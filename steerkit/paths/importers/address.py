"""Addresses of courses: a file and what of it is meant, such as `town.xodr#road=1,lane=-1`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath

from steerkit._support.errors import known, require

KINDS: Mapping[str, str] = {
    ".csv": "CSV",
    ".gpx": "GPX",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".xodr": "OpenDRIVE",
    ".xml": "CommonRoad or OSM",
    ".osm": "OSM or Lanelet2",
}
"""How the name of a file with a road in it ends, and what it then is."""
_SETTINGS = ("noise", "closed", "reverse")


@dataclass(frozen=True, kw_only=True)
class Address:
    """A file, which road or track of it, and how it is to be smoothed."""

    file: str
    choice: Mapping[str, str]
    """What is chosen by name: road, lane, lanelet, way, track, feature, to, lap."""
    noise: float | None
    """How far points lie beside the way, as a standard deviation [m]; None: the format's."""
    closed: bool | None
    """None: closed if it comes back to its beginning."""
    reverse: bool
    """The other way round."""

    @classmethod
    def parsed(cls, text: str) -> Address:
        """The address in a text: `FILE`, or `FILE#KEY=VALUE,KEY=VALUE`; raises ValueError with the valid keys."""
        file, _, rest = text.partition("#")
        values: dict[str, str] = {}
        for word in filter(None, rest.split(",")):
            key, sign, value = word.partition("=")
            require(sign and value, f"'{text}'", f"'{word}', expected KEY=VALUE, such as noise=0.5 or road=1")
            require(key not in values, f"'{text}'", f"{key} stands twice")
            values[key] = value
        kind = FilePath(file).suffix.lower()
        known(kind or "none", KINDS, "a course's file: ending")
        choice = {key: value for key, value in values.items() if key not in _SETTINGS}
        for key in choice:
            valid = CHOICES[kind]
            known(key, (*valid, *_SETTINGS), f"'{text}': {KINDS[kind]} key")
        return cls(
            file=file,
            choice=choice,
            noise=_noise(values["noise"], text) if "noise" in values else None,
            closed=_yes_or_no("closed", values["closed"], text) if "closed" in values else None,
            reverse=_yes_or_no("reverse", values["reverse"], text) if "reverse" in values else False,
        )

    @property
    def name(self) -> str:
        """What the course is called: the file's name, and what of it."""
        parts = [FilePath(self.file).stem, *(f"{key}{value}" for key, value in self.choice.items())]
        parts += ["reversed"] * self.reverse
        clean = "".join(c if c.isalnum() or c in "-_." else "_" for c in "-".join(parts))
        return clean.replace("--", "-_")  # two hyphens part the names of scenarios


CHOICES: Mapping[str, tuple[str, ...]] = {
    ".csv": ("lap",),
    ".gpx": ("track", "lap"),
    ".geojson": ("feature", "lap"),
    ".json": ("feature", "lap"),
    ".xodr": ("road", "lane", "to"),
    ".xml": ("lanelet", "way", "to"),
    ".osm": ("lanelet", "way", "to"),
}
"""What can be chosen by name, by the file's ending."""


def is_road(name: str) -> bool:
    """Does a course's name mean a file other than a plain CSV, or something in a file?"""
    file, sign, _ = name.partition("#")
    ending = FilePath(file).suffix.lower()
    return ending in KINDS and (bool(sign) or ending != ".csv")


def _noise(text: str, where: str) -> float:
    try:
        noise = float(text)
    except ValueError:
        noise = -1.0
    require(0.0 <= noise <= 10.0, f"'{where}'", f"noise = {text} [m], expected 0 to 10")
    return noise


def _yes_or_no(key: str, text: str, where: str) -> bool:
    return known(text, ("yes", "no"), f"'{where}': {key}") == "yes"
