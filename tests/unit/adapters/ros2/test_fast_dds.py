"""The node on DDS against another vendor's: Fast DDS, which most installations of ROS 2 speak, in a program that is built here.

It needs g++ and Debian's libfastrtps-dev; where these are unpacked elsewhere, UWSERVER_FASTDDS names the folder with their usr.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from adapter_rig import serving
from ros_rig import EPOCH_NS, PORTS, context, sample

pytest.importorskip("cyclonedds")

from uwserver_adapters.ros2 import Ros2Adapter
from uwserver_adapters.ros2.config import Ros2Config

pytestmark = pytest.mark.slow

DOMAIN = 190 + os.getpid() % 40
ROOT = Path(os.environ.get("UWSERVER_FASTDDS", "/"))
SOURCE = Path(__file__).with_name("fastdds_peer.cpp")


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    """The program and its environment."""
    include = ROOT / "usr/include"
    if shutil.which("g++") is None or not (include / "fastdds/dds").is_dir():
        pytest.skip("g++ or libfastrtps-dev is not installed")
    libraries = [str(ROOT / "usr/lib/x86_64-linux-gnu"), str(ROOT / "usr/lib")]
    built = tmp_path_factory.mktemp("fastdds") / "peer"
    places = [*(f"-L{place}" for place in libraries), *(f"-Wl,-rpath-link,{place}" for place in libraries)]
    command = [
        "g++",
        "-std=c++17",
        "-O0",
        f"-I{include}",
        f"-I{include}/x86_64-linux-gnu",
        str(SOURCE),
        "-o",
        str(built),
        *places,
        "-lfastrtps",
        "-lfastcdr",
    ]
    made = subprocess.run([*command, "-lpthread"], capture_output=True, timeout=300)
    assert made.returncode == 0, made.stderr.decode()[-2000:]
    return built, {**os.environ, "LD_LIBRARY_PATH": ":".join(libraries)} if Path("/") != ROOT else dict(os.environ)


@pytest.mark.parametrize(("distro", "range_"), [("humble", "subnet"), ("jazzy", "localhost"), ("jazzy", "subnet")])
def test_fast_dds_hears_and_steers(peer, distro, range_):
    """Also a node that looks for others as installations do by default, while the server looks on this machine alone."""
    program, environment = peer

    async def story():
        made = context()
        table = Ros2Config(transport="dds", allow_network=True, domain=DOMAIN, ros_distro=distro)
        async with serving(Ros2Adapter(table, made)):
            process = await asyncio.create_subprocess_exec(
                str(program), str(DOMAIN), range_, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
            )
            try:
                ended = asyncio.ensure_future(process.communicate())
                while not ended.done():
                    made.put([sample(PORTS["rov/imu"]), sample(PORTS["rov/autopilot/state"])])
                    await asyncio.wait({ended}, timeout=0.01)
                out, err = ended.result()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            assert process.returncode == 0, (err.decode(), made.stats)
            return json.loads(out.decode().splitlines()[-1]), made

    told, world = asyncio.run(asyncio.wait_for(story(), 90))
    assert told.pop("imus") >= 50
    assert told.pop("sec") >= EPOCH_NS // 10**9 - 10**9
    assert told == {"z": 9.81, "frame": "rov/base_link", "mode": "depth_hold"}
    assert world.commands[-1].value == ((0.1, 0.2, 0.3),)
    assert world.stats.errors == 0
