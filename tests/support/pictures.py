"""Check that a study drew its figure in every format, with the required words."""

from __future__ import annotations

from pathlib import Path


def assert_drawn(path: str | Path, *words: str) -> None:
    """Check that a figure exists as PNG, PDF and SVG.

    Parameters
    ----------
    path : str or Path
        The PNG.
    *words : str
        Words that it must contain.
    """
    picture = Path(path)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    written = picture.with_suffix(".svg").read_text(encoding="utf-8")
    assert [word for word in words if word not in written] == []
