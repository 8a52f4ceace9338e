"""The container image, built here by buildah on a base made by debootstrap, and run from a read-only disk in a network of its own."""

from __future__ import annotations

import json
import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from uwserver.scenario.files.documents import shipped

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TOOLS = ("buildah", "debootstrap", "unshare", "nsenter", "chroot", "ip")
BASE_PACKAGES = "python3.11,python3.11-venv,python3-distutils,ca-certificates"
BUILD_TIMEOUT_S, ANSWER_S = 1800.0, 60.0
LIMIT_MB = 700
START_CPU_S = 4.0
"""Most processor time from the start to the first tick; to compile the kernels of one scenario takes twenty."""
SITE = "opt/uwserver/venv/lib/python3.11/site-packages"
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

    def command(
        self,
        *arguments: str,
        environment: dict[str, str] | None = None,
        first: bool = False,
        volumes: Mapping[str, Path] | None = None,
    ) -> list[str]:
        """Runs `arguments` in the image as its user, on a read-only disk without /tmp and without HOME, with its own loopback only.

        Args:
            arguments: command and its arguments.
            environment: more variables than those of the image.
            first: as process 1 of a name space, to which no signal comes that it does not handle.
            volumes: folders that are mounted and may be written, by their places in the image.
        """
        variables = [*self.config["Env"], *(f"{k}={v}" for k, v in (environment or {}).items())]
        inside = ["chroot", f"--userspec={self.config['User']}", str(self.root)]
        inside += ["env", "-i", f"--chdir={self.config['WorkingDir']}", *variables, *arguments]
        mounted = "".join(
            f' && mkdir -p "$0{place}" && mount --bind {shlex.quote(str(folder))} "$0{place}"'
            for place, folder in (volumes or {}).items()
        )
        script = (
            f'mount --bind "$0" "$0" && mount --bind /dev "$0/dev" && mount --bind /proc "$0/proc"{mounted} && mount -o remount,ro,bind "$0"'
            ' && mount -t tmpfs -o ro none "$0/tmp" && ip link set lo up && exec "$@"'
        )
        spaces = ["--mount", "--net", *(["--pid", "--fork", "--kill-child"] if first else [])]
        return ["unshare", *spaces, "sh", "-c", script, str(self.root), *inside]


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
        # As the images of the field's registries are: without manuals, translations, and lists of packages.
        for left in (
            "var/cache/apt/archives",
            "var/lib/apt/lists",
            "usr/share/doc",
            "usr/share/man",
            "usr/share/locale",
        ):
            for path in (root / left).iterdir():
                path.unlink() if path.is_symlink() or not path.is_dir() else shutil.rmtree(path)
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


def served(
    image: Image,
    log: Path,
    environment: dict[str, str],
    arguments: Sequence[str] = (),
    volumes: Mapping[str, Path] | None = None,
) -> Iterator[Served]:
    inside = [*image.config["Entrypoint"], *(arguments or image.config["Cmd"])]
    command = image.command(*inside, environment=environment, volumes=volumes)
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
    packages = image.root / SITE
    assert not (packages / "pybullet_data").exists()
    assert [path.stat().st_size < 20e6 for path in packages.glob("pybullet.*.so")] == [True], "debug information"


def test_holds_the_locked_versions_and_nothing_that_builds(image: Image) -> None:
    entries = (ROOT / "requirements.lock").read_text().replace("\\\n", "").splitlines()
    locked = {entry.partition(" ")[0].lower() for entry in entries}
    code = "from importlib.metadata import distributions as d; print(*(f'{x.name}=={x.version}' for x in d()))"
    there = {
        each.lower().replace("_", "-")
        for each in run(*image.command("python", "-c", code)).split()
        if not each.startswith(("uwserver", "uwclient"))
    }
    assert len(there) > 20
    assert there <= locked
    assert not {each.partition("==")[0] for each in there} & {"pip", "setuptools", "hatchling"}


def test_runs_as_an_ordinary_user(image: Image) -> None:
    assert int(image.config["User"].partition(":")[0]) > 0


def test_kernels_are_ready_on_a_read_only_disk(image: Image) -> None:
    output = run(*image.command("python", "-m", "uwserver.world.warm"))
    assert "kernels: were ready in /opt/uwserver/kernels" in output


def test_starts_from_a_read_only_disk_without_compiling(image: Image) -> None:
    arguments = ("uwserver", "run", "--port", "0", "--mode", "freerun", "--until", "0.01")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = run(*image.command(*arguments))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"started with {spent:.1f} s of processor time")
    assert "compil" not in output
    assert spent < START_CPU_S


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


def catches(status: Path, number: int) -> bool:
    """Whether a process handles a signal, by its /proc/PID/status."""
    found = re.search(r"^SigCgt:\s*([0-9a-f]+)$", status.read_text(), re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> (number - 1) & 1)


def test_sigterm_before_it_serves_ends_the_first_process_of_a_container(image: Image) -> None:
    """Sent as soon as it is handled, which is before the imports: long before a server could be asked to end."""
    command = image.command("uwserver", "run", "--port", "0", environment={"UWSERVER_TOKEN": TOKEN}, first=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            children, deadline = Path(f"/proc/{process.pid}/task/{process.pid}/children"), time.monotonic() + ANSWER_S
            while not (
                (pids := children.read_text().split()) and catches(Path(f"/proc/{pids[0]}/status"), signal.SIGTERM)
            ):
                assert time.monotonic() < deadline
                time.sleep(0.002)
            ticks = Path(f"/proc/{pids[0]}/stat").read_text().rpartition(")")[2].split()[11:13]
            os.kill(int(pids[0]), signal.SIGTERM)
            output, _ = process.communicate(timeout=ANSWER_S)
        finally:
            process.kill()
    assert process.returncode == 128 + signal.SIGTERM
    assert "Ctrl-C" not in output
    spent = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    assert spent < 0.5, "s of processor time until a signal is handled"


def test_makes_a_token_and_prints_the_lines_to_type(container_without_token: Served) -> None:
    text = container_without_token.until("Ctrl-C ends it")
    lines = [line for line in text.splitlines() if "uwclient" in line]
    assert [line.split()[-1] for line in lines if line.endswith(" topics")] == ["topics"]
    for line in lines[:2]:
        name, *arguments = shlex.split(line)
        assert name == "uwclient"
        assert "--token" in arguments
        more = ["--seconds", "0.5"] if "watch" in arguments else []
        answer = container_without_token.beside(*uwclient(*arguments, *more))
        assert answer.returncode == 0, answer.stderr
    assert "bluerov2/depth" in container_without_token.beside(*uwclient(*shlex.split(lines[0])[1:])).stdout


@pytest.mark.parametrize("scenario", sorted(shipped()))
def test_each_shipped_scenario_is_served(image: Image, tmp_path: Path, scenario: str) -> None:
    checked = run(*image.command("uwserver", "check", scenario))
    assert "not installed" not in checked
    for server in served(image, tmp_path / "log", {}, ("run", scenario)):
        assert "compil" not in server.until("Ctrl-C ends it")
        server.process.terminate()
        assert server.process.wait(timeout=ANSWER_S) == 0


def test_doctor_misses_nothing(image: Image) -> None:
    text = run(*image.command("uwserver", "doctor", "bluerov2_px4"))
    assert "pip install" not in text
    assert "not installed" not in text


SEABED = """
import h5netcdf, numpy
with h5netcdf.File("/records/bed.nc", "w") as file:
    file.dimensions = {"lat": 9, "lon": 9}
    file.create_variable("lat", ("lat",), data=63.0 + 0.01 * numpy.arange(9.0))
    file.create_variable("lon", ("lon",), data=10.0 + 0.01 * numpy.arange(9.0))
    file.create_variable("elevation", ("lat", "lon"), data=numpy.full((9, 9), -20.0))
"""
NETCDF_SCENARIO = """
schema = 1
[server]
uvloop = true
[seabed]
kind = "grid"
file = "bed.nc"
extent_m = 500.0
[world]
origin_lat_deg = 63.04
origin_lon_deg = 10.04
[vehicles.rov]
model = "bluerov2"
[vehicles.rov.sensors.altimeter]
kind = "altimeter"
rate_hz = 10
[adapters.tcp]
kind = "sockets"
port = 0
"""


def test_reads_netcdf_and_serves_by_uvloop(image: Image, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    run(*image.command("python", "-c", SEABED, volumes={"/records": tmp_path}))
    (tmp_path / "it.toml").write_text(NETCDF_SCENARIO)
    run(
        *image.command(
            "uwserver", "run", "/records/it.toml", "--until", "0.5", "--mode", "freerun", volumes={"/records": tmp_path}
        )
    )


def test_draws_a_picture(image: Image, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    run(
        *image.command(
            "uwserver", "plot", "vehicle", "bluerov2", "-o", "/records/rov.png", volumes={"/records": tmp_path}
        )
    )
    assert (tmp_path / "rov.png").read_bytes().startswith(b"\x89PNG")


def test_replays_what_was_recorded_outside_bit_for_bit(image: Image, tmp_path: Path) -> None:
    """With contacts: the engine of the image is stripped, and its kernels are made for any CPU."""
    tmp_path.chmod(0o777)
    recording = tmp_path / "push.mcap"
    outside = (sys.executable, "-m", "uwserver", "run", "push_the_crate", "--port", "0", "--mode", "freerun")
    run(*outside, "--until", "5", "--record", recording)
    recording.chmod(0o644)
    assert "hashes equal" in run(
        *image.command("uwserver", "replay", "/records/push.mcap", volumes={"/records": tmp_path})
    )


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


TANK = """
schema = 1
[vehicles.rov]
model = "bluerov2"
[adapters.tcp]
kind = "sockets"
"""


def test_the_commands_of_the_page_run(image: Image, tmp_path: Path) -> None:
    """All `docker run` of docs/how-to/container.md in their order, with its folder mounted as each says."""
    text = (ROOT / "docs/how-to/container.md").read_text().replace("\\\n", "")
    lines = [shlex.split(line.partition("#")[0]) for line in text.splitlines() if line.startswith("docker run --rm")]
    assert len(lines) > 8
    tmp_path.chmod(0o777)
    (tmp_path / "records").mkdir()
    (tmp_path / "records").chmod(0o777)
    (tmp_path / "tank.toml").write_text(TANK)
    for words in lines:
        options, arguments = words[: words.index("uwserver")], words[words.index("uwserver") + 1 :]
        mounts = [word.split(":") for flag, word in pairwise(options) if flag == "-v"]
        volumes = {place: Path(folder.replace("$PWD", str(tmp_path))) for folder, place, *_ in mounts}
        environment = {"UWSERVER_TOKEN": TOKEN} if "UWSERVER_TOKEN" in options else {}
        if arguments and arguments[0] != "run":
            at = next((word for flag, word in pairwise(options) if flag == "-w"), image.config["WorkingDir"])
            named = [word if (word[0] in "/-" or "." not in word) else f"{at}/{word}" for word in arguments]
            run(*image.command("uwserver", *named, volumes=volumes))
            continue
        for server in served(image, tmp_path / "log", environment, arguments, volumes):
            server.until("Ctrl-C ends it")
            time.sleep(1.0 if "--record" in arguments else 0.0)
            server.process.terminate()
            assert server.process.wait(timeout=ANSWER_S) == 0
