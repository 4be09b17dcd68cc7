"""A batch of reports as it is posted: read and checked in one step, which takes half of what the framework's two do."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from pydantic.json_schema import models_json_schema

from contract.observation import ObservationBatch

_SCHEMAS = "#/components/schemas/"


async def posted_batch(request: Request) -> ObservationBatch:
    """The batch of a request; raises `RequestValidationError`."""
    try:
        return ObservationBatch.model_validate_json(await request.body())
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False)
        raise RequestValidationError([{**item, "loc": ("body", *item["loc"])} for item in found]) from None


REQUEST_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": f"{_SCHEMAS}{ObservationBatch.__name__}"}}},
    }
}
"""Of the operation in the OpenAPI document, since the framework does not see this body."""


def described(document: dict[str, Any]) -> dict[str, Any]:
    """The OpenAPI document with the schemas that `REQUEST_BODY` speaks of."""
    _, schema = models_json_schema([(ObservationBatch, "validation")], ref_template=f"{_SCHEMAS}{{model}}")
    document["components"]["schemas"] |= schema["$defs"]
    return document
