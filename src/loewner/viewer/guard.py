"""Control access to the page: check each request, for the page or its websocket, before viser receives it.

viser serves any client that can reach its port. Such a client need not be a user of this machine. A page from any site,
opened in a browser on this machine, can open a websocket to 127.0.0.1, or to a name that resolves to this address. A
request from such a page can be refused, since its Origin or Host names the page's site, and no script in a browser can
change these headers.
"""

from __future__ import annotations

import asyncio
import base64
import dataclasses
import gzip
import hmac
import http.client
import ipaddress
import os
import re
import socket
from html import escape
from typing import Any
from urllib.parse import parse_qs, urlsplit

from loewner.errors import InputError, MissingExtraError
from loewner.viewer.style import HEAD

# Seconds within which the newly started server must answer the guard's own requests.
PATIENCE = 30.0

FORBIDDEN = 403

# A Host header: a name or an address (IPv6 in brackets), followed by the port unless it is HTTP's default port.
HOST = re.compile(r"(?P<name>\[[0-9a-f:.]+\]|[^\s:/@\[\]]+)(?::(?P<port>[0-9]{1,5}))?")
HTTP_PORT = "80"

# The title of the page as viser serves it.
VISERS_TITLE = b"<title>Viser</title>"

# No host has this name (RFC 2606). The name represents all foreign hosts when the guard is tested.
FOREIGN = "loewner.invalid"


@dataclasses.dataclass(frozen=True)
class Listening:
    """The address at which the page is served.

    Attributes
    ----------
    host : str
        The host, as given by the caller.
    address : str
        Numeric address of the host, on which the server listens.
    family : socket.AddressFamily
    """

    host: str
    address: str
    family: socket.AddressFamily

    @property
    def loopback(self) -> bool:
        """Whether only programs on this machine can connect."""
        return ipaddress.ip_address(self.address).is_loopback

    @property
    def everywhere(self) -> bool:
        """Whether the address stands for all addresses of this machine."""
        return ipaddress.ip_address(self.address).is_unspecified

    @property
    def own_address(self) -> str:
        """Address at which this machine reaches the server."""
        if not self.everywhere:
            return self.address
        return "::1" if self.family == socket.AF_INET6 else "127.0.0.1"

    def url(self, port: int, token: str | None, name: str | None = None) -> str:
        """Return the address to type into a browser, on this machine or on one that reaches this machine by `name`."""
        if name is None:
            name = "localhost" if self.own_address == "127.0.0.1" else self.host if not self.everywhere else "::1"
        host = f"[{name}]" if ":" in name else name
        return f"http://{host}:{port}" + ("" if token is None else f"/?token={token}")


def listening(host: Any) -> Listening:
    """Find the address of a host. Raise an InputError if the host has no address."""
    if not isinstance(host, str):
        raise InputError(f"host: expected an address or the name of a host as a str, found {type(host).__name__}")
    if not host:
        raise InputError(
            "host: expected an address or the name of a host, found ''; '0.0.0.0' is all of this machine's"
        )
    try:
        # The server gets this address instead of the name, so it listens at exactly the address that was checked.
        addresses = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        family, address = min((family, str(where[0])) for family, *_, where in addresses)
        ipaddress.ip_address(address)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"host: expected an address or the name of a host, found {host!r} ({reason})") from None
    return Listening(host, address, family)


class Guard:
    """Accept or refuse each request, by its headers and its path.

    Parameters
    ----------
    where : Listening
    port : int
    token : str or None
        The secret that a client must send, or None if no secret is required.
    title : str
        Title of the browser's tab.
    """

    def __init__(self, where: Listening, port: int, token: str | None, title: str) -> None:
        self.where, self.port, self.token, self.title = where, port, token, title
        # The name contains the port: all ports of a host share cookies, and two pages must not overwrite each other's
        # cookies.
        self.cookie = f"loewner-token-{port}"
        self._names = {"localhost", where.host.lower(), where.address}
        if where.everywhere:
            self._names |= {socket.gethostname().lower(), socket.gethostname().lower().partition(".")[0]}

    def refusal(self, path: str, headers: Any) -> str | None:
        """Return the reason for refusing a request, or None if the request is accepted.

        Parameters
        ----------
        path : str
            Path of the request, including the part after the question mark.
        headers : websockets.Headers
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._knows(hosts[0].lower()):
            return f"expected a Host of this server, such as localhost:{self.port}"
        # Browsers send no Origin when a page is opened, and always send one with a websocket. A websocket without an
        # Origin comes from a program, which could just as well send the right Origin.
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "expected a page of this server as Origin"
        if self.token is not None and not any(map(self._is_token, (*_queried(path), *self._cookies(headers)))):
            return "expected the token of this page: open the whole address that was printed when it was started"
        return None

    def admit(self, path: str, response: Any, host: str) -> None:
        """Complete a page before it is sent, with a title, style, the websocket's token, and the policy on connections.

        viser's page follows `?websocket=ws://...` and `?playbackPath=...` to any address and shows the content as its
        own, so a link to this server with such parameters could be used in an attack. The policy allows connections
        only to this server. It also prevents pages of other machines from framing this page, because such pages could
        collect clicks unnoticed.
        """
        self._entitle(response)
        response.headers["Content-Security-Policy"] = (
            "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
            f"connect-src 'self' ws://{host} data: blob:; "
            "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*"
        )
        response.headers["Referrer-Policy"] = "no-referrer"
        if self.token is not None and any(map(self._is_token, _queried(path))):
            response.headers["Set-Cookie"] = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _entitle(self, response: Any) -> None:
        """Add the title and the style to the page, which stays unchanged if viser's version is unknown."""
        packed = response.headers.get("Content-Encoding") == "gzip"
        content = gzip.decompress(response.body) if packed else response.body
        if VISERS_TITLE in content:
            named = content.replace(VISERS_TITLE, f"<title>{escape(self.title)}</title>{HEAD}".encode(), 1)
            response.body = gzip.compress(named, compresslevel=1) if packed else named
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))

    def _knows(self, host: str) -> bool:
        read = HOST.fullmatch(host)
        if read is None or (read["port"] or HTTP_PORT) != str(self.port):
            return False
        name = read["name"].strip("[]")
        if name in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        # A numeric address is safe: foreign sites have names, and only a name can be redirected.
        return address.is_loopback or self.where.everywhere

    def _cookies(self, headers: Any) -> list[str]:
        pairs = (part.partition("=") for line in headers.get_all("Cookie") for part in line.split(";"))
        return [value.strip() for name, _, value in pairs if name.strip() == self.cookie]

    def _is_token(self, said: str) -> bool:
        assert self.token is not None
        return hmac.compare_digest(said.encode("utf-8", "replace"), self.token.encode())


def _queried(path: str) -> list[str]:
    try:
        return parse_qs(urlsplit(path).query).get("token", [])
    except ValueError:  # not an address, for example an unclosed bracket
        return []


def install(server: Any, guard: Guard) -> None:
    """Put the guard in front of a viser server that has just been started, and check that the guard works.

    viser has no hook for this, so the guard is installed in the websockets server on which viser is built. That server
    is reached through one of its own connections, opened for this purpose. Clients that connected earlier are
    disconnected in the same turn of the server's loop. During this turn, no client can connect, and the page is still
    empty. If the internals of viser or websockets are not as expected, the installation or the check fails, and no page
    is left open.

    Raises
    ------
    MissingExtraError
        If the installed viser cannot be guarded.
    """
    import viser

    try:
        infra = server._websock_server
        # viser's page can request to be published at an address on the internet.
        for message in (viser._messages.ShareUrlRequest, viser._messages.ShareUrlDisconnect):
            infra.unregister_handler(message)
        status, first = _ask(guard, upgrade=True)
        try:
            if status != http.client.SWITCHING_PROTOCOLS:
                raise RuntimeError(f"a websocket was answered by {status}")
            loop = infra._background_event_loop
            asyncio.run_coroutine_threadsafe(_put(guard, infra._live_connections), loop).result(PATIENCE)
        finally:
            first.close()
        _try(guard)
    except Exception as error:
        raise MissingExtraError(
            f"the viewer needs a viser that it can guard against foreign requests: expected one built like 1.1, found "
            f"{getattr(viser, '__version__', 'one without a version')} ({type(error).__name__}: {error})"
        ) from error


async def _put(guard: Guard, connections: Any) -> None:
    end = asyncio.get_running_loop().time() + PATIENCE
    while not connections:
        if asyncio.get_running_loop().time() > end:
            raise TimeoutError("viser noted no connection")
        await asyncio.sleep(0.001)
    websockets = next(iter(connections.values())).server
    serve = websockets.process_request
    if not callable(serve):
        raise TypeError(f"expected viser's page server, found {serve!r}")

    def process_request(connection: Any, request: Any) -> Any:
        why = guard.refusal(request.path, request.headers)
        if why is not None:
            return connection.respond(FORBIDDEN, f"Refused: {why}.\n")
        response = serve(connection, request)
        if response is not None:
            guard.admit(request.path, response, request.headers["Host"])
        return response

    websockets.process_request = process_request
    for connection in list(websockets.handlers):
        connection.transport.abort()


def _try(guard: Guard) -> None:
    """Send requests that must be refused, and check that the guard refuses them."""
    foreign = f"http://{FOREIGN}:{guard.port}"
    wrong: list[dict[str, Any]] = [
        {"host": FOREIGN},
        {"host": FOREIGN, "upgrade": True},
        {"origin": foreign, "upgrade": True},
        {"origin": "null", "upgrade": True},
    ]
    if guard.token is not None:
        wrong += [{"token": None}, {"token": None, "upgrade": True}]
    for request in wrong:
        status, connection = _ask(guard, **request)
        connection.close()
        if status != FORBIDDEN:
            raise RuntimeError(f"a request with {request} was answered by {status}")


def _ask(
    guard: Guard, *, host: str = "localhost", origin: str | None = None, token: str | None = "", upgrade: bool = False
) -> tuple[int, http.client.HTTPConnection]:
    """Send a request to the server, with the right token unless `token` is None; return the status of the answer."""
    import viser

    headers = {"Host": f"{host}:{guard.port}"}
    if origin is not None:
        headers["Origin"] = origin
    if upgrade:
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        headers |= {"Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode()}
        headers |= {"Sec-WebSocket-Protocol": f"viser-v{viser.__version__}"}
    query = "" if token is None or guard.token is None else f"?token={guard.token}"
    connection = http.client.HTTPConnection(guard.where.own_address, guard.port, timeout=PATIENCE)
    connection.request("GET", f"/{query}", headers=headers)
    return connection.getresponse().status, connection
