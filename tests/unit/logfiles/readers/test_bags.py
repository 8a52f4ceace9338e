"""Bags of ROS, written by rosbags."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uwserver.logfiles import LogError
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of

S = 1_000_000_000
UTC = 1_760_000_000 * S


def odometry(store, k):
    t = store.types
    header = {"seq": k} if "seq" in {n for n, _ in store.fielddefs["std_msgs/msg/Header"][1]} else {}
    stamp = t["builtin_interfaces/msg/Time"](sec=1, nanosec=k)
    point, quaternion = (
        t["geometry_msgs/msg/Point"](x=1.0 * k, y=2.0, z=-3.0),
        t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    vector = t["geometry_msgs/msg/Vector3"]
    pose = t["geometry_msgs/msg/PoseWithCovariance"](
        pose=t["geometry_msgs/msg/Pose"](position=point, orientation=quaternion), covariance=np.arange(36.0)
    )
    twist = t["geometry_msgs/msg/Twist"](linear=vector(x=1.0, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
    twist = t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    return t["nav_msgs/msg/Odometry"](
        header=t["std_msgs/msg/Header"](stamp=stamp, frame_id="odom", **header),
        child_frame_id="base",
        pose=pose,
        twist=twist,
    )


def bag1(path, compression=None, count=20):
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        for k in range(count):
            writer.write(connection, UTC + k * S, store.serialize_ros1(odometry(store, k), "nav_msgs/msg/Odometry"))
    return path


def bag2(path, storage=StoragePlugin.SQLITE3, mode=None, count=20, version=9):
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 depth\nstring[] names", "my_msgs/msg/Own"))
    with (
        Writer2(path, version=version, storage_plugin=storage)
        if mode is None
        else _compressed(path, storage, mode, version) as writer
    ):
        one = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        two = writer.add_connection("/own", "my_msgs/msg/Own", typestore=store)
        own = store.types["my_msgs/msg/Own"]
        for k in range(count):
            writer.write(one, UTC + k * S, store.serialize_cdr(odometry(store, k), "nav_msgs/msg/Odometry"))
            writer.write(two, UTC + k * S, store.serialize_cdr(own(depth=0.5 * k, names=["a", "b"]), "my_msgs/msg/Own"))
    return path


def _compressed(path, storage, mode, version):
    writer = Writer2(path, version=version, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    return writer


def check(log, kind):
    assert log.kind == kind
    assert log.topics["/odom"].count == 20
    assert (log.start_ns, log.end_ns, log.epoch_ns) == (0, 19 * S, UTC)
    fields = {f.name: f for f in log.topics["/odom"].fields}
    assert (fields["pose.pose.position.x"].type, fields["pose.pose.position.x"].unit) == ("float64", "m")
    assert fields["pose.covariance"].type == "float64[36]"
    data = list(log.read({"/odom"}, start_ns=5 * S, end_ns=7 * S))
    assert [d.t_ns for d in data] == [5 * S, 6 * S, 7 * S]
    assert data[0].value["pose"]["pose"]["position"] == {"x": 5.0, "y": 2.0, "z": -3.0}
    assert data[0].value["header"]["frame_id"] == "odom"
    track = pose_tracks(log, mapping_of(log))["odom"].track
    assert track.p_NB[4].tolist() == [2.0, 4.0, 3.0]


@pytest.mark.parametrize("compression", [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_ros_1(tmp_path, read_log, compression):
    check(read_log(bag1(tmp_path / "a.bag", compression)), "bag")


@pytest.mark.parametrize("mode", [None, CompressionMode.MESSAGE])
def test_ros_2_database(tmp_path, read_log, mode):
    log = read_log(bag2(tmp_path / "a", mode=mode))
    check(log, "rosbag2")
    assert next(log.read({"/own"})).value == {"depth": 0.0, "names": ["a", "b"]}


def test_ros_2_mcap_and_a_database_without_definitions(tmp_path, read_log):
    check(read_log(bag2(tmp_path / "a", StoragePlugin.MCAP)), "mcap")
    old = read_log(bag2(tmp_path / "b", version=8) / "b.db3")
    assert old.topics["/odom"].count == 20
    assert next(old.read({"/odom"})).value["pose"]["pose"]["position"]["y"] == 2.0


def test_files_that_are_compressed_as_a_whole_are_refused(tmp_path, read_log):
    with pytest.raises(LogError, match="zstd -d"):
        read_log(bag2(tmp_path / "a", mode=CompressionMode.FILE))


@pytest.mark.parametrize("compression", [Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_chunks_unpack_up_to_a_limit(tmp_path, read_log, compression):
    log = read_log(bag1(tmp_path / "a.bag", compression), record_bytes=1000)
    with pytest.raises(LogError, match="decompresses to more than 1000 bytes"):
        list(log.read())


def test_a_path_in_the_metadata_is_not_opened(tmp_path, read_log):
    outside = bag2(tmp_path / "outside") / "outside.db3"
    folder = bag2(tmp_path / "a")
    about = folder / "metadata.yaml"
    about.write_text(about.read_text().replace("a.db3", str(outside)))
    (folder / "a.db3").unlink()
    with pytest.raises(LogError, match="missing"):
        read_log(folder)


@pytest.mark.parametrize("make", ["bag", "db3"])
def test_damaged_bags_never_crash(tmp_path, read_log, make):
    file = bag1(tmp_path / "a.bag", count=5) if make == "bag" else bag2(tmp_path / "a", count=5) / "a.db3"
    raw = file.read_bytes()
    rng = np.random.default_rng(4)
    for k in range(60):
        hurt = bytearray(raw[: len(raw) - 100 * k] if k % 2 else raw)
        for at in rng.integers(20, len(hurt), 8):
            hurt[at] = int(rng.integers(0, 256))
        other = tmp_path / f"hurt{k}.{make}"
        other.write_bytes(hurt)
        try:
            times = [d.t_ns for d in read_log(other).read()]
        except LogError:
            continue
        assert times == sorted(times)


def test_a_folder_that_is_no_bag(tmp_path, read_log):
    with pytest.raises(LogError, match="not a ROS 2 bag"):
        read_log(tmp_path)
