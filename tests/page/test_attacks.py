"""Nobody but the page itself gets an answer, and whatever is sent, the server stays up."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from http.client import HTTPConnection
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from deformscope.page.server import page_server
from deformscope.page.server.messages import LONGEST_MESSAGE
from deformscope.page.server.page_server import MOST_PAGES, PageServer
from tests.page.pages import get, netloc, page_script, root, socket_to, token
from tests.patience import PATIENCE_S

HELLO = '{"kind":"hello","id":1,"version":1,"page":"a"}'
STOP = '{"kind":"stop","id":2}'


def read_all(websocket: ClientConnection) -> None:
    while True:
        websocket.recv(PATIENCE_S)


@pytest.fixture(scope="module")
def attacked() -> Iterator[PageServer]:
    with PageServer("bench") as server:
        server.pieces.add(b"secret", lasting=True)
        yield server


@pytest.fixture
def page(attacked: PageServer) -> Iterator[PageServer]:
    yield attacked
    assert get(attacked, root(attacked))[0] == 200  # after every attack


def test_the_page_itself_is_served(page: PageServer) -> None:
    port = netloc(page).split(":")[1]
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", "localhost:8080", "127.0.0.1"):  # also a forwarded port
        status, content = get(page, root(page), {"Host": host})
        assert (status, b"<title>deformscope" in content) == (200, True)
    for name in ("page.js", "session.js", "link.js", "steer.js", "viewer.js", "page.css", "icon.svg", "index.html"):
        assert (
            get(page, root(page) + name, {"Sec-Fetch-Site": "same-origin", "Origin": f"http://{netloc(page)}"})[0]
            == 200
        )
    assert get(page, root(page), method="HEAD") == (200, b"")


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "127.0.0.1.evil.example",
        "127.0.0.1@evil.example",
        "",
        "[::1",
        "2130706433",
    ],
)
def test_a_name_that_was_rebound_is_refused(page: PageServer, host: str) -> None:
    assert get(page, root(page), {"Host": host.format(port=netloc(page).split(":")[1])})[0] in (400, 403)
    with pytest.raises(InvalidStatus), socket_to(page, "session", additional_headers={"Host": host or "x"}):
        pytest.fail("opened")


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://{own}", "http://127.0.0.1:1", "http://localhost"]
)
def test_another_origin_is_refused(page: PageServer, origin: str) -> None:
    origin = origin.format(own=netloc(page))
    assert get(page, root(page), {"Origin": origin})[0] == 403
    for what in ("session", "data"):
        with pytest.raises(InvalidStatus) as refused, socket_to(page, what, origin=origin):
            pytest.fail("opened")
        assert refused.value.response.status_code == 403


def test_a_page_of_another_site_is_refused(page: PageServer) -> None:
    for site in ("cross-site", "same-site"):
        assert get(page, root(page) + "page.js", {"Sec-Fetch-Site": site})[0] == 403
    with pytest.raises(InvalidStatus), socket_to(page, "session", origin=None):  # no browser: it says nothing of itself
        pytest.fail("opened")


@pytest.mark.parametrize("given", ["", "x", "{short}", "{own}x", "{upper}", "%00", "{own}%2f.."])
def test_a_wrong_token_is_refused(page: PageServer, given: str) -> None:
    own = token(page)
    path = given.format(short=own[:-1], own=own, upper=own.swapcase())
    assert get(page, f"/{path}/" if path else "/")[0] in (403, 404)
    assert b"title" not in get(page, f"/{path}/index.html")[1]


def test_a_stale_token_is_refused(page: PageServer) -> None:
    with PageServer("another") as other:
        assert get(page, root(other))[0] == 403
        with pytest.raises(InvalidStatus), socket_to(page, f"../{token(other)}/session"):
            pytest.fail("opened")


@pytest.mark.parametrize(
    "path",
    [
        *(
            "../server.py",
            "..%2fserver.py",
            "%2e%2e/server.py",
            "static/../../server.py",
            "//etc/passwd",
            "..\\server.py",
        ),
        *(
            "/etc/passwd",
            "%2fetc%2fpasswd",
            "page.js/../../server.py",
            "page.js%00.css",
            "re_viewer.js/../../x",
            ".",
            "..",
            "~",
        ),
    ],
)
def test_no_path_leads_out(page: PageServer, path: str) -> None:
    status, content = get(page, root(page) + path)
    assert status in (403, 404)
    assert b"root:" not in content
    assert b"import" not in content


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "CONNECT"])
def test_nothing_can_be_posted(page: PageServer, method: str) -> None:
    assert get(page, root(page), method=method)[0] in (400, 403, 405)


def test_answers_forbid_what_a_page_does_not_need(page: PageServer) -> None:
    with socket.create_connection(("127.0.0.1", int(netloc(page).split(":")[1]))) as raw:
        raw.sendall(f"GET {root(page)} HTTP/1.1\r\nHost: {netloc(page)}\r\nConnection: close\r\n\r\n".encode())
        head = b"".join(iter(lambda: raw.recv(65536), b"")).split(b"\r\n\r\n")[0].decode().lower()
    for line in ("frame-ancestors 'none'", "referrer-policy: no-referrer", "nosniff", "cache-control: no-store"):
        assert line in head
    assert "access-control" not in head
    assert "unsafe-inline" not in head


@pytest.mark.parametrize("what", ["session", "data"])
@pytest.mark.parametrize(
    "message",
    [
        *("{", "[]", "null", '{"kind":"hello"}', '{"kind":"launch","id":1}', '{"batch":-1}', "NaN", "é"),
        *(b"\x00" * 100, "[" * 10_000, '{"kind":"hello","id":1,"version":1,"page":"a","more":1}'),
        *(
            '{"kind":"hello","id":1e400,"version":1,"page":"a"}',
            '{"kind":"hello","id":1,"version":1,"page":"' + "a" * 5000 + '"}',
        ),
    ],
)
def test_malformed_messages_end_their_connection_alone(page: PageServer, what: str, message: str | bytes) -> None:
    with page_script(page, "good") as good:
        with socket_to(page, what) as websocket:
            websocket.send(message)
            with pytest.raises(ConnectionClosed) as closed:
                read_all(websocket)
        assert closed.value.rcvd.code == 1008
        assert good.command("stop")[0] == "refused"  # nothing runs; but it is answered


def test_a_page_of_another_version_is_to_be_loaded_again(page: PageServer) -> None:
    with socket_to(page, "session") as websocket:
        websocket.send(HELLO.replace('"version":1', '"version":2'))
        with pytest.raises(ConnectionClosed) as closed:
            websocket.recv(PATIENCE_S)
    assert closed.value.rcvd.code == 4000


@pytest.mark.parametrize("size", [LONGEST_MESSAGE + 1, 10 << 20])
def test_a_message_that_is_too_long_is_not_read(page: PageServer, size: int) -> None:
    with socket_to(page, "session") as websocket:
        with suppress(ConnectionClosed):
            websocket.send("x" * size)
        with pytest.raises(ConnectionClosed) as closed:
            read_all(websocket)
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1009


def sockets_of_this_process() -> int:
    count = 0
    for handle in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since
            count += str(handle.readlink()).startswith("socket:")
    return count


def test_a_thousand_connections_leave_room_for_the_page(page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "REQUEST_S", 0.3)
    address = ("127.0.0.1", int(netloc(page).split(":")[1]))
    with page_script(page, "good") as good, ExitStack() as stack:
        held = []
        for _ in range(1000):
            try:
                held.append(stack.enter_context(socket.create_connection(address, timeout=5)))
            except OSError:
                break
        deadline = time.monotonic() + PATIENCE_S
        # the server's own share, since we are one process: what comes in one burst is taken before it is refused
        while sockets_of_this_process() - len(held) >= 2 * page_server.MOST_STRANGERS:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert good.command("stop")[0] == "refused"  # it answers who was there before
        deadline = time.monotonic() + PATIENCE_S
        while True:  # and others once the idle ones were closed
            try:
                assert get(page, root(page))[0] == 200
                break
            except OSError:
                assert time.monotonic() < deadline


def slow(kind: str, address: tuple[str, int], over: threading.Event) -> None:
    """One who has no token, and comes back whenever the server ends the connection."""
    refused = b"GET /x/ HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    first, rest = {
        "silent": (b"", b""),
        "a letter at a time": (b"GET / HTTP/1.1\r\n", b"a"),
        "refused again and again": (refused + b"\r\n", refused + b"\r\n"),
        "an endless body": (refused + b"Content-Length: 1000000\r\n\r\n", b"a"),
        "a websocket": (refused + b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: x\r\n\r\n", b"a"),
    }[kind]
    while not over.is_set():
        with suppress(OSError), socket.create_connection(address, PATIENCE_S) as connection:
            connection.sendall(first)
            while not over.wait(0.1):
                connection.sendall(rest)


@pytest.mark.parametrize(
    "kind", ["silent", "a letter at a time", "refused again and again", "an endless body", "a websocket"]
)
def test_seventy_without_the_token_keep_no_page_away(page: PageServer, kind: str) -> None:
    over, address = threading.Event(), ("127.0.0.1", int(netloc(page).split(":")[1]))
    threads = [threading.Thread(target=slow, args=(kind, address, over)) for _ in range(70)]
    try:
        for thread in threads:
            thread.start()
        over.wait(0.5)  # all are there
        for _ in range(10):  # a page that is loaded again, and its Stop: each at once, none tried twice
            for name in ("", "page.js", "session.js", "page.css"):
                assert get(page, root(page) + name)[0] == 200
            with page_script(page, "good") as good:
                assert good.command("stop")[0] == "refused"  # nothing runs; but it is answered
    finally:
        over.set()
        for thread in threads:
            thread.join()


FLOOD = """
import selectors, socket, sys
port, count = map(int, sys.argv[1:])
waiting = selectors.DefaultSelector()
def come():
    one = socket.socket()
    one.setblocking(False)
    one.connect_ex(("127.0.0.1", port))
    waiting.register(one, selectors.EVENT_READ)
for _ in range(count):
    come()
print("ready", flush=True)
while True:
    for key, _ in waiting.select():
        waiting.unregister(key.fileobj)
        key.fileobj.close()
        come()
"""


def test_three_hundred_that_come_back_at_once_keep_no_page_away(page: PageServer) -> None:
    command = [sys.executable, "-c", FLOOD, netloc(page).split(":")[1], "300"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flood:
        assert flood.stdout.readline() == "ready\n"
        try:
            for _ in range(3):
                connection = HTTPConnection(netloc(page), timeout=PATIENCE_S)
                connection.connect()
                time.sleep(0.3)  # on a busy machine a browser sends its request this much later
                connection.request("GET", root(page))
                assert connection.getresponse().status == 200
                connection.close()
        finally:
            flood.kill()


@pytest.mark.parametrize("words", [b"", b"GET / HTTP/1.1\r\n", b"GET /x/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"])
def test_who_has_not_shown_the_token_within_a_second_is_cut_off(page: PageServer, words: bytes) -> None:
    assert page_server.REQUEST_S <= 1.0
    with socket.create_connection(("127.0.0.1", int(netloc(page).split(":")[1])), PATIENCE_S) as connection:
        connection.sendall(words)
        with suppress(ConnectionResetError):
            while connection.recv(1000):
                pass


def test_who_has_shown_the_token_is_not_cut_off(page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "REQUEST_S", 0.05)
    connection = HTTPConnection(netloc(page), timeout=PATIENCE_S)
    with page_script(page, "good") as good, closing(connection):
        connection.connect()
        connected = connection.sock
        for _ in range(3):
            connection.request("GET", root(page))
            assert connection.getresponse().read()
            assert connection.sock is connected
            time.sleep(3 * page_server.REQUEST_S)
        assert good.command("stop")[0] == "refused"


def test_pages_are_few(page: PageServer) -> None:
    opened = [socket_to(page, "session") for _ in range(MOST_PAGES)]
    for one in opened:
        one.__enter__().send(HELLO)
    with pytest.raises(InvalidStatus), socket_to(page, "session"):
        pytest.fail("opened")
    for one in opened:
        one.__exit__(None, None, None)


def test_only_loopback_is_listened_on(page: PageServer) -> None:
    assert page.address.startswith("http://127.0.0.1:")
    assert len(token(page)) >= 32
    addresses = {
        line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:] if line.split()[3] == "0A"
    }
    port = int(netloc(page).split(":")[1])
    assert f"0100007F:{port:04X}" in addresses
    assert f"00000000:{port:04X}" not in addresses
