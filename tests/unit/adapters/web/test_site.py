"""What can be asked by HTTP, by whom, and what no page of another origin gets. Also of uwserver.testing.fake_scene."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import gzip
import hashlib
import json
import time
from pathlib import Path

import pytest
from uwserver_adapters.web import connection, site
from uwserver_adapters.web.site import Files, StaticFile, static_file
from web_rig import Stage, play

IMPORT_MAP = b'{"imports":{"three":"./vendor/three.js"}}'
PAGE = b'<!doctype html><title>x</title><script type="importmap">' + IMPORT_MAP + b"</script>" + b"<p>" * 200


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of a page, and what must not be served beside them."""
    web = tmp_path / "web"
    (web / "vendor").mkdir(parents=True)
    (web / "index.html").write_bytes(PAGE)
    (web / "main.js").write_text("export const x = 1;\n")
    (web / "vendor" / "three.js").write_text("export {};\n" * 200)
    (web / ".hidden.js").write_text("no")
    (web / "notes.toml").write_text("no")
    (tmp_path / "secret.txt").write_text("secret")
    (web / "link.txt").symlink_to(tmp_path / "secret.txt")
    monkeypatch.setattr(connection, "page_folder", lambda: web)
    return web


def test_the_page_and_its_files(folder: Path) -> None:
    async def scene(stage: Stage) -> None:
        page = await stage.get("/")
        assert (page.status, page.body) == (200, PAGE)
        assert page.headers["content-type"].startswith("text/html")
        assert (await stage.get("/main.js?v=2")).headers["content-type"].startswith("text/javascript")
        three = await stage.get("/vendor/three.js", Accept_Encoding="br, gzip")
        assert three.headers["content-encoding"] == "gzip"
        assert gzip.decompress(three.body) == (folder / "vendor" / "three.js").read_bytes()
        assert len(three.body) < 100
        again = await stage.get("/vendor/three.js", If_None_Match=three.headers["etag"])
        assert (again.status, again.body) == (304, b"")
        head = await stage.get("/main.js", "HEAD")
        assert (head.status, head.body, head.headers["content-length"]) == (200, b"", "20")

    play(scene)


@pytest.mark.parametrize(
    "path",
    ["/../secret.txt", "/%2e%2e/secret.txt", "/link.txt", "/.hidden.js", "/notes.toml", "/vendor", "/vendor/", "//etc/passwd",
     "/main.js/", "/mesh/../main.js", "/mesh/" + 64 * "0" + ".bin"],
)  # fmt: skip
def test_nothing_but_the_files_of_the_page_is_served(folder: Path, path: str) -> None:
    async def scene(stage: Stage) -> None:
        answer = await stage.get(path)
        assert answer.status == 404
        assert b"secret" not in answer.body

    play(scene)


def test_files_that_come_later_are_not_served(folder: Path) -> None:
    files = Files(folder)
    assert files.has("/main.js")
    (folder / "later.js").write_text("no")
    assert not files.has("/later.js")


def test_a_page_may_do_nothing_beyond_its_server(folder: Path) -> None:
    async def scene(stage: Stage) -> None:
        headers = (await stage.get("/")).headers
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        digest = base64.b64encode(hashlib.sha256(IMPORT_MAP).digest()).decode()
        assert policy["script-src"] == f"'self' 'sha256-{digest}'"
        assert policy["frame-ancestors"] == "'none'"
        assert policy["default-src"] == "'self'"
        # The pictures of a .glb file are fetched from a blob that the page made of it.
        assert policy["connect-src"] == "'self' blob:"
        for answer in (await stage.get("/"), await stage.get("/world.json"), await stage.get("/nothing")):
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["cross-origin-resource-policy"] == "same-origin"
            assert not [name for name in answer.headers if name.startswith("access-control")]

    play(scene)


def test_pages_that_may_frame_the_view_are_named() -> None:
    async def scene(stage: Stage) -> None:
        policy = (await stage.get("/")).headers["content-security-policy"]
        assert policy.endswith("frame-ancestors https://ours.example")

    play(scene, frame_ancestors=("https://ours.example",))


@pytest.mark.parametrize(
    ("host", "status"),
    [("127.0.0.1:7680", 200), ("localhost", 200), ("[::1]:9", 200), ("sim.example:80", 200), ("SIM.example", 200),
     ("evil.example", 421), ("127.0.0.1.evil.example", 421), ("", 421), ("127.0.0.1:7680@evil.example", 421),
     ("[::1]evil.example", 421), ("127.0.0.1:7680:evil.example", 421)],
)  # fmt: skip
@pytest.mark.parametrize("path", ["/", "/world.json", "/health"])
def test_names_that_were_made_to_point_here_get_nothing(host: str, status: int, path: str) -> None:
    async def scene(stage: Stage) -> None:
        assert (await stage.get(path, Host=host)).status == status

    play(scene, allowed_hosts=("sim.example",))


@pytest.mark.parametrize("method", ["POST", "PUT", "OPTIONS", "DELETE"])
def test_only_get_and_head(method: str) -> None:
    async def scene(stage: Stage) -> None:
        for path in ("/", "/world.json", "/live"):
            answer = await stage.get(path, method)
            assert (answer.status, answer.headers["allow"]) == (405, "GET, HEAD")

    play(scene)


@pytest.mark.parametrize("site", ["cross-site", "same-site", "weird"])
def test_a_browser_fetches_data_for_our_own_page_alone(site: str) -> None:
    async def scene(stage: Stage) -> None:
        assert (await stage.get("/world.json", Sec_Fetch_Site=site)).status == 403
        assert (await stage.get("/", Sec_Fetch_Site=site)).status == 200, "who follows a link comes from elsewhere"
        assert (await stage.get("/world.json", Sec_Fetch_Site="same-origin")).status == 200

    context = play(scene)
    assert context.stats.details["refused"] == {"origin": 1}


def test_with_a_token_all_but_the_page_needs_it() -> None:
    async def scene(stage: Stage) -> None:
        assert (await stage.get("/")).status == 200
        for path in ("/world.json", "/health", "/mesh/" + 64 * "0" + ".bin", "/looks/" + 64 * "0" + ".glb", "/nothing"):
            bare = await stage.get(path)
            assert (bare.status, bare.headers["www-authenticate"]) == (401, "Bearer")
            assert (await stage.get(path, Authorization="Bearer wrong")).status == 401
            assert (await stage.get(path, Authorization="Basic sesame")).status == 401
        for token in ("sesame", "peek"):
            assert (await stage.get("/world.json", Authorization=f"Bearer {token}")).status == 200
        assert (await stage.get("/world.json?token=sesame")).status == 401, "a token in a query would be in every log"

    play(scene, token="sesame", view_token="peek")


def test_who_tries_tokens_is_not_heard_for_a_while() -> None:
    async def scene(stage: Stage) -> None:
        for n in range(11):
            assert (await stage.get("/world.json", Authorization=f"Bearer {n}")).status == 401
        late = await stage.raw(b"GET /world.json HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer sesame\r\n\r\n")
        assert b"200 OK" not in late

    assert play(scene, token="sesame").stats.details["refused"]["lockout"] == 1  # type: ignore[index,call-overload]


@pytest.mark.parametrize(
    "said",
    [b"GET / HTTP/1.1\r\nHost 127.0.0.1\r\n\r\n", b"GET / / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: x\r\n\r\n",
     b"GET /" + b"a" * 30000 + b" HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nX: " + b"a" * 30000 + b"\r\n\r\n",
     b'{"jsonrpc":"2.0","id":1,"method":"describe"}\n', b"\x00\x00\x00\x01\xc0" * 9, b"\x16\x03\x01\x00\x05\x01aaaa"],
)  # fmt: skip
def test_what_is_no_request_is_told_so_and_ended(said: bytes) -> None:
    async def scene(stage: Stage) -> None:
        answer = await stage.raw(said)
        assert b"200 OK" not in answer
        assert b"jsonrpc" not in answer
        assert (await stage.get("/world.json")).status == 200, "the others are served on"

    play(scene)


def test_the_scene_is_told_once_for_all_and_anew_when_bodies_come() -> None:
    async def scene(stage: Stage) -> None:
        first = await stage.get("/world.json")
        told = json.loads(first.body)
        assert (told["revision"], [v["name"] for v in told["vehicles"]]) == (3, ["rov", "auv"])
        assert (told["exact_poses"], told["read_only"]) == (True, False)
        assert (await stage.get("/world.json", If_None_Match=first.headers["etag"])).status == 304
        state = stage.context.scene_state
        stage.context.scene_state = state._replace(
            entities=state.entities._replace(revision=4, vehicles=state.entities.vehicles[:1])
        )
        again = await stage.get("/world.json", If_None_Match=first.headers["etag"])
        assert (again.status, json.loads(again.body)["revision"]) == (200, 4)

    play(scene)


def test_triangles_are_kept_for_ever_under_their_hash() -> None:
    async def scene(stage: Stage) -> None:
        name = 64 * "a"
        stage.context.files[name] = b"triangles"
        mesh = await stage.get(f"/mesh/{name}.bin")
        assert (mesh.status, mesh.body) == (200, b"triangles")
        assert "immutable" in mesh.headers["cache-control"]
        assert (await stage.get(f"/looks/{name}.glb")).headers["content-type"] == "model/gltf-binary"
        assert (await stage.get(f"/mesh/{name}.glb")).status == 404

    play(scene)


def test_health_tells_a_failure() -> None:
    async def scene(stage: Stage) -> None:
        assert (await stage.get("/health")).status == 200
        stage.context.scripts["world/status"] = lambda args: {"failure": "it sank"}
        sunk = await stage.get("/health")
        assert (sunk.status, json.loads(sunk.body)) == (503, {"failure": "it sank"})

    play(scene)


def test_what_does_not_shrink_is_sent_as_it_is() -> None:
    assert static_file(b"x", "text/plain").gzipped is None
    assert static_file(bytes(1000), "model/gltf-binary").gzipped is None


def test_a_view_without_its_files_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "page_folder", lambda: tmp_path / "nothing")

    async def scene(stage: Stage) -> None:
        page = await stage.get("/")
        assert page.status == 200
        assert b"missing" in page.body

    play(scene)


def test_a_large_file_waits_for_a_slow_peer_in_pieces(folder: Path) -> None:
    (folder / "large.glb").write_bytes(bytes(6_000_000))

    async def scene(stage: Stage) -> None:
        reader, writer = await asyncio.open_connection(stage.host, stage.port, limit=4096)
        writer.write(b"GET /large.glb HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert await reader.read(1)
        await asyncio.sleep(0.1)
        (peer,) = stage.adapter.peers
        assert peer.waiting < 300_000, "the rest is not copied for a peer that does not read"
        assert len(await reader.read(-1)) > 6_000_000
        writer.close()

    play(scene)


def test_a_scene_that_cannot_be_described_is_told_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scene(stage: Stage) -> None:
        described = stage.context.scene

        def fails(entities: object) -> None:
            raise KeyError("object")

        stage.context.scene = fails  # type: ignore[method-assign,assignment]
        assert [(await stage.get("/world.json")).status for _ in range(3)] == [500] * 3
        assert caplog.text.count("Traceback") == 1
        stage.context.scene = described  # type: ignore[method-assign]
        assert (await stage.get("/world.json")).status == 200

    play(scene)


def test_what_many_ask_for_at_once_is_made_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_of: list[str] = []

    def slowly(data: bytes, kind: str) -> StaticFile:
        made_of.append(kind)
        time.sleep(0.05)
        return static_file(data, kind)

    monkeypatch.setattr(site, "static_file", slowly)
    monkeypatch.setattr(site, "static_file", slowly)

    async def scene(stage: Stage) -> None:
        for path in ("/world.json", "/main.js"):
            answers = await asyncio.gather(*(stage.get(path) for _ in range(20)))
            assert {answer.status for answer in answers} == {200}

    play(scene)
    assert made_of == ["application/json", "text/javascript; charset=utf-8"]


@pytest.mark.parametrize("token", [None, "sesame"])
@pytest.mark.parametrize("said", [b"", b"GET /slow HTTP/1.1\r\nHost: 127.0.0.1\r\n"])
def test_connections_that_ask_for_nothing_are_closed_quietly(
    said: bytes, token: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene(stage: Stage) -> None:
        reader, writer = await asyncio.open_connection(stage.host, stage.port)
        writer.write(said)
        with contextlib.suppress(ConnectionResetError):
            assert await asyncio.wait_for(reader.read(), 60.0) == b""
        writer.close()

    context = play(scene, hello_timeout_s=0.2, token=token)
    assert "refused" not in context.stats.details
    assert caplog.text == ""


def test_who_is_locked_out_is_told_so_in_http_and_has_the_page() -> None:
    async def scene(stage: Stage) -> None:
        for n in range(11):
            await stage.get("/world.json", Authorization=f"Bearer {n}")
        assert (await stage.get("/")).status == 200
        assert (await stage.get("/world.json", Authorization="Bearer sesame")).status == 429

    play(scene, token="sesame")
