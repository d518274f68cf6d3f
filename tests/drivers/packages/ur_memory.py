"""The double of a UR within this process, on a simulated clock, with a cable that can be pulled."""

from deformscope_ur import UrDouble

from deformscope_drivers.doubles import Double
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.transport import Transport


class MemoryPorts:
    """The ways to a double: `Ur(config, MemoryPorts(double, clock), clock=clock)`. plugged: whether its cable is in"""

    def __init__(self, controller: UrDouble, clock: SimulatedClock) -> None:
        self.controller, self.clock, self.plugged = controller, clock, True
        self._made: list[MemoryTransport] = []

    def __call__(self, kind: str) -> Transport:
        """A new connection. kind: one of `config.PORTS`"""
        self._made.append(_InMemory(self, self.controller.connection(kind), kind))
        if not self.plugged:
            self._made[-1].unplug()
        return self._made[-1]

    def unplug(self) -> None:
        """Pull the cable out. It is put back by `plugged`; the connections of before are gone."""
        self.plugged = False
        for made in self._made:
            made.unplug()


class _InMemory(MemoryTransport):
    """A connection that the controller sees ending."""

    def __init__(self, ports: MemoryPorts, connection: Double, kind: str) -> None:
        super().__init__(connection, ports.clock, f"simulated UR {kind}")
        self._controller, self._connection = ports.controller, connection

    def close(self) -> None:
        super().close()
        self._controller.drop(self._connection)
