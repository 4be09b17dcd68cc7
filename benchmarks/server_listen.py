"""Serve an ASGI application on a free port of loopback, as one process, and say where.

A peer's own Python runs it too, so that it imports uvicorn only: `python -m benchmarks.server_listen MODULE:NAME`.
"""

from __future__ import annotations

import socket
import sys
from typing import Any

import uvicorn


def serve(application: Any) -> None:
    """Serve an ASGI application, or the one that `module:name` names, until ended."""
    listener = socket.create_server(("127.0.0.1", 0))
    print(f"listening on http://127.0.0.1:{listener.getsockname()[1]}", flush=True)
    config = uvicorn.Config(application, access_log=False, log_config=None, server_header=False)
    uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    serve(sys.argv[1])
