"""The page in which a browser watches a run: rerun's own, kept from speaking to anyone but this machine.

By itself that page fetches a font, the news of rerun's releases and a list of examples from the web, and tells rerun's
makers that it is in use; there is no switch against it. So browsers get it from here: with a policy by which they
refuse all that, and with an answer to it at once, so that nothing is refused and no error stands in their console.
"""

import re
import threading
from functools import partial
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote

LOOPBACK = "127.0.0.1"
_PATIENCE_S = 20.0
_FOREIGN_LINK = re.compile(rb"<link\b[^>]*https?://[^>]*>")
_ANSWERED = b"""<script>
const asked = window.fetch;
window.fetch = (what, how) => new URL(what.url ?? what, location).hostname === location.hostname
  ? asked(what, how) : Promise.resolve(new Response(null, { status: 204 }));
</script>"""
_POLICY = (
    "default-src 'self'; connect-src 'self' http://{data}; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "form-action 'none'; frame-ancestors 'none'"
)


class WebPage:
    """Serves the page on this machine until it is closed."""

    def __init__(self, port: int, data_port: int) -> None:
        """Take the page from rerun's server on one port of this machine; it takes its data from another one."""
        policy = _POLICY.format(data=f"{LOOPBACK}:{data_port}")
        self._server = ThreadingHTTPServer((LOOPBACK, 0), partial(_Handler, port, policy))
        self._server.daemon_threads = True
        self._data = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        threading.Thread(target=self._server.serve_forever, name="web page", daemon=True).start()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{LOOPBACK}:{self._server.server_port}/?url={quote(self._data, safe='')}"

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, port: int, policy: str, *args: object) -> None:
        self._port, self._policy = port, policy
        super().__init__(*args)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        try:
            self._pass_on()
        except (OSError, HTTPException):  # the browser went away, or the viewer ended
            self.close_connection = True

    def _pass_on(self) -> None:
        rerun = HTTPConnection(LOOPBACK, self._port, timeout=_PATIENCE_S)
        try:
            rerun.request("GET", self.path)
            found = rerun.getresponse()
            body, kind = found.read(), found.getheader("Content-Type", "")
        finally:
            rerun.close()
        if kind.startswith("text/html"):
            body = _FOREIGN_LINK.sub(b"", body).replace(b"<head>", b"<head>" + _ANSWERED, 1)
        self.send_response(found.status)
        for name, value in (
            ("Content-Type", kind), ("Content-Length", str(len(body))), ("rerun-final-length", str(len(body))),
            ("Content-Security-Policy", self._policy), ("Referrer-Policy", "no-referrer"),
        ):  # fmt: skip
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Keep quiet: what a browser asks for is nobody's business."""
