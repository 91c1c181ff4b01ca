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
