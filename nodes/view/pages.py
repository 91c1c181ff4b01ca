"""Pages without a server, registered by whoever can play a scenario (``haptic.pages``)."""

from __future__ import annotations

from typing import Final

from nodes.parameters.registry import Registry

PAGES: Final = Registry(
    "haptic.pages",
    "page without a server",
    lambda _, found: "" if callable(found) else f"{found!r} cannot be called",
)
"""Writers of a page: from a folder and names of scenarios to what was written."""
