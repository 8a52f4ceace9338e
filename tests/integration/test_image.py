"""The container image, built here by buildah on a base made by debootstrap, and run from a read-only disk in a network of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TOOLS = ("buildah", "debootstrap", "unshare", "nsenter", "chroot", "ip")
BASE_PACKAGES = "python3.11,python3.11-venv,python3-distutils,ca-certificates"
BUILD_TIMEOUT_S, ANSWER_S = 1800.0, 60.0
LIMIT_MB = 900
TOKEN = "a-token-of-the-test"


def missing() -> str:
    """Why no image can be built here; empty when it can."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent:
        return f"no {', '.join(absent)}"
    if os.geteuid() != 0:
        return "a base image is made by root only"
    probe = subprocess.run(["unshare", "--mount", "--net", "mount", "--bind", "/mnt", "/mnt"], capture_output=True)
    return "" if probe.returncode == 0 else "no name spaces for mounts and network"


def run(*command: str | Path, timeout: float = BUILD_TIMEOUT_S) -> str:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, f"{command}: {done.stdout[-4000:]}{done.stderr[-4000:]}"
    return done.stdout


class PipSettings:
    """How pip finds packages on this machine: what a base image "with its own certificates and pip configuration" has."""

    def __init__(self) -> None:
        lines = run(sys.executable, "-m", "pip", "config", "debug").splitlines()
        stated = [line.strip().partition(", exists: ") for line in lines]
        self.files = [
            Path(file) for file, _, exists in stated if exists == "True" and Path(sys.prefix) not in Path(file).parents
        ]
        self.environment = {
            name: value
            for name, value in os.environ.items()
            if name.startswith("PIP_")
            or name.upper().endswith("_PROXY")
            or name in ("SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")
        }
        settings = (
            run(sys.executable, "-m", "pip", "config", "list").replace("'", " ").replace("=", " ").replace(",", " ")
        )
        named = {Path(word.removeprefix("file://")) for word in settings.split() if word.startswith(("/", "file:///"))}
        named |= {Path(value) for value in self.environment.values() if value.startswith("/")}
        self.files += [path for path in named if path.is_file()]
        # A local index is a folder "simple" that links to the files beside it.
        self.folders = [path.parent if path.name == "simple" else path for path in named if path.is_dir()]

    def copy_to(self, root: Path) -> None:
        for file in self.files:
            target = root / file.relative_to("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)


@dataclass(frozen=True)
class Image:
    """A built image, mounted.

    Attributes:
        root: its file system.
        config: entry point, command, environment, user, health check.
        megabytes: size of the files.
    """

    root: Path
    config: dict[str, Any]
    megabytes: float

    def command(self, *arguments: str, environment: dict[str, str] | None = None) -> list[str]:
        """Runs `arguments` in the image as its user, on a read-only disk without /tmp and without HOME, with its own loopback only."""
        variables = [*self.config["Env"], *(f"{k}={v}" for k, v in (environment or {}).items())]
        inside = ["chroot", f"--userspec={self.config['User']}", str(self.root), "env", "-i", *variables, *arguments]
        script = (
            'mount --bind "$0" "$0" && mount --bind /dev "$0/dev" && mount --bind /proc "$0/proc" && mount -o remount,ro,bind "$0"'
            ' && mount -t tmpfs -o ro none "$0/tmp" && ip link set lo up && exec "$@"'
        )
        return ["unshare", "--mount", "--net", "sh", "-c", script, str(self.root), *inside]


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Image]:
    reason = missing()
    if reason:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("image")
    buildah = ("buildah", "--root", folder / "store", "--runroot", folder / "run", "--storage-driver", "vfs")
    pip = PipSettings()
    try:
        run(*buildah, "from", "--name", "base", "scratch")
        root = Path(run(*buildah, "mount", "base").strip())
        run("debootstrap", "--variant=minbase", f"--include={BASE_PACKAGES}", "bookworm", root)
        for package in (root / "var/cache/apt/archives").glob("*.deb"):
            package.unlink()
        pip.copy_to(root)
        for name, value in pip.environment.items():
            run(*buildah, "config", "--env", f"{name}={value}", "base")
        run(*buildah, "commit", "--rm", "base", "localhost/base")
        volumes = [word for path in pip.folders for word in ("--volume", f"{path}:{path}:ro")]
        run(
            *buildah, "bud", "--isolation", "chroot", "--format", "docker", "--build-arg", "BASE=localhost/base", *volumes,
            "--tag", "uwserver-test", ROOT,
        )  # fmt: skip
        config = json.loads(run(*buildah, "inspect", "--type", "image", "uwserver-test"))["Docker"]["config"]
        run(*buildah, "from", "--name", "container", "localhost/uwserver-test")
        root = Path(run(*buildah, "mount", "container").strip())
        size = int(run("du", "-sm", root).split()[0])
        yield Image(root, config, size)
    finally:
        subprocess.run([*map(str, buildah), "rm", "--all"], capture_output=True, timeout=300)
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class Served:
    """A running container."""

    process: subprocess.Popen[str]
    log: Path

    def beside(self, *command: str) -> subprocess.CompletedProcess[str]:
        """A command of this machine (not of the image) in the container's network."""
        inside = ["nsenter", "--target", str(self.process.pid), "--net", *command]
        return subprocess.run(inside, capture_output=True, text=True, timeout=ANSWER_S)

    def until(self, text: str) -> str:
        """The log once it holds a text."""
        deadline = time.monotonic() + ANSWER_S
        while text not in self.log.read_text():
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.05)
        return self.log.read_text()


def served(image: Image, log: Path, environment: dict[str, str], arguments: Sequence[str] = ()) -> Iterator[Served]:
    inside = [*image.config["Entrypoint"], *(arguments or image.config["Cmd"])]
    command = image.command(*inside, environment=environment)
    with log.open("w") as out, subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield Served(process, log)
        finally:
            process.kill()


@pytest.fixture
def container(image: Image, tmp_path: Path) -> Iterator[Served]:
    yield from served(image, tmp_path / "log", {"UWSERVER_TOKEN": TOKEN})


@pytest.fixture
def container_without_token(image: Image, tmp_path: Path) -> Iterator[Served]:
    yield from served(image, tmp_path / "log", {})


def uwclient(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "uwclient", *arguments]


def test_is_small_and_has_no_example_models(image: Image) -> None:
    print(f"image: {image.megabytes} MB")
    assert image.megabytes < LIMIT_MB
    packages = image.root / "opt/uwserver/venv/lib/python3.11/site-packages"
    assert not (packages / "pybullet_data").exists()
    assert list(packages.glob("pybullet*.so"))


def test_runs_as_an_ordinary_user(image: Image) -> None:
    assert int(image.config["User"].partition(":")[0]) > 0


def test_kernels_are_ready_on_a_read_only_disk(image: Image) -> None:
    output = run(*image.command("python", "-m", "uwserver.physics.warm"))
    assert "kernels: were ready in /opt/uwserver/kernels" in output


def test_serves_a_client_from_outside_who_has_the_token(container: Served) -> None:
    text = container.until("Ctrl-C ends it")
    assert "compil" not in text
    answer = container.beside(*uwclient("--token", TOKEN, "echo", "bluerov2/depth", "-n", "2"))
    assert answer.returncode == 0, answer.stderr
    refused = container.beside(*uwclient("--token", "wrong", "topics"))
    assert refused.returncode == 1
    assert TOKEN not in text


def test_health_check_of_the_image_succeeds(image: Image, container: Served) -> None:
    container.until("Ctrl-C ends it")
    kind, *check = image.config["Healthcheck"]["Test"]
    assert kind == "CMD"
    environment = dict(variable.split("=", 1) for variable in image.config["Env"])
    inside = ["chroot", f"--userspec={image.config['User']}", str(image.root), "env", "-i"]
    answer = container.beside(*inside, *(f"{k}={v}" for k, v in environment.items()), *check)
    assert answer.returncode == 0, answer.stderr


def test_ends_on_sigterm(container: Served) -> None:
    container.until("Ctrl-C ends it")
    container.process.terminate()
    assert container.process.wait(timeout=ANSWER_S) == 0


def test_makes_a_token_and_prints_the_line_to_type(container_without_token: Served) -> None:
    text = container_without_token.until("Ctrl-C ends it")
    line = next(line for line in text.splitlines() if "uwclient" in line and "--token" in line)
    name, *arguments = line.split()
    assert name == "uwclient"
    answer = container_without_token.beside(*uwclient(*arguments))
    assert answer.returncode == 0, answer.stderr
    assert "bluerov2/depth" in answer.stdout


STATION = """
from pymavlink import mavutil
station = mavutil.mavlink_connection("udpin:127.0.0.1:14550", dialect="ardupilotmega", source_system=255)
beat = station.wait_heartbeat(timeout=40)
print("heard", beat.type, flush=True)
station.mav.command_long_send(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
print("version", station.recv_match(type="AUTOPILOT_VERSION", blocking=True, timeout=10).flight_sw_version >> 24, flush=True)
"""


@pytest.fixture
def rov(image: Image, tmp_path: Path) -> Iterator[Served]:
    yield from served(image, tmp_path / "log", {}, ("run", "bluerov2_qgc"))


def test_a_ground_station_in_its_network_hears_it_by_itself(rov: Served) -> None:
    rov.until("Ctrl-C ends it")
    answer = rov.beside(sys.executable, "-c", STATION)
    assert answer.stdout.split() == ["heard", "12", "version", "4"], answer.stderr


def test_holds_what_the_adapters_need(image: Image) -> None:
    imports = "import pymavlink, zenoh, pybullet, embreex; print('all')"
    assert run(*image.command("python", "-c", imports)).strip() == "all"
