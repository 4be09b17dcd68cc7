"""What only operators may do: confirm, dismiss, mark repaired, note inspections, delete; and read the audit log."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from pydantic import Field, model_validator

from contract.history import ActionLog, OperatorAction
from contract.obstacle import ObstacleFeature
from server.formats.names import FormatName
from server.formats.registry import FORMATS
from server.reading import representation
from server.reading.cursors import cursor_of, position_of
from server.reading.query import Missing, Parameters
from server.storage import audit
from server.web.dependencies import REFUSALS, OperatorNow, PartsNow, bearer, must_be_json, once_each, refusals
from server.web.reader_endpoints import GeoJson, one
from server.web.request_context import CURRENT

_TAG = re.compile(rf'"([1-9][0-9]{{0,8}})-(?:{"|".join(FormatName)})"')

operators = APIRouter(
    prefix="/v1",
    tags=["operators"],
    responses=REFUSALS | refusals(s403="the key's role is not operator"),
    dependencies=[Depends(bearer), Depends(once_each)],
)
_ON_AN_OBSTACLE = refusals(
    s404="no obstacle ever had this id", s412="the obstacle has changed since (`If-Match`): read it again"
)
IfMatch = Annotated[
    str | Missing,
    Header(description="entity tag of the obstacle as it was read; refused with 412 when it has changed since"),
]


class ActionsQuery(Parameters):
    """Query of the audit log."""

    obstacle_id: Annotated[UUID, Field(description="actions on this obstacle only")] | Missing = None
    limit: Annotated[int, Field(ge=1, le=1_000, description="actions in one page")] = 100
    cursor: Annotated[str, Field(max_length=200, description="from the link `next` of the page before")] | Missing = (
        None
    )

    @model_validator(mode="after")
    def _has_a_good_cursor(self) -> ActionsQuery:
        self.after()
        return self

    def after(self) -> audit.Moment | None:
        """Where the page begins."""
        if self.cursor is None:
            return None
        at, identifier = position_of(self.cursor, self.scope, (datetime, UUID))
        return at, identifier

    @property
    def scope(self) -> str:
        """What a cursor of this query belongs to."""
        return f"actions {self.obstacle_id}"


@operators.post(
    "/obstacles/{obstacle_id}/actions",
    response_class=GeoJson,
    dependencies=[Depends(must_be_json)],
    responses={
        200: {"model": ObstacleFeature},
        **_ON_AN_OBSTACLE,
        **refusals(
            s400="the body is not text in UTF-8",
            s409="the obstacle was removed and cannot be confirmed",
            s413="the body exceeds 1 MiB",
            s415="the body is not application/json",
        ),
    },
)
async def post_action(
    request: Request,
    obstacle_id: UUID,
    action: OperatorAction,
    operator: OperatorNow,
    parts: PartsNow,
    if_match: IfMatch = None,
) -> Response:
    """Act on an obstacle; the answer is the obstacle afterwards. The same action again changes nothing."""
    order = audit.Order(obstacle_id, action, operator.key_id, _request_id(), _revisions(if_match))
    return one(request, await parts.operators.carry_out(order), FORMATS[FormatName.GEOJSON])


@operators.delete("/obstacles/{obstacle_id}", status_code=204, responses=_ON_AN_OBSTACLE)
async def delete_obstacle(obstacle_id: UUID, operator: OperatorNow, parts: PartsNow, if_match: IfMatch = None) -> None:
    """Remove an obstacle for good, and delete the points and descriptors of all its versions.

    A marker without them (state `removed`) stays under its id, so that vehicles learn that it is gone.
    """
    order = audit.Order(obstacle_id, "delete", operator.key_id, _request_id(), _revisions(if_match))
    await parts.operators.carry_out(order)


@operators.get("/actions")
async def get_actions(
    request: Request, _operator: OperatorNow, parts: PartsNow, query: Annotated[ActionsQuery, Query()]
) -> ActionLog:
    """The audit log of what was done without a report, oldest first."""
    async with parts.database.read() as connection:
        found = await audit.actions(connection, query.obstacle_id, query.after(), query.limit + 1)
    page = found[: query.limit]
    links = []
    if len(found) > query.limit:
        cursor = cursor_of(query.scope, (page[-1]["at"], page[-1]["id"]))
        links.append(representation.next_link(request, cursor, "application/json"))
    return ActionLog(actions=tuple(map(audit.record, page)), links=tuple(links))


def _request_id() -> str | None:
    """What the caller's logs and ours know the request by."""
    context = CURRENT.get()
    return None if context is None else context.request_id


def _revisions(if_match: str | None) -> frozenset[int] | None:
    """Revisions that the header names, by strong comparison (RFC 9110, 13.1.1); None when any will do."""
    if if_match is None or if_match.strip() == "*":
        return None
    tags = (_TAG.fullmatch(item.strip()) for item in if_match.split(","))
    return frozenset(int(tag.group(1)) for tag in tags if tag)
