"""Leases: each has one holder, until it is returned or has expired."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from nodes.base.leases import Leases
from nodes.parameters.store import ParameterError


def leases_of(
    path: Path | None = None,
) -> tuple[Leases, list[tuple[str, Mapping[str, Any]]], dict[str, Any]]:
    """Return a node's leases, its recorded operations, and the operations by short name."""
    done: list[tuple[str, Mapping[str, Any]]] = []
    leases = Leases("coupling", lambda op, args: done.append((op, args)), path)
    return (
        leases,
        done,
        {name.removeprefix("lease."): run for name, run in leases.operations().items()},
    )


def test_a_lease_that_somebody_holds_is_taken_by_nobody_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second holder replaced it, and restored the first one's temporary state."""
    leases, _, operations = leases_of()
    take, end = operations["take"], operations["end"]
    asked = {"name": "borrowed", "seconds": 5.0, "then": "law.switch"}
    take(**asked, args={"law": "pd"})
    with pytest.raises(
        ParameterError,
        match=r"coupling: lease 'borrowed' is held by another client; .* 5 s after",
    ):
        take(**asked, args={"law": "trial"})
    # Not even one that has run out, before what was agreed is done.
    now = time.monotonic()
    monkeypatch.setattr("nodes.base.leases.time.monotonic", lambda: now + 6.0)
    with pytest.raises(ParameterError, match="held by another client"):
        take(**asked, args={"law": "trial"})
    assert leases.run_out() == [("borrowed", "law.switch", {"law": "pd"})]
    take(**asked, args={"law": "pd"})
    assert end(names=["borrowed"]) == {"run_out": []}
    take(**asked, args={"law": "pd"})


def test_whoever_held_one_before_neither_renews_nor_ends_that_of_another() -> None:
    """A delayed client continued with another's lease and restored its own law."""
    _, _, operations = leases_of()
    take, renew, end = (operations[name] for name in ("take", "renew", "end"))
    asked = {
        "name": "borrowed",
        "seconds": 5.0,
        "then": "law.switch",
        "args": {"law": "pd"},
    }
    take(**asked, holder="first")
    assert renew(names=["borrowed"], holder="first") == {"run_out": []}
    assert end(names=["borrowed"], holder="first") == {"run_out": []}
    take(**asked, holder="second")
    assert (
        renew(names=["borrowed"], holder="first")
        == end(names=["borrowed"], holder="first")
        == {"run_out": ["borrowed"]}
    )
    assert end(names=["borrowed"], holder="second") == {"run_out": []}


def test_a_change_is_made_under_its_own_lease_and_refused_under_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A delayed client changed the law after its lease had expired; nothing reverted it."""
    leases, done, operations = leases_of()
    take, change, end = (operations[name] for name in ("take", "change", "end"))
    wanted = {"name": "borrowed", "operation": "law.switch", "args": {"law": "trial"}}
    refused = r"coupling: law.switch refused: its lease 'borrowed' has run out"
    with pytest.raises(ParameterError, match=refused):
        change(**wanted, holder="first")
    agreed = {
        "name": "borrowed",
        "seconds": 5.0,
        "then": "law.switch",
        "args": {"law": "pd"},
    }
    take(**agreed, holder="first")
    change(**wanted, holder="first")
    assert done == [("law.switch", {"law": "trial"})]
    with pytest.raises(ParameterError, match=refused):
        change(**wanted, holder="second")
    now = time.monotonic()
    monkeypatch.setattr("nodes.base.leases.time.monotonic", lambda: now + 6.0)
    assert leases.run_out() == [("borrowed", "law.switch", {"law": "pd"})]
    with pytest.raises(ParameterError, match=refused):
        change(**wanted, holder="first")
    # Nor under the lease of the next client, nor once its own was ended.
    take(**agreed, holder="second")
    with pytest.raises(ParameterError, match=refused):
        change(**wanted, holder="first")
    end(names=["borrowed"], holder="second")
    with pytest.raises(ParameterError, match=refused):
        change(**wanted, holder="second")
    assert done == [("law.switch", {"law": "trial"})]


def test_a_lease_outlives_the_process_of_its_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A coupling restarted during a trial kept the trial law for good."""
    path = tmp_path / "coupling.leases"
    _, _, operations = leases_of(path)
    agreed = {"seconds": 5.0, "then": "law.switch", "args": {"law": "pd", "ramp": 100}}
    for name in ("ended", "borrowed"):
        operations["take"](name=name, **agreed, holder="first")
    operations["end"](names=["ended"], holder="first")
    again, done, operations = leases_of(path)
    # Its holder goes on with it, another one does not.
    assert operations["renew"](names=["ended", "borrowed"], holder="first") == {
        "run_out": ["ended"]
    }
    assert operations["renew"](names=["borrowed"], holder="second") == {
        "run_out": ["borrowed"]
    }
    operations["change"](
        name="borrowed", operation="param.set", args={}, holder="first"
    )
    assert done == [("param.set", {})]
    now = time.monotonic()
    monkeypatch.setattr("nodes.base.leases.time.monotonic", lambda: now + 6.0)
    assert again.run_out() == [("borrowed", "law.switch", {"law": "pd", "ramp": 100})]
    again.save()
    third, _, _ = leases_of(path)
    assert third.run_out() == []
