"""XML-RPC of ROS 1: what is read, and what no page of a browser can send."""

import xmlrpc.client

import pytest
from uwserver_adapters.ros1.xmlrpc import (
    BODY_LIMIT,
    NESTED,
    SLICE,
    TAGS,
    Answer,
    BadHttp,
    Call,
    Requests,
    request,
    result,
    told,
)

from uwserver.ports import Refused

CALL = request("127.0.0.1:5000", "/RPC2", "requestTopic", ["/rviz", "/rov/imu", [["TCPROS"]]])


def take(data: bytes, size: int | None = None) -> Call | None:
    requests = Requests(("robot",))
    for at in range(0, len(data), size or len(data)):
        requests.receive(data[at : at + (size or len(data))])
        call = requests.next_call()
        while call is None and requests.is_parsing:
            call = requests.next_call()
        if call is not None:
            return call
    return None


def read_back(answered: bytes, size: int | None = None) -> object:
    answer = Answer()
    for at in range(0, len(answered), size or len(answered) or 1):
        answer.receive(answered[at : at + (size or len(answered))])
    body = answer.body()
    while body.parse_slice():
        pass
    return result(body)


@pytest.mark.parametrize("size", [None, 1, 7, 100])
def test_a_call_in_pieces(size: int | None) -> None:
    assert take(CALL, size) == Call("requestTopic", ("/rviz", "/rov/imu", [["TCPROS"]]))


def test_calls_behind_each_other() -> None:
    requests = Requests()
    requests.receive(CALL + CALL)
    assert requests.next_call() == requests.next_call() != None  # noqa: E711
    assert requests.next_call() is None


def changed(old: bytes, new: bytes) -> bytes:
    assert old in CALL
    return CALL.replace(old, new)


def with_body(body: bytes) -> bytes:
    head = CALL.partition(b"\r\n\r\n")[0].partition(b"Content-Length")[0]
    return head + b"Content-Length: %d\r\n\r\n" % len(body) + body


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (changed(b"Content-Type: text/xml", b"Content-Type: text/plain"), "415"),
        (changed(b"Content-Type: text/xml\r\n", b""), "415"),
        (changed(b"Host: 127.0.0.1:5000", b"Host: evil.example"), "403"),
        (changed(b"Host: 127.0.0.1:5000\r\n", b""), "403"),
        (changed(b"Connection: close", b"Origin: null"), "403"),
        (changed(b"Connection: close", b"Origin: http://127.0.0.1:5000"), "403"),
        (changed(b"Connection: close", b"Transfer-Encoding: chunked"), "411"),
        (changed(b"Content-Length: ", b"X-Length: "), "411"),
        (changed(b"Content-Length: ", b"Content-Length: -"), "411"),
        (changed(b"Content-Length: ", b"Content-Length: 99999999"), "413"),
        (changed(b"Connection: close", b"Content-Length: 3"), "400"),
        (changed(b"POST ", b"GET "), "405"),
        (changed(b"/RPC2 ", b"/RPC3 "), "404"),
        (with_body(b"<methodCal></methodCal>"), "400"),
        (with_body(b"<!DOCTYPE x [<!ENTITY a 'b'>]><methodCall><methodName>getPid</methodName></methodCall>"), "400"),
        (with_body(b"<methodResponse></methodResponse>"), "400"),
        (with_body(b"\xff" * 50), "400"),
        (b"POST / HTTP/1.1\r\n" + b"X: y\r\n" * 3000, "431"),
    ],
)
def test_what_is_refused(data: bytes, status: str) -> None:
    with pytest.raises(BadHttp) as bad:
        take(data)
    assert bad.value.status.startswith(status)


def test_a_host_of_ours() -> None:
    assert take(changed(b"Host: 127.0.0.1:5000", b"Host: robot:5000")) is not None
    assert take(changed(b"Host: 127.0.0.1:5000", b"Host: localhost")) is not None


@pytest.mark.parametrize("size", [None, 1, 7])
def test_answers_are_read_back(size: int | None) -> None:
    assert read_back(told(1, "ready", ["TCPROS", "127.0.0.1", 5]), size) == ["TCPROS", "127.0.0.1", 5]
    with pytest.raises(Refused, match="no such topic"):
        read_back(told(-1, "no such topic", 0), size)
    fault = xmlrpc.client.dumps(xmlrpc.client.Fault(3, "it failed"), methodresponse=True).encode()
    with pytest.raises(Refused, match="it failed"):
        read_back(b"HTTP/1.1 200 OK\r\n\r\n" + fault, size)


@pytest.mark.parametrize(
    "answered",
    [b"", b"HTTP/1.1 500 x\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n<a/>", told(1, "", 2)[:-9]],
)
def test_no_answer(answered: bytes) -> None:
    with pytest.raises(Refused):
        read_back(answered)


def test_an_answer_is_whole_when_its_announced_length_has_come() -> None:
    answer, answered = Answer(), told(1, "", [5])
    answer.receive(answered[:-1])
    assert not answer.is_whole
    answer.receive(answered[-1:])
    assert answer.is_whole


@pytest.mark.parametrize(
    "data", [b"x" * (BODY_LIMIT << 1), b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % (BODY_LIMIT + 1)]
)
def test_an_answer_too_long_is_not_stored(data: bytes) -> None:
    with pytest.raises(Refused, match="longer"):
        Answer().receive(data)


def test_a_long_call_is_parsed_slice_by_slice() -> None:
    """So the loop does other work in between."""
    uris = [f"http://node{number}:40000/" for number in range(500)]
    requests, steps = Requests(), 0
    requests.receive(request("localhost", "/", "publisherUpdate", ["/master", "/rov/imu", uris]))
    while (call := requests.next_call()) is None:
        assert requests.is_parsing
        steps += 1
    assert call == Call("publisherUpdate", ("/master", "/rov/imu", uris))
    assert steps == requests.size // SLICE
    assert not requests.is_parsing


_ARRAY = (b"<value><array><data>", b"</data></array></value>")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (b"<a/>" * TAGS, "tags"),
        (_ARRAY[0] * (NESTED + 1) + _ARRAY[1] * (NESTED + 1), "arrays"),
        (b"<value a='1' b='2'>5</value>", "attributes"),
        (b"<value\na = '1'/>", "attributes"),
    ],
)
def test_what_costs_much_is_refused_before_it_is_built(value: bytes, said: str) -> None:
    body = b"<?xml version='1.0'?><methodCall><methodName>x</methodName><params><param>%s</param></params></methodCall>"
    with pytest.raises(BadHttp, match=said):
        take(with_body(body % value))
    inner = b"<value>5</value>"
    for _ in range(NESTED):
        inner = inner.join(_ARRAY)
    assert take(with_body(body % inner)) is not None
