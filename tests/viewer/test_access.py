"""Who may open a page of the viewer, and where it may lead: hosts, ports, origins, tokens and other sites."""

import http.server
import re
import socket
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

import loewner
from loewner import Body, viewer
from loewner.viewer import guard
from viewer_pages import PATIENCE, WINDOW, two_boxes

UPGRADE = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
UPGRADE += ("Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",)

SERVED = {False: 200, True: 101}


def ask(page, *lines, websocket=False, path="/", address="127.0.0.1"):
    """Send a request of exactly these header lines; its status, and the head of the answer."""
    import viser

    port = page.server.get_port()
    lines = [line.format(port=port, next=port + 1) for line in lines]
    if websocket:
        lines += [*UPGRADE, f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]
    with socket.create_connection((address, port), timeout=30) as connection:
        connection.sendall("\r\n".join([f"GET {path} HTTP/1.1", *lines, "", ""]).encode("latin-1"))
        head = b""
        while b"\r\n\r\n" not in head:
            part = connection.recv(65536)
            assert part, head
            head += part
    return int(head.split()[1]), head.partition(b"\r\n\r\n")[0].decode("latin-1")


@pytest.fixture(scope="module")
def open_page():
    with two_boxes() as page:
        yield page


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "host",
    [
        "evil.example:{port}",
        "evil.example",
        "localhost",
        "localhost:{next}",
        "localhost:{port}.evil.example",
        "localhost.evil.example:{port}",
        "127.0.0.1.evil.example:{port}",
        "localhost.:{port}",
        "localhost:{port}@evil.example:{port}",
        "evil.example/localhost:{port}",
        "evil.example,localhost:{port}",
        "0.0.0.0:{port}",
        "192.168.1.2:{port}",
        "[::2]:{port}",
        "[::1:{port}",
        "::1:{port}",
        "2130706433:{port}",
        ":{port}",
        "",
        "\xff\xfe:{port}",
    ],
)
def test_foreign_host_is_refused(open_page, host, websocket):
    """A name of somebody else's that was made to point here opens neither page nor websocket."""
    assert ask(open_page, f"Host: {host}", websocket=websocket)[0] == 403
    assert ask(open_page, "Host: localhost:{port}", f"Host: {host}", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://evil.example:{port}",
        "null",
        "",
        "file://",
        "http://localhost",
        "http://localhost:{next}",
        "https://localhost:{port}",
        "http://localhost:{port}.evil.example",
        "http://localhost:{port}/",
        "http://localhost:{port}, http://evil.example",
        "http://127.0.0.1:{port}",
        "localhost:{port}",
    ],
)
def test_foreign_origin_is_refused(open_page, origin, websocket):
    """A page of another site opens nothing, though it names the right host; nor does one of another port."""
    assert ask(open_page, "Host: localhost:{port}", f"Origin: {origin}", websocket=websocket)[0] == 403
    own = "Origin: http://localhost:{port}"
    assert ask(open_page, "Host: localhost:{port}", own, f"Origin: {origin}", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
def test_no_host_is_refused(open_page, websocket):
    """A request without a Host header is refused with status 403."""
    assert ask(open_page, "Accept: */*", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "host", ["localhost:{port}", "LocalHost:{port}", "127.0.0.1:{port}", "127.0.0.9:{port}", "[::1]:{port}"]
)
def test_own_names_are_served(open_page, host, websocket):
    """This machine's names open page and websocket, with the Origin that a browser sends, or as a program with none."""
    assert ask(open_page, f"Host: {host}", websocket=websocket)[0] == SERVED[websocket]
    status, _ = ask(open_page, f"Host: {host}", f"Origin: http://{host}", websocket=websocket)
    assert status == SERVED[websocket]


def test_refused_websocket_sees_nothing(viser):
    """A websocket client of a foreign Origin or Host gets no byte of the scene; one of the page's own gets it."""
    websockets = pytest.importorskip("websockets.sync.client")
    from websockets.exceptions import InvalidStatus

    def first_message(page, host, origin):
        port = page.server.get_port()
        with (
            socket.create_connection(("127.0.0.1", port)) as here,
            websockets.connect(
                f"ws://{host}:{port}", sock=here, origin=origin, subprotocols=[f"viser-v{viser.__version__}"],
                max_size=None, proxy=None,
            ) as client,
        ):  # fmt: skip
            return client.recv(timeout=30)

    with two_boxes() as page:
        assert len(first_message(page, "localhost", page.url)) > 1000
        assert len(first_message(page, "localhost", None)) > 1000
        for host, origin in (("localhost", "http://evil.example"), ("evil.example", None), ("localhost", "null")):
            with pytest.raises(InvalidStatus) as refused:
                first_message(page, host, origin)
            assert refused.value.response.status_code == 403


def test_token_for_others(capsys):
    """Where others can connect, nothing is served without the token; it is printed once, and new for each page."""
    with two_boxes(host="0.0.0.0") as page, two_boxes(host="0.0.0.0") as other:
        printed = capsys.readouterr().out
        address, token = re.fullmatch(r"(http://localhost:\d+)/\?token=([\w-]{32})", page.url).groups()
        assert printed.count(token) == 1
        (line,) = [line for line in printed.splitlines() if token in line]
        assert "any of this machine's addresses" in line
        assert "can see and move the bodies" in line
        cookie, host = f"Cookie: a=b; loewner-token-{page.server.get_port()}={{}}; c", "Host: 127.0.0.1:{port}"
        strange = other.url.partition("token=")[2]
        assert strange != token
        for websocket in (False, True):
            wrong = ["/?token=" + said for said in ("", token[:-1], token + "x", strange, "%00", "%ff")]
            for path in ("/", "/index.html", "//[", "/" + token, "/?Token=" + token, *wrong):
                assert ask(page, host, websocket=websocket, path=path)[0] == 403, path
            for said in ("", token[1:], strange, "\xff", '"'):
                assert ask(page, host, cookie.format(said), websocket=websocket)[0] == 403, said
            assert ask(page, host, f"Cookie: loewner-token-1={token}", websocket=websocket)[0] == 403
            assert ask(page, host, cookie.format(token), websocket=websocket)[0] == SERVED[websocket]
            for own in (
                host,
                "Host: localhost:{port}",
                "Host: 192.168.1.2:{port}",
                f"Host: {socket.gethostname()}:{{port}}",
            ):
                assert ask(page, own, websocket=websocket, path=f"/?token={token}")[0] == SERVED[websocket], own
            # The token alone does not let a page of another site in.
            for foreign in (
                ["Host: evil.example:{port}"],
                [host, "Origin: null"],
                [host, "Origin: http://evil.example"],
            ):
                assert ask(page, *foreign, cookie.format(token), websocket=websocket, path=f"/?token={token}")[0] == 403
        _, head = ask(page, host, path=f"/?x=1&token={token}")
        assert f"Set-Cookie: loewner-token-{page.server.get_port()}={token}; Path=/; HttpOnly; SameSite=Strict" in head
        assert address == f"http://localhost:{page.server.get_port()}"


def test_no_token_for_this_machine(capsys):
    """The page for this machine alone has a plain address, and sets no cookie."""
    with two_boxes(host="localhost") as page:
        assert page.url == f"http://localhost:{page.server.get_port()}"
        assert "Set-Cookie" not in ask(page, "Host: localhost:{port}")[1]
    assert "token" not in capsys.readouterr().out


def test_page_reaches_this_server_alone(open_page):
    """viser's page follows addresses in its own: the policy sent with it keeps it, and foreign frames, out."""
    head = ask(open_page, "Host: localhost:{port}")[1]
    policy = re.search(r"Content-Security-Policy: (.*)", head)[1]
    assert f"connect-src 'self' ws://localhost:{open_page.server.get_port()} data: blob:;" in policy
    assert "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*" in policy


def test_ipv6():
    """A page at ::1 has an address that opens it."""
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("no IPv6 here")
    with two_boxes(host="::1") as page:
        assert page.url == f"http://[::1]:{page.server.get_port()}"
        for websocket in (False, True):
            asked = {"websocket": websocket, "address": "::1"}
            assert ask(page, "Host: [::1]:{port}", "Origin: " + page.url, **asked)[0] == SERVED[websocket]
            assert ask(page, "Host: evil.example:{port}", **asked)[0] == 403


def test_page_cannot_be_published(viser, open_page):
    """A client of viser's can ask the server to publish itself at an address of the internet; ours does not listen."""
    assert viser._messages.ShareUrlRequest not in open_page.server._websock_server._incoming_handlers


async def do_nothing(*_):
    pass


@pytest.mark.parametrize("change", ["guard is not asked", "viser is built otherwise", "websockets is built otherwise"])
def test_viser_that_cannot_be_guarded(viser, change, monkeypatch):
    """A viser in which the guard has no effect, or no place, is refused by its version, and its server is stopped."""
    if change == "guard is not asked":
        monkeypatch.setattr(guard, "_put", do_nothing)
    elif change == "viser is built otherwise":
        monkeypatch.delattr(viser.infra.WebsockMessageHandler, "unregister_handler")
    else:
        from websockets.asyncio.server import Server

        # Read when a connection is made, and not to be set from outside.
        monkeypatch.setattr(Server, "process_request", property(lambda _: None, lambda *_: None), raising=False)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    expected = rf"a viser that it can guard .*: expected one built like 1\.1, found {re.escape(viser.__version__)}"
    with pytest.raises(loewner.MissingExtraError, match=expected):
        two_boxes(port=port)
    socket.create_server(("127.0.0.1", port)).close()


def test_port_in_use():
    """A port that another program has is refused by name, not silently changed."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(loewner.InputError, match=f"port: expected a free port .* {port}"):
            viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port)


@pytest.mark.parametrize("port", [-1, 65536, 80.5, "8080", True])
def test_port_that_is_none(port):
    """A port has to be a whole number from 0 to 65535."""
    with pytest.raises(loewner.InputError, match="port: expected an integer"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port)


def test_host_that_is_none():
    """A host that does not exist is refused by its name."""
    with pytest.raises(loewner.InputError, match="no such host"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, host="no such host")


def test_close_twice_and_free_the_port():
    """Closing a page twice is harmless, and its port is free afterwards."""
    page = viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)
    port = page.server.get_port()
    page.close()
    page.close()
    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port) as again:
        assert again.url == f"http://localhost:{port}"
        assert repr(again) == f"PairViewer({again.url})"
    assert repr(again) == "PairViewer(closed)"


@pytest.mark.parametrize(
    "host", [None, 3, True, b"127.0.0.1", ["127.0.0.1"], 10**400, "", "a\0b", "\ud800", "x" * 300, "[::1]", " "]
)
def test_host_that_is_no_address(host):
    """A host has to be text that can be an address or a name."""
    with pytest.raises(loewner.InputError, match="host: expected an address or the name of a host"):
        two_boxes(host=host)


@pytest.mark.parametrize(
    "port", [None, b"80", 10**400, 10**5000, -(10**5000), float("nan"), np.nan, [80], np.bool_(True), 1j], ids=type
)
def test_port_that_is_no_number(port):
    """A port that is no whole number, or far out of range, is refused."""
    with pytest.raises(loewner.InputError, match="port: expected an integer"):
        two_boxes(port=port)


def test_host_of_another_machine():
    """An address that is none of this machine's is refused, not listened at for ever."""
    with pytest.raises(loewner.InputError, match=r"at 192\.0\.2\.1, could not have 0"):
        two_boxes(host="192.0.2.1")


EVIL = """
<!doctype html><iframe src="{url}"></iframe><script>
  const found = {{}};
  const socket = new WebSocket("{ws}", ["viser-v{version}"]);
  socket.onopen = () => found.websocket = "open";
  socket.onclose = () => found.websocket ??= "refused";
  fetch("{url}").then(r => r.text()).then(t => found.page = "read", () => found.page = "refused");
</script>
"""


@contextmanager
def site(html):
    """Serve a page of another site; gives its port and the list of what was asked of it."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.path, self.headers.get("Upgrade")))
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(html.encode())

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_port, asked
        finally:
            server.shutdown()


def test_another_site_in_the_browser(tab, viser):
    """A page of another site, in the same browser, gets no websocket, cannot read the page and cannot frame it.

    Nor does it when its own name is made to point to the page's server.
    """
    with two_boxes() as page:
        ws = page.url.replace("http", "ws")
        with site(EVIL.format(url=page.url, ws=ws, version=viser.__version__)) as (port, asked):
            tab.goto(f"http://evil.example:{port}/")
            tab.wait_for_function("() => found.websocket && found.page", timeout=PATIENCE)
            assert tab.evaluate("found") == {"websocket": "refused", "page": "refused"}
            assert asked
            assert tab.frames[1].url.startswith("chrome-error:")
        rebound = tab.goto(f"http://evil.example:{page.server.get_port()}/")
        assert rebound.status == 403
        assert "expected a Host of this server" in tab.content()
        time.sleep(0.5)
        assert len(page.server.get_clients()) == 0
        tab.close()  # with its spare connections, which the server would wait for


@pytest.mark.verify
@pytest.mark.parametrize("end", ["websocket=ws://localhost:{}", "playbackPath=http://localhost:{}/x.viser"])
def test_link_cannot_lead_the_page_astray(tab, end, monkeypatch):
    """viser's page connects to what its address names, and shows what it finds there as its own; ours does not.

    Left to itself it connects within some time; with the policy sent with it, it has not after twice that time.
    """
    with two_boxes() as page, site("") as (port, asked):
        took = []
        for policy in (False, True):
            with monkeypatch.context() as patch:
                if not policy:
                    patch.setattr(guard.Guard, "admit", lambda *_: None)
                started = time.monotonic()
                tab.goto(f"{page.url}/?{end.format(port)}")
                while not asked and time.monotonic() < started + (2 * took[0] + 1 if policy else PATIENCE / 1000):
                    tab.wait_for_timeout(50)
                took.append(time.monotonic() - started)
            assert bool(asked) != policy, asked
            tab.goto("about:blank")
            tab.wait_for_timeout(300)
            asked.clear()


@pytest.mark.verify
@pytest.mark.parametrize("host", ["0.0.0.0", pytest.param("::1", marks=pytest.mark.verify)])
def test_page_with_token_in_the_browser(browser, host):
    """The browser shows the page at the address given, again without its token, and not to who never had it."""
    context, stranger = browser.new_context(viewport=WINDOW), browser.new_context(viewport=WINDOW)
    try:
        with two_boxes(host=host) as page:
            tab = context.new_page()
            tab.goto(page.url, timeout=PATIENCE)
            tab.locator('[data-loewner="verdict"]', has_text="FREE").wait_for(timeout=PATIENCE)
            assert tab.get_by_text("Share").count() == 0
            bare = page.url.partition("/?")[0]
            tab.goto(bare + "/", timeout=PATIENCE)
            tab.locator('[data-loewner="verdict"]', has_text="FREE").wait_for(timeout=PATIENCE)
            met = stranger.new_page().goto(bare + "/", timeout=PATIENCE)
            assert met.status == (403 if "token" in page.url else 200)
    finally:
        context.close()
        stranger.close()
