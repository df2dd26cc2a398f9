"""One page and the server in conversation: consent, rounds on the clock, withdrawal, and coming back.

Messages to the page: ``welcome`` (what the study is), ``session`` (who is playing, which round is next), ``round``,
``tick``, ``over``, ``withdrawn``, ``sorry``. Those of the page: `analysis.play.messages`.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from analysis.play.live_round import LiveRound
from analysis.play.messages import Allowance, BadMessage, Message, parse
from analysis.play.study import Person, Study
from models.errors import InputError

T = TypeVar("T")

GOING_AWAY, BAD_MESSAGE, TAKEN_OVER, FULL = 1001, 1008, 4001, 1013
"""Why a connection is closed."""

PATIENCE = 10.0
"""Seconds for the first message to come, and for a page to take one."""

STRANGER = "This browser took part in another study here, or the study has changed, so you cannot go on with it."
NOT_STORED = "Something could not be stored. Please tell whoever invited you; rounds you finished before are kept."

LATE_TICKS = 3
"""Ticks that are caught up with at once; later than that (a laptop that slept) the clock starts anew."""


class Conversation:
    """One connection of a page.

    Parameters
    ----------
    socket : WebSocket
        Not accepted yet.
    study : Study
    files : Executor
        One thread, in which everything happens that touches the study: files, and policies that think.
    pages : dict of int to Conversation
        Who is connected, by participant: the last page that a person opens takes over.
    """

    def __init__(
        self, socket: WebSocket, study: Study, files: Executor, pages: dict[int, Conversation]
    ) -> None:  # fmt: skip
        self.socket, self.study, self.files, self.pages = socket, study, files, pages
        self.person: Person | None = None
        self._playing: asyncio.Task[None] | None = None
        self._live: LiveRound | None = None

    async def run(self) -> None:
        """Talk until the page is gone."""
        await self.socket.accept()
        loop = asyncio.get_running_loop()
        allowance = Allowance(loop.time())
        try:
            first = True
            while True:
                text = await asyncio.wait_for(self.socket.receive_text(), PATIENCE if first else None)
                if not allowance.spend(loop.time()):
                    raise BadMessage("too many messages")
                message = parse(text)
                if first != (message.type == "hello"):
                    raise BadMessage("hello comes first, and once")
                first = False
                await self._answer(message)
        except (BadMessage, KeyError) as error:
            # KeyError: binary frames, which have no text.
            await self._close(BAD_MESSAGE, str(error) if isinstance(error, BadMessage) else "text wanted")
        except TimeoutError:
            await self._close(GOING_AWAY, "nothing said")
        except (OSError, InputError) as error:
            await self._trouble(error)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            # Nothing is awaited here: a server that shuts down cancels whatever still waits.
            if self._playing is not None:
                self._playing.cancel()
            person = self.person
            if person is not None and self.pages.get(person.participant) is self:
                del self.pages[person.participant]
                with contextlib.suppress(RuntimeError):  # the server is ending and files are closed
                    self.files.submit(self.study.leave, person)

    # -- what the page asks for --------------------------------------------------------------------
    async def _answer(self, message: Message) -> None:
        if message.type == "hello":
            await self._hello(message.token)
        elif message.type == "consent":
            if self.person is not None:
                raise BadMessage("consent was given already")
            token, person = await self._study(self.study.agree)
            await self._take(person)
            await self._session(token)
        elif self.person is None:
            # Nothing but consent leads anywhere, and nothing else is kept.
            raise BadMessage("consent comes first")
        elif message.type == "key":
            if self._live is not None:
                self._live.key(message.move, message.pressed)
        elif message.type == "start":
            if self._playing is None or self._playing.done():
                self._playing = asyncio.create_task(self._play_safely(self.person))
        elif message.type == "withdraw":
            await self._stop()
            person, self.person = self.person, None
            self.pages.pop(person.participant, None)
            rule = await self._study(lambda: self.study.withdraw(person))
            await self._send({"type": "withdrawn", "words": rule})

    async def _hello(self, token: str | None) -> None:
        s = self.study.settings
        await self._send(
            {"type": "welcome", "consent": s.consent_paragraphs, "rounds": s.n_rounds,
             "seconds": round(s.parameters.seconds), "withdrawal": s.withdrawal_words}
        )  # fmt: skip
        if token is None:
            return
        person = await self._study(lambda: self.study.find(token))
        if person is None:
            await self._send({"type": "sorry", "words": STRANGER, "anew": True})
            return
        await self._take(person)
        await self._session(token)

    async def _take(self, person: Person) -> None:
        self.person = person
        other = self.pages.get(person.participant)
        self.pages[person.participant] = self
        if other is not None:
            await other.hand_over()

    async def hand_over(self) -> None:
        """The person has opened the page elsewhere."""
        await self._stop()
        await self._close(TAKEN_OVER, "opened elsewhere")

    async def _session(self, token: str) -> None:
        assert self.person is not None
        rows = self.study.rows(self.person)
        live = self.person.live
        await self._send(
            {"type": "session", "token": token, "k": len(rows), "of": self.study.settings.n_rounds,
             "paused": live is not None and live.game.tick > 0,
             "totals": [sum(r.human_tokens for r in rows), sum(r.robot_tokens for r in rows)]}
        )  # fmt: skip

    # -- rounds ------------------------------------------------------------------------------------
    async def _play_safely(self, person: Person) -> None:
        try:
            await self._play(person)
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # the page is gone; the round waits
        except (OSError, InputError) as error:
            await self._trouble(error)

    async def _play(self, person: Person) -> None:
        study, s = self.study, self.study.settings
        if study.finished(person):
            return
        live = await self._study(lambda: study.begin(person))
        try:
            await self._send(live.start(s.n_rounds, s.countdown, s.tick_seconds))
            self._live = live
            await asyncio.sleep(s.countdown)
            live.paused = False
            loop = asyncio.get_running_loop()
            due = loop.time()
            while not live.done:
                due += s.tick_seconds
                late = loop.time() - due
                if late > LATE_TICKS * s.tick_seconds:
                    due = loop.time()
                await asyncio.sleep(max(0.0, -late))
                live.tick()
                await self._send({"type": "tick", **live.state()})
        finally:
            self._live = None
        # Once begun, the writing of a finished round is not given up with the connection.
        row = await asyncio.shield(self._study(lambda: study.finish(person)))
        rows = study.rows(person)
        totals = [sum(r.human_tokens for r in rows), sum(r.robot_tokens for r in rows)]
        await self._send(
            {"type": "over", "k": row.k, "of": s.n_rounds, "score": [row.human_tokens, row.robot_tokens],
             "totals": totals}
        )  # fmt: skip

    async def _stop(self) -> None:
        task, self._playing = self._playing, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    # -- means -------------------------------------------------------------------------------------
    async def _study(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self.files, work)

    async def _send(self, message: dict[str, Any]) -> None:
        await asyncio.wait_for(self.socket.send_json(message), PATIENCE)

    async def _trouble(self, error: Exception) -> None:
        """A full disk, a log that was edited, a policy that cannot go on: for whoever runs the study to see."""
        who = "somebody new" if self.person is None else f"participant {self.person.participant}"
        print(f"prosocial: {who}: {error}", file=sys.stderr, flush=True)
        with contextlib.suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
            await self._send({"type": "sorry", "words": NOT_STORED, "anew": False})

    async def _close(self, code: int, reason: str) -> None:
        with contextlib.suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
            await asyncio.wait_for(self.socket.close(code, reason), PATIENCE)
