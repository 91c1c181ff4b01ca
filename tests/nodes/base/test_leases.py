"""Leases: each is one holder's, until it is given back or has run out."""

from __future__ import annotations

import time

import pytest

from nodes.base.leases import Leases
from nodes.parameters.store import ParameterError


def test_a_lease_that_somebody_holds_is_taken_by_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one replaced it, and put back at its end what the first had only borrowed."""
    leases = Leases("coupling")
    take, _, end = leases.operations().values()
    asked = {"name": "borrowed", "seconds": 5.0, "then": "law.switch"}
    take(**asked, args={"law": "pd"})
    with pytest.raises(ParameterError, match=r"coupling: lease 'borrowed' is held by somebody else; .* 5 s after"):
        take(**asked, args={"law": "trial"})
    # Not even one that has run out, before what was agreed is done.
    now = time.monotonic()
    monkeypatch.setattr("nodes.base.leases.time.monotonic", lambda: now + 6.0)
    with pytest.raises(ParameterError, match="held by somebody else"):
        take(**asked, args={"law": "trial"})
    assert leases.run_out() == [("borrowed", "law.switch", {"law": "pd"})]
    take(**asked, args={"law": "pd"})
    assert end(names=["borrowed"]) == {"run_out": []}
    take(**asked, args={"law": "pd"})


def test_whoever_held_one_before_neither_renews_nor_ends_that_of_another() -> None:
    """One that was held up for longer than agreed went on with the launch that another had by then, and put its law back."""
    leases = Leases("coupling")
    take, renew, end = leases.operations().values()
    asked = {"name": "borrowed", "seconds": 5.0, "then": "law.switch", "args": {"law": "pd"}}
    take(**asked, holder="first")
    assert renew(names=["borrowed"], holder="first") == {"run_out": []}
    assert end(names=["borrowed"], holder="first") == {"run_out": []}
    take(**asked, holder="second")
    assert renew(names=["borrowed"], holder="first") == end(names=["borrowed"], holder="first") == {"run_out": ["borrowed"]}
    assert end(names=["borrowed"], holder="second") == {"run_out": []}
