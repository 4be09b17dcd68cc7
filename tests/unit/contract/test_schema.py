"""The committed schema is the contract's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from contract import schema


def test_the_committed_schema_is_what_the_messages_say() -> None:
    assert schema.SCHEMA_PATH.read_text() == schema.schema_text(), "run `python -m contract.schema` and review the diff"


def test_every_message_is_in_the_schema_and_refuses_unknown_keys() -> None:
    definitions = json.loads(schema.schema_text())["$defs"]
    assert {message.__name__ for message in schema.MESSAGES} <= definitions.keys()
    found = list(objects(definitions))
    # Also where a message has a mapping in it.
    assert len(found) > len(schema.MESSAGES)
    assert all(item["additionalProperties"] is False for item in found)


def objects(part: Any) -> Iterator[dict[str, Any]]:
    """Every object that a schema describes, however deep."""
    if isinstance(part, dict) and part.get("type") == "object":
        yield part
    for below in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from objects(below)
