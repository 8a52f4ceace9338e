"""The native protocol for pages: with a `view` of binary frames, and a second token for pages that may only watch."""

from __future__ import annotations

import hmac
from collections.abc import Callable

from uwserver.adapter import AdapterContext, Refusals
from uwserver.ports import Fault, Refused
from uwserver_adapters.native.messages import Request
from uwserver_adapters.native.service import NativeService, params_of, take
from uwserver_adapters.native.session import Allowance, Session
from uwserver_adapters.web.pages import Page, Pages
from uwserver_adapters.web.rights import Rights


class WebService(NativeService):
    """The native protocol, with what pages need besides.

    Args:
        context: the adapter's context.
        tokens: the token for everything, and the token for watching; None where there is none.
        read_only: no page may change anything.
        allowance, requests_per_s: limits of each page.
        refusals: counts and logs what was refused.

    Attributes:
        rights: what pages may do.
        view_token: the token for watching.
        pages: the open pages; set before the first one.
    """

    pages: Pages

    def __init__(
        self,
        context: AdapterContext,
        tokens: tuple[str | None, str | None],
        read_only: bool,
        allowance: Allowance,
        requests_per_s: int,
        refusals: Refusals,
    ) -> None:
        self.rights = Rights(context, read_only)
        super().__init__(self.rights, tokens[0], allowance, requests_per_s, refusals)
        self.view_token = tokens[1]
        self._page_of: dict[Session, Page] = {}

    def open(self, session: Session, page: Page) -> None:
        """Begin a page that uses a session."""
        self._page_of[session] = page
        self.pages.enter(page)

    def end(self, session: Session) -> None:
        """End the page of a session."""
        page = self._page_of.pop(session, None)
        if page is not None:
            self.pages.leave(page)
        self.rights.leave(session.serial)

    def take(self, session: Session, request: Request, host: str) -> Fault | None:
        """Carry out a request. Returns the fault that must end the connection, if there is one."""
        if request.method in _VERBS and session.admitted:
            self._carry_out(session, request)
            return None
        if request.method == "hello" and self._shows_view_token(request):
            fault = take(session, request, self.view_token)
            if session.greeted:
                self.rights.watching.add(session.serial)
            return fault
        return super().take(session, request, host)

    def _shows_view_token(self, request: Request) -> bool:
        params = request.params
        given = params.get("token") if isinstance(params, dict) else None
        return isinstance(given, str) and self.view_token is not None and is_equal(given, self.view_token)

    def knows(self, token: str) -> bool:
        """Return whether a text is one of the two tokens."""
        return any(is_equal(token, known) for known in (self.token, self.view_token) if known is not None)

    def _carry_out(self, session: Session, request: Request) -> None:
        try:
            session.reply(request.id, _VERBS[request.method](self, self._page_of[session], request))
        except Refused as refused:
            session.refuse(request.id, refused.fault)

    def view(self, page: Page, request: Request) -> object:
        """Set which binary frames a page wants. All pictures that it was sent count as shown."""
        params = params_of(request, ("frames", "pictures"))
        frames, pictures = params.get("frames", page.wants_frames), params.get("pictures")
        if not isinstance(frames, bool):
            raise Refused("bad_argument", '"frames" must be true or false', "frames")
        numbers: dict[str, int] = {}
        if pictures is not None:
            if not isinstance(pictures, list) or not all(isinstance(path, str) for path in pictures):
                raise Refused("bad_argument", '"pictures" must be a list of paths of ports', "pictures")
            numbers = self.pages.pictures.show(page, pictures)
        page.wants_frames = frames
        self.pages.follow()
        return {"frames": frames, "pictures": numbers}

    def seen(self, page: Page, request: Request) -> object:
        """Note that a page has shown its pictures of these ports."""
        params = params_of(request, ("pictures",))
        numbers = params.get("pictures")
        if not isinstance(numbers, list) or not all(isinstance(n, int) for n in numbers):
            raise Refused("bad_argument", '"pictures" must be a list of numbers of ports', "pictures")
        self.pages.pictures.seen(page, numbers)
        return {}


def is_equal(given: str, known: str) -> bool:
    """Return whether two tokens are equal. Takes equally long for all wrong ones."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), known.encode())


_VERBS: dict[str, Callable[[WebService, Page, Request], object]] = {
    "view": WebService.view,
    "seen": WebService.seen,
}
