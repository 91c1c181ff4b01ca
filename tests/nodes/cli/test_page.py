"""The page's URL on the command line: printed once, while the launch runs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from nodes.cli.page import PageAnnouncer


def test_no_url_is_printed_for_a_launch_that_is_ending(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "view.page.json").write_text(
        '{"url": "http://127.0.0.1:1/x/"}', encoding="utf-8"
    )
    child = SimpleNamespace(setup=SimpleNamespace(kind="view"), running=True)
    announcer = PageAnnouncer(as_json=True)
    supervisor: Any = SimpleNamespace(
        children={"view": child}, run_dir=str(tmp_path), ending=True
    )
    announcer(supervisor)
    supervisor.ending = False
    announcer(supervisor)
    announcer.drain()
    assert capfd.readouterr().out.count("http://") == 1
