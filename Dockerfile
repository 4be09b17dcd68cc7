# The obstacle service. Build: docker build -t headsup .   Run: see docker-compose.yml and docs/operations.md.
FROM python:3.11.14-slim-trixie AS wheel
WORKDIR /build
COPY . .
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.11.14-slim-trixie
ENV PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    HEADSUP_HOST=0.0.0.0 \
    HEADSUP_PORT=8000 \
    HEADSUP_DATABASE_URL=sqlite+aiosqlite:////data/headsup.sqlite3
COPY requirements-server.lock /tmp/requirements-server.lock
RUN pip install --no-cache-dir --require-hashes -r /tmp/requirements-server.lock
COPY --from=wheel /wheels /wheels
RUN pip install --no-cache-dir --no-deps /wheels/*.whl \
    && groupadd --system --gid 10001 headsup \
    && useradd --system --uid 10001 --gid headsup --home-dir /data headsup \
    && install --directory --owner headsup --group headsup --mode 0700 /data
USER 10001:10001
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=20s \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/healthz', timeout=2)"]
STOPSIGNAL SIGTERM
CMD ["headsup", "serve"]
