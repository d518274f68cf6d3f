"""What a replay that differs raises."""

from __future__ import annotations

from deformscope.errors import InputError


class Different(InputError):
    """The recomputed numbers are not the recorded ones."""
