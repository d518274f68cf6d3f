"""What is taken for the robot, drawn over what the camera sees: a picture of each way to take it out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from deformscope.pictures.figures import canvas, png_of
from studies.robot_pictures import (
    DOUBT_M,
    REMOVALS,
    RemovalScene,
    known_as,
    removed,
)

KEPT, TAKEN, LOST, LEFT = (104, 176, 104), (74, 96, 190), (240, 160, 30), (220, 30, 150)
DIM = 0.55


def removal_png(seed: int) -> bytes:
    """Of a robot that presses into foam, seen by a RealSense whose place is off by 5 mm and 1 degree."""
    import matplotlib as mpl

    scene = RemovalScene(seed)
    picture = scene.picture("realsense", pressing=True)
    T = scene.T_surface_camera("surface")
    panels: list[tuple[str, npt.NDArray[np.uint8]]] = [("what the camera sees", picture.exact.color)]
    for removal in REMOVALS:
        geometry = scene.geometry(T, DOUBT_M["surface"], known_as(removal))
        found = removed(picture, geometry, scene.box("all above", picture.center_m))
        columns, rows = np.rint(scene.view.pixels(_as_seen(found.points_m, T, scene))).astype(int).T
        color: npt.NDArray[np.uint8] = (DIM * picture.exact.color).astype(np.uint8)
        for which, tint in (
            (found.kept, KEPT),
            (~found.beside, TAKEN),
            (found.foam & ~found.beside, LOST),
            (found.robot & found.kept, LEFT),
        ):
            color[rows[which], columns[which]] = tint
        panels.append((f'removal = "{removal}"', color))
    with mpl.rc_context({"font.size": 9}):
        figure = canvas(10.4, 8.4, layout="constrained")
        for axes, (title, image) in zip(figure.subplots(2, 2).flat, panels, strict=True):
            axes.imshow(image)
            axes.set_title(title)
            axes.set_axis_off()
        words = ("kept", "taken for the robot", "foam that is lost", "robot that is left")
        handles = [
            mpl.patches.Patch(color=tuple((np.array(tint) / 255.0).tolist()), label=word)
            for word, tint in zip(words, (KEPT, TAKEN, LOST, LEFT), strict=True)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
        return png_of(figure, 110)


def _as_seen(
    points_m: npt.NDArray[np.floating], T: npt.NDArray[np.floating], scene: RemovalScene
) -> npt.NDArray[np.floating]:
    """(n, 3) points where they were truly seen, from where they are taken to be."""
    back = scene.view.surface_from_camera @ np.linalg.inv(T)
    return np.asarray(points_m @ back[:3, :3].T + back[:3, 3])
