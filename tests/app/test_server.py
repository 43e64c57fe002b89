"""The page's server: who may ask, what is sent, what is taken, and what a wrong request is told."""

import http.client
import json
import socket
import time
import urllib.parse

import pytest

from cablejax.app import Desk, serve
from cablejax.app.server import PAGE

ABOUT = {"units": ["mm"], "voltages": [], "version": "0"}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    desk = Desk("tests.app.stages:stage", tmp_path_factory.mktemp("desk"))
    one = serve(desk, ABOUT)
    yield one
    one.shutdown()
    one.server_close()
    desk.close()


def ask(server, method: str, path: str, body: bytes = b"", key: str | None = None):
    """Status, headers and content of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=30)
    connection.request(method, f"/{server.key if key is None else key}/{path}", body)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, answer.headers, content


def put(server, name: str, content: bytes = b"", settings: str = "{}"):
    query = urllib.parse.urlencode({"name": name, "settings": settings})
    status, _, said = ask(server, "POST", f"scans?{query}", content)
    return status, json.loads(said)


def settled(server, number: int) -> dict:
    end = time.monotonic() + 60
    while (found := json.loads(ask(server, "GET", f"scans/{number}")[2]))["busy"]:
        assert time.monotonic() < end, found
        time.sleep(0.02)
    return found


def test_it_listens_where_this_machine_alone_reaches_it(server):
    assert server.server_address[0] == "127.0.0.1"
    assert server.url == f"http://127.0.0.1:{server.server_address[1]}/{server.key}/"
    assert len(server.key) >= 20


def test_without_the_word_in_the_address_nothing_is_told(server):
    for key in ("", "x", server.key[:-1], server.key + "x", "ü"):
        status, _, said = ask(server, "GET", "state", key=urllib.parse.quote(key))
        assert (status, b"program printed" in said) == (403, True)
        assert ask(server, "POST", "scans?name=a.ply", b"1 2 3", key=urllib.parse.quote(key))[0] == 403
    assert json.loads(ask(server, "GET", "state")[2]) == {"scans": [], **ABOUT}


def test_the_page_and_its_parts_are_sent_and_may_load_nothing_from_elsewhere(server):
    files = sorted(path.name for path in PAGE.iterdir())
    assert "index.html" in files
    for name in ["", *files]:
        status, headers, content = ask(server, "GET", name)
        assert (status, content) == (200, (PAGE / (name or "index.html")).read_bytes())
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
    text = "".join((PAGE / name).read_text() for name in files)
    assert "://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "innerHTML" not in text  # names of files and sentences are text


def test_an_uploaded_scan_is_measured_and_its_report_saved_under_its_name(server):
    content = b"every no\n" + 300_000 * b"report never\n"  # several pieces of a stream
    status, said = put(server, "../büro/scan ü.ply", content, '{"unit": "mm"}')
    assert status == 200
    number = said["number"]
    found = settled(server, number)
    assert (found["name"], found["command"]) == ("scan ü.ply", "cablejax measure 'scan ü.ply' --unit mm")
    status, _, _ = ask(server, "POST", f"scans/{number}/measure", b'{"unit": "m"}')
    assert status == 200
    assert settled(server, number)["settings"] == {"unit": "m"}
    assert ask(server, "POST", f"scans/{number}/remove", b"{}")[0] == 200
    assert ask(server, "GET", f"scans/{number}")[0] == 404


def test_a_report_is_saved_under_the_scans_name(server):
    _, said = put(server, "a b.las.gz")
    settled(server, said["number"])
    status, headers, content = ask(server, "GET", f"scans/{said['number']}/report-1")
    assert (status, content) == (200, b"<p>report</p>")
    assert headers["Content-Disposition"] == "attachment; filename*=UTF-8''a%20b.las-cable-1.html"
    ask(server, "POST", f"scans/{said['number']}/remove", b"{}")


WRONG = {
    "no such page": ("GET", "nothing.html", b"", 404, "there is no such thing here"),
    "a way out": ("GET", "..%2fserver.py", b"", 404, "there is no such thing here"),
    "no such scan": ("GET", "scans/999", b"", 404, "there is no such thing here"),
    "no such cable": ("GET", "scans/999/cables/1/section?at=1", b"", 404, "there is no such thing here"),
    "no number": ("GET", "scans/1/cables/1/section?at=here", b"", 400, "at: expected a number"),
    "nothing to stop": ("POST", "scans/999/stop", b"{}", 404, "there is no such thing here"),
    "no name": ("POST", "scans?name=..", b"", 400, "name: expected that of a file, got '..'"),
    "no settings": ("POST", "scans?name=a.ply&settings=7", b"", 400, "settings: expected a JSON object"),
    "a wrong setting": ("POST", "scans?name=a.ply&settings={%22box%22:3}", b"", 400, "box: expected 6 numbers, got 3"),
    "too long a name": ("POST", f"scans?name={'a' * 300}.ply", b"", 507, "cannot be kept on this machine"),
    "a get of what is posted": ("GET", "scans", b"", 404, "there is no such thing here"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_request_is_told_what_is_wrong(server, case):
    method, path, body, status, sentence = WRONG[case]
    got, _, said = ask(server, method, path, body)
    assert got == status
    assert sentence in json.loads(said)["error"]
    assert json.loads(ask(server, "GET", "state")[2])["scans"] == []


def test_an_upload_that_breaks_off_leaves_nothing(server):
    before = set(server.desk._folder.iterdir())
    with socket.create_connection(server.server_address[:2], timeout=30) as connection:
        connection.sendall(
            f"POST /{server.key}/scans?name=a.ply HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000\r\n\r\n".encode()
            + b"half"
        )
        connection.shutdown(socket.SHUT_WR)
        connection.settimeout(30)
        assert connection.recv(100) == b""  # the server hangs up
    assert set(server.desk._folder.iterdir()) == before
    assert json.loads(ask(server, "GET", "state")[2])["scans"] == []


def test_the_page_answers_while_a_scan_is_measured(server):
    _, said = put(server, "slow.ply", b"measure slow")
    begun, asked = time.monotonic(), 0
    while asked < 200:
        assert ask(server, "GET", "state")[0] == 200
        asked += 1
    assert time.monotonic() - begun < 30  # of the 60 s that the scan takes
    ask(server, "POST", f"scans/{said['number']}/remove", b"{}")
