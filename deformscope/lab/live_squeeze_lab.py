"""A simulated container for devices on the host's clock, each with its own thread.

The same doubles as in `squeeze_lab`, behind pseudo terminals, in a child process: a real hand does not wait for this
program's threads either. That process also draws the pictures. Here a call may wait for a motion."""

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from deformscope.errors import InputError
from deformscope.lab.container_constants import PA_PER_COUNT
from deformscope.lab.container_view import camera_pose
from deformscope.lab.live_lab import first_message, pass_pictures, until_done
from deformscope.lab.squeeze_lab import ContainerCase, ContainerTruth, SqueezedContainer, camera_config, members
from deformscope.processes import SPAWN, child_process
from deformscope.rig.rig_file import RigDevice
from deformscope.rig.source import RigSource
from deformscope.robot.robot import sleep_until
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.depth_camera import SyntheticDepthCamera
from deformscope_drivers.device import Device
from deformscope_drivers.dsa import Dsa, DsaConfig
from deformscope_drivers.sdh import Sdh, SdhConfig
from deformscope_drivers.sdh.double import Port
from deformscope_drivers.wires import PtyWire, reaching

PICTURES_HZ = 10.0


class LiveSqueezeLab:
    """`with LiveSqueezeLab(case) as lab:` makes its devices, which are not opened; `lab.source()` opens them.

    hand, pads, camera: the real drivers' devices; clock, wait_until: those of the host. `devices` makes the devices of
    a rig file (`deformscope.robot.squeeze_setup.SimulatedContainer`)"""

    runs_itself, opener, clock, wait_until = True, None, staticmethod(monotonic_ns), staticmethod(sleep_until)

    def __init__(self, case: ContainerCase, camera_hz: float = PICTURES_HZ) -> None:
        self.intrinsics, self.camera_hz = case.camera.intrinsics, camera_hz
        self.T_hand_camera = camera_pose(case.camera)
        self._case = case
        self._configs = SdhConfig(), DsaConfig()
        self._over = threading.Event()

    def __enter__(self) -> "LiveSqueezeLab":
        with contextlib.ExitStack() as stack:
            pictures, theirs = SPAWN.Pipe(duplex=False)
            given = self._case, self.camera_hz, theirs
            self._questions = stack.enter_context(child_process("simulated container", _stand, *given))
            theirs.close()
            stack.callback(pictures.close)
            hand_port, pads_port = first_message(self._questions, "container")
            hand, pads = self._configs
            self.hand = Sdh(replace(reaching(hand, hand_port), checksum=None))
            self.pads = Dsa(replace(reaching(pads, pads_port), calibration=(PA_PER_COUNT,)))
            config = camera_config(self.intrinsics, self.camera_hz, self._case.seed)
            self.camera = SyntheticDepthCamera(None, config)
            passing = partial(pass_pictures, pictures, self.camera, self._over.is_set)
            stack.enter_context(until_done("simulated pictures", passing))
            stack.callback(self._over.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def source(self) -> RigSource:
        """The devices as a source, named as in `squeeze_lab.NAMES`; entering it opens them."""
        return RigSource(members(self.hand, self.pads, self.camera))

    @contextlib.contextmanager
    def devices(self, entries: Sequence[RigDevice]) -> Iterator[dict[str, Device[Any]]]:
        """The devices by their names in a rig file, with its settings, not opened; the container is present until the
        end of the context."""
        configs = {entry.driver.name: entry.config for entry in entries}
        self._configs = configs["sdh"], configs["dsa"]
        with self:
            made: dict[str, Device[Any]] = {"hand": self.hand, "tactile": self.pads, "depth": self.camera}
            yield {entry.name: made[entry.driver.kind] for entry in entries}

    def truth(self) -> ContainerTruth:
        """The simulated truth, up to now, on the host's clock. Raises InputError if its process has ended."""
        try:
            self._questions.send(None)
            answer = self._questions.recv()
        except (EOFError, OSError) as error:
            raise InputError("a simulated container that answers", "its process has ended", "run it again") from error
        assert isinstance(answer, ContainerTruth)
        return answer


def _stand(answers: Connection, case: ContainerCase, camera_hz: float, pictures: Connection) -> None:
    """The process: wires with their threads, pictures at their rate, answers, until all callers have ended."""
    try:
        simulated = SqueezedContainer(case, monotonic_ns, Port.RS232)
    except InputError as error:
        answers.send(error)
        return
    with PtyWire(simulated.hand) as hand, PtyWire(simulated.pads) as pads, contextlib.suppress(EOFError, OSError):
        answers.send((hand.port, pads.port))
        due = time.monotonic()
        while True:
            with contextlib.suppress(OSError):  # nobody looks any more
                pictures.send(simulated.seen())
            due = max(due + 1.0 / camera_hz, time.monotonic())
            while (left := due - time.monotonic()) > 0.0:
                if answers.poll(left):
                    answers.recv()
                    answers.send(simulated.truth())
