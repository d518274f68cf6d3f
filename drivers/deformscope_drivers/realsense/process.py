"""The process that reads one RealSense camera: a hang or a crash of the library ends neither program nor recording.

`python -m deformscope_drivers.realsense.process FD SETTINGS MODULE` is started by `Realsense`, which gives it one end
of a socket pair, and is ended by closing the other end. MODULE: pyrealsense2, or what stands in for it. With
`list MODULE` alone it prints the cameras that are there.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import json
import os
import sys
from multiprocessing.connection import Connection
from typing import Any

from deformscope_drivers.camera_process.messages import FAILED, NOTE, OPENED, pack_frame, pack_words
from deformscope_drivers.errors import DeviceError, LibraryMissing
from deformscope_drivers.realsense.advice import INSTALL
from deformscope_drivers.realsense.camera import RealsenseCamera, RealsenseSettings, as_device_error, listed

ROUND_S = 0.05


def load(module: str) -> Any:
    """The library. Raises LibraryMissing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise LibraryMissing("pyrealsense2", str(error), INSTALL, "realsense") from error


def serve(settings: RealsenseSettings, module: str, connection: Connection) -> None:
    """Read a camera until the other end is closed."""
    try:
        camera = RealsenseCamera(settings, load(module))
        connection.send_bytes(pack_words(OPENED, camera.words()))
        while not connection.poll(0):
            frame = camera.next(ROUND_S)
            for note in camera.take_notes():
                connection.send_bytes(pack_words(NOTE, {"words": note}))
            if frame is not None:
                connection.send_bytes(pack_frame(frame))
        camera.close()
    except (DeviceError, RuntimeError) as error:
        found = as_device_error(error)
        connection.send_bytes(pack_words(FAILED, {"kind": type(found).__name__, "words": str(found)}))


def main(arguments: list[str]) -> None:
    if arguments[0] == "list":
        try:
            print(json.dumps([dataclasses.asdict(found) for found in listed(load(arguments[1]))]), flush=True)
        except LibraryMissing as error:
            print(json.dumps({"error": str(error)}), flush=True)
    else:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the other end was closed
            serve(RealsenseSettings(**json.loads(arguments[1])), arguments[2], Connection(int(arguments[0])))
    sys.stdout.flush()
    os._exit(0)  # the library's own clearing up crashes now and then once a camera is gone (librealsense, issue 14470)


if __name__ == "__main__":
    main(sys.argv[1:])
