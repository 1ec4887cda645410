"""Who may look at the page: requests that name this server, from pages of this server, which nobody may frame.

A page of elsewhere whose name was made to point here (DNS rebinding) sends its own name as ``Host``; one that opens a
socket to here sends it as ``Origin``. Who is on this computer can look all the same.
"""

from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

HERE = ("localhost", "127.0.0.1", "::1")
REQUEST_S = 10.0
"""A connection that has not sent a whole request after this time is closed [s]."""

_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def guarded_application(name: str) -> web.Application:
    """Returns an application that answers only who may ask, and tells browsers what its pages may do.

    Args:
        name: Name or address that it is served under, besides those of this computer for itself.
    """
    app = web.Application(middlewares=[_only_for((*HERE, name.lower().strip("[]")))])
    app.on_response_prepare.append(_tell_browser)
    return app


def _only_for(names: tuple[str, ...]) -> Middleware:
    served = sorted(set(names))

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        if _host_name(host) not in served:
            raise web.HTTPForbidden(text=f"host {host[:100]!r} is not served here; served are {', '.join(served)}")
        origin = request.headers.get("Origin")
        if origin is not None and origin.lower() != f"{request.scheme}://{host}".lower():
            raise web.HTTPForbidden(text=f"pages of {origin[:100]!r} may not use this display")
        return await handler(request)

    return check


def _host_name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


async def _tell_browser(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
