"""The committed schema is the contract's."""

from __future__ import annotations

import json

from contract import schema


def test_the_committed_schema_is_what_the_messages_say() -> None:
    assert schema.SCHEMA_PATH.read_text() == schema.schema_text(), "run `python -m contract.schema` and review the diff"


def test_every_message_is_in_the_schema_and_refuses_unknown_keys() -> None:
    definitions = json.loads(schema.schema_text())["$defs"]
    assert {message.__name__ for message in schema.MESSAGES} <= definitions.keys()
    objects = [definition for definition in definitions.values() if definition["type"] == "object"]
    assert all(definition["additionalProperties"] is False for definition in objects)
