"""Which format a caller gets, and that GeoJSON is encoded in one way only."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.obstacle import Link, ObstacleCollection, ObstacleFeature
from server.errors import NotAcceptableError
from server.formats.names import FormatName
from server.formats.registry import FORMATS, chosen
from server.reading import collection
from tests.unit.server.served import NOON, features


@pytest.mark.parametrize(
    ("accept", "name"),
    [
        (None, "geojson"),
        ("", "geojson"),
        ("*/*", "geojson"),
        ("application/json", "geojson"),
        ("application/ld+json", "fiware"),
        ("application/vnd.headsup.denm+json; q=0.5, application/vnd.headsup.datex+xml", "datex"),
        ("application/vnd.headsup.itis+json;q=0.9, */*;q=0.1", "itis"),
        ("application/geo+json;q=0, application/ld+json;q=0.1", "fiware"),
        ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", "geojson"),
        ("APPLICATION/LD+JSON", "fiware"),
    ],
)
def test_the_best_that_is_accepted_is_chosen(accept: str | None, name: str) -> None:
    assert chosen(None, accept).name == name


def test_a_name_in_the_query_outweighs_the_header() -> None:
    assert chosen(FormatName.WAZE, "application/ld+json").name == "waze"


@pytest.mark.parametrize("accept", ["text/html", "application/geo+json;q=0", "application/ld+json;q=x", ";;,,=q"])
def test_what_nothing_fits_is_refused(accept: str) -> None:
    with pytest.raises(NotAcceptableError, match="application/geo\\+json"):
        chosen(None, accept)


@given(st.text(max_size=80))
def test_no_header_is_too_strange(accept: str) -> None:
    try:
        assert chosen(None, accept) in FORMATS.values()
    except NotAcceptableError:
        assert accept.strip()


@given(st.lists(features(), max_size=4))
def test_joined_features_are_the_bytes_of_the_collection(served: list[ObstacleFeature]) -> None:
    body = collection.joined([collection.encoded(item) for item in served])
    whole = ObstacleCollection(features=tuple(served))
    assert body == whole.model_dump_json(exclude={"links"}).encode()
    assert ObstacleCollection.model_validate_json(body) == whole


@given(st.lists(features(), max_size=3), st.sampled_from(FormatName))
def test_every_format_writes_any_page(served: list[ObstacleFeature], name: FormatName) -> None:
    form = FORMATS[name]
    links = [Link(rel="next", href="/v1/obstacles?cursor=x", type=form.media_type)]
    body = form.page(served, links, NOON)
    assert body.startswith(b"<?xml") if name == "datex" else json.loads(body) is not None
    assert [bool(form.one(item, NOON)) for item in served] == [True] * len(served)


@given(features())
def test_a_tag_names_obstacle_revision_and_format(served: ObstacleFeature) -> None:
    revision = served.properties.revision
    marks = [collection.mark_of(served.id, number) for number in (revision, revision + 1)]
    tags = {collection.tag(these, form) for these in ([marks[0]], [marks[1]], marks) for form in ("a", "b")}
    assert len(tags) == 6
    assert all(tag.startswith('W/"') for tag in tags)
