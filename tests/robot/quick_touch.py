"""A touch whose approach is short, for what it does in contact."""

import dataclasses

from studies.fault_study import FaultScene, make_scene


def quick_scene(seed: int, *, modulus_pa: float = 60e3, tip: str = "sphere", tilt_deg: float = 0.0) -> FaultScene:
    """As `make_scene`; the tip is slow only within 1 cm of the surface."""
    scene = make_scene(seed, modulus_pa=modulus_pa, tip=tip, tilt_deg=tilt_deg)
    return dataclasses.replace(scene, plan=dataclasses.replace(scene.plan, slow_within_m=0.01, far_speed_m_s=0.05))
