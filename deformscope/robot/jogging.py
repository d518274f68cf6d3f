"""Moving an arm by keys, in small steps: the motion of each key, and rest while no key is held.

A press of a key moves one step. A key that is held repeats in every terminal: the motion then continues, and ends
GRACE_S after the last repeat. So the release of a key, a terminal that hangs and a broken connection stop it."""

from dataclasses import dataclass

import numpy as np

from deformscope.robot.robot import TipVelocity

SPEED_M_S = 0.02
"""Speed of the tip's centre: the limit near contact, because by keys the tip may touch something anywhere. At a higher
speed it moves further after the last key (GRACE_S); at a lower one, a step of 10 mm takes more than half a second."""
STEPS_M = {"1": 0.001, "2": 0.005, "3": 0.01}
"""Motion of a press, by the key that chooses it."""
TURN_PER_M = 6.0
"""Rotation of a press for each metre of its translation [rad/m]: 5 mm and 1.7 degrees."""
GRACE_S = 0.15
"""Duration of the motion after the last repeat of a key: four repeats of a terminal, and 3 mm of motion. A shorter one
stutters over a slow line; a longer one moves the arm further after the key's release."""
REPEATS_S = 0.8
"""The same key again so soon after the last is a key that is held: terminals wait up to 0.6 s before they repeat."""
LEAVE = "q"

KEYS = ("da", "ws", "rf", "ou", "ik", "lj")
MOVES = {key: (axis, way) for axis, keys in enumerate(KEYS) for key, way in zip(keys, (1.0, -1.0), strict=True)}
"""Key to axis (x, y, z, then turns about them, surface frame) and way."""
HELP = (
    "a d  along x    w s  along y    f r  down, up    u o, k i, j l  turn about x, y, z\n1 2 3  steps of 1, "
    "5, 10 mm    hold a key to continue, release to stop    space  stop    q  leave"
)


@dataclass(slots=True)
class Jog:
    """The motion that the keys request. step_m: way of the tip's centre for one press [m]"""

    step_m: float = STEPS_M["2"]
    _key: str = ""
    _pressed_ns: int = 0
    _until_ns: int = 0

    def press(self, key: str, now_ns: int) -> None:
        """A key, or its repeat, at a time of the robot's clock [ns]. A key without a meaning stops the motion."""
        if key in STEPS_M:
            self.step_m = STEPS_M[key]
        again = key == self._key and now_ns - self._pressed_ns < REPEATS_S * 1e9
        self._key, self._pressed_ns = key, now_ns
        if key not in MOVES:
            self._until_ns = now_ns
        elif again:
            self._until_ns = max(self._until_ns, now_ns + round(GRACE_S * 1e9))
        else:
            self._until_ns = now_ns + round(self.step_m / SPEED_M_S * 1e9)

    def command(self, now_ns: int) -> TipVelocity | None:
        """The velocity for the control period that begins at now_ns; None = rest."""
        if now_ns >= self._until_ns or self._key not in MOVES:
            return None
        axis, way = MOVES[self._key]
        velocity = np.zeros(6)
        velocity[axis] = way * (SPEED_M_S if axis < 3 else SPEED_M_S * TURN_PER_M)
        return TipVelocity(velocity[:3], velocity[3:] if axis >= 3 else None)
