"""Logs of any program: what is in them (`read_log`), and the drive that they hold (`read_drive`)::

drive = read_drive("lap.mat", ColumnMap.load("lap.toml"))
"""

from steerkit.logs.channels import Channel, Column, ColumnMap
from steerkit.logs.drive import Drive
from steerkit.logs.reading import RawLog, drive_of, read_drive, read_log, shipped_drives

__all__ = ["Channel", "Column", "ColumnMap", "Drive", "RawLog", "drive_of", "read_drive", "read_log", "shipped_drives"]
