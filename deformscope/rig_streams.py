"""A rig's streams as the JSON that stands in its recording."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from deformscope.frames import Pad, Stream


def stream_json(stream: Stream) -> str:
    """One stream as a JSON object."""
    return json.dumps(dataclasses.asdict(stream), default=str, sort_keys=True)


def stream_from_json(text: str) -> Stream:
    """What `stream_json` made."""
    values = json.loads(text)
    pads = tuple(Pad(**{**pad, "texel_m": tuple(pad["texel_m"])}) for pad in values.pop("pads"))
    urdf = values.pop("urdf")
    return Stream(**values, pads=pads, urdf=None if urdf is None else Path(urdf))
