"""Make the laboratory's robot: a Jaco whose fingers hold a stick, as URDF with meshes, in deformscope/lab/robots.

python tools/robot_meshes.py

Joints are those of drivers/deformscope_drivers/jaco/j2n6s300.urdf; the shapes are our own: tubes along curves.
"""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import open3d as o3d

ROOT = Path(__file__).resolve().parents[1]
ARM = ROOT / "drivers" / "deformscope_drivers" / "jaco" / "j2n6s300.urdf"
FOLDER = ROOT / "deformscope" / "lab" / "robots"
NAME = "j2n6s300-stick"
NOTE = """
  Made by tools/robot_meshes.py: a Kinova Jaco2 whose fingers hold a stick. Joint origins, axes, limits, efforts, speeds
  and masses are facts of Kinova's published description (kinova_description, BSD-3); all shapes are our own.
"""
SIDES = 20

TUBES: dict[str, list[tuple[float, float, float, float]]] = {
    # x, y, z, radius [m]
    "wrist": [
        (0.0, 0.0, 0.034, 0.030),
        (0.0, 0.0, 0.028, 0.034),
        (0.0, 0.0, -0.020, 0.034),
        (0.0, -0.009, -0.036, 0.032),
        (0.0, -0.022, -0.050, 0.031),
        (0.0, -0.037, -0.064, 0.030),
    ],
    "palm": [
        (0.0, 0.0, 0.010, 0.036),
        (0.0, 0.0, 0.002, 0.040),
        (0.0, 0.0, -0.050, 0.038),
        (0.0, 0.0, -0.080, 0.046),
        (0.0, 0.0, -0.100, 0.046),
        (0.0, 0.0, -0.114, 0.036),
    ],
    "finger": [
        (-0.010, 0.0, 0.0, 0.007),
        (-0.004, 0.0, 0.0, 0.012),
        (0.006, 0.001, 0.0, 0.012),
        (0.018, 0.003, 0.0, 0.009),
        (0.032, 0.002, 0.0, 0.009),
        (0.042, -0.002, 0.0, 0.011),
        (0.050, -0.004, 0.0, 0.007),
    ],
    "fingertip": [
        (-0.006, 0.0, 0.0, 0.007),
        (0.004, 0.0, 0.0, 0.009),
        (0.018, 0.002, 0.0, 0.008),
        (0.032, 0.001, 0.0, 0.0075),
        (0.041, -0.002, 0.0, 0.005),
    ],
    # a flange on the palm, a neck that the fingers hold, the force sensor before the ball
    "mount": [
        (0.0, 0.0, -0.048, 0.028),
        (0.0, 0.0, -0.040, 0.028),
        (0.0, 0.0, -0.036, 0.012),
        (0.0, 0.0, 0.010, 0.010),
        (0.0, 0.0, 0.050, 0.008),
        (0.0, 0.0, 0.053, 0.0115),
        (0.0, 0.0, 0.072, 0.0115),
        (0.0, 0.0, 0.076, 0.008),
    ],
}
DRAWN = {
    "j2n6s300_link_4": "wrist",
    "j2n6s300_link_5": "wrist",
    "j2n6s300_link_6": "palm",
    **{f"j2n6s300_link_finger_{k}": "finger" for k in (1, 2, 3)},
    **{f"j2n6s300_link_finger_tip_{k}": "fingertip" for k in (1, 2, 3)},
    "j2n6s300_end_effector": "mount",
}


def tube(stations: list[tuple[float, float, float, float]]) -> o3d.geometry.TriangleMesh:
    """Closed, through circles about the points of a curve."""
    middle, radius = np.array(stations)[:, :3], np.array(stations)[:, 3]
    along = np.gradient(middle, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.cross(along, (0.0, 0.0, 1.0) if abs(along[0, 2]) < 0.9 else (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    third = np.cross(along, aside)
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)[:, None, None]
    rings = middle + radius[:, None] * (np.cos(angle) * aside + np.sin(angle) * third)
    count = len(stations)
    vertices = np.concatenate([rings.reshape(-1, 3), middle[[0, -1]]])
    number = np.arange(SIDES * count).reshape(SIDES, count)
    a, b = number, np.roll(number, -1, axis=0)
    triangles = np.concatenate(
        [
            np.stack([a[:, :-1], b[:, :-1], b[:, 1:]], axis=-1).reshape(-1, 3),
            np.stack([a[:, :-1], b[:, 1:], a[:, 1:]], axis=-1).reshape(-1, 3),
            np.stack([np.full(SIDES, number.size), b[:, 0], a[:, 0]], axis=-1),
            np.stack([np.full(SIDES, number.size + 1), a[:, -1], b[:, -1]], axis=-1),
        ]
    )
    made = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    if not made.is_watertight():
        raise SystemExit("a tube that is not closed")
    if made.get_volume() < 0.0:
        made.triangles = o3d.utility.Vector3iVector(triangles[:, ::-1])
    return made.compute_triangle_normals()


def main() -> None:
    """Write meshes and URDF."""
    for name, stations in TUBES.items():
        if not o3d.io.write_triangle_mesh(FOLDER / f"{name}.stl", tube(stations)):
            raise SystemExit(f"{name}.stl could not be written")
    tree = ET.parse(ARM)
    for link in tree.getroot().findall("link"):
        if (mesh := DRAWN.get(link.attrib["name"])) is None:
            continue
        for visual in link.findall("visual"):
            link.remove(visual)
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=f"{mesh}.stl")
    ET.indent(tree)
    text = ET.tostring(tree.getroot(), encoding="unicode")
    (FOLDER / f"{NAME}.urdf").write_text(f'<?xml version="1.0"?>\n<!--{NOTE}-->\n{text}\n', encoding="utf-8")
    sys.stdout.write(f"{FOLDER}: {len(TUBES)} meshes and {NAME}.urdf\n")


if __name__ == "__main__":
    main()
