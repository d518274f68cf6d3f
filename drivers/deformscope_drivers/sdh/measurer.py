"""The hand's readings out of its answers: answers and their arrival in, readings out.

Both the device and the replay of a recording's bytes use it: it has neither port nor thread."""

import numpy as np

from deformscope_drivers.clock import Stamp
from deformscope_drivers.errors import ProtocolViolation
from deformscope_drivers.sdh.codes import AxisState
from deformscope_drivers.sdh.protocol import Event, Reading
from deformscope_drivers.sdh.results import FloatArray, HandReading


class HandMeasurer:
    """A reading is made of answers about states, velocities and, last, angles; temperatures come more rarely.

    name: name of the device, for messages"""

    def __init__(self, name: str) -> None:
        self._name = name
        self._states: tuple[AxisState, ...] | None = None
        self._velocity: FloatArray | None = None
        self._temperature: tuple[FloatArray, Stamp] | tuple[None, None] = (None, None)

    def measure(self, event: Event, host_ns: int) -> HandReading | None:
        """The reading that an answer completes, else None. host_ns: when it arrived [ns]. Raises ProtocolViolation
        where an axis is in a state that is not known."""
        if not isinstance(event, Reading) or event.axis is not None:
            return None
        values = np.array(event.values, dtype=np.float64)
        values.flags.writeable = False
        match event.quantity:
            case "temp":
                self._temperature = values, Stamp(host_ns)
            case "state":
                self._states = None
                self._states = self._known_states(values)
            case "vel" | "tvav":
                self._velocity = values
            case "pos" if self._states is not None and self._velocity is not None:
                return HandReading(Stamp(host_ns), values, self._velocity, self._states, *self._temperature)
        return None

    def _known_states(self, values: FloatArray) -> tuple[AxisState, ...]:
        """The states of axes (n,); raises ProtocolViolation for one that is not known."""
        try:
            return tuple(AxisState(int(value)) for value in values)
        except ValueError as error:
            known = ", ".join(f"{state.value} {state.name}" for state in AxisState)
            raise ProtocolViolation(f"axis states of {known}", f"{values.tolist()}", where=self._name) from error
