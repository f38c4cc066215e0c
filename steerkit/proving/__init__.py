"""Manoeuvres of vehicle testing: one definition, driven in simulation, found in a log, driven on a car, judged."""
