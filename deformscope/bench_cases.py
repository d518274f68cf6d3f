"""The parts of `deformscope bench`: its flags read them without numpy."""

from typing import Literal, get_args

Case = Literal["step", "call", "relax"]

CASES: tuple[Case, ...] = get_args(Case)
