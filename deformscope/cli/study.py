"""What a study declares, and what runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Study:
    """options: the class of its flags; run: what runs it with them"""

    options: type
    run: Callable[[Any], None]


def run(study: Study, options: object) -> None:
    """Run it."""
    study.run(options)
