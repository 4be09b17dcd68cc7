"""What the framework costs by itself: one endpoint that answers bytes made before, one that only validates.

Run by `benchmarks.server`: `python -m benchmarks.server_bare GET_BYTES POST_BYTES` serves on a free port of loopback.
"""

from __future__ import annotations

import sys

from fastapi import FastAPI, Response

from benchmarks.server_listen import serve
from contract.observation import ObservationBatch


def bare_app(get_bytes: int, post_bytes: int) -> FastAPI:
    """Answers of the given sizes, whatever is asked."""
    app = FastAPI()
    found = b'{"filler":"' + b"x" * max(0, get_bytes - 13) + b'"}'
    taken = b'{"filler":"' + b"x" * max(0, post_bytes - 13) + b'"}'

    @app.get("/v1/obstacles")
    async def get_obstacles() -> Response:
        return Response(found, media_type="application/geo+json")

    @app.post("/v1/observations")
    async def post_observations(batch: ObservationBatch) -> Response:
        return Response(taken, media_type="application/json")

    return app


def main() -> None:
    """Serve until ended."""
    get_bytes, post_bytes = map(int, sys.argv[1:3])
    serve(bare_app(get_bytes, post_bytes))


if __name__ == "__main__":
    main()
