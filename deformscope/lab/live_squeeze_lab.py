"""A simulated container for devices that run by themselves: on the host's clock, each device with its own thread.

The same doubles as in `squeeze_lab`, behind pseudo terminals, in a process of their own: a real hand does not wait for
this program's threads either. Pictures come from that process ready made. Motions may be waited for here.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.container_constants import PA_PER_COUNT
from deformscope.lab.container_view import CAMERA, camera_pose
from deformscope.lab.double_device import reaching
from deformscope.lab.live_lab import pass_pictures
from deformscope.lab.ray_camera import DepthViewConfig
from deformscope.lab.squeeze_lab import ContainerTruth, SqueezedContainer, camera_config, members
from deformscope.processes import SPAWN, follow_parent, starting
from deformscope.rig.rig_file import RigDevice
from deformscope.rig.source import RigSource
from deformscope.robot.robot import sleep_until
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.depth_camera import SyntheticDepthCamera
from deformscope_drivers.device import Device
from deformscope_drivers.dsa import Dsa, DsaConfig
from deformscope_drivers.sdh import Sdh, SdhConfig
from deformscope_drivers.sdh.double import Port
from deformscope_drivers.wires import PtyWire

START_S, END_S = 60.0, 5.0
PICTURES_HZ = 10.0


@dataclass(frozen=True, slots=True)
class _Asked:
    """What the process gets: as for `SqueezeLab`."""

    content: str
    container: str
    seed: int
    session: int
    grasp: FloatArray | None
    camera: DepthViewConfig
    camera_hz: float


@dataclass(frozen=True, slots=True)
class _Standing:
    """What it answers when it stands: the ports of hand and pads."""

    hand: str
    pads: str


class LiveSqueezeLab:
    """`with LiveSqueezeLab("rice") as lab:` and its devices are there, closed; `lab.source()` opens them.

    hand, pads, camera: the real drivers' devices; clock, wait_until: the host's
    `devices` makes them those of a rig file (`deformscope.robot.squeeze_setup.SimulatedContainer`)
    """

    runs_itself, opener, clock, wait_until = True, None, staticmethod(monotonic_ns), staticmethod(sleep_until)

    def __init__(
        self,
        content: str,
        container: str = "box-01",
        *,
        seed: int = 0,
        session: int = 0,
        grasp: FloatArray | None = None,
        camera_hz: float = PICTURES_HZ,
        camera: DepthViewConfig = CAMERA,
    ) -> None:
        """As for `SqueezeLab`."""
        self.intrinsics, self.camera_hz = camera.intrinsics, camera_hz
        self.T_hand_camera = camera_pose(camera)
        self._asked = _Asked(content, container, seed, session, grasp, camera, camera_hz)
        self._configs = SdhConfig(), DsaConfig()
        self._over = SPAWN.Event()

    def __enter__(self) -> LiveSqueezeLab:
        with contextlib.ExitStack() as stack:
            pictures, self._questions = stack.enter_context(self._process())
            standing = _answer(self._questions)
            hand, pads = self._configs
            self.hand = Sdh(replace(reaching(hand, standing.hand), checksum=None))
            self.pads = Dsa(replace(reaching(pads, standing.pads), calibration=(PA_PER_COUNT,)))
            config = camera_config(self.intrinsics, self.camera_hz, self._asked.seed)
            self.camera = SyntheticDepthCamera(None, config)
            passing = threading.Thread(
                target=pass_pictures,
                args=(pictures, self.camera, self._over.is_set),
                name="simulated pictures",
                daemon=True,
            )
            passing.start()
            stack.callback(passing.join)
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
        """The devices by the names that a rig file gives them, set as it says, closed; the container stands there until
        the end of the context."""
        configs = {entry.driver.name: entry.config for entry in entries}
        self._configs = configs["sdh"], configs["dsa"]
        with self:
            made: dict[str, Device[Any]] = {"hand": self.hand, "tactile": self.pads, "depth": self.camera}
            yield {entry.name: made[entry.driver.kind] for entry in entries}

    def truth(self) -> ContainerTruth:
        """What is simulated, up to now, on the host's clock. Raises InputError where its process has ended."""
        try:
            self._questions.send(None)
            answer = self._questions.recv()
        except (EOFError, OSError) as error:
            raise InputError("a simulated container that answers", "its process has ended", "run it again") from error
        assert isinstance(answer, ContainerTruth)
        return answer

    @contextlib.contextmanager
    def _process(self) -> Iterator[tuple[Connection, Connection]]:
        """The container and its doubles; pipes with pictures, and for questions."""
        pictures, theirs = SPAWN.Pipe(duplex=False)
        questions, answers = SPAWN.Pipe()
        process = SPAWN.Process(
            target=_stand, args=(self._asked, self._over, theirs, answers), name="simulated container", daemon=True
        )
        with starting():
            process.start()
        theirs.close()
        answers.close()
        try:
            yield pictures, questions
        finally:
            self._over.set()
            process.join(END_S)
            if process.is_alive():
                process.kill()
            pictures.close()
            questions.close()


def _answer(questions: Connection) -> _Standing:
    """Raises InputError when nothing stands there."""
    with contextlib.suppress(EOFError):
        if questions.poll(START_S):
            standing = questions.recv()
            if isinstance(standing, InputError):
                raise standing
            assert isinstance(standing, _Standing)
            return standing
    raise InputError("a simulated container that stands", "none", "run it again")


def _stand(asked: _Asked, over: threading.Event, pictures: Connection, answers: Connection) -> None:
    """The process: wires with their threads, pictures at their rate, answers."""
    follow_parent()
    try:
        simulated = SqueezedContainer(
            asked.content,
            asked.container,
            clock=monotonic_ns,
            port=Port.RS232,
            seed=asked.seed,
            session=asked.session,
            grasp=asked.grasp,
            camera=asked.camera,
        )
    except InputError as error:
        answers.send(error)
        return
    with PtyWire(simulated.hand) as hand, PtyWire(simulated.pads) as pads:
        answers.send(_Standing(hand.port, pads.port))
        due = time.monotonic()
        while not over.is_set():
            with contextlib.suppress(OSError):  # nobody looks any more
                pictures.send(simulated.seen())
            due = max(due + 1.0 / asked.camera_hz, time.monotonic())
            while (left := due - time.monotonic()) > 0.0:
                if answers.poll(min(left, 0.05)):
                    with contextlib.suppress(EOFError, OSError):
                        answers.recv()
                        answers.send(simulated.truth())
                if over.is_set():
                    return
