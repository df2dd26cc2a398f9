"""Starting the web server: address, warm-up, and an ending that closes files."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING

from analysis.play.robot_mind import RobotMind
from analysis.play.settings import PlaySettings
from models.errors import InputError, Phrase, located
from models.game.robot import RobotPlayer
from models.game.round import Round

if TYPE_CHECKING:
    from analysis.play.study import Study

NEEDED = ("starlette", "uvicorn", "websockets")


def check_installed() -> None:
    """Refuse to go on without the packages of the optional extra.

    Raises
    ------
    InputError
        Saying what to install.
    """
    from importlib.util import find_spec

    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise InputError(
            f"play: {', '.join(missing)} not installed; wanted the optional extra game: pip install -e '.[game]'"
        )


def reserve(host: str, port: int) -> socket.socket:
    """Take the address without answering there yet, so that browsers are told at once that nobody is there.

    Port 0 is any free one.

    Raises
    ------
    InputError
        If it is taken or none of this machine's.
    """
    try:
        family, kind, proto, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        taken = socket.socket(family, kind, proto)
    except OSError as error:
        raise located("--host", host, f"an address of this machine ({error.strerror})") from None
    try:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(address)
    except OSError as error:
        taken.close()
        raise _not_free(f"{host}, port {port}", error) from None
    return taken


def open_port(taken: socket.socket) -> None:
    """Answer at an address from `reserve`.

    Raises
    ------
    InputError
        If another server has begun to answer there in the meantime.
    """
    try:
        taken.listen(128)
    except OSError as error:
        host, port, *_ = taken.getsockname()
        raise _not_free(f"{host}, port {port}", error) from None


def _not_free(address: str, error: OSError) -> InputError:
    return located("--port", Phrase(f"{address}: {error.strerror}"), "a free port of this machine")


def address_of(taken: socket.socket, host: str) -> str:
    """Where a browser on this machine finds the page."""
    name = "127.0.0.1" if host in ("0.0.0.0", "::", "") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{taken.getsockname()[1]}/"


def is_loopback(taken: socket.socket) -> bool:
    """Whether only this machine can reach the address."""
    import ipaddress

    return ipaddress.ip_address(taken.getsockname()[0].partition("%")[0]).is_loopback


def warm_up(settings: PlaySettings) -> None:
    """Compile what a round needs before anybody waits for it, and let each policy think once."""
    game, robot = Round(settings.layout, settings.parameters), RobotPlayer()
    game.step(0, robot.move(game))
    for policy in settings.policies:
        RobotMind(policy, settings.modes).act(settings.policy_rng(0, 0))


def serve(study: Study, taken: socket.socket, host: str, site: str | None, ready: Callable[[], None]) -> None:
    """Serve until Ctrl-C; rounds that are finished by then are written.

    Parameters
    ----------
    study : Study
    taken : socket
        From `reserve`; it answers from now on.
    host, site : str
        As in `analysis.play.server.application`.
    ready : callable
        Called when pages are answered.

    Raises
    ------
    InputError
        If another server answers there by now.
    """
    import uvicorn

    from analysis.play.server import MOST_BYTES, application

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            ready()

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            # Shutting down takes seconds at the most; a second Ctrl-C would tear it apart in the middle.
            if not self.should_exit:
                super().handle_exit(sig, frame)

    config = uvicorn.Config(
        application(study, host, site), ws="websockets-sansio", ws_max_size=MOST_BYTES,
        ws_per_message_deflate=False,
        # Network addresses of players are nobody's business, so nothing is logged but errors.
        access_log=False, log_config=None, log_level=logging.WARNING, server_header=False, proxy_headers=False,
        timeout_graceful_shutdown=3, lifespan="on",
    )  # fmt: skip
    try:
        open_port(taken)
        Server(config).run(sockets=[taken])
    except KeyboardInterrupt:
        pass  # how a server is ended
    finally:
        study.close()
