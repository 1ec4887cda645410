"""Doors of the page: requests must name the server and come from the pages; no other page may frame the pages.

A page of elsewhere whose name was made to point here (DNS rebinding) sends its own name as ``Host``; one that opens a
socket to here sends it as ``Origin``. An address points nowhere else: the one that a request came to
is served, whatever interface has it. Who is on this computer can look all the same.
"""

from collections.abc import Collection
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from im_pnt_display.page.hosts import address_of, served_names

REQUEST_S = 10.0
"""A connection that has not sent a whole request after this time is closed [s]."""

_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # another machine at this address has another token, and perhaps another page
    "Cross-Origin-Resource-Policy": "same-origin",
}


def guarded_application(host: str) -> web.Application:
    """Return an application with checked requests, and with rules for browsers on the pages."""
    app = web.Application(middlewares=[_only_for(served_names(host))])
    app.on_response_prepare.append(_tell_browser)
    return app


def _only_for(names: Collection[str]) -> Middleware:
    served = sorted(names)

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        name = _host_name(host)
        if name not in served and not _came_to(request, name):
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


def _came_to(request: web.Request, name: str | None) -> bool:
    """Return whether a text is the address of the computer at which a request came in."""
    own = request.transport.get_extra_info("sockname") if request.transport is not None else None
    return own is not None and name is not None and address_of(name) == address_of(own[0])


async def _tell_browser(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
