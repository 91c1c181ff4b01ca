"""JSON schemas, each checked once, which takes a hundred times as long as a message."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from jsonschema.validators import validator_for


@cache
def _validator(text: str) -> Any:
    schema = json.loads(text)
    kind = validator_for(schema)
    kind.check_schema(schema)
    return kind(schema)


def validate(value: object, schema: Mapping[str, Any]) -> None:
    """Raise jsonschema.ValidationError if a value does not fit a schema."""
    _validator(json.dumps(schema)).validate(value)
