"""The libraries that people use, unmodified: roslibpy, and roslib in node where npm can get it."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from adapter_rig import serving
from ros_rig import PORTS, context, flying, sample
from uwserver_adapters.rosbridge import RosbridgeAdapter
from uwserver_adapters.rosbridge.config import RosbridgeConfig

from uwserver.ports import Reply

ROSLIBPY = """
import json, sys, threading
import roslibpy
told = {}
ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
ros.run(timeout=60)
heard = threading.Event()
def hear(message):
    told["z"] = message["linear_acceleration"]["z"]
    heard.set()
listener = roslibpy.Topic(ros, "/rov/imu", "sensor_msgs/Imu", throttle_rate=10, queue_length=1)
listener.subscribe(hear)
assert heard.wait(60)
listener.unsubscribe()
told["topics"] = "/rov/imu" in ros.get_topics()
told["type"] = ros.get_topic_type("/rov/imu")
told["services"] = "/world/pause" in ros.get_services()
told["nodes"] = ros.get_nodes()
told["time"] = ros.get_time()["secs"]
told["param"] = ros.get_param("/nothing")
pause = roslibpy.Service(ros, "/world/pause", "std_srvs/Trigger")
told["pause"] = pause.call(roslibpy.ServiceRequest(), timeout=60)["success"]
talker = roslibpy.Topic(ros, "/rov/thrusters/cmd", "std_msgs/Float64MultiArray")
talker.advertise()
talker.publish(roslibpy.Message({"data": [0.1, 0.2, 0.3]}))
own = roslibpy.Service(ros, "/add", "example_interfaces/AddTwoInts")
def add(request, response):
    response["sum"] = request["a"] + request["b"]
    return True
own.advertise(add)
answered = threading.Event()
def summed(response):
    told["sum"] = response["sum"]
    answered.set()
roslibpy.Service(ros, "/add", "example_interfaces/AddTwoInts").call(roslibpy.ServiceRequest({"a": 2, "b": 3}), callback=summed)
assert answered.wait(60)
told["feedback"] = []
goto = roslibpy.ActionClient(ros, "/rov/goto", "uwserver_msgs/action/Goto")
moved, ended = threading.Event(), []
def moving(feedback):
    told["feedback"].append(feedback["progress"])
    moved.set()
goal = roslibpy.Goal({"pose": {"pose": {"position": {"x": 1.0, "y": 2.0, "z": -3.0}, "orientation": {"w": 0.0}}}, "speed": 0.5})
first = goto.send_goal(goal, ended.append, moving, print)
goto.wait_goal(first, 60)
assert moved.is_set()
told["first"] = [ended[0]["status"].value, ended[0]["values"]]
moved.clear()
second = goto.send_goal(goal, ended.append, moving, print)
assert moved.wait(60)
goto.cancel_goal(second)
goto.wait_goal(second, 60)
told["second"] = [ended[1]["status"].value, ended[1]["values"]["message"]]
failed = []
wrong = goto.send_goal(roslibpy.Goal({"place": 1}), print, print, failed.append)
goto.wait_goal(wrong, 60)
told["failed"] = failed[0]["values"]
print(json.dumps(told))
ros.terminate()
"""

ROSLIB = """
import * as ROSLIB from 'roslib';
const told = {};
const ros = new ROSLIB.Ros({ url: `ws://127.0.0.1:${process.argv[2]}` });
const once = (make) => new Promise((resolve, reject) => { setTimeout(() => reject(new Error('late: ' + make)), 20000); make(resolve, reject); });
await once((resolve, reject) => { ros.on('connection', resolve); ros.on('error', reject); });
// One that the subscription before still sent may come to the next one: roslib tells them apart by the topic alone.
const hear = (compression, more = {}, fits = () => true) => once((resolve) => {
  const topic = new ROSLIB.Topic({ ros, name: '/rov/lasers', messageType: 'sensor_msgs/LaserScan', compression, ...more });
  topic.subscribe((message) => { if (fits(message)) { topic.unsubscribe(); resolve(message); } });
});
told.plain = (await hear('none')).ranges[0];
told.throttled = (await hear('none', { throttle_rate: 10, queue_length: 2 })).ranges[0];
told.png = (await hear('png')).ranges[0];
const cbor = await hear('cbor', {}, (message) => ArrayBuffer.isView(message.ranges));
told.cbor = [cbor.ranges.constructor.name, cbor.ranges[0]];
const raw = await hear('cbor-raw', {}, (message) => message.bytes !== undefined);
told.raw = raw.bytes.length;
const service = (name, type) => new ROSLIB.Service({ ros, name, serviceType: type });
told.pause = await once((resolve, reject) => service('/world/pause', 'std_srvs/Trigger').callService({}, resolve, reject));
told.failed = await once((resolve) => service('/world/nothing', 'std_srvs/Trigger').callService({}, () => resolve('good'), resolve));
told.topics = await once((resolve, reject) => ros.getTopics((found) => resolve(found.topics.includes('/rov/lasers')), reject));
told.services = await once((resolve, reject) => ros.getServices((found) => resolve(found.includes('/world/pause')), reject));
told.nodes = await once((resolve, reject) => ros.getNodes(resolve, reject));
told.type = await once((resolve, reject) => ros.getTopicType('/rov/lasers', resolve, reject));
const talker = new ROSLIB.Topic({ ros, name: '/rov/thrusters/cmd', messageType: 'std_msgs/Float64MultiArray' });
talker.advertise();
talker.publish({ data: [0.1, 0.2, 0.3] });
const own = service('/add', 'example_interfaces/AddTwoInts');
own.advertise((request, response) => { response.sum = request.a + request.b; return true; });
await new Promise((resolve) => setTimeout(resolve, 200));  // it says so a moment later
told.sum = (await once((resolve, reject) => service('/add', 'example_interfaces/AddTwoInts').callService({ a: 2, b: 3 }, resolve, reject))).sum;
console.log(JSON.stringify(told));
ros.close();
setTimeout(() => process.exit(0), 100);
"""


def told_by(command, port_name, made=None, meanwhile=lambda: None, **options):
    """What a client says that runs beside the adapter, while samples flow and something happens; and the commands that came."""

    async def story(made=made):
        made = made or context()
        async with serving(RosbridgeAdapter(RosbridgeConfig(port=0), made)):
            port = made.stats.address.rpartition(":")[2]
            process = await asyncio.create_subprocess_exec(
                *command, port, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options
            )
            try:
                ended = asyncio.ensure_future(process.communicate())
                while not ended.done():
                    made.put([sample(PORTS[port_name])])
                    meanwhile()
                    await asyncio.wait({ended}, timeout=0.02)
                out, err = ended.result()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            assert process.returncode == 0, err.decode()
            return json.loads(out.decode().splitlines()[-1]), made

    return asyncio.run(asyncio.wait_for(story(), 120))


def test_roslibpy():
    pytest.importorskip("roslibpy")
    world = flying()

    def meanwhile():
        """The first goal arrives, the second is still on its way when it is cancelled."""
        goals = [call for call in world.calls if call.service == "rov/autopilot/goto"]
        if goals and not goals[-1].is_done:
            goals[-1].progress(0.5)
            if len(goals) == 1:
                goals[0].finish(Reply(1, 1, {"distance_m": 0.1}))

    told, _ = told_by([sys.executable, "-c", ROSLIBPY], "rov/imu", world, meanwhile)
    assert told.pop("time") >= world.world.epoch_ns // 10**9
    assert set(told.pop("feedback")) == {0.5}
    assert told.pop("failed").startswith("uwserver_msgs/action/Goto_Goal has no field 'place'")
    assert told == {
        "z": 9.81, "topics": True, "type": "sensor_msgs/msg/Imu", "services": True, "nodes": ["/uwserver"], "param": None, "pause": True,
        "sum": 5, "first": [4, {"success": True, "message": "", "distance": 0.1}], "second": [5, "cancelled by its caller"],
    }  # fmt: skip
    assert world.commands[-1].value == ((0.1, 0.2, 0.3),)


def test_the_program_of_the_page_runs():
    """docs/how-to/rosbridge.md, to the letter but for its port."""
    pytest.importorskip("roslibpy")
    page = (Path(__file__).parents[4] / "docs/how-to/rosbridge.md").read_text()
    program = page.split("```python\n")[1].split("```")[0]
    before = "import json, sys, threading\nsaid, count = [], threading.Semaphore(0)\ndef print(what):\n    said.append(what)\n    count.release()\n"
    after = "assert count.acquire(timeout=60) and count.acquire(timeout=60)\nsys.stdout.write(json.dumps(said, default=dict))\nros.terminate()\n"
    told, world = told_by(
        [sys.executable, "-c", before + program.replace("9090", "int(sys.argv[1])") + after], "rov/imu"
    )
    assert {"x": 0.1, "y": -0.2, "z": 9.81} in told
    assert {"success": True, "message": ""} in told
    # The vehicle of the test has three thrusters, that of the page eight: refused, and told so.
    assert world.stats.details["refused"] == {"bad_shape": 1}


@pytest.fixture(scope="session")
def roslib(tmp_path_factory):
    """A folder with roslib in it: that of UWSERVER_ROSLIB, or a fresh one of npm."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    named = os.environ.get("UWSERVER_ROSLIB")
    if named:
        return Path(named)
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed, and UWSERVER_ROSLIB names no folder with roslib in node_modules")
    folder = tmp_path_factory.mktemp("roslib")
    (folder / "package.json").write_text('{"private": true}')
    command = ["npm", "install", "--no-audit", "--no-fund", "--silent", "roslib@2.1.0"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.skip("npm did not get roslib within 60 s")
    if done.returncode:
        pytest.skip(f"npm cannot get roslib: {done.stderr.decode()[-200:]}")
    return folder


@pytest.mark.slow  # npm fetches it
def test_roslib_in_node(roslib):
    script = roslib / "client.mjs"
    script.write_text(ROSLIB)
    told, world = told_by(["node", str(script)], "rov/lasers", cwd=roslib)
    raw = told.pop("raw")
    assert raw > 60
    assert "no service" in str(told.pop("failed"))
    assert told == {
        "plain": 3, "throttled": 3, "png": 3, "cbor": ["Float32Array", 3], "pause": {"success": True, "message": ""}, "topics": True,
        "services": True, "nodes": ["/uwserver"], "type": "sensor_msgs/msg/LaserScan", "sum": 5,
    }  # fmt: skip
    assert world.commands[-1].value == ((0.1, 0.2, 0.3),)
