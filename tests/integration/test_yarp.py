"""The how-to of YARP: by hand, on its text carrier; and with YARP's own tools, where `UWSERVER_YARP_BIN` names the folder that has them."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from nursery import python
from uwserver_bench.processes import Served, serving

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/yarp.md").read_text()
TOOLS = os.environ.get("UWSERVER_YARP_BIN", "")
PATIENCE_S = 60
SOCKETS = '[adapters.tcp]\nkind = "sockets"\nport = 0\n[server]\nweb = false\nmetrics = false\n'


def scenario(folder: Path, name_server: str) -> Path:
    (found,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    file = folder / "sea.toml"
    file.write_text(found.replace("127.0.0.1:10000", name_server) + SOCKETS)
    return file


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """No name server is there: peers that know the address do without."""
    with serving(scenario(tmp_path_factory.mktemp("yarp"), "127.0.0.1:9"), python=python()) as found:
        yield found


class Peer:
    """Somebody who types at a port."""

    def __init__(self, served: Served, name: str) -> None:
        status = served.ask('{"id":1,"method":"call","params":{"service":"world/status"}}')
        number = status["value"]["adapters"]["yarp"]["details"]["ports"][f"/uwserver/{name}"]
        self._socket = socket.create_connection((served.host, number), PATIENCE_S)
        self._lines = self._socket.makefile("rb")
        assert self.say("CONNECT /me") == "Welcome /me"

    def write(self, *lines: str) -> None:
        self._socket.sendall("".join(f"{line}\n" for line in lines).encode())

    def say(self, *lines: str) -> str:
        """Write, and give the next line."""
        self.write(*lines)
        return self._lines.readline().decode().strip()

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


def test_the_page_by_hand(served: Served) -> None:
    rpc = Peer(served, "world/rpc:i")
    assert "step [(n int)]" in rpc.say("d", "help")
    assert rpc.say("d", "pause") == "[ok]"
    imu = Peer(served, "heavy/imu:o")
    thrusters = Peer(served, "heavy/thrusters:i")
    assert thrusters.say("d", "(u (0 0 0 0 0.5 0.5 0.5 0.5))") == "[ok]"
    assert thrusters.say("d", "0 0 0 0 0.5 0.5 0.5 0.5") == "[ok]"
    assert thrusters.say("d", "1").startswith("[fail]")
    imu.write("r")
    admin = Peer(served, "heavy/imu:o")
    assert "(from" in admin.say("a", "[list] [out] /me")
    assert rpc.say("d", "step (n 8)") == "[ok]"
    command, bottle = imu.say(), imu.say()
    assert re.fullmatch(r"D \d+ [\d.]+", command)
    assert re.fullmatch(r"\(f_S \(.+\)\) \(w_S \(.+\)\) \(temperature [\d.]+\) \(valid 1\)", bottle)
    for peer in (rpc, imu, thrusters, admin):
        peer.close()


SCRIPT = """
ip link set lo up
export HOME={folder}
yarpserver --write --ip 127.0.0.1 --socket 10000 --portdb :memory: --subdb :memory: >{folder}/names.log 2>&1 &
NAMES=$!
HOME={home} {python} -m uwserver run {file} --port 0 >{folder}/server.log 2>&1 &
SERVER=$!
for i in $(seq 100); do yarp name list 2>/dev/null | grep -q world/rpc && break; sleep 0.2; done
yarp name list
for carrier in tcp fast_tcp text text_ack; do
  timeout 4 yarp read /r_$carrier envelope >{folder}/$carrier.txt 2>&1 &
done
sleep 1.5
for carrier in tcp fast_tcp text text_ack; do
  yarp connect /uwserver/heavy/imu:o /r_$carrier $carrier
done
sleep 0.5
yarp disconnect /uwserver/heavy/imu:o /r_tcp
echo "0 0 0 0 0.5 0.5 0.5 0.5" | yarp write /w /uwserver/heavy/thrusters:i
printf 'pause\\nstep (n 3)\\nresume\\nhelpp\\n' | yarp rpc /uwserver/world/rpc:i
echo "1 2" | yarp rpc /uwserver/heavy/thrusters:i
echo "[list] [out]" | yarp admin rpc /uwserver/heavy/imu:o
timeout 4 yarp read /t >{folder}/clock.txt 2>&1 &
sleep 1
yarp connect /uwserver/clock /t
sleep 1
grep -m1 -E "^[0-9]+ [0-9]+ *$" {folder}/clock.txt
for carrier in tcp fast_tcp text text_ack; do grep -c "f_S" {folder}/$carrier.txt; grep -m1 f_S {folder}/$carrier.txt; done
kill $SERVER; wait $SERVER
yarp name list; echo left
kill $NAMES; wait
"""


@pytest.mark.skipif(
    not TOOLS or not shutil.which("unshare"), reason="UWSERVER_YARP_BIN names no folder with yarp and yarpserver"
)
def test_the_page_with_yarps_own_tools(tmp_path: Path) -> None:
    """In a network of its own, as yarpserver takes no loopback address where there is another."""
    file = scenario(tmp_path, "127.0.0.1:10000")
    script = SCRIPT.format(folder=tmp_path, home=Path.home(), python=sys.executable, file=file)
    environment = {**os.environ, "PATH": f"{TOOLS}:{os.environ['PATH']}"}
    command = ["unshare", "--map-root-user", "--net", "sh", "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=180)
    said = done.stdout + done.stderr
    assert "registration name /uwserver/heavy/imu:o ip 127.0.0.1" in said, said
    assert said.count("Success: Added connection from /uwserver/heavy/imu:o") == 4, said
    assert "Success: Removed connection" in said
    assert said.count("Response: [ok]") == 3, said
    assert 'did you mean "help' in said or "no service helpp" in said
    assert "must be a list of 8" in said
    counts = [int(line) for line in said.splitlines() if line.isdigit()]
    assert len(counts) == 4, said
    assert min(counts) > 10, said
    assert len(re.findall(r"^\d+ [\d.]+ +\(f_S \(", said, re.MULTILINE)) == 4, said
    assert re.search(r"^\d+ \d{1,9} *$", said, re.MULTILINE), said
    before, _, after = said.partition("left")
    assert before.count("/uwserver/heavy/imu:o ip") == 1, said
    assert "/uwserver" not in after
