"""The contract as JSON schema: `python -m contract.schema` writes `contract/schema.json`; a test fails on drift."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from contract.events import Appeared, Left, Moved, Position, Removed, Snapshot, Updated
from contract.observation import ObservationBatch, ObservationBatchResult
from contract.obstacle import ObstacleCollection, ObstacleFeature

SCHEMA_PATH = Path(__file__).with_name("schema.json")
MESSAGES: tuple[type[BaseModel], ...] = (
    ObservationBatch,
    ObservationBatchResult,
    ObstacleFeature,
    ObstacleCollection,
    Position,
    Snapshot,
    Moved,
    Appeared,
    Updated,
    Removed,
    Left,
)


def schema_text() -> str:
    """JSON schema of every message, as committed."""
    _, schema = models_json_schema([(model, "validation") for model in MESSAGES], title="HeadsUp contract v1")
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    SCHEMA_PATH.write_text(schema_text())
