"""What the recording of a command shows: it verifies, and its pictures and tables are in its views."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rerun.chunk import RrdReader

from deformscope.recording.reader import Replay
from tests.verified import verify_here


@dataclass(frozen=True, slots=True)
class Explored:
    """A recording of an exploration, and what the command said."""

    touches: int
    record: Path
    out: str
    err: str

    @property
    def found(self) -> Any:
        return json.loads(self.record.with_suffix(".json").read_text())


Explore = Callable[..., Explored]


def assert_shows(
    path: Path, *, says: str, pictures: int = 1, beside_particles: bool = False, chart: bool = True
) -> None:
    """The recording is whole, holds so many pictures that can be decoded, and a table with these words."""
    assert verify_here(path, "--json", str(path.with_suffix(".json"))) == 0
    recording = Replay(path)
    root = "/calibration" if beside_particles else "/found"
    drawn = f"{root}/chart" if beside_particles else f"{root}/picture"
    shown = set()
    for chunk in recording.chunks(f"{drawn}/**") if chart else ():
        for blob in chunk.to_record_batch().column("EncodedImage:blob").to_pylist():
            assert cv2.imdecode(np.array(blob[0], np.uint8), cv2.IMREAD_COLOR).std() > 5.0
            shown.add(chunk.entity_path)
    assert len(shown) == (pictures if chart else 0)
    texts = [
        str(text)
        for chunk in recording.chunks(f"{root}/summary" if beside_particles else f"{root}/tables")
        if "TextDocument:text" in chunk.to_record_batch().schema.names
        for text in chunk.to_record_batch().column("TextDocument:text").to_pylist()
    ]
    assert any(says in text for text in texts)
    assert RrdReader(path).blueprints()
