"""Kinds of recordings, as far as they matter before devices are opened."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

PictureLayout = Literal["images", "flow", "pair", "pair-3d"]
"""Layouts over a picture: a calibrated sequence of images; optical flow; pairs of particle sets in the plane; in
space."""


@dataclass(frozen=True, slots=True)
class Application:
    """rerun's application: a viewer keeps one set of views for each.

    name: rerun's id of the application; over_picture: the views of results over a picture, once the picture is known,
    None = the views come with their results; devices: whether devices are recorded; robot_moves: whether a robot moves
    during the recording, whose run reports its state on a page. A recording without its results is useless
    """

    name: str
    over_picture: PictureLayout | None = None
    devices: bool = False
    robot_moves: bool = False

    def variant(self, name: str) -> Application:
        """The application with separate views under this name; without a name the application itself."""
        return dataclasses.replace(self, name=f"{self.name}-{name}") if name else self


IMAGES = Application("deformscope", "images")
FLOW = Application("deformscope-flow", "flow")
PAIR = Application("deformscope-pair", "pair")
PAIR_3D = Application("deformscope-pair-3d", "pair-3d")
FINDINGS = Application("deformscope-findings")
