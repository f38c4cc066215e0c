"""Recorded drives through their controllers again: are the requests the same, bit for bit?

The driver process records what it is told about who steers (`Remark`): a controller by name, or a learner's net by its
file and SHA-256, from which request on, and whether it was trusted. So a drive whose nets changed on the way can be
replayed too, as long as its run directory keeps them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, NamedTuple

from steerkit import car as cars
from steerkit import realtime
from steerkit.block import Block
from steerkit.car import Follow, Steering
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.recovery import Guarded
from steerkit.learning.settings import ELEMENTS
from steerkit.path import Path
from steerkit.plants.real_car.client import CarLost, ReplayLink
from steerkit.plants.real_car.config import CarConfig
from steerkit.plants.real_car.protocol import Hello, Remark, Request, Snapshot, decode
from steerkit.plants.real_car.recording import Recorded
from steerkit.plants.real_car.states import Mode
