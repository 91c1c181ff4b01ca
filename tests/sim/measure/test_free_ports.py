"""Free ports: adjacent, bindable, and outside the range of outgoing connections."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import pytest

from sim.measure import free_ports


@pytest.mark.parametrize("outgoing", [32768, 1024])
def test_they_are_adjacent_free_and_none_of_the_outgoing_ones(
    outgoing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "range").write_text(f"{outgoing}\t60999\n", encoding="ascii")
    monkeypatch.setattr(free_ports, "RANGE", tmp_path / "range")
    for _ in range(20):
        first = free_ports.free_ports(4)
        assert first + 3 < (
            outgoing if outgoing > free_ports.LOWEST else free_ports.HIGHEST
        )
        with contextlib.ExitStack() as held:
            for port in range(first, first + 4):
                held.enter_context(socket.create_server(("127.0.0.1", port)))


def test_a_taken_one_among_them_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    first = free_ports.free_ports(3)
    wanted = iter((first, first + 1, first + 2))
    monkeypatch.setattr(
        "sim.measure.free_ports.random.randrange", lambda *_: next(wanted)
    )
    with socket.create_server(("127.0.0.1", first + 1)):
        assert free_ports.free_ports(1) == first
        wanted = iter((first, first + 1, first + 2))
        monkeypatch.setattr(
            "sim.measure.free_ports.random.randrange", lambda *_: next(wanted)
        )
        assert free_ports.free_ports(2) == first + 2
