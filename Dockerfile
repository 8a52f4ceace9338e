# The server with everything that a scenario can ask for. BASE may be any Debian-like image with Python 3.11 and its venv module, for
# instance one with your own certificates and pip configuration: docker build --build-arg BASE=my-python:3.11 .
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS builder
# `generic`: the kernels are compiled here and run on any CPU of the architecture. Both stages must say so, and the same folder.
ENV NUMBA_CACHE_DIR=/opt/uwserver/kernels \
    NUMBA_CPU_NAME=generic \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1
# `strip` is in binutils.
RUN apt-get update \
    && apt-get install -y --no-install-recommends binutils \
    && rm -rf /var/lib/apt/lists/*
# Every version is pinned (`make lock`), that of what builds the wheels of the sources too; so two builds of one commit hold the same.
COPY requirements.lock /
RUN python3.11 -m venv /opt/uwserver/venv \
    && /opt/uwserver/venv/bin/pip install --require-hashes -r /requirements.lock
COPY . /src
# Example models, tests, symbols for debugging and the installer itself are more than half of the size. Only libraries without others that
# come along in a folder `.libs` are stripped: those were patched when their wheels were made, and do not stand it.
RUN /opt/uwserver/venv/bin/pip install --no-deps --no-build-isolation /src /src/clients/python \
    && /opt/uwserver/venv/bin/pip uninstall -y hatchling pathspec pluggy tomlkit trove-classifiers lxml pip setuptools \
    && cd /opt/uwserver/venv/lib/python3.11/site-packages \
    && rm -rf pybullet_data pybullet_envs pybullet_examples pybullet_robots pybullet_utils eglRenderer.*.so \
    && rm -rf pkg_resources _distutils_hack distutils-precedence.pth matplotlib/mpl-data/sample_data \
    && find pymavlink -name "*.xml" -delete && rm -rf pymavlink/generator \
    && find pymavlink/dialects -name "*.py" ! -name __init__.py ! -path "*/v20/ardupilotmega.py" ! -path "*/v20/common.py" \
        ! -path "*/v20/development.py" -delete \
    && find . -type d -name tests -prune -exec rm -rf {} + \
    && find $(ls -d pybullet.*.so) llvmlite uvloop zstandard zenoh kiwisolver fontTools lz4 -name "*.so" -exec strip --strip-unneeded {} + \
    && find /opt/uwserver -type d -name __pycache__ -prune -exec rm -rf {} +
# Compiles the kernels, and writes the byte code of what a server imports; so the run-time stage starts at once from a read-only disk.
WORKDIR /tmp
RUN /opt/uwserver/venv/bin/python -m uwserver.world.warm \
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
# Keeps the times of the files: Python compares them with those of the sources.
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
