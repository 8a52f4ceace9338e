"""XML-RPC of ROS 1: what is read, and what no page of a browser can send."""

import xmlrpc.client

import pytest
from uwserver_adapters.ros1.xmlrpc import BadHttp, Call, Requests, request, result, told

from uwserver.ports import Refused

CALL = request("127.0.0.1:5000", "/RPC2", "requestTopic", ["/rviz", "/rov/imu", [["TCPROS"]]])


def take(data: bytes, size: int | None = None) -> Call | None:
    requests = Requests(("robot",))
    for at in range(0, len(data), size or len(data)):
        requests.receive(data[at : at + (size or len(data))])
        call = requests.next_call()
        if call is not None:
            return call
    return None


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


def test_answers_are_read_back() -> None:
    assert result(told(1, "ready", ["TCPROS", "127.0.0.1", 5])) == ["TCPROS", "127.0.0.1", 5]
    with pytest.raises(Refused, match="no such topic"):
        result(told(-1, "no such topic", 0))
    fault = xmlrpc.client.dumps(xmlrpc.client.Fault(3, "it failed"), methodresponse=True).encode()
    with pytest.raises(Refused, match="it failed"):
        result(b"HTTP/1.1 200 OK\r\n\r\n" + fault)


@pytest.mark.parametrize(
    "answered",
    [b"", b"HTTP/1.1 500 x\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n<a/>", told(1, "", 2)[:-9]],
)
def test_no_answer(answered: bytes) -> None:
    with pytest.raises(Refused):
        result(answered)
