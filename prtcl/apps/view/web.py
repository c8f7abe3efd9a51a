"""The viewer's web server: viser's, kept to this machine and to its own page."""

from __future__ import annotations

import contextlib
import io
import socket
import warnings
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from prtcl.errors import InputError, PrtclError
from prtcl.scene.camera import Camera

INSTALL = "prtcl view needs viser, which is not installed\npip install 'prtcl[viewer]'"
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


def start(host: str, port: int, eye: Camera, vertical: float) -> Any:
    """A server that listens, with the view that a new page starts from.

    Parameters
    ----------
    eye : that view; a page's canvas decides its width
    vertical : its field of view, radians

    Raises
    ------
    InputError
        If viser is missing, or the address cannot be listened at.
    """
    try:
        import viser
    except ImportError as error:
        raise InputError(INSTALL) from error

    class Server(viser.ViserServer):  # type: ignore[misc, unused-ignore]
        def request_share_url(self, verbose: bool = True) -> str | None:
            """None: viser would open a tunnel to a public server whenever a page asks for one."""
            return None

    require_free(host, port)
    # A page may go while its picture is made: no news for the terminal.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    with _silenced():
        server = Server(host, port, label="prtcl", verbose=False)
    if port and server.get_port() != port:  # viser takes the next one that is free
        stop(server)
        raise _in_use(host, port)
    server.gui.configure_theme(
        dark_mode=True, show_logo=False, show_share_button=False, control_width="medium"
    )
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction(eye.up)
    server.initial_camera.position, server.initial_camera.look_at = eye.eye, eye.target
    server.initial_camera.up, server.initial_camera.fov = eye.up, vertical
    return server


def stop(server: Any) -> None:
    """Close all connections and stop listening."""
    with _silenced():
        server.stop()


def require_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened at: viser tries the next ports, a thousand of them.

    Raises
    ------
    InputError
        Naming it.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except (OSError, OverflowError, UnicodeError) as error:
        if getattr(error, "errno", None) == 98:
            raise _in_use(host, port) from error
        raise InputError(f"--host {host} --port {port}: cannot listen there: {error}") from error


def is_own_page(server: Any, client_id: int, host: str) -> bool:
    """Whether a connection comes from this server's page, and not from another site open in the same browser.

    Browsers let any site connect to a local port; what it says of itself is the origin.
    """
    connection = server._websock_server._live_connections.get(client_id)
    if connection is None:
        return False
    headers = connection.request.headers
    return allowed(headers.get("Origin"), headers.get("Host"), host)


def allowed(origin: str | None, named: str | None, host: str) -> bool:
    """Whether a connection's origin and the host it asked for are this server's.

    Parameters
    ----------
    origin : the Origin header; None where no browser connects
    named : the Host header
    host : what the server listens at
    """
    if origin is None:
        return True
    at = urlsplit(origin).netloc
    # A foreign name that resolves to this machine is not ours, unless the server was opened to others.
    local = host in ("localhost", "127.0.0.1", "::1")
    return at == named and (not local or at.rpartition(":")[0] in LOOPBACK or at in LOOPBACK)


def check_viser(server: Any) -> None:
    """Refuse a viser that does not let `is_own_page` look."""
    if not hasattr(getattr(server, "_websock_server", None), "_live_connections"):
        raise PrtclError("this viser is too new for prtcl view\npip install 'viser<1.2'")


def url(host: str, port: int) -> str:
    """What to open in a browser."""
    shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}"


def _in_use(host: str, port: int) -> InputError:
    return InputError(f"--port {port}: is in use at {host}; choose another, or 0 for any that is free")


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """viser announces itself on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
