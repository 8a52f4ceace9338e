"""What a notebook shows by itself: a world, a reading, a picture of a camera, and where clients are served."""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ET
import zlib

import numpy as np
import pytest

import uwserver
from uwserver.ports import Buffer, Field, Port, Sample
from uwserver.world.sensing.reading import Reading


def pictures(page: str) -> list[ET.Element]:
    return [ET.fromstring(text) for text in re.findall(r"<svg.*?</svg>", page)]


def corners_of(picture: ET.Element, fill: str) -> list[np.ndarray]:
    """(n, 2) the corners, pixels, of each polygon of a colour."""
    found = [each for each in picture.iter() if each.tag.endswith("polygon") and each.get("fill") == fill]
    return [np.array([point.split(",") for point in each.get("points").split()], dtype=float) for each in found]


BODY, GROUND = "#e0a030", "#cbb994"


def test_a_world_shows_where_its_bodies_are_from_two_sides():
    with uwserver.load("push_the_crate") as world:
        world.vehicles["crate"].set_state(p_NB=(3.0, 2.0, 9.0))
        world.vehicles["rov"].set_state(p_NB=(0.0, 0.0, 8.0))
        page = world._repr_html_()
        above, side = pictures(page)
        rov, crate = (points.mean(axis=0) for points in corners_of(above, BODY))
        assert crate[0] > rov[0], "east is right"
        assert crate[1] < rov[1], "north is up"
        rov, crate = (points.mean(axis=0) for points in corners_of(side, BODY))
        assert crate[0] > rov[0], "north is right"
        assert crate[1] > rov[1], "down is down"
        (ground,) = corners_of(side, GROUND)
        assert ground[:, 1].min() > crate[1], "the bottom is below"
        assert "<td>bluerov2_heavy</td>" in page
        assert ">crate</text>" in page
        assert "3.00</td>" in page


def test_turning_a_body_turns_its_outline():
    def size(yaw: float) -> np.ndarray:
        with uwserver.load("remus_survey") as world:
            world.vehicles["auv"].set_state(rpy=(0.0, 0.0, yaw))
            (points,) = corners_of(pictures(world._repr_html_())[0], BODY)
            return np.ptp(points, axis=0)

    assert size(0.0)[1] > 3 * size(0.0)[0]
    assert size(np.pi / 2)[0] > 3 * size(np.pi / 2)[1]


@pytest.mark.parametrize("scenario", ["slope", "swarm_100", "bluerov2_open_sea"])
def test_other_grounds_many_bodies_and_spawned_ones(scenario):
    with uwserver.load(scenario) as world:
        page = world._repr_html_()
        assert len(pictures(page)) == 2
        bodies = len(world.vehicles)
        assert len(corners_of(pictures(page)[0], BODY)) == bodies
        assert ("and 92 more" in page) == (bodies == 100)


def test_a_reading_shows_its_values_with_units():
    with uwserver.load("bluerov2_pool") as world:
        world.step(240)
        page = world.read("bluerov2/imu")._repr_html_()
        assert "bluerov2/imu at " in page
        assert re.search(r"<td>f_S</td><td>\(.*, .*, -9\.\d+\)</td><td>m/s\^2</td>", page)
        assert world.read("bluerov2/imu")._repr_png_() is None


def reading(array: np.ndarray) -> Reading:
    port = Port("rov/camera", "sensor", "camera", (Field("image", "1", "picture", type="buffer"),), "A camera.")
    return Reading(port, Sample("rov/camera", 0, 0, 0, True, (Buffer.of(array),)))


def decoded(png: bytes) -> tuple[tuple[int, ...], bytes]:
    """The header of a PNG without a palette, and the bytes of its rows, each after that of its filter."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    place, data, header = 8, b"", ()
    while place < len(png):
        size, name = struct.unpack(">I4s", png[place : place + 8])
        body = png[place + 8 : place + 8 + size]
        assert zlib.crc32(name + body) == struct.unpack(">I", png[place + 8 + size : place + 12 + size])[0]
        header = struct.unpack(">IIBBBBB", body) if name == b"IHDR" else header
        data += body if name == b"IDAT" else b""
        place += 12 + size
    return header, zlib.decompress(data)


def test_a_picture_shows_itself():
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    shown = reading(image)
    assert shown._repr_html_() is None
    header, rows = decoded(shown._repr_png_())
    assert header == (3, 2, 8, 2, 0, 0, 0)
    assert rows == b"".join(b"\0" + row.tobytes() for row in image)
    assert shown.image._repr_png_() == shown._repr_png_()


def test_distances_and_grey_pictures_show_themselves_and_other_buffers_do_not():
    header, rows = decoded(reading(np.array([[1000, 0]], dtype=np.uint16))._repr_png_())
    assert header[:4] == (2, 1, 8, 0)
    assert rows[1] > 200, "what is near is bright"
    assert rows[2] == 0, "nothing is black"
    assert reading(np.zeros(7, dtype=np.uint8))._repr_png_() is None
    assert reading(np.zeros((2, 2), dtype=np.float32))._repr_png_() is None


def test_where_clients_are_served_is_a_link():
    with uwserver.load("bluerov2_pool") as world, world.view(opens=False, port=0) as page:
        assert f'<a href="{page.address}"' in page._repr_html_()
        assert world.serve("sockets")._repr_html_().startswith("sockets: 127.0.0.1:")
