"""The three Jaco2 as chains of joints, and the files that describe them to viewers.

Origins, limits and masses are facts of Kinova's published robot description (kinova_description, BSD-3)."""

from pathlib import Path

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, Joint

_PI = float(np.pi)
_BASE_JOINT = ((0.0, 0.0, 0.15675), (0.0, _PI, 0.0))
_SHOULDER_JOINT = ((0.0, 0.0016, -0.11875), (-_PI / 2, 0.0, _PI))
_FOREARM_JOINT = ((0.0, 0.2073, -0.0114), (-_PI / 2, 0.0, _PI))
_ELBOW_JOINT = ((0.0, -0.41, 0.0), (0.0, _PI, 0.0))
_SPHERICAL_JOINT = ((0.0, 0.0, -0.10375), (_PI / 2, 0.0, _PI))
_HAND_JOINT = ((0.0, 0.10375, 0.0), (-_PI / 2, 0.0, _PI))
_WRIST_JOINT = ((0.0, -0.03703, -0.06414), (_PI / 3, 0.0, _PI))
_END_EFFECTOR = ((0.0, 0.0, -0.16), (_PI, 0.0, _PI / 2))

J2N6S300 = Chain(
    "j2n6s300",
    (
        Joint(*_BASE_JOINT, None, None, 36.0, 40.0, 0.7477),
        Joint(*_SHOULDER_JOINT, 47.0, 313.0, 36.0, 80.0, 0.99),
        Joint(*_ELBOW_JOINT, 19.0, 341.0, 36.0, 40.0, 0.6763),
        Joint(*_FOREARM_JOINT, None, None, 48.0, 20.0, 0.426367),
        Joint(*_WRIST_JOINT, None, None, 48.0, 20.0, 0.426367),
        Joint(*_WRIST_JOINT, None, None, 48.0, 20.0, 0.99),
    ),
    *_END_EFFECTOR,
    home_deg=(275.0, 167.4, 57.4, 240.0, 82.7, 75.5),
)

J2S6S300 = Chain(
    "j2s6s300",
    (
        Joint(*_BASE_JOINT, None, None, 36.0, 40.0, 0.7477),
        Joint(*_SHOULDER_JOINT, 47.0, 313.0, 36.0, 80.0, 0.99),
        Joint(*_ELBOW_JOINT, 19.0, 341.0, 36.0, 40.0, 0.6763),
        Joint(*_FOREARM_JOINT, None, None, 48.0, 20.0, 0.463),
        Joint(*_SPHERICAL_JOINT, 30.0, 330.0, 48.0, 20.0, 0.463),
        Joint(*_HAND_JOINT, None, None, 48.0, 20.0, 0.99),
    ),
    *_END_EFFECTOR,
    home_deg=(283.0, 162.0, 43.0, 265.0, 257.0, 288.0),  # of seven joints, whose third stands at 0: the same arm
)

J2S7S300 = Chain(
    "j2s7s300",
    (
        Joint(*_BASE_JOINT, None, None, 36.0, 40.0, 0.7477),
        Joint(*_SHOULDER_JOINT, 47.0, 313.0, 36.0, 80.0, 0.8447),
        Joint((0.0, -0.205, 0.0), (-_PI / 2, 0.0, 0.0), None, None, 36.0, 40.0, 0.8447),
        Joint((0.0, 0.0, -0.205), (_PI / 2, 0.0, _PI), 30.0, 330.0, 36.0, 40.0, 0.6763),
        Joint(*_FOREARM_JOINT, None, None, 48.0, 20.0, 0.463),
        Joint(*_SPHERICAL_JOINT, 65.0, 295.0, 48.0, 20.0, 0.463),
        Joint(*_HAND_JOINT, None, None, 48.0, 20.0, 0.99),
    ),
    *_END_EFFECTOR,
    home_deg=(283.0, 162.0, 0.0, 43.0, 265.0, 257.0, 288.0),
)

CHAINS = {chain.name: chain for chain in (J2N6S300, J2S6S300, J2S7S300)}


def urdf_path(model: str) -> Path:
    """File of an arm's URDF: simple shapes, the joints of `kinematics`, links and joints named `<model>_...`.

    Joint angles in it are the vendor's: `<model>_joint_1` and so on, at radians(degrees)."""
    if model not in CHAINS:
        raise ValueError(f"expected a model among {', '.join(sorted(CHAINS))}; came {model!r}")
    return Path(__file__).parent / f"{model}.urdf"
