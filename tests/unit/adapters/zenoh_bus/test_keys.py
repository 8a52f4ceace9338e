"""Keys to paths and back."""

from __future__ import annotations

import pytest
from uwserver_adapters.zenoh_bus.keys import BadName, KeyScheme

KEYS = KeyScheme("uw", "pool")


def test_keys_of_ports_and_services():
    assert KEYS.of("rov/imu") == "uw/pool/rov/imu"
    assert KEYS.path("uw/pool/rov/imu") == "rov/imu"
    assert KEYS.path(KEYS.of("world/pause")) == "world/pause"


@pytest.mark.parametrize("key", ["uw/other/rov/imu", "uw/pools/rov/imu", "uw/pool", "rov/imu", "", "uw/pool/@describe"])
def test_other_keys_have_no_path(key):
    assert KEYS.path(key) is None


def test_tokens():
    assert KEYS.alive() == "uw/pool/@alive"
    assert KEYS.alive("rov") == "uw/pool/@alive/rov"
    assert KEYS.alive("rov/imu") == "uw/pool/@alive/rov/imu"
    assert KEYS.identity("abc") == "uw/pool/@id/abc"
    assert KEYS.progress("c1", 7) == "uw/pool/@progress/c1/7"
    assert KEYS.error("c1", "rov/imu") == "uw/pool/@error/c1/rov/imu"


def test_a_prefix_of_several_levels():
    keys = KeyScheme("site/tank", "pool")
    assert keys.of("rov/imu") == "site/tank/pool/rov/imu"
    assert keys.path("site/tank/pool/rov/imu") == "rov/imu"


@pytest.mark.parametrize("name", ["", "a/b", "a*", "*", "a b", "a?", "a#", "a$b", "@pool", "a\n"])
def test_names_that_cannot_be_in_a_key(name):
    with pytest.raises(BadName, match="server"):
        KeyScheme("uw", name)


@pytest.mark.parametrize("prefix", ["", "/", "a//b", "/a", "a/", "**"])
def test_prefixes_that_cannot_be_in_a_key(prefix):
    with pytest.raises(BadName, match="prefix"):
        KeyScheme(prefix, "pool")
