"""The process that reads one camera through OpenNI2: a hang or a crash of it ends neither program nor recording.

`python -m deformscope_drivers.openni.process FD SETTINGS` is started by `DepthCamera`, which gives it one
end of a socket pair, and is ended by closing the other end. With `list` alone it prints the cameras that are there.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sys
import time
from multiprocessing.connection import Connection

from deformscope_drivers.camera_process.messages import END, FAILED, OPENED, pack_frame, pack_words
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.openni.camera import OpenniCamera, OpenniSettings, Pairs
from deformscope_drivers.openni.library import Openni

ROUND_S = 0.05


def serve(settings: OpenniSettings, connection: Connection) -> None:
    """Read a camera until the other end is closed."""
    try:
        camera = OpenniCamera(settings)
        connection.send_bytes(pack_words(OPENED, camera.words()))
        camera.start()
        pairs = Pairs(camera.depth.mode().fps, wanted=settings.color)
        while not connection.poll(0):
            try:
                frame = camera.next(ROUND_S)
            except EOFError:
                for pair in pairs.rest():
                    connection.send_bytes(pack_frame(pair))
                connection.send_bytes(END)
                break
            if frame is not None:
                for pair in pairs.add(frame, time.monotonic_ns()):
                    connection.send_bytes(pack_frame(pair))
        camera.close()
    except DeviceError as error:
        connection.send_bytes(pack_words(FAILED, {"kind": type(error).__name__, "words": str(error)}))


def main(arguments: list[str]) -> None:
    if arguments == ["list"]:
        try:
            print(json.dumps([dataclasses.asdict(device) for device in Openni().devices()]), flush=True)
        except DeviceError as error:
            print(json.dumps({"error": str(error)}), flush=True)
    else:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the other end was closed
            serve(OpenniSettings(**json.loads(arguments[1])), Connection(int(arguments[0])))
    sys.stdout.flush()
    os._exit(0)  # the library's own clearing up at exit crashes


if __name__ == "__main__":
    main(sys.argv[1:])
