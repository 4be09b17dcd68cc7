"""Load by wrk: requests from a file, as fast as they are answered or at a pace, and what they cost the server."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.server_processes import Measured

_THREADS = 2
# In the mean: uvicorn ends connections that are idle for 5 s, which hardly ever are then.
_LONGEST_PAUSE_S = 0.25
# Each thread takes every second line of the file, from its beginning; what is used up begins again.
_SCRIPT = """
local threads = 0
function setup(thread) thread:set("number", threads); threads = threads + 1 end
function init(args)
  lines, at, pause_ms, method = {}, 0, tonumber(args[2]), args[3]
  local count = 0
  for line in io.lines(args[1]) do
    if count %% %(threads)d == number then lines[#lines + 1] = line end
    count = count + 1
  end
  math.randomseed(number + 1)
  at = tonumber(args[4])
  headers = {["Content-Type"] = "application/json"}
  if args[5] ~= "" then headers["Authorization"] = "Bearer " .. args[5] end
end
function request()
  at = at %% #lines + 1
  if method == "GET" then return wrk.format("GET", lines[at], headers) end
  return wrk.format("POST", "/v1/observations", headers, lines[at])
end
if %(paced)s then
  function delay() return math.floor(-pause_ms * math.log(1 - math.random()) + 0.5) end
end
function done(summary, latency, requests)
  local errors = summary.errors
  io.write(string.format('\\n{"requests":%%d,"duration_us":%%d,"bytes":%%d,"failed":%%d,"p50_us":%%f,"p99_us":%%f}\\n',
    summary.requests, summary.duration, summary.bytes,
    errors.connect + errors.read + errors.write + errors.status + errors.timeout,
    latency:percentile(50), latency:percentile(99)))
end
"""


class LoadError(RuntimeError):
    """A server did not answer all of its requests as it should."""


@dataclass(frozen=True, slots=True)
class Load:
    """Requests: a file with one in each line (paths to get, or bodies to post)."""

    lines: Path
    posts: bool = False
    connections: int = 32
    pause_ms: float = 0.0
    """Mean pause of each connection before a request (exponential); none: as fast as answers come."""
    first: int = 0
    """Where in the file to begin."""

    key: str = ""
    """Sent with each request; without, a server must be open."""

    def beginning(self, first: int) -> Load:
        """The same from another place in the file."""
        return replace(self, first=first // _THREADS)

    def at(self, per_second: float) -> Load:
        """The same at a pace, if answers take no time; of a slow server on fewer connections."""
        connections = min(self.connections, max(_THREADS, round(_LONGEST_PAUSE_S * per_second)))
        return replace(self, connections=connections, pause_ms=1e3 * connections / per_second)


@dataclass(frozen=True, slots=True)
class Cost:
    """What a load cost. Processor times are microseconds a request, of the server and of its database."""

    requests: int
    seconds: float
    app_us: float
    database_us: float
    p50_ms: float
    p99_ms: float
    answer_bytes: float

    @property
    def cpu_us(self) -> float:
        """Server and database."""
        return self.app_us + self.database_us

    @property
    def per_second(self) -> float:
        """Throughput."""
        return self.requests / self.seconds


def cost_of(server: Measured, load: Load, seconds: int) -> Cost:
    """Put a load on a server; raises `LoadError` when any answer is not 2xx."""
    before_s = server.cpu_s()
    said = _wrk(server.url, load, seconds)
    app_s, database_s = (after - before for after, before in zip(server.cpu_s(), before_s, strict=True))
    if said["failed"] or not said["requests"]:
        raise LoadError(f"{said['failed']} of {said['requests']} requests to {server.url} failed")
    number = int(said["requests"])
    return Cost(
        requests=number,
        seconds=said["duration_us"] / 1e6,
        app_us=1e6 * app_s / number,
        database_us=1e6 * database_s / number,
        p50_ms=said["p50_us"] / 1e3,
        p99_ms=said["p99_us"] / 1e3,
        answer_bytes=said["bytes"] / number,
    )


def script(paced: bool) -> str:
    """The Lua program of wrk."""
    return _SCRIPT % {"threads": _THREADS, "paced": str(paced).lower()}


def _wrk(url: str, load: Load, seconds: int) -> dict[str, float]:
    program = load.lines.with_suffix(".lua")
    program.write_text(script(load.pause_ms > 0))
    command = ["wrk", f"-t{_THREADS}", f"-c{load.connections}", f"-d{seconds}s", "--timeout", "10s"]
    arguments = [str(load.lines), str(load.pause_ms), "POST" if load.posts else "GET", str(load.first), load.key]
    ran = subprocess.run(  # noqa: S603  # our own arguments
        [*command, "-s", str(program), url, "--", *arguments], capture_output=True, text=True, check=False
    )
    if ran.returncode:
        raise RuntimeError(f"wrk: {ran.stderr.strip() or ran.stdout.strip()}")
    said: dict[str, float] = json.loads(ran.stdout.strip().splitlines()[-1])
    return said
