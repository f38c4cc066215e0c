"""How C code is compiled: `make test` has it compiled quickly, as most of it is run for less time than that takes."""

import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from steerkit._support import native


def optimising() -> str:
    """$CC with which loops are optimised all the same: for what computes for longer, or is to be seen optimised."""
    words = shlex.split(os.environ.get("CC", "")) or [*(native.compiler() or ["cc"])]
    return shlex.join([*words, "-O1", "-Ualways_inline"])


@contextmanager
def optimised() -> Iterator[None]:
    """With that compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CC", optimising())
        yield
