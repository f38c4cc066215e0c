"""Who may work for this machine, and that nothing hangs where nobody answers; tests/evals has real clusters."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from benchmarks.run import cluster
from benchmarks.run.cluster import _ASK, _objection, dask_client
from benchmarks.run.sources import source, versions

pytest.importorskip("distributed", reason="comes with the extra bench")


def answer(**changes: str) -> dict[str, Any]:
    """Of a machine like this one, with other versions of some packages."""
    return {"source": source(everything=True), "versions": versions() | changes}


def test_a_machine_like_this_one_answers_so() -> None:
    answered = eval(_ASK, {})
    assert answered == answer()
    assert _objection("it", answered) == ""


def test_other_sources_and_versions_cannot_work_for_this_machine() -> None:
    other = _objection("the worker w", answer() | {"source": "0" * 16})
    assert other.startswith("the worker w has another steerkit-control (")
    assert "sources 0000000000000000) than this machine (" in other
    assert f"sources {source(everything=True)}): install steerkit-control" in other
    assert "has another steerkit-control (9.9, " in _objection("it", answer(**{"steerkit-control": "9.9"}))


def test_other_packages_matter_where_numbers_are_made() -> None:
    other = answer(numpy="0.1", torch="0.2")
    assert "it has numpy 0.1 instead of " in _objection("it", other)
    assert ", torch 0.2 instead of " in _objection("it", other)
    assert _objection("it", other, packages=False) == ""  # of a scheduler


def test_a_machine_without_the_package_is_told_what_to_install() -> None:
    said = _objection("the scheduler", {"error": "ModuleNotFoundError: No module named 'benchmarks'"})
    assert said.startswith(
        "the scheduler cannot import this package (ModuleNotFoundError: No module named 'benchmarks')"
    )
    assert said.endswith("with the extra bench there as here, and start it again")


@pytest.mark.parametrize("listening", [False, True])
def test_where_no_scheduler_answers_it_ends(listening: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is there, or somebody who says nothing."""
    monkeypatch.setattr(cluster, "CONTACT", 0.5)
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if listening:
            server.listen()
        address = "tcp://{}:{}".format(*server.getsockname())
        with (
            pytest.raises(ValueError, match=f"--address {address}: no Dask scheduler answers there"),
            dask_client(address),
        ):
            pytest.fail("there is no client")


def test_an_address_of_no_kind() -> None:
    with pytest.raises(ValueError, match="unknown address scheme 'nowhere'"), dask_client("nowhere://x"):
        pytest.fail("there is no client")
