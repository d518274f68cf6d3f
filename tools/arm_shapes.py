"""A URDF of simple shapes for a chain of joints: `python tools/arm_shapes.py kr6r900sixx > FILE`."""

import math
import sys

import numpy as np

from deformscope_drivers.arm.kinematics import Chain

RADIUS_M = 0.05
SHORTEST_M = 0.02


def urdf_of(chain: Chain) -> str:
    """Links as cylinders from each joint to the next, the first as thick as RADIUS_M and each a little thinner."""
    name = chain.name
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {name} in simple shapes, made of its chain of joints by tools/arm_shapes.py: visual only -->",
        f'<robot name="{name}">',
        '  <material name="orange"><color rgba="0.85 0.42 0.12 1"/></material>',
        *_link(f"{name}_link_base", chain.joints[0].xyz_m, RADIUS_M),
    ]
    ends_m = [*(joint.xyz_m for joint in chain.joints[1:]), tuple(chain.T_last_end_effector[:3, 3])]
    for index, (joint, end_m) in enumerate(zip(chain.joints, ends_m, strict=True), 1):
        endless = joint.lower_deg is None or joint.upper_deg is None
        low = -2 * math.pi if joint.lower_deg is None else math.radians(joint.lower_deg)
        high = 2 * math.pi if joint.upper_deg is None else math.radians(joint.upper_deg)
        parent = f"{name}_link_{index - 1}" if index > 1 else f"{name}_link_base"
        lines += [
            f'  <joint name="{name}_joint_{index}" type="{"continuous" if endless else "revolute"}">',
            f'    <origin xyz="{_format_values(joint.xyz_m)}" rpy="{_format_values(joint.rpy_rad)}"/>',
            f'    <parent link="{parent}"/><child link="{name}_link_{index}"/><axis xyz="0 0 1"/>',
            f'    <limit lower="{low:.10g}" upper="{high:.10g}" effort="{joint.effort_nm:g}" '
            f'velocity="{math.radians(joint.velocity_deg_s):.10g}"/>',
            "  </joint>",
            *_link(f"{name}_link_{index}", end_m, RADIUS_M - 0.004 * index),
        ]
    lines += [
        f'  <joint name="{name}_joint_end_effector" type="fixed">',
        f'    <origin xyz="{_format_values(ends_m[-1])}" rpy="{_format_values(chain.end_effector_rpy_rad)}"/>',
        f'    <parent link="{name}_link_{chain.joint_count}"/><child link="{name}_end_effector"/>',
        "  </joint>",
        f'  <link name="{name}_end_effector"/>',
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _link(name: str, end_m: tuple[float, ...], radius_m: float) -> list[str]:
    """A cylinder from the link's origin to (3,) [m]; a disc where that is the origin too."""
    length_m = float(np.linalg.norm(end_m))
    x, y, z = end_m
    turned = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)) if length_m else (0.0, 0.0, 0.0)
    middle = tuple(0.5 * value for value in end_m)
    return [
        f'  <link name="{name}">',
        f'    <visual><origin xyz="{_format_values(middle)}" rpy="{_format_values(turned)}"/>',
        f'      <geometry><cylinder radius="{radius_m:.3g}" length="{max(length_m, SHORTEST_M):.6g}"/></geometry>',
        '      <material name="orange"/></visual>',
        "  </link>",
    ]


def _format_values(values: tuple[float, ...]) -> str:
    return " ".join(f"{value + 0.0:.10g}" for value in values)


if __name__ == "__main__":
    from deformscope_drivers.arms import chains

    sys.stdout.write(urdf_of(chains()[sys.argv[1]]))
