"""Whether a study drew its picture, in every format, and with the words that it needs."""

from __future__ import annotations

from pathlib import Path


def assert_drawn(path: str | Path, *words: str) -> None:
    """Check that a picture is there as PNG, PDF and SVG.

    Parameters
    ----------
    path : str or Path
        The PNG.
    *words : str
        What must be written in it.
    """
    picture = Path(path)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    written = picture.with_suffix(".svg").read_text(encoding="utf-8")
    assert [word for word in words if word not in written] == []
