"""The arms' own descriptions, for viewers: `rr.urdf.UrdfTree.from_file_path(urdf_path("j2n6s300"))`."""

from __future__ import annotations

from pathlib import Path

from deformscope_drivers.jaco.chains import CHAINS


def urdf_path(model: str) -> Path:
    """File of an arm's URDF: simple shapes, the joints of `kinematics`, links and joints named `<model>_...`.

    Joint angles in it are the vendor's: `<model>_joint_1` and so on, at radians(degrees)."""
    if model not in CHAINS:
        raise ValueError(f"expected a model among {', '.join(sorted(CHAINS))}; came {model!r}")
    return Path(__file__).parent / f"{model}.urdf"
