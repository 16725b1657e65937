"""Mutated requests to an open page: what it serves has the page's own Host and Origin, read from the same bytes."""

import logging
import random
import socket
from collections import Counter

import pytest

import driver
from families import translation
from loewner import Body, InputError, viewer

pytest.importorskip("viser")

SHORT, FULL = 300, 20_000


@pytest.fixture(autouse=True)
def no_log_of_requests(caplog):
    """Keep refused requests out of the log: bytes that are no text could not be sent to the process that reports."""
    caplog.set_level(logging.CRITICAL + 1, logger="websockets")


NAMES = (
    b"localhost",
    b"127.0.0.1",
    b"[::1]",
    b"evil.example",
    b"0.0.0.0",
    b"[::]",
    b"localhost.evil.example",
    b"null",
    b"",
)
SPLICES = (b"\r\n", b"\n", b" ", b"\t", b"\0", b"\xff", b":", b",", b"@", b"/", b"[", b"]", b"%00", b"?", b"http://")
SPLICES += (b"Host: ", b"Origin: ", b"evil.example", b"\r\nHost: evil.example", b"\r\nOrigin: null", b"\r\n ")

# The guard lets these through; what refuses a request later refuses it by another.
SERVED = (b"101", b"200", b"404")


def request(port, seed):
    """A right request or one a little wrong: other names, lines twice or left out, bytes replaced and put between."""
    import viser

    draw = random.Random(seed)
    host = draw.choice(NAMES[:3] if draw.random() < 0.7 else NAMES) + b":%d" % port
    origin = b"http://" + (host if draw.random() < 0.7 else draw.choice(NAMES) + b":%d" % port)
    lines = [b"Host: " + host]
    if draw.random() < 0.7:
        lines.append(b"Origin: " + origin)
    if draw.random() < 0.5:
        lines += [b"Upgrade: websocket", b"Connection: Upgrade", b"Sec-WebSocket-Version: 13"]
        lines += [b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", b"Sec-WebSocket-Protocol: viser-v"]
        lines[-1] += viser.__version__.encode()
    for _ in range(draw.choice((0, 0, 1, 2))):
        k = draw.randrange(len(lines))
        lines[k : k + 1] = draw.choice(([], [lines[k]] * 2, [lines[k].swapcase()], [lines[k] + b"1"]))
        draw.shuffle(lines)
        if not lines:
            break
    whole = bytearray(b"\r\n".join([b"GET / HTTP/1.1", *lines, b"", b""]))
    for _ in range(draw.choice((0, 0, 1, 1, 3))):
        k = draw.randrange(len(whole))
        whole[k : k + draw.choice((0, 1))] = draw.choice((*SPLICES, bytes([draw.randrange(256)])))
    # The server would wait for what is missing at the end.
    return bytes(whole) if b"\r\n\r\n" in whole else bytes(whole) + b"\r\n\r\n"


def is_own(sent, port):
    """Whether one Host names this machine and this port, and all Origins that Host's page."""
    fields = [line.partition(b":") for line in sent.partition(b"\r\n\r\n")[0].split(b"\r\n")[1:]]
    said = {
        key: [v.strip(b" \t").lower() for name, _, v in fields if name.lower() == key] for key in (b"host", b"origin")
    }
    if len(said[b"host"]) != 1:
        return False
    (host,) = said[b"host"]
    name, _, number = host.rpartition(b":")
    return number == b"%d" % port and is_loopback(name) and all(o == b"http://" + host for o in said[b"origin"])


def is_loopback(name):
    try:
        if name.startswith(b"["):
            return name.endswith(b"]") and socket.inet_pton(socket.AF_INET6, name[1:-1].decode())[:-1] == bytes(15)
        return name == b"localhost" or socket.inet_pton(socket.AF_INET, name.decode())[0] == 127
    except (OSError, ValueError):
        return False


def answer(port, sent):
    """Status of the answer; empty if the connection was closed without one."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(sent)
        try:
            return connection.recv(65536)[9:12]
        except ConnectionResetError:
            return b""


def campaign(count):
    """Outcomes of requests, and how many of them were to be served."""
    # Not one that asks for what is in the scene: the test is about the door.
    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), translation(3.0)) as page:
        port = page.server.get_port()

        def one(seed):
            sent = request(port, seed)
            status = answer(port, sent)
            if status not in SERVED:
                raise InputError(f"refused by {status!r}")
            return None if is_own(sent, port) else f"served by {status!r}: {sent!r}"

        outcomes = driver.run(one, range(count))
        # It still answers: right requests, and no others, after all of these.
        assert answer(port, b"GET / HTTP/1.1\r\nHost: localhost:%d\r\n\r\n" % port) == b"200"
        assert answer(port, b"GET / HTTP/1.1\r\nHost: evil.example:%d\r\n\r\n" % port) == b"403"
    return outcomes


def check(count):
    outcomes = campaign(count)
    assert not driver.faults(outcomes), driver.faults(outcomes)
    kinds = Counter(outcome.kind for outcome in outcomes)
    # Both happen often: neither a wall nor an open door passes.
    assert min(kinds[driver.OK], kinds[driver.REFUSED]) > count // 10
    return kinds


def test_requests_short():
    """No request is served that has a foreign Host or Origin."""
    check(SHORT)


@pytest.mark.fuzz
def test_requests():
    """The same, many times."""
    kinds = check(FULL)
    print(f"\nrequests to a page: {FULL} mutated, {kinds[driver.OK]} served, {kinds[driver.REFUSED]} refused, 0 wrong")
