# The server with everything that a scenario can ask for. BASE may be any Debian-like image with Python 3.11 and its venv module, for
# instance one with your own certificates and pip configuration: docker build --build-arg BASE=my-python:3.11 .
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS builder
# `generic`: the kernels are compiled here and run on any CPU of the architecture. Both stages must say so, and the same folder.
ENV NUMBA_CACHE_DIR=/opt/uwserver/kernels \
    NUMBA_CPU_NAME=generic \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1
# pybullet has wheels for x86-64 only; elsewhere it is compiled.
RUN test "$(uname -m)" = x86_64 \
    || { apt-get update && apt-get install -y --no-install-recommends g++ python3-dev && rm -rf /var/lib/apt/lists/*; }
COPY . /src
RUN python3.11 -m venv /opt/uwserver/venv \
    && /opt/uwserver/venv/bin/pip install "/src[solid,mavlink,zenoh]" "/src/clients/python[msgpack]" \
    && cd /opt/uwserver/venv/lib/python3.11/site-packages \
    # Example models, tests and the installer itself: a third of the size.
    && rm -rf pybullet_data pybullet_envs pybullet_examples pybullet_robots pybullet_utils \
    && rm -rf pip pip-*.dist-info setuptools setuptools-*.dist-info pkg_resources _distutils_hack distutils-precedence.pth \
    && find pymavlink/dialects -name "*.py" ! -name __init__.py ! -path "*/v20/ardupilotmega.py" ! -path "*/v20/development.py" -delete \
    && rm -rf pymavlink/generator lxml lxml-*.dist-info \
    && find numpy numba llvmlite scipy trimesh -type d -name tests -prune -exec rm -rf {} + \
    && find /opt/uwserver -type d -name __pycache__ -prune -exec rm -rf {} +
# Compiles the kernels, and writes the byte code of what a server imports; so the run-time stage starts at once from a read-only disk.
WORKDIR /tmp
RUN /opt/uwserver/venv/bin/python -m uwserver.physics.warm \
    && /opt/uwserver/venv/bin/uwserver run --port 0 --mode freerun --until 1 \
    && /opt/uwserver/venv/bin/uwclient --help > /dev/null \
    && /opt/uwserver/venv/bin/python -c "from uwserver_adapters.mavlink.wire.dialect import Dialect; Dialect()" \
    && chmod -R a+rX /opt/uwserver

FROM ${BASE}
LABEL org.opencontainers.image.title="uwserver" \
      org.opencontainers.image.licenses="BSD-3-Clause"
ENV PATH=/opt/uwserver/venv/bin:$PATH \
    NUMBA_CACHE_DIR=/opt/uwserver/kernels \
    NUMBA_CPU_NAME=generic \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
# Keeps the times of the files: numba and Python compare them with those of the sources.
COPY --from=builder /opt/uwserver /opt/uwserver
# An owner without a name suffices: nothing of the image is written at run time.
RUN mkdir -p /records && chown 10001:10001 /records
USER 10001:10001
WORKDIR /records
EXPOSE 7600 9600
HEALTHCHECK --interval=10s --timeout=5s --start-period=15s --retries=3 \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:9600/health', timeout=4)"]
ENTRYPOINT ["uwserver"]
CMD ["run", "--bind", "0.0.0.0", "--metrics-bind", "0.0.0.0"]
