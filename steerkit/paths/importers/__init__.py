"""Courses from files: CSV, GPX, GeoJSON, OpenDRIVE, CommonRoad, OSM and Lanelet2::

yard = read_course("lap.gpx#noise=1")            # .path, .v, .v_limit, .notes
town = read_course("town.xodr#road=1,lane=-1,to=5")
print(contents("town.xodr").listed())            # what there is to choose from
town.to_csv("town.csv")                          # a course like any other
"""

from steerkit.paths.importers.course import TIGHTEST, Course, Line, course_of
from steerkit.paths.importers.network import Map, Piece
from steerkit.paths.importers.reading import Address, contents, is_road, read_course

__all__ = ["TIGHTEST", "Address", "Course", "Line", "Map", "Piece", "contents", "course_of", "is_road", "read_course"]
