"""What a notebook holds, as YAML holds it: numbers and arrays of numpy, and laws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from nodes.laws import Law
from nodes.laws.parse import law_to_dict


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Turn what a notebook holds into what YAML holds: numbers and arrays of numpy, and laws."""
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return law_to_dict(value) if isinstance(value, Law) else value
