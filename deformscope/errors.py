"""The one error that reaches a user."""

from __future__ import annotations


class InputError(Exception):
    """Something a user gave cannot be used.

    The message says, in one line, what was expected, what came, and what to try; a path comes last.
    """

    def __init__(self, expected: str, came: str, try_this: str = "", where: object = "") -> None:
        parts = [f"expected {expected}; got {came}"]
        if try_this:
            parts.append(f"try: {try_this}")
        if str(where):
            parts.append(str(where))
        super().__init__(" | ".join(parts))

    @classmethod
    def about(cls, error: Exception, where: object) -> InputError:
        """The same error, with the file that it is about."""
        made = cls.__new__(cls)
        Exception.__init__(made, f"{error} | {where}" if str(where) else str(error))
        return made

    def __reduce__(self) -> tuple[object, ...]:
        """Between processes the message goes as it is."""
        return type(self).about, (Exception(str(self)), "")
