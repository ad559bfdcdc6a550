"""The server of the page: opening it on a free port for pages of this machine, and closing it."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import socket
from collections.abc import Iterator
from functools import partial

import viser
from websockets.asyncio import server as websockets_server

from nsm.cli.errors import InputError

#: Addresses that stand for all of this machine, under whatever name another machine knows it.
_WILDCARDS = ("0.0.0.0", "::", "")
#: Number of ports that are tried in search of a free one.
_TRIES = 100


def open_server(host: str, port: int | None) -> viser.ViserServer:
    """Open an empty page.

    Args:
        host: Address of the page.
        port: Port of the page; None for any free one.

    Raises:
        InputError: If the port is taken, or the host is not an address of this machine.
    """
    free = free_port(host, 0 if port is None else port)
    # viser would silently take the next port, and the page would not be where the user looks for it
    if port not in (None, free):
        raise InputError(f"`port` must be free, got {port}, which is in use on {host}. Try `port={free}`.")
    logging.getLogger("websockets").setLevel(logging.WARNING)  # it logs every connection
    with contextlib.redirect_stdout(io.StringIO()), _own_pages_only(host):  # viser prints a table of addresses
        server = viser.ViserServer(host, free, verbose=False)
    if server.get_port() != free:  # another process was faster
        close_server(server)
        other = free_port(host, free)
        raise InputError(f"`port` must be free, got {free}, which is in use on {host}. Try `port={other}`.")
    return server


@contextlib.contextmanager
def open_page(host: str, port: int | None) -> Iterator[viser.ViserServer]:
    """Open an empty page with a panel for controls, and close it at the end.

    Raises:
        InputError: Under the conditions of `open_server`.
    """
    server = open_server(host, port)
    try:
        clear(server)
        yield server
    finally:
        close_server(server)


def clear(server: viser.ViserServer) -> None:
    """Remove everything from the scene and the panel of a page."""
    server.scene.reset()
    clear_panel(server)


def clear_panel(server: viser.ViserServer) -> None:
    """Remove everything from the panel of a page."""
    server.gui.reset()
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(47, 95, 179))
    server.gui.set_panel_label("nsm")
    server.gui.main_panel.dock_right()


def page_address(server: viser.ViserServer) -> str:
    """URL of a page."""
    host = server.get_host()
    return f"http://{'127.0.0.1' if host in ('0.0.0.0', '::') else host}:{server.get_port()}"


@contextlib.contextmanager
def _own_pages_only(host: str) -> Iterator[None]:
    """Let a server that starts within the context refuse the pages of other sites.

    Any site that the user visits could otherwise connect to the viewer and change its settings. Pages of this machine
    may come from any port, as they do through a tunnel. viser has no option for this, so its call is given one here.
    """
    if host in _WILDCARDS:
        yield
        return
    names = "|".join(re.escape(name) for name in ("localhost", "127.0.0.1", "[::1]", host, f"[{host}]"))
    origins = [None, re.compile(rf"https?://({names})(:\d+)?")]  # programs other than browsers send no origin
    serve = websockets_server.serve
    websockets_server.serve = partial(serve, origins=origins)  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        websockets_server.serve = serve  # type: ignore[misc]


def close_server(server: viser.ViserServer) -> None:
    """Close a page without the message that viser prints."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def free_port(host: str, first: int) -> int:
    """Find a free port: ``first`` or one soon after it; any if ``first`` is 0.

    Raises:
        InputError: If there is none, or the host is not an address of this machine.
    """
    reason = ""
    for port in range(first, min(first + _TRIES, 1 << 16)):
        try:
            with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET) as bound:
                return int(bound.getsockname()[1])
        except OSError as error:
            reason = error.strerror or str(error)
    raise InputError(
        f"`host` and `port` must be an address of this machine with a free port, got {host} and {first} ({reason}). "
        "Try `host=127.0.0.1 port=8080`."
    )
