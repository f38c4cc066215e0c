"""Measurements put into the order in which they were made, by their age; and a wheel whose angle goes missing."""

from __future__ import annotations

import math
from typing import NamedTuple

from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar


class Arrived(NamedTuple):
    """What was measured within half a sample of a time, NaN where nothing was."""

    x: Scalar
    y: Scalar
    psi: Scalar
    lead: Scalar
    """How much older than that time the pose is [s], negative where it is newer."""
    v: Scalar
    r: Scalar


ANY_ANGLE = 1e3
"""Larger angles of the steering wheel [rad] are none."""
SIZE = len(Arrived._fields)


def sorted_in(buffer: State, pose: State, age: Scalar, motion: State, motion_age: Scalar, dt: float) -> list[Arrived]:
    """What was measured now, a sample ago, and so on, with what has come in this sample; the oldest is due.

    buffer: the numbers of all but the newest and the last before this sample. pose: x, y, psi, of this age [s]; motion:
    v, r, of that age. What is older than the buffer, from the future, of no age or NaN is not put in; what comes twice
    for one sample replaces what came first.
    """
    slots = [Arrived(*(math.nan,) * SIZE)]
    slots += [Arrived._make(buffer[k : k + SIZE]) for k in range(0, len(buffer), SIZE)]
    found = m.is_finite(pose[0] + pose[1])
    pose_slot, motion_slot = m.floor(age / dt + 0.5), m.floor(motion_age / dt + 0.5)
    filled = []
    for k, old in enumerate(slots):
        place, now = m.both(pose_slot == k, found), motion_slot == k
        new_pose = [m.where(place, new, before) for new, before in zip((*pose, age - k * dt), old)]
        new_motion = [m.where(m.both(now, m.is_finite(new)), new, before) for new, before in zip(motion, old[4:])]
        filled.append(Arrived(*new_pose, *new_motion))
    return filled


class Wheel(NamedTuple):
    """The steering wheel in a sample: its angle before and after [rad], its zero, and what is known of it."""

    before: Scalar
    after: Scalar
    zero: Scalar
    held: Scalar
    """Was the angle after it not heard? 0 or 1."""
    unsure: Scalar
    """Was either not? 0 or 1."""


def turned_on(before: Scalar, held: Scalar, zero: Scalar, heard: Scalar) -> Wheel:
    """The wheel in a sample after which its angle is heard, or NaN.

    While it is not, its angle is held, and what it turns goes into the zero. Once it is heard again, angle and zero add
    up to what they did, so that the zero is what it was.
    """
    there = m.absolute(heard) < ANY_ANGLE
    after = m.where(there, heard, before)
    back = m.both(there, held > 0.5)
    missing = m.where(there, 0.0, 1.0)
    start, zero = m.where(back, after, before), m.where(back, zero + before - after, zero)
    return Wheel(start, after, zero, missing, m.where(back, 1.0, missing))
