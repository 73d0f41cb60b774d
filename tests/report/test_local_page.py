"""The server of local pages: for this machine, for its own pages, and it never falls over."""

import http.client
import json
import socket
import struct
import threading
from urllib.parse import urlsplit

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.report.local_page import Answer, serve_until, serving


def ask(path, query):
    if path == "/fail":
        raise InvalidConfigError("no such cloth; click again")
    if path == "/break":
        raise ZeroDivisionError("a defect of ours")
    if path == "/odd":
        return Answer.of({"value": int(query["value"])})
    return Answer(b"hello", "text/plain") if path == "/" else None


def tell(path, message):
    return Answer.of({"heard": message["word"]}) if path == "/say" else None


def request(address, method, path, body=None, **headers):
    url = urlsplit(address)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=10)
    try:
        connection.request(method, path, body, {"Content-Type": "application/json", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


@pytest.fixture
def address():
    with serving(ask, tell) as address:
        yield address


def test_it_answers_on_this_machine_only(address):
    assert address.startswith("http://127.0.0.1:")
    assert request(address, "GET", "/") == (200, b"hello")
    status, body = request(address, "POST", "/say", json.dumps({"word": "cloth"}))
    assert (status, json.loads(body)) == (200, {"heard": "cloth"})


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status"),
    [
        ("GET", "/nothing", None, {}, 404),
        ("GET", "/../../etc/passwd", None, {}, 404),
        ("GET", "/", None, {"Host": "evil.example:80"}, 403),
        ("POST", "/say", '{"word": "x"}', {"Host": "evil.example:80"}, 403),
        ("GET", "/", None, {"Origin": "http://evil.example"}, 403),
        ("POST", "/say", '{"word": "x"}', {"Origin": "http://evil.example"}, 403),
        ("POST", "/say", '{"word": "x"}', {"Origin": "null"}, 403),
        ("POST", "/say", '{"word": "x"}', {"Content-Type": "text/plain"}, 415),
        ("POST", "/say", "word=x", {}, 400),
        ("POST", "/say", "[1]", {}, 400),
        ("POST", "/say", "{}", {}, 400),
        ("POST", "/say", "x" * 100_000, {}, 413),
        ("GET", "/odd?value=cloth", None, {}, 400),
        ("GET", "/odd", None, {}, 400),
        ("GET", "/fail", None, {}, 422),
        ("GET", "/break", None, {}, 500),
    ],
)
def test_what_is_wrong_is_answered_with_a_reason(address, method, path, body, *, headers, status):
    got, answer = request(address, method, path, body, **headers)
    assert got == status
    assert json.loads(answer)["error"]
    assert request(address, "GET", "/")[0] == 200


def test_a_browser_that_resets_its_connection_leaves_no_traceback(address, capfd):
    url = urlsplit(address)
    for _ in range(5):
        with socket.create_connection((url.hostname, url.port), timeout=10) as raw:
            raw.sendall(b"POST /say HTTP/1.1\r\nContent-Length: 50\r\n\r\n{")
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    for _ in range(20):
        assert request(address, "GET", "/")[0] == 200
    assert capfd.readouterr().err == ""


def test_a_port_that_is_taken_or_cannot_be_is_refused(address):
    with (
        pytest.raises(InvalidConfigError, match="choose another one"),
        serving(ask, tell, urlsplit(address).port),
    ):
        pass
    with pytest.raises(InvalidConfigError, match="port is 99999"), serving(ask, tell, 99_999):
        pass


def test_ctrl_c_ends_it_as_soon_as_the_address_is_told():
    told = []

    def pressed(address):
        told.append(address)
        raise KeyboardInterrupt

    serve_until(threading.Event(), ask, tell, opened=pressed)
    with pytest.raises(ConnectionRefusedError):
        request(told[0], "GET", "/")
