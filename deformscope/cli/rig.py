"""`deformscope rig new`: a rig file for what is plugged in."""

import contextlib
import socket
from pathlib import Path

from deformscope.cli import devices
from deformscope.cli.common import say
from deformscope.config import NewRigConfig
from deformscope.errors import InputError
from deformscope.file_io import resolve
from deformscope.rig.new_rig import NewDevice, example_rig, rig_text
from deformscope.rig.rig_file import parse_rig
from deformscope.runs.skeleton import at_terminal
from deformscope_drivers.interface import DRIVERS

ANSWER_S = 1.0
"""Longest time until a controller takes a connection."""


def new(config: NewRigConfig) -> None:
    """Search, ask, and write the file."""
    path = Path(config.rig).expanduser()
    if path.exists() and (not path.is_file() or path.stat().st_size):
        raise InputError("the name of a new rig file", f"{path}, which exists", "another name")
    if config.doubles:
        text, found = resolve("sample:rig").read_text(encoding="utf-8"), []
    else:
        found = [*map(NewDevice.parse, config.device), *_plugged_in(at_terminal() and not config.yes)]
        text = rig_text(found) if found else example_rig()
        if not found:
            say("no device was found: the file has an example of each. Take out what you do not have")
    parse_rig(text, str(path))
    for one in found:
        say(f"{one.name}: {one.driver}{_answers(one.keys.get('port', ''))}")
    path.write_text(text, encoding="utf-8")
    say(f"{path} is written. Next: deformscope doctor {path}")


def _plugged_in(asks: bool) -> list[NewDevice]:
    """What is plugged in, and with `asks` what a person names besides."""
    found = []
    for one in devices.search():
        driver = one.driver
        if asks:
            say(f"{one.port}: {' '.join(filter(None, (one.name, one.serial, one.note)))}")
            driver = _line(f"its driver ({', '.join(DRIVERS)}), - = leave it out [{driver or '-'}]: ") or driver
        if driver not in ("", "-"):
            found.append(NewDevice.of(driver, one.port, one.serial))
        elif not asks:
            say(f"left out: {one.port}, {one.name or 'unknown'}: name its driver by --device NAME=DRIVER:{one.port}")
    while asks and (line := _line("another device, NAME=DRIVER:ADDRESS; empty = no more: ")):
        found.append(NewDevice.parse(line))
    return found


def _line(prompt: str) -> str:
    """The typed line; empty at the end of the input."""
    with contextlib.suppress(EOFError):
        return input(prompt).strip()
    return ""


def _answers(port: str) -> str:
    """Whether a controller at socket://HOST:PORT takes a connection, as text."""
    host, _, number = port.removeprefix("socket://").rpartition(":")
    if not port.startswith("socket://") or not number.isdecimal():
        return ""
    try:
        socket.create_connection((host, int(number)), ANSWER_S).close()
    except OSError as error:
        return f", but {port} does not answer: {error.strerror or error}"
    return f", {port} answers"
