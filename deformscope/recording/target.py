"""The name of a recording, and its unfinished file in the same folder until the end."""

import logging
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from deformscope.errors import InputError
from deformscope.file_io import refusal
from deformscope.recording.facts import is_recoverable
from deformscope.recording.lateness import RecordingError, check_room
from deformscope.recording.ledger import Losses, check_recording, ledger_path, write_ledger
from deformscope.recording.lock import create_locked, is_being_written, one_at_a_time
from deformscope.recording.rrd_file import merged_path, sync

SUFFIX = ".rrd"

_logger = logging.getLogger(__name__)


class RecordingTarget:
    """The files `NAME.rrd` and `NAME.part.rrd`, which is locked during the recording."""

    def __init__(self, file: Path, *, overwrite: bool) -> None:
        self.path = _followed(file)
        self.part = self.path
        self._overwrite = overwrite
        self._lock: BinaryIO | None = None

    def reserve(self) -> None:
        """Make the unfinished file; refuses impossible targets before any work is done."""
        self.part, self._lock = _reserve(self.path, self._overwrite)
        try:
            check_room(self.path)
        except BaseException:
            self.give_up()
            raise

    def give_up(self) -> None:
        """End without a recording."""
        self.part.unlink(missing_ok=True)
        ledger_path(self.part).unlink(missing_ok=True)
        self.release()

    def release(self) -> None:
        """Release the name for other recordings."""
        if self._lock is not None:
            self._lock.close()

    def publish(self, whole: Path, counts: Mapping[str, int], losses: Losses) -> Path:
        """Give the recording its name, and its ledger. whole: the file of the recording, which is renamed"""
        if self.path.exists() and not self._overwrite:
            self._keep(whole)
            came, hint = "one made during the run", f"the new one: {self.part}"
            raise RecordingError("no file of that name", came, hint, self.path)
        sync(whole)
        # Its bytes are hashed again below: what differs from the checksums made while it grew has to be known before.
        problems = check_recording(self.part).problems if whole == self.part else []
        # An older recording's ledger goes first: a ledger that fits no recording must never be next to one.
        ledger_path(self.path).unlink(missing_ok=True)
        if whole == self.part:
            ledger_path(self.part).replace(ledger_path(self.path))  # its blocks are taken over
        whole.replace(self.path)
        write_ledger(self.path, counts, losses, source_problems=problems)
        ledger_path(self.part).unlink(missing_ok=True)
        self.part.unlink(missing_ok=True)  # last, as it is the one that is locked
        sync(self.path.parent)
        return self.path

    def keep_unfinished(self, whole: Path, *, worth_it: bool) -> Path | None:
        """Keep the unfinished file, unless it is useless."""
        self._keep(whole)
        if not worth_it:
            self.part.unlink(missing_ok=True)
            ledger_path(self.part).unlink(missing_ok=True)
            return None
        if is_recoverable(self.part):
            _logger.warning("data recorded before the error are stored: deformscope recover %s", self.part)
        else:
            _logger.warning("no data recorded before the error can be recovered: %s", self.part)
        return self.part

    def _keep(self, whole: Path) -> None:
        """Keep the recording as the unfinished file, with a ledger of its bytes if the disk has room for that."""
        if whole != self.part:
            whole.replace(self.part)
            with suppress(OSError):
                write_ledger(self.part)
                return
            ledger_path(self.part).unlink(missing_ok=True)


def remove_strays(folder: Path) -> None:
    """Removes what killed runs left: the file of large portions, of no use without its end. The recordings of these
    runs stay."""
    for stray in folder.glob(f"*{merged_path(Path(f'.part*{SUFFIX}'))}"):
        if not is_being_written(stray.with_suffix("")):
            with suppress(OSError):  # in a folder that is only read
                stray.unlink(missing_ok=True)


def _followed(target: Path) -> Path:
    """Where a link leads: it stays a link, to the new recording, as with every other output."""
    if not target.is_symlink():
        return target
    found = Path(os.path.realpath(target))
    if found.is_symlink():
        raise InputError("a link that leads to a file", "one that leads to itself", where=target)
    return found


def _reserve(target: Path, overwrite: bool) -> tuple[Path, BinaryIO]:
    """An empty file to record into, next to the target, and its lock until it is closed."""
    if target.suffix.lower() != SUFFIX:
        raise InputError(f"a recording's name that ends in {SUFFIX}", f"{target.suffix or 'no ending'}", where=target)
    if target.is_dir():
        raise InputError("a file to record into", "a folder", where=target)
    if target.exists() and not overwrite:
        raise InputError("a new file to record into", "one that exists", "another name, or --overwrite", target)
    if not target.parent.is_dir():
        raise InputError("a folder to record into", "none", f"mkdir -p {target.parent}", target)
    with one_at_a_time(target.parent):
        remove_strays(target.parent)
        for number in range(1, 1000):
            part = target.with_name(f"{target.stem}.part{'' if number == 1 else f'-{number}'}{SUFFIX}")
            try:
                return part, create_locked(part)
            except FileExistsError:
                if is_being_written(part):
                    came = f"one that another run is recording to ({part.name})"
                    raise InputError("a recording of its own", came, "another name", target) from None
            except OSError as error:
                refused = refusal(error)
                raise InputError("a folder that can be written to", refused, "another folder", target.parent) from error
    raise InputError("fewer unfinished recordings", "1000", "rename or delete some", target.parent)
