"""The server: access by token from this computer only, no content from other hosts, limited uploads."""

from __future__ import annotations

import hmac
import logging
import secrets
import socket
from typing import Any

from nicegui import app, core, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection

from leastaction.app.files import MOST_BYTES
from leastaction.app.page import close_sessions, root
from leastaction.errors import InputError

__all__ = ["HOST", "Keys", "free_port", "serve"]

HOST = "127.0.0.1"
_PORTS = range(8137, 8157)
# Vue compiles templates in the browser, hence 'unsafe-eval'; every source is this server.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host}; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors 'none'"
)
_NO_KEY = (
    "This leastaction app needs its token: open the complete address that it printed in the terminal, "
    "including ?token=, in a browser that accepts cookies."
)
_FOREIGN = "A page from another address may not use this leastaction app: open the app itself in the browser."
_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><path d="M4 5Q9 29 28 27" fill="none" '
    'stroke="#0b67ad" stroke-width="4" stroke-linecap="round"/>'
    '<circle cx="14" cy="20" r="4.5" fill="#d0580a"/></svg>'
)


def free_port(port: int | None) -> int:
    """Return `port` if it is free; without one, the first free of a few.

    Raises
    ------
    InputError
        If no port is free.
    """
    for candidate in _PORTS if port is None else [port]:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, candidate))
            except OSError:
                continue
            return candidate
    what = f"port {port} is" if port is not None else f"ports {_PORTS[0]} to {_PORTS[-1]} are"
    raise InputError(f"{what} in use, perhaps by an app that is still running; give another with --port")


class Keys:
    """Credentials of the app on one port: the token in its address, and the cookie that replaces it.

    The browser is started with a ticket instead, which is valid once, because all users of a computer can
    read command lines.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._token, self._ticket, self._value = (secrets.token_urlsafe() for _ in range(3))
        self._cookie = f"leastaction-{port}"  # cookies do not distinguish ports

    @property
    def address(self) -> str:
        """Address for the user, valid in any browser and any number of times."""
        return f"http://{HOST}:{self._port}/?token={self._token}"

    @property
    def path_once(self) -> str:
        """Path that is valid for the first request."""
        return f"/?token={self._ticket}"

    @property
    def cookie(self) -> str:
        """Value of the header `Set-Cookie`; the cookie ends with the browser session."""
        return f"{self._cookie}={self._value}; Path=/; HttpOnly; SameSite=Strict"

    def opens(self, token: str) -> bool:
        """Whether a token is valid; a ticket becomes invalid."""
        if _same(token, self._ticket):
            self._ticket = secrets.token_urlsafe()
            return True
        return _same(token, self._token)

    def fits(self, cookies: dict[str, str]) -> bool:
        """Whether a request has the cookie."""
        return _same(cookies.get(self._cookie, ""), self._value)


def _same(given: str, wanted: str) -> bool:
    """Comparison in constant time."""
    return hmac.compare_digest(given.encode(), wanted.encode())


class Door:
    """Accepts requests with the cookie; refuses all others, and those of other pages.

    Browsers treat another port of this computer as the same site and send the cookie. The origin must
    therefore equal the requested address.
    """

    def __init__(self, application: Any, keys: Keys) -> None:
        self.application, self.keys = application, keys

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.application(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        origin = asked.headers.get("origin")
        if origin is not None and origin != f"http://{asked.headers.get('host')}":
            await _answer(scope, send, 403, _FOREIGN)
        elif self._brings_token(asked):
            headers = {"location": "/", "set-cookie": self.keys.cookie}
            await _answer(scope, send, 303, "The app is at the address without the token.", headers)
        elif self.keys.fits(asked.cookies):
            await self.application(scope, receive, send)
        else:
            headers = {}
            if asked.headers.get("sec-fetch-site") == "cross-site":
                # Browsers omit the cookie when the user follows a link from another site. They send it when
                # this page requests the app.
                headers["refresh"] = "0; url=/"
            await _answer(scope, send, 403, _NO_KEY, headers)

    def _brings_token(self, asked: HTTPConnection) -> bool:
        if asked.scope["type"] != "http" or asked.scope["method"] != "GET":
            return False
        return self.keys.opens(asked.query_params.get("token", ""))


async def _answer(
    scope: Any, send: Any, status: int, text: str, headers: dict[str, str] | None = None
) -> None:
    """One sentence instead of the app; also to a socket if the server supports it."""
    kind = "http"
    if scope["type"] == "websocket":
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008})  # the server makes it a 403
            return
        kind = "websocket.http"
    all_headers = {
        "content-type": "text/plain; charset=utf-8",
        "cache-control": "no-store",
        "vary": "Cookie",  # NiceGUI allows caching; this answer must not be reused with a cookie
        **(headers or {}),
    }
    lines = [(name.encode(), value.encode()) for name, value in all_headers.items()]
    await send({"type": f"{kind}.response.start", "status": status, "headers": lines})
    await send({"type": f"{kind}.response.body", "body": f"{text}\n".encode()})


class Guard:
    """Refuses bodies that are too large, and forbids the browser to load content from elsewhere.

    The Host header is checked, too (see `install`), against pages whose host name points to this computer.
    """

    def __init__(self, application: Any) -> None:
        self.application = application

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] != "http":
            await self.application(scope, receive, send)
            return
        headers = dict(scope["headers"])
        policy = _POLICY.format(host=headers.get(b"host", b"127.0.0.1").decode("latin-1")).encode("latin-1")
        taken = 0

        async def limited() -> Any:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            # Simulates a disconnect, so that the reader of the body stops.
            return {"type": "http.disconnect"} if taken > MOST_BYTES + 1_000_000 else message

        async def guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                extra = [(b"content-security-policy", policy), (b"x-content-type-options", b"nosniff")]
                message["headers"] = [
                    *message.get("headers", []),
                    *extra,
                    (b"referrer-policy", b"no-referrer"),
                ]
            await send(message)

        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > MOST_BYTES + 1_000_000:
            await guarded({"type": "http.response.start", "status": 413, "headers": []})
            await send({"type": "http.response.body", "body": b"the file is too large"})
            return
        await self.application(scope, limited, guarded)


def _worth_telling(record: logging.LogRecord) -> bool:
    """Whether a log record is more than a browser that disconnected early."""
    error = record.exc_info[1] if record.exc_info else None
    return not (isinstance(error, RuntimeError) and str(error) == "No response returned.")


def install(keys: Keys) -> None:
    """Install door and guards before NiceGUI, and end all workers at shutdown."""
    logging.getLogger("uvicorn.error").addFilter(_worth_telling)
    core.sio.eio.cors_allowed_origins = None  # the same origin only; NiceGUI allows all
    app.add_middleware(Door, keys=keys)
    app.add_middleware(Guard)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    app.on_shutdown(close_sessions)


def serve(port: int, keys: Keys, show: bool) -> None:
    """Run until interrupted."""
    install(keys)
    # The views say what they wait for; Quasar's bar for requests has no accessible name.
    app.config.quasar_config.setdefault("loadingBar", {})["skipHijack"] = True
    ui.run(
        root,
        host=HOST,
        port=port,
        show=keys.path_once if show else False,
        title="leastaction",
        favicon=_FAVICON,
        dark=None,
        language="en-US",
        reload=False,
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=30.0,
    )
