"""Description in an export, for `import`: `export.json`, or the metadata of an MCAP."""

from typing import Any

import msgspec

from deformscope.errors import InputError
from deformscope.frames import Stream

SCHEMA_VERSION = 1
"""Version of an export's streams, columns and messages; a change that a reader would misread increases it."""
DRIVER = "imported"
"""Driver name of a stream without a driver."""


class ExportedColumn(msgspec.Struct, frozen=True):
    name: str
    type: str = ""
    unit: str = ""


class ExportedStream(msgspec.Struct, frozen=True):
    """A stream. kind: class of its rows; files: files that contain it"""

    entity: str = ""
    kind: str = ""
    files: tuple[str, ...] = ()
    columns: tuple[ExportedColumn, ...] = ()


class Manifest(msgspec.Struct, frozen=True):
    """The contents of an export; a new manifest belongs to no export. devices: description of each device, by its name;
    topics, device_topics: topics and device topics of an MCAP, of entities and of devices"""

    session_starts_ns: int | None = None
    streams: tuple[ExportedStream, ...] = ()
    devices: dict[str, dict[str, Any]] = {}
    topics: dict[str, str] = {}
    device_topics: dict[str, str] = {}

    def stream(self, device: str, otherwise: Stream) -> Stream:
        """Description of a device, or its default. Raises InputError if it is none."""
        if device not in self.devices:
            return otherwise
        try:
            return msgspec.convert({**self.devices[device], "device": device, "driver": DRIVER}, Stream)
        except msgspec.ValidationError as error:
            raise InputError(f"{device} as deformscope describes devices", str(error)) from error


def read_manifest(found: Any, where: object) -> Manifest:
    """Raises InputError for a manifest with a newer schema, or that deformscope cannot have written."""
    if not isinstance(found, dict) or "schema_version" not in found:
        return Manifest()
    version = found["schema_version"]
    if not isinstance(version, int) or version > SCHEMA_VERSION:
        expected = f"an export of schema version {SCHEMA_VERSION}"
        raise InputError(expected, f"one of version {version}", "a newer deformscope", where)
    try:
        return msgspec.convert(found, Manifest)
    except msgspec.ValidationError as error:
        raise InputError("an export as deformscope writes it", str(error), where=where) from error
