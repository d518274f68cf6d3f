"""The dashboard server of a controller: one line is asked, one is answered (TCP port 29999).

Source: Universal Robots' "Dashboard Server" for CB3 and e-Series."""

from deformscope_drivers.clock import Clock
from deformscope_drivers.errors import NoReply
from deformscope_drivers.transport import Transport

GREETING = "Connected: Universal Robots Dashboard Server"
ANSWER_S = 2.0
UNKNOWN = "could not understand"
"""Begin of the answer to a command that this version does not have."""


class Dashboard:
    """`with Dashboard(transport, clock) as dashboard: dashboard.ask("robotmode")`. Raises NotConnected, LinkLost."""

    def __init__(self, transport: Transport, clock: Clock) -> None:
        self._transport, self._clock, self._buffered = transport, clock, b""

    def __enter__(self) -> "Dashboard":
        self._transport.open()  # which may drop the greeting, or the first part of it
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

    def ask(self, command: str) -> str:
        """The answer to a command, without what comes before a colon; empty where this version has no such command."""
        self._transport.write(command.encode() + b"\n")
        until_ns = self._clock() + round(ANSWER_S * 1e9)
        while (left_s := (until_ns - self._clock()) / 1e9) > 0:
            self._buffered += self._transport.read(min(left_s, 0.05))
            while b"\n" in self._buffered:
                line, _, self._buffered = self._buffered.partition(b"\n")
                answer = line.decode("utf-8", "replace").strip()
                if not GREETING.endswith(answer):
                    return "" if answer.lower().startswith(UNKNOWN) else answer.rpartition(": ")[2]
        advice = "is it a controller? Its dashboard may be off (PolyScope: Settings, Security, Services)"
        raise NoReply(f"an answer to {command!r} within {ANSWER_S:g} s", "none", advice, self._transport.name)
