"""Parts of the study `scoreboard`: steerkit beside the best that others wrote, in their own measure.

Each part is a module with `add_options(parser)`, whose options no other part has, and `measure(options) -> dict`, which
prints its tables and returns its figures. Packages of the extra `peers` are imported where they are used.
"""
