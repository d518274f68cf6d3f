"""The error whose message a user reads."""

import logging
import re

_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """Text of files, devices and paths for a terminal or a page. Control characters, those that reverse the direction
    of text, and bytes that are not UTF-8 become escapes, as in Python's `repr`; line breaks and tabs stay."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


class _Printable(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def show_remarks() -> None:
    """Print the library's remarks so that no text in them controls the terminal: in each process, as it begins."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_Printable())


class InputError(Exception):
    """Input of a user that cannot be used.

    The message has, in one line, the expectation, the actual value, and what to try; a path comes last."""

    def __init__(self, expected: str, came: str, try_this: str = "", where: object = "") -> None:
        parts = [f"expected {expected}; got {came}"]
        if try_this:
            parts.append(f"try: {try_this}")
        if str(where):
            parts.append(str(where))
        super().__init__(printable(" | ".join(parts)))

    @classmethod
    def about(cls, error: Exception, where: object) -> "InputError":
        """The error with the file concerned."""
        made = cls.__new__(cls)
        Exception.__init__(made, printable(f"{error} | {where}" if str(where) else str(error)))
        return made

    def __reduce__(self) -> tuple[object, ...]:
        """Between processes the message is unchanged."""
        return type(self).about, (Exception(str(self)), "")
